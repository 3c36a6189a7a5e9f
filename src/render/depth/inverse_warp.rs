//! The inverse warp of a depth buffer (Bruckner et al. 2003), read backwards.

use std::array;
use std::iter::from_fn;
use std::ops::Range;
use std::sync::Arc;

use glam::{DMat3, DVec2, DVec3};

use super::{Limits, SceneDepth, SeenScanline, goes_on};
use crate::render::factorization::Factorization;
use crate::render::ranges::{common, hull};
use crate::render::view::{Rays, View};
use crate::render::warp::inside;
use crate::simd::masks::{Masks, WORD};
#[cfg(target_arch = "x86_64")]
use crate::simd::wide::Avx2;
use crate::simd::wide::{LANES, Lanes, Portable, Wide, least, most};
use crate::simd::{self, Kernel};
use crate::volume::Volume;

/// No pixel is so far from a picture, pixels.
const BEYOND: f64 = 1e12;

/// The inverse warp of a depth buffer: what of it the pixels of an intermediate image meet.
#[derive(Debug)]
pub struct InverseWarp<'a> {
    depth: &'a SceneDepth,
    factorization: &'a Factorization,
    image_from_sheared: DMat3,
    along: AlongRays,
    size: DVec2,
    /// Pixels along u and v beside which nothing shows.
    shown: [Range<usize>; 2],
    limits: Arc<Limits>,
}

impl<'a> InverseWarp<'a> {
    /// `None` where the view has no depth buffer. Of pixels beside those `shown` along u and v nothing is told: their rays do not end.
    pub fn of(
        view: &'a View,
        volume: &Volume,
        factorization: &'a Factorization,
        shown: [Range<usize>; 2],
    ) -> Option<Self> {
        let depth = view.depth()?;
        let mut inverse = Self {
            depth,
            factorization,
            image_from_sheared: factorization.sheared_from_image.inverse(),
            along: AlongRays::new(view, volume, factorization),
            size: DVec2::new(depth.width as f64, depth.height as f64),
            shown,
            limits: Arc::default(),
        };
        let [_, told] = &inverse.shown;
        let others = SeenScanline::ending(inverse.beyond(), 0..0, |_| {});
        inverse.limits = Arc::new(Limits::new(factorization.size[1], told.clone(), others, |v| {
            let met = inverse.met_by(v);
            SeenScanline::ending(inverse.beyond(), met.clone(), |to| {
                simd::dispatch(Ends { inverse: &inverse, v, first: met.start, to });
            })
        }));
        Some(inverse)
    }

    /// The pixels of scanline `v`, one of those that show something, that may meet something, and show something.
    fn met_by(&self, v: usize) -> Range<usize> {
        let window = &self.depth.window;
        let [us, _] = &self.shown;
        if window.iter().any(Range::is_empty) {
            return 0..0;
        }
        let (mut low, mut high) = (DVec2::ZERO, DVec2::ZERO);
        // What touches the picture's border goes on beyond it.
        for axis in 0..2 {
            let Range { start, end } = window[axis];
            low[axis] = if start > 0 { start as f64 } else { -BEYOND };
            high[axis] = if (end as f64) < self.size[axis] { end as f64 } else { BEYOND };
        }
        let start = self.image_from_sheared * DVec3::new(0.0, v as f64, 1.0);
        let met = inside([low, high], start, self.image_from_sheared.x_axis, self.factorization.size[0]);
        common(&met, us)
    }

    /// Where rays end that go on behind the volume.
    fn beyond(&self) -> f32 {
        self.factorization.dims[2] as f32
    }

    /// Where the ray of pixel (u, v) ends, in slices from the front one on: a slice before or behind the volume at most.
    pub fn end(&self, u: usize, v: usize) -> f32 {
        self.limits.at(u, v).to
    }

    /// The scanlines with rays that may end.
    pub fn may_hold_ends(&self) -> Range<usize> {
        self.limits.told()
    }

