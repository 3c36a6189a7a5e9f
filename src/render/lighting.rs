//! Light on a gradient, and depth: the shading model where nothing is tabulated by normal.

use glam::{DVec3, Vec3};

use super::simd::numbers::Numbers;
use super::{Light, Shading, View};
use crate::volume::Volume;

/// The shading model, ready to be asked for every sample.
#[derive(Clone, Debug)]
pub struct Lighting {
    ambient: f32,
    diffuse: f32,
    specular: f32,
    /// The exponent's whole part and the rest.
    shininess: (u32, f32),
    /// The factor where there is no gradient.
    facing: f32,
    /// Towards the light (`None`: the eye), and its intensity.
    lights: Vec<(Option<Vec3>, f32)>,
}

impl Lighting {
    /// For the lights and coefficients of `shading`, where so much of the light that casts shadows comes through.
    pub fn new(shading: &Shading, transmittance: f64) -> Self {
        let light = |light: &Light| {
            let towards = match *light {
                Light::Headlight => None,
                Light::Directional { direction, .. } => Some(DVec3::normalize(direction).as_vec3()),
            };
            (towards, light.intensity(transmittance) as f32)
        };
        Self {
            ambient: shading.ambient as f32,
            diffuse: shading.diffuse as f32,
            specular: shading.specular as f32,
            shininess: (shading.shininess as u32, shading.shininess.fract() as f32),
            facing: shading.facing(transmittance) as f32,
            lights: shading.lights.iter().map(light).collect(),
        }
    }

    /// What colours are multiplied with, and what is added to them, for samples side by side: where
    /// gradients (world, of any length) and directions to the eye (world, unit) are given by component.
    #[inline(always)]
    pub fn shade<V: Numbers>(&self, [x, y, z]: [V; 3], to_eye: [V; 3]) -> [V; 2] {
        let (zero, one) = (V::all(0.0), V::all(1.0));
        let length = (x * x + y * y + z * z).sqrt();
        // A gradient of zero has no normal; its cosines are 0 here and dealt with at the end.
        let scale = length.where_above(0.0, one / length, zero);
        let normal = [x * scale, y * scale, z * scale];
        let (mut factors, mut addends) = (V::all(self.ambient), zero);
        for &(towards, intensity) in &self.lights {
            let diffuse = intensity * self.diffuse;
            let specular = intensity * self.specular;
            let (towards, half) = match towards {
                None => (to_eye, to_eye),
                Some(towards) => {
                    let towards = [V::all(towards.x), V::all(towards.y), V::all(towards.z)];
                    let [x, y, z] = [towards[0] + to_eye[0], towards[1] + to_eye[1], towards[2] + to_eye[2]];
                    let length = (x * x + y * y + z * z).sqrt();
                    // A light opposite to the eye has no half vector.
                    let half = [
                        length.where_above(0.0, x / length, to_eye[0]),
                        length.where_above(0.0, y / length, to_eye[1]),
                        length.where_above(0.0, z / length, to_eye[2]),
                    ];
                    (towards, half)
                }
            };
            factors = factors + V::all(diffuse) * cosines(normal, towards);
            if specular > 0.0 {
                addends = addends + V::all(specular) * raise::<V, false>(cosines(normal, half), self.shininess);
            }
        }
        let steep = x.abs() + y.abs() + z.abs();
        [steep.where_above(0.0, factors, V::all(self.facing)), steep.where_above(0.0, addends, zero)]
    }
}

/// A sample's colour under the lights, by its gradient (world, of any length) and the direction to the eye (world, unit): ambient and
/// diffuse times the colour, specular added, at most 1. So much of the light that casts shadows comes through.
pub fn lit(color: DVec3, gradient: DVec3, to_eye: DVec3, shading: &Shading, transmittance: f64) -> DVec3 {
    let Some(normal) = gradient.try_normalize() else {
        return (color * shading.facing(transmittance)).min(DVec3::ONE);
    };
    let (mut diffuse, mut specular) = (shading.ambient, 0.0);
    for light in &shading.lights {
        let (towards, half) = match *light {
            Light::Headlight => (to_eye, to_eye),
            Light::Directional { direction, .. } => {
                let towards = direction.normalize();
                (towards, (towards + to_eye).try_normalize().unwrap_or(to_eye))
            }
        };
        let intensity = light.intensity(transmittance);
        diffuse += intensity * shading.diffuse * normal.dot(towards).abs();
        specular += intensity * shading.specular * normal.dot(half).abs().powf(shading.shininess);
    }
    (color * diffuse + specular).min(DVec3::ONE)
}

