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
//! A colour volume's voxels are averaged by extinction, and their colours weighted by it (Kraus and Bürger 2008, section 4): a mean of
//! opacities would make thin walls transparent. Their filter is a box four voxels wide, which they found the best compromise for
//! trilinear sampling ([`BoxFilter::Four`]); the usual one is kept beside it for comparison.
//!
//! Mean and interpolation together are one filter of at most four voxels along an axis, applied along j and
//! k to whole rows and then along them: one rounding, some milliseconds for 512 x 512 x 234 voxels.

use glam::{DVec3, DVec4};
use rayon::prelude::*;

use super::gradient::Code;
use super::{Colors, Placement, Scalars, Volume};
use crate::simd::{self, Kernel};

/// The next coarser level of `volume`: half as many voxels along each axis, rounded up, and at least 2. At
/// odd sizes the last mean is of what is there.
pub fn coarser(volume: &Volume) -> Volume {
    coarser_by(volume, BoxFilter::Four)
}

/// Levels of a volume's pyramid, the volume itself being level 0: each half the size of the one before, until none has more than
/// 64 voxels along an axis, and always two.
pub fn levels(dims: [usize; 3]) -> usize {
    const SMALLEST: usize = 64;
    let mut largest = dims.into_iter().max().unwrap_or(1);
    let mut levels = 1;
    while levels < 2 || largest > SMALLEST {
        largest = halved(largest);
        levels += 1;
    }
    levels
}

/// How many voxels along an axis a colour volume's voxel of the next level is the mean of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoxFilter {
    Two,
    Four,
}

/// [`coarser`] with a filter for colours.
pub fn coarser_by(volume: &Volume, filter: BoxFilter) -> Volume {
    let dims = volume.dims().map(halved);
    if let Some(colors) = volume.colors() {
        let colors = averaged(colors, volume.dims(), dims, filter);
        return Volume::of_colors(dims, stretched(volume), colors, volume.report().clone())
            .expect("half of a sound volume is sound");
    }
    let scalars = match volume.scalars() {
        Scalars::U8(codes) => Scalars::U8(filtered(codes, volume.dims(), dims)),
        Scalars::U16(codes) => Scalars::U16(filtered(codes, volume.dims(), dims)),
    };
    Volume::new(dims, stretched(volume), scalars, volume.rescale(), volume.report().clone())
        .expect("half of a sound volume is sound")
}

/// A level's labels, `dims` of them: names have no mean, so each voxel has that of the voxel of `labels` that is next to where it stands.
pub fn labels_of_level(labels: &Volume, dims: [usize; 3]) -> Scalars {
    let nearest = |axis: usize| {
        // Outermost voxels stand on the box's faces, on all levels.
        let spacing = (labels.dims()[axis] - 1) as f64 / (dims[axis] - 1) as f64;
        (0..dims[axis]).map(|at| (at as f64 * spacing).round() as usize).collect::<Vec<_>>()
    };
    let [x, y, z] = [0, 1, 2].map(nearest);
    let [nx, ny, _] = labels.dims();
    let rows = z.iter().flat_map(|k| y.iter().map(move |j| (k * ny + j) * nx));
    fn picked<T: Copy>(codes: &[T], rows: impl Iterator<Item = usize>, x: &[usize]) -> Vec<T> {
        rows.flat_map(|row| x.iter().map(move |i| codes[row + i])).collect()
    }
    match labels.scalars() {
        Scalars::U8(codes) => Scalars::U8(picked(codes, rows, &x)),
        Scalars::U16(codes) => Scalars::U16(picked(codes, rows, &x)),
    }
}

