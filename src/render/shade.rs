//! Shading tables indexed by quantized normal (Lacroute and Levoy 1994, section 3.1).
//!
//! All lights are white, so a normal's shading is two numbers: what the voxel's colour is multiplied
//! with (ambient and diffuse) and what is added to it (specular). Under parallel projection both
//! depend on the normal alone, and a frame computes them once for each of the normal codes.

use glam::{DMat3, DVec3, Vec3};

use super::lighting::{cosines, raise};
use super::simd::numbers::Numbers;
#[cfg(target_arch = "x86_64")]
use super::simd::wide::Avx2;
use super::simd::wide::{LANES, Portable, Wide};
use super::simd::{self, Kernel};
use super::{Light, Shading};
use crate::volume::gradient::{NO_NORMAL, NORMAL_CODES, NORMALS};

const _: () = assert!(NO_NORMAL as usize == NORMAL_CODES - 1 && (NORMAL_CODES - 1).is_multiple_of(LANES));

/// Factor on the colour and addend, by normal code.
#[derive(Clone, Debug)]
pub struct ShadingTable {
    entries: Vec<[f32; 2]>,
}

impl ShadingTable {
    /// For rays along `forward` (world, unit), with normals kept in a frame that `world_from_frame`
    /// turns into the world, where so much of the light that casts shadows comes through.
    pub fn new(shading: &Shading, transmittance: f64, forward: DVec3, world_from_frame: DMat3) -> Self {
        let frame_from_world = world_from_frame.transpose();
        let to_eye = -forward;
        let light = |light: &Light| {
            let [towards, half] = match *light {
                Light::Headlight => [to_eye, to_eye],
                Light::Directional { direction, .. } => {
                    let towards = direction.normalize();
                    [towards, (towards + to_eye).try_normalize().unwrap_or(to_eye)]
                }
            }
            .map(|direction| (frame_from_world * direction).as_vec3());
            let intensity = light.intensity(transmittance);
            let [diffuse, specular] = [shading.diffuse, shading.specular].map(|share| (intensity * share) as f32);
            FixedLight { towards, half, diffuse, specular }
        };
        let lights: Vec<FixedLight> = shading.lights.iter().map(light).collect();
        let mut entries = vec![[0.0; 2]; NORMAL_CODES];
        let normals = NORMALS.each_ref().map(|of_axis| &of_axis[..]);
        simd::dispatch(Fill { shading, lights: &lights, normals, entries: &mut entries });
        entries[usize::from(NO_NORMAL)] = [shading.facing(transmittance) as f32, 0.0];
        Self { entries }
    }

    /// Entries by normal code.
    pub fn entries(&self) -> &[[f32; 2]] {
        &self.entries
    }
}

/// A light as normals see it, in the frame that they are kept in.
struct FixedLight {
    towards: Vec3,
    /// Half way between it and the eye.
    half: Vec3,
    diffuse: f32,
    specular: f32,
}

/// Entries to be filled in.
struct Fill<'a> {
    shading: &'a Shading,
    lights: &'a [FixedLight],
    normals: [&'a [f32]; 3],
    entries: &'a mut [[f32; 2]],
}

impl Kernel for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.any::<Portable>();
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) {
        self.any::<Avx2>();
    }
}

impl Fill<'_> {
    /// Most exponents are whole.
    #[inline(always)]
    fn any<W: Wide>(self) {
        if self.shading.shininess.fract() as f32 > 0.0 {
            self.fill::<W, false>();
        } else {
            self.fill::<W, true>();
        }
    }

    #[inline(always)]
    fn fill<W: Wide, const WHOLE: bool>(self) {
        let shininess = (self.shading.shininess as u32, self.shading.shininess.fract() as f32);
        let [x, y, z] = self.normals;
        let normals = x.as_chunks().0.iter().zip(y.as_chunks().0).zip(z.as_chunks().0);
        for (entries, ((x, y), z)) in self.entries.as_chunks_mut::<LANES>().0.iter_mut().zip(normals) {
            let normal = [W::Numbers::load(x), W::Numbers::load(y), W::Numbers::load(z)];
            let (mut factors, mut addends) = (W::Numbers::all(self.shading.ambient as f32), W::Numbers::all(0.0));
            for FixedLight { towards, half, diffuse, specular } in self.lights {
                let along = cosines(normal, everywhere::<W>(towards));
                factors = factors + W::Numbers::all(*diffuse) * along;
                if *specular > 0.0 {
                    let highlights = raise::<_, WHOLE>(cosines(normal, everywhere::<W>(half)), shininess);
                    addends = addends + W::Numbers::all(*specular) * highlights;
                }
            }
            let (factors, addends) = (factors.store(), addends.store());
            for n in 0..LANES {
                entries[n] = [factors[n], addends[n]];
            }
        }
    }
}

/// A direction for all lanes.
#[inline(always)]
fn everywhere<W: Wide>(direction: &Vec3) -> [W::Numbers; 3] {
    [W::Numbers::all(direction.x), W::Numbers::all(direction.y), W::Numbers::all(direction.z)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::gradient::{decode_normal, encode_normal};

    #[test]
    fn a_surface_that_faces_the_headlight_gets_all_of_it() {
        let shading = Shading::default();
        let table = ShadingTable::new(&shading, 1.0, DVec3::Y, DMat3::IDENTITY);
        let code = encode_normal(0.0, -1.0, 0.0);
        let cosine = decode_normal(code).y.abs();
        let [factor, addend] = table.entries()[usize::from(code)];
        assert!((factor - (0.2 + 0.8 * cosine)).abs() < 1e-6);
        assert!((addend - 0.2 * cosine.powi(20)).abs() < 1e-6);
        assert_eq!(table.entries()[usize::from(NO_NORMAL)], [1.0, 0.0]);
    }
}
