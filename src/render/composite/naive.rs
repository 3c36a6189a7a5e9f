//! The composite without runs, masks, links or bands: the standard for correctness checking.
//!
//! Every pixel gathers from four voxels in every slice, each looked up, shaded and weighted anew,
//! and tests for itself whether it is opaque. The kernel's pixels must be the same bit for bit.

use glam::Vec4;
use rayon::prelude::*;

use super::{Composite, Weights, over};
use crate::classify::rle::Scanline;
use crate::render::RenderError;
use crate::render::intermediate::IntermediateImage;
use crate::render::material::SliceMaterial;

/// Composites all slices into `image`, as [`Composite::run`] does.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub fn run<const LIT: bool, const FACTORED: bool>(
    composite: &Composite<'_, LIT, FACTORED>,
    image: &mut IntermediateImage,
) -> Result<(), RenderError> {
    image.bands(1).try_for_each(|mut band| {
        if composite.cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        let v = band.first;
        for (u, pixel) in band.scanline(0).pixels.iter_mut().enumerate() {
            *pixel = composite.pixel(u, v);
        }
        Ok(())
    })
}

impl<const LIT: bool, const FACTORED: bool> Composite<'_, LIT, FACTORED> {
    /// The ray of intermediate pixel (u, v).
    fn pixel(&self, u: usize, v: usize) -> Vec4 {
        let f = self.factorization;
        let mut pixel = Vec4::ZERO;
        for step in 0..f.dims[2] {
            let k = if f.reversed { f.dims[2] - 1 - step } else { step };
            let slice = f.slice(k);
            let between = slice.fraction.map(|fraction| usize::from(fraction > 0.0));
            let inside = |at: usize, axis: usize| {
                at >= slice.first[axis] && at - slice.first[axis] + between[axis] < f.dims[axis]
            };
            if !inside(u, 0) || !inside(v, 1) || f.is_clipped() && !f.visible_pixels(v, k).contains(&u) {
                continue;
            }
            let (i, j) = (u - slice.first[0], v - slice.first[1]);
            let material = self.material.slice(f.is_outermost(k));
            let row = |j: usize| {
                let scanline = self.encoding.scanline(j, k);
                [voxel(&scanline, i, material), voxel(&scanline, i + 1, material)]
            };
            let weights = Weights::new(slice.fraction[0], slice.fraction[1]);
            let sample = if between[1] == 1 {
                weights.sample::<true>(row(j), row(j + 1))
            } else {
                weights.sample::<false>(row(j), [Vec4::ZERO; 2])
            };
            pixel = over(pixel, sample);
            if pixel.w >= self.opaque {
                break;
            }
        }
        pixel
    }
}

/// Voxel `i` of a scanline; zero where it is transparent or past the end.
fn voxel<const LIT: bool, const FACTORED: bool>(
    scanline: &Scanline<'_>,
    i: usize,
    material: SliceMaterial<'_, LIT, FACTORED>,
) -> Vec4 {
    let mut before = 0;
    for run in scanline.runs {
        let (start, length) = (usize::from(run.start), usize::from(run.length));
        if (start..start + length).contains(&i) {
            let at = before + i - start;
            let factor = scanline.factors.get(at).copied().unwrap_or(u8::MAX);
            return material.color(scanline.voxels[at], factor);
        }
        before += length;
    }
    Vec4::ZERO
}
