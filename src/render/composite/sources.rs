//! Where the kernel of voxels gets them from: run-length encoded, or as the volume has them.
//!
//! Both give the same voxels without looking at transparent ones, the first from an encoding (Lacroute and Levoy 1994,
//! section 3.1), the second with little that has been prepared for the transfer function (section 3.3): it knows which voxels are
//! visible, and reads code and normal of each where the volume has them. Frames of either are the same bit for bit, so that one stands in
//! for the other as long as there is no encoding ("switch modes").

use super::WORD;
use super::samples::VoxelRows;
use crate::classify::CodeTables;
use crate::classify::rle::{AxisEncoding, Scanline, Voxel};
use crate::classify::visible::AxisVisible;
use crate::render::factorization::Factorization;
use crate::render::material::{SliceShader, VoxelWord, before};
use crate::render::simd::prefetch_at;
use crate::render::simd::shorts::FOUR;
use crate::volume::gradient::Code;
use crate::volume::scanlines::Scanlines;

/// Voxels by scanline.
pub trait VoxelSource: Copy + Send + Sync {
    /// A scanline, found.
    type Scanline: Copy;

    /// Where voxels are that will be asked for.
    type Ahead: Copy;

    /// Where the marked voxels of a word of a scanline are.
    type Word: Copy;

    /// True where these are stored one after the other, false where they are among all of the scanline's.
    const PACKED: bool;

    /// Scanline `j` of slice `k`.
    fn scanline(&self, j: usize, k: usize) -> Self::Scanline;

    /// Where the voxels of scanline `j` of slice `k` begin, the one that is walked next.
    fn ahead(&self, j: usize, k: usize) -> Self::Ahead;

    /// Asks for what tells where scanline `j` of slice `k` is.
    fn prefetch_place(&self, j: usize, k: usize);

    /// Which of up to 64 scanlines from `j` on of slice `k`, as far as there are any, have a mark; a bit each.
    fn shown(&self, j: usize, count: usize, k: usize) -> u64;

    /// The bits of voxels that may be drawn, and [`MORE`](crate::classify::rle::MORE) words.
    fn marks<'s>(&self, scanline: &'s Self::Scanline) -> &'s [u64];

    /// Where the voxels of a word of a scanline are, and those of the same scanline of the slice `ahead`.
    fn word(&self, scanline: &Self::Scanline, word: usize, ahead: Self::Ahead) -> Self::Word;

    /// Four voxels, from voxel `at` of a word on: where they are stored one after the other those of them that are marked and then any. Asks for
    /// those that lie behind them.
    fn four(&self, word: &VoxelWord<Self::Word>, at: usize) -> [Voxel; FOUR];

    /// Voxels of a word one after the other, at least those that are marked and `asked` for; the marks of these voxels; and their gradient
    /// opacity (255 = 1, 0 where a voxel is not drawn), where that plays a part.
    fn packed<'s, M: SliceShader>(
        &'s self,
        word: &'s VoxelWord<Self::Word>,
        asked: u64,
        gathered: &'s mut Gathered,
    ) -> (u64, &'s [Voxel], &'s [u8]);

    /// Voxel (i, j, k) and its gradient opacity (255 = 1), the plain way; `None` where it is not drawn.
    fn voxel(&self, at: [usize; 3]) -> Option<(Voxel, u8)>;
}

/// Voxels of a word that are stored one after the other.
#[derive(Clone, Copy, Debug)]
pub struct StoredWord<'a> {
    /// And at least [`MORE`](crate::classify::rle::MORE) of anything.
    voxels: &'a [Voxel],
    /// Their gradient opacity.
    factors: &'a [u8],
    /// So many of the scanline are before them.
    before: usize,
    ahead: &'a [Voxel],
}

/// Voxels of a word that are not stored one after the other.
#[derive(Debug)]
pub struct Gathered {
    voxels: [Voxel; WORD],
    factors: [u8; WORD],
}

