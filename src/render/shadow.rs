//! Shadows of a directional light: how much of it each voxel lacks.
//!
//! A second sheared accumulation, along the light's rays instead of the viewer's, as Lacroute's library VolPack has it. The
//! light's own factorization shears the slices so that its rays become parallel to the stack. Slice by slice, away from the light, the
//! resampled opacities take from a buffer what has come through so far, and before a slice does so its voxels read from the buffer how
//! much reaches them. The buffer stays on one lattice, so what is blurred is blurred once, however deep the volume is.
//!
//! A slice's voxels are not shadowed by the [`BIAS`] slices before it: what a voxel of a surface shares with its neighbours would
//! otherwise darken it (VolPack's shadow bias).
//!
//! What comes out has no view in it: it is made once for a light and serves all frames. It is a field like the scalars, on the
//! volume's own grid, and what samples between voxels interpolates it.
//!
//! Scanlines of the buffer are independent, so bands of them are jobs. A band owns the voxel scanlines that end in it, on
//! every slice, and keeps one scanline of the buffer more, to interpolate.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::Clip;
use super::composite::WORD;
use super::composite::occupied::LeafRows;
use super::composite::samples::{VoxelLight, VoxelRows};
use super::factorization::{Factorization, SlicePlacement};
use super::ranges::hull;
use super::simd::{self, Kernel};
use crate::classify::labels::Labels;
use crate::classify::{Classification, CodeTables, TransferFunction};
use crate::volume::gradient::Code;
use crate::volume::scanlines::{AnyScanlines, Scanlines, turn};
use crate::volume::{PreparedVolume, Volume};

/// Takes from light, told by factors on colours and addends to them, what is lacking of the light that casts shadows: so much of all of
/// it. `in_shadow` is what is left without.
#[inline(always)]
pub fn darken<const N: usize>(light: &mut [[f32; N]; 2], in_shadow: &[[f32; N]; 2], lacking: [f32; N]) {
    for (light, in_shadow) in light.iter_mut().zip(in_shadow) {
        for n in 0..N {
            light[n] += (in_shadow[n] - light[n]) * lacking[n];
        }
    }
}

/// 255ths as a fraction.
#[inline(always)]
pub fn part_of(lacking: u8) -> f32 {
    f32::from(lacking) / 255.0
}

/// Slices before a voxel's own that cast no shadow on it.
pub const BIAS: usize = 4;

/// Scanlines of the buffer that one job computes.
const BAND_HEIGHT: usize = 32;

/// What each voxel lacks of a light.
#[derive(Clone, Debug, PartialEq)]
pub struct Shadow {
    /// In 255ths, x fastest. Voxels far from all that shows have 0.
    lacking: Vec<u8>,
}

impl Shadow {
    /// Bytes in memory of a shadow on a volume of `dims` voxels.
    pub fn bytes_of(dims: [usize; 3]) -> u64 {
        dims.iter().map(|n| *n as u64).product()
    }

    /// What each voxel lacks of the light, 0 to 255, x fastest.
    pub fn lacking(&self) -> &[u8] {
        &self.lacking
    }

    /// Lets a volume under a transfer function (of which labels, if there are any, show a part) cast shadows, away from a light
    /// that lies `towards` (world, of any length above 0), but for what is outside of `clip` or in one of `holes`. Runs on the
    /// current rayon pool.
    pub fn cast(
        prepared: &PreparedVolume,
        transfer: &TransferFunction,
        labels: Option<Labels<'_>>,
        towards: DVec3,
        clip: &Clip,
        holes: &[Clip],
    ) -> Self {
        let volume = prepared.volume();
        let factorization = Factorization::along_rays(-towards.normalize(), volume);
        let (tables, length) = (CodeTables::new(volume, transfer, 0.0), factorization.slice_distance as f32);
        let occupied = Classification::leaves(prepared, transfer, &tables);
        let around = with_neighbours(&occupied, prepared.octree().leaf_dims());
        let world_from_voxel = factorization.world_from_voxel(volume);
        let cast = Cast {
            factorization: &factorization,
            placements: (0..factorization.dims[2]).map(|k| factorization.slice(k)).collect(),
            casters: LeafRows::new(&occupied, &factorization),
            receivers: LeafRows::new(&around, &factorization),
            clip: clip.told_by(world_from_voxel),
            holes: holes.iter().map(|hole| hole.told_by(world_from_voxel)).collect(),
            opacity: tables.extinction.iter().map(|tau| -(-tau * length).exp_m1()).collect(),
            tables: &tables,
            labels,
        };
        let lacking = match prepared.scanlines(factorization.principal_axis) {
            AnyScanlines::U8(scanlines) => cast.run(scanlines, volume, transfer),
            AnyScanlines::U16(scanlines) => cast.run(scanlines, volume, transfer),
        };
        Self { lacking }
    }
}

