//! The run-length encoded volume: for each voxel scanline which of its voxels are not transparent, and
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
//! Runs are kept as the bits that they set in the words of a scanline, an eighth of a byte for each
//! voxel, and not as a list of lengths: the kernel intersects them with the pixels that are not opaque
//! yet by operations on words and had to make words of a list first; the other order is a transposition of
//! bits; and where few voxels are transparent for long, as in scans, a list is no shorter.
//! Scanlines without any voxel are most, and one bit for each tells the kernel to pass them by.

mod encode;

pub use super::marks::WORD;
use super::marks::{turn, words};
use super::tables::CodeTables;
use super::transfer::TransferFunction;
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
    /// A bit for every voxel: set for those that are not transparent. No words where none is set.
    pub marked: &'a [u64],
    /// Those voxels, one after the other.
    pub voxels: &'a [Voxel],
    /// Their gradient opacity, 255 = 1; empty where it plays no part.
    pub factors: &'a [u8],
}

impl Scanline<'_> {
    /// Where voxel `i` is among [`Self::voxels`], if it is not transparent.
    pub fn place_of(&self, i: usize) -> Option<usize> {
        let word = *self.marked.get(i / WORD)?;
        let below = (1u64 << (i % WORD)) - 1;
        let before: u32 = self.marked[..i / WORD].iter().map(|word| word.count_ones()).sum();
        (word >> (i % WORD) & 1 == 1).then(|| (before + (word & below).count_ones()) as usize)
    }
}

/// Encoded scanlines of one plane.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plane {
    /// Words of a row.
    words: usize,
    /// A bit for every voxel, row after row.
    pub marked: Vec<u64>,
    /// First voxel of every row, and past the last.
    starts: Vec<u32>,
    pub voxels: Vec<Voxel>,
    pub factors: Vec<u8>,
}

impl Plane {
    /// Rows of `length` voxels with these marks. The voxels, as many as marks, are given afterwards.
    pub(super) fn new(length: usize, marked: Vec<u64>) -> Self {
        let words = words(length);
        let mut starts = Vec::with_capacity(marked.len() / words + 1);
        let mut voxels = 0;
        starts.push(voxels);
        for row in marked.chunks_exact(words) {
            voxels += row.iter().map(|word| word.count_ones()).sum::<u32>();
            starts.push(voxels);
        }
        Self { words, marked, starts, voxels: vec![], factors: vec![] }
    }

    /// Number of marks.
    pub(super) fn marks(&self) -> usize {
        self.starts[self.starts.len() - 1] as usize
    }

    #[inline(always)]
    fn scanline(&self, row: usize) -> Scanline<'_> {
        let voxels = self.starts[row] as usize..self.starts[row + 1] as usize;
        let factors = if self.factors.is_empty() { &[] } else { &self.factors[voxels.clone()] };
        Scanline { marked: &self.marked[row * self.words..][..self.words], voxels: &self.voxels[voxels], factors }
    }

    fn bytes(&self) -> u64 {
        let index = size_of_val(&self.marked[..]) + size_of_val(&self.starts[..]);
        (index + size_of_val(&self.voxels[..]) + self.factors.len()) as u64
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
    /// By principal axis: a bit for every scanline j, slice after slice, set where it has voxels.
    filled: [Vec<u64>; 3],
}

/// The encoding that one principal axis walks.
#[derive(Clone, Copy, Debug)]
pub struct AxisEncoding<'a> {
    planes: &'a [Plane],
    /// True where planes are slices k; else planes are scanline positions j.
    plane_is_slice: bool,
    filled: &'a [u64],
    words: usize,
}

impl<'a> AxisEncoding<'a> {
    /// Scanline `j` of slice `k`; all of it is empty where it has no voxels.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> Scanline<'a> {
        if self.is_empty(j, k) {
            return Scanline { marked: &[], voxels: &[], factors: &[] };
        }
        let (plane, row) = if self.plane_is_slice { (k, j) } else { (j, k) };
        self.planes[plane].scanline(row)
    }

    /// True where scanline `j` of slice `k` has no voxels.
    #[inline(always)]
    pub fn is_empty(&self, j: usize, k: usize) -> bool {
        self.filled[k * self.words + j / WORD] >> (j % WORD) & 1 == 0
    }
}

impl RunLengthVolume {
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

    /// Of the planes of both orders.
    pub(super) fn new(dims: [usize; 3], along_x: Vec<Plane>, along_y: Vec<Plane>) -> Self {
        let [nx, ny, nz] = dims;
        // A row for each plane, a bit for each of its rows; where planes are scanline positions, turned.
        let rows = |planes: &[Plane], rows: usize| {
            let mut filled = vec![0; words(rows) * nz];
            for (plane, filled) in planes.iter().zip(filled.chunks_exact_mut(words(rows))) {
                for (row, ends) in plane.starts.windows(2).enumerate() {
                    filled[row / WORD] |= u64::from(ends[0] < ends[1]) << (row % WORD);
                }
            }
            filled
        };
        let turned = |filled: &[u64], rows: usize| {
            let mut turned = vec![0; words(nz) * rows];
            turn(filled, [rows, nz], &mut turned);
            turned
        };
        let (by_y, by_x) = (rows(&along_x, ny), rows(&along_y, nx));
        let filled = [turned(&by_x, nx), turned(&by_y, ny), by_y];
        Self { dims, along_x, along_y, filled }
    }

    /// What encoding so many voxels, those of the occupied leaves, can take in memory at most.
    pub(super) fn bytes_at_most([nx, ny, nz]: [usize; 3], voxels: u64) -> u64 {
        // A voxel and its factor take 5 bytes in each order.
        let order = |length: usize, rows: usize| {
            let per_plane = rows * words(length) * size_of::<u64>() + (rows + 1) * size_of::<u32>();
            5 * voxels + (nz * per_plane) as u64
        };
        let filled = words(nz) * nx + words(nz) * ny + words(ny) * nz;
        order(nx, ny) + order(ny, nx) + (filled * size_of::<u64>()) as u64
    }

    /// The encoding for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisEncoding<'_> {
        let planes = if axis == 0 { &self.along_y } else { &self.along_x };
        let scanlines = if axis == 2 { self.dims[1] } else { self.dims[2] };
        AxisEncoding { planes, plane_is_slice: axis == 2, filled: &self.filled[axis], words: words(scanlines) }
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
        let filled: usize = self.filled.iter().map(|filled| size_of_val(&filled[..])).sum();
        self.along_x.iter().chain(&self.along_y).map(Plane::bytes).sum::<u64>() + filled as u64
    }
}
