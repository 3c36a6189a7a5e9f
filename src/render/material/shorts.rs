//! Tables of 16-bit fractions, and the [`Shader`] that reads them.

use std::fmt::Debug;

use glam::Vec4;

use super::{Shader, SliceShader, VoxelWord, depths, opacities, shares, table_of};
use crate::classify::CodeTables;
use crate::classify::rle::Voxel;
use crate::render::composite::sources::{Stored, VoxelSource};
use crate::render::factorization::Factorization;
use crate::render::pixel::{WORD, first_four, nearest, short};
use crate::render::shade::ShadingTable;
use crate::render::simd::numbers::Numbers;
use crate::render::simd::shorts::{FOUR, Short, ShortLight, Shorts, UNIT, darkened};
#[cfg(target_arch = "x86_64")]
use crate::render::simd::wide::Avx2;
use crate::render::simd::wide::{LANES, Lanes, Portable, Wide, least};
use crate::render::simd::{self, Kernel};
use crate::render::spare::Spare;
use crate::volume::gradient::NORMAL_CODES;

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
    /// The same without the light that casts shadows, if one does.
    in_shadow: Option<ShortLights>,
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

    /// The same, or none where there is no table.
    pub fn if_any(shading: Option<&ShadingTable>) -> Option<Option<Self>> {
        match shading {
            None => Some(None),
            shading => Self::new(shading).map(Some),
        }
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

    /// For the view's slice distance; `None` where they would hold what 16 bits are too coarse or too few for. `in_shadow` is the light without that which
    /// casts shadows.
    pub fn new(
        tables: &CodeTables,
        factorization: &Factorization,
        shading: Option<&ShadingTable>,
        in_shadow: Option<&ShadingTable>,
    ) -> Option<Self> {
        let (lights, in_shadow) = (ShortLights::new(shading)?, ShortLights::if_any(in_shadow)?);
        let mut short = Self { entries: vec![], lights, in_shadow };
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

/// Shadows on voxels.
pub trait ShortShadow: Copy + Debug + Send + Sync {
    /// The light of voxel (i, j, k), which without shadows is `light`.
    fn one(self, light: ShortLight, normal: u16, at: [usize; 3]) -> ShortLight;

    /// The same of four voxels from (i, j, k) on or, if they are `PACKED`, of those of them whose bits are set in `marked`, one after the other.
    fn four<W: Shorts, const PACKED: bool>(
        self,
        lights: [ShortLight; FOUR],
        normals: [u16; FOUR],
        at: [usize; 3],
        marked: u64,
    ) -> [ShortLight; FOUR];
}

/// None.
#[derive(Clone, Copy, Debug)]
pub struct NoShadow;

impl ShortShadow for NoShadow {
    #[inline(always)]
    fn one(self, light: ShortLight, _: u16, _: [usize; 3]) -> ShortLight {
        light
    }

    #[inline(always)]
    fn four<W: Shorts, const PACKED: bool>(
        self,
        lights: [ShortLight; FOUR],
        _: [u16; FOUR],
        _: [usize; 3],
        _: u64,
    ) -> [ShortLight; FOUR] {
        lights
    }
}

/// Those of one light: what is left without it, and how much of it each voxel lacks, in 255ths.
#[derive(Clone, Copy, Debug)]
pub struct Shadowed<'a> {
    pub in_shadow: &'a [ShortLight; ANY_CODE],
    pub lacking: Stored<'a, u8>,
}

/// Of four, by their bits: those that are set, one after the other.
const PACKED_ORDER: [[u8; FOUR]; 16] = {
    let mut order = [[0; FOUR]; 16];
    let mut bits = 0;
    while bits < order.len() {
        let (mut n, mut next) = (0, 0);
        while n < FOUR {
            if bits >> n & 1 == 1 {
                order[bits][next] = n as u8;
                next += 1;
            }
            n += 1;
        }
        bits += 1;
    }
    order
};

impl ShortShadow for Shadowed<'_> {
    #[inline(always)]
    fn one(self, light: ShortLight, normal: u16, at: [usize; 3]) -> ShortLight {
        darkened(light, self.in_shadow[usize::from(normal)], self.lacking.at(at))
    }

    #[inline(always)]
    fn four<W: Shorts, const PACKED: bool>(
        self,
        lights: [ShortLight; FOUR],
        normals: [u16; FOUR],
        at: [usize; 3],
        marked: u64,
    ) -> [ShortLight; FOUR] {
        let mut lacking = self.lacking.four(at);
        if PACKED {
            let (all, order) = (lacking, PACKED_ORDER[marked as usize % 16]);
            for n in 0..FOUR {
                lacking[n] = all[usize::from(order[n])];
            }
        }
        let mut in_shadow = [[0; 2]; FOUR];
        for n in 0..FOUR {
            in_shadow[n] = self.in_shadow[usize::from(normals[n])];
        }
        W::darken(lights, in_shadow, lacking)
    }
}

