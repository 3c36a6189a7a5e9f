//! Where the kernel of voxels gets them from: run-length encoded, or unencoded and classified as they
//! are drawn.
//!
//! Both give the same voxels, the first without looking at transparent ones (Lacroute and Levoy 1994,
//! section 3.1), the second without having been prepared for the transfer function (section 3.3): it marks all
//! of a leaf's voxels where the leaf may hold something to draw, and asks each that a pixel touches
//! whether it is transparent. Frames of either are the same bit for bit, so that one stands in for the other
//! as long as there is no encoding ("switch modes").

use super::occupied::LeafRows;
use super::samples::{BLOCK, VoxelRows};
use super::{WORD, below};
use crate::classify::CodeTables;
use crate::classify::rle::{AxisEncoding, MORE, Scanline, Voxel};
use crate::render::factorization::Factorization;
use crate::render::material::{SliceShader, VoxelWord};
use crate::render::simd::prefetch;
use crate::render::simd::shorts::Shorts;
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

    /// Which of up to 64 scanlines from `j` on of slice `k`, as far as there are any, have a mark; a bit each.
    fn shown(&self, j: usize, count: usize, k: usize) -> u64;

    /// The bits of voxels that may be drawn, and [`MORE`] words.
    fn marks<'s>(&self, scanline: &'s Self::Scanline) -> &'s [u64];

    /// Which of the eight voxels of a block are drawn, a bit each.
    fn classify(&self, scanline: &Self::Scanline, block: usize) -> u64;

    /// Shades voxels of a word of scanline j of slice k: every aligned four whose first bit is `asked` for. Those that are not in the word's
    /// `marks` come out as zero.
    fn shade<W: Shorts, M: SliceShader>(
        &self,
        scanline: &Self::Scanline,
        word_and_marks: (usize, u64),
        asked: u64,
        out: &mut [M::Pixel; WORD],
        j_and_k: [usize; 2],
        material: M,
    );

    /// Voxel (i, j, k) and its gradient opacity (255 = 1), the plain way; `None` where it is not drawn.
    fn voxel(&self, at: [usize; 3]) -> Option<(Voxel, u8)>;
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
        prefetch(scanline.voxels());
    }

    #[inline(always)]
    fn prefetch_place(&self, j: usize, k: usize) {
        self.prefetch_marks(j, k);
    }

    #[inline(always)]
    fn shown(&self, j: usize, count: usize, k: usize) -> u64 {
        AxisEncoding::shown(self, j, count, k)
    }

    #[inline(always)]
    fn marks<'s>(&self, scanline: &'s Scanline<'a>) -> &'s [u64] {
        scanline.marks_and_more()
    }

    #[inline(always)]
    fn classify(&self, _: &Scanline<'a>, _: usize) -> u64 {
        u64::MAX
    }

    #[inline(always)]
    fn shade<W: Shorts, M: SliceShader>(
        &self,
        scanline: &Scanline<'a>,
        (word, marks): (usize, u64),
        asked: u64,
        out: &mut [M::Pixel; WORD],
        [j, k]: [usize; 2],
        material: M,
    ) {
        let (voxels, factors) = scanline.word(word);
        material.word::<W>(&VoxelWord { marks, voxels, factors, at: [word * WORD, j, k] }, asked, out);
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let scanline = AxisEncoding::scanline(self, j, k);
        let (marks, at) = (scanline.marks(), i % WORD);
        let word = *marks.get(i / WORD)?;
        if word >> at & 1 == 0 {
            return None;
        }
        let ((voxels, factors), before) = (scanline.word(i / WORD), (word & ((1 << at) - 1)).count_ones() as usize);
        Some((voxels[before], factors.get(before).copied().unwrap_or(u8::MAX)))
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

impl<'a, T: Code> VoxelSource for Unencoded<'a, T> {
    /// j, k, and the leaves that it passes, and what follows them.
    type Scanline = (usize, usize, &'a [u64]);
    const CLASSIFIES: bool = true;

    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Self::Scanline {
        (j, k, self.leaves.scanline_and_more(j, k))
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
    fn shown(&self, j: usize, count: usize, k: usize) -> u64 {
        let rows = j..(j + count).min(self.leaves.scanlines());
        let is_shown = |j: usize| self.leaves.scanline(j, k).iter().any(|&bits| bits != 0);
        rows.fold(0, |shown, at| shown | u64::from(is_shown(at)) << (at - j))
    }

    #[inline(always)]
    fn marks<'s>(&self, (.., leaves): &'s Self::Scanline) -> &'s [u64] {
        leaves
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

    #[inline(always)]
    fn shade<W: Shorts, M: SliceShader>(
        &self,
        _: &Self::Scanline,
        (word, marks): (usize, u64),
        asked: u64,
        out: &mut [M::Pixel; WORD],
        [j, k]: [usize; 2],
        material: M,
    ) {
        let codes = self.voxels.row(j, k);
        // All of each four, as if they were encoded.
        let marks = marks & (asked * 0b1111) & below(codes.len(), word);
        let mut voxels = [Voxel { code: 0, normal: 0 }; WORD + MORE];
        let mut factors = [u8::MAX; WORD];
        let (mut left, mut count) = (marks, 0);
        while left != 0 {
            let i = word * WORD + left.trailing_zeros() as usize;
            left &= left - 1;
            let code = codes[i].into();
            voxels[count] = Voxel { code, normal: if M::LIT { self.normals.at([i, j, k]) } else { 0 } };
            if M::FACTORED {
                factors[count] = self.factor(code, [i, j, k]);
            }
            count += 1;
        }
        let voxels = VoxelWord { marks, voxels: &voxels, factors: &factors, at: [word * WORD, j, k] };
        material.word::<W>(&voxels, asked, out);
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let code = self.voxels.codes(j, k, i)[0];
        let tau = self.tables.extinction[usize::from(code)];
        let factor = if self.voxels.has_gradient_opacity() { self.voxels.gradient_factor([i, j, k]) } else { u8::MAX };
        let drawn = self.tables.is_visible(tau, factor);
        drawn.then(|| (Voxel { code, normal: self.voxels.normal([i, j, k]) }, factor))
    }
}
