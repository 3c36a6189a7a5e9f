//! Slabs of 16-bit fractions, four at once, for parallel views.
//!
//! A sample is a factor and an addend of light and a scalar of fifteen bits, eight bytes in all. Voxels become samples by aligned fours, each
//! once for as long as its scanline is in a row buffer, and asks for those that lie behind them; pixels are sampled, looked up and blended by aligned fours, too. What is
//! asked for is told by words of masks, so that no run of pixels or voxels ends a loop.
//!
//! Fractions serve what is looked up as it is: between two slices of voxels, without gradient opacity, and not
//! faded. Where clipping leaves a part of a slab, that pixel's is looked up by itself.

use std::ops::Range;

use super::WORD;
use super::lattice::Unit;
use super::mask::{Mask, first_bits};
use super::samples::{Position, RowBuffer, RowPair};
use super::slabs::{BufferRow, SlabScanline, SlabSource};
use crate::classify::preintegration::ShortSlabTable;
use crate::render::factorization::{Factorization, SlicePlacement};
use crate::render::intermediate::ScanlineMut;
use crate::render::material::{ANY_CODE, ShortLights, ShortShadow};
use crate::render::pixel::{Pixel, first_four, nearest};
use crate::render::simd::prefetch_at;
use crate::render::simd::shorts::{FOUR, Short, ShortLight, Shorts};
use crate::render::simd::wide::Portable;
use crate::render::slab::opacity_ratio;
use crate::volume::gradient::Code;
use crate::volume::scanlines::{Scanlines, four_of};

/// Voxels, and the table that slabs between them are looked up in.
#[derive(Clone, Copy, Debug)]
pub struct ShortSlabs<'a, T, D> {
    scanlines: Scanlines<'a, T>,
    /// Normals and what lights them, if anything does.
    light: Option<(Scanlines<'a, u16>, &'a [ShortLight; ANY_CODE])>,
    shadow: D,
    /// Slices are walked from the last to the first.
    reversed: bool,
    table: &'a ShortSlabTable,
}

impl<'a, T: Code, D: ShortShadow> ShortSlabs<'a, T, D> {
    /// `scanlines` and normals are those of the factorization's principal axis.
    pub fn new(
        scanlines: Scanlines<'a, T>,
        light: Option<(Scanlines<'a, u16>, &'a ShortLights)>,
        shadow: D,
        factorization: &Factorization,
        table: &'a ShortSlabTable,
    ) -> Self {
        let light = light.map(|(normals, lights)| (normals, lights.by_any_code()));
        Self { scanlines, light, shadow, reversed: factorization.reversed, table }
    }

