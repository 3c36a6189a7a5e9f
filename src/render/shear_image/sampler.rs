//! Scalars and gradients between voxels.
//!
//! A packet's rays meet a slice of voxels in eight points, each between four voxels; points between
//! two slices lie between eight. The gradient is the trilinear interpolation of the voxels' central
//! differences (conventions of the optical model). Interpolation is linear, so that is the difference of
//! two interpolated scalars a voxel before and behind: it needs no array of gradients, only the
//! scanlines around the cell, four neighbours of each, and is exact for every type of code.

use glam::{Vec3, Vec4};

use super::packet::{IN_SLICE, LANES, Lanes, Packet};
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

    /// Twice the trilinearly interpolated central differences along x, y, z at a point: what
    /// [`GradientFrame`](crate::volume::gradient::GradientFrame) takes.
    #[inline(always)]
    pub fn differences(&self, at: Vec3) -> Vec3 {
        let ([x, y, z], f) = self.cell(at);
        // Rows y - 1 to y + 2 of slices z - 1 to z + 2, but for the corners; indices clamped at the border.
        let [nx, ny, nz] = self.dims;
        let y = [y.saturating_sub(1) * nx, y * nx, (y + 1) * nx, (y + 2).min(ny - 1) * nx];
        let z = [z.saturating_sub(1) * nx * ny, z * nx * ny, (z + 1) * nx * ny, (z + 2).min(nz - 1) * nx * ny];
        let (r11, r21, r12, r22) =
            (self.row(x, z[1] + y[1]), self.row(x, z[1] + y[2]), self.row(x, z[2] + y[1]), self.row(x, z[2] + y[2]));
        let (r01, r31, r02, r32) =
            (self.row(x, z[1] + y[0]), self.row(x, z[1] + y[3]), self.row(x, z[2] + y[0]), self.row(x, z[2] + y[3]));
        let (r10, r13, r20, r23) =
            (self.row(x, z[0] + y[1]), self.row(x, z[3] + y[1]), self.row(x, z[0] + y[2]), self.row(x, z[3] + y[2]));
        let g = Vec3::ONE - f;
        let along_x = (r11 * g.y + r21 * f.y) * g.z + (r12 * g.y + r22 * f.y) * f.z;
        let along_y = ((r21 - r01) * g.y + (r31 - r11) * f.y) * g.z + ((r22 - r02) * g.y + (r32 - r12) * f.y) * f.z;
        let along_z = ((r12 - r10) * g.z + (r13 - r11) * f.z) * g.y + ((r22 - r20) * g.z + (r23 - r21) * f.z) * f.y;
        Vec3::new(
            (along_x.z - along_x.x) * g.x + (along_x.w - along_x.y) * f.x,
            along_y.y * g.x + along_y.z * f.x,
            along_z.y * g.x + along_z.z * f.x,
        )
    }

    /// Voxels x - 1 to x + 2 of the scanline that begins at `first`, indices clamped at the border.
    #[inline(always)]
    fn row(&self, x: usize, first: usize) -> Vec4 {
        let nx = self.dims[0];
        let row = &self.codes[first..][..nx];
        if x >= 1 && x + 2 < nx {
            let inner = &row[x - 1..x + 3];
            Vec4::new(inner[0].as_f32(), inner[1].as_f32(), inner[2].as_f32(), inner[3].as_f32())
        } else {
            let (before, after) = (row[x.saturating_sub(1)], row[(x + 2).min(nx - 1)]);
            Vec4::new(before.as_f32(), row[x].as_f32(), row[x + 1].as_f32(), after.as_f32())
        }
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
