//! Distances of a depth buffer in window space.

use std::ops::Range;

use glam::{DMat4, DVec3, DVec4};

use crate::render::view::{Rays, View};
use crate::simd::masks::WORD;
use crate::simd::wide::{LANES, Lanes};
use crate::simd::{self, Kernel};

/// The far plane's depth: nothing is there.
pub const FAR: f32 = 1.0;

/// Values that are no window depths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected values from 0 to 1, got {0} others")]
pub struct NoWindowDepths(pub usize);

/// Which words of window depths hold anything in front of the far plane: told while they are received, when they are near.
#[derive(Clone, Debug, Default)]
pub struct Met(Vec<bool>);

/// Bytes of a word's values.
const WORD_BYTES: usize = WORD * size_of::<f32>();

impl Met {
    /// Of 32-bit floats, little endian, as far as they have come: `bytes` are all of these, and looked at once.
    pub fn advance(&mut self, bytes: &[u8]) {
        let known = bytes.get(self.0.len() * WORD_BYTES..).unwrap_or_default();
        simd::dispatch(Advance { words: known.as_chunks().0, met: &mut self.0 });
    }

    /// Whether there may be anything among some values.
    pub(super) fn among(&self, values: Range<usize>) -> bool {
        // The last word may be cut short.
        (values.start / WORD..values.end.div_ceil(WORD)).any(|word| self.0.get(word).is_none_or(|met| *met))
    }
}

/// The job: whether each of some words holds anything in front of the far plane.
struct Advance<'a> {
    words: &'a [[u8; WORD_BYTES]],
    met: &'a mut Vec<bool>,
}

impl Kernel for Advance<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for word in self.words {
            let mut others = 0;
            for value in word.as_chunks().0 {
                others |= u32::from_le_bytes(*value) ^ FAR.to_bits();
            }
            self.met.push(others != 0);
        }
    }
}

/// How far along its ray what lies in window space is: the fraction of two sums, times the length of the ray to where it is 1.
///
/// In perspective depth is counted along the view's forward direction, of which all rays to the plane of the pixels are as long a part.
pub struct Ahead {
    rays: Rays,
    /// Of pixel coordinates, a window depth and 1.
    depth: DVec4,
    weight: DVec4,
    /// Of a millimetre of depth, of the vectors that rays are told by.
    scale: f64,
}

impl Ahead {
    /// For the `view` that these matrices make.
    pub fn new(view: &View, projection: &DMat4, camera: &DMat4) -> Self {
        let (width, height) = view.size();
        let clip_from_window = DMat4::from_translation(DVec3::new(-1.0, 1.0, -1.0))
            * DMat4::from_scale(DVec3::new(2.0 / f64::from(width), -2.0 / f64::from(height), 2.0));
        let world_from_window = (*projection * *camera).inverse() * clip_from_window;
        let weight = world_from_window.row(3);
        let along = |direction: DVec3| world_from_window.transpose() * direction.extend(0.0);
        let rays = *view.rays();
        match rays {
            Rays::Parallel { corner, dx, dy, direction } => {
                let origin = DVec4::new(dx.dot(direction), dy.dot(direction), 0.0, corner.dot(direction));
                Self { rays, depth: along(direction) - origin * weight.w, weight, scale: 1.0 }
            }
            Rays::Perspective { eye, corner, .. } => {
                let forward = view.forward();
                let depth = along(forward) - weight * eye.dot(forward);
                Self { rays, depth, weight, scale: 1.0 / corner.dot(forward) }
            }
        }
    }

    /// Of eight window depths in row `y` from pixel `x` on; infinite where they are 1.
    #[inline(always)]
    fn distances(&self, [x, y]: [usize; 2], depths: &Lanes) -> Lanes {
        let (x, y) = (x as f64 + 0.5, y as f64 + 0.5);
        let (mut ahead, mut weight, mut length) = ([0.0; LANES], [0.0; LANES], [self.scale; LANES]);
        let of_row = |sum: &DVec4| sum.x * x + sum.y * y + sum.w;
        let (ahead_first, weight_first) = (of_row(&self.depth), of_row(&self.weight));
        for lane in 0..LANES {
            let (step, depth) = (lane as f64, f64::from(depths[lane]));
            ahead[lane] = ahead_first + self.depth.x * step + self.depth.z * depth;
            weight[lane] = weight_first + self.weight.x * step + self.weight.z * depth;
        }
        if let Rays::Perspective { corner, dx, dy, .. } = &self.rays {
            let first = *corner + *dx * x + *dy * y;
            for (lane, length) in length.iter_mut().enumerate() {
                let step = lane as f64;
                let ray = [first.x + dx.x * step, first.y + dx.y * step, first.z + dx.z * step];
                *length *= (ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]).sqrt();
            }
        }
        let mut distances = [0.0; LANES];
        for lane in 0..LANES {
            let distance = (length[lane] * ahead[lane] / weight[lane]) as f32;
            distances[lane] = if depths[lane] < FAR { distance } else { f32::INFINITY };
        }
        distances
    }
}

/// Counts by lane what is no window depth.
#[inline(always)]
fn count_others(depths: &Lanes, others: &mut [u32; LANES]) {
    for lane in 0..LANES {
        others[lane] += u32::from(!((depths[lane] >= 0.0) & (depths[lane] <= 1.0)));
    }
}

/// The job: distances of some `columns` of values of window depth, from row `first` of a picture on; gives how many are none.
pub struct Distances<'a> {
    pub ahead: &'a Ahead,
    /// Of the whole picture, in rows of `width`.
    pub values: &'a [f32],
    pub width: usize,
    pub columns: Range<usize>,
    pub first: usize,
    pub distances: &'a mut [f32],
}

impl Kernel for Distances<'_> {
    type Output = usize;

    #[inline(always)]
    fn run(self) -> usize {
        let Self { ahead, values, width, columns, first, distances } = self;
        let mut others = [0; LANES];
        for (y, distances) in (first..).zip(distances.chunks_exact_mut(columns.len())) {
            let values = &values[y * width..][columns.clone()];
            let ((values, rest), (distances, last)) = (values.as_chunks(), distances.as_chunks_mut());
            for (n, (depths, distances)) in values.iter().zip(distances).enumerate() {
                count_others(depths, &mut others);
                *distances = ahead.distances([columns.start + n * LANES, y], depths);
            }
            if !rest.is_empty() {
                let mut depths = [FAR; LANES];
                depths[..rest.len()].copy_from_slice(rest);
                count_others(&depths, &mut others);
                let distances = ahead.distances([columns.end - rest.len(), y], &depths);
                last.copy_from_slice(&distances[..rest.len()]);
            }
        }
        others.into_iter().sum::<u32>() as usize
    }
}
