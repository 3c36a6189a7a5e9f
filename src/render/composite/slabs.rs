//! The kernel of slabs: what lies between two slices, looked up by the scalars on both (Schulze et
//! al. 2003).
//!
//! For a scanline of pixels and a slab:
//!
//! 1. *Which pixels?* Those that pass a cell in which something may show and are not opaque
//!    (`mask.rs`).
//! 2. *Sample* the back slice at those pixels; the front slice's samples are the last slab's back ones
//!    and wait in a buffer slice, but for pixels that had no work there (`samples.rs`).
//! 3. *Look up and blend*: the slab by its two scalars, lit by the mean light of both samples,
//!    its length and density corrected, "over".
//!
//! n slices have n - 1 slabs between them, or several times as many where slices are interpolated
//! between slices. A slab that a side of the volume's box cuts counts where its middle is inside: half
//! a slab too many is as likely as half too few. Its sample outside is that of the box's border.
//!
//! The paper's two kinds of buffer slice are both here: two buffers the size of a slice, which change
//! places (SB), or one the size of the intermediate image, in which a pixel's back sample takes the
//! place of its front sample (IB). Of either a band has its own scanlines only.

use std::ops::Range;

use glam::Vec4;

use super::cue::DepthTables;
use super::mask::{Mask, Runs};
use super::occupied::Occupied;
use super::samples::{self, Position, SampleRows, VoxelRows};
use super::{CANCEL_STEP, Composite, clear_bits, over};
use crate::classify::preintegration::Slabs;
use crate::render::factorization::Factorization;
use crate::render::intermediate::{Band, ScanlineMut};
use crate::render::slab::Correction;
use crate::render::{BufferSlice, Cancel, RenderError};
use crate::volume::gradient::Code;

/// What the bands of a frame share.
#[derive(Debug)]
pub struct SlabComposite<'a, T, S, C> {
    pub factorization: &'a Factorization,
    pub voxels: VoxelRows<'a, T>,
    pub occupied: Occupied<'a>,
    pub table: S,
    pub correction: C,
    /// `None`: nothing fades.
    pub cue: Option<&'a DepthTables>,
    /// Slabs from a slice of voxels to the next.
    pub steps: usize,
    pub buffer: BufferSlice,
    /// Accumulated opacity at which a pixel is done.
    pub opaque: f32,
    pub cancel: &'a Cancel,
}

/// Row buffers, masks and buffer slices of a thread.
#[derive(Debug)]
pub struct Scratch {
    front: SampleRows,
    back: SampleRows,
    pixels: Mask,
    fresh: Mask,
    kept: Vec<Kept>,
    buffer: Buffer,
}

/// Which pixels of a scanline have a sample in the buffer slice.
#[derive(Clone, Debug)]
struct Kept {
    /// The slab that left them.
    slab: usize,
    pixels: Mask,
}

/// Where a slab lies.
struct Slab {
    number: usize,
    /// Slice of voxels below it, in the volume's order: the layer of cells that it is in.
    layer: usize,
    front: Position,
    back: Position,
    /// Its middle along k.
    middle: f64,
    /// Pixels along u and scanlines over which the middle is inside the volume.
    pixels: Range<usize>,
    scanlines: Range<usize>,
    /// The factor of depth cueing along k.
    cue: f32,
}

impl<T: Code, S: Slabs, C: Correction> Composite for SlabComposite<'_, T, S, C> {
    type Scratch = Scratch;

    fn scratch(&self, height: usize) -> Scratch {
        let [length, ..] = self.factorization.dims;
        let [width, _] = self.factorization.size;
        Scratch {
            front: SampleRows::new(length),
            back: SampleRows::new(length),
            pixels: Mask::new(width),
            fresh: Mask::new(width),
            kept: vec![Kept { slab: 0, pixels: Mask::new(width) }; height],
            buffer: Buffer::new(self.buffer, length, width, height),
        }
    }

    #[inline(always)]
    fn band(&self, band: &mut Band<'_>, scratch: &mut Scratch) -> Result<(), RenderError> {
        for kept in &mut scratch.kept {
            kept.pixels.clear();
        }
        for number in 0..self.slabs() {
            if number % CANCEL_STEP == 0 && self.cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            self.slab(band, &self.place(number), scratch);
            scratch.buffer.next_slab();
        }
        Ok(())
    }
}