/// The [`Shader`] of 16-bit fractions.
#[derive(Clone, Copy, Debug)]
pub struct ShortMaterial<'a, D> {
    tables: &'a ShortTables,
    shadow: D,
}

impl<'a> ShortMaterial<'a, NoShadow> {
    /// Without shadows.
    pub fn new(tables: &'a ShortTables) -> Self {
        Self { tables, shadow: NoShadow }
    }
}

impl<'a> ShortMaterial<'a, Shadowed<'a>> {
    /// With those of the light that the tables tell apart, if they do; `lacking`: how much of it voxels lack, in 255ths.
    pub fn shadowed(tables: &'a ShortTables, lacking: Stored<'a, u8>) -> Option<Self> {
        let in_shadow = tables.in_shadow.as_ref()?.by_any_code();
        Some(Self { tables, shadow: Shadowed { in_shadow, lacking } })
    }
}

/// A [`ShortMaterial`] for the voxels of one slice.
#[derive(Clone, Copy, Debug)]
pub struct ShortSlice<'a, D> {
    table: &'a [Short; ANY_CODE],
    lights: &'a [ShortLight; ANY_CODE],
    shadow: D,
}

impl<'a, D: ShortShadow> Shader for ShortMaterial<'a, D> {
    type Slice = ShortSlice<'a, D>;

    #[inline(always)]
    fn slice(&self, share: f64) -> ShortSlice<'a, D> {
        let Some(table) = table_of(&self.tables.entries, share).first_chunk() else {
            unreachable!("tables are for any code")
        };
        ShortSlice { table, lights: self.tables.lights.by_any_code(), shadow: self.shadow }
    }
}

impl<D: ShortShadow> SliceShader for ShortSlice<'_, D> {
    type Pixel = Short;
    const LIT: bool = true;
    const FACTORED: bool = false;
    const PAINTED: bool = false;

    #[inline(always)]
    fn voxel(&self, voxel: Voxel, _: u8, at: [usize; 3]) -> Short {
        let light = self.shadow.one(self.lights[usize::from(voxel.normal)], voxel.normal, at);
        self.table[usize::from(voxel.code)].lit(light)
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
            let (mut entries, mut lights, mut normals) = ([Short::CLEAR; FOUR], [[0; 2]; FOUR], [0; FOUR]);
            for n in 0..FOUR {
                entries[n] = self.table[usize::from(four[n].code)];
                lights[n] = self.lights[usize::from(four[n].normal)];
                normals[n] = four[n].normal;
            }
            let ([i, j, k], marked) = (word.at, word.marks >> at);
            let shaded = if V::PACKED {
                let lights = self.shadow.four::<W, true>(lights, normals, [i + at, j, k], marked);
                W::shade::<true>(entries, lights, marked)
            } else {
                let lights = self.shadow.four::<W, false>(lights, normals, [i + at, j, k], marked);
                W::shade::<false>(entries, lights, marked)
            };
            out[at..at + FOUR].copy_from_slice(&shaded);
        }
    }

    #[inline(always)]
    fn resampled(&self, sample: Short, _: f32) -> Short {
        sample
    }
}
