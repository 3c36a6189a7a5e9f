//! The image-order renderer: the reference, slow and plain.
//!
//! Every pixel's ray is cut where it enters and leaves the volume and sampled at the midpoints of
//! equal steps; a sample is trilinearly interpolated, then classified, then shaded by the
//! interpolated gradient. Nothing is tabulated or quantized, so that the picture converges to the
//! optical model as the step shrinks, and what differs from it elsewhere is the other's error.
//!
//! Two things make it bearable and neither changes a bit: samples in leaves of the octree that are
//! transparent throughout are not interpolated (their opacity is exactly zero), and a ray ends once
//! it is as opaque as asked for.

use glam::{DMat4, DVec2, DVec3, Vec4};
use rayon::prelude::*;

use crate::classify::transfer::{TransferFunction, extinction};
use crate::render::{Cancel, Light, Ray, RenderError, Scene, Settings, Shading, View};
use crate::volume::gradient::{Code, GradientFrame};
use crate::volume::octree::leaf_of;
use crate::volume::{Scalars, Volume};

/// Premultiplied colour and opacity of every pixel, row 0 on top.
///
/// # Errors
/// [`RenderError::Cancelled`] soon after `cancel` was called.
pub fn raycast(scene: &Scene<'_>, view: &View, settings: &Settings, cancel: &Cancel) -> Result<Vec<Vec4>, RenderError> {
    match scene.prepared.volume().scalars() {
        Scalars::U8(codes) => Caster::new(codes, scene, settings).image(view, cancel),
        Scalars::U16(codes) => Caster::new(codes, scene, settings).image(view, cancel),
    }
}

/// What all rays of a frame share.
struct Caster<'a, T> {
    codes: &'a [T],
    volume: &'a Volume,
    dims: [usize; 3],
    transfer: &'a TransferFunction,
    reference_length: f64,
    shading: Option<&'a Shading>,
    frame: GradientFrame,
    index_from_world: DMat4,
    step: f64,
    opaque: f64,
    /// One flag per leaf of the octree; `None`: every sample is looked at.
    occupied: Option<Occupied>,
}

/// Leaves that may hold something to draw.
struct Occupied {
    leaves: Vec<bool>,
    dims: [usize; 3],
}

impl<'a, T: Code> Caster<'a, T> {
    fn new(codes: &'a [T], scene: &Scene<'a>, settings: &'a Settings) -> Self {
        let volume = scene.prepared.volume();
        let transfer = scene.transfer;
        let octree = scene.prepared.octree();
        let occupied = settings.skipping.then(|| Occupied {
            leaves: octree.occupied_leaves(|range| {
                let (low, high) = range.code;
                let values = (volume.value_of_code(low.into()), volume.value_of_code(high.into()));
                // An interpolated gradient may be shorter than all that it was made of.
                transfer.is_transparent(values, (0.0, f64::from(range.gradient.1)))
            }),
            dims: octree.leaf_dims(),
        });
        Self {
            codes,
            volume,
            dims: volume.dims(),
            transfer,
            reference_length: transfer.reference_length(volume.smallest_spacing()),
            shading: settings.shading.as_ref(),
            frame: GradientFrame::new(volume.placement(), volume.rescale().0),
            index_from_world: volume.world_from_index().inverse(),
            step: settings.sample_distance * volume.smallest_spacing(),
            opaque: f64::from(settings.early_ray_termination),
            occupied,
        }
    }

    fn image(&self, view: &View, cancel: &Cancel) -> Result<Vec<Vec4>, RenderError> {
        let (width, height) = view.size();
        let mut image = vec![Vec4::ZERO; width as usize * height as usize];
        image.par_chunks_mut(width as usize).enumerate().try_for_each(|(row, pixels)| {
            for (column, pixel) in pixels.iter_mut().enumerate() {
                // A row of converged rays takes long enough to be worth leaving in its middle.
                if column % 64 == 0 && cancel.is_cancelled() {
                    return Err(RenderError::Cancelled);
                }
                let ray = view.ray(DVec2::new(column as f64 + 0.5, row as f64 + 0.5));
                *pixel = self.pixel(view, &ray);
            }
            Ok(())
        })?;
        Ok(image)
    }

    /// The integral along one ray.
    fn pixel(&self, view: &View, ray: &Ray) -> Vec4 {
        let start = self.index_from_world.transform_point3(ray.origin);
        let direction = self.index_from_world.transform_vector3(ray.direction);
        let Some((enter, leave)) = self.span(view, ray, start, direction) else { return Vec4::ZERO };
        // A length that is a whole number of steps but for rounding takes that number.
        let steps = ((leave - enter) / self.step - 1e-6).ceil().max(1.0);
        let length = (leave - enter) / steps;
        let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
        for n in 0..steps as u64 {
            let at = start + direction * (enter + (n as f64 + 0.5) * length);
            let Some((sample, tau)) = self.sample(at, ray) else { continue };
            let opacity = -(-tau * length).exp_m1();
            color += sample * (transmittance * opacity);
            transmittance *= 1.0 - opacity;
            if 1.0 - transmittance >= self.opaque {
                break;
            }
        }
        color.extend(1.0 - transmittance).as_vec4()
    }

