//! Where the kernel of voxels gets them from: run-length encoded, or unencoded and classified as they
//! are drawn.
//!
//! Both give the same voxels, the first without looking at transparent ones (Lacroute and Levoy 1994,
//! section 3.1), the second without having been prepared for the transfer function (section 3.3): it marks all
//! of a leaf's voxels where the leaf may hold something to draw, and asks each that a pixel touches
//! whether it is transparent. Frames of either are the same bit for bit, so that one stands in for the other
//! as long as there is no encoding ("switch modes").

use super::occupied::LeafRows;
use super::rows::Row;
use super::samples::{BLOCK, VoxelRows};
use super::touched::{Open, Touched};
use super::{WORD, run_mask};
use crate::classify::CodeTables;
use crate::classify::rle::{AxisEncoding, Scanline, Voxel};
use crate::render::factorization::Factorization;
use crate::render::material::SliceShader;
use crate::render::simd::prefetch;
use crate::render::simd::shorts::Shorts;
use crate::render::simd::wide::Portable;
use crate::volume::gradient::Code;

/// Voxels by scanline.
pub trait VoxelSource: Copy + Send + Sync {
    /// A scanline, found.
    type Scanline: Copy;

    /// True where marked voxels may turn out to be transparent when [`Self::classify`] is asked.
    const CLASSIFIES: bool;

    /// Scanline `j` of slice `k`.
    fn scanline(&self, j: usize, k: usize) -> Self::Scanline;

    /// Asks for what scanline `j` of slice `k` will need.
    fn prefetch(&self, j: usize, k: usize);

    /// Asks for what tells where scanline `j` of slice `k` is.
    fn prefetch_place(&self, j: usize, k: usize);

    /// True where nothing would be marked.
    fn is_empty(&self, scanline: &Self::Scanline) -> bool;

    /// Which of up to 64 scanlines from `j` on of slice `k`, as far as there are any, are not empty; a bit each.
    fn shown(&self, j: usize, count: usize, k: usize) -> u64;

    /// True where an open pixel touches a voxel that may be drawn.
    fn touches(&self, scanline: &Self::Scanline, open: &Open<'_>) -> bool;

    /// Adds the open pixels that touch drawn voxels to `touched`, and shades the voxels that they touch (or some more) into a row
    /// that is to be scanline j of slice k, unless they are there. A row for which nothing is touched may go on being another.
    fn touch<W: Shorts, M: SliceShader>(
        &self,
        scanline: &Self::Scanline,
        open: &Open<'_>,
        touched: &mut Touched,
        row: (&mut Row<M::Pixel>, [usize; 2]),
        material: M,
    );

    /// Sets the bits of voxels that may be drawn.
    fn mark(&self, scanline: &Self::Scanline, marked: &mut [u64]);

    /// Which of the eight voxels of a block are drawn, a bit each.
    fn classify(&self, scanline: &Self::Scanline, block: usize) -> u64;

    /// Shades the voxels that are `asked` for and not `shaded` yet (or some more) into a row of them, which
    /// is zero elsewhere. Voxels that are not drawn come out as zero.
    fn shade<M: SliceShader>(
        &self,
        scanline: &Self::Scanline,
        asked: &[u64],
        row: ShadedRow<'_, M::Pixel>,
        material: M,
    );

    /// Voxel (i, j, k) and its gradient opacity (255 = 1), the plain way; `None` where it is not drawn.
    fn voxel(&self, at: [usize; 3]) -> Option<(Voxel, u8)>;
}

/// A scanline's shaded voxels.
#[derive(Debug)]
pub struct ShadedRow<'a, P> {
    /// Premultiplied colour and opacity by voxel.
    pub voxels: &'a mut [P],
    /// Voxels that are there.
    pub shaded: &'a mut [u64],
    /// The scanline's j and k.
    pub at: [usize; 2],
}

