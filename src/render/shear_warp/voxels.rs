//! The pass of single voxels: where they come from, and the kernel's other type parameters.

use glam::Vec4;

use super::{Begun, LightTable, Pass};
use crate::classify::Encodings;
use crate::classify::labels::Labels;
use crate::render::composite::Composite;
use crate::render::composite::lattice::{Lattice, Scaled, Unit};
use crate::render::composite::naive::{NaiveVoxels, Pixels};
use crate::render::composite::samples::{VoxelLight, VoxelRows};
use crate::render::composite::sources::{Stored, Unencoded, VoxelSource};
use crate::render::composite::voxels::{VoxelLattice, Voxels};
use crate::render::intermediate::IntermediateImage;
use crate::render::material::{
    AnyLight, ByNormal, ByRay, Light, Material, Paint, Painted, Shader, Shadowless, ShortMaterial, ShortTables,
    SliceTables, Unlit,
};
use crate::render::{RenderError, Sampling};
use crate::volume::Scalars;
use crate::volume::gradient::Code;
use crate::volume::scanlines::{AnyScanlines, Scanlines};

impl Pass<'_> {
    /// Composites voxels into `image`: encoded ones where they are there, else as they are stored.
    pub(super) fn voxels(&self, image: &mut IntermediateImage) -> Result<Begun, RenderError> {
        let axis = self.factorization.principal_axis;
        match self.scene.encodings.and_then(Encodings::voxels) {
            Some(encoded) => self.with_source(encoded.for_axis(axis), image),
            None => match self.scene.prepared.scanlines(axis) {
                AnyScanlines::U8(scanlines) => self.unencoded(scanlines, image),
                AnyScanlines::U16(scanlines) => self.unencoded(scanlines, image),
            },
        }
    }

    fn unencoded<T: Code>(
        &self,
        scanlines: Scanlines<'_, T>,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        let Self { scene, classification, factorization, .. } = *self;
        let visible = classification.visible().expect("the classification is of voxels");
        let source = Unencoded {
            voxels: VoxelRows::new(scanlines, scene.prepared.volume(), factorization, VoxelLight::Off, scene.transfer),
            normals: scene.prepared.normals(factorization.principal_axis),
            visible: visible.for_axis(factorization.principal_axis),
            tables: classification.tables(),
        };
        self.with_source(source, image)
    }

    fn with_source<V: VoxelSource>(&self, source: V, image: &mut IntermediateImage) -> Result<Begun, RenderError> {
        if let Some(paint) = self.paint() {
            let painted = Painted { light: self.any_light(), paint, sampling: self.settings.sampling };
            return self.with_lattice(source, painted, image);
        }
        if let Some(tables) = self.shorts() {
            let lacking = self.lacking();
            return match lacking.and_then(|lacking| ShortMaterial::shadowed(&tables, lacking)) {
                Some(shadowed) => self.with_material(Unit, source, shadowed, image),
                None => self.with_material(Unit, source, ShortMaterial::new(&tables), image),
            };
        }
        match &self.tables.light {
            _ if self.tables.in_shadow.is_some() => self.with_lattice(source, self.any_light(), image),
            LightTable::ByRay(light) => self.with_light(Scaled, source, ByRay(light), image),
            LightTable::ByNormal(table) => self.with_light(Unit, source, ByNormal::new(table), image),
            LightTable::Off => self.with_lattice(source, Unlit, image),
        }
    }

    /// Tables of 16-bit fractions, where these will do.
    fn shorts(&self) -> Option<ShortTables> {
        if !self.factorization.is_parallel() || self.cue.is_some() || self.is_factored() {
            return None;
        }
        let in_shadow = self.tables.in_shadow.as_ref().and_then(LightTable::by_normal);
        let light = self.tables.light.by_normal();
        ShortTables::new(self.classification.tables(), self.factorization, light, in_shadow)
    }

    /// True where opacity depends on the gradient.
    fn is_factored(&self) -> bool {
        !self.scene.transfer.gradient_opacity.is_empty()
    }

    fn with_lattice<V: VoxelSource, H: Light>(
        &self,
        source: V,
        light: H,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        if self.factorization.is_parallel() {
            self.with_light(Unit, source, light, image)
        } else {
            self.with_light(Scaled, source, light, image)
        }
    }

    /// The light, whatever it is.
    fn any_light(&self) -> AnyLight<'_> {
        let shadowless = |table| match table {
            &LightTable::Off => Shadowless::Unlit,
            LightTable::ByNormal(table) => Shadowless::ByNormal(ByNormal::new(table)),
            LightTable::ByRay(light) => Shadowless::ByRay(ByRay(light)),
        };
        let in_shadow = self.tables.in_shadow.as_ref().map(shadowless);
        AnyLight { light: shadowless(&self.tables.light), shadow: in_shadow.zip(self.lacking()) }
    }

    /// What voxels look like by themselves, where they do.
    fn paint(&self) -> Option<Paint<'_>> {
        if let Some(Labels { voxels, tables }) = self.scene.labels {
            return Some(match voxels {
                Scalars::U8(labels) => Paint::Labels8(Stored::new(labels, self.factorization), tables),
                Scalars::U16(labels) => Paint::Labels16(Stored::new(labels, self.factorization), tables),
            });
        }
        let colors = self.scene.prepared.volume().colors()?;
        Some(Paint::Colors(Stored::new(&colors.voxels, self.factorization)))
    }

    fn with_light<L: VoxelLattice<Vec4> + NaiveVoxels<Vec4>, V: VoxelSource, H: Light>(
        &self,
        lattice: L,
        source: V,
        light: H,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        let factored = self.is_factored();
        // Opacities that are resampled are those of the length that they were given for.
        let length = (H::PAINTED && self.settings.sampling == Sampling::Opacity).then(|| {
            let volume = self.scene.prepared.volume();
            self.scene.transfer.reference_length(volume.smallest_spacing())
        });
        // Of labels' extinctions, 1 mm.
        let length = length.or(self.scene.labels.map(|_| 1.0));
        let lengths = length.map(|length| self.factorization.slice_distance / length);
        let optical_depth = factored || H::PAINTED;
        let tables = SliceTables::new(self.classification.tables(), self.factorization, length, optical_depth);
        if factored {
            self.with_material(lattice, source, Material::<_, true>::new(&tables, light, lengths), image)
        } else {
            self.with_material(lattice, source, Material::<_, false>::new(&tables, light, lengths), image)
        }
    }

    fn with_material<L: Lattice, V: VoxelSource, M: Shader>(
        &self,
        lattice: L,
        source: V,
        material: M,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError>
    where
        for<'a> Voxels<'a, L, V, M>: Composite + Pixels,
    {
        let voxels = Voxels {
            lattice,
            source,
            factorization: self.factorization,
            placements: self.factorization.slices.clone().map(|k| L::placement(self.factorization, k as f64)).collect(),
            material,
            cue: self.cue,
            opaque: self.settings.early_ray_termination,
            cancel: self.cancel,
        };
        self.run(&voxels, image)
    }
}