impl<T: Code, S: Slabs, C: Correction> SlabComposite<'_, T, S, C> {
    /// Slabs along a ray.
    pub(super) fn slabs(&self) -> usize {
        (self.factorization.dims[2] - 1) * self.steps
    }

    fn place(&self, number: usize) -> Slab {
        let f = self.factorization;
        let middle = samples::along(f, number as f64 + 0.5, self.steps);
        let inside = f.placement(middle);
        let [pixels, scanlines] = [0, 1].map(|axis| {
            let voxels = f.dims[axis] - usize::from(inside.fraction[axis] > 0.0);
            inside.first[axis]..inside.first[axis] + voxels
        });
        let layer = number / self.steps;
        Slab {
            number,
            layer: if f.reversed { f.dims[2] - 2 - layer } else { layer },
            front: Position::new(f, number, self.steps),
            back: Position::new(f, number + 1, self.steps),
            middle,
            pixels,
            scanlines,
            cue: self.cue.map_or(1.0, |cue| cue.slice(middle)),
        }
    }

    /// One slab into one band.
    #[inline(always)]
    fn slab(&self, band: &mut Band<'_>, slab: &Slab, scratch: &mut Scratch) {
        let rows = band.first..band.first + band.height();
        for v in slab.scanlines.start.max(rows.start)..slab.scanlines.end.min(rows.end) {
            let row = v - band.first;
            let mut scanline = band.scanline(row);
            if !self.find(slab, v, &scanline, &mut scratch.pixels) {
                continue;
            }
            let Scratch { front, back, pixels, fresh, kept, buffer } = &mut *scratch;
            let kept = &mut kept[row];
            let samples = buffer.row(row, slab);
            let missing = if kept.slab + 1 == slab.number {
                fresh.difference(pixels, &kept.pixels)
            } else {
                fresh.copy_from(pixels);
                true
            };
            if missing {
                let out = (&mut *samples.front, samples.front_base);
                front.sample(&self.voxels, self.table, &slab.front, v, fresh, out);
            }
            let out = (&mut *samples.back, samples.back_base);
            back.sample(&self.voxels, self.table, &slab.back, v, pixels, out);
            self.blend(&mut scanline, v, slab, pixels, &samples);
            samples.keep(pixels);
            kept.slab = slab.number;
            kept.pixels.copy_from(pixels);
        }
    }

    /// Finds the pixels of scanline `v` to work on; false where there is none.
    #[inline(always)]
    fn find(&self, slab: &Slab, v: usize, scanline: &ScanlineMut<'_>, pixels: &mut Mask) -> bool {
        let [ni, nj, _] = self.factorization.dims;
        let cells = |position: &Position| {
            let first = position.placement.first;
            let j = (v + 1).saturating_sub(first[1] + 1).min(nj - 2);
            (self.occupied.scanline(j, slab.layer), first[0])
        };
        pixels.clear();
        for (cells, first) in [cells(&slab.front), cells(&slab.back)] {
            pixels.add_cells(cells, ni - 1, first);
        }
        let any = pixels.keep(scanline.non_opaque, &slab.pixels);
        if any && !self.factorization.clip.is_empty() {
            return pixels.keep(scanline.non_opaque, &self.factorization.visible_pixels(v, slab.middle));
        }
        any
    }

    /// Looks slabs up and blends them behind what is there.
    #[inline(always)]
    fn blend(&self, scanline: &mut ScanlineMut<'_>, v: usize, slab: &Slab, pixels: &Mask, samples: &BufferRow<'_>) {
        let lit = self.voxels.is_lit();
        let along_v = self.cue.map_or(1.0, |cue| slab.cue * cue.along_v[v]);
        for (u, length) in Runs::new(pixels) {
            let run = Run {
                pixels: &mut scanline.pixels[u..][..length],
                front: &samples.front[(u as isize - samples.front_base) as usize..][..length],
                back: &samples.back[(u as isize - samples.back_base) as usize..][..length],
            };
            let opaque = match (lit, self.cue.map(|cue| &cue.along_u[u..][..length])) {
                (false, None) => self.blend_run::<false, false>(run, &[], along_v),
                (false, Some(cue)) => self.blend_run::<false, true>(run, cue, along_v),
                (true, None) => self.blend_run::<true, false>(run, &[], along_v),
                (true, Some(cue)) => self.blend_run::<true, true>(run, cue, along_v),
            };
            if opaque != 0 {
                clear_bits(scanline.non_opaque, u, opaque);
            }
        }
    }

    /// Blends consecutive pixels; gives the mask of those that became opaque.
    #[inline(always)]
    fn blend_run<const LIT: bool, const CUED: bool>(&self, run: Run<'_>, along_u: &[f32], along_v: f32) -> u64 {
        let mut opaque = 0;
        let samples = run.front.iter().zip(run.back);
        for (at, (pixel, (front, back))) in run.pixels.iter_mut().zip(samples).enumerate() {
            let mut sample = self.sample::<LIT>(*front, *back);
            if CUED {
                sample = (sample * (along_v * along_u[at])).with_w(sample.w);
            }
            *pixel = over(*pixel, sample);
            opaque |= u64::from(pixel.w >= self.opaque) << at;
        }
        opaque
    }

    /// Premultiplied colour and opacity between two samples.
    #[inline(always)]
    pub(super) fn sample<const LIT: bool>(&self, front: Vec4, back: Vec4) -> Vec4 {
        let mean = (front + back) * 0.5;
        let slab = self.correction.correct(self.table.slab(front.x, back.x), mean.w);
        if LIT { (slab * mean.y + Vec4::splat(mean.z * slab.w)).min(Vec4::splat(slab.w)).with_w(slab.w) } else { slab }
    }
}

