//! Scalars and gradients between voxels.
//!
//! A packet's rays meet a slice of voxels in eight points, each between four voxels; points between
//! two slices lie between eight. The gradient is the trilinear interpolation of the voxels' central
//! differences (conventions of the optical model). Interpolation is linear, so that is the difference of
//! two interpolated scalars a voxel before and behind: it needs no array of gradients, only the
//! scanlines around the cell, four neighbours of each, and is exact for every type of code.

use glam::{Vec3, Vec4};

use super::packet::{IN_SLICE, Packet};
use crate::simd::wide::{LANES, Lanes};
use crate::volume::gradient::Code;

/// A volume's codes, to be sampled.
#[derive(Clone, Copy, Debug)]
pub struct Sampler<'a, T> {
    codes: &'a [T],
    dims: [usize; 3],
}

/// The codes from four places on, all of one length: one comparison bounds four reads.
struct Corners<'a, T>([&'a [T]; 4]);

impl<'a, T: Code> Corners<'a, T> {
    /// Codes at 0, `i`, `j` and `i + j`, from `from` on.
    #[inline(always)]
    fn new(codes: &'a [T], from: usize, i: usize, j: usize) -> Self {
        let length = codes.len() - from - i - j;
        Self([
            &codes[from..][..length],
            &codes[from + i..][..length],
            &codes[from + j..][..length],
            &codes[from + i + j..][..length],
        ])
    }

    #[inline(always)]
    fn at(&self, index: usize) -> [f32; 4] {
        let Self([a, b, c, d]) = self;
        // Never taken: positions are clamped into the volume.
        if index >= a.len() || index >= b.len() || index >= c.len() || index >= d.len() {
            return [0.0; 4];
        }
        [a[index].as_f32(), b[index].as_f32(), c[index].as_f32(), d[index].as_f32()]
    }
}

impl<'a, T: Code> Sampler<'a, T> {
    /// `codes` of a volume of `dims` voxels, x fastest.
    pub fn new(codes: &'a [T], dims: [usize; 3]) -> Self {
        assert_eq!(codes.len(), dims.iter().product::<usize>(), "as many codes as voxels");
        Self { codes, dims }
    }

    /// Voxels along x, y, z.
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Codes from a voxel to the next along an axis.
    #[inline(always)]
    fn stride(&self, axis: usize) -> usize {
        let [nx, ny, _] = self.dims;
        [1, nx, nx * ny][axis]
    }

    /// Cell and fraction of positions along an axis.
    #[inline(always)]
    fn cells(&self, axis: usize, at: Lanes) -> ([u32; LANES], Lanes) {
        let last = (self.dims[axis] - 1) as f32;
        let last_cell = self.dims[axis] as i32 - 2;
        let mut cells = [0; LANES];
        let mut fractions = [0.0; LANES];
        for lane in 0..LANES {
            let at = at[lane].max(0.0).min(last);
            let cell = (at as i32).min(last_cell);
            cells[lane] = cell as u32;
            fractions[lane] = at - cell as f32;
        }
        (cells, fractions)
    }

    /// The slice that rays meet as the `t`-th.
    #[inline(always)]
    fn slice(&self, packet: &Packet, t: usize) -> usize {
        if packet.reversed { self.dims[packet.axis] - 1 - t } else { t }
    }

    /// Scalars where the packet meets slice `t`: bilinear.
    #[inline(always)]
    pub fn on_slice(&self, packet: &Packet, t: usize) -> Lanes {
        let places = self.places(packet, t as f32);
        self.resample(packet, t, &places)
    }

    /// Scalars where the packet meets the slice interpolated between slices `t` and `t + 1`, `fraction` of
    /// the way: trilinear.
    #[inline(always)]
    pub fn between(&self, packet: &Packet, t: usize, fraction: f32) -> Lanes {
        let places = self.places(packet, t as f32 + fraction);
        let (near, far) = (self.resample(packet, t, &places), self.resample(packet, t + 1, &places));
        let mut scalars = [0.0; LANES];
        for lane in 0..LANES {
            scalars[lane] = near[lane] + (far[lane] - near[lane]) * fraction;
        }
        scalars
    }