    /// The pixels of scanline `v` with rays that may end.
    pub fn may_end(&self, v: usize) -> Range<usize> {
        let Range { start, end } = self.limits.scanline(v).told();
        start..end.min(self.factorization.size[0])
    }

    /// The final image's coordinates of a place on the intermediate one; `None` where that is behind the eye.
    #[inline(always)]
    pub fn image_point(&self, sheared: DVec2) -> Option<DVec2> {
        let homogeneous = self.image_from_sheared * sheared.extend(1.0);
        if self.factorization.is_parallel() {
            return Some(homogeneous.truncate());
        }
        (homogeneous.z > 0.0).then(|| homogeneous.truncate() / homogeneous.z)
    }

    /// Where the ray through a point of the final image ends, as [`Self::end`] tells it.
    #[inline(always)]
    pub fn end_at(&self, at: DVec2) -> f32 {
        let at = at.clamp(DVec2::ZERO, self.size);
        let distance = self.depth.between(at);
        if distance == f32::INFINITY {
            return self.beyond();
        }
        let end = self.along.position(at, distance.into());
        (end as f32).clamp(-1.0, self.beyond())
    }

    /// The same as [`Self::image_point`] and [`Self::end_at`] tell for the pixels of scanline `v` from `u` on, side by side and but for
    /// rounding: of places on the picture and along the rays, to single precision.
    #[inline(always)]
    fn ends<W: Wide>(&self, u: usize, v: usize) -> Lanes {
        let m = &self.image_from_sheared;
        let first = *m * DVec3::new(u as f64, v as f64, 1.0);
        let of_lanes = |axis: usize| -> Lanes {
            let (first, step) = (first[axis] as f32, m.x_axis[axis] as f32);
            array::from_fn(|lane| first + step * lane as f32)
        };
        let (mut x, mut y, mut z) = (of_lanes(0), of_lanes(1), [1.0; LANES]);
        if !self.factorization.is_parallel() {
            z = of_lanes(2);
            for lane in 0..LANES {
                (x[lane], y[lane]) = (x[lane] / z[lane], y[lane] / z[lane]);
            }
        }
        for (at, size) in [(&mut x, self.size.x as f32), (&mut y, self.size.y as f32)] {
            for at in at {
                *at = most(least(*at, size), 0.0);
            }
        }
        let distances = self.depth.between_all::<W>(&x, &y);
        let along = self.along.positions(&x, &y, &distances);
        let beyond = self.beyond();
        let mut ends = [beyond; LANES];
        for lane in 0..LANES {
            // Behind the eye there is nothing, nor where rays meet nothing.
            let ends_here = (along[lane] < beyond) & (z[lane] > 0.0) & (distances[lane] < f32::INFINITY);
            ends[lane] = if ends_here { most(along[lane], -1.0) } else { beyond };
        }
        ends
    }

    /// What is seen in front of it.
    pub fn limits(&self) -> Arc<Limits> {
        Arc::clone(&self.limits)
    }

    /// The pixels u of scanline v, some of `us` and but for the last ones, where what ends the rays is torn among those from (u, v) to
    /// (u + 1, v + 1): by more than `least` slices.
    pub fn torn(&self, v: usize, us: Range<usize>, least: f32) -> impl Iterator<Item = usize> {
        let [width, height] = self.factorization.size;
        // Of -1, 0, 1, 2 scanlines from that one on.
        let rows = [0, 1, 2, 3].map(|n| self.limits.scanline((v + n).saturating_sub(1).min(height - 1)));
        let [_, upper, lower, _] = rows;
        let met = hull(&upper.told(), &lower.told());
        let cells = us.start.max(met.start.saturating_sub(1))..us.end.min(met.end).min(width - 1);
        let last = cells.end;
        cells.step_by(WORD).flat_map(move |first| {
            let mut torn = simd::dispatch(Torn { rows, width, first, least });
            let of_word = from_fn(move || {
                let n = torn.trailing_zeros() as usize;
                torn &= torn.wrapping_sub(1);
                (n < WORD).then_some(first + n)
            });
            of_word.take_while(move |u| *u < last)
        })
    }
}

