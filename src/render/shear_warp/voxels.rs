//! The pass of single voxels: the kernel's type parameters.

use super::{Begun, Pass};
use crate::classify::{Encodings, RunLengthVolume};
use crate::render::RenderError;
use crate::render::composite::voxels::Voxels;
use crate::render::intermediate::IntermediateImage;
use crate::render::material::{Material, SliceTables};

impl Pass<'_> {
    /// Composites voxels into `image`.
    pub(super) fn voxels(&self, image: &mut IntermediateImage) -> Result<Begun, RenderError> {
        let factored = !self.scene.transfer.gradient_opacity.is_empty();
        let made;
        let run_lengths = match self.scene.encodings.and_then(Encodings::voxels) {
            Some(run_lengths) => run_lengths,
            None => {
                let (tables, occupied) = (self.classification.tables(), self.classification.occupied());
                made = RunLengthVolume::encode(self.scene.prepared, tables, self.scene.transfer, occupied);
                &made
            }
        };
        let tables = SliceTables::new(self.classification.tables(), self.factorization, factored);
        match (self.shading.is_some(), factored) {
            (true, true) => self.run(&self.encoded::<true, true>(run_lengths, &tables), image),
            (true, false) => self.run(&self.encoded::<true, false>(run_lengths, &tables), image),
            (false, true) => self.run(&self.encoded::<false, true>(run_lengths, &tables), image),
            (false, false) => self.run(&self.encoded::<false, false>(run_lengths, &tables), image),
        }
    }

    fn encoded<'b, const LIT: bool, const FACTORED: bool>(
        &'b self,
        run_lengths: &'b RunLengthVolume,
        tables: &'b SliceTables,
    ) -> Voxels<'b, LIT, FACTORED> {
        Voxels {
            encoding: run_lengths.for_axis(self.factorization.principal_axis),
            factorization: self.factorization,
            material: Material::new(tables, self.shading),
            opaque: self.settings.early_ray_termination,
            cancel: self.cancel,
        }
    }
}
