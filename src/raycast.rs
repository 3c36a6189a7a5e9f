//! The image-order renderer: the reference, slow and plain.
//!
//! Every pixel's ray is cut where it enters and leaves the volume and sampled at equal steps; a sample
//! is trilinearly interpolated, then classified, then shaded by the interpolated gradient
//! (`composite`), or only the largest, the smallest or the mean sample is kept (`projection`).
//! Nothing is tabulated or quantized, so that the picture converges to the optical model as the step
//! shrinks, and what differs from it elsewhere is the other's error.
//!
//! Two things make it bearable and neither changes a bit: samples in leaves of the octree that cannot
//! matter are not interpolated, and a ray ends where nothing further would show.

mod composite;
mod field;
mod projection;

use glam::{DMat4, DVec2, DVec3, Vec4};
use rayon::prelude::*;

use crate::render::view::cut;
use crate::render::{Blend, Cancel, Ray, RenderError, Scene, Settings, View};
use crate::volume::gradient::Code;
use crate::volume::{Scalars, Volume};
use composite::Medium;
use field::Field;
use projection::Intensity;

/// Premultiplied colour and opacity of every pixel, row 0 on top.
///
/// # Errors
/// [`RenderError::Cancelled`] soon after `cancel` was called.
pub fn raycast(scene: &Scene<'_>, view: &View, settings: &Settings, cancel: &Cancel) -> Result<Vec<Vec4>, RenderError> {
    match scene.prepared.volume().scalars() {
        Scalars::U8(codes) => of_codes(codes, scene, view, settings, cancel),
        Scalars::U16(codes) => of_codes(codes, scene, view, settings, cancel),
    }
}

fn of_codes<T: Code>(
    codes: &[T],
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<Vec<Vec4>, RenderError> {
    let field = Field::new(codes, scene.prepared);
    let rays = Rays::new(view, scene.prepared.volume(), settings.sample_distance);
    match settings.blend {
        Blend::Composite => {
            let medium = Medium::new(field, scene, view, settings);
            rays.image(cancel, |ray, stretch| medium.pixel(ray, stretch))
        }
        Blend::Projection(which, window) => {
            let octree = settings.skipping.then(|| scene.prepared.octree());
            let intensity = Intensity::new(field, scene, which, window, octree);
            rays.image(cancel, |_, stretch| intensity.pixel(stretch))
        }
    }
}

/// The rays of an image, and the box that they are cut by.
struct Rays<'a> {
    view: &'a View,
    index_from_world: DMat4,
    /// Largest index coordinates.
    last: DVec3,
    /// mm between samples, at most.
    step: f64,
}

/// What of a ray lies inside the volume, in equal steps.
#[derive(Clone, Copy, Debug)]
struct Stretch<'a> {
    cancel: &'a Cancel,
    /// Index coordinates of the ray's origin.
    start: DVec3,
    /// Indices per mm.
    direction: DVec3,
    /// Where the stretch begins, mm from the origin.
    enter: f64,
    steps: u64,
    /// Of a step, mm.
    length: f64,
}

impl Stretch<'_> {
    /// The steps, counted from 0; fewer if the frame is cancelled meanwhile, for a ray may be long.
    fn walk(&self) -> impl Iterator<Item = u64> {
        (0..self.steps).take_while(|step| step % 4096 != 4095 || !self.cancel.is_cancelled())
    }

    /// The distance from the ray's origin after so many steps, mm.
    fn distance(&self, steps: f64) -> f64 {
        self.enter + steps * self.length
    }

    /// Index coordinates after so many steps.
    fn at(&self, steps: f64) -> DVec3 {
        self.start + self.direction * self.distance(steps)
    }
}

impl<'a> Rays<'a> {
    fn new(view: &'a View, volume: &Volume, sample_distance: f64) -> Self {
        Self {
            view,
            index_from_world: volume.world_from_index().inverse(),
            last: DVec3::from_array(volume.dims().map(|n| (n - 1) as f64)),
            step: sample_distance * volume.smallest_spacing(),
        }
    }

    /// All pixels, each by `pixel` of its ray; those whose ray misses the volume are transparent.
    fn image(&self, cancel: &Cancel, pixel: impl Fn(&Ray, &Stretch) -> Vec4 + Sync) -> Result<Vec<Vec4>, RenderError> {
        let (width, height) = self.view.size();
        let mut image = vec![Vec4::ZERO; width as usize * height as usize];
        image.par_chunks_mut(width as usize).enumerate().try_for_each(|(row, pixels)| {
            for (column, out) in pixels.iter_mut().enumerate() {
                let ray = self.view.ray(DVec2::new(column as f64 + 0.5, row as f64 + 0.5));
                let far = self.view.depth().map_or(f64::INFINITY, |depth| depth.at(column, row).into());
                *out = self.stretch(&ray, far, cancel).map_or(Vec4::ZERO, |stretch| pixel(&ray, &stretch));
                if cancel.is_cancelled() {
                    return Err(RenderError::Cancelled);
                }
            }
            Ok(())
        })?;
        Ok(image)
    }

    /// Where the ray is inside the volume and the view's clip planes, up to `far` mm from its origin.
    fn stretch<'c>(&self, ray: &Ray, far: f64, cancel: &'c Cancel) -> Option<Stretch<'c>> {
        let start = self.index_from_world.transform_point3(ray.origin);
        let direction = self.index_from_world.transform_vector3(ray.direction);
        let mut span = [self.view.nearest(), far];
        for axis in 0..3 {
            span = cut(span, start[axis], direction[axis]);
            span = cut(span, self.last[axis] - start[axis], -direction[axis]);
        }
        let mut span = self.view.clip().span(ray.origin, ray.direction, span);
        if let Some(layer) = self.view.layer() {
            span = layer.span(ray.origin, ray.direction, span);
        }
        let [enter, leave] = span;
        (enter < leave).then(|| {
            // A length that is a whole number of steps but for rounding takes that number.
            let steps = ((leave - enter) / self.step - 1e-6).ceil().max(1.0);
            Stretch { cancel, start, direction, enter, steps: steps as u64, length: (leave - enter) / steps }
        })
    }
}
