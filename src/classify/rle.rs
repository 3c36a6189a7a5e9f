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
//! Runs never cross a multiple of 64 voxels, so that a run is a mask in one machine word, and have at most 63, so that the pixels
//! between and beside their voxels are one, too; the kernel intersects them with the pixels that are not opaque yet.
//!
//! How the encodings are made: `rle/encode.rs`.

mod encode;

pub use super::marks::WORD;

/// Voxels in a run at most.
pub(super) const LONGEST_RUN: usize = WORD - 1;

use super::tables::CodeTables;
use super::transfer::TransferFunction;
use crate::volume::PreparedVolume;

/// A run of non-transparent voxels within one word of a scanline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Run {
    /// Index of the first voxel in the scanline.
    pub start: u16,
    /// 1..=63.
    pub length: u16,
}

impl Run {
    /// The word of the scanline that the run lies in.
    #[inline(always)]
    pub fn word(self) -> usize {
        usize::from(self.start) / WORD
    }

    /// The run's voxels as bits of that word.
    #[inline(always)]
    pub fn mask(self) -> u64 {
        (u64::MAX >> (WORD as u32 - u32::from(self.length))) << (u32::from(self.start) % WORD as u32)
    }
}

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
    pub runs: &'a [Run],
    /// The voxels of all runs, one after the other.
    pub voxels: &'a [Voxel],
    /// The voxels' gradient opacity, 255 = 1; empty where it plays no part.
    pub factors: &'a [u8],
}

/// Encoded scanlines of one plane.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Plane {
    /// First run and first voxel of every row, and past the last.
    pub rows: Vec<[u32; 2]>,
    pub runs: Vec<Run>,
    pub voxels: Vec<Voxel>,
    pub factors: Vec<u8>,
}

impl Plane {
    /// Rows of so many words of marks. The voxels, as many as marks, are given afterwards.
    pub(super) fn of_marks(marks: &[u64], words: usize) -> Self {
        let mut plane = Self { rows: Vec::with_capacity(marks.len() / words + 1), ..Self::default() };
        let mut voxels = 0;
        plane.rows.push([0, 0]);
        for row in marks.chunks_exact(words) {
            for (word, &bits) in row.iter().enumerate() {
                plane.runs.extend(runs(word, bits));
                voxels += bits.count_ones();
            }
            plane.rows.push([plane.runs.len() as u32, voxels]);
        }
        plane.runs.shrink_to_fit();
        plane
    }

    #[inline(always)]
    fn scanline(&self, row: usize) -> Scanline<'_> {
        let ([run, voxel], [run_end, voxel_end]) = (self.rows[row], self.rows[row + 1]);
        let voxels = voxel as usize..voxel_end as usize;
        let factors = if self.factors.is_empty() { &[] } else { &self.factors[voxels.clone()] };
        Scanline { runs: &self.runs[run as usize..run_end as usize], voxels: &self.voxels[voxels], factors }
    }

    fn bytes(&self) -> u64 {
        (size_of_val(&self.rows[..]) + size_of_val(&self.runs[..]) + size_of_val(&self.voxels[..]) + self.factors.len())
            as u64
    }
}

/// All encodings of a volume under a transfer function.
#[derive(Clone, Debug, PartialEq)]
pub struct RunLengthVolume {
    pub(super) dims: [usize; 3],
    /// Scanlines along x: a plane for each z with a row for each y.
    pub(super) along_x: Vec<Plane>,
    /// Scanlines along y: a plane for each z with a row for each x.
    pub(super) along_y: Vec<Plane>,
    /// By principal axis.
    shown: [Shown; 3],
}

/// Which scanlines of the slices along a principal axis hold anything.
#[derive(Clone, Debug, PartialEq)]
struct Shown {
    /// Words of a slice: one more than its scanlines need.
    words: usize,
    bits: Vec<u64>,
}

impl Shown {
    /// `planes` are as they are stored.
    fn new(planes: &[Plane], plane_is_slice: bool) -> Self {
        let rows = planes.first().map_or(0, |plane| plane.rows.len() - 1);
        let (scanlines, slices) = if plane_is_slice { (rows, planes.len()) } else { (planes.len(), rows) };
        let words = scanlines.div_ceil(WORD) + 1;
        let mut bits = vec![0; words * slices];
        for (plane, Plane { rows, .. }) in planes.iter().enumerate() {
            for (row, ends) in rows.windows(2).enumerate().filter(|(_, ends)| ends[0] != ends[1]) {
                debug_assert!(ends[0][0] < ends[1][0], "voxels are in runs");
                let (j, k) = if plane_is_slice { (row, plane) } else { (plane, row) };
                bits[k * words + j / WORD] |= 1 << (j % WORD);
            }
        }
        Self { words, bits }
    }
}

/// The encoding that one principal axis walks.
#[derive(Clone, Copy, Debug)]
pub struct AxisEncoding<'a> {
    planes: &'a [Plane],
    /// True where planes are slices k; else planes are scanline positions j.
    plane_is_slice: bool,
    shown: &'a Shown,
}

