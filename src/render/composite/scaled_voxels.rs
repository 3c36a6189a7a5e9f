//! The kernel of single voxels over scaled slices.
//!
//! The same three steps as where pixels lie as far apart as voxels, but for two things. The voxel
//! scanlines under a scanline of pixels are several, kept in a ring; where any of them has runs, the
//! pixels that these are under follow from the footprint. And the opacity of a resampled pixel is
//! corrected for the length of its own ray: voxels are looked up as the shortest ray would see them.
//! (Correcting voxel by voxel would take a power or a table for each; resampled premultiplied colours differ
//! from those of corrected voxels by less than a step of 8 bits.)

use std::ops::Range;

use glam::Vec4;

use super::clipped::ClippedPixels;
use super::cue::ScanlineCue;
use super::footprint::Footprint;
use super::lattice::{Lattice, Scaled};
use super::mask::{Mask, Runs};
use super::rows::Row;
use super::scaled::{Columns, add};
use super::sources::VoxelSource;
use super::voxels::{VoxelLattice, Voxels, cut, slices_ahead};
use super::{WORD, clear_bits, first_run, run_mask};
use crate::render::factorization::Factorization;
use crate::render::intermediate::{Band, ScanlineMut};
use crate::render::material::{Shader, SliceShader};
use crate::render::pixel::Pixel;
use crate::render::simd::masks::Masks;
use crate::render::simd::masks::fours;
use crate::render::simd::shorts::Shorts;
use crate::render::slab::opacity_ratio;

/// Row buffers and masks of a thread.
#[derive(Debug)]
pub struct Scratch {
    length: usize,
    /// Voxel scanlines, j always in the same place.
    rows: Vec<Row<Vec4>>,
    /// Voxels that any of them marks, of those with a weight.
    marked: Vec<u64>,
    columns: Columns,
    /// Weights of the scanlines under one of pixels.
    weights: Vec<f32>,
    sum: Vec<Vec4>,
    pixels: Mask,
    clipped: ClippedPixels,
    touched: Mask,
    /// The first bits of aligned fours of voxels that hold those.
    asked: Vec<u64>,
    /// Lengths of the band's rays in units of the shortest.
    lengths: Vec<f32>,
}

/// A scanline of pixels on a slice.
struct Place<'a> {
    factorization: &'a Factorization,
    along_u: Footprint,
    /// Pixels that lie on the slice.
    us: Range<usize>,
    v: usize,
}

impl VoxelLattice<Vec4> for Scaled {
    type Scratch = Scratch;

    fn scratch(factorization: &Factorization) -> Scratch {
        let length = factorization.dims[0];
        Scratch {
            length,
            rows: vec![],
            marked: vec![0; length.div_ceil(WORD)],
            columns: Columns::default(),
            weights: vec![],
            sum: vec![Vec4::ZERO; length],
            pixels: Mask::new(factorization.size[0]),
            clipped: ClippedPixels::default(),
            touched: Mask::new(length),
            asked: vec![],
            lengths: vec![],
        }
    }

    #[inline(always)]
    fn enter_band(factorization: &Factorization, band: &Band<'_, Vec4>, scratch: &mut Scratch) {
        factorization.relative_lengths(band.first..band.first + band.height(), &mut scratch.lengths);
        scratch.clipped.enter_band(band);
    }

    #[inline(always)]
    fn slice<W: Shorts, V: VoxelSource, M: Shader<Slice: SliceShader<Pixel = Vec4>>>(
        voxels: &Voxels<'_, Self, V, M>,
        band: &mut Band<'_, Vec4>,
        k: usize,
        scratch: &mut Scratch,
    ) {
        let f = voxels.factorization;
        let placement @ [along_u, along_v] = voxels.placements[k - f.slices.start];
        let [us, vs] = Self::inside(f, &placement);
        if us.is_empty() {
            return;
        }
        let band_end = band.first + band.height();
        let vs = vs.start.max(band.first)..vs.end.min(band_end);
        if vs.is_empty() || !scratch.clipped.enter(f, vs.clone(), f.interval(k)) {
            return;
        }
        let material = voxels.material.slice(f.share(k));
        let cue = voxels.cue.map(|cue| cue.slice(k as f64));
        scratch.enter_slice(along_v.taps());
        let ahead = slices_ahead(f, k);
        let next = ahead.map_or(k, |[next, _]| next);
        for v in vs {
            let (first, taps) = (along_v.first(v), along_v.taps());
            if taps < WORD && voxels.source.shown(first, taps, k) == 0 {
                continue;
            }
            if let Some([_, farther]) = ahead {
                voxels.source.prefetch_place(first, farther);
            }
            scratch.weights.clear();
            scratch.weights.extend((first..first + taps).map(|j| along_v.weight(v, j)));
            if !scratch.enter_rows(voxels.source, first, k) {
                continue;
            }
            let row = v - band.first;
            let mut scanline = band.scanline(row);
            let at = Place { factorization: f, along_u, us: us.clone(), v };
            if !scratch.find::<W>(&at, &mut scanline) {
                continue;
            }
            scratch.shade::<W, V, _>(voxels.source, first, [k, next], material);
            let finish = |sample: Vec4, u, length, clipped: &ClippedPixels| {
                let left = if clipped.is_any() { voxels.left(u, v, k, clipped) } else { None };
                let of_length = if M::Slice::PAINTED {
                    material.resampled(sample, length)
                } else {
                    sample * opacity_ratio(sample.w, length)
                };
                cut(of_length, left)
            };
            let cue = cue.map(|cue| cue.scanline(v));
            scratch.blend(&mut scanline, row * f.size[0], first, cue, finish, voxels.opaque);
        }
    }
}

