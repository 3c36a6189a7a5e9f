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
//! Runs never cross a multiple of 64 voxels, so that a run is a mask in one machine word; the
//! kernel intersects runs with the pixels that are not opaque yet by bit operations.
//!
//! Encoding touches voxels only in leaves that octree and summed-area table cannot rule out. It
//! marks the non-transparent voxels of a plane as bits, turns the bits for the second order, and
//! copies the marked voxels; planes are independent and spread over the pool.

use rayon::prelude::*;

use super::tables::CodeTables;
use super::transfer::TransferFunction;
use crate::volume::gradient::{Code, GradientFrame, gradient_at};
use crate::volume::octree::leaf_of;
use crate::volume::{PreparedVolume, Scalars};

/// Voxels of a scanline that a run's mask spans.
pub const WORD: usize = 64;

/// A run of non-transparent voxels within one word of a scanline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Run {
    /// Index of the first voxel in the scanline.
    pub start: u16,
    /// 1..=64.
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
}

/// The encoding that one principal axis walks.
#[derive(Clone, Copy, Debug)]
pub struct AxisEncoding<'a> {
    planes: &'a [Plane],
    /// True where planes are slices k; else planes are scanline positions j.
    plane_is_slice: bool,
}

impl<'a> AxisEncoding<'a> {
    /// What [`Self::scanline`] looks up first.
    #[inline(always)]
    pub fn place(&self, j: usize, k: usize) -> &'a [[u32; 2]] {
        let (plane, row) = if self.plane_is_slice { (k, j) } else { (j, k) };
        self.planes.get(plane).and_then(|plane| plane.rows.get(row..row + 1)).unwrap_or_default()
    }

    /// Scanline `j` of slice `k`.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> Scanline<'a> {
        let (plane, row) = if self.plane_is_slice { (k, j) } else { (j, k) };
        self.planes[plane].scanline(row)
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
        match prepared.volume().scalars() {
            Scalars::U8(codes) => Encoder::new(codes, prepared, tables, transfer, occupied).encode(),
            Scalars::U16(codes) => Encoder::new(codes, prepared, tables, transfer, occupied).encode(),
        }
    }

    /// What encoding so many voxels, those of the occupied leaves, can take in memory at most.
    pub(super) fn bytes_at_most([nx, ny, nz]: [usize; 3], voxels: u64) -> u64 {
        // A voxel and its factor take 5 bytes, a run 4. Of n voxels v are encoded in at most n - v runs and
        // one for each word, so that both together take 5 n at most, besides those and the rows.
        let order = |length: usize, rows: usize| {
            let per_row = size_of::<[u32; 2]>() + length.div_ceil(WORD) * size_of::<Run>();
            5 * voxels + ((rows * nz + nz) * per_row) as u64
        };
        order(nx, ny) + order(ny, nx)
    }

    /// The encoding for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisEncoding<'_> {
        let planes = if axis == 0 { &self.along_y } else { &self.along_x };
        AxisEncoding { planes, plane_is_slice: axis == 2 }
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
        self.along_x.iter().chain(&self.along_y).map(Plane::bytes).sum()
    }
}

/// What all planes of an encoding share.
struct Encoder<'a, T> {
    codes: &'a [T],
    prepared: &'a PreparedVolume,
    tables: &'a CodeTables,
    transfer: &'a TransferFunction,
    frame: GradientFrame,
    occupied: &'a [bool],
    dims: [usize; 3],
}

impl<'a, T: Code> Encoder<'a, T> {
    fn new(
        codes: &'a [T],
        prepared: &'a PreparedVolume,
        tables: &'a CodeTables,
        transfer: &'a TransferFunction,
        occupied: &'a [bool],
    ) -> Self {
        let volume = prepared.volume();
        let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
        Self { codes, prepared, tables, transfer, frame, occupied, dims: volume.dims() }
    }

    fn encode(&self) -> RunLengthVolume {
        let (along_x, along_y) = (0..self.dims[2]).into_par_iter().map(|z| self.plane(z)).unzip();
        RunLengthVolume { dims: self.dims, along_x, along_y }
    }

    /// Both orders of the plane at `z`.
    fn plane(&self, z: usize) -> (Plane, Plane) {
        let [nx, ny, _] = self.dims;
        let marks_x = self.marks(z);
        let marks_y = marks_x.turned();
        let first = z * nx * ny;
        (self.rows(&marks_x, z, |row, i| first + row * nx + i), self.rows(&marks_y, z, |row, i| first + i * nx + row))
    }

    /// Marks the non-transparent voxels of a plane, rows along x.
    fn marks(&self, z: usize) -> Marks {
        let [nx, ny, nz] = self.dims;
        let [bx, by, _] = self.prepared.octree().leaf_dims();
        let mut marks = Marks::new(nx, ny);
        let words = marks.words;
        for (y, row) in marks.bits.chunks_exact_mut(words).enumerate() {
            let leaves = &self.occupied[(leaf_of(z, nz) * by + leaf_of(y, ny)) * bx..][..bx];
            let at = (z * ny + y) * nx;
            for (leaf, _) in leaves.iter().enumerate().filter(|(_, occupied)| **occupied) {
                let first = leaf * crate::volume::octree::LEAF;
                let end = if leaf + 1 == bx { nx } else { first + crate::volume::octree::LEAF };
                for x in first..end {
                    let visible = self.is_visible(at + x, [x, y, z]);
                    row[x / WORD] |= u64::from(visible) << (x % WORD);
                }
            }
        }
        marks
    }

