//! From a stored voxel to what is composited: the view's opacity and colour tables, and shading.
//!
//! How thick a slice of voxels looks depends on the view, so the opacity of every code is corrected
//! for the length of a ray between two slices, through a table made for the frame (Lacroute and
//! Levoy 1994, section 3.1). The premultiplied colour follows the corrected opacity (Schulze et al.
//! 2003, colour correction). The two outermost slices stand for half an interval and have a table
//! of their own.
//!
//! Whether a voxel is shaded and whether its extinction is scaled by a gradient opacity are type
//! parameters: chosen once per frame, never asked per voxel.

use glam::Vec4;

use super::factorization::Factorization;
use super::shade::ShadingTable;
use crate::classify::CodeTables;
use crate::classify::rle::Voxel;

/// Colour and opacity by code, for a ray's length through a slice.
#[derive(Clone, Debug)]
pub struct SliceTables {
    /// By how many intervals a slice stands for. Red, green, blue as they are; then opacity, or
    /// (with gradient opacity) the optical depth.
    entries: Vec<(f64, Vec<Vec4>)>,
}

impl SliceTables {
    /// For the view's slice distance. With `optical_depth` the fourth component is left as
    /// extinction times length, to be scaled by a voxel's gradient opacity.
    pub fn new(tables: &CodeTables, factorization: &Factorization, optical_depth: bool) -> Self {
        let mut shares: Vec<f64> = factorization.slices.clone().map(|k| factorization.share(k)).collect();
        shares.sort_by(f64::total_cmp);
        shares.dedup();
        let entries = shares.into_iter().map(|share| {
            let length = (factorization.slice_distance * share) as f32;
            let entry = |(tau, [r, g, b]): (&f32, &[f32; 3])| {
                let depth = tau * length;
                let w = if optical_depth || depth == 0.0 { depth } else { opacity(depth) };
                Vec4::new(*r, *g, *b, w)
            };
            (share, tables.extinction.iter().zip(&tables.color).map(entry).collect())
        });
        Self { entries: entries.collect() }
    }
}

/// Opacity of an optical depth.
#[inline(always)]
fn opacity(depth: f32) -> f32 {
    -(-depth).exp_m1()
}

/// Voxel -> premultiplied colour and opacity.
#[derive(Clone, Copy, Debug)]
pub struct Material<'a, const LIT: bool, const FACTORED: bool> {
    tables: &'a SliceTables,
    shades: &'a [[f32; 2]],
}

/// A [`Material`] for the voxels of one slice.
#[derive(Clone, Copy, Debug)]
pub struct SliceMaterial<'a, const LIT: bool, const FACTORED: bool> {
    table: &'a [Vec4],
    shades: &'a [[f32; 2]],
}

impl<'a, const LIT: bool, const FACTORED: bool> Material<'a, LIT, FACTORED> {
    /// `shading` is needed where `LIT`; `tables` must hold optical depths where `FACTORED`.
    pub fn new(tables: &'a SliceTables, shading: Option<&'a ShadingTable>) -> Self {
        Self { tables, shades: shading.map_or(&[], ShadingTable::entries) }
    }

    /// For a slice that stands for `share` intervals, as one of the factorization does.
    #[inline(always)]
    pub fn slice(&self, share: f64) -> SliceMaterial<'a, LIT, FACTORED> {
        let entries = &self.tables.entries;
        let (_, table) = entries.iter().find(|entry| entry.0 == share).unwrap_or(&entries[0]);
        SliceMaterial { table, shades: self.shades }
    }
}

impl<const LIT: bool, const FACTORED: bool> SliceMaterial<'_, LIT, FACTORED> {
    /// Premultiplied colour and opacity of a voxel; `factor` is its gradient opacity, 255 = 1.
    #[inline(always)]
    pub fn color(&self, voxel: Voxel, factor: u8) -> Vec4 {
        let entry = self.table[usize::from(voxel.code)];
        let alpha = if FACTORED { opacity(entry.w * f32::from(factor) / 255.0) } else { entry.w };
        let color = if LIT {
            let [scale, add] = self.shades[usize::from(voxel.normal)];
            (entry * scale + Vec4::splat(add)).min(Vec4::ONE)
        } else {
            entry
        };
        (color * alpha).with_w(alpha)
    }
}
