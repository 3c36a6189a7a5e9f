//! Slices of voxels -> samples on the pixels of a scanline: what slabs are looked up by.
//!
//! A sample is what is interpolated between voxels: the scalar, and, where shading asks for it, a factor on
//! the colour and an addend, where the transfer function asks for it, the gradient opacity. Each is a
//! component of a [`Vec4`], so that all are resampled at once. (Which of the two light terms a slab
//! of two samples has is left to it.) Voxels are read, and shaded, four at a time, once for as long as their
//! scanline is in a row buffer, and only where a pixel asks. Four, because surfaces are a few voxels
//! thin: of eight most would be shaded in vain.
//!
//! Interpolation is `a + (b - a) f`, which between two equal scalars is that scalar: what lies within a
//! range stays within it, so that slabs over transparent ranges stay exactly zero. First down a
//! column of two voxels, then along the row, where each column serves two pixels.
//!
//! Reading voxels depends on their type and on what lights them, and nothing else of the kernel does. So it is a
//! job of its own ([`Quads`]), called for those that a row lacks: the kernel, which has many type
//! parameters, is not compiled for each type of voxel again.

use std::fmt::Debug;
use std::ops::{Range, RangeInclusive};

use glam::Vec4;

use super::WORD;
use super::lattice::Lattice;
use super::mask::{Mask, Runs};
use super::sources::Stored;
use crate::classify::TransferFunction;
use crate::classify::preintegration::Slabs;
use crate::render::factorization::{Factorization, SlicePlacement};
use crate::render::ray_light::RayLight;
use crate::render::shadow::{darken, part_of};
use crate::render::simd::{self, Kernel, prefetch};
use crate::volume::Volume;
use crate::volume::gradient::{Code, GradientFrame, Gradients, magnitudes, normals};
use crate::volume::scanlines::Scanlines;

/// Voxels that become samples at once.
const QUAD: usize = 4;

/// What voxels are lit by.
#[derive(Clone, Copy, Debug)]
pub enum VoxelLight<'a> {
    Off,
    /// Factor and addend by code of the normal.
    ByNormal {
        shades: &'a [[f32; 2]],
        normals: Scanlines<'a, u16>,
    },
    /// Along the ray that each is seen by.
    ByRay(&'a RayLight),
}

/// A volume's voxels as one principal axis walks them, to be sampled.
#[derive(Clone, Copy, Debug)]
pub struct VoxelRows<'a, T> {
    scanlines: Scanlines<'a, T>,
    gradients: Gradients<'a, T>,
    /// Voxels along i, j, k.
    dims: [usize; 3],
    /// Slices are walked from the last to the first.
    reversed: bool,
    light: VoxelLight<'a>,
    /// The light where the one that casts shadows is gone, and how much of that each voxel lacks, in 255ths.
    shadow: Option<(VoxelLight<'a>, Stored<'a, u8>)>,
    gradient_opacity: Option<&'a TransferFunction>,
}

impl<'a, T: Code> VoxelRows<'a, T> {
    /// `scanlines` are those of the factorization's principal axis.
    pub fn new(
        scanlines: Scanlines<'a, T>,
        volume: &'a Volume,
        factorization: &Factorization,
        light: VoxelLight<'a>,
        transfer: &'a TransferFunction,
    ) -> Self {
        Self {
            scanlines,
            gradients: Gradients::new(scanlines, &GradientFrame::new(volume.placement(), volume.rescale().0)),
            dims: factorization.dims,
            reversed: factorization.reversed,
            light,
            shadow: None,
            gradient_opacity: Some(transfer).filter(|transfer| !transfer.gradient_opacity.is_empty()),
        }
    }

    /// With shadows on the voxels: `light` is where the one that casts them is gone, `lacking` how much of that each voxel
    /// lacks, in 255ths.
    pub fn shadowed(self, light: VoxelLight<'a>, lacking: Stored<'a, u8>) -> Self {
        Self { shadow: Some((light, lacking)), ..self }
    }

