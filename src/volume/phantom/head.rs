//! The built-in demo volume: a CT angiography of a head that nobody owns.
//!
//! Anatomy is modelled as solids ([`super::shape`]) in millimetres around the middle of the head, x
//! to the left, y to the back, z up, and painted one over the other: flesh, fat and skin, bone,
//! teeth, airways, brain, vessels, at last the air outside. Every edge is blurred over [`BLUR`] as a scanner does, so
//! that surfaces come out smooth, and a little noise lies over everything.
//!
//! To be quick, voxels are made in blocks of 8^3, and these in blocks of 4^3. A part's distance from
//! a block's middle tells whether it can reach into the block at all: most blocks need no part (air)
//! or one (brain). The four voxels of a small block's row are made at once ([`super::shape`]); what only
//! some of them need is made for all and chosen by lane.

mod brain;
mod skin;
mod skull;
mod vessels;

use glam::{DMat3, DVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::random::bell;
use super::shape::{Points, above, at, below, coverage, mirrored, mix, v};
use crate::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};
use vessels::Vessel;

/// Voxels along x, y, z.
const DIMS: [usize; 3] = [160, 192, 192];
/// mm; 208 x 250 x 250 mm in all, a usual field of view.
const SPACING: f32 = 1.3;
/// HU of code 0.
const INTERCEPT: f32 = -1024.0;
/// Edges are this wide, mm: the point spread of a soft reconstruction kernel.
const BLUR: f32 = 3.4;
/// Standard deviation of the scanner's noise, HU.
const NOISE: f32 = 7.0;
/// Edges of blocks, voxels. The small ones divide the large ones, the large ones the volume.
const BLOCK: usize = 8;
const SMALL_BLOCK: usize = 4;
const _: () = assert!(SMALL_BLOCK == 4, "a row of a small block is a row of points");
/// Further away than anything, mm.
const FAR: f32 = 1e4;

/// Hounsfield units of what a head is made of.
mod hu {
    pub const AIR: f32 = -1000.0;
    pub const FAT: f32 = -100.0;
    pub const SKIN: f32 = 35.0;
    pub const MUSCLE: f32 = 55.0;
    pub const FLUID: f32 = 8.0;
    pub const VITREOUS: f32 = 12.0;
    pub const LENS: f32 = 90.0;
    pub const GREY_MATTER: f32 = 40.0;
    pub const WHITE_MATTER: f32 = 29.0;
    pub const CARTILAGE: f32 = 95.0;
    pub const TRABECULAR: f32 = 520.0;
    pub const CORTICAL: f32 = 1350.0;
    pub const PETROUS: f32 = 1600.0;
    pub const DENTINE: f32 = 1600.0;
    pub const ENAMEL: f32 = 2300.0;
    pub const ARTERY: f32 = 340.0;
    pub const VEIN: f32 = 230.0;
}

/// A CT scan of a head in Hounsfield units, made up: 160 x 192 x 192 voxels of 1.3 mm, centred on the
/// origin, facing -y. The same bits on every machine and with any number of threads.
pub fn head() -> Volume {
    let [nx, ny, _] = DIMS;
    let vessels = vessels::tree();
    let mut codes = vec![0_u16; DIMS.iter().product()];
    codes.par_chunks_mut(nx * ny * BLOCK).enumerate().for_each(|(layer, codes)| {
        let k0 = layer * BLOCK;
        let vessels: Vec<_> = vessels.iter().filter(|vessel| near_blocks(vessel, 2, k0)).collect();
        for j0 in (0..ny).step_by(BLOCK) {
            let vessels: Vec<_> = vessels.iter().copied().filter(|vessel| near_blocks(vessel, 1, j0)).collect();
            for i0 in (0..nx).step_by(BLOCK) {
                paint_block(codes, [i0, j0, k0], &vessels);
            }
        }
    });
    let placement = Placement {
        spacing: DVec3::splat(f64::from(SPACING)),
        direction: DMat3::IDENTITY,
        origin: origin().as_dvec3(),
    };
    let report = ImportReport::plain("phantom", ScalarType::U16);
    Volume::new(DIMS, placement, Scalars::U16(codes), (1.0, f64::from(INTERCEPT)), report)
        .expect("the head's dimensions and placement make a volume")
}

