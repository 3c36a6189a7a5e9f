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
        Self([from, from + i, from + j, from + i + j].map(|start| &codes[start..][..length]))
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
        let at = at.map(|p| p.max(0.0).min(last));
        let cell = at.map(|p| (p as i32).min(last_cell));
        let fraction = std::array::from_fn(|lane| at[lane] - cell[lane] as f32);
        (cell.map(|c| c as u32), fraction)
    }

    /// The slice that rays meet as the `t`-th.
    #[inline(always)]
    fn slice(&self, packet: &Packet, t: usize) -> usize {
        if packet.reversed { self.dims[packet.axis] - 1 - t } else { t }
    }

    /// Scalars where the packet meets slice `t`: bilinear.
    #[inline(always)]
    pub fn on_slice(&self, packet: &Packet, t: usize) -> Lanes {
        let [i, j] = IN_SLICE[packet.axis];
        let (cell_i, fi) = self.cells(i, packet.at(0, t as f32));
        let (cell_j, fj) = self.cells(j, packet.at(1, t as f32));
        let (si, sj) = (self.stride(i) as u32, self.stride(j) as u32);
        let base = self.slice(packet, t) * self.stride(packet.axis);
        let corners = Corners::new(self.codes, base, self.stride(i), self.stride(j));
        let index: [u32; LANES] = std::array::from_fn(|lane| cell_i[lane] * si + cell_j[lane] * sj);
        let voxels: [[f32; 4]; LANES] = std::array::from_fn(|lane| corners.at(index[lane] as usize));
        std::array::from_fn(|lane| bilinear(voxels[lane], fi[lane], fj[lane]))
    }

    /// Scalars where the packet meets the slice interpolated between slices `t` and `t + 1`, `fraction` of
    /// the way: trilinear.
    #[inline(always)]
    pub fn between(&self, packet: &Packet, t: usize, fraction: f32) -> Lanes {
        let [i, j] = IN_SLICE[packet.axis];
        let (cell_i, fi) = self.cells(i, packet.at(0, t as f32 + fraction));
        let (cell_j, fj) = self.cells(j, packet.at(1, t as f32 + fraction));
        let (si, sj) = (self.stride(i) as u32, self.stride(j) as u32);
        let index: [u32; LANES] = std::array::from_fn(|lane| cell_i[lane] * si + cell_j[lane] * sj);
        let slices = [t, t + 1].map(|t| {
            let base = self.slice(packet, t) * self.stride(packet.axis);
            let corners = Corners::new(self.codes, base, self.stride(i), self.stride(j));
            let voxels: [[f32; 4]; LANES] = std::array::from_fn(|lane| corners.at(index[lane] as usize));
            let scalars: Lanes = std::array::from_fn(|lane| bilinear(voxels[lane], fi[lane], fj[lane]));
            scalars
        });
        std::array::from_fn(|lane| slices[0][lane] + (slices[1][lane] - slices[0][lane]) * fraction)
    }

    /// The index coordinates of a lane at slice position `t`.
    #[inline(always)]
    pub fn position(&self, packet: &Packet, lane: usize, t: f32) -> Vec3 {
        let mut at = Vec3::ZERO;
        let last = (self.dims[packet.axis] - 1) as f32;
        at[packet.axis] = if packet.reversed { last - t } else { t };
        for (n, axis) in IN_SLICE[packet.axis].into_iter().enumerate() {
            at[axis] = packet.start[n][lane] + t * packet.slope[n][lane];
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
            cell[axis] = (p as usize).min(self.dims[axis] - 2);
            fraction[axis] = p - cell[axis] as f32;
        }
        (cell, fraction)
    }

    /// The scalar at one point: trilinear. For the ends of rays, which are on no slice.
    #[inline(always)]
    pub fn scalar(&self, at: Vec3) -> f32 {
        let [nx, ny, _] = self.dims;
        let ([x, y, z], f) = self.cell(at);
        let slices = [z, z + 1].map(|z| {
            let index = (z * ny + y) * nx + x;
            let corners = [0, 1, nx, nx + 1].map(|offset| self.codes[index + offset].as_f32());
            bilinear(corners, f.x, f.y)
        });
        slices[0] + (slices[1] - slices[0]) * f.z
    }

    /// Twice the trilinearly interpolated central differences along x, y, z at a point: what
    /// [`GradientFrame`](crate::volume::gradient::GradientFrame) takes.
    #[inline(always)]
    pub fn differences(&self, at: Vec3) -> Vec3 {
        let ([x, y, z], f) = self.cell(at);
        // Rows y - 1 to y + 2 of slices z - 1 to z + 2, but for the corners; indices clamped at the border.
        let before = |n: usize| n.saturating_sub(1);
        let after = |n: usize, axis: usize| (n + 2).min(self.dims[axis] - 1);
        let (y, z) = ([before(y), y, y + 1, after(y, 1)], [before(z), z, z + 1, after(z, 2)]);
        let row = |j: usize, k: usize| self.row(x, y[j], z[k]);
        let (r11, r21, r12, r22) = (row(1, 1), row(2, 1), row(1, 2), row(2, 2));
        let g = Vec3::ONE - f;
        let along_x = (r11 * g.y + r21 * f.y) * g.z + (r12 * g.y + r22 * f.y) * f.z;
        let along_y = ((r21 - row(0, 1)) * g.y + (row(3, 1) - r11) * f.y) * g.z
            + ((r22 - row(0, 2)) * g.y + (row(3, 2) - r12) * f.y) * f.z;
        let along_z = ((r12 - row(1, 0)) * g.z + (row(1, 3) - r11) * f.z) * g.y
            + ((r22 - row(2, 0)) * g.z + (row(2, 3) - r21) * f.z) * f.y;
        Vec3::new(
            (along_x.z - along_x.x) * g.x + (along_x.w - along_x.y) * f.x,
            along_y.y * g.x + along_y.z * f.x,
            along_z.y * g.x + along_z.z * f.x,
        )
    }

    /// Voxels x - 1 to x + 2 of a scanline, indices clamped at the border.
    #[inline(always)]
    fn row(&self, x: usize, y: usize, z: usize) -> Vec4 {
        let [nx, ny, _] = self.dims;
        let row = &self.codes[(z * ny + y) * nx..][..nx];
        let four = if x >= 1 && x + 2 < nx {
            let inner = &row[x - 1..x + 3];
            [inner[0], inner[1], inner[2], inner[3]]
        } else {
            [row[x.saturating_sub(1)], row[x], row[x + 1], row[(x + 2).min(nx - 1)]]
        };
        Vec4::from_array(four.map(Code::as_f32))
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
