//! Gradients, gradient magnitude and quantized normals.
//!
//! Gradients are central differences in world mm with indices clamped at the border and a divisor
//! of twice the spacing. What a frame needs of them is the surface normal, and it needs it for
//! every voxel it draws in every frame, so normals are computed once per volume and quantized
//! (Lacroute and Levoy 1994, section 3.1: shading from a lookup table indexed by an encoded
//! normal).
//!
//! Lighting is two-sided: a normal and its opposite are lit alike. So only a hemisphere is
//! encoded, by an octahedral map folded at the equator: one division, no trigonometry, cells of
//! nearly equal size. With [`NORMAL_STEPS`] steps a side the angle between a normal and its code
//! stays under 1.1 degrees (a test measures it). Thirteen bits over the whole sphere, as VolPack has
//! them, are twice as coarse in angle and show bands on smooth skulls; sixteen bits make the
//! shading table outgrow the second-level cache.
//!
//! Normals are kept in the volume's own frame, so that turning a volume in the world changes no
//! bit of them; a frame turns its lights instead.

use std::sync::LazyLock;

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::{Placement, Scalars, Volume};

/// Steps along each side of the folded octahedral map.
pub const NORMAL_STEPS: usize = 128;
/// The code of a gradient of zero, which has no normal.
pub const NO_NORMAL: u16 = (NORMAL_STEPS * NORMAL_STEPS) as u16;
/// Number of normal codes, [`NO_NORMAL`] included.
pub const NORMAL_CODES: usize = NORMAL_STEPS * NORMAL_STEPS + 1;

const _: () = assert!(NORMAL_CODES <= 1 << 15, "a voxel keeps its normal in 15 bits");

/// One code of 8 or 16 bits.
pub trait Code: Copy + Ord + Send + Sync + Into<u16> + 'static {
    /// As a number.
    fn as_f32(self) -> f32;
}

impl Code for u8 {
    fn as_f32(self) -> f32 {
        f32::from(self)
    }
}

impl Code for u16 {
    fn as_f32(self) -> f32 {
        f32::from(self)
    }
}

/// The frame in which a volume's normals are kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GradientFrame {
    /// World from frame: orthonormal, of either handedness.
    pub world_from_frame: DMat3,
    /// Frame gradient from differences of codes along i, j, k (not yet divided by anything).
    pub frame_from_differences: DMat3,
    /// True where [`Self::frame_from_differences`] is diagonal: an orthogonal direction matrix.
    pub diagonal: bool,
}

impl GradientFrame {
    /// For a volume at `placement` whose values are `slope` per code.
    ///
    /// The gradient in the world is `direction^-T` times the differences per mm. The frame is the
    /// direction matrix itself where that is orthogonal, else its Gram-Schmidt basis.
    pub fn new(placement: &Placement, slope: f64) -> Self {
        let per_mm = DMat3::from_diagonal(slope / (2.0 * placement.spacing));
        let direction = placement.direction;
        let skew = direction.transpose() * direction - DMat3::IDENTITY;
        if skew.to_cols_array().iter().all(|e| e.abs() < 1e-5) {
            return Self { world_from_frame: direction, frame_from_differences: per_mm, diagonal: true };
        }
        let x = direction.x_axis.normalize();
        let y = (direction.y_axis - x * x.dot(direction.y_axis)).normalize();
        let z = direction.z_axis - x * x.dot(direction.z_axis) - y * y.dot(direction.z_axis);
        let frame = DMat3::from_cols(x, y, z.normalize());
        let to_frame = frame.transpose() * direction.inverse().transpose() * per_mm;
        Self { world_from_frame: frame, frame_from_differences: to_frame, diagonal: false }
    }
}

/// Differences of codes across one row of voxels, ready to be scaled: scratch of a pass.
#[derive(Debug)]
pub struct GradientRow {
    /// Gradient along the frame's axes, one array each, `nx` long.
    pub components: [Vec<f32>; 3],
}

impl GradientRow {
    /// Scratch for rows of `nx` voxels.
    pub fn new(nx: usize) -> Self {
        Self { components: std::array::from_fn(|_| vec![0.0; nx]) }
    }

