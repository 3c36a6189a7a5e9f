//! Opaque geometry that ends rays: the scene's depth buffer, and its inverse warp.
//!
//! Bruckner, Schmalstieg, Hauser and Gröller 2003 carry every pixel of a depth buffer forward into sheared object space, as a
//! footprint, the nearest one winning; where footprints are too small there are holes, where too large, steps (their figure 5).
//! But a pixel of the intermediate image *is* a ray of the view, and that ray meets the final image at one point, which the inverse of
//! the 2D warp gives. So the depth is read there, backwards: every pixel has one, none has two. Between the depth buffer's pixels
//! it is interpolated where the surface goes on, and taken from the nearest where it is torn, so that neither slopes
//! become stairs nor silhouettes become sheets.
//!
//! What comes of it is where each ray ends, in slices ([`Limits`]); the kernels then treat it as one more clip plane
//! ([`super::factorization::Factorization::left`]). Rays in image order ask the buffer itself.

mod inverse_warp;
mod limits;

use std::fmt;
use std::ops::Range;

use glam::{DMat4, DVec2, DVec3};
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_128;

use super::view::View;
pub use inverse_warp::InverseWarp;
pub use limits::{Hole, Limits, Seen, SeenScanline, Stretch};

/// A step between two pixels that is so many times as large as the larger of the two beside it is a tear.
const TEAR: f32 = 2.0;

/// Places that are told side by side, as registers have room.
const LANES: usize = 8;

type Doubles = [f64; LANES];

/// Shorter steps, mm, are none: rounding of depth buffers.
const FLAT: f32 = 1e-3;

/// Where each pixel's ray meets opaque geometry.
#[derive(Clone, PartialEq)]
pub struct SceneDepth {
    width: usize,
    height: usize,
    /// mm along the rays from their origins, row by row from the top; infinite where they meet nothing.
    distances: Vec<f32>,
    /// By pixel, whether a surface goes on between it and its neighbours to the right and below.
    smooth: Vec<bool>,
    /// Pixel coordinates that hold all that rays meet: from where to where. None where nothing is met.
    met: Option<[DVec2; 2]>,
    /// Of the distances.
    hash: u128,
}

/// Told by size and content: two that say the same are the same.
impl fmt::Debug for SceneDepth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SceneDepth({} x {}, {:032x})", self.width, self.height, self.hash)
    }
}

impl SceneDepth {
    /// From mm along the rays of `view`, row by row from the top.
    ///
    /// # Panics
    /// Where there is not one for each pixel.
    pub fn new(view: &View, distances: Vec<f32>) -> Self {
        let (width, height) = view.size();
        let (width, height) = (width as usize, height as usize);
        assert_eq!(distances.len(), width * height, "a distance for each pixel");
        let hash = xxh3_128(bytemuck::cast_slice(&distances));
        let met = met(&distances, width);
        let rows = met.map_or(0..0, |[low, high]| (low.y as usize).saturating_sub(1)..high.y as usize);
        let smooth = smooth(&distances, width, rows);
        Self { width, height, distances, smooth, met, hash }
    }

    /// From a depth buffer in WebGL's window space (0 on the near plane, 1 on the far one, where nothing is), for the `view` that
    /// these matrices make.
    ///
    /// # Panics
    /// Where there is not one value for each pixel.
    pub fn from_window(values: &[f32], view: &View, projection: &DMat4, camera: &DMat4) -> Self {
        let world_from_clip = (*projection * *camera).inverse();
        let (width, height) = view.size();
        let distance = |(at, &value): (usize, &f32)| {
            if value >= 1.0 {
                return f32::INFINITY;
            }
            let pixel = DVec2::new(f64::from(at as u32 % width) + 0.5, f64::from(at as u32 / width) + 0.5);
            let clip = DVec3::new(
                2.0 * pixel.x / f64::from(width) - 1.0,
                1.0 - 2.0 * pixel.y / f64::from(height),
                2.0 * f64::from(value) - 1.0,
            );
            let ray = view.ray(pixel);
            let point = world_from_clip * clip.extend(1.0);
            ((point.truncate().dot(ray.direction) / point.w) - ray.origin.dot(ray.direction)) as f32
        };
        Self::new(view, values.par_iter().enumerate().map(distance).collect())
    }

    /// Those of all pixels, mm, row by row from the top.
    pub fn distances(&self) -> &[f32] {
        &self.distances
    }

