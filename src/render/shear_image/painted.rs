//! Voxels that look each as they are: those of colour volumes, and those of labels.
//!
//! There are no scalars to pre-integrate. Extinction and the colour weighted by it are interpolated between voxels, and a slab has
//! the mean of what its front and its back have (extinction-based sampling; Kraus and Bürger 2008, section 3). Opacity-based
//! sampling interpolates opacities of the reference length in their place and makes extinctions of the samples.

use glam::Vec4;

use super::composite::Middles;
use super::medium::Medium;
use super::packet::{IN_SLICE, Packet};
use super::patch::{Patch, Places, Slice};
use super::sampler::Sampler;
use crate::classify::CodeTables;
use crate::classify::labels::LabelTables;
use crate::classify::transfer::extinction;
use crate::render::{Sampling, Scene};
use crate::simd::wide::{LANES, Lanes, Wide};
use crate::volume::Scalars;
use crate::volume::gradient::Code;

/// The looks of a volume's voxels, in the volume's order.
pub(super) struct Looks<'a, T> {
    codes: &'a [T],
    dims: [usize; 3],
    paint: Paint<'a>,
    /// Of opacity-based sampling: the length that opacities are for, mm.
    opacity_length: Option<f64>,
}

/// Where they come from.
enum Paint<'a> {
    /// Colours of their own; weights by code.
    Colors(&'a [[u8; 4]], Vec<f32>),
    /// Colour and extinction by label.
    Labels8(&'a [u8], &'a LabelTables),
    Labels16(&'a [u16], &'a LabelTables),
}

impl<'a, T: Code> Looks<'a, T> {
    /// Of a scene whose voxels are not told by their scalars alone.
    pub fn of(codes: &'a [T], scene: &Scene<'a>, tables: &CodeTables, sampling: Sampling) -> Option<Self> {
        let volume = scene.prepared.volume();
        let looks = |paint, opacity_length| Some(Self { codes, dims: volume.dims(), paint, opacity_length });
        if let Some(labels) = scene.labels {
            return match labels.voxels {
                Scalars::U8(voxels) => looks(Paint::Labels8(voxels, labels.tables), None),
                Scalars::U16(voxels) => looks(Paint::Labels16(voxels, labels.tables), None),
            };
        }
        let colors = &volume.colors()?.voxels;
        match sampling {
            Sampling::Extinction => looks(Paint::Colors(colors, tables.extinction.clone()), None),
            Sampling::Opacity => {
                let length = scene.transfer.reference_length(volume.smallest_spacing());
                let opacities = tables.extinction.iter().map(|tau| -(-tau * length as f32).exp_m1()).collect();
                looks(Paint::Colors(colors, opacities), Some(length))
            }
        }
    }

    /// Colour times weight, and the weight: extinction per mm, or opacity.
    fn voxel(&self, index: usize, code: u16) -> Vec4 {
        let mut voxel = [Vec4::ZERO];
        self.row(index, 1, &[code.into()], &mut voxel);
        voxel[0]
    }

    /// The same of voxels from one on, so far apart.
    fn row(&self, first: usize, stride: usize, codes: &[f32], out: &mut [Vec4]) {
        match &self.paint {
            Paint::Colors(colors, weights) => {
                for ((out, code), [r, g, b, _]) in out.iter_mut().zip(codes).zip(colors[first..].iter().step_by(stride))
                {
                    let color = Vec4::new((*r).into(), (*g).into(), (*b).into(), 255.0);
                    *out = color * (weights[*code as usize] / 255.0);
                }
            }
            Paint::Labels8(labels, tables) => looks_of(&labels[first..], stride, tables, codes, out),
            Paint::Labels16(labels, tables) => looks_of(&labels[first..], stride, tables, codes, out),
        }
    }

    /// The same with a gradient of a magnitude in scalar units per mm; `None` but for labels.
    #[inline(always)]
    fn voxel_with_gradient(&self, index: usize, magnitude: f64) -> Option<Vec4> {
        let factor = match &self.paint {
            Paint::Colors(..) => return None,
            Paint::Labels8(labels, tables) => tables.gradient_factor_at(labels[index].into(), magnitude),
            Paint::Labels16(labels, tables) => tables.gradient_factor_at(labels[index], magnitude),
        };
        Some(self.voxel(index, self.codes[index].into()) * factor as f32)
    }
}

/// What every so many labels say of codes.
fn looks_of<L: Copy + Into<u16>>(labels: &[L], stride: usize, tables: &LabelTables, codes: &[f32], out: &mut [Vec4]) {
    for ((out, code), label) in out.iter_mut().zip(codes).zip(labels.iter().step_by(stride)) {
        let ([r, g, b], extinction) = tables.look((*label).into(), *code as u16);
        *out = Vec4::new(r, g, b, 1.0) * extinction;
    }
}