    /// Scanline `j` of slice `k`.
    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Scanline<'a, T> {
        (self.scanlines.row(j, k), self.light.map_or(&[], |(normals, _)| normals.row(j, k)))
    }

    /// Samples of four voxels from (i, j, k) on, of their scanline, its last one repeated past its end; in place of a position there is a scalar.
    #[inline(always)]
    fn four<W: Shorts>(&self, (codes, normals): Scanline<'_, T>, [i, j, k]: [usize; 3], out: &mut [Short; FOUR]) {
        let four = four_of(codes, i);
        let mut codes = [0; FOUR];
        for n in 0..FOUR {
            codes[n] = four[n].into();
        }
        let mut lights = [[0; 2]; FOUR];
        if let Some((_, table)) = self.light {
            let normals = four_of(normals, i);
            for n in 0..FOUR {
                lights[n] = table[usize::from(normals[n])];
            }
            lights = self.shadow.four::<W, false>(lights, normals, [i, j, k], u64::MAX);
        }
        W::voxels(codes, lights, self.table.axis().scalars(), out);
    }

    /// The sample at a pixel, slices being continued by their borders.
    pub fn sample_at(&self, position: &Position<SlicePlacement>, pixel: [usize; 2]) -> Short {
        let SlicePlacement { first, fraction } = position.placement;
        let last = self.scanlines.dims().map(|n| n - 1);
        let [i, j] =
            [0, 1].map(|axis| [pixel[axis], pixel[axis] + 1].map(|at| at.saturating_sub(first[axis]).min(last[axis])));
        let voxel = |i: usize, j: usize| {
            let mut four = [Short::CLEAR; FOUR];
            self.four::<Portable>(self.scanline(j, position.near), [i, j, position.near], &mut four);
            four[0]
        };
        let row = |j: usize| i.map(|i| voxel(i, j));
        let sample = Short::between(row(j[0]), row(j[1]), fraction.map(part));
        self.table.axis().positions().map_or(sample, |positions| sample.placed(positions))
    }

    /// Reads those voxels of scanline `j` of slice `k` that `row`, which is for that scanline, lacks: the fours that are `asked` for.
    #[inline(always)]
    fn fetch<W: Shorts>(&self, row: &mut Row, j: usize, k: usize, asked: &[u64]) {
        let [length, _, slices] = self.scanlines.dims();
        let next = if self.reversed { k.saturating_sub(1) } else { (k + 1).min(slices - 1) };
        let (scanline, (codes, normals)) = (self.scanline(j, k), self.scanline(j, next));
        for (word, (asked, there)) in asked.iter().zip(&mut row.there).enumerate() {
            let mut left = asked & !*there;
            *there |= left;
            while left != 0 {
                let i = word * WORD + left.trailing_zeros() as usize;
                left &= left - 1;
                prefetch_at(codes, i);
                prefetch_at(normals, i);
                let Some(out) = row.voxels[i + BESIDE..].first_chunk_mut() else {
                    unreachable!("there are voxels for whole words")
                };
                self.four::<W>(scanline, [i, j, k], out);
                if i == 0 {
                    row.voxels[BESIDE - 1] = row.voxels[BESIDE];
                }
                if i + FOUR >= length {
                    row.voxels[BESIDE + length] = row.voxels[BESIDE + length - 1];
                }
            }
        }
    }

    /// Samples some pixels of a word, each between the rows' voxels of the same number and the one after.
    #[inline(always)]
    fn sample_word<W: Shorts, const SOME: bool>(
        &self,
        [upper, lower]: [&[Short; WORD + 1]; 2],
        fractions: [i16; 2],
        pixels: u64,
        out: &mut [Short; WORD],
    ) {
        let mut left = pixels;
        while left != 0 {
            let at = first_four(left);
            left &= !(0b1111 << at);
            let (Some(upper), Some(lower), Some(out)) =
                (upper[at..].first_chunk(), lower[at..].first_chunk(), out[at..].first_chunk_mut::<FOUR>())
            else {
                unreachable!("a four ends in its word")
            };
            let before = *out;
            W::between([upper, lower], fractions, out);
            if let Some(positions) = self.table.axis().positions() {
                W::place(out, positions);
            }
            if SOME {
                for n in 0..FOUR {
                    out[n] = if pixels >> (at + n) & 1 == 1 { out[n] } else { before[n] };
                }
            }
        }
    }

    /// Looks up and blends some pixels of a word. Gives the mask of those of them (or some beside them) that are done.
    #[inline(always)]
    fn blend_word<W: Shorts, const LIT: bool>(
        &self,
        pixels: &mut [Short; WORD],
        [front, back]: [&[Short; WORD]; 2],
        limit: i16,
        touched: u64,
    ) -> u64 {
        let (slabs, mut left, mut done) = (self.table.slabs(), touched, 0);
        while left != 0 {
            let at = first_four(left);
            left &= !(0b1111 << at);
            let (Some(pixels), Some(front), Some(back)) =
                (pixels[at..].first_chunk_mut::<FOUR>(), front[at..].first_chunk(), back[at..].first_chunk())
            else {
                unreachable!("a four ends in its word")
            };
            done |= W::blend_slabs::<LIT>(slabs, [front, back], pixels, limit, touched >> at) << at;
        }
        done
    }
}

/// Codes and normals; no normals where nothing is lit.
type Scanline<'a, T> = (&'a [T], &'a [u16]);

/// Part of the way from a voxel to the next, in 32768ths.
#[inline(always)]
fn part(fraction: f32) -> i16 {
    nearest((fraction * 32768.0).min(32767.0))
}

/// So many samples before a voxel scanline's first and behind its last belong to the words of its first and last pixels.
const BESIDE: usize = WORD;

/// A voxel scanline as samples. Voxel i is at i + 64: the scanline's ends are repeated once.
#[derive(Debug)]
pub struct Row {
    j: Option<usize>,
    voxels: Vec<Short>,
    /// The first bits of the aligned fours of voxels that are there.
    there: Vec<u64>,
}

impl RowBuffer for Row {
    fn new(length: usize) -> Self {
        let words = length.div_ceil(WORD).next_multiple_of(4);
        Self { j: None, voxels: vec![Short::CLEAR; words * WORD + 2 * BESIDE], there: vec![0; words] }
    }

    #[inline(always)]
    fn scanline(&mut self) -> &mut Option<usize> {
        &mut self.j
    }

    #[inline(always)]
    fn forget(&mut self) {
        for there in self.there.as_chunks_mut::<4>().0 {
            *there = [0; 4];
        }
    }
}

