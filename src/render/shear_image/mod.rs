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
//! al. 2003), or, between voxels with colours of their own or labels, the means of two samples
//! (Kraus and Bürger 2008; [`painted`]).
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
mod medium;
mod packet;
mod painted;
mod patch;
mod projection;
mod sampler;
mod skip;

use std::time::Instant;

use glam::Vec4;
use rayon::prelude::*;

use super::bands;
use super::simd::wide::{LANES, Portable, Wide};
use super::simd::{self, Kernel};
use super::{Cancel, RenderError, Scene, Settings, Timings, View};
use crate::render::Blend;
use crate::volume::Scalars;
use crate::volume::gradient::Code;
use crate::volume::scanlines::{AnyScanlines, Scanlines};
use packet::{IndexRays, Packet};

/// Rows that one job fills: packets below each other read the same voxels.
const BAND_HEIGHT: usize = 8;

/// What becomes of packets: their rays' pixels, premultiplied.
trait Pixels: Sync {
    /// What a job keeps from tile to tile.
    type Buffers: Default;

    /// Walks the slices with a tile of packets, which are of one part of the view and lie below each other.
    /// Implementations are `#[inline(always)]`.
    fn pixels<W: Wide>(&self, tile: &[Packet], buffers: &mut Self::Buffers, out: &mut [[Vec4; LANES]]);
}

/// A frame in shear-image order: its rays' pixels, premultiplied.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub(super) fn rays(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Vec<Vec4>, Timings), RenderError> {
    let prepared = scene.prepared;
    match (prepared.volume().scalars(), [0, 1, 2].map(|axis| prepared.scanlines(axis))) {
        (Scalars::U8(codes), [AnyScanlines::U8(x), AnyScanlines::U8(y), AnyScanlines::U8(z)]) => {
            of_codes(codes, [x, y, z], scene, view, settings, cancel)
        }
        (Scalars::U16(codes), [AnyScanlines::U16(x), AnyScanlines::U16(y), AnyScanlines::U16(z)]) => {
            of_codes(codes, [x, y, z], scene, view, settings, cancel)
        }
        _ => unreachable!("all copies of a volume's codes are of one type"),
    }
}

fn of_codes<T: Code>(
    codes: &[T],
    scanlines: [Scanlines<'_, T>; 3],
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Vec<Vec4>, Timings), RenderError> {
    let start = Instant::now();
    let rays = IndexRays::new(view, scene.prepared.volume());
    let frame = Frame { rays: &rays, settings, cancel, start };
    match settings.blend {
        Blend::Composite => composite::frame(codes, scanlines, scene, &frame),
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
    fn render<P: Pixels>(&self, pixels: &P) -> Result<(Vec<Vec4>, Timings), RenderError> {
        let begun = self.start.elapsed();
        let (width, height) = self.rays.size;
        let mut out = vec![Vec4::ZERO; width * height];
        bands::middle_first(out.chunks_mut(width * BAND_HEIGHT).enumerate())
            .try_for_each(|(band, out)| simd::dispatch(Band { pixels, frame: self, first: band * BAND_HEIGHT, out }))?;
        let render = self.start.elapsed();
        Ok((out, Timings { composite: render - begun, render, ..Timings::default() }))
    }
}

/// Some rows of the image.
struct Band<'a, P> {
    pixels: &'a P,
    frame: &'a Frame<'a>,
    first: usize,
    /// All zero.
    out: &'a mut [Vec4],
}

impl<P: Pixels> Kernel for Band<'_, P> {
    type Output = Result<(), RenderError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        self.fill::<Portable>()
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) -> Self::Output {
        self.fill::<simd::wide::Avx2>()
    }
}

impl<P: Pixels> Band<'_, P> {
    /// Fills it.
    #[inline(always)]
    fn fill<W: Wide>(self) -> Result<(), RenderError> {
        let (width, _) = self.frame.rays.size;
        let mut buffers = P::Buffers::default();
        let (mut rows, mut packets) = (Vec::with_capacity(BAND_HEIGHT), Vec::with_capacity(BAND_HEIGHT));
        for x in (0..width).step_by(LANES) {
            if self.frame.cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            let lanes = LANES.min(width - x);
            // Packets by part; where parts meet, several of a row.
            for part in self.parts(x, lanes) {
                rows.clear();
                packets.clear();
                for row in 0..self.rows() {
                    let mut first = 0;
                    while first < lanes {
                        let end = self.frame.rays.part_end(x, self.first + row, first, lanes);
                        if let Some(packet) = self.frame.rays.packet(x, self.first + row, first..end)
                            && (packet.axis, packet.reversed) == part
                        {
                            rows.push(row);
                            packets.push(packet);
                        }
                        first = end;
                    }
                }
                let mut pixels = [[Vec4::ZERO; LANES]; BAND_HEIGHT];
                self.pixels.pixels::<W>(&packets, &mut buffers, &mut pixels[..packets.len()]);
                for ((packet, row), pixels) in packets.iter().zip(&rows).zip(&pixels) {
                    let (first, last) = packet.lanes;
                    self.out[row * width + x..][first..=last].copy_from_slice(&pixels[first..=last]);
                }
            }
        }
        Ok(())
    }
}

impl<P> Band<'_, P> {
    /// How many there are.
    fn rows(&self) -> usize {
        self.out.len() / self.frame.rays.size.0
    }

    /// The parts of the view that `lanes` columns from `x` on have pixels of.
    fn parts(&self, x: usize, lanes: usize) -> Vec<(usize, bool)> {
        let rays = self.frame.rays;
        let corners = [0, lanes - 1].map(|lane| [0, self.rows() - 1].map(|row| rays.part(x + lane, self.first + row)));
        let here = corners[0][0];
        // The directions of one part are a convex cone: where all corners are in it, all are.
        if corners.as_flattened().iter().all(|part| *part == here) {
            return vec![here];
        }
        [0, 1, 2].into_iter().flat_map(|axis| [(axis, false), (axis, true)]).collect()
    }
}