/// Leaves, and those that touch them.
fn with_neighbours(leaves: &[bool], dims: [usize; 3]) -> Vec<bool> {
    let mut all = leaves.to_vec();
    for axis in 0..3 {
        let stride: usize = dims[..axis].iter().product();
        let alone = all.clone();
        for (at, leaf) in all.iter_mut().enumerate() {
            let place = at / stride % dims[axis];
            *leaf |= place > 0 && alone[at - stride] || place + 1 < dims[axis] && alone[at + stride];
        }
    }
    all
}

/// What a light's rays pass.
struct Cast<'a> {
    factorization: &'a Factorization,
    placements: Vec<SlicePlacement>,
    /// Voxels that may show something, and those that may be beside one.
    casters: LeafRows,
    receivers: LeafRows,
    /// In voxel coordinates.
    clip: Clip,
    holes: Vec<Clip>,
    /// Opacity of a slice by code.
    opacity: Vec<f32>,
    tables: &'a CodeTables,
    labels: Option<Labels<'a>>,
}

impl Cast<'_> {
    /// What each voxel lacks, x fastest.
    fn run<T: Code>(&self, scanlines: Scanlines<'_, T>, volume: &Volume, transfer: &TransferFunction) -> Vec<u8> {
        let Self { factorization, placements, .. } = self;
        let [ni, nj, nk] = factorization.dims;
        let voxels = VoxelRows::new(scanlines, volume, factorization, VoxelLight::Off, transfer);
        let mut lacking = vec![0; ni * nj * nk];
        let mut rows: Vec<_> = lacking.chunks_exact_mut(ni).map(Some).collect();
        let bands = factorization.size[1].div_ceil(BAND_HEIGHT);
        let mut owned: Vec<Vec<Owned<'_>>> = (0..bands).map(|_| vec![]).collect();
        for position in 0..nk {
            let k = factorization.along(position as f64) as usize;
            for j in 0..nj {
                let row = rows[scanlines.place(j, k)].take().expect("a scanline is one band's");
                owned[(placements[k].first[1] + j) / BAND_HEIGHT].push(Owned { position, j, row });
            }
        }
        owned.into_par_iter().enumerate().for_each(|(band, owned)| {
            let first = band * BAND_HEIGHT;
            simd::dispatch(Band { cast: self, voxels: &voxels, vs: first..first + BAND_HEIGHT, owned });
        });
        // The scanlines of the principal axis x run along y.
        if factorization.principal_axis == 0 { turn(&lacking, ni, nk) } else { lacking }
    }
}

/// A scanline of voxels that a band fills.
struct Owned<'a> {
    /// Of its slice, from the light on.
    position: usize,
    j: usize,
    row: &'a mut [u8],
}

/// Some scanlines of the buffer.
struct Band<'a, T> {
    cast: &'a Cast<'a>,
    voxels: &'a VoxelRows<'a, T>,
    vs: Range<usize>,
    /// In the order of slices.
    owned: Vec<Owned<'a>>,
}

