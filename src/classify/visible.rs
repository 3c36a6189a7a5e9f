//! Visible voxels: those whose code a transfer function gives an extinction.
//!
//! It is what fast classification (Lacroute and Levoy 1994, section 3.3) asks octree and summed-area table for at every node, told once
//! for a transfer function and to the voxel: in leaves that these cannot rule out, codes are compared, 64 at a time. The
//! run-length encodings of [`super::rle`] begin with it and take one and a half to six times as long, for they compute the normals of what is visible and deal it
//! out. Whether a gradient opacity leaves anything of a voxel is not told here.

use super::marks::{AxisMarks, Holding, Marks, Shown, VisibleCodes, WORD};
use super::tables::CodeTables;
use crate::volume::PreparedVolume;
use crate::volume::scanlines::AnyScanlines;

/// The visible voxels of a volume, or its [`cells`](super::cells) in which something shows, for all three principal axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Visible {
    marks: Marks,
    /// By principal axis.
    shown: [Shown; 3],
}

/// Those that one principal axis walks.
#[derive(Clone, Copy, Debug)]
pub struct AxisVisible<'a> {
    pub marks: AxisMarks<'a>,
    pub shown: &'a Shown,
}

impl Visible {
    /// The voxels that `tables` leave, on the current rayon pool. `occupied` has a flag for each leaf of the volume's octree: false only where the
    /// whole leaf is transparent.
    pub fn new(prepared: &PreparedVolume, tables: &CodeTables, occupied: &[bool]) -> Self {
        let visible = tables.extinction.iter().map(|tau| *tau > 0.0);
        let (marks, holding) = match prepared.scanlines(2) {
            AnyScanlines::U8(scanlines) => Marks::new::<_, false>(scanlines, &VisibleCodes::new(visible), occupied),
            AnyScanlines::U16(scanlines) => Marks::new::<_, false>(scanlines, &VisibleCodes::new(visible), occupied),
        };
        Self::holding(marks, &holding)
    }

    /// Those that are marked.
    pub(super) fn of(marks: Marks) -> Self {
        let holding = marks.holding();
        Self::holding(marks, &holding)
    }

    /// Those that are marked, and by plane z which scanlines hold any.
    pub(super) fn holding(marks: Marks, by_plane: &[Holding]) -> Self {
        let [nx, ny, nz] = marks.dims;
        let bit = |bits: &[u64], at: usize| bits[at / WORD] >> (at % WORD) & 1 == 1;
        let shown = [
            Shown::new(nz, nx, |j, k| bit(&by_plane[j].columns, k)),
            Shown::new(nz, ny, |j, k| bit(&by_plane[j].rows, k)),
            Shown::new(ny, nz, |j, k| bit(&by_plane[k].rows, j)),
        ];
        Self { marks, shown }
    }

    /// What is left when the scanlines along x of each plane z have gone through `reduce`; and what that gave.
    pub(super) fn reduced<R: Send>(&self, reduce: impl Fn(usize, &mut [u64]) -> R + Sync) -> (Self, Vec<R>) {
        let (marks, given) = self.marks.reduced(reduce);
        (Self::of(marks), given)
    }

    /// Those for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisVisible<'_> {
        AxisVisible { marks: self.marks.for_axis(axis), shown: &self.shown[axis] }
    }

    /// Share that is marked, 0..=1.
    pub fn share(&self) -> f64 {
        self.marks.share()
    }

    /// What those of so many voxels (or cells) take in memory.
    pub(super) fn bytes_of(dims @ [nx, ny, nz]: [usize; 3]) -> u64 {
        let shown = Shown::bytes_of(nz, nx) + Shown::bytes_of(nz, ny) + Shown::bytes_of(ny, nz);
        Marks::bytes_of(dims) + shown
    }

    /// All marks.
    pub(super) fn marks(&self) -> &Marks {
        &self.marks
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classify::{Classification, Color, ControlPoint, Purpose, TransferFunction};
    use crate::volume::phantom;

    #[test]
    fn scanlines_that_hold_voxels_are_known_from_marking_them() {
        for dims in [[2, 3, 2], [70, 65, 5], [64, 9, 130]] {
            // Half a ball, so that there are empty planes, rows and columns.
            let field = |i: usize, j: usize, k: usize| {
                let [x, y, z] = [i, j, k].map(|at| at as f64 / 8.0);
                if (x - 1.0).powi(2) + (y - 2.0).powi(2) + z * z < 4.0 { 100.0 } else { (i % 7) as f64 }
            };
            let prepared = PreparedVolume::build(phantom::from_fn(dims, [1.0; 3], field));
            let point = |value, opacity| ControlPoint { value, opacity, color: Color([1.0; 3]) };
            let transfer = TransferFunction {
                points: vec![point(50.0, 0.0), point(60.0, 1.0)],
                opacity_distance: None,
                gradient_opacity: vec![],
            };
            let classification = Classification::build(&prepared, &transfer, Purpose::Voxels { min_opacity: 0.0 });
            let visible = classification.visible().expect("voxels are classified");
            assert_eq!(*visible, Visible::of(visible.marks.clone()));
            assert!(visible.marks.share() > 0.0, "an empty volume tests nothing");
        }
    }
}