impl<'a> VoxelSource for AxisEncoding<'a> {
    type Scanline = Scanline<'a>;
    const CLASSIFIES: bool = false;

    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Scanline<'a> {
        AxisEncoding::scanline(self, j, k)
    }

    #[inline(always)]
    fn prefetch(&self, j: usize, k: usize) {
        let scanline = AxisEncoding::scanline(self, j, k);
        prefetch(scanline.runs);
        prefetch(scanline.voxels);
    }

    #[inline(always)]
    fn prefetch_place(&self, j: usize, k: usize) {
        prefetch(self.place(j, k));
    }

    #[inline(always)]
    fn is_empty(&self, scanline: &Scanline<'a>) -> bool {
        scanline.runs.is_empty()
    }

    #[inline(always)]
    fn shown(&self, j: usize, count: usize, k: usize) -> u64 {
        AxisEncoding::shown(self, j, count, k)
    }

    #[inline(always)]
    fn touches(&self, scanline: &Scanline<'a>, open: &Open<'_>) -> bool {
        scanline.runs.iter().any(|run| open.around(run.start.into(), run.length.into()).pixels != 0)
    }

    /// Per run the stretch from the first to the last voxel that is touched and not there yet.
    #[inline(always)]
    fn touch<W: Shorts, M: SliceShader>(
        &self,
        scanline: &Scanline<'a>,
        open: &Open<'_>,
        touched: &mut Touched,
        (row, at): (&mut Row<M::Pixel>, [usize; 2]),
        material: M,
    ) {
        let mut before = 0;
        for run in scanline.runs {
            let (start, length) = (usize::from(run.start), usize::from(run.length));
            let around = open.around(start, length);
            if around.pixels != 0 {
                row.enter(at[0]);
                touched.add(around.first, around.pixels);
                let shaded = &mut row.shaded[run.word()];
                let missing = around.voxels(length) & !(*shaded >> (start % WORD));
                if missing != 0 {
                    let (from, to) = (missing.trailing_zeros() as usize, WORD - missing.leading_zeros() as usize);
                    *shaded |= run_mask(from, to - from) << (start % WORD);
                    let stored = before + from..before + to;
                    let factors = if M::FACTORED { &scanline.factors[stored.clone()] } else { &[] };
                    let out = &mut row.voxels[start + from..start + to];
                    material.voxels::<W>(&scanline.voxels[stored], factors, [start + from, at[0], at[1]], out);
                }
            }
            before += length;
        }
    }

    #[inline(always)]
    fn mark(&self, scanline: &Scanline<'a>, marked: &mut [u64]) {
        for run in scanline.runs {
            marked[run.word()] |= run.mask();
        }
    }

    #[inline(always)]
    fn classify(&self, _: &Scanline<'a>, _: usize) -> u64 {
        u64::MAX
    }

    /// Per run the stretch from the first to the last voxel that is asked for and not there yet.
    #[inline(always)]
    fn shade<M: SliceShader>(&self, scanline: &Scanline<'a>, asked: &[u64], row: ShadedRow<'_, M::Pixel>, material: M) {
        let mut before = 0;
        for run in scanline.runs {
            let (start, length) = (usize::from(run.start), usize::from(run.length));
            let missing = asked[run.word()] & run.mask() & !row.shaded[run.word()];
            if missing != 0 {
                let first = run.word() * WORD + missing.trailing_zeros() as usize;
                let end = (run.word() + 1) * WORD - missing.leading_zeros() as usize;
                let stored = before + first - start..before + end - start;
                let factors = if M::FACTORED { &scanline.factors[stored.clone()] } else { &[] };
                let [j, k] = row.at;
                let out = &mut row.voxels[first..end];
                material.voxels::<Portable>(&scanline.voxels[stored], factors, [first, j, k], out);
                row.shaded[run.word()] |= run_mask(first % WORD, end - first);
            }
            before += length;
        }
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let scanline = AxisEncoding::scanline(self, j, k);
        let mut before = 0;
        for run in scanline.runs {
            let (start, length) = (usize::from(run.start), usize::from(run.length));
            if (start..start + length).contains(&i) {
                let at = before + i - start;
                return Some((scanline.voxels[at], scanline.factors.get(at).copied().unwrap_or(u8::MAX)));
            }
            before += length;
        }
        None
    }
}

/// The volume's normals or colours as one principal axis walks them. There is no copy with scanlines along y: their
/// voxels are cache lines apart, but the same lines serve the next slices.
#[derive(Clone, Copy, Debug)]
pub struct Stored<'a, T> {
    codes: &'a [T],
    /// Codes from a voxel to the next along i, j, k.
    strides: [usize; 3],
    /// The last voxel of a scanline.
    last: usize,
}

/// Normals by their codes.
pub type StoredNormals<'a> = Stored<'a, u16>;

impl<'a, T: Copy + Default> Stored<'a, T> {
    /// `codes` are in the volume's order, x fastest.
    pub fn new(codes: &'a [T], factorization: &Factorization) -> Self {
        Self { codes, strides: factorization.strides(factorization.dims), last: factorization.dims[0] - 1 }
    }

    /// That of voxel (i, j, k), past the scanline's end that of its last voxel.
    #[inline(always)]
    pub fn at(&self, [i, j, k]: [usize; 3]) -> T {
        self.codes[i.min(self.last) * self.strides[0] + j * self.strides[1] + k * self.strides[2]]
    }