    /// The distance of a pixel, mm.
    #[inline(always)]
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.distances[y * self.width + x]
    }

    /// The distance at pixel coordinates (centres at halves); beyond the picture it is as on its border.
    #[inline(always)]
    fn between(&self, at: DVec2) -> f32 {
        // From the first centre to the last, and the pixel before.
        let along = |at: f64, size: usize| {
            let at = (at - 0.5).clamp(0.0, (size - 1) as f64);
            let first = (at as usize).min(size.saturating_sub(2));
            (first, (at - first as f64) as f32)
        };
        let ((x, fx), (y, fy)) = (along(at.x, self.width), along(at.y, self.height));
        let pixel = y * self.width + x;
        let (right, below) = (usize::from(self.width > 1), if self.height > 1 { self.width } else { 0 });
        if self.smooth[pixel] {
            let get = |ahead: usize| self.distances[pixel + ahead];
            let upper = get(0) + (get(right) - get(0)) * fx;
            let lower = get(below) + (get(below + right) - get(below)) * fx;
            upper + (lower - upper) * fy
        } else {
            self.distances[pixel + if fx >= 0.5 { right } else { 0 } + if fy >= 0.5 { below } else { 0 }]
        }
    }
}

impl SceneDepth {
    /// [`Self::between`] side by side, at coordinates within the picture.
    #[inline(always)]
    fn between_all(&self, x: &Doubles, y: &Doubles) -> [f32; LANES] {
        let ((x, fx), (y, fy)) = (centres_before(x, self.width), centres_before(y, self.height));
        let (right, below) = (usize::from(self.width > 1), if self.height > 1 { self.width } else { 0 });
        // The upper two and the lower two.
        let mut around = [[0.0; LANES]; 4];
        let mut smooth = [false; LANES];
        for lane in 0..LANES {
            let pixel = y[lane] as usize * self.width + x[lane] as usize;
            smooth[lane] = self.smooth[pixel];
            let four = [pixel, pixel + right, pixel + below, pixel + below + right];
            for (around, pixel) in around.iter_mut().zip(four) {
                around[lane] = self.distances[pixel];
            }
        }
        let mut distances = [0.0; LANES];
        for lane in 0..LANES {
            let [a, b, c, d] = [0, 1, 2, 3].map(|n| around[n][lane]);
            let (upper, lower) = (a + (b - a) * fx[lane], c + (d - c) * fx[lane]);
            let between = upper + (lower - upper) * fy[lane];
            let (upper, lower) = if fx[lane] >= 0.5 { (b, d) } else { (a, c) };
            let nearest = if fy[lane] >= 0.5 { lower } else { upper };
            distances[lane] = if smooth[lane] { between } else { nearest };
        }
        distances
    }
}

/// The first of two pixels' centres around coordinates along an axis of a picture, and how far from it to the next.
#[inline(always)]
fn centres_before(at: &Doubles, size: usize) -> ([i32; LANES], [f32; LANES]) {
    let (mut first, mut fraction) = ([0; LANES], [0.0; LANES]);
    let (last, last_first) = ((size - 1) as f64, size.saturating_sub(2) as i32);
    for lane in 0..LANES {
        let at = at[lane] - 0.5;
        let at = if at > last {
            last
        } else if at > 0.0 {
            at
        } else {
            0.0
        };
        let whole = (at as i32).min(last_first);
        (first[lane], fraction[lane]) = (whole, (at - f64::from(whole)) as f32);
    }
    (first, fraction)
}

/// Pixel coordinates in rows of `width` that hold all that is finite.
fn met(distances: &[f32], width: usize) -> Option<[DVec2; 2]> {
    let of_row = |(y, row): (usize, &[f32])| {
        let first = row.iter().position(|distance| distance.is_finite())?;
        let last = row.iter().rposition(|distance| distance.is_finite())?;
        Some([DVec2::new(first as f64, y as f64), DVec2::new((last + 1) as f64, (y + 1) as f64)])
    };
    let rows = distances.par_chunks(width).enumerate().filter_map(of_row);
    rows.reduce_with(|[low, high], [a, b]| [low.min(a), high.max(b)])
}

/// By pixel of rows of `width`, whether a surface goes on between it and its neighbours to the right and below; not for others than
/// `rows`.
fn smooth(distances: &[f32], width: usize, rows: Range<usize>) -> Vec<bool> {
    let height = distances.len() / width;
    let mut smooth = vec![false; distances.len()];
    let told = &mut smooth[rows.start * width..rows.end * width];
    told.par_chunks_mut(width).enumerate().for_each(|(nth, smooth)| {
        let y = rows.start + nth;
        let row = |y: usize| &distances[y.min(height - 1) * width..][..width];
        let [before, upper, lower, after] = [y.saturating_sub(1), y, y + 1, y + 2].map(row);
        for (x, smooth) in smooth.iter_mut().enumerate() {
            *smooth = goes_on([before[x], upper[x], lower[x], after[x]]);
        }
        for x in 1..width {
            smooth[x - 1] &= smooth[x];
        }
        for row in [upper, lower] {
            let at = |x: usize| row[x.min(width - 1)];
            smooth[0] &= goes_on([at(0), at(0), at(1), at(2)]);
            for (smooth, four) in smooth[1..].iter_mut().zip(row.windows(4)) {
                *smooth &= goes_on([four[0], four[1], four[2], four[3]]);
            }
            for x in (1..width).rev().take(2) {
                smooth[x] &= goes_on([at(x - 1), at(x), at(x + 1), at(x + 2)]);
            }
        }
    });
    smooth
}