impl Default for Gathered {
    fn default() -> Self {
        Self { voxels: [Voxel { code: 0, normal: 0 }; WORD], factors: [u8::MAX; WORD] }
    }
}

impl<'a> VoxelSource for AxisEncoding<'a> {
    type Scanline = Scanline<'a>;
    type Ahead = &'a [Voxel];
    type Word = StoredWord<'a>;
    const PACKED: bool = true;

    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Scanline<'a> {
        AxisEncoding::scanline(self, j, k)
    }

    #[inline(always)]
    fn ahead(&self, j: usize, k: usize) -> &'a [Voxel] {
        let (voxels, _) = AxisEncoding::scanline(self, j, k).from(0);
        voxels
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
    fn word(&self, scanline: &Scanline<'a>, word: usize, ahead: &'a [Voxel]) -> StoredWord<'a> {
        let before = scanline.before(word);
        let (voxels, factors) = scanline.from(before);
        StoredWord { voxels, factors, before, ahead }
    }

    #[inline(always)]
    fn four(&self, word: &VoxelWord<Self::Word>, at: usize) -> [Voxel; FOUR] {
        let (before, StoredWord { voxels, ahead, before: of_scanline, .. }) = (before(word.marks, at), word.voxels);
        // There are about as many before them: whatever shows here does so a slice on.
        prefetch_at(ahead, of_scanline + before);
        let Some(four) = voxels.get(before..before + FOUR).and_then(<[_]>::first_chunk) else {
            unreachable!("there are more than are drawn")
        };
        *four
    }

    #[inline(always)]
    fn packed<'s, M: SliceShader>(
        &'s self,
        word: &'s VoxelWord<Self::Word>,
        _: u64,
        _: &'s mut Gathered,
    ) -> (u64, &'s [Voxel], &'s [u8]) {
        let StoredWord { voxels, factors, before, ahead } = word.voxels;
        prefetch_at(ahead, before);
        (word.marks, voxels, factors)
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let scanline = AxisEncoding::scanline(self, j, k);
        let (marks, at) = (scanline.marks(), i % WORD);
        let word = *marks.get(i / WORD)?;
        if word >> at & 1 == 0 {
            return None;
        }
        let ((voxels, factors), before) = (scanline.word(i / WORD), before(word, at));
        Some((voxels[before], factors.get(before).copied().unwrap_or(u8::MAX)))
    }
}

/// What else there is of voxels, colours or labels say, as one principal axis walks them. There is no copy with scanlines along y: their
/// voxels are cache lines apart, but the same lines serve the next slices.
#[derive(Clone, Copy, Debug)]
pub struct Stored<'a, T> {
    codes: &'a [T],
    /// Codes from a voxel to the next along i, j, k.
    strides: [usize; 3],
    /// The last voxel of a scanline.
    last: usize,
    /// Slices are walked from the last to the first.
    reversed: bool,
}

impl<'a, T: Copy + Default> Stored<'a, T> {
    /// `codes` are in the volume's order, x fastest.
    pub fn new(codes: &'a [T], factorization: &Factorization) -> Self {
        Self {
            codes,
            strides: factorization.strides(factorization.dims),
            last: factorization.dims[0] - 1,
            reversed: factorization.reversed,
        }
    }

    /// That of voxel (i, j, k), past the scanline's end that of its last voxel.
    #[inline(always)]
    pub fn at(&self, [i, j, k]: [usize; 3]) -> T {
        self.codes[i.min(self.last) * self.strides[0] + j * self.strides[1] + k * self.strides[2]]
    }

