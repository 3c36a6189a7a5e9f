//! The scanline kernel: shear, resample and composite slices front to back into the intermediate
//! image (Lacroute and Levoy 1994, section 3.1).
//!
//! The intermediate image is cut into bands of scanlines, each a job of its own that walks all
//! slices; pixels do not depend on how bands are cut or on who fills them. What the slices are made
//! of is a type parameter of the walk:
//!
//! - [`voxels`]: single voxels, shaded and resampled, each slice behind the one before; encoded ones or
//!   unencoded ones ([`sources`]).
//! - [`slabs`]: what lies between two slices, looked up by the scalars on both.
//!
//! Either works in the same three steps for a scanline of pixels: *which pixels* are not opaque and
//! see something that is not transparent (machine words, a bit for each pixel); *fetch* the voxels
//! those pixels touch into row buffers, each once; *resample and blend*. How pixels lie over slices is another type
//! parameter, [`lattice`]: as far apart as voxels, or scaled by perspective.
//!
//! Everything skipped would have added exact zeros or stood behind an opaque pixel; [`naive`] does
//! it all the slow way and tests hold both together bit for bit.

mod clipped;
pub mod cue;
pub mod float_slabs;
pub mod footprint;
pub mod lattice;
mod mask;
pub mod naive;
pub mod occupied;
mod rows;
pub mod samples;
mod scaled;
mod scaled_voxels;
pub mod short_slabs;
pub mod slabs;
pub mod sources;
mod touched;
pub mod voxels;

use rayon::prelude::*;

use super::RenderError;
use super::bands;
use super::intermediate::{Band, BandBuffer, IntermediateImage, Strip};
use super::pixel::Pixel;
pub(super) use super::pixel::WORD;
use super::simd::shorts::Shorts;
#[cfg(target_arch = "x86_64")]
use super::simd::wide::Avx2;
use super::simd::wide::Portable;
use super::simd::{self, Kernel};

/// Scanlines of a band: enough to share voxel scanlines between pixel rows, few enough that a
/// band's pixels stay in the second-level cache and bands spread evenly over threads.
const BAND_HEIGHT: usize = 16;

/// Slices from one look at whether the frame was cancelled to the next.
const CANCEL_STEP: usize = 64;

/// A walk over all slices that fills bands of the intermediate image.
pub trait Composite: Sync {
    /// What bands are composited in.
    type Pixel: Pixel;
    /// Row buffers and masks of a thread.
    type Scratch: Send;

    /// Scratch for bands of at most `height` scanlines.
    fn scratch(&self, height: usize) -> Self::Scratch;

    /// Composites all slices into a band. Implementations are `#[inline(always)]`.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`].
    fn band<W: Shorts>(&self, band: &mut Band<'_, Self::Pixel>, scratch: &mut Self::Scratch)
    -> Result<(), RenderError>;

    /// Composites into `image`, which must be of the factorization's size.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`].
    fn run(&self, image: &mut IntermediateImage) -> Result<(), RenderError>
    where
        Self: Sized,
    {
        bands::middle_first(image.strips(BAND_HEIGHT)).try_for_each_init(
            || (BandBuffer::default(), self.scratch(BAND_HEIGHT)),
            |(buffer, scratch), strip| simd::dispatch(Job { composite: self, strip, buffer, scratch }),
        )
    }
}

/// One band.
struct Job<'a, 'b, C: Composite> {
    composite: &'a C,
    strip: Strip<'b>,
    buffer: &'a mut BandBuffer<C::Pixel>,
    scratch: &'a mut C::Scratch,
}

impl<C: Composite> Kernel for Job<'_, '_, C> {
    type Output = Result<(), RenderError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.fill::<Portable>()
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) -> Self::Output {
        self.fill::<Avx2>()
    }
}

impl<C: Composite> Job<'_, '_, C> {
    #[inline(always)]
    fn fill<W: Shorts>(self) -> Result<(), RenderError> {
        let mut band = self.strip.open(self.buffer);
        self.composite.band::<W>(&mut band, self.scratch)?;
        self.strip.close(self.buffer);
        Ok(())
    }
}

/// `length` bits from bit `start` on.
#[inline(always)]
pub(super) fn run_mask(start: usize, length: usize) -> u64 {
    (u64::MAX >> (WORD - length)) << start
}

/// The bits of word `at` that stand for pixels below `limit`.
#[inline(always)]
fn below(limit: usize, at: usize) -> u64 {
    let bits = limit.saturating_sub(at * WORD);
    if bits >= WORD { u64::MAX } else { (1 << bits) - 1 }
}

/// The first run of set bits in a word that is not zero: its start and its length.
#[inline(always)]
pub(super) fn first_run(bits: u64) -> (usize, usize) {
    let start = bits.trailing_zeros() as usize;
    (start, (!(bits >> start)).trailing_zeros().min((WORD - start) as u32) as usize)
}

/// Clears the bits of `mask`, which starts at bit `from` of `words`.
#[inline(always)]
fn clear_bits(words: &mut [u64], from: usize, mask: u64) {
    let (word, shift) = (from / WORD, from % WORD);
    words[word] &= !(mask << shift);
    if shift > 0 {
        words[word + 1] &= !(mask >> (WORD - shift));
    }
}
