//! Gradients, gradient magnitude and quantized normals.
//!
//! Gradients are central differences in world mm with indices clamped at the border and a divisor
//! of twice the spacing. What a frame needs of them is the surface normal of the voxels it draws, quantized
//! (Lacroute and Levoy 1994, section 3.1: shading from a lookup table indexed by an encoded normal).
//!
//! [`Gradients`] computes eight at once from the scanlines of any principal axis, to the same bits from each.
//! An encoding has that done for the voxels that it keeps, and needs no array of all. Frames of unencoded
//! voxels ask for few in each block of eight, again and again; for them there is an array, made when the
//! first of them asks ([`PreparedVolume::normals`](super::PreparedVolume::normals)).
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

use glam::{DMat3, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::scanlines::Scanlines;
use super::{Placement, Volume};
use crate::simd::{self, Kernel};

/// Steps along each side of the folded octahedral map.
pub const NORMAL_STEPS: usize = 128;
/// The code of a gradient of zero, which has no normal.
pub const NO_NORMAL: u16 = (NORMAL_STEPS * NORMAL_STEPS) as u16;
/// Number of normal codes, [`NO_NORMAL`] included.
pub const NORMAL_CODES: usize = NORMAL_STEPS * NORMAL_STEPS + 1;

const _: () = assert!(NORMAL_CODES <= 1 << 15, "a voxel keeps its normal in 15 bits");

/// One code of 8 or 16 bits.
pub trait Code: bytemuck::Pod + Ord + Default + Send + Sync + Into<u16> {
    /// The largest that the type holds.
    const MAX: Self;

    /// As a number.
    fn as_f32(self) -> f32;

    /// As a number that differences are taken of.
    #[inline(always)]
    fn as_i32(self) -> i32 {
        i32::from(self.into())
    }

    /// `code`, which the type must hold.
    fn from_code(code: u16) -> Self;
}

impl Code for u8 {
    const MAX: Self = Self::MAX;

    #[inline(always)]
    fn as_f32(self) -> f32 {
        f32::from(self)
    }

    fn from_code(code: u16) -> Self {
        code as u8
    }
}

impl Code for u16 {
    const MAX: Self = Self::MAX;

    #[inline(always)]
    fn as_f32(self) -> f32 {
        f32::from(self)
    }

    fn from_code(code: u16) -> Self {
        code
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

/// Voxels whose gradients are computed at once where whole scanlines are.
pub const BLOCK: usize = 8;

/// Gradients of a block of voxels along the frame's axes, one array each.
pub type GradientBlock<const N: usize> = [[f32; N]; 3];

/// The gradients of a volume's voxels, computed from its scanlines where they are asked for.
#[derive(Clone, Copy, Debug)]
pub struct Gradients<'a, T> {
    scanlines: Scanlines<'a, T>,
    frame_from_differences: Mat3,
    diagonal: bool,
}

impl<'a, T: Code> Gradients<'a, T> {
    /// Of the volume whose `scanlines` these are; `frame` is that of its placement and slope.
    pub fn new(scanlines: Scanlines<'a, T>, frame: &GradientFrame) -> Self {
        let frame_from_differences = frame.frame_from_differences.as_mat3();
        Self { scanlines, frame_from_differences, diagonal: frame.diagonal }
    }

    /// The gradients at voxels `first..first + N` of scanline `j` of slice `k`; past the scanline's end
    /// they mean nothing. The same bits whichever principal axis the scanlines are of.
    #[inline(always)]
    pub fn block<const N: usize>(&self, j: usize, k: usize, first: usize) -> GradientBlock<N> {
        let [_, nj, nk] = self.scanlines.dims();
        let row = self.scanlines.row(j, k);
        let along_i = match first.checked_sub(1).and_then(|from| row.get(from..first + N + 1)) {
            Some(around) => difference(codes_from(around, 2), codes_from(around, 0)),
            None => difference_at_an_end(row, first),
        };
        let (before, after) = (self.scanlines.row(j.saturating_sub(1), k), self.scanlines.row((j + 1).min(nj - 1), k));
        let along_j = difference(codes_from(after, first), codes_from(before, first));
        let (before, after) = (self.scanlines.row(j, k.saturating_sub(1)), self.scanlines.row(j, (k + 1).min(nk - 1)));
        let along_k = difference(codes_from(after, first), codes_from(before, first));
        // In the volume's own order, so that sums round alike for all principal axes.
        // (Chosen by a branch: arrays that are indexed by variables live in memory.)
        self.turn(&match self.scanlines.axes() {
            [1, 2, 0] => [along_k, along_i, along_j],
            [0, 2, 1] => [along_i, along_k, along_j],
            _ => [along_i, along_j, along_k],
        })
    }

    /// Differences along the volume's axes -> components along the frame's.
    #[inline(always)]
    fn turn<const N: usize>(&self, [x, y, z]: &GradientBlock<N>) -> GradientBlock<N> {
        let m = &self.frame_from_differences;
        let mut turned = [[0.0; N]; 3];
        for n in 0..N {
            if self.diagonal {
                turned[0][n] = m.x_axis.x * x[n];
                turned[1][n] = m.y_axis.y * y[n];
                turned[2][n] = m.z_axis.z * z[n];
            } else {
                turned[0][n] = m.x_axis.x * x[n] + m.y_axis.x * y[n] + m.z_axis.x * z[n];
                turned[1][n] = m.x_axis.y * x[n] + m.y_axis.y * y[n] + m.z_axis.y * z[n];
                turned[2][n] = m.x_axis.z * x[n] + m.y_axis.z * y[n] + m.z_axis.z * z[n];
            }
        }
        turned
    }
}

/// Codes of the normals of a block's gradients.
#[inline(always)]
pub fn normals<const N: usize>([x, y, z]: &GradientBlock<N>) -> [u16; N] {
    let mut normals = [0; N];
    for n in 0..N {
        normals[n] = encode_normal(x[n], y[n], z[n]);
    }
    normals
}

/// The code of every voxel's normal, in the order of `scanlines`, those of the z axis.
pub(super) fn quantized_normals<T: Code>(scanlines: Scanlines<'_, T>, frame: &GradientFrame) -> Vec<u16> {
    let gradients = Gradients::new(scanlines, frame);
    let [nx, ny, nz] = scanlines.dims();
    let mut codes = vec![0; nx * ny * nz];
    codes.par_chunks_mut(nx * ny).enumerate().for_each(|(z, plane)| {
        simd::dispatch(NormalPlane { gradients, z, plane });
    });
    codes
}

/// A plane whose normals are wanted.
struct NormalPlane<'a, T> {
    gradients: Gradients<'a, T>,
    z: usize,
    plane: &'a mut [u16],
}

impl<T: Code> Kernel for NormalPlane<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [nx, ..] = self.gradients.scanlines.dims();
        for (y, row) in self.plane.chunks_exact_mut(nx).enumerate() {
            for (block, codes) in row.chunks_mut(BLOCK).enumerate() {
                let normals = normals(&self.gradients.block::<BLOCK>(y, self.z, block * BLOCK));
                codes.copy_from_slice(&normals[..codes.len()]);
            }
        }
    }
}