    /// Where the ray is inside the volume and the view's clip planes, in mm from its origin.
    fn span(&self, view: &View, ray: &Ray, start: DVec3, direction: DVec3) -> Option<(f64, f64)> {
        let mut enter = match view.projection() {
            crate::render::Projection::Parallel => f64::NEG_INFINITY,
            crate::render::Projection::Perspective => 0.0,
        };
        let mut leave = f64::INFINITY;
        let mut cut = |distance: f64, rate: f64| {
            // distance + t * rate >= 0
            if rate > 0.0 {
                enter = enter.max(-distance / rate);
            } else if rate < 0.0 {
                leave = leave.min(-distance / rate);
            } else if distance < 0.0 {
                leave = f64::NEG_INFINITY;
            }
        };
        for axis in 0..3 {
            cut(start[axis], direction[axis]);
            cut((self.dims[axis] - 1) as f64 - start[axis], -direction[axis]);
        }
        for half in view.clip() {
            cut(half.normal.dot(ray.origin) + half.offset, half.normal.dot(ray.direction));
        }
        (enter < leave).then_some((enter, leave))
    }

    /// Shaded colour and extinction at index coordinates; `None` where it is transparent.
    fn sample(&self, at: DVec3, ray: &Ray) -> Option<(DVec3, f64)> {
        let cell = [0, 1, 2].map(|axis| (at[axis].max(0.0) as usize).min(self.dims[axis] - 2));
        if let Some(Occupied { leaves, dims }) = &self.occupied {
            let [bi, bj, bk] = [0, 1, 2].map(|axis| leaf_of(cell[axis], self.dims[axis]));
            if !leaves[(bk * dims[1] + bj) * dims[0] + bi] {
                return None;
            }
        }
        let fraction = (at - DVec3::from_array(cell.map(|c| c as f64))).clamp(DVec3::ZERO, DVec3::ONE);
        let value = self.volume.value_of_code(trilinear(fraction, |corner| self.code(cell, corner)));
        let opacity = self.transfer.opacity(value);
        if opacity <= 0.0 {
            return None;
        }
        let mut tau = extinction(opacity, self.reference_length);
        let mut color = DVec3::from_array(self.transfer.color(value));
        if self.shading.is_some() || !self.transfer.gradient_opacity.is_empty() {
            let gradient = self.gradient(cell, fraction);
            tau *= self.transfer.gradient_factor(gradient.length());
            if let Some(shading) = self.shading {
                color = lit(color, gradient, -ray.direction, shading);
            }
        }
        (tau > 0.0).then_some((color, tau))
    }

    fn code(&self, cell: [usize; 3], [i, j, k]: [usize; 3]) -> f64 {
        let [nx, ny, _] = self.dims;
        let index = ((cell[2] + k) * ny + cell[1] + j) * nx + cell[0] + i;
        let code: u16 = self.codes[index].into();
        f64::from(code)
    }

    /// The world gradient, interpolated as a vector from the voxels' central differences.
    fn gradient(&self, cell: [usize; 3], fraction: DVec3) -> DVec3 {
        let difference = |axis: usize| {
            trilinear(fraction, |corner| {
                let voxel = [cell[0] + corner[0], cell[1] + corner[1], cell[2] + corner[2]];
                let (mut after, mut before) = (voxel, voxel);
                after[axis] = (voxel[axis] + 1).min(self.dims[axis] - 1);
                before[axis] = voxel[axis].saturating_sub(1);
                self.code(after, [0; 3]) - self.code(before, [0; 3])
            })
        };
        let differences = DVec3::new(difference(0), difference(1), difference(2));
        self.frame.world_from_frame * (self.frame.frame_from_differences * differences)
    }
}

/// Trilinear interpolation of a cell's corners.
fn trilinear(fraction: DVec3, corner: impl Fn([usize; 3]) -> f64) -> f64 {
    let along_i = |j, k| {
        let (a, b) = (corner([0, j, k]), corner([1, j, k]));
        a + (b - a) * fraction.x
    };
    let along_j = |k| {
        let (a, b) = (along_i(0, k), along_i(1, k));
        a + (b - a) * fraction.y
    };
    let (a, b) = (along_j(0), along_j(1));
    a + (b - a) * fraction.z
}

/// The colour under the lights: ambient and diffuse times the colour, specular added, at most 1.
fn lit(color: DVec3, gradient: DVec3, to_eye: DVec3, shading: &Shading) -> DVec3 {
    let Some(normal) = gradient.try_normalize() else {
        return (color * (shading.ambient + shading.diffuse)).min(DVec3::ONE);
    };
    let (mut diffuse, mut specular) = (shading.ambient, 0.0);
    for light in &shading.lights {
        let (towards, half, intensity) = match *light {
            Light::Headlight => (to_eye, to_eye, 1.0),
            Light::Directional { direction, intensity } => {
                let towards = direction.normalize();
                (towards, (towards + to_eye).try_normalize().unwrap_or(to_eye), intensity)
            }
        };
        diffuse += intensity * shading.diffuse * normal.dot(towards).abs();
        specular += intensity * shading.specular * normal.dot(half).abs().powf(shading.shininess);
    }
    (color * diffuse + specular).min(DVec3::ONE)
}