    /// Where the packet meets a slice: the first of four voxels, from the slice's first, and fractions.
    #[inline(always)]
    fn places(&self, packet: &Packet, t: f32) -> ([u32; LANES], [Lanes; 2]) {
        let [i, j] = IN_SLICE[packet.axis];
        let (cell_i, fi) = self.cells(i, packet.at(0, t));
        let (cell_j, fj) = self.cells(j, packet.at(1, t));
        let (si, sj) = (self.stride(i) as u32, self.stride(j) as u32);
        let mut index = [0; LANES];
        for lane in 0..LANES {
            index[lane] = cell_i[lane] * si + cell_j[lane] * sj;
        }
        (index, [fi, fj])
    }

    /// Scalars of a slice of voxels between four of them.
    #[inline(always)]
    fn resample(&self, packet: &Packet, t: usize, (index, [fi, fj]): &([u32; LANES], [Lanes; 2])) -> Lanes {
        let [i, j] = IN_SLICE[packet.axis];
        let slice = self.slice(packet, t) * self.stride(packet.axis);
        let corners = Corners::new(self.codes, slice, self.stride(i), self.stride(j));
        let mut voxels = [[0.0; LANES]; 4];
        for lane in 0..LANES {
            let four = corners.at(index[lane] as usize);
            for corner in 0..4 {
                voxels[corner][lane] = four[corner];
            }
        }
        let mut scalars = [0.0; LANES];
        for lane in 0..LANES {
            let four = [voxels[0][lane], voxels[1][lane], voxels[2][lane], voxels[3][lane]];
            scalars[lane] = bilinear(four, fi[lane], fj[lane]);
        }
        scalars
    }

    /// The index coordinates of a lane at slice position `t`.
    #[inline(always)]
    pub fn position(&self, packet: &Packet, lane: usize, t: f32) -> Vec3 {
        let mut at = Vec3::ZERO;
        let last = (self.dims[packet.axis] - 1) as f32;
        at[packet.axis] = if packet.reversed { last - t } else { t };
        for n in 0..2 {
            at[IN_SLICE[packet.axis][n]] = packet.start[n][lane] + t * packet.slope[n][lane];
        }
        at
    }

    /// Cell and fraction of a point.
    #[inline(always)]
    fn cell(&self, at: Vec3) -> ([usize; 3], Vec3) {
        let mut cell = [0; 3];
        let mut fraction = Vec3::ZERO;
        for axis in 0..3 {
            let p = at[axis].max(0.0).min((self.dims[axis] - 1) as f32);
            cell[axis] = (p as u32 as usize).min(self.dims[axis] - 2);
            fraction[axis] = p - cell[axis] as f32;
        }
        (cell, fraction)
    }

    /// The index of the voxel next to a point.
    #[inline(always)]
    pub fn nearest_voxel(&self, at: Vec3) -> usize {
        let nearest = |axis: usize| ((at[axis] + 0.5).max(0.0) as usize).min(self.dims[axis] - 1);
        let [nx, ny, _] = self.dims;
        (nearest(2) * ny + nearest(1)) * nx + nearest(0)
    }

    /// The scalar at one point: trilinear. For the ends of rays, which are on no slice.
    #[inline(always)]
    pub fn scalar(&self, at: Vec3) -> f32 {
        let [nx, ny, _] = self.dims;
        let ([x, y, z], f) = self.cell(at);
        let code = |index: usize| self.codes[index].as_f32();
        let slice =
            |first: usize| bilinear([code(first), code(first + 1), code(first + nx), code(first + nx + 1)], f.x, f.y);
        let (near, far) = (slice((z * ny + y) * nx + x), slice(((z + 1) * ny + y) * nx + x));
        near + (far - near) * f.z
    }

    /// What eight voxels have, told by their index, at one point between them: trilinear.
    #[inline(always)]
    pub fn interpolated(&self, at: Vec3, voxel: impl Fn(usize) -> Vec4) -> Vec4 {
        let [nx, ny, _] = self.dims;
        let ([x, y, z], f) = self.cell(at);
        let row = |first: usize| voxel(first).lerp(voxel(first + 1), f.x);
        let slice = |first: usize| row(first).lerp(row(first + nx), f.y);
        let first = (z * ny + y) * nx + x;
        slice(first).lerp(slice(first + nx * ny), f.z)
    }

