//! Intensity projections: the largest, the smallest or the mean scalar on a ray, as an opaque gray.
//!
//! Samples lie at both ends of every step, so that the ray's own ends count; the mean is that of the
//! straight lines between samples.
//!
//! A leaf of the octree bounds what is interpolated in it, so a sample is passed over where its
//! leaf's range holds nothing beyond what was found, and needs no interpolation where the leaf is of
//! one scalar throughout. With a segmentation a sample counts where the label of the voxel next to it shows anything.

use glam::Vec4;

use super::Stretch;
use super::field::{Field, Place};
use crate::classify::labels::Labels;
use crate::render::{IntensityProjection, Scene, Window};
use crate::volume::Volume;
use crate::volume::gradient::Code;
use crate::volume::octree::MinMaxOctree;

/// One of the projections of a volume.
pub(super) struct Intensity<'a, T> {
    field: Field<'a, T>,
    volume: &'a Volume,
    which: IntensityProjection,
    window: Window,
    labels: Option<Labels<'a>>,
    /// `None`: every sample is interpolated.
    octree: Option<&'a MinMaxOctree>,
}

impl<'a, T: Code> Intensity<'a, T> {
    pub(super) fn new(
        field: Field<'a, T>,
        scene: &Scene<'a>,
        which: IntensityProjection,
        window: Window,
        octree: Option<&'a MinMaxOctree>,
    ) -> Self {
        Self { field, volume: scene.prepared.volume(), which, window, labels: scene.labels, octree }
    }

    /// The gray of a ray inside the volume; nothing where none of it counts.
    pub(super) fn pixel(&self, stretch: &Stretch<'_>) -> Vec4 {
        let code = match self.which {
            IntensityProjection::Maximum => self.maximum(stretch),
            IntensityProjection::Minimum => self.minimum(stretch),
            IntensityProjection::Average => self.average(stretch),
        };
        if !code.is_finite() {
            return Vec4::ZERO;
        }
        let Window { center, width } = self.window;
        let gray = (self.volume.value_of_code(code) - (center - width / 2.0)) / width;
        Vec4::splat(gray.clamp(0.0, 1.0) as f32).with_w(1.0)
    }

    fn maximum(&self, stretch: &Stretch<'_>) -> f64 {
        self.samples(stretch).fold(f64::NEG_INFINITY, |found, place| {
            if self.range(place).1 <= found { found } else { found.max(self.field.code(place)) }
        })
    }

    fn minimum(&self, stretch: &Stretch<'_>) -> f64 {
        self.samples(stretch).fold(f64::INFINITY, |found, place| {
            if self.range(place).0 >= found { found } else { found.min(self.field.code(place)) }
        })
    }

    fn average(&self, stretch: &Stretch<'_>) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for n in stretch.walk().chain([stretch.steps]) {
            let place = self.field.place(stretch.at(n as f64));
            if !self.counts(place) {
                continue;
            }
            let (low, high) = self.range(place);
            let code = if low == high { low } else { self.field.code(place) };
            let weight = if n == 0 || n == stretch.steps { 0.5 } else { 1.0 };
            sum += code * weight;
            weights += weight;
        }
        sum / weights
    }

    /// The ends of all steps that count.
    fn samples(&self, stretch: &Stretch<'_>) -> impl Iterator<Item = Place> {
        let places = stretch.walk().chain([stretch.steps]).map(|n| self.field.place(stretch.at(n as f64)));
        places.filter(|place| self.counts(*place))
    }

    /// False where the label shows nothing.
    fn counts(&self, place: Place) -> bool {
        self.labels.is_none_or(|labels| labels.shows(self.field.nearest_voxel(place)))
    }

    /// The codes of the place's leaf; any, where nothing is skipped.
    fn range(&self, place: Place) -> (f64, f64) {
        self.octree.map_or((f64::NEG_INFINITY, f64::INFINITY), |octree| {
            let (low, high) = octree.leaf(self.field.leaf(place)).code;
            (low.into(), high.into())
        })
    }
}
