//! The pass of single voxels: the kernel's type parameters.

use std::time::Instant;

use super::Pass;
use crate::classify::{Encodings, RunLengthVolume};
use crate::render::RenderError;
use crate::render::composite::voxels::Voxels;
use crate::render::intermediate::IntermediateImage;
use crate::render::material::{Material, SliceTables};

impl Pass<'_> {
    /// Composites voxels into `image`; gives when the tables were there.
    pub(super) fn voxels(&self, image: &mut IntermediateImage) -> Result<Instant, RenderError> {
        let factored = !self.scene.transfer.gradient_opacity.is_empty();
        let tables = SliceTables::new(self.classification.tables(), self.factorization, factored);
        let made;
        let run_lengths = match self.scene.encodings.and_then(Encodings::voxels) {
            Some(run_lengths) => run_lengths,
            None => {
                let (codes, occupied) = (self.classification.tables(), self.classification.occupied());
                made = RunLengthVolume::encode(self.scene.prepared, codes, self.scene.transfer, occupied);
                &made
            }
        };
        match (self.settings.shading.is_some(), factored) {
            (true, true) => self.run(&self.encoded::<true, true>(&tables, run_lengths), image),
            (true, false) => self.run(&self.encoded::<true, false>(&tables, run_lengths), image),
            (false, true) => self.run(&self.encoded::<false, true>(&tables, run_lengths), image),
            (false, false) => self.run(&self.encoded::<false, false>(&tables, run_lengths), image),
        }
    }

    fn encoded<'b, const LIT: bool, const FACTORED: bool>(
        &'b self,
        tables: &'b SliceTables,
        run_lengths: &'b RunLengthVolume,
    ) -> Voxels<'b, LIT, FACTORED> {
        Voxels {
            encoding: run_lengths.for_axis(self.factorization.principal_axis),
            factorization: self.factorization,
            material: Material::new(tables, self.table),
            opaque: self.settings.early_ray_termination,
            cancel: self.cancel,
        }
    }
}
