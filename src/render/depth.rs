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
mod surface;
mod window;

use std::array::from_fn;
use std::fmt;
use std::ops::Range;

use glam::{DMat4, DVec2};
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_128;

use super::awake;
use super::ranges::{common, hull};
use super::spare::Spare;
use super::view::View;
use crate::simd::masks::WORD;
use crate::simd::wide::{CellRow, INTEGER, LANES, Lanes, MANTISSA, Wide};
use crate::simd::{self, Kernel};
use crate::volume::Volume;
pub use inverse_warp::InverseWarp;
pub use limits::{Hole, Limits, Seen, SeenScanline, Stretch};
use surface::{goes_on, smooth};
use window::{Ahead, Distances, FAR, seen};
pub use window::{Met, NoWindowDepths};

/// Rows that are told together.
const BAND_HEIGHT: usize = 16;

/// Rows in which it is looked together for what is met.
const LOOKED_AT: usize = 64;

/// Where each pixel's ray meets opaque geometry.
#[derive(Clone, PartialEq)]
pub struct SceneDepth {
    width: usize,
    height: usize,
    /// Columns and rows of pixels that hold all that rays meet, and one more on each side where there is one; empty where nothing is met.
    window: [Range<usize>; 2],
    /// mm along the rays of these pixels from their origins, row by row from the top; infinite where they meet nothing.
    distances: Vec<f32>,
    /// By pixel of these, whether a surface goes on between it and its neighbours to the right and below.
    smooth: Vec<bool>,
    /// Of the window and its distances.
    hash: u128,
}

/// Memory for distances that are not needed any more.
static SPARE_DISTANCES: Spare<f32> = Spare::none();

