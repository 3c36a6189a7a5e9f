//! Final pixels between rays that end at opaque geometry and rays that go on.
//!
//! The bilinear filter mixes the four rays around a pixel, which is right as long as all of them have seen the same. Along the rim of a
//! mesh some have ended where others went on, and a mixture of the two is neither what is in front of the mesh nor what is
//! beside it: over the picture of the mesh it shows as a row of beads. There a pixel takes those of the four that end where its
//! own ray does.

use glam::DVec2;
use rayon::prelude::*;

use super::Part;
use crate::render::depth::InverseWarp;
use crate::render::intermediate::Fixed;

/// By so much a place on the picture may be off, pixels.
const ROUNDING: f64 = 1e-6;

/// Ends that lie no farther apart, in slices, are the same.
const SAME: f32 = 1.0;

/// So many scanlines are looked at together, at least.
const TOGETHER: usize = 8;

/// The pixels of a picture of `size` that lie between rays with other ends than theirs, warped anew.
pub fn mended(parts: &[Part<'_>], size: [usize; 2]) -> Vec<([usize; 2], Fixed)> {
    let of_part = |part: &Part<'_>| {
        let ends = part.depth.map_or(0..0, InverseWarp::may_hold_ends);
        let rows = ends.start.saturating_sub(1)..ends.end.min(part.image.size()[1].saturating_sub(1));
        let of_rows = rows.into_par_iter().with_min_len(TOGETHER).fold(Vec::new, |mut found, v| {
            part.mend(v, size, &mut found);
            found
        });
        of_rows.collect::<Vec<_>>()
    };
    parts.iter().flat_map(of_part).flatten().collect()
}

impl Part<'_> {
    /// Adds those between scanlines `v` and `v + 1`, of a picture of `size` pixels, to those that were `found`.
    fn mend(&self, v: usize, size: [usize; 2], found: &mut Vec<([usize; 2], Fixed)>) {
        let Some(depth) = self.depth else { return };
        // Where nothing was drawn a mixture is what all of them are.
        let drawn = self.image.drawn(v, v + 1);
        for u in depth.torn(v, drawn.start.saturating_sub(1)..drawn.end, SAME) {
            let [xs, ys] = self.over([u, v], size);
            let pixels = ys.flat_map(|y| xs.clone().map(move |x| [x, y]));
            found.extend(pixels.filter_map(|at| Some((at, self.mended_pixel(at, [u, v])?))));
        }
    }

    /// The pixels of a picture of `size` with centres that may lie between pixel (u, v) and pixel (u + 1, v + 1).
    fn over(&self, [u, v]: [usize; 2], size: [usize; 2]) -> [std::ops::Range<usize>; 2] {
        let Some(depth) = self.depth else { return [0..0, 0..0] };
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for [du, dv] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
            let Some(at) = depth.image_point(DVec2::new((u + du) as f64, (v + dv) as f64)) else { return [0..0, 0..0] };
            (low, high) = (low.min(at), high.max(at));
        }
        // Centres are at halves; beyond zero a number becomes zero.
        [0, 1].map(|axis| {
            let first = (low[axis] - 0.5 - ROUNDING).ceil() as usize;
            first..((high[axis] + 0.5 + ROUNDING).floor() as usize).min(size[axis])
        })
    }

    /// Pixel (x, y), if it lies between pixel (u, v) and pixel (u + 1, v + 1) and is to be warped anew.
    fn mended_pixel(&self, [x, y]: [usize; 2], [u, v]: [usize; 2]) -> Option<Fixed> {
        let (depth, factorization) = (self.depth?, self.factorization);
        let centre = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let homogeneous = factorization.sheared_from_image * centre.extend(1.0);
        let at = homogeneous.truncate() / homogeneous.z;
        let [low, high] = factorization.extent;
        let here = at.floor() == DVec2::new(u as f64, v as f64) && at.cmpge(low).all() && at.cmple(high).all();
        if homogeneous.z <= 0.0 || !here || !factorization.owns(centre) {
            return None;
        }
        let own = depth.end_at(centre);
        let around = [[u, v], [u + 1, v], [u, v + 1], [u + 1, v + 1]];
        let apart = around.map(|[u, v]| (depth.end(u, v) - own).abs());
        let farthest = apart.into_iter().fold(0.0, f32::max);
        if farthest <= SAME {
            return None;
        }
        let fraction = at - at.floor();
        let (fu, fv) = (fraction.x as f32, fraction.y as f32);
        let weights = [(1.0 - fu) * (1.0 - fv), fu * (1.0 - fv), (1.0 - fu) * fv, fu * fv];
        let (mut sum, mut whole) = ([0.0; 4], 0.0);
        for (([u, v], apart), weight) in around.into_iter().zip(apart).zip(weights) {
            if apart > farthest / 2.0 {
                continue;
            }
            // A pixel that is alone among those around it is seen whole, however far away.
            let weight = weight.max(1e-6);
            let pixel = self.image.pixels()[v * self.image.size()[0] + u];
            for (sum, component) in sum.iter_mut().zip(pixel) {
                *sum += weight * f32::from(component);
            }
            whole += weight;
        }
        (whole > 0.0).then(|| sum.map(|component| (component / whole).round() as i16))
    }
}
