//! Slices of voxels -> samples on the pixels of a scanline: what slabs are looked up by.
//!
//! A sample is what is interpolated between voxels: the scalar, and, where shading asks for it, a factor on
//! the colour and an addend, where the transfer function asks for it, the gradient opacity. Each is a
//! component of a [`Vec4`], so that all are resampled at once. (Which of the two light terms a slab
//! of two samples has is left to it.) Voxels are read, and shaded, in blocks of eight, once for as
//! long as their scanline is in a row buffer, and only where a pixel asks.
//!
//! Interpolation is `a + (b - a) f`, which between two equal scalars is that scalar: what lies within a
//! range stays within it, so that slabs over transparent ranges stay exactly zero. First down a
//! column of two voxels, then along the row, where each column serves two pixels.

use glam::Vec4;

use super::WORD;
use super::lattice::Lattice;
use super::mask::{Mask, Runs};
use crate::classify::TransferFunction;
use crate::classify::preintegration::Slabs;
use crate::render::factorization::{Factorization, SlicePlacement};
use crate::render::ray_light::RayLight;
use crate::volume::Volume;
use crate::volume::gradient::{Code, GradientBlock, GradientFrame, Gradients, magnitudes, normals};
use crate::volume::scanlines::Scanlines;

/// Voxels that are read at once.
pub use crate::volume::gradient::BLOCK;

/// What voxels are lit by.
#[derive(Clone, Copy, Debug)]
pub enum VoxelLight<'a> {
    Off,
    /// Factor and addend by code of the normal.
    ByNormal(&'a [[f32; 2]]),
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
    light: VoxelLight<'a>,
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
            light,
            gradient_opacity: Some(transfer).filter(|transfer| !transfer.gradient_opacity.is_empty()),
        }
    }

    /// True where samples have light.
    #[inline(always)]
    pub fn is_lit(&self) -> bool {
        !matches!(self.light, VoxelLight::Off)
    }

    /// Samples at eight voxels of scanline `j` of slice `k`, from voxel `first` on. Past the scanline's end
    /// its last voxel is repeated.
    #[inline(always)]
    pub fn block(&self, j: usize, k: usize, first: usize) -> [Vec4; BLOCK] {
        let codes = eight(self.scanlines.row(j, k), first);
        let (mut factor, mut addend, mut density) = ([1.0; BLOCK], [0.0; BLOCK], [1.0; BLOCK]);
        match self.light {
            VoxelLight::Off => {}
            VoxelLight::ByNormal(shades) => {
                let normals = self.normals(j, k, first);
                for n in 0..BLOCK {
                    [factor[n], addend[n]] = shades[usize::from(normals[n])];
                }
            }
            VoxelLight::ByRay(light) => {
                [factor, addend] = light.of_gradients(&self.gradients(j, k, first), [first, j, k]);
            }
        }
        if self.has_gradient_opacity() {
            for (n, density) in density.iter_mut().enumerate() {
                *density = f32::from(self.gradient_factor([first + n, j, k])) / 255.0;
            }
        }
        let mut samples = [Vec4::ZERO; BLOCK];
        for n in 0..BLOCK {
            samples[n] = Vec4::new(codes[n], factor[n], addend[n], density[n]);
        }
        samples
    }

    /// Codes of the normals of eight voxels.
    #[inline(always)]
    pub fn normals(&self, j: usize, k: usize, first: usize) -> [u16; BLOCK] {
        normals(&self.gradients(j, k, first))
    }

    /// Gradients of eight voxels in the frame of the volume's normals.
    #[inline(always)]
    fn gradients(&self, j: usize, k: usize, first: usize) -> GradientBlock {
        self.gradients.block(j, k, first)
    }

    /// Codes of scanline `j` of slice `k`.
    #[inline(always)]
    pub fn row(&self, j: usize, k: usize) -> &'a [T] {
        self.scanlines.row(j, k)
    }

    /// Codes of eight voxels, the scanline's last one repeated past its end.
    #[inline(always)]
    pub fn codes(&self, j: usize, k: usize, first: usize) -> [u16; BLOCK] {
        let row = self.scanlines.row(j, k);
        let mut codes = [0; BLOCK];
        if let Some(whole) = row.get(first..first + BLOCK) {
            for n in 0..BLOCK {
                codes[n] = whole[n].into();
            }
        } else {
            for (n, code) in codes.iter_mut().enumerate() {
                *code = row[(first + n).min(row.len() - 1)].into();
            }
        }
        codes
    }

    /// True where the gradient has an influence on opacity.
    #[inline(always)]
    pub fn has_gradient_opacity(&self) -> bool {
        self.gradient_opacity.is_some()
    }

    /// The gradient opacity of voxel (i, j, k), 255 = 1; that of the scanline's last voxel past its end.
    pub fn gradient_factor(&self, [i, j, k]: [usize; 3]) -> u8 {
        let Some(transfer) = self.gradient_opacity else { return u8::MAX };
        let magnitude = magnitudes(&self.gradients(j, k, i.min(self.dims[0] - 1)))[0];
        (transfer.gradient_factor(magnitude.into()) * 255.0).round() as u8
    }
}