/// The job: where the rays of pixels of scanline `v` end, from one on.
struct Ends<'a, 'b> {
    inverse: &'b InverseWarp<'a>,
    v: usize,
    first: usize,
    to: &'b mut [f32],
}

impl Kernel for Ends<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.fill::<Portable>();
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) {
        self.fill::<Avx2>();
    }
}

impl Ends<'_, '_> {
    #[inline(always)]
    fn fill<W: Wide>(self) {
        let Self { inverse, v, first, to } = self;
        let (eights, rest) = to.as_chunks_mut();
        let last = first + eights.len() * LANES;
        for (n, to) in eights.iter_mut().enumerate() {
            *to = inverse.ends::<W>(first + n * LANES, v);
        }
        if !rest.is_empty() {
            rest.copy_from_slice(&inverse.ends::<W>(last, v)[..rest.len()]);
        }
    }
}

/// The job: at which of 64 pixels of a scanline, from one on, what ends the rays is torn between that, the next and the two below.
struct Torn<'a> {
    /// The one before the scanline, that, and the two below it.
    rows: [&'a SeenScanline; 4],
    width: usize,
    first: usize,
    least: f32,
}

impl Kernel for Torn<'_> {
    type Output = u64;

    #[inline(always)]
    fn run(self) -> u64 {
        self.find::<Portable>()
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) -> u64 {
        self.find::<Avx2>()
    }
}

impl Torn<'_> {
    #[inline(always)]
    fn find<W: Masks>(self) -> u64 {
        // With a pixel before the first and two behind the last.
        let mut ends = [[0.0; WORD + 3]; 4];
        for row in [1, 2] {
            self.ends(row, &mut ends[row]);
        }
        let mut spans = [0.0; WORD];
        for n in 0..WORD {
            let [a, b, c, d] = [ends[1][n + 1], ends[1][n + 2], ends[2][n + 1], ends[2][n + 2]];
            spans[n] = most(most(a, b), most(c, d)) - least(least(a, b), least(c, d));
        }
        let [together, _] = W::numbers(&spans, self.least, self.least);
        if together == u64::MAX {
            return 0;
        }
        for row in [0, 3] {
            self.ends(row, &mut ends[row]);
        }
        let mut columns = [false; WORD + 3];
        for n in 0..WORD + 3 {
            columns[n] = goes_on(ends[0][n], ends[1][n], ends[2][n], ends[3][n]);
        }
        // 1 where a surface goes on along both rows and both columns.
        let mut on = [0.0; WORD];
        for n in 0..WORD {
            let [upper, lower] = [&ends[1], &ends[2]];
            let rows = goes_on(upper[n], upper[n + 1], upper[n + 2], upper[n + 3])
                & goes_on(lower[n], lower[n + 1], lower[n + 2], lower[n + 3]);
            on[n] = f32::from(u8::from(rows & columns[n + 1] & columns[n + 2]));
        }
        let [torn, _] = W::numbers(&on, 0.0, 0.0);
        torn & !together
    }

    /// Finds where rays end on one of the scanlines; beyond the image it is as on its border.
    #[inline(always)]
    fn ends(&self, row: usize, ends: &mut [f32; WORD + 3]) {
        let before = usize::from(self.first == 0);
        self.rows[row].ends(self.first + before - 1, &mut ends[before..]);
        if before == 1 {
            ends[0] = ends[1];
        }
        let last = self.width - self.first;
        if last < WORD + 2 {
            let border = ends[last];
            ends[last + 1..].fill(border);
        }
    }
}

/// Where points along the rays of a view are, in slices from the front one on.
#[derive(Clone, Copy, Debug)]
struct AlongRays {
    rays: Rays,
    /// Of the point or direction that a ray is told by at pixel (0, 0), and from a pixel to the next along x and y.
    corner: f64,
    dx: f64,
    dy: f64,
    /// Of a millimetre along parallel rays, or of the eye.
    other: f64,
}

