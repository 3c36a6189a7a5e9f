//! Voxels with colours of their own, and those of labels.

use glam::Vec4;

use super::{AnyLight, Light, opacity};
use crate::classify::labels::LabelTables;
use crate::classify::transfer::MAX_OPACITY;
use crate::render::Sampling;
use crate::render::composite::sources::Stored;

/// Voxels that look each as they are, and not by their codes alone. What is interpolated between them follows Kraus and Bürger 2008.
#[derive(Clone, Copy, Debug)]
pub struct Painted<'a> {
    pub light: AnyLight<'a>,
    pub paint: Paint<'a>,
    pub sampling: Sampling,
}

/// Where the looks of voxels come from.
#[derive(Clone, Copy, Debug)]
pub enum Paint<'a> {
    /// Colours of their own; extinction by the transfer function.
    Colors(Stored<'a, [u8; 4]>),
    /// Colour and extinction by label, the latter per mm.
    Labels8(Stored<'a, u8>, &'a LabelTables),
    Labels16(Stored<'a, u16>, &'a LabelTables),
}

impl Light for Painted<'_> {
    const LIT: bool = true;
    const BLOCKS: bool = false;
    const PAINTED: bool = true;

    #[inline(always)]
    fn shade<const N: usize>(self, normals: &[u16; N], at: [usize; 3]) -> [[f32; N]; 2] {
        self.light.shade(normals, at)
    }

    #[inline(always)]
    fn paint(self, entry: Vec4, code: u16, at: [usize; 3]) -> Vec4 {
        let ([r, g, b], extinction) = match self.paint {
            Paint::Colors(colors) => {
                let [r, g, b, _] = colors.at(at).map(f32::from);
                return (Vec4::new(r, g, b, 0.0) / 255.0).with_w(entry.w);
            }
            Paint::Labels8(labels, tables) => tables.look(labels.at(at).into(), code),
            Paint::Labels16(labels, tables) => tables.look(labels.at(at), code),
        };
        Vec4::new(r, g, b, extinction)
    }

    #[inline(always)]
    fn factored(self, depth: f32, factor: u8, at: [usize; 3]) -> f32 {
        match self.paint {
            Paint::Colors(_) => depth * f32::from(factor) / 255.0,
            Paint::Labels8(labels, tables) => depth * tables.gradient_factor(labels.at(at).into(), factor),
            Paint::Labels16(labels, tables) => depth * tables.gradient_factor(labels.at(at), factor),
        }
    }

    #[inline(always)]
    fn weight(self, depth: f32) -> f32 {
        match self.sampling {
            Sampling::Extinction => depth,
            Sampling::Opacity => opacity(depth),
        }
    }

    #[inline(always)]
    fn resampled(self, sample: Vec4, lengths: f32) -> Vec4 {
        if sample.w <= 0.0 {
            return Vec4::ZERO;
        }
        let depth = match self.sampling {
            Sampling::Extinction => sample.w,
            Sampling::Opacity => -(-sample.w.min(MAX_OPACITY as f32)).ln_1p(),
        };
        let alpha = opacity(depth * lengths);
        (sample * (alpha / sample.w)).with_w(alpha)
    }
}