/// Eight codes from `first` on, the last one repeated.
#[inline(always)]
fn eight<T: Code>(row: &[T], first: usize) -> [f32; BLOCK] {
    let mut codes = [0.0; BLOCK];
    if let Some(whole) = row.get(first..first + BLOCK) {
        for n in 0..BLOCK {
            codes[n] = whole[n].as_f32();
        }
    } else {
        for (n, code) in codes.iter_mut().enumerate() {
            *code = row[(first + n).min(row.len() - 1)].as_f32();
        }
    }
    codes
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
    /// Blocks that are there.
    fetched: Vec<bool>,
}

impl Row {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        let blocks = length.div_ceil(BLOCK);
        Self { j: None, voxels: vec![Vec4::ZERO; blocks * BLOCK + 2], fetched: vec![false; blocks] }
    }

    /// Becomes scanline `j`, nothing of which is there yet.
    #[inline(always)]
    pub fn enter(&mut self, j: usize) {
        self.j = Some(j);
        self.fetched.fill(false);
    }

    /// Reads voxels `first..=last` of scanline `j` of slice `k`, which the row is for.
    #[inline(always)]
    pub fn fetch<T: Code>(&mut self, rows: &VoxelRows<'_, T>, j: usize, k: usize, first: usize, last: usize) {
        for block in first / BLOCK..=last / BLOCK {
            if !self.fetched[block] {
                self.fetched[block] = true;
                let at = block * BLOCK;
                let samples = rows.block(j, k, at);
                self.voxels[at + 1..][..BLOCK].copy_from_slice(&samples);
                if block == 0 {
                    self.voxels[0] = samples[0];
                }
                let end = rows.dims[0];
                if at + BLOCK >= end {
                    self.voxels[end + 1] = self.voxels[end];
                }
            }
        }
    }
}

/// The two scanlines of a slice of voxels that a scanline of pixels gathers from.
#[derive(Debug)]
struct RowPair {
    rows: [Row; 2],
    k: usize,
}

impl RowPair {
    fn new(length: usize) -> Self {
        Self { rows: [Row::new(length), Row::new(length)], k: usize::MAX }
    }

    /// Makes the rows those of scanlines `upper` and `lower` of slice `k`; gives where they are.
    #[inline(always)]
    fn enter(&mut self, upper: usize, lower: usize, k: usize) -> [usize; 2] {
        if self.k != k {
            self.k = k;
            self.rows[0].j = None;
            self.rows[1].j = None;
        }
        let place = |rows: &[Row; 2], j: usize| (0..2).find(|&at| rows[at].j == Some(j));
        let at_upper = place(&self.rows, upper);
        let at_lower = place(&self.rows, lower);
        match (at_upper, at_lower) {
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
    near: RowPair,
    far: RowPair,
}

impl SampleRows {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        Self { near: RowPair::new(length), far: RowPair::new(length) }
    }

    /// Samples the pixels of `mask`, which lie on the slice or less than a pixel beside it, on scanline `v`.
    /// Pixel u goes to `out[u - base]`.
    #[inline(always)]
    pub fn sample<T: Code, S: Slabs>(
        &mut self,
        voxels: &VoxelRows<'_, T>,
        table: S,
        position: &Position<SlicePlacement>,
        v: usize,
        mask: &Mask,
        (out, base): (&mut [Vec4], isize),
    ) {
        let SlicePlacement { first, fraction } = position.placement;
        let last = voxels.dims.map(|n| n - 1);
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
