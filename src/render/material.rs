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
use super::composite::sources::{Gathered, Stored, VoxelSource};
use super::composite::{first_run, run_mask};
use super::factorization::Factorization;
use super::intermediate::Spare;
use super::pixel::{BLOCK, Pixel, WORD, first_four, nearest, short};
use super::ray_light::RayLight;
use super::shade::ShadingTable;
use super::simd::numbers::{Array, Numbers, exp_m1};
use super::simd::shorts::{FOUR, Short, ShortLight, Shorts, UNIT};
#[cfg(target_arch = "x86_64")]
use super::simd::wide::Avx2;
use super::simd::wide::{LANES, Lanes, Portable, Wide, least};
use super::simd::{self, Kernel};
use crate::classify::CodeTables;
use crate::classify::labels::LabelTables;
use crate::classify::rle::Voxel;
use crate::classify::transfer::MAX_OPACITY;
use crate::volume::gradient::NORMAL_CODES;

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

    /// What is left of a voxel's optical depth by its byte of gradient opacity.
    #[inline(always)]
    fn factored(self, depth: f32, factor: u8, _: [usize; 3]) -> f32 {
        depth * f32::from(factor) / 255.0
    }

    /// Where voxels are [`Light::PAINTED`]: the weight of its colour among others, by its optical depth.
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
    fn factored(self, depth: f32, factor: u8, at: [usize; 3]) -> f32 {
        match self.paint {
            Paint::Colors(_) => depth * f32::from(factor) / 255.0,
            Paint::Labels8(labels, tables) => depth * tables.gradient_factor(labels.at(at).into(), factor),
            Paint::Labels16(labels, tables) => depth * tables.gradient_factor(labels.at(at), factor),
        }
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

/// Entries of a table that has one for whatever code there is, so that none is out of bounds.
pub const ANY_CODE: usize = 1 << u16::BITS;

static SPARE_ENTRIES: Spare<Short> = Spare::none();
static SPARE_LIGHTS: Spare<ShortLight> = Spare::none();

/// Tables of 16-bit fractions for a frame whose voxels are told by their codes and normals. What they hold for codes that there are none of
/// is of another frame.
#[derive(Debug)]
pub struct ShortTables {
    /// By how many intervals a slice stands for. Premultiplied colour, not lit yet, and opacity.
    entries: Vec<(f64, Vec<Short>)>,
    lights: ShortLights,
}

impl Drop for ShortTables {
    fn drop(&mut self) {
        self.entries.drain(..).for_each(|(_, table)| SPARE_ENTRIES.give(table));
    }
}

/// Lights of a frame by their normals' codes.
#[derive(Debug)]
pub struct ShortLights(Vec<ShortLight>);

impl Drop for ShortLights {
    fn drop(&mut self) {
        SPARE_LIGHTS.give(std::mem::take(&mut self.0));
    }
}

/// A table to be filled from its first entry on.
fn for_any_code<T: Copy + Default>(spare: &Spare<T>) -> Vec<T> {
    let mut table = spare.take();
    table.resize(ANY_CODE, T::default());
    table
}

/// A shading table without light.
static UNLIT: [[f32; 2]; NORMAL_CODES] = [[1.0, 0.0]; NORMAL_CODES];

/// Floats' lights to be shortened; [`Kernel::run`] gives the greatest of their numbers.
struct ShortenLights<'a> {
    shading: &'a [[f32; 2]],
    lights: &'a mut [ShortLight],
}

impl Kernel for ShortenLights<'_> {
    type Output = f32;

    #[inline(always)]
    fn run(self) -> f32 {
        let (from, to) = (self.shading.as_flattened(), self.lights.as_flattened_mut());
        let mut brightest = 0;
        for (number, light) in from.iter().zip(to) {
            // Of numbers that are not negative the bits are in order, too.
            brightest = brightest.max(number.to_bits());
            *light = nearest(number * (f32::from(UNIT) / 2.0));
        }
        f32::from_bits(brightest)
    }
}

impl ShortLights {
    /// The greatest factor or addend.
    const BRIGHTEST: f32 = 1.999;

    /// Those of a table (`None`: unlit); `None` where one is brighter than twice the full strength.
    pub fn new(shading: Option<&ShadingTable>) -> Option<Self> {
        let mut lights = Self(for_any_code(&SPARE_LIGHTS));
        let shading = shading.map_or(&UNLIT[..], ShadingTable::entries);
        let brightest = simd::dispatch(ShortenLights { shading, lights: &mut lights.0 });
        (brightest <= Self::BRIGHTEST).then_some(lights)
    }

    /// By any 16 bits.
    #[inline(always)]
    pub fn by_any_code(&self) -> &[ShortLight; ANY_CODE] {
        let Some(lights) = self.0.first_chunk() else { unreachable!("tables are for any code") };
        lights
    }
}

/// The job: the same as 16-bit fractions; gives the least opacity above 0.
struct ShortEntries<'a> {
    tables: &'a CodeTables,
    length: f32,
    entries: &'a mut [Short],
}

impl Kernel for ShortEntries<'_> {
    type Output = f32;

    #[inline(always)]
    fn run(self) -> f32 {
        self.fill::<Portable>()
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) -> f32 {
        self.fill::<Avx2>()
    }
}