/// Row buffers for slices of samples.
#[derive(Debug)]
pub struct ShortRows {
    pair: RowPair<Row>,
    /// Which aligned fours of voxels pixels ask for.
    asked: Vec<u64>,
    /// As many bits as a scanline has voxels.
    within: Vec<u64>,
}

impl<T: Code, D: ShortShadow> SlabSource<Unit> for ShortSlabs<'_, T, D> {
    type Pixel = Short;
    type Sample = Short;
    type Rows = ShortRows;

    fn rows(&self, factorization: &Factorization) -> ShortRows {
        let length = factorization.dims[0];
        let within = first_bits(length);
        ShortRows { pair: RowPair::new(length), asked: vec![0; within.len()], within }
    }

    #[inline(always)]
    fn sample<W: Shorts, const SOME: bool>(
        &self,
        ShortRows { pair, asked, within }: &mut ShortRows,
        position: &Position<SlicePlacement>,
        (_, v): (&Range<usize>, usize),
        mask: &Mask,
        (out, base): (&mut [Short], isize),
    ) {
        let SlicePlacement { first, fraction } = position.placement;
        let (k, [_, height, _]) = (position.near, self.scanlines.dims());
        // From -1: slices are continued by their borders.
        let upper = (v + 1).saturating_sub(first[1] + 1).min(height - 1);
        let lower = if fraction[1] > 0.0 { (v + 1 - first[1]).min(height - 1) } else { upper };
        let at = pair.enter(upper, lower, k);
        mask.around(first[0], within, asked);
        for (at, j) in at.into_iter().zip([upper, lower]) {
            self.fetch::<W>(&mut pair.rows[at], j, k, asked);
        }
        let fractions = fraction.map(part);
        let rows = at.map(|at| &pair.rows[at].voxels[..]);
        for (word, &pixels) in mask.words().iter().enumerate() {
            if pixels == 0 {
                continue;
            }
            let first_pixel = word * WORD;
            let start = first_pixel + BESIDE - first[0];
            let (Some(upper), Some(lower), Some(out)) = (
                rows[0][start..].first_chunk(),
                rows[1][start..].first_chunk(),
                out[(first_pixel as isize - base) as usize..].first_chunk_mut(),
            ) else {
                unreachable!("rows and buffers go on for a word")
            };
            self.sample_word::<W, SOME>([upper, lower], fractions, pixels, out);
        }
    }

    #[inline(always)]
    fn blend<W: Shorts>(
        &self,
        scanline: &mut ScanlineMut<'_, Short>,
        at: &SlabScanline<'_, SlicePlacement>,
        pixels: &Mask,
        samples: &BufferRow<'_, Short>,
    ) {
        let &SlabScanline { factorization, slab, v, clipped, opaque, .. } = at;
        let limit = Short::limit(opaque);
        let is_cut = clipped.is_any() && clipped.cuts_any();
        for (word, &touched) in pixels.words().iter().enumerate() {
            if touched == 0 {
                continue;
            }
            let first = word * WORD;
            let [front, back] = samples.from(first);
            let mut by_itself = if is_cut { touched & clipped.cut_from(first) } else { 0 };
            let fours = touched & !by_itself;
            let (Some(pixels), Some(front), Some(back)) =
                (scanline.pixels[first..].first_chunk_mut(), front.first_chunk(), back.first_chunk())
            else {
                unreachable!("scanlines and buffers go on for a word")
            };
            let mut done = match self.light {
                Some(_) => self.blend_word::<W, true>(pixels, [front, back], limit, fours),
                None => self.blend_word::<W, false>(pixels, [front, back], limit, fours),
            };
            while by_itself != 0 {
                let n = by_itself.trailing_zeros() as usize;
                by_itself &= by_itself - 1;
                let left = Some(factorization.left(first + n, v, slab.ends));
                pixels[n] = pixels[n].over(self.slab(front[n], back[n], 1.0, left));
                done |= u64::from(pixels[n].is_opaque(limit)) << n;
            }
            scanline.non_opaque[word] &= !done;
        }
    }

    fn slab(&self, front: Short, back: Short, _: f32, left: Option<impl Iterator<Item = [f32; 2]>>) -> Short {
        let slab = |front: Short, back: Short| match self.light {
            Some(_) => front.slab::<true>(self.table.slabs(), back),
            None => front.slab::<false>(self.table.slabs(), back),
        };
        let Some(left) = left else { return slab(front, back) };
        left.fold(Short::CLEAR, |before, [enter, leave]| {
            let [from, to] = [enter, leave].map(|at| front.towards(back, part(at)));
            let slab = slab(from, to);
            before.over(Pixel::times(slab, opacity_ratio(Pixel::opacity(slab), leave - enter)))
        })
    }
}
