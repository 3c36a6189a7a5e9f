//! Visible voxels: those whose code a transfer function gives an extinction.
//!
//! It is what fast classification (Lacroute and Levoy 1994, section 3.3) asks octree and summed-area table for at every node, told once
//! for a transfer function and to the voxel: in leaves that these cannot rule out, codes are compared, 64 at a time. It takes a
//! millisecond or two where the run-length encodings of [`super::rle`], which begin with it, take ten, for these compute the normals of what is
//! visible and deal it out. Whether a gradient opacity leaves anything of a voxel is not told here.

use super::marks::{AxisMarks, Marks, OccupiedWords, Shown, VisibleCodes, WORD, turn, words};
use super::tables::CodeTables;
use crate::simd::{self, Kernel};
use crate::volume::PreparedVolume;
use crate::volume::gradient::Code;
use crate::volume::octree::leaf_of;
use crate::volume::scanlines::{AnyScanlines, Scanlines};

/// The visible voxels of a volume, for all three principal axes.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleVoxels {
    marks: Marks,
    /// By principal axis.
    shown: [Shown; 3],
}

/// The visible voxels as one principal axis walks them.
#[derive(Clone, Copy, Debug)]
pub struct AxisVisible<'a> {
    pub marks: AxisMarks<'a>,
    pub shown: &'a Shown,
}

impl VisibleVoxels {
    /// Those that `tables` leave, on the current rayon pool. `occupied` has a flag for each leaf of the volume's octree: false only where the
    /// whole leaf is transparent.
    pub fn new(prepared: &PreparedVolume, tables: &CodeTables, occupied: &[bool]) -> Self {
        match prepared.scanlines(2) {
            AnyScanlines::U8(scanlines) => mark(scanlines, tables, occupied),
            AnyScanlines::U16(scanlines) => mark(scanlines, tables, occupied),
        }
    }

    /// Those for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisVisible<'_> {
        AxisVisible { marks: self.marks.for_axis(axis), shown: &self.shown[axis] }
    }

    /// Marks of the plane at z: by scanlines along x and along y.
    pub(super) fn plane(&self, z: usize) -> [&[u64]; 2] {
        self.marks.plane(z)
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        self.marks.bytes() + self.shown.iter().map(Shown::bytes).sum::<u64>()
    }
}

fn mark<T: Code>(scanlines: Scanlines<'_, T>, tables: &CodeTables, occupied: &[bool]) -> VisibleVoxels {
    let dims @ [nx, ny, nz] = scanlines.dims();
    let visible = VisibleCodes::new(tables.extinction.iter().map(|tau| *tau > 0.0));
    let marks = Marks::of_planes(dims, |z, rows, columns| {
        simd::dispatch(Plane { scanlines, visible: &visible, occupied, z, rows, columns });
    });
    let shown = [[nz, nx], [nz, ny], [ny, nz]];
    let shown = [0, 1, 2].map(|axis| {
        let (of_axis, [scanlines, slices]) = (marks.for_axis(axis), shown[axis]);
        Shown::new(scanlines, slices, |j, k| of_axis.scanline(j, k).iter().any(|&bits| bits != 0))
    });
    VisibleVoxels { marks, shown }
}

/// The voxels of slice `z`, to be marked in both orders.
struct Plane<'a, T> {
    scanlines: Scanlines<'a, T>,
    visible: &'a VisibleCodes<T>,
    occupied: &'a [bool],
    z: usize,
    rows: &'a mut [u64],
    columns: &'a mut [u64],
}

impl<T: Code> Kernel for Plane<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let dims @ [nx, ny, _] = self.scanlines.dims();
        let mut occupied = OccupiedWords::new(self.occupied, dims, self.z);
        for (y, marks) in self.rows.chunks_exact_mut(words(nx)).enumerate() {
            let row = self.scanlines.row(y, self.z);
            let occupied = occupied.of_row(leaf_of(y, ny));
            for (word, (marks, occupied)) in marks.iter_mut().zip(occupied).enumerate() {
                if *occupied {
                    *marks = self.visible.mark_voxels(row, word * WORD);
                }
            }
        }
        turn(self.rows, [nx, ny], self.columns);
    }
}
