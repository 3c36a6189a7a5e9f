//! What voxels are lit by.

use std::array::from_fn;
use std::fmt::Debug;

use glam::Vec4;

use crate::render::composite::sources::Stored;
use crate::render::ray_light::RayLight;
use crate::render::shade::ShadingTable;
use crate::render::shadow::{darken, part_of};

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
        if let Some((in_shadow, lacking)) = self.shadow {
            let lacking = from_fn(|n| part_of(lacking.at([i + n, j, k])));
            darken(&mut light, &in_shadow.shade(normals, [i, j, k]), lacking);
        }
        light
    }
}
