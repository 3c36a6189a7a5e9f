//! Visible voxels: those whose code a transfer function gives an extinction.
//!
//! It is what fast classification (Lacroute and Levoy 1994, section 3.3) asks octree and summed-area table for at every node, told once
//! for a transfer function and to the voxel: in leaves that these cannot rule out, codes are compared, 64 at a time. The
//! run-length encodings of [`super::rle`] begin with it and take one and a half to five times as long, for they compute the normals of what is visible and deal it
//! out. Whether a gradient opacity leaves anything of a voxel is not told here.

use super::marks::{AxisMarks, Marks, Shown, VisibleCodes};
use super::tables::CodeTables;
use crate::volume::PreparedVolume;
use crate::volume::scanlines::AnyScanlines;

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
        let visible = tables.extinction.iter().map(|tau| *tau > 0.0);
        let marks = match prepared.scanlines(2) {
            AnyScanlines::U8(scanlines) => Marks::new::<_, false>(scanlines, &VisibleCodes::new(visible), occupied),
            AnyScanlines::U16(scanlines) => Marks::new::<_, false>(scanlines, &VisibleCodes::new(visible), occupied),
        };
        let [nx, ny, nz] = prepared.volume().dims();
        let shown = [[nz, nx], [nz, ny], [ny, nz]];
        let shown = [0, 1, 2].map(|axis| {
            let (of_axis, [scanlines, slices]) = (marks.for_axis(axis), shown[axis]);
            Shown::new(scanlines, slices, |j, k| of_axis.scanline(j, k).iter().any(|&bits| bits != 0))
        });
        Self { marks, shown }
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