/// The medium between such voxels.
pub(super) struct Painted<'a, T> {
    pub looks: &'a Looks<'a, T>,
    /// Labels have gradient opacities.
    pub by_gradient: bool,
}

impl<T> Clone for Painted<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Painted<'_, T> {}

/// The looks of a layer's voxels at its near and its far side, and between them.
#[derive(Default)]
pub(super) struct PaintedLayer {
    slices: [Vec<Vec4>; 2],
    between: Vec<Vec4>,
}

impl<T: Code> Painted<'_, T> {
    /// A sample's colour weighted by its extinction, and that.
    #[inline(always)]
    fn extinct(&self, sample: Vec4) -> Vec4 {
        match self.looks.opacity_length {
            Some(length) if sample.w > 0.0 => {
                let tau = extinction(sample.w.into(), length) as f32;
                (sample * (tau / sample.w)).with_w(tau)
            }
            _ => sample,
        }
    }
}

impl<T: Code> Medium<T> for Painted<'_, T> {
    /// Extinction per mm, and before it the colour weighted by that.
    type Sample = Vec4;
    type Samples = [Lanes; 4];
    const NOTHING: Self::Samples = [[0.0; LANES]; 4];
    type Layer = PaintedLayer;

    #[inline(always)]
    fn enter(&self, patch: &Patch, packet: &Packet, t: usize, layer: &mut PaintedLayer) {
        let dims = self.looks.dims;
        let strides = [1, dims[0], dims[0] * dims[1]];
        let [i, j] = IN_SLICE[packet.axis].map(|axis| strides[axis]);
        for (side, out) in layer.slices.iter_mut().enumerate() {
            let k = if packet.reversed { dims[packet.axis] - 1 - (t + side) } else { t + side };
            let slice = k * strides[packet.axis];
            patch.paint(side, out, |[along, across], codes, out| {
                self.looks.row(slice + along * i + across * j, i, codes, out);
            });
        }
    }

    #[inline(always)]
    fn interpolate(&self, _: &mut Patch, layer: &mut PaintedLayer, fraction: f32) {
        let PaintedLayer { slices: [near, far], between } = layer;
        between.clear();
        between.extend(near.iter().zip(far.iter()).map(|(near, far)| *near + (*far - *near) * fraction));
    }

    #[inline(always)]
    fn samples<W: Wide>(&self, patch: &Patch, layer: &PaintedLayer, slice: Slice, places: &Places) -> [Lanes; 4] {
        let voxels = match slice {
            Slice::Near => &layer.slices[0],
            Slice::Between => &layer.between,
            Slice::Far => &layer.slices[1],
        };
        let mut samples = patch.vectors::<W>(voxels, places);
        if self.looks.opacity_length.is_some() {
            for lane in 0..LANES {
                let sample = self.extinct(Self::sample(&samples, lane));
                for (component, samples) in samples.iter_mut().enumerate() {
                    samples[lane] = sample[component];
                }
            }
        }
        samples
    }

    #[inline(always)]
    fn sample(samples: &[Lanes; 4], lane: usize) -> Vec4 {
        Vec4::from_array([0, 1, 2, 3].map(|component| samples[component][lane]))
    }

    #[inline(always)]
    fn at(&self, sampler: &Sampler<'_, T>, packet: &Packet, lane: usize, t: f32) -> Vec4 {
        let voxel = |index: usize| self.looks.voxel(index, self.looks.codes[index].into());
        self.extinct(sampler.interpolated(sampler.position(packet, lane, t), voxel))
    }

    #[inline(always)]
    fn slab(&self, front: Vec4, back: Vec4) -> Vec4 {
        (front + back) * 0.5
    }

    #[inline(always)]
    fn slabs<W: Wide>(&self, front: &[Lanes; 4], back: &[Lanes; 4]) -> [Lanes; 4] {
        let mut slabs = *front;
        for (slabs, back) in slabs.iter_mut().zip(back) {
            for lane in 0..LANES {
                slabs[lane] = (slabs[lane] + back[lane]) * 0.5;
            }
        }
        slabs
    }

    fn with_gradients(
        &self,
        sampler: &Sampler<'_, T>,
        packet: &Packet,
        middles: Middles<'_>,
        magnitudes: &Lanes,
    ) -> Option<[Lanes; 4]> {
        if !self.by_gradient {
            return None;
        }
        let mut slabs = [[0.0; LANES]; 4];
        for lane in 0..LANES {
            let magnitude = f64::from(magnitudes[lane]);
            let voxel = |index| self.looks.voxel_with_gradient(index, magnitude).unwrap_or_default();
            let slab = sampler.interpolated(sampler.position(packet, lane, middles.of(lane)), voxel);
            for (component, slabs) in slabs.iter_mut().enumerate() {
                slabs[lane] = slab[component];
            }
        }
        Some(slabs)
    }
}
