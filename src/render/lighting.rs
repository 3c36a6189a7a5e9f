//! Light on a gradient: the shading model where nothing is tabulated by normal.

use glam::{DVec3, Vec3};

use super::{Light, Shading};

/// The shading model, ready to be asked for every sample.
#[derive(Clone, Debug)]
pub struct Lighting {
    ambient: f32,
    diffuse: f32,
    specular: f32,
    shininess: f32,
    /// Towards the light (`None`: the eye), and its intensity.
    lights: Vec<(Option<Vec3>, f32)>,
}

impl Lighting {
    /// For the lights and coefficients of `shading`.
    pub fn new(shading: &Shading) -> Self {
        let light = |light: &Light| match *light {
            Light::Headlight => (None, 1.0),
            Light::Directional { direction, intensity } => {
                (Some(DVec3::normalize(direction).as_vec3()), intensity as f32)
            }
        };
        Self {
            ambient: shading.ambient as f32,
            diffuse: shading.diffuse as f32,
            specular: shading.specular as f32,
            shininess: shading.shininess as f32,
            lights: shading.lights.iter().map(light).collect(),
        }
    }

    /// What a colour is multiplied with, and what is added to it, where the gradient (world, of any
    /// length) is `gradient` and the eye in the direction `to_eye` (world, unit).
    #[inline(always)]
    pub fn shade(&self, gradient: Vec3, to_eye: Vec3) -> [f32; 2] {
        let squared = gradient.length_squared();
        if squared == 0.0 {
            return [self.ambient + self.diffuse, 0.0];
        }
        let normal = gradient * squared.sqrt().recip();
        let [mut factor, mut addend] = [self.ambient, 0.0];
        for &(towards, intensity) in &self.lights {
            let (towards, half) = match towards {
                None => (to_eye, to_eye),
                Some(towards) => (towards, (towards + to_eye).try_normalize().unwrap_or(to_eye)),
            };
            factor += intensity * self.diffuse * normal.dot(towards).abs();
            if self.specular > 0.0 {
                addend += intensity * self.specular * normal.dot(half).abs().powf(self.shininess);
            }
        }
        [factor, addend]
    }
}
