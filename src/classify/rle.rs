//! The run-length encoded volume: for each voxel scanline its runs of non-transparent voxels and
//! those voxels, nothing else (Lacroute and Levoy 1994, section 3.1).
//!
//! A frame walks scanlines that are perpendicular to the principal axis, so each of the three axes
//! needs an encoding whose scanlines run along another axis. Two stored orders are enough for the
//! three: scanlines along x serve the principal axes y and z, scanlines along y serve x. They are
//! kept by planes of constant z:
//!
//! | principal axis | i | j | k | order | scanline (j, k) is |
//! | --- | --- | --- | --- | --- | --- |
//! | z | x | y | z | along x | plane k, row j |
//! | y | x | z | y | along x | plane j, row k |
//! | x | y | z | x | along y | plane j, row k |
//!
//! The runs of 64 voxels are kept as the bits of a machine word, as those of cells are ([`super::cells`]): a word is intersected with the
//! pixels that are not opaque yet whatever runs it holds, and the voxels before one are counted in an instruction. They are the marks of
//! the [visible voxels](super::visible), and shared with the classification unless a gradient opacity leaves fewer.
//!
//! How the encodings are made: `rle/encode.rs`.

mod encode;

use std::sync::Arc;

use bytemuck::zeroed_vec;

pub use super::marks::MORE;
use super::tables::CodeTables;
use super::transfer::TransferFunction;
use super::visible::{AxisVisible, Visible};
use crate::simd::prefetch_at;
use crate::volume::PreparedVolume;

/// What a frame needs of a non-transparent voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Voxel {
    /// The scalar's code.
    pub code: u16,
    /// The normal's code.
    pub normal: u16,
}

/// One encoded scanline.
#[derive(Clone, Copy, Debug)]
pub struct Scanline<'a> {
    /// And more.
    marks: &'a [u64],
    words: usize,
    plane: &'a Plane,
    row: usize,
}

impl<'a> Scanline<'a> {
    /// A bit for each voxel, set where it is not transparent.
    #[inline(always)]
    pub fn marks(&self) -> &'a [u64] {
        &self.marks[..self.words]
    }

    /// The same and what follows: at least [`MORE`] words.
    #[inline(always)]
    pub fn marks_and_more(&self) -> &'a [u64] {
        self.marks
    }

    /// The voxels of word `word` of the marks and what follows, at least [`MORE`] of them; and their gradient opacity, 255 = 1, or nothing where it
    /// plays no part.
    #[inline(always)]
    pub fn word(&self, word: usize) -> (&'a [Voxel], &'a [u8]) {
        self.from(self.before(word))
    }

    /// The same of the word with so many voxels of the scanline before it.
    #[inline(always)]
    pub fn from(&self, before: usize) -> (&'a [Voxel], &'a [u8]) {
        let first = self.plane.rows[self.row] as usize + before;
        (&self.plane.voxels[first..], self.plane.factors.get(first..).unwrap_or_default())
    }

    /// How many voxels are not transparent before word `word`.
    #[inline(always)]
    pub fn before(&self, word: usize) -> usize {
        let mut before = 0;
        for marks in &self.marks()[..word] {
            before += marks.count_ones() as usize;
        }
        before
    }
}

/// The voxels of one plane's scanlines.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plane {
    /// The first voxel of every row, and past the last.
    rows: Vec<u32>,
    /// By row, and [`MORE`] that are in none.
    voxels: Vec<Voxel>,
    factors: Vec<u8>,
}

impl Plane {
    /// Of rows of so many words of `marks`. The voxels, as many as marks, are given afterwards.
    pub(super) fn of_marks(marks: &[u64], words: usize) -> Self {
        let mut rows = Vec::with_capacity(marks.len() / words + 1);
        rows.push(0);
        let mut voxels = 0;
        for row in marks.chunks_exact(words) {
            voxels += row.iter().map(|word| word.count_ones()).sum::<u32>();
            rows.push(voxels);
        }
        Self { rows, voxels: zeroed_vec(voxels as usize + MORE), factors: vec![] }
    }

    /// How many voxels are stored.
    pub(super) fn count(&self) -> usize {
        self.voxels.len() - MORE
    }

    /// Those.
    pub(super) fn stored(&self) -> &[Voxel] {
        &self.voxels[..self.count()]
    }