impl Scratch {
    /// Forgets the scanlines of another slice; there will be `taps` of them to one of pixels.
    #[inline(always)]
    fn enter_slice(&mut self, taps: usize) {
        while self.rows.len() < taps {
            self.rows.push(Row::new(self.length));
        }
        self.rows.iter_mut().for_each(|row| row.j = None);
    }

    /// Enters the scanlines from `first` on of slice `k`; false where none of those with a weight has anything.
    #[inline(always)]
    fn enter_rows<V: VoxelSource>(&mut self, source: V, first: usize, k: usize) -> bool {
        let count = self.rows.len();
        let mut any = 0;
        self.marked.fill(0);
        for (j, &weight) in (first..).zip(&self.weights) {
            self.rows[j % count].enter(j);
            if weight > 0.0 {
                let scanline = source.scanline(j, k);
                for (marked, marks) in self.marked.iter_mut().zip(source.marks(&scanline)) {
                    *marked |= marks;
                    any |= marks;
                }
            }
        }
        any != 0
    }

    /// Finds the pixels over marked voxels that are not opaque and not clipped away, and the voxels under them;
    /// false where there is none.
    #[inline(always)]
    fn find<W: Masks>(&mut self, at: &Place<'_>, scanline: &mut ScanlineMut<'_, Vec4>) -> bool {
        self.pixels.clear();
        for word in 0..self.marked.len() {
            let mut marked = self.marked[word];
            while marked != 0 {
                let (start, length) = first_run(marked);
                marked &= !run_mask(start, length);
                // From the outer edge of the run's first voxel to that of its last; at the slice's border, from afar.
                let (from, to) = (word * WORD + start, word * WORD + start + length);
                let low = if from == 0 { f64::NEG_INFINITY } else { from as f64 - 0.5 };
                let high = if to >= self.length { f64::INFINITY } else { to as f64 - 0.5 };
                self.pixels.add(at.along_u.touching(low, high));
            }
        }
        let mut any = self.pixels.keep(scanline.non_opaque, &at.us);
        let f = at.factorization;
        if any && self.clipped.enter_scanline(f, at.v, || self.pixels.filled()) {
            any =
                !self.clipped.find::<W>(f, at.v, scanline.non_opaque) || self.pixels.keep(self.clipped.open(), &at.us);
        }
        if any {
            self.columns.fill(&at.along_u, &at.us);
            self.touch();
        }
        any
    }

    /// Shades the touched voxels.
    #[inline(always)]
    fn shade<W: Shorts, V: VoxelSource, M: SliceShader<Pixel = Vec4>>(
        &mut self,
        source: V,
        first: usize,
        [k, next]: [usize; 2],
        material: M,
    ) {
        let count = self.rows.len();
        for (j, _) in (first..).zip(&self.weights).filter(|(_, weight)| **weight > 0.0) {
            let (row, scanline) = (&mut self.rows[j % count], source.scanline(j, k));
            for (word, asked) in self.asked.iter().enumerate().filter(|(_, asked)| **asked != 0) {
                row.shade::<W, V, M>(source, (&scanline, source.ahead(j, next)), (word, *asked), k, material);
            }
        }
    }

    /// The voxels under the pixels.
    #[inline(always)]
    fn touch(&mut self) {
        self.touched.clear();
        for (u, length) in Runs::new(&self.pixels) {
            self.touched.add(self.columns.under(&(u..u + length)));
        }
        self.asked.clear();
        self.asked.extend(self.touched.words().iter().map(|touched| fours(*touched)));
    }

    /// Resamples the scanlines from `first` on at the pixels and blends behind what is there.
    #[inline(always)]
    fn blend(
        &mut self,
        scanline: &mut ScanlineMut<'_, Vec4>,
        lengths: usize,
        first: usize,
        cue: Option<ScanlineCue<'_>>,
        finish: impl Fn(Vec4, usize, f32, &ClippedPixels) -> Vec4,
        opaque: f32,
    ) {
        let count = self.rows.len();
        for (u, length) in Runs::new(&self.pixels) {
            let hull = self.columns.under(&(u..u + length));
            let sum = &mut self.sum[..hull.len()];
            let mut empty = true;
            for (j, &weight) in (first..).zip(&self.weights).filter(|(_, weight)| **weight > 0.0) {
                add(sum, &self.rows[j % count].voxels[hull.clone()], weight, empty);
                empty = false;
            }
            let mut samples = [Vec4::ZERO; WORD];
            self.columns.gather(u, sum, hull.start, &mut samples[..length]);
            let mut done = 0;
            let lengths = &self.lengths[lengths + u..][..length];
            let pixels = scanline.pixels[u..][..length].iter_mut().zip(&samples).zip(lengths);
            for (at, ((pixel, sample), length)) in pixels.enumerate() {
                let mut sample = finish(*sample, u + at, *length, &self.clipped);
                if let Some(cue) = cue {
                    sample = sample.faded(cue.at(u + at));
                }
                *pixel = pixel.over(sample);
                done |= u64::from(pixel.w >= opaque) << at;
            }
            if done != 0 {
                clear_bits(scanline.non_opaque, u, done);
            }
        }
    }
}