impl Drop for SceneDepth {
    fn drop(&mut self) {
        SPARE_DISTANCES.give(std::mem::take(&mut self.distances));
    }
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
        assert_eq!(distances.len(), pixels(view), "a distance for each pixel");
        let width = view.size().0 as usize;
        let window = window(&distances, width, f32::INFINITY, |_| true);
        let within = |row: usize, own: &mut [f32]| own.copy_from_slice(&distances[row * width..][window[0].clone()]);
        Self::of_window(view, window.clone(), |first, own| {
            (first..).zip(own.chunks_exact_mut(window[0].len())).for_each(|(row, own)| within(row, own));
        })
    }

    /// From a depth buffer in WebGL's window space (0 on the near plane, 1 on the far one, where nothing is), for the `view` that
    /// the matrices (projection and view) make; `met` has looked at the values. Nothing is told of rays that pass none of the voxels `shown` of a volume, along
    /// its axes, where these are given.
    ///
    /// # Errors
    /// Where values are not from 0 to 1.
    ///
    /// # Panics
    /// Where there is not one value for each pixel.
    pub fn from_window(
        values: &[f32],
        met: Met,
        view: &View,
        [projection, camera]: [&DMat4; 2],
        shown: Option<(&Volume, &[Range<usize>; 3])>,
    ) -> Result<Self, NoWindowDepths> {
        assert_eq!(values.len(), pixels(view), "a value for each pixel");
        let _frame = awake::Frame::begin();
        let ahead = Ahead::new(view, projection, camera);
        let width = view.size().0 as usize;
        let met = met.finish(values)?;
        let mut window = window(values, width, FAR, |numbers| met.among(numbers));
        if let Some(shown) = shown {
            let seen = seen(shown, [projection, camera], [width, values.len() / width]);
            window = [0, 1].map(|axis| common(&window[axis], &seen[axis]));
        }
        if window.iter().any(Range::is_empty) {
            window = [0..0, 0..0];
        }
        Ok(Self::of_window(view, window.clone(), |first, distances| {
            simd::dispatch(Distances { ahead: &ahead, values, width, columns: window[0].clone(), first, distances });
        }))
    }

    /// What `fill` writes, from a row on, of the window's part of rows.
    fn of_window(view: &View, window: [Range<usize>; 2], fill: impl Fn(usize, &mut [f32]) + Sync) -> Self {
        let [columns, rows] = [window[0].len(), window[1].len()];
        let mut distances = SPARE_DISTANCES.take();
        distances.resize(columns * rows, 0.0);
        let bands = distances.par_chunks_mut((columns * BAND_HEIGHT).max(1)).enumerate();
        let hashes: Vec<u128> = bands
            .map(|(band, distances)| {
                fill(window[1].start + band * BAND_HEIGHT, distances);
                xxh3_128(bytemuck::cast_slice(distances))
            })
            .collect();
        let smooth = smooth(&distances, columns);
        let hash = xxh3_128(format!("{window:?} {hashes:x?}").as_bytes());
        let (width, height) = view.size();
        Self { width: width as usize, height: height as usize, window, distances, smooth, hash }
    }

    /// Those of all pixels, mm, row by row from the top.
    pub fn distances(&self) -> Vec<f32> {
        let mut all = vec![f32::INFINITY; self.width * self.height];
        let [columns, rows] = &self.window;
        for (row, own) in rows.clone().zip(self.distances.chunks_exact(columns.len().max(1))) {
            all[row * self.width..][columns.clone()].copy_from_slice(own);
        }
        all
    }

    /// The distance of a pixel, mm.
    #[inline(always)]
    pub fn at(&self, x: usize, y: usize) -> f32 {
        let [columns, rows] = &self.window;
        if columns.contains(&x) && rows.contains(&y) {
            self.distances[(y - rows.start) * columns.len() + x - columns.start]
        } else {
            f32::INFINITY
        }
    }

    /// The distance at pixel coordinates (centres at halves); beyond the picture it is as on its border.
    #[inline(always)]
    fn between(&self, at: DVec2) -> f32 {
        if self.distances.is_empty() {
            return f32::INFINITY;
        }
        let [(x, fx), (y, fy)] = [0, 1].map(|axis| cell(at[axis], &self.window[axis]));
        let pixel = y * self.window[0].len() + x;
        let (right, below) = self.ahead();
        if self.smooth[pixel] {
            let get = |ahead: usize| self.distances[pixel + ahead];
            let upper = get(0) + (get(right) - get(0)) * fx;
            let lower = get(below) + (get(below + right) - get(below)) * fx;
            upper + (lower - upper) * fy
        } else {
            self.distances[pixel + if fx >= 0.5 { right } else { 0 } + if fy >= 0.5 { below } else { 0 }]
        }
    }

    /// [`Self::between`] side by side.
    #[inline(always)]
    fn between_all<W: Wide>(&self, x: &Lanes, y: &Lanes) -> Lanes {
        let (right, below) = self.ahead();
        if right == 0 || below == 0 {
            // There are no four around.
            return from_fn(|lane| self.between(DVec2::new(x[lane].into(), y[lane].into())));
        }
        let [columns, rows] = [0, 1].map(|axis| {
            let Range { start, end } = self.window[axis];
            let low = start as f32 + 0.5;
            CellRow { low, high: end as f32 - 0.5, origin: low, last: (end - start - 2) as f32 }
        });
        let ([column, fx], [row, fy]) = (W::cells(x, &columns), W::cells(y, &rows));
        let (width, mut pixels, mut distances) = (self.window[0].len() as u32, [0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            pixels[lane] = whole(row[lane]).wrapping_mul(width).wrapping_add(whole(column[lane]));
        }
        let between = W::bilinear(&self.distances, self.window[0].len(), &pixels, [&fx, &fy]);
        let mut smooth = [false; LANES];
        for lane in 0..LANES {
            smooth[lane] = self.smooth[pixels[lane] as usize];
        }
        if smooth == [true; LANES] {
            return between;
        }
        for lane in 0..LANES {
            let nearest = pixels[lane] + if fx[lane] >= 0.5 { 1 } else { 0 } + if fy[lane] >= 0.5 { width } else { 0 };
            let nearest = self.distances[nearest as usize];
            distances[lane] = if smooth[lane] { between[lane] } else { nearest };
        }
        distances
    }

    /// From a pixel to those to the right and below that there are.
    #[inline(always)]
    fn ahead(&self) -> (usize, usize) {
        let [columns, rows] = &self.window;
        (usize::from(columns.len() > 1), if rows.len() > 1 { columns.len() } else { 0 })
    }
}

/// Of some `pixels` along an axis of a picture, the first of two centres around a coordinate, and how far from it to the next; of two cells
/// that meet there, either.
fn cell(at: f64, pixels: &Range<usize>) -> (usize, f32) {
    let last = pixels.len() - 1;
    let at = (at - (pixels.start as f64 + 0.5)).clamp(0.0, last as f64);
    let first = (at as usize).min(last.saturating_sub(1));
    (first, (at - first as f64) as f32)
}

/// A whole number from 0 to 2^22.
#[inline(always)]
fn whole(number: f32) -> u32 {
    (number + INTEGER).to_bits() & MANTISSA
}

/// Columns and rows that hold all numbers but `nothing`, and one more on each side where there is one. Looked through are rows of which
/// there may be any among the numbers.
fn window(
    numbers: &[f32],
    width: usize,
    nothing: f32,
    may_be: impl Fn(Range<usize>) -> bool + Sync,
) -> [Range<usize>; 2] {
    let met = |(band, rows)| {
        let first = band * width * LOOKED_AT;
        simd::dispatch(Window { rows, width, nothing, may_be: |n| may_be(first + n * width..first + (n + 1) * width) })
    };
    let bands = numbers.par_chunks(width * LOOKED_AT).enumerate().map(met).collect::<Vec<_>>().into_iter();
    let met = bands.enumerate().filter_map(|(band, met)| {
        let ([columns, rows], above) = (met?, band * LOOKED_AT);
        Some([columns, rows.start + above..rows.end + above])
    });
    let around = |pixels: Range<usize>, size: usize| pixels.start.saturating_sub(1)..(pixels.end + 1).min(size);
    let [columns, rows] = met.reduce(both).unwrap_or_default();
    if columns.is_empty() { [0..0, 0..0] } else { [around(columns, width), around(rows, numbers.len() / width)] }
}

