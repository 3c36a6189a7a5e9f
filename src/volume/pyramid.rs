//! A coarser level of a volume: means of 2 x 2 x 2 voxels.
//!
//! Quality `draft` renders an eighth of the voxels. A level must keep its volume's box, or the picture
//! would shrink whenever the viewer is dragged; but the means' centres end half a voxel inside it, and
//! what lies beyond them counts as what they are. Kernels know volumes whose outermost voxels lie on the
//! box's faces, and a special case in each of them would be a high price for half a voxel. So the level is
//! put on such a lattice here: its spacing is stretched until the outermost voxels lie on the faces, and
//! its values are interpolated between the means where the stretched lattice's voxels stand, clamped
//! beyond the outermost means. They are never farther than a quarter of the coarse spacing from a mean, so
//! three quarters of each is the mean and at most a quarter its neighbour; a linear field stays the
//! same field. (Means on a stretched lattice without that would displace what they show by up to half a
//! voxel near the faces.)
//!
//! Mean and interpolation together are one filter of at most four voxels along an axis, applied along j and
//! k to whole rows and then along them: one rounding, some milliseconds for 512 x 512 x 234 voxels.

use glam::DVec3;
use rayon::prelude::*;

use super::gradient::Code;
use super::{Placement, Scalars, Volume};
use crate::simd::{self, Kernel};

/// The next coarser level of `volume`: half as many voxels along each axis, rounded up, and at least 2. At
/// odd sizes the last mean is of what is there.
pub fn coarser(volume: &Volume) -> Volume {
    let dims = volume.dims().map(halved);
    let scalars = match volume.scalars() {
        Scalars::U8(codes) => Scalars::U8(filtered(codes, volume.dims(), dims)),
        Scalars::U16(codes) => Scalars::U16(filtered(codes, volume.dims(), dims)),
    };
    let stretch = DVec3::from_array([0, 1, 2].map(|axis| spacing(volume.dims()[axis])));
    let placement = Placement { spacing: volume.placement().spacing * stretch, ..*volume.placement() };
    Volume::new(dims, placement, scalars, volume.rescale(), volume.report().clone())
        .expect("half of a sound volume is sound")
}

fn halved(n: usize) -> usize {
    n.div_ceil(2).max(2)
}

/// Distance of the coarse voxels along an axis of `n` voxels, in those.
fn spacing(n: usize) -> f64 {
    (n - 1) as f64 / (halved(n) - 1) as f64
}

/// The voxels of `n` along an axis that make a coarse one, and their weights.
type Taps = [(usize, f32); 4];

/// The taps of coarse voxel `at`.
fn taps(at: usize, n: usize) -> Taps {
    let covered = |mean: usize| if n == 2 { [mean; 2] } else { [2 * mean, (2 * mean + 1).min(n - 1)] };
    let centre = |mean: usize| {
        let [first, last] = covered(mean);
        (first + last) as f64 / 2.0
    };
    let place = at as f64 * spacing(n);
    let last = halved(n) - 1;
    // The means on both sides, the same where there is none.
    let beside = if place < centre(at) { at.saturating_sub(1) } else { (at + 1).min(last) };
    let share = if beside == at { 0.0 } else { (place - centre(at)) / (centre(beside) - centre(at)) };
    let [here, there] = [at, beside].map(covered);
    let [near, far] = [1.0 - share, share].map(|weight| (weight / 2.0) as f32);
    [(here[0], near), (here[1], near), (there[0], far), (there[1], far)]
}

fn filtered<T: Code>(codes: &[T], fine: [usize; 3], coarse: [usize; 3]) -> Vec<T> {
    let mut filtered = vec![T::default(); coarse.iter().product()];
    filtered.par_chunks_mut(coarse[0] * coarse[1]).enumerate().for_each(|(z, plane)| {
        simd::dispatch(Filter { codes, fine, columns: coarse[0], z, plane });
    });
    filtered
}

/// A coarse plane to be made.
struct Filter<'a, T> {
    codes: &'a [T],
    fine: [usize; 3],
    /// Voxels of a coarse row.
    columns: usize,
    z: usize,
    plane: &'a mut [T],
}

