//! Emission and absorption along a ray, at the midpoints of its steps.

use glam::{DVec3, DVec4, Vec4};

use super::Stretch;
use super::field::{Field, Place};
use crate::classify::labels::Labels;
use crate::classify::summed_area::octree_for;
use crate::classify::transfer::{TransferFunction, extinction};
use crate::render::lighting::{AxialDepth, lit};
use crate::render::shadow::Shadow;
use crate::render::{DepthCueing, Ray, Sampling, Scene, Settings, Shading, View};
use crate::volume::Volume;
use crate::volume::gradient::Code;

/// An octree's gradient magnitudes are rounded to f32; those here are not.
const GRADIENT_MARGIN: f64 = 1.0 + 1e-5;

/// The volume as the optical model sees it.
pub(super) struct Medium<'a, T> {
    field: Field<'a, T>,
    volume: &'a Volume,
    transfer: &'a TransferFunction,
    reference_length: f64,
    shading: Option<&'a Shading>,
    shadow: Option<&'a [u8]>,
    depth_cueing: Option<(DepthCueing, AxialDepth)>,
    sampling: Sampling,
    labels: Option<Labels<'a>>,
    opaque: f64,
    /// One flag per leaf of the octree, false where all of it is transparent; `None`: every sample is
    /// looked at.
    occupied: Option<Vec<bool>>,
}

impl<'a, T: Code> Medium<'a, T> {
    pub(super) fn new(field: Field<'a, T>, scene: &Scene<'a>, view: &View, settings: &'a Settings) -> Self {
        let (volume, transfer) = (scene.prepared.volume(), scene.transfer);
        let occupied = settings.skipping.then(|| {
            octree_for(scene.prepared, transfer).occupied_leaves(|range| {
                let (low, high) = range.code;
                let values = (volume.value_of_code(low.into()), volume.value_of_code(high.into()));
                // An interpolated gradient may be shorter than all that it was made of.
                transfer.is_transparent(values, (0.0, f64::from(range.gradient.1) * GRADIENT_MARGIN))
            })
        });
        Self {
            field,
            volume,
            transfer,
            reference_length: transfer.reference_length(volume.smallest_spacing()),
            shading: settings.shading.as_ref(),
            shadow: scene.shadow.map(Shadow::lacking),
            depth_cueing: settings.depth_cueing.map(|cueing| (cueing, AxialDepth::new(view, volume))),
            sampling: settings.sampling,
            labels: scene.labels,
            opaque: f64::from(settings.early_ray_termination),
            occupied,
        }
    }

    /// The integral along one ray.
    pub(super) fn pixel(&self, ray: &Ray, stretch: &Stretch<'_>) -> Vec4 {
        let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
        for n in stretch.walk() {
            let middle = n as f64 + 0.5;
            let Some((mut sample, tau)) = self.sample(stretch.at(middle), ray) else { continue };
            if let Some((DepthCueing { front, density }, depth)) = &self.depth_cueing {
                let point = ray.origin + ray.direction * stretch.distance(middle);
                sample *= front * (-density * depth.of(point)).exp();
            }
            let opacity = -(-tau * stretch.length).exp_m1();
            color += sample * (transmittance * opacity);
            transmittance *= 1.0 - opacity;
            if 1.0 - transmittance >= self.opaque {
                break;
            }
        }
        color.extend(1.0 - transmittance).as_vec4()
    }

    /// Shaded colour and extinction at index coordinates; `None` where it is transparent.
    fn sample(&self, at: DVec3, ray: &Ray) -> Option<(DVec3, f64)> {
        let place = self.field.place(at);
        if self.occupied.as_ref().is_some_and(|occupied| !occupied[self.field.leaf(place)]) {
            return None;
        }
        if self.labels.is_some() || self.volume.colors().is_some() {
            let (color, tau) = self.painted(place);
            let (color, tau) = self.on_gradient(place, color, tau, -ray.direction);
            return (tau > 0.0).then_some((color, tau));
        }
        let value = self.volume.value_of_code(self.field.code(place));
        let opacity = self.transfer.opacity(value);
        if opacity <= 0.0 {
            return None;
        }
        let tau = extinction(opacity, self.reference_length);
        let color = DVec3::from_array(self.transfer.color(value));
        let (color, tau) = self.on_gradient(place, color, tau, -ray.direction);
        (tau > 0.0).then_some((color, tau))
    }

    /// Colour and extinction between voxels that look each as they are.
    fn painted(&self, place: Place) -> (DVec3, f64) {
        let colors = self.volume.colors().map_or(&[][..], |colors| &colors.voxels);
        // Each label has a gradient opacity of its own.
        let by_gradient = self.labels.is_some() && !self.transfer.gradient_opacity.is_empty();
        let magnitude = if by_gradient { self.field.gradient(place).length() } else { 0.0 };
        let sum = self.field.interpolated(place, |index| {
            if let Some(Labels { voxels, tables }) = self.labels {
                let label = voxels.code(index);
                let (color, tau) = tables.look(label, self.volume.scalars().code(index));
                let tau = f64::from(tau) * tables.gradient_factor_at(label, magnitude);
                return (DVec3::from_array(color.map(f64::from)) * tau).extend(tau);
            }
            let [r, g, b, code] = colors[index].map(f64::from);
            let opacity = self.transfer.opacity(code);
            let weight = match self.sampling {
                Sampling::Extinction => extinction(opacity, self.reference_length),
                Sampling::Opacity => opacity,
            };
            (DVec3::new(r, g, b) / 255.0 * weight).extend(weight)
        });
        // Of labels it is extinction in any case.
        let is_opacity = self.sampling == Sampling::Opacity && self.labels.is_none();
        let tau = if is_opacity { extinction(sum.w, self.reference_length) } else { sum.w };
        (if sum.w > 0.0 { sum.truncate() / sum.w } else { DVec3::ZERO }, tau)
    }

    /// Colour and extinction after what depends on the gradient: light and gradient opacity.
    fn on_gradient(&self, place: Place, color: DVec3, tau: f64, to_eye: DVec3) -> (DVec3, f64) {
        if self.shading.is_none() && self.transfer.gradient_opacity.is_empty() {
            return (color, tau);
        }
        let gradient = self.field.gradient(place);
        let color =
            self.shading.map_or(color, |shading| lit(color, gradient, to_eye, shading, self.transmittance(place)));
        // That of labels is in the extinction between voxels.
        let factor = if self.labels.is_some() { 1.0 } else { self.transfer.gradient_factor(gradient.length()) };
        (color, tau * factor)
    }

    /// How much of the light that casts shadows comes through.
    fn transmittance(&self, place: Place) -> f64 {
        let lacking = |shadow: &[u8]| self.field.interpolated(place, |index| DVec4::splat(shadow[index].into())).x;
        self.shadow.map_or(1.0, |shadow| 1.0 - lacking(shadow) / 255.0)
    }
}