/// Columns and rows that hold those of two windows.
fn both([columns, rows]: [Range<usize>; 2], [others, below]: [Range<usize>; 2]) -> [Range<usize>; 2] {
    [hull(&columns, &others), hull(&rows, &below)]
}

/// The job: columns and rows that hold all numbers but `nothing` in those rows of `width` in which there `may_be` any, if there are.
struct Window<'a, F> {
    rows: &'a [f32],
    width: usize,
    nothing: f32,
    may_be: F,
}

impl<F: Fn(usize) -> bool> Kernel for Window<'_, F> {
    type Output = Option<[Range<usize>; 2]>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut met: Option<[Range<usize>; 2]> = None;
        let any = |numbers: &[f32]| {
            let mut any = false;
            for &number in numbers {
                any |= number != self.nothing;
            }
            any
        };
        for (y, row) in self.rows.chunks_exact(self.width).enumerate().filter(|(y, _)| (self.may_be)(*y)) {
            // By words, then within the first and the last.
            let Some(first) = row.chunks(WORD).position(any) else { continue };
            let last = row.chunks(WORD).rposition(any).unwrap_or(first);
            let is_met = |number: &f32| *number != self.nothing;
            let start = row[first * WORD..].iter().position(is_met).map_or(first * WORD, |n| first * WORD + n);
            let end = row[..row.len().min((last + 1) * WORD)].iter().rposition(is_met).map_or(start, |n| n + 1);
            let of_row = [start..end, y..y + 1];
            met = Some(met.map_or(of_row.clone(), |met| both(met, of_row)));
        }
        met
    }
}

