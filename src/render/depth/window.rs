//! Distances of a depth buffer in window space.

use std::array;
use std::ops::Range;

use glam::{DMat4, DVec2, DVec3, DVec4};

use crate::render::view::{Rays, View};
use crate::simd::masks::WORD;
use crate::simd::wide::{LANES, Lanes};
use crate::simd::{self, Kernel};
use crate::volume::Volume;

/// The far plane's depth: nothing is there.
pub const FAR: f32 = 1.0;

/// So many voxels and pixels around what is seen are told of it: as far as rays, and what is torn between them, are looked at.
const AROUND: f64 = 6.0;

/// Values that are no window depths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected values from 0 to 1, got {0} others")]
pub struct NoWindowDepths(pub usize);

/// What is told of window depths while they are received, when they are near.
#[derive(Clone, Debug, Default)]
pub struct Met {
    /// Which words of them hold anything in front of the far plane.
    words: Vec<bool>,
    /// How many of them are none.
    others: usize,
}

/// Bytes of a word's values.
const WORD_BYTES: usize = WORD * size_of::<f32>();

impl Met {
    /// Of 32-bit floats, little endian, as far as they have come: `bytes` are all of these, and looked at once.
    pub fn advance(&mut self, bytes: &[u8]) {
        let unknown = bytes.get(self.words.len() * WORD_BYTES..).unwrap_or_default();
        simd::dispatch(Advance { unknown: unknown.as_chunks().0, met: self });
    }

    /// Of all of them.
    ///
    /// # Errors
    /// Where values are not from 0 to 1.
    pub(super) fn finish(mut self, values: &[f32]) -> Result<Self, NoWindowDepths> {
        let unknown = values.get(self.words.len() * WORD..).unwrap_or_default();
        for word in unknown.chunks(WORD) {
            self.words.push(word.iter().any(|value| *value != FAR));
            self.others += word.iter().filter(|value| !(0.0..=FAR).contains(*value)).count();
        }
        if self.others == 0 { Ok(self) } else { Err(NoWindowDepths(self.others)) }
    }

    /// Whether there may be anything among some values.
    pub(super) fn among(&self, values: Range<usize>) -> bool {
        self.words[values.start / WORD..values.end.div_ceil(WORD)].contains(&true)
    }
}

/// The job: whether each of some words holds anything in front of the far plane, and what is no depth.
struct Advance<'a> {
    unknown: &'a [[u8; WORD_BYTES]],
    met: &'a mut Met,
}

impl Kernel for Advance<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { unknown, met } = self;
        for word in unknown {
            let (mut nearer, mut others) = (0, 0);
            for value in word.as_chunks().0 {
                // Positive numbers are in the order of their bits.
                let bits = u32::from_le_bytes(*value);
                nearer |= bits ^ FAR.to_bits();
                others += u32::from((bits > FAR.to_bits()) & (bits != (-0.0f32).to_bits()));
            }
            met.words.push(nearer != 0);
            met.others += others as usize;
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

/// The columns and rows of a picture of `size`, and a few around, in which these matrices show some voxels of a volume along its axes x, y, z.
pub fn seen(
    (volume, voxels): (&Volume, &[Range<usize>; 3]),
    [projection, camera]: [&DMat4; 2],
    size: [usize; 2],
) -> [Range<usize>; 2] {
    if voxels.iter().any(Range::is_empty) {
        return [0..0, 0..0];
    }
    let clip_from_index = *projection * *camera * volume.world_from_index();
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for corner in 0..8 {
        let index = array::from_fn(|axis| match corner >> axis & 1 {
            0 => voxels[axis].start as f64 - AROUND,
            _ => voxels[axis].end as f64 - 1.0 + AROUND,
        });
        let clip = clip_from_index * DVec3::from_array(index).extend(1.0);
        if clip.w <= 0.0 {
            // Behind the eye.
            return size.map(|size| 0..size);
        }
        let at = clip.truncate().truncate() / clip.w;
        (low, high) = (low.min(at), high.max(at));
    }
    let of_axis = |[low, high]: [f64; 2], size: usize| {
        let [low, high] = [low, high].map(|at| (at + 1.0) / 2.0 * size as f64);
        (low - AROUND).floor().max(0.0) as usize..((high + AROUND).ceil().max(0.0) as usize).min(size)
    };
    // Rows are counted from the top.
    [of_axis([low.x, high.x], size[0]), of_axis([-high.y, -low.y], size[1])]
}

/// The job: distances of some `columns` of values of window depth, from row `first` of a picture on.
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
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { ahead, values, width, columns, first, distances } = self;
        for (y, distances) in (first..).zip(distances.chunks_exact_mut(columns.len())) {
            let values = &values[y * width..][columns.clone()];
            let ((values, rest), (distances, last)) = (values.as_chunks(), distances.as_chunks_mut());
            for (n, (depths, distances)) in values.iter().zip(distances).enumerate() {
                *distances = ahead.distances([columns.start + n * LANES, y], depths);
            }
            if !rest.is_empty() {
                let mut depths = [FAR; LANES];
                depths[..rest.len()].copy_from_slice(rest);
                let distances = ahead.distances([columns.end - rest.len(), y], &depths);
                last.copy_from_slice(&distances[..rest.len()]);
            }
        }
    }
}
