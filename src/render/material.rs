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

mod light;
mod painted;
mod shorts;

use std::fmt::Debug;

use glam::Vec4;

use super::composite::sources::{Gathered, VoxelSource};
use super::composite::{first_run, run_mask};
use super::factorization::Factorization;
use super::pixel::{BLOCK, Pixel, WORD};
use super::simd::numbers::{Array, Numbers, exp_m1};
use super::simd::shorts::Shorts;
#[cfg(target_arch = "x86_64")]
use super::simd::wide::Avx2;
use super::simd::wide::{LANES, Lanes, Portable, Wide};
use super::simd::{self, Kernel};
use crate::classify::CodeTables;
use crate::classify::rle::Voxel;
pub use light::{AnyLight, ByNormal, ByRay, Light, Shadowless, Unlit};
pub use painted::{Paint, Painted};
pub use shorts::{ANY_CODE, NoShadow, Shadowed, ShortLights, ShortMaterial, ShortShadow, ShortTables};

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
        let entries = shares(factorization).into_iter().map(|share| {
            let length = length.unwrap_or(factorization.slice_distance * share) as f32;
            let mut entries = vec![Vec4::ZERO; tables.extinction.len()];
            simd::dispatch(Entries { tables, length, optical_depth, entries: &mut entries });
            (share, entries)
        });
        Self { entries: entries.collect() }
    }
}

/// How many intervals slices stand for, ascending.
fn shares(factorization: &Factorization) -> Vec<f64> {
    let mut shares: Vec<f64> = factorization.slices.clone().map(|k| factorization.share(k)).collect();
    shares.sort_by(f64::total_cmp);
    shares.dedup();
    shares
}

/// Opacity of an optical depth.
#[inline(always)]
fn opacity(depth: f32) -> f32 {
    opacities(Array([depth])).0[0]
}

/// The same side by side.
#[inline(always)]
fn opacities<V: Numbers>(depths: V) -> V {
    let zero = V::all(0.0);
    zero - exp_m1(zero - depths)
}

/// The job: entries by code, for rays of a `length` in mm; as [`SliceTables::new`] tells.
struct Entries<'a> {
    tables: &'a CodeTables,
    length: f32,
    optical_depth: bool,
    entries: &'a mut [Vec4],
}

impl Kernel for Entries<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.fill::<Portable>();
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) {
        self.fill::<Avx2>();
    }
}

impl Entries<'_> {
    #[inline(always)]
    fn fill<W: Wide>(self) {
        let Self { tables: CodeTables { extinction, color, .. }, length, optical_depth, entries } = self;
        let codes = extinction.chunks(LANES).zip(color.chunks(LANES));
        for ((taus, colors), entries) in codes.zip(entries.chunks_mut(LANES)) {
            let depths = depths(taus, length);
            let fourth = if optical_depth { depths } else { opacities(W::Numbers::load(&depths)).store() };
            for ((entry, [r, g, b]), w) in entries.iter_mut().zip(colors).zip(fourth) {
                *entry = Vec4::new(*r, *g, *b, w);
            }
        }
    }
}

/// Optical depths of up to eight extinctions.
#[inline(always)]
fn depths(taus: &[f32], length: f32) -> Lanes {
    let mut depths = [0.0; LANES];
    for (depth, tau) in depths.iter_mut().zip(taus) {
        *depth = tau * length;
    }
    depths
}

/// Voxel -> premultiplied colour and opacity.
pub trait Shader: Copy + Debug + Send + Sync {
    /// The shader for the voxels of one slice.
    type Slice: SliceShader;

    /// For a slice that stands for `share` intervals, as one of the factorization does.
    fn slice(&self, share: f64) -> Self::Slice;
}

/// A [`Shader`] for the voxels of one slice. Implementations are `#[inline(always)]`.
pub trait SliceShader: Copy {
    /// What voxels are made into.
    type Pixel: Pixel;
    /// False where colours stay as they are.
    const LIT: bool;
    /// True where voxels have a gradient opacity.
    const FACTORED: bool;
    /// True where samples must be [`Self::resampled`].
    const PAINTED: bool;

    /// What is resampled of voxel (i, j, k); `factor` is its gradient opacity, 255 = 1.
    fn voxel(&self, voxel: Voxel, factor: u8, at: [usize; 3]) -> Self::Pixel;

    /// The same of a word of voxels: of every aligned four whose first bit is `asked` for. Nothing where none is marked.
    fn word<W: Shorts, V: VoxelSource>(
        &self,
        source: &V,
        word: &VoxelWord<V::Word>,
        asked: u64,
        out: &mut [Self::Pixel; WORD],
    );

    /// Premultiplied colour and opacity of what was resampled, along a ray of a `length` in units of the shortest.
    fn resampled(&self, sample: Self::Pixel, length: f32) -> Self::Pixel;
}