/// Magnitudes of a block's gradients, scalar units per mm.
#[inline(always)]
pub fn magnitudes<const N: usize>([x, y, z]: &GradientBlock<N>) -> [f32; N] {
    let mut magnitudes = [0.0; N];
    for n in 0..N {
        magnitudes[n] = (x[n] * x[n] + y[n] * y[n] + z[n] * z[n]).sqrt();
    }
    magnitudes
}

/// Codes from `first` on; the scanline's last one is repeated.
#[inline(always)]
fn codes_from<T: Code, const N: usize>(row: &[T], first: usize) -> [i32; N] {
    let mut codes = [0; N];
    if let Some(within) = row.get(first..first + N) {
        for n in 0..N {
            codes[n] = within[n].as_i32();
        }
    } else {
        for (n, code) in codes.iter_mut().enumerate() {
            *code = row[(first + n).min(row.len() - 1)].as_i32();
        }
    }
    codes
}

/// Differences of codes: of 16 bits and a sign, which an f32 holds exactly.
#[inline(always)]
fn difference<const N: usize>(after: [i32; N], before: [i32; N]) -> [f32; N] {
    let mut differences = [0.0; N];
    for n in 0..N {
        differences[n] = (after[n] - before[n]) as f32;
    }
    differences
}

/// Differences along a scanline where the neighbours of a block's voxels are not all within it.
#[inline(never)]
fn difference_at_an_end<T: Code, const N: usize>(row: &[T], first: usize) -> [f32; N] {
    let code = |i: usize| row[i.min(row.len() - 1)].as_i32();
    std::array::from_fn(|n| (code(first + n + 1) - code((first + n).saturating_sub(1).min(row.len() - 1))) as f32)
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

/// The world gradient at voxel (i, j, k) in scalar units per mm: the plain twin of [`Gradients`].
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
    use crate::volume::scanlines::AnyScanlines;
    use crate::volume::{ImportReport, PreparedVolume, ScalarType, Scalars};

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

    /// A volume of noise, of either code.
    fn noise(dims: [usize; 3], wide: bool, direction: DMat3) -> Volume {
        let codes = (0..dims.iter().product::<usize>() as u32).map(|at| (at + 1).wrapping_mul(2_654_435_761) >> 16);
        let scalars = if wide {
            Scalars::U16(codes.map(|code| code as u16).collect())
        } else {
            Scalars::U8(codes.map(|code| (code % 3) as u8).collect())
        };
        let placement = Placement { spacing: DVec3::new(0.7, 1.3, 2.1), direction, origin: DVec3::ZERO };
        let report = ImportReport::plain("test", ScalarType::U16);
        Volume::new(dims, placement, scalars, (0.25, -3.0), report).unwrap()
    }

    fn check<T: Code>(prepared: &PreparedVolume, frame: &GradientFrame, scanlines: Scanlines<'_, T>) {
        let gradients = Gradients::new(scanlines, frame);
        let [ni, nj, nk] = scanlines.dims();
        for (j, k) in (0..nk).flat_map(|k| (0..nj).map(move |j| (j, k))) {
            for first in 0..ni {
                let block = gradients.block::<BLOCK>(j, k, first);
                for n in 0..BLOCK.min(ni - first) {
                    let mut at = [0; 3];
                    for (axis, index) in scanlines.axes().into_iter().zip([first + n, j, k]) {
                        at[axis] = index;
                    }
                    let plain = gradient_at(prepared.volume(), frame, at);
                    let here = frame.world_from_frame * Vec3::from_array(block.map(|g| g[n])).as_dvec3();
                    assert!((here - plain).length() <= 1e-5 * plain.length(), "{here} at {at:?}, not {plain}");
                    assert!((f64::from(magnitudes(&block)[n]) - plain.length()).abs() <= 1e-5 * plain.length());
                    // To the bit what any other block and principal axis make of the voxel.
                    let alone = z_gradients(prepared, frame, at);
                    assert_eq!(block.map(|g| g[n].to_bits()), alone.map(f32::to_bits), "at {at:?}");
                    let normal = encode_normal(alone[0], alone[1], alone[2]);
                    assert_eq!(normals(&block)[n], normal);
                    let [x, y, z] = at;
                    assert_eq!(prepared.normals(2).row(y, z)[x], normal);
                    assert_eq!(prepared.normals(0).row(z, x)[y], normal);
                }
            }
        }
    }

    /// The first of the block at a voxel, by the scanlines of the z axis.
    fn z_gradients(prepared: &PreparedVolume, frame: &GradientFrame, [x, y, z]: [usize; 3]) -> [f32; 3] {
        match prepared.scanlines(2) {
            AnyScanlines::U8(scanlines) => Gradients::new(scanlines, frame).block::<1>(y, z, x).map(|g| g[0]),
            AnyScanlines::U16(scanlines) => Gradients::new(scanlines, frame).block::<1>(y, z, x).map(|g| g[0]),
        }
    }

    #[test]
    fn blocks_of_all_axes_are_the_plain_gradients_and_alike_to_the_bit() {
        let skewed = DMat3::from_cols(DVec3::X, DVec3::new(0.6, 0.8, 0.0), DVec3::new(0.0, 0.6, 0.8));
        for (dims, wide, direction) in [
            ([2, 3, 4], false, DMat3::IDENTITY),
            ([17, 9, 8], true, DMat3::IDENTITY),
            ([10, 11, 3], true, skewed),
            ([25, 2, 16], false, skewed),
        ] {
            let prepared = PreparedVolume::build(noise(dims, wide, direction));
            let frame = GradientFrame::new(prepared.volume().placement(), prepared.volume().rescale().0);
            for axis in 0..3 {
                match prepared.scanlines(axis) {
                    AnyScanlines::U8(scanlines) => check(&prepared, &frame, scanlines),
                    AnyScanlines::U16(scanlines) => check(&prepared, &frame, scanlines),
                }
            }
        }
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