    #[inline(always)]
    fn is_visible(&self, index: usize, at: [usize; 3]) -> bool {
        let code: u16 = self.codes[index].into();
        let tau = self.tables.extinction[usize::from(code)];
        tau > 0.0 && (self.transfer.gradient_opacity.is_empty() || self.tables.is_visible(tau, self.factor(at)))
    }

    /// The gradient opacity of a voxel, 255 = 1.
    fn factor(&self, at: [usize; 3]) -> u8 {
        let magnitude = gradient_at(self.prepared.volume(), &self.frame, at).length();
        (self.transfer.gradient_factor(magnitude) * 255.0).round() as u8
    }

    /// Encodes marked rows; `index` gives the voxel of (row, position in row).
    fn rows(&self, marks: &Marks, z: usize, index: impl Fn(usize, usize) -> usize) -> Plane {
        let [nx, ny, _] = self.dims;
        let normals = self.prepared.normals();
        let mut plane = Plane::default();
        let with_factors = !self.transfer.gradient_opacity.is_empty();
        plane.rows.push([0, 0]);
        for (row, words) in marks.bits.chunks_exact(marks.words).enumerate() {
            for run in words.iter().enumerate().flat_map(|(word, &bits)| runs(word, bits)) {
                plane.runs.push(run);
                for i in usize::from(run.start)..usize::from(run.start) + usize::from(run.length) {
                    let at = index(row, i);
                    plane.voxels.push(Voxel { code: self.codes[at].into(), normal: normals[at] });
                    if with_factors {
                        plane.factors.push(self.factor([at % nx, at / nx % ny, z]));
                    }
                }
            }
            plane.rows.push([plane.runs.len() as u32, plane.voxels.len() as u32]);
        }
        plane.runs.shrink_to_fit();
        plane.voxels.shrink_to_fit();
        plane
    }
}

/// The runs of set bits in a word.
fn runs(word: usize, mut bits: u64) -> impl Iterator<Item = Run> {
    std::iter::from_fn(move || {
        if bits == 0 {
            return None;
        }
        let start = bits.trailing_zeros();
        let length = (!(bits >> start)).trailing_zeros().min(WORD as u32 - start);
        let run = Run { start: (word * WORD) as u16 + start as u16, length: length as u16 };
        bits &= !run.mask();
        Some(run)
    })
}

/// A plane's non-transparent voxels, a bit each.
struct Marks {
    /// Voxels in a row, and rows.
    dims: [usize; 2],
    words: usize,
    bits: Vec<u64>,
}

impl Marks {
    fn new(length: usize, rows: usize) -> Self {
        let words = length.div_ceil(WORD);
        Self { dims: [length, rows], words, bits: vec![0; words * rows] }
    }

    /// Rows and columns swapped, by blocks of 64 x 64 bits.
    fn turned(&self) -> Self {
        let [length, rows] = self.dims;
        let mut turned = Self::new(rows, length);
        for block_row in 0..rows.div_ceil(WORD) {
            for word in 0..self.words {
                let source = |i: usize| self.bits.get((block_row * WORD + i) * self.words + word).copied();
                let mut block: [u64; WORD] = std::array::from_fn(|i| source(i).unwrap_or(0));
                if block.iter().all(|&bits| bits == 0) {
                    continue;
                }
                transpose(&mut block);
                for (i, bits) in block.into_iter().enumerate().take(length - word * WORD) {
                    turned.bits[(word * WORD + i) * turned.words + block_row] = bits;
                }
            }
        }
        turned
    }
}

/// Transposes 64 x 64 bits: bit j of word i becomes bit i of word j (Hacker's Delight 7-3).
fn transpose(block: &mut [u64; WORD]) {
    let (mut width, mut mask) = (WORD / 2, u64::MAX >> (WORD / 2));
    while width > 0 {
        let mut i = 0;
        while i < WORD {
            let swap = (block[i] >> width ^ block[i + width]) & mask;
            block[i + width] ^= swap;
            block[i] ^= swap << width;
            i = (i + width + 1) & !width;
        }
        width /= 2;
        mask ^= mask << width;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposing_moves_every_bit_to_its_mirror() {
        let mut state = 1u64;
        let block: [u64; WORD] = std::array::from_fn(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            state ^ state >> 29
        });
        let mut turned = block;
        transpose(&mut turned);
        for (i, row) in block.iter().enumerate() {
            for (j, column) in turned.iter().enumerate() {
                assert_eq!(row >> j & 1, column >> i & 1);
            }
        }
    }

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