impl ShortEntries<'_> {
    #[inline(always)]
    fn fill<W: Wide>(self) -> f32 {
        let Self { tables: CodeTables { extinction, color, .. }, length, entries } = self;
        let ((taus, last_taus), (colors, last_colors)) = (extinction.as_chunks(), color.as_chunks());
        let (entries, _) = entries.as_chunks_mut();
        let mut faintest = [f32::INFINITY; LANES];
        for ((taus, colors), entries) in taus.iter().zip(colors).zip(&mut *entries) {
            eight::<W>(taus, colors, length, entries, &mut faintest);
        }
        if let Some(entries) = entries.get_mut(taus.len()) {
            let (mut taus, mut colors) = ([0.0; LANES], [[0.0; 3]; LANES]);
            taus[..last_taus.len()].copy_from_slice(last_taus);
            colors[..last_colors.len()].copy_from_slice(last_colors);
            eight::<W>(&taus, &colors, length, entries, &mut faintest);
        }
        faintest.into_iter().fold(f32::INFINITY, least)
    }
}

/// Eight of them; `faintest` are the least opacities above 0 so far.
#[inline(always)]
fn eight<W: Wide>(
    taus: &Lanes,
    colors: &[[f32; 3]; LANES],
    length: f32,
    entries: &mut [Short; LANES],
    faintest: &mut Lanes,
) {
    let mut any = 0;
    for tau in taus {
        any |= tau.to_bits();
    }
    if any == 0 {
        *entries = [Short::CLEAR; LANES];
        return;
    }
    let opacities = opacities(W::Numbers::load(&depths(taus, length))).store();
    let mut premultiplied = [0.0; 4 * LANES];
    for lane in 0..LANES {
        let opacity = if opacities[lane] > 0.0 { opacities[lane] } else { f32::INFINITY };
        faintest[lane] = least(opacity, faintest[lane]);
        let [r, g, b] = colors[lane];
        let entry = Vec4::new(r, g, b, 1.0) * opacities[lane];
        premultiplied[4 * lane..][..4].copy_from_slice(&entry.to_array());
    }
    let mut shorts = [0; 4 * LANES];
    for n in 0..4 * LANES {
        shorts[n] = short(premultiplied[n]);
    }
    *entries = bytemuck::cast(shorts);
}

impl ShortTables {
    /// The least opacity that a slice may have, but for nothing: rounded, it is off by 1 in 128, and what is seen of a
    /// medium by less than 1 in 255.
    const LEAST_OPACITY: f32 = 1.0 / 512.0;

    /// For the view's slice distance; `None` where they would hold what 16 bits are too coarse or too few for.
    pub fn new(tables: &CodeTables, factorization: &Factorization, shading: Option<&ShadingTable>) -> Option<Self> {
        let mut short = Self { entries: vec![], lights: ShortLights::new(shading)? };
        let shares = shares(factorization);
        for &share in &shares {
            let mut entries = for_any_code(&SPARE_ENTRIES);
            let length = (factorization.slice_distance * share) as f32;
            let faintest = simd::dispatch(ShortEntries { tables, length, entries: &mut entries });
            short.entries.push((share, entries));
            // The outermost slices, which stand for less, may be fainter.
            if Some(&share) == shares.last() && faintest < Self::LEAST_OPACITY {
                return None;
            }
        }
        Some(short)
    }
}

/// The [`Shader`] of 16-bit fractions.
#[derive(Clone, Copy, Debug)]
pub struct ShortMaterial<'a>(pub &'a ShortTables);

/// A [`ShortMaterial`] for the voxels of one slice.
#[derive(Clone, Copy, Debug)]
pub struct ShortSlice<'a> {
    table: &'a [Short; ANY_CODE],
    lights: &'a [ShortLight; ANY_CODE],
}

impl<'a> Shader for ShortMaterial<'a> {
    type Slice = ShortSlice<'a>;

    #[inline(always)]
    fn slice(&self, share: f64) -> ShortSlice<'a> {
        let Some(table) = table_of(&self.0.entries, share).first_chunk() else {
            unreachable!("tables are for any code")
        };
        ShortSlice { table, lights: self.0.lights.by_any_code() }
    }
}

impl SliceShader for ShortSlice<'_> {
    type Pixel = Short;
    const LIT: bool = true;
    const FACTORED: bool = false;
    const PAINTED: bool = false;

    #[inline(always)]
    fn voxel(&self, voxel: Voxel, _: u8, _: [usize; 3]) -> Short {
        self.table[usize::from(voxel.code)].lit(self.lights[usize::from(voxel.normal)])
    }

    /// Four by four.
    #[inline(always)]
    fn word<W: Shorts, V: VoxelSource>(
        &self,
        source: &V,
        word: &VoxelWord<V::Word>,
        asked: u64,
        out: &mut [Short; WORD],
    ) {
        // Of few the end of another loop would take longer to foresee than to shade nothing.
        let mut left = asked;
        while left != 0 {
            let at = first_four(left);
            left &= left - 1;
            let four = source.four(word, at);
            let (mut entries, mut lights) = ([Short::CLEAR; FOUR], [[0; 2]; FOUR]);
            for n in 0..FOUR {
                entries[n] = self.table[usize::from(four[n].code)];
                lights[n] = self.lights[usize::from(four[n].normal)];
            }
            let shaded = if V::PACKED {
                W::shade::<true>(entries, lights, word.marks >> at)
            } else {
                W::shade::<false>(entries, lights, word.marks >> at)
            };
            out[at..at + FOUR].copy_from_slice(&shaded);
        }
    }

    #[inline(always)]
    fn resampled(&self, sample: Short, _: f32) -> Short {
        sample
    }
}
