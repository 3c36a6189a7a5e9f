//! Shading tables indexed by quantized normal (Lacroute and Levoy 1994, section 3.1).
//!
//! All lights are white, so a normal's shading is two numbers: what the voxel's colour is multiplied
//! with (ambient and diffuse) and what is added to it (specular). Under parallel projection both
//! depend on the normal alone, and a frame computes them once for each of the normal codes.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{Light, Shading};
use crate::volume::gradient::{NO_NORMAL, NORMAL_CODES, NORMALS};

/// Codes that one job computes.
const CHUNK: usize = 4096;

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
        let lights: Vec<[DVec3; 2]> = shading
            .lights
            .iter()
            .map(|light| match *light {
                Light::Headlight => [to_eye, to_eye],
                Light::Directional { direction, .. } => {
                    let towards = direction.normalize();
                    [towards, (towards + to_eye).try_normalize().unwrap_or(to_eye)]
                }
            })
            .map(|directions| directions.map(|d| frame_from_world * d))
            .collect();
        let mut entries = vec![[shading.ambient as f32, 0.0]; NORMAL_CODES];
        entries.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, entries)| {
            for (light, [towards, half]) in shading.lights.iter().zip(&lights) {
                add_light(entries, chunk * CHUNK, shading, light.intensity(transmittance), *towards, *half);
            }
        });
        entries[usize::from(NO_NORMAL)] = [shading.facing(transmittance) as f32, 0.0];
        Self { entries }
    }

    /// Entries by normal code.
    pub fn entries(&self) -> &[[f32; 2]] {
        &self.entries
    }
}

/// Adds a light to the entries of the normals from code `first` on.
fn add_light(entries: &mut [[f32; 2]], first: usize, shading: &Shading, intensity: f64, towards: DVec3, half: DVec3) {
    let normals = [0, 1, 2].map(|axis| &NORMALS[axis][first..first + entries.len()]);
    let cosines = |direction: DVec3| -> Vec<f32> {
        let d = direction.as_vec3();
        let along = normals[0].iter().zip(normals[1]).zip(normals[2]);
        along.map(|((x, y), z)| (x * d.x + y * d.y + z * d.z).abs()).collect()
    };
    let (diffuse, specular) = ((intensity * shading.diffuse) as f32, (intensity * shading.specular) as f32);
    for (entry, cosine) in entries.iter_mut().zip(cosines(towards)) {
        entry[0] += diffuse * cosine;
    }
    if specular > 0.0 {
        let mut highlights = cosines(half);
        raise(&mut highlights, shading.shininess);
        for (entry, highlight) in entries.iter_mut().zip(highlights) {
            entry[1] += specular * highlight;
        }
    }
}

/// Raises all of `bases` (0..=1) to `exponent`: the integer part by squaring, all values at once, which
/// vectorizes; `powf` for what is left.
fn raise(bases: &mut [f32], exponent: f64) {
    let mut powers = vec![1f32; bases.len()];
    let fraction = exponent.fract() as f32;
    if fraction > 0.0 {
        powers.iter_mut().zip(&*bases).for_each(|(power, base)| *power = base.powf(fraction));
    }
    let mut bits = exponent as u32;
    while bits > 0 {
        if bits & 1 == 1 {
            powers.iter_mut().zip(&*bases).for_each(|(power, base)| *power *= base);
        }
        bases.iter_mut().for_each(|base| *base *= *base);
        bits >>= 1;
    }
    bases.copy_from_slice(&powers);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::gradient::{decode_normal, encode_normal};

    #[test]
    fn raising_is_powf() {
        for exponent in [0.0, 1.0, 2.5, 20.0, 33.25] {
            let mut values = [0.0f32, 0.3, 0.9, 0.99, 1.0];
            let expected = values.map(|v| v.powf(exponent as f32));
            raise(&mut values, exponent);
            for (value, expected) in values.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-5, "{exponent}: {value} {expected}");
            }
        }
    }

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
