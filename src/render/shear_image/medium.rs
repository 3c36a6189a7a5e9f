//! What a packet's slabs are made of: scalars that are looked up in a table, or the looks of voxels.

use glam::Vec4;

use super::composite::Middles;
use super::packet::Packet;
use super::patch::{Patch, Places, Slice};
use super::sampler::Sampler;
use crate::classify::preintegration::Slabs;
use crate::simd::wide::{LANES, Lanes, Wide};
use crate::volume::gradient::Code;

/// What is sampled, and what slabs between two samples look like.
pub(super) trait Medium<T: Code>: Copy + Sync {
    /// Where one ray meets a slice, and where eight do.
    type Sample: Copy;
    type Samples: Copy;
    /// Of rays that met none yet.
    const NOTHING: Self::Samples;
    /// What a tile needs of a layer's voxels beside their scalars.
    type Layer: Default;

    /// Makes ready the layer from slice `t` to the next, which `patch` has entered.
    fn enter(&self, patch: &Patch, packet: &Packet, t: usize, layer: &mut Self::Layer);

    /// Makes the slice `fraction` of the way from the near one to the far one.
    fn interpolate(&self, patch: &mut Patch, layer: &mut Self::Layer, fraction: f32);

    /// Where a packet meets a slice of the layer.
    fn samples<W: Wide>(&self, patch: &Patch, layer: &Self::Layer, slice: Slice, places: &Places) -> Self::Samples;

    /// One ray's of eight.
    fn sample(samples: &Self::Samples, lane: usize) -> Self::Sample;

    /// Where a lane is at slice position `t`: for the ends of rays, which are on no slice.
    fn at(&self, sampler: &Sampler<'_, T>, packet: &Packet, lane: usize, t: f32) -> Self::Sample;

    /// The slab between two samples: premultiplied colour and opacity, or the same of its optical depth.
    fn slab(&self, front: Self::Sample, back: Self::Sample) -> Vec4;

    /// Eight of them, by component.
    fn slabs<W: Wide>(&self, front: &Self::Samples, back: &Self::Samples) -> [Lanes; 4];

    /// Where voxels have gradient opacities of several kinds: slabs of what they look like in their middles with gradients of these
    /// magnitudes. `None`: they have one or none.
    fn with_gradients(
        &self,
        sampler: &Sampler<'_, T>,
        packet: &Packet,
        middles: Middles<'_>,
        magnitudes: &Lanes,
    ) -> Option<[Lanes; 4]>;
}

/// Scalars, pre-integrated.
#[derive(Clone, Copy)]
pub(super) struct Scalars<S>(pub S);

impl<T: Code, S: Slabs> Medium<T> for Scalars<S> {
    /// Positions on the table's axis.
    type Sample = f32;
    type Samples = Lanes;
    const NOTHING: Lanes = [0.0; LANES];
    type Layer = ();

    #[inline(always)]
    fn enter(&self, _: &Patch, _: &Packet, _: usize, (): &mut ()) {}

    #[inline(always)]
    fn interpolate(&self, patch: &mut Patch, (): &mut (), fraction: f32) {
        patch.interpolate(fraction);
    }

    #[inline(always)]
    fn samples<W: Wide>(&self, patch: &Patch, (): &(), slice: Slice, places: &Places) -> Lanes {
        self.0.coordinates::<W>(&patch.scalars::<W>(slice, places))
    }

    #[inline(always)]
    fn sample(samples: &Lanes, lane: usize) -> f32 {
        samples[lane]
    }

    #[inline(always)]
    fn at(&self, sampler: &Sampler<'_, T>, packet: &Packet, lane: usize, t: f32) -> f32 {
        self.0.coordinate(sampler.scalar(sampler.position(packet, lane, t)))
    }

    #[inline(always)]
    fn slab(&self, front: f32, back: f32) -> Vec4 {
        self.0.slab(front, back)
    }

    #[inline(always)]
    fn slabs<W: Wide>(&self, front: &Lanes, back: &Lanes) -> [Lanes; 4] {
        self.0.slabs::<W>(front, back)
    }

    #[inline(always)]
    fn with_gradients(&self, _: &Sampler<'_, T>, _: &Packet, _: Middles<'_>, _: &Lanes) -> Option<[Lanes; 4]> {
        None
    }
}