    /// Asks for the voxels that the walk will need next: those a slice on, or, where that was needed for
    /// gradients already, two.
    #[inline(always)]
    fn prefetch(&self, j: usize, k: usize, voxels: Range<usize>) {
        let ahead = if matches!(self.light, VoxelLight::ByRay(_)) { 2 } else { 1 };
        let next = if self.reversed { k.checked_sub(ahead) } else { Some(k + ahead).filter(|&k| k < self.dims[2]) };
        let Some(next) = next else { return };
        if let VoxelLight::ByNormal { normals, .. } = self.light
            && let Some(normals) = normals.row(j, next).get(voxels.clone())
        {
            prefetch(normals);
        }
        if let Some(codes) = self.scanlines.row(j, next).get(voxels) {
            prefetch(codes);
        }
    }

    /// Samples at four voxels of scanline `j` of slice `k`, from voxel `first` on. Past the scanline's end
    /// its last voxel is repeated.
    #[inline(always)]
    fn quad(&self, [first, j, k]: [usize; 3]) -> [Vec4; QUAD] {
        let codes = self.four([first, j, k]);
        let (mut light, mut density) = (self.light(&self.light, [first, j, k]), [1.0; QUAD]);
        if let Some((in_shadow, lacking)) = &self.shadow {
            darken(&mut light, &self.light(in_shadow, [first, j, k]), lacking.four([first, j, k]).map(part_of));
        }
        if self.has_gradient_opacity() {
            for (n, density) in density.iter_mut().enumerate() {
                *density = f32::from(self.gradient_factor([first + n, j, k])) / 255.0;
            }
        }
        let mut samples = [Vec4::ZERO; QUAD];
        for n in 0..QUAD {
            samples[n] = Vec4::new(codes[n].as_f32(), light[0][n], light[1][n], density[n]);
        }
        samples
    }

    /// Factors on and addends to the colours of four voxels from (i, j, k) on.
    #[inline(always)]
    fn light(&self, light: &VoxelLight<'_>, at @ [i, j, k]: [usize; 3]) -> [[f32; QUAD]; 2] {
        match light {
            VoxelLight::Off => [[1.0; QUAD], [0.0; QUAD]],
            VoxelLight::ByNormal { shades, normals } => {
                let mut light = [[0.0; QUAD]; 2];
                for (n, code) in normals.four(at).into_iter().enumerate() {
                    [light[0][n], light[1][n]] = shades[usize::from(code)];
                }
                light
            }
            VoxelLight::ByRay(light) => light.of_gradients(&self.gradients.block(j, k, i), at),
        }
    }

    /// The code of the normal of voxel (i, j, k), from its neighbours: the one that is stored.
    pub fn normal(&self, [i, j, k]: [usize; 3]) -> u16 {
        normals(&self.gradients.block::<1>(j, k, i))[0]
    }

    /// Codes of scanline `j` of slice `k`.
    #[inline(always)]
    pub fn row(&self, j: usize, k: usize) -> &'a [T] {
        self.scanlines.row(j, k)
    }

    /// Codes of four voxels from (i, j, k) on, the scanline's last one repeated past its end.
    #[inline(always)]
    pub fn four(&self, at: [usize; 3]) -> [T; QUAD] {
        self.scanlines.four(at)
    }

    /// True where the gradient has an influence on opacity.
    #[inline(always)]
    pub fn has_gradient_opacity(&self) -> bool {
        self.gradient_opacity.is_some()
    }

    /// The gradient opacity of voxel (i, j, k), 255 = 1; that of the scanline's last voxel past its end.
    pub fn gradient_factor(&self, [i, j, k]: [usize; 3]) -> u8 {
        let Some(transfer) = self.gradient_opacity else { return u8::MAX };
        let magnitude = magnitudes(&self.gradients.block::<1>(j, k, i.min(self.dims[0] - 1)))[0];
        (transfer.gradient_factor(magnitude.into()) * 255.0).round() as u8
    }
}

/// Voxels of whatever type as samples.
pub trait Quads: Debug + Send + Sync {
    /// Voxels along i, j, k.
    fn dims(&self) -> [usize; 3];

    /// True where samples have light.
    fn is_lit(&self) -> bool;

    /// The sample at voxel (i, j, k); past the scanline's end that of its last voxel.
    fn sample(&self, at: [usize; 3]) -> Vec4;

    /// Reads those quads of scanline `j` of slice `k` that `row`, which is for that scanline, lacks.
    fn fetch(&self, row: &mut Row, j: usize, k: usize, quads: RangeInclusive<usize>);
}

