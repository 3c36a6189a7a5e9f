//! Volumes that a formula describes, so that a picture of them can be computed by hand.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::random;
use super::shape::Points;
use crate::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

/// A volume of 16-bit codes (value = code) at origin 0 with the identity direction, its voxels
/// `value(i, j, k)` rounded and clamped to 0..=65535. Computed in parallel.
///
/// # Panics
/// Where `dims` or `spacing` (mm) are not those of a [`Volume`].
pub fn from_fn(dims: [usize; 3], spacing: [f64; 3], value: impl Fn(usize, usize, usize) -> f64 + Sync) -> Volume {
    let [nx, ny, nz] = dims;
    let mut codes = vec![0_u16; nx * ny * nz];
    codes.par_chunks_mut((nx * ny).max(1)).enumerate().for_each(|(k, slice)| {
        for (index, code) in slice.iter_mut().enumerate() {
            // The cast saturates, and takes NaN to 0.
            *code = value(index % nx, index / nx, k).round() as u16;
        }
    });
    let report = ImportReport::plain("phantom", ScalarType::U16);
    Volume::new(dims, Placement::from_spacing(DVec3::from_array(spacing)), Scalars::U16(codes), (1.0, 0.0), report)
        .expect("a phantom's dimensions and spacing make a volume")
}

/// The same `value` everywhere, spacing 1 mm.
pub fn uniform(dims: [usize; 3], value: f64) -> Volume {
    from_fn(dims, [1.0; 3], |_, _, _| value)
}

/// A cube of `value` in `n`^3 voxels of 1 mm, surrounded by `margin` voxels of zero on every side.
pub fn cube(n: usize, margin: usize, value: f64) -> Volume {
    let inside = margin..n.saturating_sub(margin);
    from_fn([n; 3], [1.0; 3], |i, j, k| if [i, j, k].iter().all(|c| inside.contains(c)) { value } else { 0.0 })
}

/// A ball of `value` around the middle of `n`^3 voxels of 1 mm. Across its surface at `radius` (mm)
/// the value falls to zero linearly over a shell `soft` mm thick (partial volume); 0 makes it hard.
pub fn ball(n: usize, radius: f64, value: f64, soft: f64) -> Volume {
    let middle = DVec3::splat((n as f64 - 1.0) / 2.0);
    from_fn([n; 3], [1.0; 3], |i, j, k| {
        let depth = radius - (DVec3::new(i as f64, j as f64, k as f64) - middle).length();
        let share = if soft > 0.0 { (0.5 + depth / soft).clamp(0.0, 1.0) } else { f64::from(u8::from(depth >= 0.0)) };
        share * value
    })
}

/// Values that rise by 100 per voxel along `axis` (0, 1, 2), from 0; `n`^3 voxels of 1 mm. The
/// gradient is 100 per mm along the axis and zero across it.
pub fn ramp(n: usize, axis: usize) -> Volume {
    from_fn([n; 3], [1.0; 3], |i, j, k| 100.0 * [i, j, k][axis] as f64)
}

/// Smooth random blobs, values 0..=4000, about half of the voxels zero; spacing 1 mm. Three octaves
/// of noise, the coarsest with a blob every 12 mm.
pub fn noise(dims: [usize; 3], seed: u32) -> Volume {
    from_fn(dims, [1.0; 3], |i, j, k| {
        let p = Vec3::new(i as f32, j as f32, k as f32);
        let octave = |size: f32, seed| random::smooth(Points::all(p / size), seed).x;
        let sum =
            octave(12.0, seed) + 0.5 * octave(6.0, seed.wrapping_add(1)) + 0.25 * octave(3.0, seed.wrapping_add(2));
        f64::from(sum.clamp(0.0, 1.0)) * 4000.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(volume: &Volume, [i, j, k]: [usize; 3]) -> u16 {
        let [nx, ny, _] = volume.dims();
        volume.scalars().code((k * ny + j) * nx + i)
    }

    #[test]
    fn a_cube_has_its_volume_and_an_empty_margin() {
        let cube = cube(10, 2, 7.0);
        let Scalars::U16(codes) = cube.scalars() else { panic!("phantoms have 16-bit codes") };
        assert_eq!(codes.iter().filter(|&&c| c == 7).count(), 6 * 6 * 6);
        assert_eq!(code(&cube, [1, 5, 5]), 0);
        assert_eq!(code(&cube, [2, 7, 2]), 7);
    }

    #[test]
    fn a_soft_ball_has_the_volume_of_a_ball() {
        let ball = ball(41, 15.0, 1000.0, 2.0);
        let Scalars::U16(codes) = ball.scalars() else { panic!("phantoms have 16-bit codes") };
        let sum: f64 = codes.iter().map(|&c| f64::from(c) / 1000.0).sum();
        let expected = 4.0 / 3.0 * std::f64::consts::PI * 15_f64.powi(3);
        assert!((sum / expected - 1.0).abs() < 0.01, "{sum} against {expected}");
        assert_eq!(code(&ball, [20, 20, 20]), 1000);
        assert_eq!(code(&ball, [0, 20, 20]), 0);
    }

    #[test]
    fn a_ramp_rises_along_its_axis_alone() {
        for axis in 0..3 {
            let ramp = ramp(5, axis);
            let mut at = [1, 2, 3];
            let before = code(&ramp, at);
            at[axis] += 1;
            assert_eq!(code(&ramp, at), before + 100);
            at[(axis + 1) % 3] -= 1;
            assert_eq!(code(&ramp, at), before + 100);
        }
    }

    #[test]
    fn noise_depends_on_its_seed_and_is_half_empty() {
        let blobs = noise([48, 40, 32], 1);
        assert_eq!(blobs, noise([48, 40, 32], 1));
        assert_ne!(blobs, noise([48, 40, 32], 2));
        let Scalars::U16(codes) = blobs.scalars() else { panic!("phantoms have 16-bit codes") };
        let empty = codes.iter().filter(|&&c| c == 0).count() as f64 / codes.len() as f64;
        assert!((0.3..0.7).contains(&empty), "{empty}");
    }
}
