//! Signed distance functions: solids as functions from a point to its distance from the surface,
//! negative inside, in mm.
//!
//! Solids combine by taking minima and maxima; the smooth variants round the seam over a width `k`,
//! which is what makes flesh look like flesh. Distances of ellipsoids and of combinations are
//! approximate, but right near the surface, where they are used. Only sums, products, divisions and
//! square roots: the same bits on every machine.
//!
//! All of them take four points at once, one in each lane: square roots and divisions are most of the
//! work, and four take as long as one.

use std::ops::{Div, Mul, Sub};

use glam::{BVec4A, Vec3, Vec4};

/// A point or vector in mm (LPS).
#[inline]
pub const fn v(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

/// Four points in mm (LPS), by coordinate.
#[derive(Clone, Copy, Debug)]
pub struct Points {
    pub x: Vec4,
    pub y: Vec4,
    pub z: Vec4,
}

/// Points with these coordinates.
#[inline]
pub fn at(x: impl Lanes, y: impl Lanes, z: impl Lanes) -> Points {
    Points { x: x.lanes(), y: y.lanes(), z: z.lanes() }
}

impl Points {
    /// The same point four times.
    #[inline]
    pub fn all(p: Vec3) -> Self {
        at(p.x, p.y, p.z)
    }

    #[inline]
    pub fn dot(self, other: Vec3) -> Vec4 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline]
    pub fn length(self) -> Vec4 {
        (self.x * self.x + self.y * self.y + self.z * self.z).sqrt()
    }

    #[inline]
    pub fn abs(self) -> Self {
        at(self.x.abs(), self.y.abs(), self.z.abs())
    }

    #[inline]
    pub fn max_element(self) -> Vec4 {
        self.x.max(self.y).max(self.z)
    }

    /// Less `share` of a vector.
    #[inline]
    fn without(self, vector: Vec3, share: Vec4) -> Self {
        at(self.x - vector.x * share, self.y - vector.y * share, self.z - vector.z * share)
    }
}

impl Sub<Vec3> for Points {
    type Output = Self;

    #[inline]
    fn sub(self, other: Vec3) -> Self {
        at(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl Mul<Vec3> for Points {
    type Output = Self;

    #[inline]
    fn mul(self, other: Vec3) -> Self {
        at(self.x * other.x, self.y * other.y, self.z * other.z)
    }
}

impl Div<f32> for Points {
    type Output = Self;

    #[inline]
    fn div(self, divisor: f32) -> Self {
        at(self.x / divisor, self.y / divisor, self.z / divisor)
    }
}

/// A number for each of four points, or one for all of them.
pub trait Lanes {
    fn lanes(self) -> Vec4;
}

impl Lanes for f32 {
    #[inline]
    fn lanes(self) -> Vec4 {
        Vec4::splat(self)
    }
}

impl Lanes for Vec4 {
    #[inline]
    fn lanes(self) -> Vec4 {
        self
    }
}

/// Where `a` is less than a limit.
#[inline]
pub fn below(a: Vec4, limit: f32) -> BVec4A {
    a.cmplt(Vec4::splat(limit))
}

/// Where `a` is more than a limit.
#[inline]
pub fn above(a: Vec4, limit: f32) -> BVec4A {
    a.cmpgt(Vec4::splat(limit))
}

/// `a` at t = 0, `b` at t = 1.
#[inline]
pub fn mix(a: impl Lanes, b: impl Lanes, t: impl Lanes) -> Vec4 {
    let (a, b) = (a.lanes(), b.lanes());
    a + (b - a) * t.lanes()
}

/// The same points on the left side: what is given once there exists on both.
#[inline]
pub fn mirrored(p: Points) -> Points {
    at(p.x.abs(), p.y, p.z)
}

#[inline]
pub fn sphere(p: Points, centre: Vec3, radius: f32) -> Vec4 {
    (p - centre).length() - radius
}

#[inline]
pub fn ellipsoid(p: Points, centre: Vec3, radii: Vec3) -> Vec4 {
    let per_radius = radii.recip();
    let q = (p - centre) * per_radius;
    let (scaled, slope) = (q.length(), (q * per_radius).length());
    let inside = Vec4::splat(-radii.min_element());
    Vec4::select(slope.cmplt(Vec4::splat(1e-6)), inside, scaled * (scaled - 1.0) / slope)
}

/// A limb from `a` to `b` whose radius changes evenly from `ra` to `rb`, with round ends.
#[inline]
pub fn limb(p: Points, (a, ra): (Vec3, f32), (b, rb): (Vec3, f32)) -> Vec4 {
    let (axis, from_a) = (b - a, p - a);
    let t = (from_a.dot(axis) * axis.length_squared().recip()).clamp(Vec4::ZERO, Vec4::ONE);
    from_a.without(axis, t).length() - (ra + (rb - ra) * t)
}

/// Limbs end to end.
#[inline]
pub fn chain(p: Points, joints: &[(Vec3, f32)]) -> Vec4 {
    joints.windows(2).map(|pair| limb(p, pair[0], pair[1])).fold(Vec4::INFINITY, Vec4::min)
}

/// A box of half sizes `half`, its edges rounded by `round` (within the sizes).
#[inline]
pub fn slab(p: Points, centre: Vec3, half: Vec3, round: f32) -> Vec4 {
    let q = (p - centre).abs() - (half - Vec3::splat(round));
    let beyond = at(q.x.max(Vec4::ZERO), q.y.max(Vec4::ZERO), q.z.max(Vec4::ZERO));
    beyond.length() + q.max_element().min(Vec4::ZERO) - round
}

/// A ring around the unit vector `axis`.
#[inline]
pub fn ring(p: Points, centre: Vec3, axis: Vec3, radius: f32, thickness: f32) -> Vec4 {
    let q = p - centre;
    let along = q.dot(axis);
    let across = q.without(axis, along).length() - radius;
    (across * across + along * along).sqrt() - thickness
}

/// Union, its seam filled over a width `k`.
#[inline]
pub fn join(a: Vec4, b: Vec4, k: f32) -> Vec4 {
    let h = (k - (a - b).abs()).max(Vec4::ZERO);
    a.min(b) - h * h * (0.25 * k.recip())
}

/// `a` without `b`, its edge rounded over a width `k`.
#[inline]
pub fn carve(a: Vec4, b: Vec4, k: f32) -> Vec4 {
    -join(-a, b, k)
}

/// What is in both, its edge rounded over a width `k`.
#[inline]
pub fn meet(a: Vec4, b: Vec4, k: f32) -> Vec4 {
    -join(-a, -b, k)
}

/// Share of a voxel (0..=1) that a solid fills whose surface is `distance` away, seen by a scanner
/// that blurs edges over `blur` mm. A smooth step: gradients are continuous too, and so is shading.
#[inline]
pub fn coverage(distance: Vec4, blur: f32) -> Vec4 {
    let t = (0.5 - distance * blur.recip()).clamp(Vec4::ZERO, Vec4::ONE);
    t * t * (3.0 - 2.0 * t)
}
