//! From a stored voxel to what is composited: the view's opacity and colour tables, and shading.
//!
//! How thick a slice of voxels looks depends on the view, so the opacity of every code is corrected
//! for the length of a ray between two slices, through a table made for the frame (Lacroute and
//! Levoy 1994, section 3.1). The premultiplied colour follows the corrected opacity (Schulze et al.
//! 2003, colour correction). The two outermost slices stand for half an interval and have a table
//! of their own.
//!
//! What lights a voxel and whether its extinction is scaled by a gradient opacity are type
//! parameters: chosen once per frame, never asked per voxel.

use std::fmt::Debug;

use glam::Vec4;

use super::Sampling;
use super::composite::sources::Stored;
use super::factorization::Factorization;
use super::ray_light::RayLight;
use super::shade::ShadingTable;
use crate::classify::CodeTables;
use crate::classify::labels::LabelTables;
use crate::classify::rle::Voxel;
use crate::classify::transfer::MAX_OPACITY;

/// Colour and opacity by code, for a ray's length through a slice.
#[derive(Clone, Debug)]
pub struct SliceTables {
    /// By how many intervals a slice stands for. Red, green, blue as they are; then opacity, or
    /// (with gradient opacity) the optical depth.
    entries: Vec<(f64, Vec<Vec4>)>,
}

impl SliceTables {
    /// For the view's slice distance, or for a `length` in mm where that is told. With `optical_depth` the fourth component is
    /// left as extinction times length, to be scaled by a voxel's gradient opacity.
    pub fn new(tables: &CodeTables, factorization: &Factorization, length: Option<f64>, optical_depth: bool) -> Self {
        let mut shares: Vec<f64> = factorization.slices.clone().map(|k| factorization.share(k)).collect();
        shares.sort_by(f64::total_cmp);
        shares.dedup();
        let entries = shares.into_iter().map(|share| {
            let length = length.unwrap_or(factorization.slice_distance * share) as f32;
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

/// What voxels are lit by, and whose colours they show.
pub trait Light: Copy + Debug + Send + Sync {
    /// False where colours stay as they are.
    const LIT: bool;
    /// True where light is found for eight voxels at once.
    const BLOCKS: bool;
    /// True where voxels have colours of their own.
    const PAINTED: bool = false;

    /// Factors on and addends to the colours of consecutive voxels from (i, j, k) on, by their normals' codes.
    fn shade<const N: usize>(self, normals: &[u16; N], at: [usize; 3]) -> [[f32; N]; 2];

    /// Where voxels are [`Light::PAINTED`]: what stands for the table's entry for a code, at voxel (i, j, k).
    #[inline(always)]
    fn paint(self, entry: Vec4, _: u16, _: [usize; 3]) -> Vec4 {
        entry
    }

    /// The same: the weight of its colour among others, by its optical depth.
    #[inline(always)]
    fn weight(self, depth: f32) -> f32 {
        depth
    }

    /// The same: premultiplied colour and opacity of what was resampled, for so many of the tables' lengths.
    #[inline(always)]
    fn resampled(self, sample: Vec4, _: f32) -> Vec4 {
        sample
    }
}

/// Colours as they are.
#[derive(Clone, Copy, Debug)]
pub struct Unlit;

impl Light for Unlit {
    const LIT: bool = false;
    const BLOCKS: bool = false;

    #[inline(always)]
    fn shade<const N: usize>(self, _: &[u16; N], _: [usize; 3]) -> [[f32; N]; 2] {
        [[1.0; N], [0.0; N]]
    }
}

/// Parallel rays: the normal tells it all.
#[derive(Clone, Copy, Debug)]
pub struct ByNormal<'a>(&'a [[f32; 2]]);

impl<'a> ByNormal<'a> {
    /// By a table for the view.
    pub fn new(table: &'a ShadingTable) -> Self {
        Self(table.entries())
    }
}

impl Light for ByNormal<'_> {
    const LIT: bool = true;
    const BLOCKS: bool = false;

    #[inline(always)]
    fn shade<const N: usize>(self, normals: &[u16; N], _: [usize; 3]) -> [[f32; N]; 2] {
        let mut light = [[0.0; N]; 2];
        for (n, normal) in normals.iter().enumerate() {
            [light[0][n], light[1][n]] = self.0[usize::from(*normal)];
        }
        light
    }
}

/// Each voxel along the ray that it is seen by.
#[derive(Clone, Copy, Debug)]
pub struct ByRay<'a>(pub &'a RayLight);

impl Light for ByRay<'_> {
    const LIT: bool = true;
    const BLOCKS: bool = true;