/// Consecutive pixels and their samples.
struct Run<'a> {
    pixels: &'a mut [Vec4],
    front: &'a [Vec4],
    back: &'a [Vec4],
}

/// The buffer slice, or rather a band's part of it.
#[derive(Debug)]
struct Buffer {
    kind: BufferSlice,
    /// SB: two slices, voxel -1 first. IB: the scanlines of the image, and one of back samples.
    slices: [Vec<Vec4>; 2],
    /// Samples in a scanline.
    length: usize,
    /// SB: which of the slices is in front.
    front: usize,
}

/// A scanline of front samples and one of back samples: pixel u is at `u - base`.
struct BufferRow<'a> {
    front: &'a mut [Vec4],
    front_base: isize,
    back: &'a mut [Vec4],
    back_base: isize,
    in_place: bool,
}

impl Buffer {
    fn new(kind: BufferSlice, voxels: usize, width: usize, height: usize) -> Self {
        let (length, rows) = match kind {
            BufferSlice::Slice => (voxels + 1, [height, height]),
            BufferSlice::Image => (width, [height, 1]),
        };
        Self { kind, slices: rows.map(|rows| vec![Vec4::ZERO; rows * length]), length, front: 0 }
    }

    /// The scanlines of a band's row.
    #[inline(always)]
    fn row(&mut self, row: usize, slab: &Slab) -> BufferRow<'_> {
        let [first, second] = &mut self.slices;
        let at = row * self.length;
        match self.kind {
            BufferSlice::Image => BufferRow {
                front: &mut first[at..][..self.length],
                front_base: 0,
                back: second,
                back_base: 0,
                in_place: true,
            },
            BufferSlice::Slice => {
                let (front, back) = if self.front == 0 { (first, second) } else { (second, first) };
                let base = |position: &Position| position.placement.first[0] as isize - 1;
                BufferRow {
                    front: &mut front[at..][..self.length],
                    front_base: base(&slab.front),
                    back: &mut back[at..][..self.length],
                    back_base: base(&slab.back),
                    in_place: false,
                }
            }
        }
    }

    /// What was behind is in front.
    #[inline(always)]
    fn next_slab(&mut self) {
        self.front = 1 - self.front;
    }
}

impl BufferRow<'_> {
    /// Leaves the back samples of `pixels` where the next slab looks for its front ones.
    #[inline(always)]
    fn keep(self, pixels: &Mask) {
        if self.in_place {
            for (u, length) in Runs::new(pixels) {
                self.front[u..][..length].copy_from_slice(&self.back[u..][..length]);
            }
        }
    }
}
