//! The built-in demo volume: a CT angiography of a head that nobody owns.
//!
//! Anatomy is modelled as solids ([`super::shape`]) in millimetres around the middle of the head, x
//! to the left, y to the back, z up, and painted from the outside in: air, skin, fat, muscle, then
//! brain, bone, teeth, eyes, airways and at last vessels. Every edge is blurred over [`BLUR`] as a scanner does, so
//! that surfaces come out smooth, and a little noise lies over everything.
//!
//! To be quick, voxels are made in blocks of 8^3. A solid's distance from a block's middle tells
//! whether it can reach into the block at all: most blocks need no solid (air) or one (brain).

mod brain;
mod skin;
mod skull;
mod vessels;

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::random::{bell, mix};
use super::shape::{coverage, v};
use crate::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

/// Voxels along x, y, z.
const DIMS: [usize; 3] = [176, 208, 208];
/// mm; 211 x 250 x 250 mm in all, a usual field of view.
const SPACING: f32 = 1.2;
/// HU of code 0.
const INTERCEPT: f32 = -1024.0;
/// Edges are this wide, mm: the point spread of a soft reconstruction kernel.
const BLUR: f32 = 2.0;
/// Standard deviation of the scanner's noise, HU.
const NOISE: f32 = 7.0;
/// Edge of a block, voxels.
const BLOCK: usize = 8;

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

/// A CT scan of a head in Hounsfield units, made up: 176 x 208 x 208 voxels of 1.2 mm, centred on the
/// origin, facing -y. The same bits on every machine and with any number of threads.
pub fn head() -> Volume {
    let [nx, ny, _] = DIMS;
    let vessels = vessels::tree();
    let mut codes = vec![0_u16; DIMS.iter().product()];
    codes.par_chunks_mut(nx * ny * BLOCK).enumerate().for_each(|(layer, codes)| {
        let k0 = layer * BLOCK;
        for j0 in (0..ny).step_by(BLOCK) {
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

/// Paints a block into `codes`, the layer of slices that it lies in.
fn paint_block(codes: &mut [u16], first: [usize; 3], vessels: &[vessels::Vessel]) {
    let [nx, ny, _] = DIMS;
    let corner = origin() + SPACING * v(first[0] as f32, first[1] as f32, first[2] as f32);
    let half = 0.5 * SPACING * (BLOCK - 1) as f32;
    let near = Near::around(corner + Vec3::splat(half), half * 1.733, vessels);
    for k in 0..BLOCK {
        for j in 0..BLOCK {
            let row = (k * ny + first[1] + j) * nx + first[0];
            for (i, code) in codes[row..row + BLOCK].iter_mut().enumerate() {
                let p = corner + SPACING * v(i as f32, j as f32, k as f32);
                let grain = bell((first[0] + i) as i32, (first[1] + j) as i32, (first[2] + k) as i32, 1);
                // The cast saturates at 0.
                *code = (near.value(p) + NOISE * grain - INTERCEPT).round() as u16;
            }
        }
    }
}

/// What may reach into a block.
struct Near {
    body: bool,
    /// The surface, its fat and what is in it; false deep inside.
    surface: bool,
    skull: bool,
    face: bool,
    brain: bool,
    vessels: Vec<vessels::Vessel>,
}

impl Near {
    /// A block's ball of this `radius` around `middle`, mm.
    fn around(middle: Vec3, radius: f32, vessels: &[vessels::Vessel]) -> Self {
        // Approximate distances are trusted up to a third.
        let reach = 1.5 * (radius + BLUR);
        let skin = skin::surface(middle);
        let cavity = brain::cavity(middle);
        let body = skin < reach;
        Self {
            body,
            surface: body && skin > -reach - skin::DEPTH,
            skull: body && cavity > -reach,
            face: body && skull::near_face(middle, radius + BLUR),
            brain: cavity < reach,
            vessels: if body {
                vessels.iter().filter(|s| s.distance(middle) < radius + BLUR).copied().collect()
            } else {
                vec![]
            },
        }
    }

    /// Hounsfield units at `p`, without noise.
    fn value(&self, p: Vec3) -> f32 {
        if !self.body {
            return hu::AIR;
        }
        let mut value = if self.surface { skin::layers(p) } else { hu::MUSCLE };
        let paint = |value: &mut f32, distance: f32, with: f32| *value = mix(*value, with, coverage(distance, BLUR));
        if self.brain || self.skull {
            let cavity = brain::cavity(p);
            if self.face {
                value = skull::deep_soft_tissue(p, value);
            }
            if self.skull {
                value = skull::paint(p, cavity, self.face, value);
            }
            if self.brain && cavity < BLUR {
                paint(&mut value, cavity, brain::value(p, cavity));
            }
        }
        for vessel in &self.vessels {
            paint(&mut value, vessel.distance(p), vessel.hu);
        }
        value
    }
}