impl<T: Code + Debug> Quads for VoxelRows<'_, T> {
    fn dims(&self) -> [usize; 3] {
        self.dims
    }

    fn is_lit(&self) -> bool {
        !matches!(self.light, VoxelLight::Off)
    }

    fn sample(&self, [i, j, k]: [usize; 3]) -> Vec4 {
        self.quad([i, j, k])[0]
    }

    fn fetch(&self, row: &mut Row, j: usize, k: usize, quads: RangeInclusive<usize>) {
        simd::dispatch(Fetch { voxels: self, row, j, k, quads });
    }
}

/// What [`Quads::fetch`] does.
struct Fetch<'a, 'b, T> {
    voxels: &'a VoxelRows<'b, T>,
    row: &'a mut Row,
    j: usize,
    k: usize,
    quads: RangeInclusive<usize>,
}

impl<T: Code> Kernel for Fetch<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { voxels, row, j, k, quads } = self;
        voxels.prefetch(j, k, quads.start() * QUAD..(quads.end() + 1) * QUAD);
        for quad in quads {
            if !std::mem::replace(&mut row.fetched[quad], true) {
                row.set(quad, &voxels.quad([quad * QUAD, j, k]), voxels.dims[0]);
            }
        }
    }
}

/// Where a slice of samples lies: on a slice of voxels or between two.
#[derive(Clone, Copy, Debug)]
pub struct Position<P> {
    pub placement: P,
    /// Slice of voxels at or before it, in the order of the walk.
    pub near: usize,
    /// The slice after it and how far towards it, 0..1; `None` on a slice of voxels.
    pub far: Option<(usize, f32)>,
}

impl<P> Position<P> {
    /// The samples at a position along the rays, counted in slices from the front one.
    pub fn new<L: Lattice<Placement = P>>(factorization: &Factorization, position: f64) -> Self {
        let stored = |slice: f64| factorization.along(slice) as usize;
        let (slice, fraction) = (position.floor(), position.fract());
        Self {
            placement: L::placement(factorization, factorization.along(position)),
            near: stored(slice),
            far: (fraction > 0.0).then(|| (stored(slice + 1.0), fraction as f32)),
        }
    }
}

/// A voxel scanline as samples. Voxel i is at i + 1: the scanline's ends are repeated once.
#[derive(Debug)]
pub struct Row {
    pub j: Option<usize>,
    pub voxels: Vec<Vec4>,
    /// Quads that are there.
    fetched: Vec<bool>,
}

impl Row {
    /// Reads voxels `first..=last` of scanline `j` of slice `k`, which the row is for.
    #[inline(always)]
    pub fn fetch(&mut self, voxels: &dyn Quads, j: usize, k: usize, first: usize, last: usize) {
        let (first, last) = (first / QUAD, last / QUAD);
        if let Some(missing) = self.fetched[first..=last].iter().position(|there| !there) {
            voxels.fetch(self, j, k, first + missing..=last);
        }
    }

    /// Takes the samples of a quad of a scanline of `length` voxels.
    #[inline(always)]
    fn set(&mut self, quad: usize, samples: &[Vec4; QUAD], length: usize) {
        let at = quad * QUAD;
        self.voxels[at + 1..][..QUAD].copy_from_slice(samples);
        if quad == 0 {
            self.voxels[0] = samples[0];
        }
        if at + QUAD >= length {
            self.voxels[length + 1] = self.voxels[length];
        }
    }
}

/// A voxel scanline in whatever form.
pub trait RowBuffer {
    /// For scanlines of `length` voxels.
    fn new(length: usize) -> Self;

    /// The scanline's j, where one was entered.
    fn scanline(&mut self) -> &mut Option<usize>;

    /// Nothing is there of the scanline.
    fn forget(&mut self);

    /// Becomes scanline `j`, nothing of which is there yet.
    #[inline(always)]
    fn enter(&mut self, j: usize) {
        *self.scanline() = Some(j);
        self.forget();
    }
}

impl RowBuffer for Row {
    fn new(length: usize) -> Self {
        let quads = length.div_ceil(QUAD);
        Self { j: None, voxels: vec![Vec4::ZERO; quads * QUAD + 2], fetched: vec![false; quads] }
    }

    #[inline(always)]
    fn scanline(&mut self) -> &mut Option<usize> {
        &mut self.j
    }

    #[inline(always)]
    fn forget(&mut self) {
        self.fetched.fill(false);
    }
}