impl<T: Code> Kernel for Band<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { cast, voxels, vs, owned } = self;
        let f = cast.factorization;
        let k_of = |position: usize| f.along(position as f64) as usize;
        // From one pixel before the first.
        let width = f.size[0] + 2;
        let mut light = vec![1.0; (vs.len() + 1) * width];
        let mut slice = Slice::new(f.dims[0]);
        let mut cast_by = 0;
        for Owned { position, j, row } in owned {
            // A band may own nothing of some slices, which cast shadows all the same.
            while cast_by + BIAS < position {
                let k = k_of(cast_by);
                slice.enter(k, cast.placements[k]);
                for (v, light) in (vs.start..=vs.end).zip(light.chunks_exact_mut(width)) {
                    // The scanline before the band's first.
                    if v > 0 {
                        slice.attenuate(cast, voxels, v - 1, light);
                    }
                }
                cast_by += 1;
            }
            let k = k_of(position);
            let placement = &cast.placements[k];
            let upper = (placement.first[1] + j - vs.start) * width;
            let rows = [&light[upper..][..width], &light[upper + width..][..width]];
            receive(cast.receivers.scanline(j, k), placement, rows, row);
        }
    }
}

/// Voxels of `row` take what comes through from the pixels around them, of the scanline before and that on or after theirs.
#[inline(always)]
fn receive(receivers: &[u64], placement: &SlicePlacement, [before, after]: [&[f32]; 2], row: &mut [u8]) {
    let [fu, fv] = placement.fraction;
    let Some(stretch) = stretch(receivers, row.len()) else { return };
    // Pixel u is at u + 1; voxel i is after pixel first + i - 1.
    let (first, length) = (placement.first[0] + stretch.start, stretch.len());
    let [before, after] = [before, after].map(|row| &row[first..][..length + 1]);
    for (n, out) in row[stretch].iter_mut().enumerate() {
        let mut column = [0.0; 2];
        for (side, column) in column.iter_mut().enumerate() {
            *column = after[n + side] + (before[n + side] - after[n + side]) * fv;
        }
        let [left, right] = column;
        let reaching = right + (left - right) * fu;
        *out = (255.5 - 255.0 * reaching) as u8;
    }
}

/// From the first to the last voxel of `length` whose bit is set.
#[inline(always)]
fn stretch(bits: &[u64], length: usize) -> Option<Range<usize>> {
    let first = bits.iter().position(|&word| word != 0)?;
    let last = bits.iter().rposition(|&word| word != 0)?;
    let start = first * WORD + bits[first].trailing_zeros() as usize;
    let end = ((last + 1) * WORD - bits[last].leading_zeros() as usize).min(length);
    (start < end).then_some(start..end)
}

/// Opacities of two scanlines of a slice.
struct Slice {
    k: usize,
    placement: SlicePlacement,
    rows: [Row; 2],
    /// The two, weighted.
    mixed: Vec<f32>,
}

/// Opacities of a scanline.
struct Row {
    j: Option<usize>,
    /// Voxel i is at i + 1; zero outside of `stretch`, and beside the scanline's ends.
    opacities: Vec<f32>,
    stretch: Range<usize>,
}

impl Slice {
    /// For scanlines of `length` voxels.
    fn new(length: usize) -> Self {
        let row = || Row { j: None, opacities: vec![0.0; length + 2], stretch: 0..0 };
        let placement = SlicePlacement { first: [0; 2], fraction: [0.0; 2] };
        Self { k: 0, placement, rows: [row(), row()], mixed: vec![0.0; length + 2] }
    }

    /// Becomes slice `k`.
    #[inline(always)]
    fn enter(&mut self, k: usize, placement: SlicePlacement) {
        (self.k, self.placement) = (k, placement);
        self.rows.iter_mut().for_each(|row| row.j = None);
    }