/// Depth along the camera's axis: 0 at the front of the volume's bounding sphere, 1 at its back.
#[derive(Clone, Debug)]
pub struct AxialDepth {
    front: DVec3,
    forward: DVec3,
    diameter: f64,
}

impl AxialDepth {
    /// Of a view of `volume`.
    pub fn new(view: &View, volume: &Volume) -> Self {
        let (forward, radius) = (view.forward(), volume.radius());
        Self { front: volume.centre() - forward * radius, forward, diameter: 2.0 * radius }
    }

    /// Of a point, world mm.
    pub fn of(&self, point: DVec3) -> f64 {
        (point - self.front).dot(self.forward) / self.diameter
    }
}

/// A power below this is nothing to see. Left to shrink it would end as a number without a leading bit, which many processors
/// multiply far slower.
const DARK: f32 = 1e-18;

/// Raises cosines (0..=1) to the shininess, its whole part and the rest: the former by squaring. `WHOLE`: there is no rest, and what is computed
/// beside need not make way for a call.
#[inline(always)]
pub(super) fn raise<V: Numbers, const WHOLE: bool>(mut cosines: V, (whole, fraction): (u32, f32)) -> V {
    let dark = V::all(DARK);
    let mut powers = if !WHOLE && fraction > 0.0 { cosines.powf(fraction) } else { V::all(1.0) };
    let mut bits = whole;
    while bits > 0 {
        if bits & 1 == 1 {
            powers = (powers * cosines).most(dark);
        }
        bits >>= 1;
        if bits > 0 {
            cosines = (cosines * cosines).most(dark);
        }
    }
    powers
}

/// The cosines of the angles between unit vectors, without their signs.
#[inline(always)]
pub(super) fn cosines<V: Numbers>(a: [V; 3], b: [V; 3]) -> V {
    (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::numbers::Array;

    #[test]
    fn raising_is_powf() {
        for exponent in [0.0, 1.0, 2.5, 20.0, 33.25f32] {
            let values = [0.0f32, 0.3, 0.9, 0.99, 1.0];
            let expected = values.map(|v| v.powf(exponent));
            let Array(values) = raise::<_, false>(Array(values), (exponent as u32, exponent.fract()));
            for (value, expected) in values.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-5, "{exponent}: {value} {expected}");
            }
        }
    }

    #[test]
    fn a_surface_that_faces_the_headlight_gets_all_of_it() {
        let lighting = Lighting::new(&Shading { shininess: 20.5, ..Shading::default() }, 1.0);
        let c = 0.6f32;
        let gradient = [[-3.0, 0.0, 0.0, 5.0 * 0.8], [0.0, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 5.0 * c]];
        let to_eye = [0.0, 0.0, 1.0].map(Array::<4>::all);
        let [Array(factors), Array(addends)] = lighting.shade(gradient.map(Array), to_eye);
        for (factor, expected) in factors.iter().zip([0.2, 1.0, 1.0, 0.2 + 0.8 * c]) {
            assert!((factor - expected).abs() < 1e-6, "{factor} {expected}");
        }
        for (addend, expected) in addends.iter().zip([0.0, 0.2, 0.0, 0.2 * c.powf(20.5)]) {
            assert!((addend - expected).abs() < 1e-6, "{addend} {expected}");
        }
    }

    #[test]
    fn a_light_from_the_side_has_its_highlight_half_way() {
        let light = Light::Directional { direction: DVec3::new(2.0, 0.0, 0.0), intensity: 0.5, shadows: false };
        let lighting = Lighting::new(&Shading { lights: vec![light], ..Shading::default() }, 1.0);
        let [Array([factor]), Array([addend])] =
            lighting.shade([1.0, 0.0, 1.0].map(Array::all), [0.0, 0.0, 1.0].map(Array::all));
        assert!((factor - (0.2 + 0.4 * 0.5f32.sqrt())).abs() < 1e-6);
        assert!((addend - 0.1).abs() < 1e-6);
    }
}