fn pixels(view: &View) -> usize {
    let (width, height) = view.size();
    width as usize * height as usize
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use glam::dcamera::rh::proj::opengl::{orthographic, perspective};
    use proptest::prelude::*;

    use super::*;
    use crate::render::view::cut;
    use crate::render::{Camera, Orbit};
    use crate::volume::phantom;

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
        let camera =
            DMat4::from_rotation_x(0.3) * DMat4::from_rotation_z(0.5) * DMat4::from_translation(DVec3::splat(3.0));
        let camera = DMat4::from_translation(DVec3::new(1.0, 2.0, -30.0)) * camera;
        // Beside the middle, and with slanted rays.
        let aside = DMat4::from_translation(DVec3::new(0.2, -0.1, 0.0));
        let slanted =
            DMat4::from_cols_array(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.3, 0.1, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        for projection in [
            perspective(0.5, 19.0 / 6.0, 1.0, 100.0),
            aside * perspective(0.5, 19.0 / 6.0, 1.0, 100.0),
            orthographic(-12.0, 9.0, -4.0, 5.0, -10.0, 100.0),
            slanted * orthographic(-12.0, 9.0, -4.0, 5.0, -10.0, 100.0),
        ] {
            let view = View::new(&Camera::Matrices { view: camera, projection }, DVec3::ZERO, 10.0, 19, 6).unwrap();
            let point = |n: usize| {
                let ray = view.ray(DVec2::new((n % 19) as f64 + 0.5, (n / 19) as f64 + 0.5));
                ray.origin + ray.direction * (20.0 + n as f64 / 10.0)
            };
            let window = |n: usize| {
                let clip = projection * camera * point(n).extend(1.0);
                if n % 19 < 9 { 1.0 } else { (clip.z / clip.w * 0.5 + 0.5) as f32 }
            };
            let values: Vec<_> = (0..19 * 6).map(window).collect();
            let depth = SceneDepth::from_window(&values, Met::default(), &view, [&projection, &camera], None).unwrap();
            for (n, (distance, value)) in depth.distances().iter().zip(values).enumerate() {
                let expected = if value < 1.0 { 20.0 + n as f32 / 10.0 } else { f32::INFINITY };
                assert!((distance - expected).abs() < 1e-3 || *distance == expected, "{distance} and {expected}");
            }
            assert_eq!(depth.window, [8..19, 0..6]);
        }
        let projection = perspective(0.5, 8.0 / 6.0, 1.0, 100.0);
        let empty = SceneDepth::from_window(&[1.0; 48], Met::default(), &view(), [&projection, &camera], None).unwrap();
        assert_eq!((empty.at(3, 3), empty.between(DVec2::new(3.0, 2.0))), (f32::INFINITY, f32::INFINITY));
        assert!(empty.window.iter().all(Range::is_empty));
        let mut values = [0.5; 48];
        (values[7], values[20], values[47]) = (-0.1, f32::NAN, 1.5);
        let refused = SceneDepth::from_window(&values, Met::default(), &view(), [&projection, &camera], None);
        assert_eq!(refused, Err(NoWindowDepths(3)));
    }

    #[test]
    fn of_rays_that_pass_what_is_shown_all_is_told() {
        let volume = phantom::uniform([30, 40, 20], 1.0);
        let voxels = [4..9, 20..33, 0..20];
        let index_from_world = volume.world_from_index().inverse();
        let values = [0.5; 60 * 50];
        for projection in
            [perspective(0.9, 60.0 / 50.0, 1.0, 200.0), orthographic(-72.0, 72.0, -60.0, 60.0, 1.0, 200.0)]
        {
            for step in 0..12 {
                let turned = DMat4::from_rotation_x(f64::from(step)) * DMat4::from_rotation_z(f64::from(step) * 0.7);
                let camera = DMat4::from_translation(DVec3::new(3.0, -2.0, -60.0))
                    * turned
                    * DMat4::from_translation(-volume.centre());
                let view =
                    View::new(&Camera::Matrices { view: camera, projection }, volume.centre(), 30.0, 60, 50).unwrap();
                let [some, all] = [Some((&volume, &voxels)), None].map(|shown| {
                    SceneDepth::from_window(&values, Met::default(), &view, [&projection, &camera], shown).unwrap()
                });
                let (mut passed, mut told) = (0, 0);
                for (x, y) in (0..50).flat_map(|y| (0..60).map(move |x| (x, y))) {
                    let ray = view.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                    let [start, along] = [
                        index_from_world.transform_point3(ray.origin),
                        index_from_world.transform_vector3(ray.direction),
                    ];
                    let mut span = [f64::NEG_INFINITY, f64::INFINITY];
                    for axis in 0..3 {
                        span = cut(span, start[axis] - voxels[axis].start as f64, along[axis]);
                        span = cut(span, voxels[axis].end as f64 - 1.0 - start[axis], -along[axis]);
                    }
                    if span[0] < span[1] {
                        assert_eq!(some.at(x, y), all.at(x, y), "step {step}, pixel ({x}, {y})");
                        passed += 1;
                    }
                    told += usize::from(some.at(x, y).is_finite());
                }
                assert!(passed > 0 && told < 60 * 50, "{passed} of {told}");
            }
        }
        let nothing = [0..0, 0..0, 0..0];
        let [projection, camera] =
            [perspective(0.9, 1.2, 1.0, 200.0), DMat4::from_translation(DVec3::new(0.0, 0.0, -60.0))];
        let view = View::new(&Camera::Matrices { view: camera, projection }, DVec3::ZERO, 30.0, 60, 50).unwrap();
        let told =
            SceneDepth::from_window(&values, Met::default(), &view, [&projection, &camera], Some((&volume, &nothing)));
        assert!(told.unwrap().distances().iter().all(|distance| distance.is_infinite()));
    }

    proptest! {
        /// However it comes in pieces.
        #[test]
        fn a_depth_buffer_that_was_looked_at_while_it_came_is_the_same(
            width in 1u32..90,
            height in 1u32..20,
            nearer in prop::collection::vec((any::<prop::sample::Index>(), 0.1f32..0.9), 0..4),
            pieces in prop::collection::vec(1usize..1500, 1..9),
        ) {
            let mut values = vec![1.0f32; (width * height) as usize];
            for (at, depth) in &nearer {
                *at.get_mut(&mut values) = *depth;
            }
            let bytes: Vec<_> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            let mut met = Met::default();
            for piece in pieces.iter().scan(0, |end, piece| { *end += piece; Some(*end) }) {
                met.advance(&bytes[..piece.min(bytes.len())]);
            }
            let [camera, projection] = [DMat4::from_translation(DVec3::new(0.0, 0.0, -30.0)), orthographic(-9.0, 9.0, -9.0, 9.0, 1.0, 99.0)];
            let view = View::new(&Camera::Matrices { view: camera, projection }, DVec3::ZERO, 10.0, width, height).unwrap();
            let [watched, plain] = [met, Met::default()]
                .map(|met| SceneDepth::from_window(&values, met, &view, [&projection, &camera], None).unwrap());
            prop_assert_eq!(&watched.window, &plain.window);
            prop_assert!(watched == plain);
            prop_assert_eq!(plain.distances().iter().filter(|distance| distance.is_finite()).count(), values.iter().filter(|value| **value < 1.0).count());
        }
    }
}