    /// Their gradient opacity, where it plays a part.
    pub(super) fn factors(&self) -> &[u8] {
        &self.factors
    }

    /// Fills in the voxels and, where it plays a part, their gradient opacity.
    pub(super) fn fill(&mut self, voxels: &[Voxel], factors: Vec<u8>) {
        let count = self.count();
        self.voxels[..count].copy_from_slice(voxels);
        self.factors = factors;
    }

    fn bytes(&self) -> u64 {
        (size_of_val(&self.rows[..]) + size_of_val(&self.voxels[..]) + self.factors.len()) as u64
    }
}

/// All encodings of a volume under a transfer function.
#[derive(Clone, Debug, PartialEq)]
pub struct RunLengthVolume {
    pub(super) dims: [usize; 3],
    /// Those that are stored.
    pub(super) visible: Arc<Visible>,
    /// Scanlines along x: a plane for each z with a row for each y.
    pub(super) along_x: Vec<Plane>,
    /// Scanlines along y: a plane for each z with a row for each x.
    pub(super) along_y: Vec<Plane>,
}

/// The encoding that one principal axis walks.
#[derive(Clone, Copy, Debug)]
pub struct AxisEncoding<'a> {
    visible: AxisVisible<'a>,
    planes: &'a [Plane],
    /// True where planes are slices k; else planes are scanline positions j.
    plane_is_slice: bool,
}

impl<'a> AxisEncoding<'a> {
    /// Asks for what tells which voxels of scanline `j` of slice `k` are stored and where; there may be no such slice.
    #[inline(always)]
    pub fn prefetch_marks(&self, j: usize, k: usize) {
        let (plane, row) = if self.plane_is_slice { (k, j) } else { (j, k) };
        if let Some(plane) = self.planes.get(plane) {
            prefetch_at(&plane.rows, row);
        }
        self.visible.marks.prefetch(j, k);
    }

    /// Which of the scanlines of slice `k` from `j` on hold anything, a bit each, and of 64 at most.
    #[inline(always)]
    pub fn shown(&self, j: usize, count: usize, k: usize) -> u64 {
        self.visible.shown.from(j, count, k)
    }

    /// Scanline `j` of slice `k`.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> Scanline<'a> {
        let (plane, row) = if self.plane_is_slice { (k, j) } else { (j, k) };
        let marks = self.visible.marks;
        Scanline { marks: marks.scanline_and_more(j, k), words: marks.words(), plane: &self.planes[plane], row }
    }
}

impl RunLengthVolume {
    /// Encodes what of the voxels that are `visible` by `tables` the gradient opacity of `transfer` leaves.
    pub fn encode(
        prepared: &PreparedVolume,
        tables: &CodeTables,
        transfer: &TransferFunction,
        visible: &Arc<Visible>,
    ) -> Self {
        encode::encode(prepared, tables, transfer, visible)
    }

    /// What encoding so many voxels, those of the occupied leaves, can take in memory at most.
    pub(super) fn bytes_at_most(dims @ [nx, ny, nz]: [usize; 3], voxels: u64) -> u64 {
        // A voxel and its factor take 5 bytes.
        let order =
            |rows: usize| 5 * voxels + (nz * ((rows + 1) * size_of::<u32>() + MORE * size_of::<Voxel>())) as u64;
        order(ny) + order(nx) + Visible::bytes_of(dims)
    }

    /// The encoding for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisEncoding<'_> {
        let planes = if axis == 0 { &self.along_y } else { &self.along_x };
        AxisEncoding { visible: self.visible.for_axis(axis), planes, plane_is_slice: axis == 2 }
    }

    /// Number of non-transparent voxels.
    pub fn voxels(&self) -> u64 {
        self.along_x.iter().map(|plane| plane.count() as u64).sum()
    }

    /// Share of the voxels that are not transparent, 0..=1.
    pub fn nontransparent_share(&self) -> f64 {
        self.voxels() as f64 / self.dims.iter().product::<usize>() as f64
    }

    /// Bytes in memory, all orders, and of the marks whoever shares them.
    pub fn bytes(&self) -> u64 {
        self.visible.bytes() + self.along_x.iter().chain(&self.along_y).map(Plane::bytes).sum::<u64>()
    }
}