/// Centre of the first voxel, mm.
fn origin() -> Vec3 {
    let [x, y, z] = DIMS.map(|n| -0.5 * SPACING * (n - 1) as f32);
    v(x, y, z)
}

/// Whether a vessel comes near the sheet of blocks that starts at voxel `first` along `axis`.
fn near_blocks(vessel: &Vessel, axis: usize, first: usize) -> bool {
    let half = 0.5 * SPACING * (BLOCK - 1) as f32;
    vessel.near_plane(axis, origin()[axis] + SPACING * first as f32 + half, half + BLUR)
}

/// Paints the block at voxel `first` into `codes`, the layer of slices that it lies in.
fn paint_block(codes: &mut [u16], first: [usize; 3], vessels: &[&Vessel]) {
    let corner = origin() + SPACING * v(first[0] as f32, first[1] as f32, first[2] as f32);
    let near = Near::to_block(corner, BLOCK, None, vessels);
    for k in (0..BLOCK).step_by(SMALL_BLOCK) {
        for j in (0..BLOCK).step_by(SMALL_BLOCK) {
            for i in (0..BLOCK).step_by(SMALL_BLOCK) {
                let corner = corner + SPACING * v(i as f32, j as f32, k as f32);
                let near = Near::to_block(corner, SMALL_BLOCK, Some(&near.parts), &near.vessels);
                paint_small_block(codes, [first[0] + i, first[1] + j, first[2] + k], corner, &near);
            }
        }
    }
}

fn paint_small_block(codes: &mut [u16], [i0, j0, k0]: [usize; 3], corner: Vec3, near: &Near<'_>) {
    let [nx, ny, _] = DIMS;
    for k in 0..SMALL_BLOCK {
        for j in 0..SMALL_BLOCK {
            let row = ((k0 + k) % BLOCK * ny + j0 + j) * nx + i0;
            let values = near.values(row_of_points(corner, j, k));
            for (i, code) in codes[row..row + SMALL_BLOCK].iter_mut().enumerate() {
                let grain = bell((i0 + i) as i32, (j0 + j) as i32, (k0 + k) as i32, 1);
                // Rounds; the cast saturates at 0.
                *code = (values[i] + NOISE * grain - INTERCEPT + 0.5) as u16;
            }
        }
    }
}

/// The voxels of row (j, k) of the small block whose first one lies at `corner`.
fn row_of_points(corner: Vec3, j: usize, k: usize) -> Points {
    let first = corner + SPACING * v(0.0, j as f32, k as f32);
    at(first.x + SPACING * Vec4::new(0.0, 1.0, 2.0, 3.0), first.y, first.z)
}

/// Which parts may reach into a block.
#[derive(Clone, Copy, Debug)]
struct Parts {
    body: bool,
    /// Skin and the fat under it.
    surface: bool,
    brain: bool,
    orbits: bool,
    vault: bool,
    face: bool,
    openings: bool,
    jaw: bool,
    spine: bool,
    airways: bool,
}

impl Parts {
    const ALL: Self = Self {
        body: true,
        surface: true,
        brain: true,
        orbits: true,
        vault: true,
        face: true,
        openings: true,
        jaw: true,
        spine: true,
        airways: true,
    };