impl AlongRays {
    fn new(view: &View, volume: &Volume, factorization: &Factorization) -> Self {
        let index_from_world = volume.world_from_index().inverse();
        let axis = factorization.principal_axis;
        let point = |p| factorization.position(index_from_world.transform_point3(p)[axis]);
        let vector =
            |v| factorization.position(index_from_world.transform_vector3(v)[axis]) - factorization.position(0.0);
        let rays = *view.rays();
        match rays {
            Rays::Parallel { corner, dx, dy, direction } => {
                Self { rays, corner: point(corner), dx: vector(dx), dy: vector(dy), other: vector(direction) }
            }
            Rays::Perspective { eye, corner, dx, dy } => {
                Self { rays, corner: vector(corner), dx: vector(dx), dy: vector(dy), other: point(eye) }
            }
        }
    }

    /// [`Self::position`] side by side.
    #[inline(always)]
    fn positions(&self, x: &Lanes, y: &Lanes, distances: &Lanes) -> Lanes {
        let [corner, dx, dy, other] = [self.corner, self.dx, self.dy, self.other].map(|number| number as f32);
        let mut positions = [0.0; LANES];
        for lane in 0..LANES {
            positions[lane] = corner + dx * x[lane] + dy * y[lane];
        }
        match self.rays {
            Rays::Parallel { .. } => {
                for lane in 0..LANES {
                    positions[lane] += other * distances[lane];
                }
            }
            Rays::Perspective { corner, dx, dy, .. } => {
                let [corner, dx, dy] = [corner, dx, dy].map(DVec3::as_vec3);
                for lane in 0..LANES {
                    let along = |axis: usize| corner[axis] + dx[axis] * x[lane] + dy[axis] * y[lane];
                    let ray = [along(0), along(1), along(2)];
                    let length = (ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]).sqrt();
                    positions[lane] = other + positions[lane] * (distances[lane] / length);
                }
            }
        }
        positions
    }

    /// Of the point at a distance (mm) along the ray of pixel coordinates.
    fn position(&self, at: DVec2, distance: f64) -> f64 {
        let told = self.corner + self.dx * at.x + self.dy * at.y;
        match self.rays {
            Rays::Parallel { .. } => told + self.other * distance,
            Rays::Perspective { corner, dx, dy, .. } => {
                self.other + told * (distance / (corner + dx * at.x + dy * at.y).length())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{Camera, Orbit, Projection};
    use crate::volume::phantom;

    /// Told of all pixels of a word at once, and of each by those around it.
    #[test]
    fn what_is_torn_is_told_alike_pixel_by_pixel() {
        let volume = phantom::uniform([150, 90, 40], 1.0);
        for (azimuth, elevation) in [(20.0, 15.0), (90.0, 0.0), (200.0, -70.0)] {
            let orbit = Orbit { azimuth, elevation, ..Orbit::default() };
            let view = View::new(&Camera::Orbit(orbit), volume.centre(), volume.radius(), 90, 80).unwrap();
            // A ball before a slope before nothing.
            let distance = |n: usize| {
                let (x, y) = ((n % 90) as f64, (n / 90) as f64);
                let ray = view.ray(DVec2::new(x + 0.5, y + 0.5));
                let middle = (volume.centre() - ray.origin).dot(ray.direction);
                let ball = 400.0 - (x - 40.0).powi(2) - (y - 30.0).powi(2);
                let behind = if y < 60.0 { x - 20.0 } else { f64::INFINITY };
                (middle + if ball > 0.0 { -ball.sqrt() - 10.0 } else { behind }) as f32
            };
            let view = view.clone().ending_at(Arc::new(SceneDepth::new(&view, (0..90 * 80).map(distance).collect())));
            for factorization in Factorization::parts(&view, &volume).unwrap() {
                let all = factorization.size.map(|size| 0..size);
                let warp = InverseWarp::of(&view, &volume, &factorization, all).unwrap();
                let [width, height] = factorization.size;
                let mut count = 0;
                for v in 0..height - 1 {
                    let end = |u: usize, v: usize| {
                        warp.end(u.saturating_sub(1).min(width - 1), v.saturating_sub(1).min(height - 1))
                    };
                    let is_torn = |u: &usize| {
                        let ends: [[f32; 4]; 4] =
                            array::from_fn(|row| array::from_fn(|column| end(u + column, v + row)));
                        let inner = [ends[1][1], ends[1][2], ends[2][1], ends[2][2]];
                        let span = inner.iter().fold(f32::MIN, |a, b| a.max(*b))
                            - inner.iter().fold(f32::MAX, |a, b| a.min(*b));
                        let row = |n: usize| goes_on(ends[n][0], ends[n][1], ends[n][2], ends[n][3]);
                        let column = |n: usize| goes_on(ends[0][n], ends[1][n], ends[2][n], ends[3][n]);
                        span > 1.0 && !(row(1) && row(2) && column(1) && column(2))
                    };
                    let expected: Vec<_> = (0..width - 1).filter(is_torn).collect();
                    assert_eq!(warp.torn(v, 0..width, 1.0).collect::<Vec<_>>(), expected, "scanline {v}");
                    count += expected.len();
                }
                assert!(count > 50 && count < width * height / 4, "{count} of {width} x {height}");
            }
        }
    }

    #[test]
    fn rays_that_may_meet_something_are_all_that_do() {
        let volume = phantom::head();
        for (projection, azimuth, elevation) in [
            (Projection::Parallel, 20.0, 15.0),
            (Projection::Parallel, 100.0, 70.0),
            (Projection::Perspective, 200.0, -30.0),
        ] {
            let orbit = Orbit { projection, azimuth, elevation, zoom: 1.5, ..Orbit::default() };
            let view = View::new(&Camera::Orbit(orbit), volume.centre(), volume.radius(), 60, 50).unwrap();
            // A patch within the picture, one on its border, and a pixel alone.
            for (xs, ys) in [(20..31, 10..25), (50..60, 0..9), (7..8, 40..41)] {
                let mut distances = vec![f32::INFINITY; 60 * 50];
                for (y, x) in ys.flat_map(|y| xs.clone().map(move |x| (y, x))) {
                    let ray = view.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                    distances[60 * y + x] = ((volume.centre() - ray.origin).dot(ray.direction) + x as f64 / 7.0) as f32;
                }
                let view = view.clone().ending_at(Arc::new(SceneDepth::new(&view, distances)));
                for factorization in Factorization::parts(&view, &volume).unwrap() {
                    let all = factorization.size.map(|size| 0..size);
                    let warp = InverseWarp::of(&view, &volume, &factorization, all).unwrap();
                    let [width, height] = factorization.size;
                    let mut met = 0;
                    for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
                        let at = warp.image_point(DVec2::new(u as f64, v as f64));
                        let end = at.map_or(warp.beyond(), |at| warp.end_at(at));
                        let off = (warp.end(u, v) - end).abs();
                        assert!(off < 1e-3, "{projection:?} pixel ({u}, {v}): {} for {end}", warp.end(u, v));
                        met += usize::from(end < warp.beyond());
                    }
                    assert!(met > 0 && met < width * height / 2, "{met}");
                    // Beside pixels that show something no ray ends, and over them as before.
                    let shown = [width / 3..width / 2, height / 4..height / 2];
                    let part = InverseWarp::of(&view, &volume, &factorization, shown.clone()).unwrap();
                    for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
                        let is_shown = shown[0].contains(&u) && shown[1].contains(&v);
                        let end = if is_shown { warp.end(u, v) } else { warp.beyond() };
                        assert!((part.end(u, v) - end).abs() < 1e-3, "{projection:?} pixel ({u}, {v})");
                    }
                }
            }
        }
    }
}