    /// Those of four voxels from (i, j, k) on. Asks for the same ones of the slice that is walked next.
    #[inline(always)]
    pub fn four(&self, [i, j, k]: [usize; 3]) -> [T; 4] {
        let from = j * self.strides[1] + k * self.strides[2];
        let row = &self.codes[from..];
        if self.strides[0] == 1 {
            let next = if self.reversed { from.wrapping_sub(self.strides[2]) } else { from + self.strides[2] };
            prefetch_at(self.codes, next.wrapping_add(i));
            if let Some(four) = row[..=self.last].get(i..).and_then(<[T]>::first_chunk) {
                return *four;
            }
        }
        let mut four = [T::default(); 4];
        for (n, code) in four.iter_mut().enumerate() {
            *code = row[(i + n).min(self.last) * self.strides[0]];
        }
        four
    }
}

/// Unencoded scanlines, and which of their voxels are visible.
#[derive(Clone, Copy, Debug)]
pub struct Unencoded<'a, T> {
    pub voxels: VoxelRows<'a, T>,
    pub normals: Scanlines<'a, u16>,
    pub visible: AxisVisible<'a>,
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
    /// The marks, and what follows them.
    type Scanline = &'a [u64];
    /// Codes and normals.
    type Ahead = (&'a [T], &'a [u16]);
    /// The voxels themselves are found by where they are.
    type Word = Self::Ahead;
    const PACKED: bool = false;

    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Self::Scanline {
        self.visible.marks.scanline_and_more(j, k)
    }

    #[inline(always)]
    fn ahead(&self, j: usize, k: usize) -> Self::Ahead {
        (self.voxels.row(j, k), self.normals.row(j, k))
    }

    #[inline(always)]
    fn prefetch_place(&self, j: usize, k: usize) {
        self.visible.marks.prefetch(j, k);
    }

    #[inline(always)]
    fn shown(&self, j: usize, count: usize, k: usize) -> u64 {
        self.visible.shown.from(j, count, k)
    }

    #[inline(always)]
    fn marks<'s>(&self, marks: &'s Self::Scanline) -> &'s [u64] {
        marks
    }

    #[inline(always)]
    fn word(&self, _: &Self::Scanline, _: usize, ahead: Self::Ahead) -> Self::Word {
        ahead
    }

    #[inline(always)]
    fn four(&self, word: &VoxelWord<Self::Word>, at: usize) -> [Voxel; FOUR] {
        let ([i, j, k], (codes, normals)) = (word.at, word.voxels);
        prefetch_at(codes, i + at);
        prefetch_at(normals, i + at);
        let codes = self.voxels.four([i + at, j, k]);
        let normals = self.normals.four([i + at, j, k]);
        let mut four = [Voxel { code: 0, normal: 0 }; FOUR];
        for n in 0..FOUR {
            four[n] = Voxel { code: codes[n].into(), normal: normals[n] };
        }
        four
    }

    #[inline(always)]
    fn packed<'s, M: SliceShader>(
        &'s self,
        word: &'s VoxelWord<Self::Word>,
        asked: u64,
        gathered: &'s mut Gathered,
    ) -> (u64, &'s [Voxel], &'s [u8]) {
        let ([first, j, k], marks, (codes, normals)) = (word.at, word.marks & asked, word.voxels);
        prefetch_at(codes, first);
        prefetch_at(normals, first);
        let (codes, normals) = (self.voxels.row(j, k), self.normals.row(j, k));
        let (mut left, mut count) = (marks, 0);
        while left != 0 {
            let i = first + left.trailing_zeros() as usize;
            left &= left - 1;
            let code = codes[i].into();
            gathered.voxels[count] = Voxel { code, normal: if M::LIT { normals[i] } else { 0 } };
            if M::FACTORED {
                gathered.factors[count] = self.factor(code, [i, j, k]);
            }
            count += 1;
        }
        (marks, &gathered.voxels, &gathered.factors)
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let code = self.voxels.four([i, j, k])[0].into();
        let tau = self.tables.extinction[usize::from(code)];
        let factor = if self.voxels.has_gradient_opacity() { self.voxels.gradient_factor([i, j, k]) } else { u8::MAX };
        let drawn = self.tables.is_visible(tau, factor);
        drawn.then(|| (Voxel { code, normal: self.voxels.normal([i, j, k]) }, factor))
    }
}