/// Voxels of a scanline that one word of marks tells of.
#[derive(Clone, Copy, Debug)]
pub struct VoxelWord<S> {
    /// Set where a voxel may be drawn.
    pub marks: u64,
    /// Where a source has those.
    pub voxels: S,
    /// (i, j, k) of the word's first voxel.
    pub at: [usize; 3],
}

/// How many voxels are marked before one of a word's.
#[inline(always)]
pub fn before(marks: u64, voxel: usize) -> usize {
    (marks & ((1 << voxel) - 1)).count_ones() as usize
}

/// The [`Shader`] of floats.
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
}

impl<'a, H: Light, const FACTORED: bool> Shader for Material<'a, H, FACTORED> {
    type Slice = SliceMaterial<'a, H, FACTORED>;

    #[inline(always)]
    fn slice(&self, share: f64) -> SliceMaterial<'a, H, FACTORED> {
        SliceMaterial {
            table: table_of(&self.tables.entries, share),
            light: self.light,
            lengths: self.lengths.map_or(1.0, |lengths| (lengths * share) as f32),
        }
    }
}

/// The table of slices that stand for `share` intervals.
#[inline(always)]
fn table_of<T>(entries: &[(f64, Vec<T>)], share: f64) -> &[T] {
    let (_, table) = entries.iter().find(|entry| entry.0 == share).unwrap_or(&entries[0]);
    table
}

impl<H: Light, const FACTORED: bool> SliceMaterial<'_, H, FACTORED> {
    #[inline(always)]
    fn color(&self, code: u16, factor: u8, [scale, add]: [f32; 2], at: [usize; 3]) -> Vec4 {
        let entry = self.table[usize::from(code)];
        let entry = if H::PAINTED { self.light.paint(entry, code, at) } else { entry };
        let alpha = if H::PAINTED {
            let depth = if FACTORED { self.light.factored(entry.w, factor, at) } else { entry.w };
            self.light.weight(depth)
        } else if FACTORED {
            opacity(self.light.factored(entry.w, factor, at))
        } else {
            entry.w
        };
        let color = if H::LIT { (entry * scale + Vec4::splat(add)).min(Vec4::ONE) } else { entry };
        (color * alpha).with_w(alpha)
    }

    #[inline(always)]
    fn voxels_by<const N: usize>(&self, voxels: &[Voxel], factors: &[u8], [i, j, k]: [usize; 3], out: &mut [Vec4]) {
        let out = &mut out[..voxels.len()];
        let mut first = 0;
        while first < voxels.len() {
            let end = (first + N).min(voxels.len());
            let mut normals = [0; N];
            for at in first..end {
                normals[at - first] = voxels[at].normal;
            }
            let [scales, addends] = self.light.shade(&normals, [i + first, j, k]);
            for at in first..end {
                let factor = if FACTORED { factors[at] } else { u8::MAX };
                let light = [scales[at - first], addends[at - first]];
                out[at] = self.color(voxels[at].code, factor, light, [i + at, j, k]);
            }
            first = end;
        }
    }
}

impl<H: Light, const FACTORED: bool> SliceShader for SliceMaterial<'_, H, FACTORED> {
    type Pixel = Vec4;
    const LIT: bool = H::LIT;
    const FACTORED: bool = FACTORED;
    const PAINTED: bool = H::PAINTED;

    #[inline(always)]
    fn voxel(&self, voxel: Voxel, factor: u8, at: [usize; 3]) -> Vec4 {
        let [[scale], [add]] = self.light.shade(&[voxel.normal], at);
        self.color(voxel.code, factor, [scale, add], at)
    }

    /// Run by run.
    #[inline(always)]
    fn word<W: Shorts, V: VoxelSource>(
        &self,
        source: &V,
        word: &VoxelWord<V::Word>,
        asked: u64,
        out: &mut [Vec4; WORD],
    ) {
        // All of each four.
        let asked = asked * 0b1111;
        let mut gathered = Gathered::default();
        let (marks, voxels, factors) = source.packed::<Self>(word, asked, &mut gathered);
        let mut empty = asked & !word.marks;
        while empty != 0 {
            let (start, length) = first_run(empty);
            empty &= !run_mask(start, length);
            out[start..start + length].fill(Vec4::ZERO);
        }
        let mut drawn = asked & word.marks;
        while drawn != 0 {
            let (start, length) = first_run(drawn);
            drawn &= !run_mask(start, length);
            let before = before(marks, start);
            let stored = before..before + length;
            let factors = if FACTORED { &factors[stored.clone()] } else { &[] };
            let ([i, j, k], out) = (word.at, &mut out[start..start + length]);
            if H::BLOCKS {
                self.voxels_by::<BLOCK>(&voxels[stored], factors, [i + start, j, k], out);
            } else {
                self.voxels_by::<1>(&voxels[stored], factors, [i + start, j, k], out);
            }
        }
    }

    #[inline(always)]
    fn resampled(&self, sample: Vec4, length: f32) -> Vec4 {
        if H::PAINTED { self.light.resampled(sample, self.lengths * length) } else { sample }
    }
}