    /// Those of four voxels from (i, j, k) on.
    #[inline(always)]
    pub fn four(&self, [i, j, k]: [usize; 3]) -> [T; 4] {
        let row = &self.codes[j * self.strides[1] + k * self.strides[2]..];
        if self.strides[0] == 1
            && let Some(four) = row[..=self.last].get(i..).and_then(<[T]>::first_chunk)
        {
            return *four;
        }
        let mut four = [T::default(); 4];
        for (n, code) in four.iter_mut().enumerate() {
            *code = row[(i + n).min(self.last) * self.strides[0]];
        }
        four
    }

    /// Asks for `count` voxels from (i, j, k) on, where they lie side by side.
    #[inline(always)]
    pub fn prefetch(&self, [i, j, k]: [usize; 3], count: usize) {
        let start = i + j * self.strides[1] + k * self.strides[2];
        if self.strides[0] == 1
            && let Some(codes) = self.codes.get(start..start + count)
        {
            prefetch(codes);
        }
    }
}

/// Unencoded scanlines, and what octree and summed-area table say of their leaves.
#[derive(Clone, Copy, Debug)]
pub struct Unencoded<'a, T> {
    pub voxels: VoxelRows<'a, T>,
    pub normals: StoredNormals<'a>,
    pub leaves: &'a LeafRows,
    pub tables: &'a CodeTables,
}

impl<T: Code> Unencoded<'_, T> {
    /// The gradient opacity of a voxel, 0 where it is not drawn.
    #[inline(always)]
    fn factor(&self, code: u16, at: [usize; 3]) -> u8 {
        let tau = self.tables.extinction[usize::from(code)];
        if tau > 0.0 {
            let factor = self.voxels.gradient_factor(at);
            if self.tables.is_visible(tau, factor) { factor } else { 0 }
        } else {
            0
        }
    }
}

impl<T: Code> Unencoded<'_, T> {
    /// Shades the eight voxels from (i, j, k) on.
    #[inline(always)]
    fn shade_block<W: Shorts, M: SliceShader>(&self, [i, j, k]: [usize; 3], out: &mut [M::Pixel], material: M) {
        let codes = self.voxels.codes(j, k, i);
        let mut voxels = [Voxel { code: 0, normal: 0 }; BLOCK];
        let mut factors = [u8::MAX; BLOCK];
        for n in 0..BLOCK {
            let at = [i + n, j, k];
            voxels[n] = Voxel { code: codes[n], normal: if M::LIT { self.normals.at(at) } else { 0 } };
            if M::FACTORED {
                factors[n] = self.factor(codes[n], at);
            }
        }
        material.voxels::<W>(&voxels, &factors, [i, j, k], out);
    }
}

