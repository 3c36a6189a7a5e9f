//! Noise without a generator's state: a hash of the lattice point.
//!
//! Every voxel can be made on any thread in any order, and the same on every machine: the hash is
//! integer arithmetic, the interpolation uses nothing but sums and products, which IEEE 754 rounds
//! alike everywhere (no sines or exponentials, whose last bits depend on the platform).

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
pub fn smooth(p: glam::Vec3, seed: u32) -> f32 {
    let cell = p.floor();
    let t = p - cell;
    let t = t * t * (glam::Vec3::splat(3.0) - 2.0 * t);
    let (x, y, z) = (cell.x as i32, cell.y as i32, cell.z as i32);
    let corner = |dx: i32, dy: i32, dz: i32| signed(hash(x + dx, y + dy, z + dz, seed));
    let row = |dy, dz| mix(corner(0, dy, dz), corner(1, dy, dz), t.x);
    let plane = |dz| mix(row(0, dz), row(1, dz), t.y);
    mix(plane(0), plane(1), t.z)
}

/// `a` at t = 0, `b` at t = 1.
pub fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
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
        let at = |i: i32| smooth(glam::Vec3::new(i as f32 * 0.01, 0.3, -2.7), 1);
        for i in -500..500 {
            assert!((at(i + 1) - at(i)).abs() < 0.05 && at(i).abs() <= 1.0);
        }
    }
}