/// Whether a surface goes on between the middle two of four neighbours.
#[inline(always)]
fn goes_on([before, a, b, after]: [f32; 4]) -> bool {
    let [before, step, after] = [a - before, b - a, after - b].map(f32::abs);
    let beside = if before > after { before } else { after };
    (step <= TEAR * beside + FLAT) & a.is_finite() & b.is_finite()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::render::{Camera, Orbit};

    fn view() -> View {
        View::new(&Camera::Orbit(Orbit::default()), DVec3::ZERO, 10.0, 8, 6).unwrap()
    }

    #[test]
    fn slopes_are_interpolated_and_tears_are_not() {
        let distance = |n: usize| {
            let (x, y) = ((n % 8) as f32, (n / 8) as f32);
            if x < 4.0 { 3.0 * x + y } else { 100.0 - 2.0 * x }
        };
        let depth = SceneDepth::new(&view(), (0..48).map(distance).collect());
        assert_eq!(depth.between(DVec2::new(2.5, 3.5)), 9.0);
        assert_eq!(depth.between(DVec2::new(2.0, 3.0)), 3.0 * 1.5 + 2.5);
        assert_eq!(depth.between(DVec2::new(6.0, 3.0)), 100.0 - 2.0 * 5.5);
        assert_eq!(depth.between(DVec2::new(3.9, 3.5)), 12.0, "before the tear");
        assert_eq!(depth.between(DVec2::new(4.1, 3.5)), 92.0, "behind it");
        assert_eq!(depth.between(DVec2::new(-5.0, 0.5)), 0.0, "beyond the picture is as on its border");
    }

    proptest! {
        #[test]
        fn surfaces_go_on_where_four_neighbours_along_all_sides_say_so(
            width in 1usize..7,
            steps in prop::collection::vec((0..4, -2.0f32..3.0), 1..40),
        ) {
            let mut distance = 10.0;
            let mut distances: Vec<_> = steps.iter().map(|&(kind, step)| {
                distance += if kind == 1 { 20.0 * step } else { step };
                if kind == 0 { f32::INFINITY } else { distance }
            }).collect();
            distances.resize(steps.len().next_multiple_of(width), distance);
            let height = distances.len() / width;
            let at = |x: isize, y: isize| {
                distances[y.clamp(0, height as isize - 1) as usize * width + x.clamp(0, width as isize - 1) as usize]
            };
            let told = smooth(&distances, width, 0..height);
            for (pixel, told) in told.into_iter().enumerate() {
                let (x, y) = ((pixel % width) as isize, (pixel / width) as isize);
                let row = |y: isize| goes_on([-1, 0, 1, 2].map(|n| at(x + n, y)));
                let column = |x: isize| goes_on([-1, 0, 1, 2].map(|n| at(x, y + n)));
                let expected = row(y) && row(y + 1) && column(x) && column((x + 1).min(width as isize - 1));
                prop_assert_eq!(told, expected, "pixel {} of {:?}", pixel, distances);
            }
        }
    }

    #[test]
    fn where_nothing_is_rays_do_not_end() {
        let mut distances = vec![f32::INFINITY; 48];
        distances[8 * 3 + 4] = 5.0;
        let depth = SceneDepth::new(&view(), distances);
        assert_eq!(depth.between(DVec2::new(4.4, 3.6)), 5.0);
        assert_eq!(depth.between(DVec2::new(3.4, 3.6)), f32::INFINITY);
    }

    #[test]
    fn a_window_depth_is_a_distance_along_the_ray() {
        let camera = DMat4::from_translation(DVec3::new(0.0, 0.0, -30.0));
        let projection = glam::dcamera::rh::proj::opengl::perspective(0.5, 8.0 / 6.0, 1.0, 100.0);
        let view = View::new(&Camera::Matrices { view: camera, projection }, DVec3::ZERO, 10.0, 8, 6).unwrap();
        // The plane z = 4, 26 mm in front of the eye.
        let clip = projection * DVec3::new(0.0, 0.0, -26.0).extend(1.0);
        let depth = SceneDepth::from_window(&[(clip.z / clip.w * 0.5 + 0.5) as f32; 48], &view, &projection, &camera);
        for (x, y) in [(0, 0), (4, 3), (7, 5)] {
            let ray = view.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            let met = ray.origin + ray.direction * f64::from(depth.at(x, y));
            assert!((met.z - 4.0).abs() < 1e-3, "{met}");
        }
        let empty = SceneDepth::from_window(&[1.0; 48], &view, &projection, &camera);
        assert_eq!(empty.at(3, 3), f32::INFINITY);
    }
}