    /// Computes the row (j, k) of `codes`.
    pub fn compute<T: Code>(&mut self, codes: &[T], dims: [usize; 3], frame: &GradientFrame, j: usize, k: usize) {
        let [nx, ny, nz] = dims;
        let row = |j: usize, k: usize| &codes[(k * ny + j) * nx..][..nx];
        let here = row(j, k);
        let (before_j, after_j) = (row(j.saturating_sub(1), k), row((j + 1).min(ny - 1), k));
        let (before_k, after_k) = (row(j, k.saturating_sub(1)), row(j, (k + 1).min(nz - 1)));
        let [gi, gj, gk] = &mut self.components;
        for (g, pair) in gi[1..nx - 1].iter_mut().zip(here.windows(3)) {
            *g = pair[2].as_f32() - pair[0].as_f32();
        }
        gi[0] = here[1].as_f32() - here[0].as_f32();
        gi[nx - 1] = here[nx - 1].as_f32() - here[nx - 2].as_f32();
        for ((g, after), before) in gj.iter_mut().zip(after_j).zip(before_j) {
            *g = after.as_f32() - before.as_f32();
        }
        for ((g, after), before) in gk.iter_mut().zip(after_k).zip(before_k) {
            *g = after.as_f32() - before.as_f32();
        }
        self.turn(frame);
    }

    fn turn(&mut self, frame: &GradientFrame) {
        let m = frame.frame_from_differences.as_mat3();
        let [gi, gj, gk] = &mut self.components;
        if frame.diagonal {
            let scale = [m.x_axis.x, m.y_axis.y, m.z_axis.z];
            for (component, scale) in [gi, gj, gk].into_iter().zip(scale) {
                component.iter_mut().for_each(|g| *g *= scale);
            }
        } else {
            for ((x, y), z) in gi.iter_mut().zip(gj).zip(gk) {
                [*x, *y, *z] = (m * Vec3::new(*x, *y, *z)).to_array();
            }
        }
    }

    /// Squared gradient magnitude of every voxel of the row.
    pub fn squared_magnitudes(&self, out: &mut [f32]) {
        let [x, y, z] = &self.components;
        for (((out, x), y), z) in out.iter_mut().zip(x).zip(y).zip(z) {
            *out = x * x + y * y + z * z;
        }
    }

    /// Code of every voxel's normal.
    pub fn normals(&self, out: &mut [u16]) {
        let [x, y, z] = &self.components;
        for (((out, &x), &y), &z) in out.iter_mut().zip(x).zip(y).zip(z) {
            *out = encode_normal(x, y, z);
        }
    }
}

/// The code of a normal of any length, or of its opposite; [`NO_NORMAL`] for zero.
#[inline(always)]
pub fn encode_normal(x: f32, y: f32, z: f32) -> u16 {
    let length = x.abs() + y.abs() + z.abs();
    let flip = 1f32.copysign(z);
    let scale = flip / if length > 0.0 { length } else { 1.0 };
    // Where z >= 0 the octahedron's upper half is the diamond |x| + |y| <= 1; turned by 45
    // degrees it fills the square -1..1.
    let (px, py) = (x * scale, y * scale);
    let u = nearest_step(px + py);
    let v = nearest_step(px - py);
    let code = v * NORMAL_STEPS as u32 + u;
    if length > 0.0 { code as u16 } else { NO_NORMAL }
}

/// -1..=1 to the nearest of 0..NORMAL_STEPS. Adding 2^23 rounds to an integer and leaves it in the
/// low mantissa bits, which vectorizes where a saturating cast does not.
#[inline(always)]
fn nearest_step(p: f32) -> u32 {
    const HALF: f32 = (NORMAL_STEPS - 1) as f32 / 2.0;
    ((p * HALF + HALF) + 8_388_608.0).to_bits() & 0xffff
}

/// The unit normal of a code; zero for [`NO_NORMAL`].
pub fn decode_normal(code: u16) -> Vec3 {
    if code >= NO_NORMAL {
        return Vec3::ZERO;
    }
    let steps = (NORMAL_STEPS - 1) as f32;
    let u = 2.0 * (usize::from(code) % NORMAL_STEPS) as f32 / steps - 1.0;
    let v = 2.0 * (usize::from(code) / NORMAL_STEPS) as f32 / steps - 1.0;
    let (x, y) = ((u + v) / 2.0, (u - v) / 2.0);
    Vec3::new(x, y, 1.0 - x.abs() - y.abs()).normalize()
}

