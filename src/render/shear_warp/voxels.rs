//! The pass of single voxels: where they come from, and the kernel's other type parameters.

use super::{Begun, Pass};
use crate::classify::Encodings;
use crate::render::RenderError;
use crate::render::composite::occupied::LeafRows;
use crate::render::composite::samples::VoxelRows;
use crate::render::composite::sources::{Unencoded, VoxelSource};
use crate::render::composite::voxels::Voxels;
use crate::render::intermediate::IntermediateImage;
use crate::render::material::{Material, SliceTables};
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
        let leaves = LeafRows::new(classification.occupied(), factorization);
        let source = Unencoded {
            voxels: VoxelRows::new(scanlines, scene.prepared.volume(), factorization, &[], scene.transfer),
            leaves: &leaves,
            tables: classification.tables(),
        };
        self.with_source(source, image)
    }

    fn with_source<V: VoxelSource>(&self, source: V, image: &mut IntermediateImage) -> Result<Begun, RenderError> {
        let factored = !self.scene.transfer.gradient_opacity.is_empty();
        let tables = SliceTables::new(self.classification.tables(), self.factorization, factored);
        match (self.shading.is_some(), factored) {
            (true, true) => self.run(&self.composite::<_, true, true>(source, &tables), image),
            (true, false) => self.run(&self.composite::<_, true, false>(source, &tables), image),
            (false, true) => self.run(&self.composite::<_, false, true>(source, &tables), image),
            (false, false) => self.run(&self.composite::<_, false, false>(source, &tables), image),
        }
    }

    fn composite<'b, V: VoxelSource, const LIT: bool, const FACTORED: bool>(
        &'b self,
        source: V,
        tables: &'b SliceTables,
    ) -> Voxels<'b, V, LIT, FACTORED> {
        Voxels {
            source,
            factorization: self.factorization,
            material: Material::new(tables, self.shading),
            cue: self.cue,
            opaque: self.settings.early_ray_termination,
            cancel: self.cancel,
        }
    }
}
