//! Light on a gradient, and depth: the shading model where nothing is tabulated by normal.

use glam::{DVec3, Vec3};

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

    /// What a colour is multiplied with, and what is added to it, for `N` samples at once: where
    /// gradients (world, of any length) and directions to the eye (world, unit) are given by component.
    #[inline(always)]
    pub fn shade<const N: usize>(&self, gradient: &[[f32; N]; 3], to_eye: &[[f32; N]; 3]) -> [[f32; N]; 2] {
        let mut normal = [[0.0; N]; 3];
        for n in 0..N {
            let [x, y, z] = [gradient[0][n], gradient[1][n], gradient[2][n]];
            let length = (x * x + y * y + z * z).sqrt();
            // A gradient of zero has no normal; its cosines are 0 here and dealt with at the end.
            let scale = if length > 0.0 { 1.0 / length } else { 0.0 };
            [normal[0][n], normal[1][n], normal[2][n]] = [x * scale, y * scale, z * scale];
        }
        let (mut factors, mut addends) = ([self.ambient; N], [0.0; N]);
        for &(towards, intensity) in &self.lights {
            let diffuse = intensity * self.diffuse;
            let specular = intensity * self.specular;
            match towards {
                None => {
                    let mut cosines = cosines(&normal, to_eye);
                    for n in 0..N {
                        factors[n] += diffuse * cosines[n];
                    }
                    if specular > 0.0 {
                        raise(&mut cosines, self.shininess);
                        for n in 0..N {
                            addends[n] += specular * cosines[n];
                        }
                    }
                }
                Some(towards) => {
                    let mut half = [[0.0; N]; 3];
                    for n in 0..N {
                        let [x, y, z] = [0, 1, 2].map(|axis| towards[axis] + to_eye[axis][n]);
                        let length = (x * x + y * y + z * z).sqrt();
                        let eye = [to_eye[0][n], to_eye[1][n], to_eye[2][n]];
                        // A light opposite to the eye has no half vector.
                        [half[0][n], half[1][n], half[2][n]] =
                            if length > 0.0 { [x / length, y / length, z / length] } else { eye };
                    }
                    let towards = [[towards.x; N], [towards.y; N], [towards.z; N]];
                    let diffuse_cosines = cosines(&normal, &towards);
                    for n in 0..N {
                        factors[n] += diffuse * diffuse_cosines[n];
                    }
                    if specular > 0.0 {
                        let mut highlights = cosines(&normal, &half);
                        raise(&mut highlights, self.shininess);
                        for n in 0..N {
                            addends[n] += specular * highlights[n];
                        }
                    }
                }
            }
        }
        for n in 0..N {
            let flat = gradient[0][n] == 0.0 && gradient[1][n] == 0.0 && gradient[2][n] == 0.0;
            factors[n] = if flat { self.facing } else { factors[n] };
            addends[n] = if flat { 0.0 } else { addends[n] };
        }
        [factors, addends]
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

/// Raises cosines (0..=1) to the shininess, its whole part and the rest: the former by squaring, which vectorizes.
#[inline(always)]
pub(super) fn raise<const N: usize>(cosines: &mut [f32; N], (whole, fraction): (u32, f32)) {
    let (mut bits, mut powers) = (whole, [1.0; N]);
    if fraction > 0.0 {
        for n in 0..N {
            powers[n] = cosines[n].powf(fraction);
        }
    }
    while bits > 0 {
        for n in 0..N {
            powers[n] *= if bits & 1 == 1 { cosines[n] } else { 1.0 };
            cosines[n] *= cosines[n];
        }
        bits >>= 1;
    }
    *cosines = powers;
}

/// The cosines of the angles between unit vectors, without their signs.
#[inline(always)]
pub(super) fn cosines<const N: usize>(a: &[[f32; N]; 3], b: &[[f32; N]; 3]) -> [f32; N] {
    let mut cosines = [0.0; N];
    for n in 0..N {
        cosines[n] = (a[0][n] * b[0][n] + a[1][n] * b[1][n] + a[2][n] * b[2][n]).abs();
    }
    cosines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raising_is_powf() {
        for exponent in [0.0, 1.0, 2.5, 20.0, 33.25f32] {
            let mut values = [0.0f32, 0.3, 0.9, 0.99, 1.0];
            let expected = values.map(|v| v.powf(exponent));
            raise(&mut values, (exponent as u32, exponent.fract()));
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
        let [factors, addends] = lighting.shade(&gradient, &[[0.0; 4], [0.0; 4], [1.0; 4]]);
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
        let [factor, addend] = lighting.shade(&[[1.0], [0.0], [1.0]], &[[0.0], [0.0], [1.0]]);
        assert!((factor[0] - (0.2 + 0.4 * 0.5f32.sqrt())).abs() < 1e-6);
        assert!((addend[0] - 0.1).abs() < 1e-6);
    }
}
