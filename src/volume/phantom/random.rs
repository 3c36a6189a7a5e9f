//! Noise without a generator's state: a hash of the lattice point.
//!
//! Every voxel can be made on any thread in any order, and the same on every machine: the hash is
//! integer arithmetic, the interpolation uses nothing but sums and products, which IEEE 754 rounds
//! alike everywhere (no sines or exponentials, whose last bits depend on the platform).

use glam::Vec4;

use super::shape::{Points, at, mix};

/// A well-mixed hash of a lattice point (the finalizer of MurmurHash3 over a linear combination).
pub fn hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let mut h = seed
        ^ (x as u32).wrapping_mul(0x9e37_79b1)
        ^ (y as u32).wrapping_mul(0x85eb_ca77).rotate_left(11)
        ^ (z as u32).wrapping_mul(0xc2b2_ae3d).rotate_left(22);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// A hash as a number in -1..=1.
pub fn signed(h: u32) -> f32 {
    (h >> 8) as f32 * (2.0 / 16_777_215.0) - 1.0
}

/// Bell-shaped noise with mean 0 and standard deviation 1: the sum of a hash's four bytes.
pub fn bell(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    // Each byte is uniform over 0..=255: mean 127.5, variance (256^2 - 1) / 12.
    const DEVIATION: f32 = 147.8;
    let sum: u32 = hash(x, y, z, seed).to_le_bytes().into_iter().map(u32::from).sum();
    (sum as f32 - 510.0) / DEVIATION
}

/// Smooth noise in -1..=1 with one random value per unit cube corner, smoothstep between them.
pub fn smooth(p: Points, seed: u32) -> Vec4 {
    let cell = at(p.x.floor(), p.y.floor(), p.z.floor());
    let step = |p: Vec4, cell: Vec4| {
        let t = p - cell;
        t * t * (3.0 - 2.0 * t)
    };
    let [tx, ty, tz] = [step(p.x, cell.x), step(p.y, cell.y), step(p.z, cell.z)];
    let corners_of = |x: f32, y: f32, z: f32| -> [f32; 8] {
        let [x, y, z] = [x, y, z].map(|c| c as i32);
        std::array::from_fn(|corner| {
            let [dx, dy, dz] = [0, 1, 2].map(|axis| (corner >> axis & 1) as i32);
            signed(hash(x + dx, y + dy, z + dz, seed))
        })
    };
    let [x, y, z] = [cell.x, cell.y, cell.z].map(|c| c.to_array());
    let mut by_lane = [corners_of(x[0], y[0], z[0]); 4];
    for lane in 1..4 {
        // Neighbours share a cell more often than not.
        let same = x[lane] == x[lane - 1] && y[lane] == y[lane - 1] && z[lane] == z[lane - 1];
        by_lane[lane] = if same { by_lane[lane - 1] } else { corners_of(x[lane], y[lane], z[lane]) };
    }
    let [a, b, c, d] = by_lane;
    let corners: [Vec4; 8] = std::array::from_fn(|corner| Vec4::new(a[corner], b[corner], c[corner], d[corner]));
    let row = |first: usize| mix(corners[first], corners[first + 1], tx);
    let plane = |first: usize| mix(row(first), row(first + 2), ty);
    mix(plane(0), plane(4), tz)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bell_noise_has_mean_zero_and_unit_deviation() {
        let samples: Vec<f64> = (0..40_000).map(|i| f64::from(bell(i % 40, i / 40 % 40, i / 1600, 7))).collect();
        let mean = samples.iter().sum::<f64>() / samples.len() as f64;
        let variance = samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / samples.len() as f64;
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
    }

    #[test]
    fn smooth_noise_is_continuous_and_within_bounds() {
        let noise = |i: i32| smooth(at(i as f32 * 0.01, 0.3, -2.7), 1).x;
        for i in -500..500 {
            assert!((noise(i + 1) - noise(i)).abs() < 0.05 && noise(i).abs() <= 1.0);
        }
    }
}
