//! The pass of slabs: which table the options ask for, and the kernel's type parameters.

use std::sync::Arc;
use std::time::Instant;

use super::{Begun, LightTable, Pass, Tables};
use crate::classify::preintegration::{Bilinear, Form, Nearest, OneDimensional, ShortSlabTable, SlabTables, Slabs};
use crate::render::composite::float_slabs::FloatSlabs;
use crate::render::composite::lattice::{self, Lattice, Unit};
use crate::render::composite::naive::{NaiveLattice, NaiveSlabs};
use crate::render::composite::occupied::Occupied;
use crate::render::composite::samples::{Quads, VoxelLight, VoxelRows};
use crate::render::composite::short_slabs::ShortSlabs;
use crate::render::composite::slabs::{Slab, SlabComposite};
use crate::render::intermediate::IntermediateImage;
use crate::render::material::{NoShadow, Shadowed, ShortLights, ShortShadow};
use crate::render::slab::{AsItIs, Correction, LookedUp, OpacityCorrectionTable, RayByRay, Scaled};
use crate::render::{Lookup, OpacityCorrection, RenderError, SlabTable};
use crate::volume::gradient::Code;
use crate::volume::scanlines::{AnyScanlines, Scanlines};

impl Pass<'_> {
    /// Composites slabs into `image`.
    pub(super) fn slabs(&self, image: &mut IntermediateImage) -> Result<Begun, RenderError> {
        let options = &self.settings.preintegration;
        let volume = self.scene.prepared.volume();
        let distance = volume.placement().spacing[self.factorization.principal_axis];
        let view_length = self.factorization.slice_distance;
        // The length that slabs are made for, and the view's in units of it.
        let (made_for, length) = match options.opacity_correction {
            OpacityCorrection::View => (view_length, 1.0),
            OpacityCorrection::Lookup => (distance, view_length / distance),
            OpacityCorrection::Off => (distance, 1.0),
        };
        let scaled = !self.scene.transfer.gradient_opacity.is_empty();
        let form = if scaled { Form::OpticalDepth } else { Form::Opacity };
        let tables = self.classification.slabs().expect("the classification is of slabs");
        let making = Instant::now();
        let slab_length = (made_for / options.samples_per_voxel as f64) as f32;
        match options.table {
            SlabTable::OneDimensional => {
                let sums = tables.running_sums(form, slab_length);
                let preintegration_table = making.elapsed();
                let begun = self.with_table(OneDimensional(&sums), scaled, length, image)?;
                Ok(Begun { preintegration_table, ..begun })
            }
            SlabTable::TwoDimensional => {
                if let Some((table, lights)) = self.short_table(tables, slab_length, length) {
                    let preintegration_table = making.elapsed();
                    let begun = self.with_shorts(&table, &lights, image)?;
                    return Ok(Begun { preintegration_table, ..begun });
                }
                let table = tables.table(form, slab_length);
                let preintegration_table = making.elapsed();
                let begun = match options.lookup {
                    Lookup::Nearest => self.with_table(Nearest(&table), scaled, length, image),
                    Lookup::Bilinear => self.with_table(Bilinear(&table), scaled, length, image),
                }?;
                Ok(Begun { preintegration_table, ..begun })
            }
        }
    }

    /// A table of 16-bit fractions for slabs of `slab_length` mm, which are `length` times as long in the view, and their lights with and without that which
    /// casts shadows, where these will do.
    fn short_table(
        &self,
        tables: &SlabTables,
        slab_length: f32,
        length: f64,
    ) -> Option<(Arc<ShortSlabTable>, [Option<ShortLights>; 2])> {
        let options = &self.settings.preintegration;
        let as_it_is = self.factorization.is_parallel()
            && length == 1.0
            && options.samples_per_voxel == 1
            && options.lookup == Lookup::Bilinear;
        let plain = self.cue.is_none() && self.scene.transfer.gradient_opacity.is_empty();
        if !(as_it_is && plain) {
            return None;
        }
        let Tables { light, in_shadow } = self.tables;
        let lights = [light.by_normal(), in_shadow.as_ref().and_then(LightTable::by_normal)];
        let [light, in_shadow] = lights.map(ShortLights::if_any);
        let lights = [light?, in_shadow?];
        Some((tables.short_table(slab_length, self.factorization.layers())?, lights))
    }

    fn with_shorts(
        &self,
        table: &ShortSlabTable,
        [lights, in_shadow]: &[Option<ShortLights>; 2],
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        match in_shadow.as_ref().zip(self.lacking()) {
            Some((in_shadow, lacking)) => {
                let shadow = Shadowed { in_shadow: in_shadow.by_any_code(), lacking };
                self.with_shadow(table, lights.as_ref(), shadow, image)
            }
            None => self.with_shadow(table, lights.as_ref(), NoShadow, image),
        }
    }

    fn with_shadow(
        &self,
        table: &ShortSlabTable,
        lights: Option<&ShortLights>,
        shadow: impl ShortShadow,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        let Self { scene, factorization, .. } = *self;
        let light = lights.map(|lights| (scene.prepared.normals(factorization.principal_axis), lights));
        match scene.prepared.scanlines(factorization.principal_axis) {
            AnyScanlines::U8(scanlines) => {
                self.with_slabs(Unit, ShortSlabs::new(scanlines, light, shadow, factorization, table), image)
            }
            AnyScanlines::U16(scanlines) => {
                self.with_slabs(Unit, ShortSlabs::new(scanlines, light, shadow, factorization, table), image)
            }
        }
    }

    fn with_table<S: Slabs>(
        &self,
        table: S,
        scaled: bool,
        length: f64,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        let off = self.settings.preintegration.opacity_correction == OpacityCorrection::Off;
        match (scaled, self.factorization.is_parallel()) {
            (true, true) => self.with_correction(Unit, table, Scaled { length: length as f32 }, image),
            (true, false) => self.with_correction(lattice::Scaled, table, Scaled { length: length as f32 }, image),
            (false, false) if off => self.with_correction(lattice::Scaled, table, AsItIs, image),
            (false, false) => self.with_correction(lattice::Scaled, table, RayByRay { length: length as f32 }, image),
            (false, true) if length == 1.0 => self.with_correction(Unit, table, AsItIs, image),
            (false, true) => self.with_correction(Unit, table, LookedUp(&OpacityCorrectionTable::new(length)), image),
        }
    }

    fn with_correction<L: NaiveLattice, S: Slabs, C: Correction>(
        &self,
        lattice: L,
        table: S,
        correction: C,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        let Self { scene, factorization, .. } = *self;
        let (eight, sixteen);
        let voxels: &dyn Quads = match scene.prepared.scanlines(factorization.principal_axis) {
            AnyScanlines::U8(scanlines) => {
                eight = self.voxel_rows(scanlines);
                &eight
            }
            AnyScanlines::U16(scanlines) => {
                sixteen = self.voxel_rows(scanlines);
                &sixteen
            }
        };
        self.with_slabs(lattice, FloatSlabs { voxels, table, correction }, image)
    }

    fn with_slabs<L: Lattice, Q: NaiveSlabs<L>>(
        &self,
        lattice: L,
        source: Q,
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        let Self { scene, factorization, settings, .. } = *self;
        let composite = SlabComposite {
            lattice,
            source,
            factorization,
            occupied: Occupied::new(self.classification, scene.encodings, factorization),
            slabs: Slab::all::<L>(factorization, settings.preintegration.samples_per_voxel, self.cue),
            buffer: settings.preintegration.buffer,
            opaque: settings.early_ray_termination,
            cancel: self.cancel,
        };
        self.run(&composite, image)
    }

    fn voxel_rows<'a, T: Code>(&'a self, scanlines: Scanlines<'a, T>) -> VoxelRows<'a, T> {
        let Self { scene, factorization, tables, .. } = *self;
        let rows = VoxelRows::new(
            scanlines,
            scene.prepared.volume(),
            factorization,
            self.light(&tables.light),
            scene.transfer,
        );
        match tables.in_shadow.as_ref().zip(self.lacking()) {
            None => rows,
            Some((light, lacking)) => rows.shadowed(self.light(light), lacking),
        }
    }

    fn light<'a>(&'a self, table: &'a LightTable) -> VoxelLight<'a> {
        match table {
            LightTable::Off => VoxelLight::Off,
            LightTable::ByNormal(table) => VoxelLight::ByNormal {
                shades: table.entries(),
                normals: self.scene.prepared.normals(self.factorization.principal_axis),
            },
            LightTable::ByRay(light) => VoxelLight::ByRay(light),
        }
    }
}