    #[inline(always)]
    fn shade<const N: usize>(self, normals: &[u16; N], at: [usize; 3]) -> [[f32; N]; 2] {
        self.0.of_normals(normals, at)
    }
}

/// Any light that casts no shadows.
#[derive(Clone, Copy, Debug)]
pub enum Shadowless<'a> {
    Unlit,
    ByNormal(ByNormal<'a>),
    ByRay(ByRay<'a>),
}

impl Shadowless<'_> {
    #[inline(always)]
    fn shade<const N: usize>(self, normals: &[u16; N], at: [usize; 3]) -> [[f32; N]; 2] {
        match self {
            Self::Unlit => Unlit.shade(normals, at),
            Self::ByNormal(light) => light.shade(normals, at),
            Self::ByRay(light) => light.shade(normals, at),
        }
    }
}

/// Any light, asked for what it is voxel by voxel: where there are shadows, or voxels have colours of their own.
#[derive(Clone, Copy, Debug)]
pub struct AnyLight<'a> {
    pub light: Shadowless<'a>,
    /// The light where the one that casts shadows is gone, and how much of that each voxel lacks, in 255ths.
    pub shadow: Option<(Shadowless<'a>, Stored<'a, u8>)>,
}

impl Light for AnyLight<'_> {
    const LIT: bool = true;
    const BLOCKS: bool = false;

    #[inline(always)]
    fn shade<const N: usize>(self, normals: &[u16; N], [i, j, k]: [usize; 3]) -> [[f32; N]; 2] {
        let mut light = self.light.shade(normals, [i, j, k]);
        if let Some((without, lacking)) = self.shadow {
            let without = without.shade(normals, [i, j, k]);
            for n in 0..N {
                let lacking = shadowed(lacking.at([i + n, j, k]));
                for term in 0..2 {
                    light[term][n] += (without[term][n] - light[term][n]) * lacking;
                }
            }
        }
        light
    }
}

/// 255ths as a fraction.
#[inline(always)]
pub fn shadowed(lacking: u8) -> f32 {
    f32::from(lacking) / 255.0
}

/// Voxels that look each as they are, and not by their codes alone. What is interpolated between them follows Kraus and Bürger 2008.
#[derive(Clone, Copy, Debug)]
pub struct Painted<'a> {
    pub light: AnyLight<'a>,
    pub paint: Paint<'a>,
    pub sampling: Sampling,
}

/// Where the looks of voxels come from.
#[derive(Clone, Copy, Debug)]
pub enum Paint<'a> {
    /// Colours of their own; extinction by the transfer function.
    Colors(Stored<'a, [u8; 4]>),
    /// Colour and extinction by label, the latter per mm.
    Labels8(Stored<'a, u8>, &'a LabelTables),
    Labels16(Stored<'a, u16>, &'a LabelTables),
}

impl Light for Painted<'_> {
    const LIT: bool = true;
    const BLOCKS: bool = false;
    const PAINTED: bool = true;

    #[inline(always)]
    fn shade<const N: usize>(self, normals: &[u16; N], at: [usize; 3]) -> [[f32; N]; 2] {
        self.light.shade(normals, at)
    }

    #[inline(always)]
    fn paint(self, entry: Vec4, code: u16, at: [usize; 3]) -> Vec4 {
        let ([r, g, b], extinction) = match self.paint {
            Paint::Colors(colors) => {
                let [r, g, b, _] = colors.at(at).map(f32::from);
                return (Vec4::new(r, g, b, 0.0) / 255.0).with_w(entry.w);
            }
            Paint::Labels8(labels, tables) => tables.look(labels.at(at).into(), code),
            Paint::Labels16(labels, tables) => tables.look(labels.at(at), code),
        };
        Vec4::new(r, g, b, extinction)
    }

    #[inline(always)]
    fn weight(self, depth: f32) -> f32 {
        match self.sampling {
            Sampling::Extinction => depth,
            Sampling::Opacity => opacity(depth),
        }
    }

    #[inline(always)]
    fn resampled(self, sample: Vec4, lengths: f32) -> Vec4 {
        if sample.w <= 0.0 {
            return Vec4::ZERO;
        }
        let depth = match self.sampling {
            Sampling::Extinction => sample.w,
            Sampling::Opacity => -(-sample.w.min(MAX_OPACITY as f32)).ln_1p(),
        };
        let alpha = opacity(depth * lengths);
        (sample * (alpha / sample.w)).with_w(alpha)
    }
}