impl<'a> AxisEncoding<'a> {
    /// What [`Self::scanline`] looks up first.
    #[inline(always)]
    pub fn place(&self, j: usize, k: usize) -> &'a [[u32; 2]] {
        let (plane, row) = if self.plane_is_slice { (k, j) } else { (j, k) };
        // Before the first one and after the last there is none.
        let rows = self.planes.get(plane).and_then(|plane| plane.rows.get(row..)).unwrap_or_default();
        &rows[..rows.len().min(1)]
    }

    /// Which of the scanlines of slice `k` from `j` on hold anything, a bit each, and of 64 at most.
    #[inline(always)]
    pub fn shown(&self, j: usize, count: usize, k: usize) -> u64 {
        let slice = &self.shown.bits[k * self.shown.words..][..self.shown.words];
        let (word, shift) = (j / WORD, j % WORD);
        (slice[word] >> shift | slice[word + 1] << 1 << (WORD - 1 - shift)) & (u64::MAX >> (WORD - count))
    }

    /// Scanline `j` of slice `k`.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> Scanline<'a> {
        let (plane, row) = if self.plane_is_slice { (k, j) } else { (j, k) };
        self.planes[plane].scanline(row)
    }
}

impl RunLengthVolume {
    /// Of planes in both orders.
    pub(super) fn new(dims: [usize; 3], along_x: Vec<Plane>, along_y: Vec<Plane>) -> Self {
        let shown = [Shown::new(&along_y, false), Shown::new(&along_x, false), Shown::new(&along_x, true)];
        Self { dims, along_x, along_y, shown }
    }

    /// Encodes what `tables` (and the gradient opacity of `transfer`) leave visible. `occupied` has a
    /// flag for each leaf of the volume's octree: false only where the whole leaf is transparent.
    pub fn encode(
        prepared: &PreparedVolume,
        tables: &CodeTables,
        transfer: &TransferFunction,
        occupied: &[bool],
    ) -> Self {
        encode::encode(prepared, tables, transfer, occupied)
    }

    /// What encoding so many voxels, those of the occupied leaves, can take in memory at most.
    pub(super) fn bytes_at_most([nx, ny, nz]: [usize; 3], voxels: u64) -> u64 {
        // A voxel and its factor take 5 bytes, a run 4. Of n voxels v are encoded in at most n - v runs and
        // two for each word, so that both together take 5 n at most, besides those and the rows.
        let order = |length: usize, rows: usize| {
            let per_row = size_of::<[u32; 2]>() + length.div_ceil(WORD) * 2 * size_of::<Run>();
            5 * voxels + ((rows * nz + nz) * per_row) as u64
        };
        let shown =
            |scanlines: usize, slices: usize| ((scanlines.div_ceil(WORD) + 1) * slices * size_of::<u64>()) as u64;
        order(nx, ny) + order(ny, nx) + shown(nz, nx) + shown(nz, ny) + shown(ny, nz)
    }

    /// The encoding for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisEncoding<'_> {
        let planes = if axis == 0 { &self.along_y } else { &self.along_x };
        AxisEncoding { planes, plane_is_slice: axis == 2, shown: &self.shown[axis] }
    }

    /// Number of non-transparent voxels.
    pub fn voxels(&self) -> u64 {
        self.along_x.iter().map(|p| p.voxels.len() as u64).sum()
    }

    /// Share of the voxels that are not transparent, 0..=1.
    pub fn nontransparent_share(&self) -> f64 {
        self.voxels() as f64 / self.dims.iter().product::<usize>() as f64
    }

    /// Bytes in memory, all orders.
    pub fn bytes(&self) -> u64 {
        let shown: usize = self.shown.iter().map(|shown| size_of_val(&shown.bits[..])).sum();
        shown as u64 + self.along_x.iter().chain(&self.along_y).map(Plane::bytes).sum::<u64>()
    }
}

/// The runs of set bits in a word.
fn runs(word: usize, mut bits: u64) -> impl Iterator<Item = Run> {
    std::iter::from_fn(move || {
        if bits == 0 {
            return None;
        }
        let start = bits.trailing_zeros();
        let length = (!(bits >> start)).trailing_zeros().min(WORD as u32 - start).min(LONGEST_RUN as u32);
        let run = Run { start: (word * WORD) as u16 + start as u16, length: length as u16 };
        bits &= !run.mask();
        Some(run)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_cover_exactly_the_set_bits() {
        for bits in [0, 1, u64::MAX, 1 << 63, 0xf0f0_0000_ffff_0001, !1] {
            let union = runs(3, bits).fold(0, |union, run| {
                assert_eq!(run.word(), 3);
                assert_eq!(union & run.mask(), 0, "runs overlap");
                union | run.mask()
            });
            assert_eq!(union, bits);
        }
    }
}