    /// Takes from the light of scanline `v` of the buffer what the slice holds back.
    #[inline(always)]
    fn attenuate<T: Code>(&mut self, cast: &Cast<'_>, voxels: &VoxelRows<'_, T>, v: usize, light: &mut [f32]) {
        let SlicePlacement { first, fraction: [fu, fv] } = self.placement;
        let [ni, nj, _] = cast.factorization.dims;
        // Pixel v is between voxels v - first and the next, the first of which may be before the slice's first.
        if v + 1 < first[1] || v >= first[1] + nj {
            return;
        }
        let lower = v + 1 - first[1];
        let upper = lower.checked_sub(1);
        let weights = [(upper, 1.0 - fv), (Some(lower).filter(|&j| j < nj), fv)];
        let mut all = 0..0;
        for (j, weight) in weights {
            let Some(j) = j.filter(|_| weight > 0.0) else { continue };
            self.rows[j % 2].enter(cast, voxels, j, self.k);
            all = hull(&all, &self.rows[j % 2].stretch);
        }
        if all.is_empty() {
            return;
        }
        // With what is beside it.
        let mixed = &mut self.mixed[all.start..all.end + 2];
        mixed.fill(0.0);
        for (j, weight) in weights {
            let Some(j) = j.filter(|_| weight > 0.0) else { continue };
            for (mixed, opacity) in mixed.iter_mut().zip(&self.rows[j % 2].opacities[all.start..all.end + 2]) {
                *mixed += opacity * weight;
            }
        }
        // Pixels from the one before the first voxel's to the last voxel's; pixel u is at u + 1.
        let light = &mut light[first[0] + all.start..][..all.len() + 1];
        for (n, light) in light.iter_mut().enumerate() {
            *light *= 1.0 - (mixed[n] + (mixed[n + 1] - mixed[n]) * fu);
        }
        debug_assert!(all.end <= ni);
    }
}

impl Row {
    /// Becomes scanline `j` of slice `k`, if it is not already.
    #[inline(always)]
    fn enter<T: Code>(&mut self, cast: &Cast<'_>, voxels: &VoxelRows<'_, T>, j: usize, k: usize) {
        if self.j == Some(j) {
            return;
        }
        self.j = Some(j);
        self.opacities[1..][self.stretch.clone()].fill(0.0);
        self.stretch = stretch(cast.casters.scanline(j, k), cast.factorization.dims[0]).unwrap_or(0..0);
        let codes = &voxels.row(j, k)[self.stretch.clone()];
        let opacities = &mut self.opacities[1..][self.stretch.clone()];
        for (opacity, code) in opacities.iter_mut().zip(codes) {
            let code: u16 = (*code).into();
            *opacity = cast.opacity[usize::from(code)];
        }
        if cast.labels.is_some() || voxels.has_gradient_opacity() {
            cast.scale(voxels, [self.stretch.start, j, k], opacities);
        }
        if !(cast.clip.is_empty() && cast.holes.is_empty()) {
            cast.cut([j, k], &mut self.opacities[1..]);
        }
    }
}

impl Cast<'_> {
    /// Opacities of voxels from (i, j, k) on that depend on more than a code.
    #[inline(never)]
    fn scale<T: Code>(&self, voxels: &VoxelRows<'_, T>, [first, j, k]: [usize; 3], opacities: &mut [f32]) {
        let codes = &voxels.row(j, k)[first..][..opacities.len()];
        let [si, sj, sk] = self.factorization.strides(self.factorization.dims);
        for (n, (opacity, code)) in
            opacities.iter_mut().zip(codes).enumerate().filter(|(_, (opacity, _))| **opacity > 0.0)
        {
            let (code, i): (u16, _) = ((*code).into(), first + n);
            let byte = voxels.gradient_factor([i, j, k]);
            let (extinction, factor) = match self.labels {
                Some(Labels { voxels, tables }) => {
                    let label = voxels.code(i * si + j * sj + k * sk);
                    (tables.look(label, code).1, tables.gradient_factor(label, byte))
                }
                None => (self.tables.extinction[usize::from(code)], f32::from(byte) / 255.0),
            };
            *opacity = -(-extinction * factor * self.factorization.slice_distance as f32).exp_m1();
        }
    }

    /// Takes back the opacities of voxels of a scanline that clipping takes away.
    #[inline(never)]
    fn cut(&self, [j, k]: [usize; 2], opacities: &mut [f32]) {
        let (start, last) = (DVec3::new(0.0, j as f64, k as f64), (self.factorization.dims[0] - 1) as f64);
        let voxels = |clip: &Clip| {
            let [from, to] = clip.span(start, DVec3::X, [0.0, last]);
            if from > to { 0..0 } else { from.ceil() as usize..to.floor() as usize + 1 }
        };
        let left = voxels(&self.clip);
        opacities[..left.start].fill(0.0);
        opacities[left.end..].fill(0.0);
        for hole in &self.holes {
            opacities[voxels(hole)].fill(0.0);
        }
    }
}