/// Where the voxels of the next level stand.
fn stretched(volume: &Volume) -> Placement {
    let stretch = DVec3::from_array([0, 1, 2].map(|axis| spacing(volume.dims()[axis])));
    Placement { spacing: volume.placement().spacing * stretch, ..*volume.placement() }
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

/// The voxels of `n` along an axis that a box of `width` covers around coarse voxel `at`, and their weights. Beyond the
/// outermost voxels lies more of them. Two voxels stay two, each itself.
fn covered(at: usize, n: usize, width: f64) -> impl Iterator<Item = (usize, f64)> {
    let width = if halved(n) == n { 1.0 } else { width };
    let place = at as f64 * spacing(n);
    let [from, to] = [place - width / 2.0, place + width / 2.0];
    ((from + 0.5).floor() as isize..=(to + 0.5).floor() as isize).filter_map(move |voxel| {
        let weight = (to.min(voxel as f64 + 0.5) - from.max(voxel as f64 - 0.5)) / width;
        (weight > 0.0).then_some((voxel.clamp(0, n as isize - 1) as usize, weight))
    })
}

/// Nothing is quite opaque: the optical model's bound.
const MAX_ALPHA: f64 = 1.0 - 1e-7;

/// Means of extinction and of colour weighted by it; of luminance, whose opacity is not known yet, plain ones.
fn averaged(colors: &Colors, fine: [usize; 3], coarse: [usize; 3], filter: BoxFilter) -> Colors {
    let width = match filter {
        BoxFilter::Two => 2.0,
        BoxFilter::Four => 4.0,
    };
    // Of an alpha over its own length.
    let of_alpha = |alpha: u8| -(-(f64::from(alpha) / 255.0).min(MAX_ALPHA)).ln_1p();
    let extinction: Vec<f64> =
        (0..=u8::MAX).map(|alpha| if colors.has_alpha { of_alpha(alpha) } else { 1.0 }).collect();
    let taps = [0, 1, 2].map(|axis| {
        let of_voxel = |at: usize| covered(at, fine[axis], width).collect::<Vec<_>>();
        (0..coarse[axis]).map(of_voxel).collect::<Vec<_>>()
    });
    let mean = |[x, y, z]: [usize; 3]| {
        let mut sum = DVec4::ZERO;
        for &(k, weight_k) in &taps[2][z] {
            for &(j, weight_j) in &taps[1][y] {
                for &(i, weight_i) in &taps[0][x] {
                    let [r, g, b, alpha] = colors.voxels[(k * fine[1] + j) * fine[0] + i];
                    let weight = extinction[usize::from(alpha)] * (weight_i * weight_j * weight_k);
                    sum += DVec3::new(r.into(), g.into(), b.into()).extend(1.0) * weight;
                }
            }
        }
        let [r, g, b] =
            if sum.w > 0.0 { sum.truncate() / sum.w } else { DVec3::ZERO }.to_array().map(|c| c.round() as u8);
        let alpha = (-255.0 * (-sum.w).exp_m1()).round() as u8;
        [r, g, b, if colors.has_alpha { alpha } else { Colors::luminance([r, g, b]) }]
    };
    let plane = |z: usize| (0..coarse[1] * coarse[0]).map(move |n| [n % coarse[0], n / coarse[0], z]);
    let voxels = (0..coarse[2]).into_par_iter().flat_map_iter(|z| plane(z).map(mean)).collect();
    Colors { voxels, has_alpha: colors.has_alpha }
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
    fn labels_of_a_level_are_those_next_to_its_voxels() {
        let dims = [7, 4, 2];
        let labels: Vec<u8> = (0..7 * 4 * 2).collect();
        let report = ImportReport::plain("test", ScalarType::U8);
        let placement = Placement::from_spacing(DVec3::ONE);
        let labels = Volume::new(dims, placement, Scalars::U8(labels), (1.0, 0.0), report).unwrap();
        // Places 0, 2, 4, 6 along x, 0 and 3 along y.
        let Scalars::U8(coarse) = labels_of_level(&labels, [4, 2, 2]) else { panic!("another type") };
        assert_eq!(coarse, [0, 2, 4, 6, 21, 23, 25, 27, 28, 30, 32, 34, 49, 51, 53, 55]);
        // Of the level after that, 0 and 6: 3 lies halfway.
        let Scalars::U8(coarse) = labels_of_level(&labels, [3, 2, 2]) else { panic!("another type") };
        assert_eq!(coarse[..3], [0, 3, 6]);
    }

    #[test]
    fn a_pyramid_ends_where_there_is_little_left() {
        for (largest, count) in [(2, 2), (64, 2), (65, 2), (128, 2), (129, 3), (256, 3), (512, 4)] {
            assert_eq!(levels([2, largest, 3]), count, "{largest}");
        }
    }

    #[test]
    fn two_voxels_of_colour_stay_two() {
        let (dims, red, blue) = ([9, 8, 2], [255, 0, 0, 255], [0, 0, 255, 255]);
        let voxels = [vec![red; 72], vec![blue; 72]].concat();
        let report = ImportReport::plain("test", ScalarType::U8);
        let placement = Placement::from_spacing(DVec3::ONE);
        let volume = Volume::of_colors(dims, placement, Colors { voxels, has_alpha: true }, report).unwrap();
        for filter in [BoxFilter::Two, BoxFilter::Four] {
            let coarse = coarser_by(&volume, filter);
            assert_eq!(coarse.dims(), [5, 4, 2]);
            let (front, back) = coarse.colors().unwrap().voxels.split_at(20);
            assert!(front.iter().all(|voxel| *voxel == red) && back.iter().all(|voxel| *voxel == blue));
        }
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
