//! Light in perspective: every voxel is seen along a ray of its own.
//!
//! Under parallel projection a normal's light is the same all over the picture and is looked up by the
//! normal's code. In perspective the headlight shines along the pixel's ray and highlights move with
//! it; a table for the camera's axis is wrong by the angle between the two, which costs 1 to 2 dB
//! at a field of view of 40 degrees and makes the sides of a wide one dark. So voxels are lit one by one,
//! a few at a time, towards the eye: a square root, a division and some products each. A voxel's ray
//! is within half a pixel of the pixel's.
//!
//! All vectors are in the frame of the volume's normals.

use glam::{DMat3, DVec3, Vec3};

use crate::render::factorization::Factorization;
use crate::render::lighting::Lighting;
use crate::render::{Light, Shading};
use crate::simd::numbers::Array;
use crate::volume::Volume;
use crate::volume::gradient::{GradientFrame, NORMALS};

/// The lights of a frame, and where the eye is.
#[derive(Clone, Debug)]
pub struct RayLight {
    lighting: Lighting,
    /// From a voxel to the next along i, j, k, mm.
    steps: DMat3,
    /// The eye as seen from voxel (0, 0, 0).
    eye: DVec3,
}

impl RayLight {
    /// For a part of a perspective view of `volume`, where so much of the light that casts shadows comes through; `None` where
    /// rays are parallel.
    pub fn new(shading: &Shading, transmittance: f64, volume: &Volume, factorization: &Factorization) -> Option<Self> {
        let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
        let frame_from_world = frame.world_from_frame.transpose();
        let turned = |light: &Light| match *light {
            Light::Headlight => Light::Headlight,
            Light::Directional { direction, intensity, shadows } => {
                Light::Directional { direction: frame_from_world * direction, intensity, shadows }
            }
        };
        let lights = shading.lights.iter().map(turned).collect();
        let steps = frame_from_world * factorization.world_from_steps(volume);
        let eye = steps * factorization.eye()?;
        let lighting = Lighting::new(&Shading { lights, ..shading.clone() }, transmittance);
        Some(Self { lighting, steps, eye })
    }

    /// Factors on and addends to the colours of consecutive voxels from (i, j, k) on, by their normals' codes.
    #[inline(always)]
    pub fn of_normals<const N: usize>(&self, normals: &[u16; N], at: [usize; 3]) -> [[f32; N]; 2] {
        let table = &*NORMALS;
        let mut gradients = [[0.0; N]; 3];
        for (gradients, table) in gradients.iter_mut().zip(table) {
            for (gradient, normal) in gradients.iter_mut().zip(normals) {
                *gradient = table[usize::from(*normal)];
            }
        }
        self.of_gradients(&gradients, at)
    }

    /// The same by gradients, of any length.
    #[inline(always)]
    pub fn of_gradients<const N: usize>(&self, gradients: &[[f32; N]; 3], at: [usize; 3]) -> [[f32; N]; 2] {
        let gradients = [Array(gradients[0]), Array(gradients[1]), Array(gradients[2])];
        let [x, y, z] = self.to_eye(at);
        let [Array(factors), Array(addends)] = self.lighting.shade(gradients, [Array(x), Array(y), Array(z)]);
        [factors, addends]
    }

    /// Unit vectors to the eye from consecutive voxels.
    #[inline(always)]
    fn to_eye<const N: usize>(&self, at: [usize; 3]) -> [[f32; N]; 3] {
        // From the scanline's first voxel, so that it does not matter where a block begins.
        let [i, j, k] = at.map(|n| n as f64);
        let start = (self.eye - self.steps * DVec3::new(0.0, j, k)).as_vec3();
        let step = self.steps.x_axis.as_vec3();
        let mut to_eye = [[0.0; N]; 3];
        #[expect(clippy::needless_range_loop, reason = "lanes of several arrays are walked together")]
        for n in 0..N {
            let Vec3 { x, y, z } = start - step * (i as f32 + n as f32);
            let length = (x * x + y * y + z * z).sqrt();
            // An eye on a voxel does not see it.
            let scale = if length > 0.0 { 1.0 / length } else { 0.0 };
            [to_eye[0][n], to_eye[1][n], to_eye[2][n]] = [x * scale, y * scale, z * scale];
        }
        to_eye
    }
}