impl<'a, T: Code> Unencoded<'a, T> {
    /// Shades the voxels of one word that are asked for and not shaded yet.
    #[inline(always)]
    fn shade_word<W: Shorts, M: SliceShader>(
        &self,
        &(j, k, _): &(usize, usize, &'a [u64]),
        (word, asked): (usize, u64),
        row: ShadedRow<'_, M::Pixel>,
        material: M,
    ) {
        let codes = self.voxels.row(j, k);
        let shaded = &mut row.shaded[word];
        let mut missing = asked & !*shaded;
        *shaded |= missing;
        while missing != 0 {
            let i = word * WORD + missing.trailing_zeros() as usize;
            if M::BLOCKS {
                let first = i / BLOCK * BLOCK;
                missing &= !run_mask(first % WORD, BLOCK);
                *shaded |= run_mask(first % WORD, BLOCK);
                self.shade_block::<W, M>([first, j, k], &mut row.voxels[first..first + BLOCK], material);
            } else {
                missing &= missing - 1;
                let normal = if M::LIT { self.normals.at([i, j, k]) } else { 0 };
                let code = codes[i].into();
                let factor = if M::FACTORED { self.factor(code, [i, j, k]) } else { u8::MAX };
                row.voxels[i] = material.voxel::<W>(Voxel { code, normal }, factor, [i, j, k]);
            }
        }
    }
}

impl<'a, T: Code> VoxelSource for Unencoded<'a, T> {
    /// j, k, and the leaves that it passes.
    type Scanline = (usize, usize, &'a [u64]);
    const CLASSIFIES: bool = true;

    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Self::Scanline {
        (j, k, self.leaves.scanline(j, k))
    }

    /// The codes of leaves that may show something. Normals are asked for too seldom.
    #[inline(always)]
    fn prefetch(&self, j: usize, k: usize) {
        let codes = self.voxels.row(j, k);
        for (word, &bits) in self.leaves.scanline(j, k).iter().enumerate() {
            if bits != 0 {
                let first = word * WORD + bits.trailing_zeros() as usize;
                let end = (word + 1) * WORD - bits.leading_zeros() as usize;
                prefetch(&codes[first..end.min(codes.len())]);
            }
        }
    }

    #[inline(always)]
    fn prefetch_place(&self, _: usize, _: usize) {}

    #[inline(always)]
    fn is_empty(&self, (.., leaves): &Self::Scanline) -> bool {
        leaves.iter().all(|&bits| bits == 0)
    }

    #[inline(always)]
    fn shown(&self, j: usize, count: usize, k: usize) -> u64 {
        let rows = j..(j + count).min(self.leaves.scanlines());
        rows.fold(0, |shown, at| shown | u64::from(!self.is_empty(&self.scanline(at, k))) << (at - j))
    }

    #[inline(always)]
    fn touches(&self, (.., leaves): &Self::Scanline, open: &Open<'_>) -> bool {
        leaves.iter().enumerate().any(|(word, leaves)| leaves & open.word(word).voxels() != 0)
    }

    /// Classifies the touched voxels of leaves that may show something, block by block, and shades those that are drawn.
    #[inline(always)]
    fn touch<W: Shorts, M: SliceShader>(
        &self,
        scanline: &Self::Scanline,
        open: &Open<'_>,
        touched: &mut Touched,
        (row, at): (&mut Row<M::Pixel>, [usize; 2]),
        material: M,
    ) {
        for (word, leaves) in scanline.2.iter().enumerate() {
            let open = open.word(word);
            let asked = leaves & open.voxels();
            if asked == 0 {
                continue;
            }
            if row.enter(at[0]) {
                row.classified.fill(0);
            }
            let mut unknown = asked & !row.classified[word];
            while unknown != 0 {
                let block = unknown.trailing_zeros() as usize / BLOCK;
                let mask = run_mask(block * BLOCK, BLOCK);
                unknown &= !mask;
                row.classified[word] |= mask;
                let drawn = self.classify(scanline, word * WORD / BLOCK + block) << (block * BLOCK);
                row.marked[word] = row.marked[word] & !mask | drawn;
            }
            let drawn = asked & row.marked[word];
            if drawn != 0 {
                open.touch(drawn, touched);
                let row = ShadedRow { voxels: &mut row.voxels, shaded: &mut row.shaded, at };
                self.shade_word::<W, M>(scanline, (word, drawn), row, material);
            }
        }
    }

    #[inline(always)]
    fn mark(&self, (.., leaves): &Self::Scanline, marked: &mut [u64]) {
        for (marked, leaves) in marked.iter_mut().zip(*leaves) {
            *marked |= leaves;
        }
    }

    #[inline(always)]
    fn classify(&self, &(j, k, _): &Self::Scanline, block: usize) -> u64 {
        let first = block * BLOCK;
        let codes = self.voxels.codes(j, k, first);
        let mut drawn = 0;
        for (n, code) in codes.into_iter().enumerate() {
            drawn |= u64::from(self.tables.extinction[usize::from(code)] > 0.0) << n;
        }
        if self.voxels.has_gradient_opacity() {
            let mut asked = drawn;
            while asked != 0 {
                let n = asked.trailing_zeros() as usize;
                asked &= asked - 1;
                if self.factor(codes[n % BLOCK], [first + n, j, k]) == 0 {
                    drawn &= !(1 << n);
                }
            }
        }
        drawn
    }

    /// Voxel by voxel, or block by block where light is.
    #[inline(always)]
    fn shade<M: SliceShader>(
        &self,
        scanline: &Self::Scanline,
        asked: &[u64],
        row: ShadedRow<'_, M::Pixel>,
        material: M,
    ) {
        let ShadedRow { voxels, shaded, at } = row;
        for (word, asked) in asked.iter().enumerate() {
            self.shade_word::<Portable, M>(scanline, (word, *asked), ShadedRow { voxels, shaded, at }, material);
        }
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let code = self.voxels.codes(j, k, i)[0];
        let tau = self.tables.extinction[usize::from(code)];
        let factor = if self.voxels.has_gradient_opacity() { self.voxels.gradient_factor([i, j, k]) } else { u8::MAX };
        let drawn = self.tables.is_visible(tau, factor);
        drawn.then(|| (Voxel { code, normal: self.voxels.normal([i, j, k]) }, factor))
    }
}