/// Voxel -> premultiplied colour and opacity.
#[derive(Clone, Copy, Debug)]
pub struct Material<'a, H, const FACTORED: bool> {
    tables: &'a SliceTables,
    light: H,
    /// Where the tables are not for the view's slice distance: how many of their lengths that is.
    lengths: Option<f64>,
}

/// A [`Material`] for the voxels of one slice.
#[derive(Clone, Copy, Debug)]
pub struct SliceMaterial<'a, H, const FACTORED: bool> {
    table: &'a [Vec4],
    light: H,
    /// Of what the tables are for: how much a slice stands for.
    lengths: f32,
}

impl<'a, H: Light, const FACTORED: bool> Material<'a, H, FACTORED> {
    /// `tables` must hold optical depths where `FACTORED` and where voxels have colours of their own; with `lengths`, how many of
    /// their lengths lie between two slices.
    pub fn new(tables: &'a SliceTables, light: H, lengths: Option<f64>) -> Self {
        Self { tables, light, lengths }
    }

    /// For a slice that stands for `share` intervals, as one of the factorization does.
    #[inline(always)]
    pub fn slice(&self, share: f64) -> SliceMaterial<'a, H, FACTORED> {
        let entries = &self.tables.entries;
        let (_, table) = entries.iter().find(|entry| entry.0 == share).unwrap_or(&entries[0]);
        SliceMaterial {
            table,
            light: self.light,
            lengths: self.lengths.map_or(1.0, |lengths| (lengths * share) as f32),
        }
    }
}

impl<H: Light, const FACTORED: bool> SliceMaterial<'_, H, FACTORED> {
    /// Factors on and addends to the colours of consecutive voxels from (i, j, k) on, by their normals' codes.
    #[inline(always)]
    pub fn light<const N: usize>(&self, normals: &[u16; N], at: [usize; 3]) -> [[f32; N]; 2] {
        self.light.shade(normals, at)
    }

    /// What is resampled of voxel (i, j, k): its premultiplied colour and opacity, but for [`Self::resampled`]; `factor` is its
    /// gradient opacity, 255 = 1.
    #[inline(always)]
    pub fn color(&self, code: u16, factor: u8, [scale, add]: [f32; 2], at: [usize; 3]) -> Vec4 {
        let entry = self.table[usize::from(code)];
        let entry = if H::PAINTED { self.light.paint(entry, code, at) } else { entry };
        let alpha = if H::PAINTED {
            let depth = if FACTORED { entry.w * f32::from(factor) / 255.0 } else { entry.w };
            self.light.weight(depth)
        } else if FACTORED {
            opacity(entry.w * f32::from(factor) / 255.0)
        } else {
            entry.w
        };
        let color = if H::LIT { (entry * scale + Vec4::splat(add)).min(Vec4::ONE) } else { entry };
        (color * alpha).with_w(alpha)
    }

    /// Premultiplied colour and opacity of what was resampled, along a ray of a `length` in units of the shortest.
    #[inline(always)]
    pub fn resampled(&self, sample: Vec4, length: f32) -> Vec4 {
        if H::PAINTED { self.light.resampled(sample, self.lengths * length) } else { sample }
    }

    /// The colours of consecutive voxels from (i, j, k) on; `factors` are looked at where `FACTORED`.
    #[inline(always)]
    pub fn colors(&self, voxels: &[Voxel], factors: &[u8], at: [usize; 3], out: &mut [Vec4]) {
        if H::BLOCKS {
            self.colors_by::<8>(voxels, factors, at, out);
        } else {
            self.colors_by::<1>(voxels, factors, at, out);
        }
    }

    #[inline(always)]
    fn colors_by<const N: usize>(&self, voxels: &[Voxel], factors: &[u8], [i, j, k]: [usize; 3], out: &mut [Vec4]) {
        let out = &mut out[..voxels.len()];
        let mut first = 0;
        while first < voxels.len() {
            let end = (first + N).min(voxels.len());
            let mut normals = [0; N];
            for at in first..end {
                normals[at - first] = voxels[at].normal;
            }
            let [scales, addends] = self.light(&normals, [i + first, j, k]);
            for at in first..end {
                let factor = if FACTORED { factors[at] } else { u8::MAX };
                let light = [scales[at - first], addends[at - first]];
                out[at] = self.color(voxels[at].code, factor, light, [i + at, j, k]);
            }
            first = end;
        }
    }
}
