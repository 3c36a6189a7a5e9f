//! A coarser level of a volume: the mean of 2 x 2 x 2 voxels.
//!
//! Quality `draft` renders an eighth of the voxels. A level must keep its volume's box, or the picture
//! would shrink whenever the viewer is dragged. The means' centres end half a voxel inside that box,
//! so the level's spacing is stretched until its outermost centres lie on the box's faces: places
//! are off by half a voxel of the finer level at the faces, and by nothing in the middle. (Samples
//! clamped between the outermost centres and the box would put that right, for a special case in
//! every kernel.)

use glam::DVec3;
use rayon::prelude::*;

use super::gradient::Code;
use super::{Placement, Scalars, Volume};

/// The next coarser level of `volume`: half as many voxels along each axis, rounded up, and at least 2. At
/// odd sizes the last mean is of what is there.
pub fn coarser(volume: &Volume) -> Volume {
    let dims = volume.dims().map(halved);
    let scalars = match volume.scalars() {
        Scalars::U8(codes) => Scalars::U8(means(codes, volume.dims(), dims, |mean| mean as u8)),
        Scalars::U16(codes) => Scalars::U16(means(codes, volume.dims(), dims, |mean| mean as u16)),
    };
    let stretch = DVec3::from_array([0, 1, 2].map(|axis| (volume.dims()[axis] - 1) as f64 / (dims[axis] - 1) as f64));
    let placement = Placement { spacing: volume.placement().spacing * stretch, ..*volume.placement() };
    Volume::new(dims, placement, scalars, volume.rescale(), volume.report().clone())
        .expect("half of a sound volume is sound")
}

fn halved(n: usize) -> usize {
    n.div_ceil(2).max(2)
}

/// The voxels, of `n` along an axis, that coarse voxel `at` is the mean of.
fn covered(at: usize, n: usize) -> [usize; 2] {
    if n == 2 { [at, at] } else { [2 * at, (2 * at + 1).min(n - 1)] }
}

fn means<T: Code>(
    codes: &[T],
    [nx, ny, nz]: [usize; 3],
    [mx, my, mz]: [usize; 3],
    narrow: impl Fn(u32) -> T + Sync,
) -> Vec<T> {
    let mut coarse = vec![narrow(0); mx * my * mz];
    coarse.par_chunks_mut(mx * my).enumerate().for_each(|(z, plane)| {
        for (y, row) in plane.chunks_exact_mut(mx).enumerate() {
            let rows = covered(z, nz).map(|z| covered(y, ny).map(|y| &codes[(z * ny + y) * nx..][..nx]));
            for (x, mean) in row.iter_mut().enumerate() {
                let [a, b] = covered(x, nx);
                let sum: u32 =
                    rows.iter().flatten().map(|row| u32::from(row[a].into()) + u32::from(row[b].into())).sum();
                *mean = narrow((sum + 4) / 8);
            }
        }
    });
    coarse
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{ImportReport, ScalarType};

    fn ramp(dims: [usize; 3]) -> Volume {
        let codes = (0..dims.iter().product()).map(|at: usize| (at % dims[0] * 4) as u8).collect();
        let placement = Placement::from_spacing(DVec3::new(1.0, 2.0, 0.5));
        let report = ImportReport::plain("test", ScalarType::U8);
        Volume::new(dims, placement, Scalars::U8(codes), (1.0, 0.0), report).unwrap()
    }

    #[test]
    fn a_level_keeps_the_box() {
        for dims in [[2, 3, 4], [40, 41, 7], [5, 2, 2]] {
            let (fine, coarse) = (ramp(dims), coarser(&ramp(dims)));
            assert_eq!(coarse.dims(), dims.map(|n| n.div_ceil(2).max(2)));
            assert!((fine.centre() - coarse.centre()).length() < 1e-12);
            assert!((fine.radius() - coarse.radius()).abs() < 1e-12);
        }
    }

    #[test]
    fn a_ramp_stays_a_ramp() {
        let coarse = coarser(&ramp([40, 6, 6]));
        for x in 0..20 {
            assert_eq!(coarse.scalars().code(x), (8 * x + 2) as u16);
        }
        // At an odd size the last mean is of the last voxel alone.
        assert_eq!(coarser(&ramp([5, 4, 4])).scalars().code(2), 16);
    }
}