/// Every code's unit normal, one array for each axis: what a shading table is computed from.
pub static NORMALS: LazyLock<[Vec<f32>; 3]> = LazyLock::new(|| {
    let normals: Vec<Vec3> = (0..NORMAL_CODES).map(|code| decode_normal(code as u16)).collect();
    std::array::from_fn(|axis| normals.iter().map(|n| n[axis]).collect())
});

/// The normal codes of all voxels, `i` fastest.
pub fn quantized_normals(volume: &Volume) -> Vec<u16> {
    fn pass<T: Code>(codes: &[T], volume: &Volume) -> Vec<u16> {
        let dims @ [nx, ny, _] = volume.dims();
        let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
        let mut normals = vec![0; codes.len()];
        normals.par_chunks_mut(nx * ny).enumerate().for_each_init(
            || GradientRow::new(nx),
            |scratch, (k, slice)| {
                for (j, out) in slice.chunks_exact_mut(nx).enumerate() {
                    scratch.compute(codes, dims, &frame, j, k);
                    scratch.normals(out);
                }
            },
        );
        normals
    }
    match volume.scalars() {
        Scalars::U8(codes) => pass(codes, volume),
        Scalars::U16(codes) => pass(codes, volume),
    }
}

/// The world gradient at voxel (i, j, k) in scalar units per mm: the plain twin of the rows above.
pub fn gradient_at(volume: &Volume, frame: &GradientFrame, [i, j, k]: [usize; 3]) -> DVec3 {
    let [nx, ny, nz] = volume.dims();
    let code = |i: usize, j: usize, k: usize| f64::from(volume.scalars().code((k * ny + j) * nx + i));
    let differences = DVec3::new(
        code((i + 1).min(nx - 1), j, k) - code(i.saturating_sub(1), j, k),
        code(i, (j + 1).min(ny - 1), k) - code(i, j.saturating_sub(1), k),
        code(i, j, (k + 1).min(nz - 1)) - code(i, j, k.saturating_sub(1)),
    );
    frame.world_from_frame * (frame.frame_from_differences * differences)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_is_within_a_degree_and_a_tenth_of_its_normal_or_of_the_opposite() {
        let mut worst = 0f32;
        for step in 0..200_000u32 {
            // A spiral over the sphere.
            let z = 1.0 - 2.0 * (step as f32 + 0.5) / 200_000.0;
            let angle = step as f32 * 2.399_963_2;
            let r = (1.0 - z * z).sqrt();
            let normal = Vec3::new(r * angle.cos(), r * angle.sin(), z);
            let code = encode_normal(normal.x * 3.0, normal.y * 3.0, normal.z * 3.0);
            worst = worst.max(1.0 - decode_normal(code).dot(normal).abs());
        }
        let degrees = (1.0 - worst).acos().to_degrees();
        assert!(degrees < 1.1, "{degrees}");
    }

    #[test]
    fn a_zero_gradient_has_no_normal() {
        assert_eq!(encode_normal(0.0, 0.0, 0.0), NO_NORMAL);
        assert_eq!(decode_normal(NO_NORMAL), Vec3::ZERO);
    }

    #[test]
    fn the_sheared_frame_gives_the_world_gradient() {
        // A field that rises by 2 per mm along world y has that gradient, however it is sampled.
        let shear = DMat3::from_cols(DVec3::X, DVec3::new(0.6, 0.8, 0.0), DVec3::new(0.0, 0.6, 0.8));
        let placement = Placement { spacing: DVec3::new(1.0, 2.0, 3.0), direction: shear, origin: DVec3::ZERO };
        let frame = GradientFrame::new(&placement, 1.0);
        let steps = shear * DMat3::from_diagonal(placement.spacing);
        let differences = DVec3::from_array([0, 1, 2].map(|axis| 2.0 * 2.0 * steps.col(axis).y));
        let gradient = frame.world_from_frame * (frame.frame_from_differences * differences);
        assert!((gradient - DVec3::new(0.0, 2.0, 0.0)).length() < 1e-12, "{gradient}");
    }
}
