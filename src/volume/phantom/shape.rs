//! Signed distance functions: solids as functions from a point to its distance from the surface,
//! negative inside, in mm.
//!
//! Solids combine by taking minima and maxima; the smooth variants round the seam over a width `k`,
//! which is what makes flesh look like flesh. Distances of ellipsoids and of combinations are
//! approximate, but right near the surface, where they are used. Only sums, products, divisions and
//! square roots: the same bits on every machine.

use glam::Vec3;

/// A point or vector in mm (LPS).
pub const fn v(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

/// The same point on the left side: what is given once there exists on both.
pub fn mirrored(p: Vec3) -> Vec3 {
    v(p.x.abs(), p.y, p.z)
}

pub fn sphere(p: Vec3, centre: Vec3, radius: f32) -> f32 {
    (p - centre).length() - radius
}

pub fn ellipsoid(p: Vec3, centre: Vec3, radii: Vec3) -> f32 {
    let q = (p - centre) / radii;
    let (scaled, slope) = (q.length(), (q / radii).length());
    if slope < 1e-6 { -radii.min_element() } else { scaled * (scaled - 1.0) / slope }
}

/// A limb from `a` to `b` whose radius changes evenly from `ra` to `rb`, with round ends.
pub fn limb(p: Vec3, (a, ra): (Vec3, f32), (b, rb): (Vec3, f32)) -> f32 {
    let (axis, from_a) = (b - a, p - a);
    let t = (from_a.dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
    (from_a - axis * t).length() - (ra + (rb - ra) * t)
}

/// Limbs end to end.
pub fn chain(p: Vec3, joints: &[(Vec3, f32)]) -> f32 {
    joints.windows(2).map(|pair| limb(p, pair[0], pair[1])).fold(f32::INFINITY, f32::min)
}

/// A box of half sizes `half`, its edges rounded by `round` (within the sizes).
pub fn slab(p: Vec3, centre: Vec3, half: Vec3, round: f32) -> f32 {
    let q = (p - centre).abs() - (half - Vec3::splat(round));
    q.max(Vec3::ZERO).length() + q.max_element().min(0.0) - round
}

/// A ring around the unit vector `axis`.
pub fn ring(p: Vec3, centre: Vec3, axis: Vec3, radius: f32, thickness: f32) -> f32 {
    let q = p - centre;
    let along = q.dot(axis);
    let across = (q - axis * along).length() - radius;
    (across * across + along * along).sqrt() - thickness
}

/// Union, its seam filled over a width `k`.
pub fn join(a: f32, b: f32, k: f32) -> f32 {
    let h = (k - (a - b).abs()).max(0.0);
    a.min(b) - h * h / (4.0 * k)
}

/// `a` without `b`, its edge rounded over a width `k`.
pub fn carve(a: f32, b: f32, k: f32) -> f32 {
    -join(-a, b, k)
}

/// What is in both, its edge rounded over a width `k`.
pub fn meet(a: f32, b: f32, k: f32) -> f32 {
    -join(-a, -b, k)
}

/// Share of a voxel (0..=1) that a solid fills whose surface is `distance` away, seen by a scanner
/// that blurs edges over `blur` mm.
pub fn coverage(distance: f32, blur: f32) -> f32 {
    (0.5 - distance / blur).clamp(0.0, 1.0)
}
