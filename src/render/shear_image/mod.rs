//! Slices sampled where the output's own rays meet them: quality `high`, and the projections.
//!
//! The shear-warp factorization resamples twice: slices onto the intermediate image's lattice, and
//! that image into the final one. The second step costs sharpness that no finer slab wins back: an
//! intermediate image at the output's resolution and a bilinear warp stay 0.5 to 5 dB short of what
//! follows. Here the lattice of every slice is the final image's own: pixel (x, y) meets slice
//! `t` at `start(x, y) + t slope(x, y)`, which is still regular within a slice (affine under
//! parallel projection, its offset linear in `t`), so nothing is warped. Wu, Bhatia, Lauer and Seiler
//! call it the shear-image order. Between two slices of voxels lie slices interpolated between
//! them (Sweeney and Mueller 2002), and slabs between all of these are pre-integrated (Schulze et
//! al. 2003).
//!
//! Eight neighbouring pixels of a row make a [`packet::Packet`]. It walks the slices front to back
//! and keeps its pixels, its scalars of the last slice (the buffer slice) and its open lanes in
//! registers. Every ray has its own principal axis: a perspective view falls into parts by axis, no
//! slice is met flatter than at 45 degrees in index space, and an eye among the slices is where its
//! rays begin.
//!
//! What is skipped, a layer of cells at a time, is what the runs of cells say is transparent
//! ([`skip`]), without them what octree and summed-area table say of leaves; both change no bit.
//! The first and the last slab of a ray end where it enters and leaves the volume's box and the view's
//! clip planes, exactly.

// Lanes of several arrays are walked together, and closures of iterators are not inlined into the wide entry.
#![allow(clippy::needless_range_loop)]

mod composite;
mod packet;
mod projection;
mod sampler;
mod skip;

use std::time::Instant;

use glam::Vec4;
use rayon::prelude::*;

use super::simd::{self, Kernel};
use super::{Cancel, Image, RenderError, Scene, Settings, Timings, View, image};
use crate::render::Blend;
use crate::volume::Scalars;
use crate::volume::gradient::Code;
use packet::{IndexRays, LANES, Packet};

/// Rows that one job fills: packets below each other read the same voxels.
const BAND_HEIGHT: usize = 8;

/// What becomes of a packet: its rays' pixels, premultiplied.
trait Pixels: Sync {
    /// Walks the slices. Implementations are `#[inline(always)]`.
    fn pixels(&self, packet: &Packet) -> [Vec4; LANES];
}

/// A frame in shear-image order.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub(super) fn frame(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    match scene.prepared.volume().scalars() {
        Scalars::U8(codes) => of_codes(codes, scene, view, settings, cancel),
        Scalars::U16(codes) => of_codes(codes, scene, view, settings, cancel),
    }
}

fn of_codes<T: Code>(
    codes: &[T],
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    let start = Instant::now();
    let rays = IndexRays::new(view, scene.prepared.volume());
    let frame = Frame { rays: &rays, settings, cancel, start };
    match settings.blend {
        Blend::Composite => composite::frame(codes, scene, &frame),
        Blend::Projection(which, window) => projection::frame(codes, scene, &frame, which, window),
    }
}

/// What all ways to fill a frame share.
#[derive(Clone, Copy)]
struct Frame<'a> {
    rays: &'a IndexRays,
    settings: &'a Settings,
    cancel: &'a Cancel,
    start: Instant,
}

impl Frame<'_> {
    /// Fills the image, band by band.
    fn render<P: Pixels>(&self, pixels: &P) -> Result<(Image, Timings), RenderError> {
        let start = self.start.elapsed();
        let (width, height) = self.rays.size;
        let background = &self.settings.background;
        let row_bytes = width * background.channels();
        let mut out = vec![0; row_bytes * height];
        out.par_chunks_mut(row_bytes * BAND_HEIGHT).enumerate().try_for_each(|(band, out)| {
            let rows = out.len() / row_bytes;
            let band = Band { pixels, frame: self, first: band * BAND_HEIGHT, rows };
            let colors = simd::dispatch(band)?;
            for (out, row) in out.chunks_exact_mut(row_bytes).zip(colors.chunks_exact(width)) {
                image::write_row(row, background, out);
            }
            Ok(())
        })?;
        let render = self.start.elapsed();
        let timings = Timings { composite: render - start, render, ..Timings::default() };
        let (width, height) = (width as u32, height as u32);
        Ok((Image { width, height, channels: background.channels() as u8, pixels: out }, timings))
    }
}

/// Some rows of the image.
struct Band<'a, P> {
    pixels: &'a P,
    frame: &'a Frame<'a>,
    first: usize,
    rows: usize,
}

impl<P: Pixels> Kernel for Band<'_, P> {
    type Output = Result<Vec<Vec4>, RenderError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let (width, _) = self.frame.rays.size;
        let mut colors = vec![Vec4::ZERO; width * self.rows];
        for x in (0..width).step_by(LANES) {
            if self.frame.cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            let lanes = LANES.min(width - x);
            for row in 0..self.rows {
                let (y, out) = (self.first + row, &mut colors[row * width + x..][..lanes]);
                let mut first = 0;
                while first < lanes {
                    let end = self.frame.rays.part_end(x, y, first, lanes);
                    if let Some(packet) = self.frame.rays.packet(x, y, first..end) {
                        out[first..end].copy_from_slice(&self.pixels.pixels(&packet)[first..end]);
                    }
                    first = end;
                }
            }
        }
        Ok(colors)
    }
}