impl<T: Code> Kernel for Filter<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [nx, ny, nz] = self.fine;
        let along: Vec<Taps> = (0..self.columns).map(|x| taps(x, nx)).collect();
        let mut sums = vec![0f32; nx];
        for (y, out) in self.plane.chunks_exact_mut(self.columns).enumerate() {
            sums.fill(0.0);
            for (z, weight_z) in taps(self.z, nz) {
                for (y, weight_y) in taps(y, ny) {
                    let weight = weight_z * weight_y;
                    let row = &self.codes[(z * ny + y) * nx..][..nx];
                    sums.iter_mut().zip(row).for_each(|(sum, code)| *sum += weight * code.as_f32());
                }
            }
            for (out, taps) in out.iter_mut().zip(&along) {
                let sum: f32 = taps.iter().map(|&(x, weight)| weight * sums[x]).sum();
                *out = T::from_code((sum + 0.5) as u16);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{ImportReport, ScalarType};

    /// Rises by 4 along `axis`.
    fn ramp(dims: [usize; 3], axis: usize) -> Volume {
        let index = |at: usize| [at % dims[0], at / dims[0] % dims[1], at / (dims[0] * dims[1])];
        let codes = (0..dims.iter().product()).map(|at: usize| (index(at)[axis] * 4) as u8).collect();
        let placement = Placement::from_spacing(DVec3::new(1.0, 2.0, 0.5));
        let report = ImportReport::plain("test", ScalarType::U8);
        Volume::new(dims, placement, Scalars::U8(codes), (1.0, 0.0), report).unwrap()
    }

    #[test]
    fn a_level_keeps_the_box() {
        for dims in [[2, 3, 4], [40, 41, 7], [5, 2, 2]] {
            let (fine, coarse) = (ramp(dims, 0), coarser(&ramp(dims, 0)));
            assert_eq!(coarse.dims(), dims.map(|n| n.div_ceil(2).max(2)));
            assert!((fine.centre() - coarse.centre()).length() < 1e-12);
            assert!((fine.radius() - coarse.radius()).abs() < 1e-12);
        }
    }

    #[test]
    fn weights_add_up_to_one_and_lie_around_where_the_voxel_stands() {
        for n in 2..70 {
            // Where the outermost means are.
            let first = if n == 2 { 0.0 } else { 0.5 };
            let last = if n > 2 && n % 2 == 0 { n as f64 - 1.5 } else { n as f64 - 1.0 };
            for at in 0..halved(n) {
                let taps = taps(at, n);
                let sum: f32 = taps.iter().map(|tap| tap.1).sum();
                let centre: f64 = taps.iter().map(|&(i, weight)| i as f64 * f64::from(weight)).sum();
                let place = (at as f64 * spacing(n)).clamp(first, last);
                assert!((sum - 1.0).abs() < 1e-6 && taps.iter().all(|tap| tap.1 >= 0.0), "{at} of {n}: {taps:?}");
                assert!((centre - place).abs() < 1e-4, "{at} of {n}: {centre}, not {place}");
            }
        }
    }

    #[test]
    fn a_ramp_stays_the_ramp_where_its_voxels_stand() {
        for (dims, axis) in [([40, 6, 6], 0), ([7, 33, 4], 1), ([4, 5, 50], 2)] {
            let coarse = coarser(&ramp(dims, axis));
            let strides = [1, coarse.dims()[0], coarse.dims()[0] * coarse.dims()[1]];
            let n = dims[axis];
            for at in 1..halved(n) - 1 {
                let expected = 4.0 * at as f64 * spacing(n);
                let code = f64::from(coarse.scalars().code(at * strides[axis]));
                assert!((code - expected).abs() < 0.51, "{at} along {axis}: {code}, not {expected}");
            }
            assert_eq!(coarse.scalars().code(0), 2);
        }
    }

    #[test]
    fn what_is_constant_stays_to_the_code() {
        for code in [1, 255] {
            let report = ImportReport::plain("test", ScalarType::U8);
            let placement = Placement::from_spacing(DVec3::ONE);
            let volume = Volume::new([9, 12, 5], placement, Scalars::U8(vec![code; 540]), (1.0, 0.0), report).unwrap();
            assert_eq!(coarser(&volume).scalars(), &Scalars::U8(vec![code; 5 * 6 * 3]));
        }
    }
}