/// The two scanlines of a slice of voxels that a scanline of pixels gathers from.
#[derive(Debug)]
pub struct RowPair<R> {
    pub rows: [R; 2],
    k: usize,
}

impl<R: RowBuffer> RowPair<R> {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        Self { rows: [R::new(length), R::new(length)], k: usize::MAX }
    }

    /// Makes the rows those of scanlines `upper` and `lower` of slice `k`; gives where they are.
    #[inline(always)]
    pub fn enter(&mut self, upper: usize, lower: usize, k: usize) -> [usize; 2] {
        if self.k != k {
            self.k = k;
            for row in &mut self.rows {
                *row.scanline() = None;
            }
        }
        let there = [0, 1].map(|at| *self.rows[at].scanline());
        let place = |j: usize| (0..2).find(|&at| there[at] == Some(j));
        match (place(upper), place(lower)) {
            (Some(a), Some(b)) => [a, b],
            (Some(a), None) => [a, self.replace(1 - a, lower)],
            (None, Some(b)) => [self.replace(1 - b, upper), b],
            (None, None) => {
                let a = self.replace(0, upper);
                if lower == upper { [a, a] } else { [a, self.replace(1, lower)] }
            }
        }
    }

    #[inline(always)]
    fn replace(&mut self, at: usize, j: usize) -> usize {
        self.rows[at].enter(j);
        at
    }
}

/// Row buffers for slices of samples.
#[derive(Debug)]
pub struct SampleRows {
    near: RowPair<Row>,
    far: RowPair<Row>,
}

impl SampleRows {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        Self { near: RowPair::new(length), far: RowPair::new(length) }
    }

    /// Samples the pixels of `mask`, which lie on the slice or less than a pixel beside it, on scanline `v`.
    /// Pixel u goes to `out[u - base]`.
    #[inline(always)]
    pub fn sample<S: Slabs>(
        &mut self,
        voxels: &dyn Quads,
        table: S,
        position: &Position<SlicePlacement>,
        v: usize,
        mask: &Mask,
        (out, base): (&mut [Vec4], isize),
    ) {
        let SlicePlacement { first, fraction } = position.placement;
        let last = voxels.dims().map(|n| n - 1);
        // From -1: slices are continued by their borders.
        let upper = (v + 1).saturating_sub(first[1] + 1).min(last[1]);
        let lower = (v + 1 - first[1]).min(last[1]);
        let lower = if fraction[1] > 0.0 { lower } else { upper };
        let at_near = self.near.enter(upper, lower, position.near);
        let at_far = position.far.map(|(k, part)| (self.far.enter(upper, lower, k), k, part));
        for (u, length) in Runs::new(mask) {
            let start = u + 1 - first[0];
            let (from, to) = (start.saturating_sub(1), (start + length - 1).min(last[0]));
            let out = &mut out[(u as isize - base) as usize..][..length];
            for (at, j) in at_near.into_iter().zip([upper, lower]) {
                self.near.rows[at].fetch(voxels, j, position.near, from, to);
            }
            let rows = at_near.map(|at| &self.near.rows[at].voxels[start..][..length + 1]);
            resample(rows, fraction, out);
            if let Some((at_far, k, part)) = at_far {
                for (at, j) in at_far.into_iter().zip([upper, lower]) {
                    self.far.rows[at].fetch(voxels, j, k, from, to);
                }
                let mut beyond = [Vec4::ZERO; WORD];
                let rows = at_far.map(|at| &self.far.rows[at].voxels[start..][..length + 1]);
                resample(rows, fraction, &mut beyond[..length]);
                for (near, far) in out.iter_mut().zip(beyond) {
                    *near += (far - *near) * part;
                }
            }
            for sample in out {
                *sample = sample.with_x(table.coordinate(sample.x));
            }
        }
    }
}

/// Interpolates between two rows, of one voxel more than there are pixels.
#[inline(always)]
fn resample([upper, lower]: [&[Vec4]; 2], [fu, fv]: [f32; 2], out: &mut [Vec4]) {
    let mut left = lerp(upper[0], lower[0], fv);
    for ((out, upper), lower) in out.iter_mut().zip(&upper[1..]).zip(&lower[1..]) {
        let right = lerp(*upper, *lower, fv);
        *out = lerp(left, right, fu);
        left = right;
    }
}

#[inline(always)]
pub fn lerp(a: Vec4, b: Vec4, f: f32) -> Vec4 {
    a + (b - a) * f
}