    /// Those of `self` that reach within `reach` mm of `middle`.
    fn within(self, middle: Vec3, reach: f32) -> Self {
        let middle = Points::all(middle);
        let scalp = skin::scalp(middle);
        let skin = if self.surface { skin::surface_over(middle, scalp).x } else { -FAR };
        if !self.body || skin > reach {
            return Self { body: false, ..self };
        }
        let m = mirrored(middle);
        let cavity = if self.brain || self.vault { brain::cavity_under(middle, scalp).x } else { FAR };
        let reaches = |asked: bool, part: fn(Points) -> Vec4| asked && part(m).x < reach;
        let face = reaches(self.face, |m| skull::facial_bones(m) - skull::SEAM);
        // Where the face grows out of the brain case, the latter matters from further away.
        let vault = skull::THICKEST + if face { skull::SEAM } else { 0.0 };
        Self {
            body: true,
            surface: skin > -reach - skin::depth(middle).x,
            brain: cavity < reach,
            orbits: reaches(self.orbits, skull::orbits),
            vault: self.vault && cavity > -reach && cavity < reach + vault,
            face,
            openings: reaches(self.openings, |m| skull::nose_and_openings(m) - skull::EDGE),
            jaw: reaches(self.jaw, skull::jaw),
            spine: reaches(self.spine, skull::spine),
            airways: reaches(self.airways, skull::airways),
        }
    }
}

/// What may reach into a block.
struct Near<'a> {
    parts: Parts,
    vessels: Vec<&'a Vessel>,
}

impl<'a> Near<'a> {
    /// Of `parts` (all of them unless told) and `vessels`, what may reach into the block of `size`
    /// voxels whose first one lies at `corner`.
    fn to_block(corner: Vec3, size: usize, parts: Option<&Parts>, vessels: &[&'a Vessel]) -> Self {
        let half = 0.5 * SPACING * (size - 1) as f32;
        let middle = corner + Vec3::splat(half);
        // From the middle to a corner, and as far as edges are blurred.
        let radius = half * 1.733 + 0.5 * BLUR;
        // Distances are approximate: trust four fifths of them.
        let parts = parts.unwrap_or(&Parts::ALL).within(middle, 1.25 * radius);
        let close = |vessel: &&&Vessel| parts.body && vessel.near(middle, radius);
        Self { parts, vessels: vessels.iter().filter(close).copied().collect() }
    }

    /// Hounsfield units at `p`, without noise.
    fn values(&self, p: Points) -> Vec4 {
        let (parts, air, far) = (&self.parts, Vec4::splat(hu::AIR), Vec4::splat(FAR));
        if !parts.body {
            return air;
        }
        let scalp = if parts.surface || parts.brain || parts.vault { skin::scalp(p) } else { far };
        let skin = if parts.surface { skin::surface_over(p, scalp) } else { -far };
        let outside = above(skin, 0.5 * BLUR);
        if outside.all() {
            return air;
        }
        let cavity = if parts.brain || parts.vault { brain::cavity_under(p, scalp) } else { far };
        let (deep, shallow) = (below(cavity, -0.5 * BLUR), below(cavity, 0.5 * BLUR));
        let mut value = if deep.all() { air } else { self.around_the_brain(p, scalp, skin, cavity) };
        if shallow.any() {
            let brain = brain::value(p, cavity);
            value = Vec4::select(deep, brain, mix(value, brain, coverage(cavity, BLUR)));
        }
        for vessel in &self.vessels {
            value = mix(value, vessel.hu, coverage(vessel.distance(p), BLUR));
        }
        Vec4::select(outside, air, mix(value, hu::AIR, coverage(-skin, BLUR)))
    }

    /// Hounsfield units of flesh and bone at `p`, so far from scalp, skin and the brain's cavity.
    fn around_the_brain(&self, p: Points, scalp: Vec4, skin: Vec4, cavity: Vec4) -> Vec4 {
        let mut value = skull::deep_soft_tissue(p, &self.parts, skin);
        if self.parts.surface {
            value = skin::layers(p, skin, scalp, value);
        }
        skull::bones(p, cavity, skin, &self.parts, value)
    }
}

#[cfg(test)]
mod tests;
