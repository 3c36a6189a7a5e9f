//! The scalar field between voxels: trilinear codes and gradients.

use glam::{DVec3, DVec4};

use crate::volume::PreparedVolume;
use crate::volume::gradient::{Code, GradientFrame};
use crate::volume::octree::leaf_of;

/// A volume's codes, to be interpolated.
pub(super) struct Field<'a, T> {
    codes: &'a [T],
    dims: [usize; 3],
    leaf_dims: [usize; 3],
    frame: GradientFrame,
}

/// A cell of eight voxels, and where in it a point is (0..=1 along each axis).
#[derive(Clone, Copy)]
pub(super) struct Place {
    cell: [usize; 3],
    fraction: DVec3,
}

impl<'a, T: Code> Field<'a, T> {
    pub(super) fn new(codes: &'a [T], prepared: &PreparedVolume) -> Self {
        let volume = prepared.volume();
        Self {
            codes,
            dims: volume.dims(),
            leaf_dims: prepared.octree().leaf_dims(),
            frame: GradientFrame::new(volume.placement(), volume.rescale().0),
        }
    }

    /// The place of index coordinates; rounding may have left them a hair outside.
    pub(super) fn place(&self, at: DVec3) -> Place {
        let cell = [0, 1, 2].map(|axis| (at[axis].max(0.0) as usize).min(self.dims[axis] - 2));
        let fraction = (at - DVec3::from_array(cell.map(|c| c as f64))).clamp(DVec3::ZERO, DVec3::ONE);
        Place { cell, fraction }
    }

    /// The octree's leaf that a place belongs to.
    pub(super) fn leaf(&self, Place { cell, .. }: Place) -> usize {
        let [i, j, k] = [0, 1, 2].map(|axis| leaf_of(cell[axis], self.dims[axis]));
        (k * self.leaf_dims[1] + j) * self.leaf_dims[0] + i
    }

    /// The index of the voxel next to a place.
    pub(super) fn nearest_voxel(&self, Place { cell, fraction }: Place) -> usize {
        let [i, j, k] = [0, 1, 2].map(|axis| cell[axis] + usize::from(fraction[axis] >= 0.5));
        (k * self.dims[1] + j) * self.dims[0] + i
    }

    /// The interpolated code. Never outside of what the cell's voxels range over, not by rounding
    /// either, so that what holds for a leaf's range holds for it.
    pub(super) fn code(&self, Place { cell, fraction }: Place) -> f64 {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let code = trilinear(fraction, |[i, j, k]| {
            let code = self.voxel([cell[0] + i, cell[1] + j, cell[2] + k]);
            (low, high) = (low.min(code), high.max(code));
            code
        });
        code.clamp(low, high)
    }

    /// The world gradient in scalar units per mm, interpolated as a vector from the voxels' central
    /// differences.
    pub(super) fn gradient(&self, Place { cell, fraction }: Place) -> DVec3 {
        let difference = |axis: usize| {
            trilinear(fraction, |[i, j, k]| {
                let voxel = [cell[0] + i, cell[1] + j, cell[2] + k];
                let (mut after, mut before) = (voxel, voxel);
                after[axis] = (voxel[axis] + 1).min(self.dims[axis] - 1);
                before[axis] = voxel[axis].saturating_sub(1);
                self.voxel(after) - self.voxel(before)
            })
        };
        let differences = DVec3::new(difference(0), difference(1), difference(2));
        self.frame.world_from_frame * (self.frame.frame_from_differences * differences)
    }

    /// What eight voxels have, told by their index, interpolated.
    pub(super) fn interpolated(&self, Place { cell, fraction }: Place, voxel: impl Fn(usize) -> DVec4) -> DVec4 {
        let mut sum = DVec4::ZERO;
        for corner in 0..8 {
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let weight = |axis: usize| if step[axis] == 1 { fraction[axis] } else { 1.0 - fraction[axis] };
            let [i, j, k] = [0, 1, 2].map(|axis| cell[axis] + step[axis]);
            sum += voxel((k * self.dims[1] + j) * self.dims[0] + i) * (weight(0) * weight(1) * weight(2));
        }
        sum
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> f64 {
        let code: u16 = self.codes[(k * self.dims[1] + j) * self.dims[0] + i].into();
        f64::from(code)
    }
}

/// Trilinear interpolation of a cell's corners.
fn trilinear(fraction: DVec3, mut corner: impl FnMut([usize; 3]) -> f64) -> f64 {
    let mut along_i = |j, k| {
        let (a, b) = (corner([0, j, k]), corner([1, j, k]));
        a + (b - a) * fraction.x
    };
    let mut along_j = |k| {
        let (a, b) = (along_i(0, k), along_i(1, k));
        a + (b - a) * fraction.y
    };
    let (a, b) = (along_j(0), along_j(1));
    a + (b - a) * fraction.z
}