    /// Twice the trilinearly interpolated central differences along x, y, z at a point: what
    /// [`GradientFrame`](crate::volume::gradient::GradientFrame) takes.
    #[inline(always)]
    pub fn differences(&self, at: Vec3) -> Vec3 {
        let (cell, f) = self.cell(at);
        let [nx, ny, nz] = self.dims;
        let [x, y, z] = cell;
        let inner = x >= 1 && x + 2 < nx && y >= 1 && y + 2 < ny && z >= 1 && z + 2 < nz;
        if inner { self.inner_rows(cell).differences(f) } else { self.border_rows(cell).differences(f) }
    }

    /// The rows around a cell that is not at the border.
    #[inline(always)]
    fn inner_rows(&self, [x, y, z]: [usize; 3]) -> Rows {
        let [nx, ny, _] = self.dims;
        let first = ((z - 1) * ny + (y - 1)) * nx + (x - 1);
        let codes = &self.codes[first..];
        let row = |y: usize, z: usize| {
            let row = &codes[(z * ny + y) * nx..][..4];
            Vec4::new(row[0].as_f32(), row[1].as_f32(), row[2].as_f32(), row[3].as_f32())
        };
        Rows {
            cell: [row(1, 1), row(2, 1), row(1, 2), row(2, 2)],
            beside_y: [row(0, 1), row(3, 1), row(0, 2), row(3, 2)],
            beside_z: [row(1, 0), row(1, 3), row(2, 0), row(2, 3)],
        }
    }

    /// The rows around any cell.
    #[inline(never)]
    fn border_rows(&self, [x, y, z]: [usize; 3]) -> Rows {
        let [nx, ny, nz] = self.dims;
        // Of -1, 0, 1, 2 from the cell on.
        let clamped = |cell: usize, n: usize, size: usize| (cell + n).saturating_sub(1).min(size - 1);
        let row = |j: usize, k: usize| {
            let first = (clamped(z, k, nz) * ny + clamped(y, j, ny)) * nx;
            Vec4::from_array([0, 1, 2, 3].map(|i| self.codes[first + clamped(x, i, nx)].as_f32()))
        };
        Rows {
            cell: [row(1, 1), row(2, 1), row(1, 2), row(2, 2)],
            beside_y: [row(0, 1), row(3, 1), row(0, 2), row(3, 2)],
            beside_z: [row(1, 0), row(1, 3), row(2, 0), row(2, 3)],
        }
    }
}

/// What a gradient is made of: stretches of four voxels, from the one before a cell to the one after it.
struct Rows {
    /// Through the cell's corners (y, z): (0, 0), (1, 0), (0, 1), (1, 1).
    cell: [Vec4; 4],
    /// At (-1, 0), (2, 0), (-1, 1), (2, 1).
    beside_y: [Vec4; 4],
    /// At (0, -1), (0, 2), (1, -1), (1, 2).
    beside_z: [Vec4; 4],
}

impl Rows {
    #[inline(always)]
    fn differences(&self, f: Vec3) -> Vec3 {
        let g = Vec3::ONE - f;
        let Self { cell: [r00, r10, r01, r11], beside_y: [y00, y10, y01, y11], beside_z: [z00, z01, z10, z11] } = *self;
        let along_x = (r00 * g.y + r10 * f.y) * g.z + (r01 * g.y + r11 * f.y) * f.z;
        let along_y = ((r10 - y00) * g.y + (y10 - r00) * f.y) * g.z + ((r11 - y01) * g.y + (y11 - r01) * f.y) * f.z;
        let along_z = ((r01 - z00) * g.z + (z01 - r00) * f.z) * g.y + ((r11 - z10) * g.z + (z11 - r10) * f.z) * f.y;
        Vec3::new(
            (along_x.z - along_x.x) * g.x + (along_x.w - along_x.y) * f.x,
            along_y.y * g.x + along_y.z * f.x,
            along_z.y * g.x + along_z.z * f.x,
        )
    }
}

/// Between four corners: 0, along i, along j, both.
#[inline(always)]
fn bilinear(corners: [f32; 4], fi: f32, fj: f32) -> f32 {
    let [a, b, c, d] = corners;
    let near = a + (b - a) * fi;
    let far = c + (d - c) * fi;
    near + (far - near) * fj
}
