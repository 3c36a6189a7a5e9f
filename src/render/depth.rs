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
//! ([`Factorization::left`]). Rays in image order ask the buffer itself.

use std::fmt;
use std::ops::Range;

use glam::{DMat3, DMat4, DVec2, DVec3};
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_128;

use super::factorization::{Factorization, Meeting};
use super::view::{Rays, View};
use crate::volume::Volume;

/// A step between two pixels that is so many times as large as the larger of the two beside it is a tear.
const TEAR: f32 = 2.0;

/// Shorter steps, mm, are none: rounding of depth buffers.
const FLAT: f32 = 1e-3;

/// Where each pixel's ray meets opaque geometry.
#[derive(Clone, PartialEq)]
pub struct SceneDepth {
    width: usize,
    height: usize,
    /// mm along the rays from their origins, row by row from the top; infinite where they meet nothing.
    distances: Vec<f32>,
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
        Self { width, height, distances, hash }
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
            let pixel = DVec2::new((at % width as usize) as f64 + 0.5, (at / width as usize) as f64 + 0.5);
            let clip = DVec3::new(
                2.0 * pixel.x / f64::from(width) - 1.0,
                1.0 - 2.0 * pixel.y / f64::from(height),
                2.0 * f64::from(value) - 1.0,
            );
            let ray = view.ray(pixel);
            (world_from_clip.project_point3(clip) - ray.origin).dot(ray.direction) as f32
        };
        Self::new(view, values.par_iter().enumerate().map(distance).collect())
    }

    /// The distance of a pixel, mm.
    #[inline(always)]
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.distances[y * self.width + x]
    }

    /// The distance at pixel coordinates (centres at halves), which may be beyond the picture.
    fn between(&self, at: DVec2) -> f32 {
        let last = [self.width as isize - 1, self.height as isize - 1];
        let get = |x: isize, y: isize| self.at(x.clamp(0, last[0]) as usize, y.clamp(0, last[1]) as usize);
        let at = at - 0.5;
        let (x, y) = (at.x.floor(), at.y.floor());
        let (fx, fy) = ((at.x - x) as f32, (at.y - y) as f32);
        let (x, y) = (x as isize, y as isize);
        // Most of many pictures is empty.
        if [get(x, y), get(x + 1, y), get(x, y + 1), get(x + 1, y + 1)] == [f32::INFINITY; 4] {
            return f32::INFINITY;
        }
        let row = |y: isize| goes_on([-1, 0, 1, 2].map(|n| get(x + n, y)));
        let column = |x: isize| goes_on([-1, 0, 1, 2].map(|n| get(x, y + n)));
        if row(y) && row(y + 1) && column(x) && column(x + 1) {
            let upper = get(x, y) + (get(x + 1, y) - get(x, y)) * fx;
            let lower = get(x, y + 1) + (get(x + 1, y + 1) - get(x, y + 1)) * fx;
            upper + (lower - upper) * fy
        } else {
            get(x + isize::from(fx >= 0.5), y + isize::from(fy >= 0.5))
        }
    }
}

/// Whether a surface goes on between the middle two of four neighbours.
fn goes_on([before, a, b, after]: [f32; 4]) -> bool {
    let beside = (a - before).abs().max((after - b).abs());
    (b - a).abs() <= TEAR * beside + FLAT && a.is_finite() && b.is_finite()
}

/// Pixels of a word of masks.
const WORD: usize = 64;

/// What is seen of the rays of an intermediate image, in slices from the front one on: from where to where, but for holes.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    width: usize,
    /// By pixel; `from` is infinite where nothing is seen.
    stretches: Vec<Stretch>,
    /// By scanline, in the order of pixels and, within one, of its ray.
    holes: Vec<Vec<Hole>>,
    /// By scanline and 64 pixels.
    words: Vec<Word>,
    /// By scanline.
    summaries: Vec<Summary>,
}

/// From where to where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    pub from: f32,
    pub to: f32,
}

/// A part of a pixel's stretch of which nothing is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hole {
    pub u: u32,
    pub stretch: Stretch,
}

/// What is the same for 64 pixels.
#[derive(Clone, Debug, PartialEq)]
struct Word {
    /// The least and the greatest of each end of their stretches.
    bounds: [Stretch; 2],
    /// Which of the scanline's holes are theirs, and the stretch that these are within.
    holes: Range<usize>,
    within: Stretch,
}

/// What is the same for a scanline: what is seen of any pixel is within `some`, and of every pixel all of `whole`.
#[derive(Clone, Debug, PartialEq)]
struct Summary {
    some: Stretch,
    whole: Stretch,
}

impl Summary {
    fn new(words: &[Word]) -> Self {
        let (mut some, mut whole) = (Stretch::NOTHING, Stretch::ALL);
        for Word { bounds: [least, greatest], holes, .. } in words {
            some = Stretch { from: some.from.min(least.from), to: some.to.max(greatest.to) };
            whole = Stretch { from: whole.from.max(greatest.from), to: whole.to.min(least.to) };
            if !holes.is_empty() {
                whole = Stretch::NOTHING;
            }
        }
        Self { some, whole }
    }
}

impl Stretch {
    const ALL: Self = Self { from: f32::NEG_INFINITY, to: f32::INFINITY };
    pub(super) const NOTHING: Self = Self { from: f32::INFINITY, to: f32::NEG_INFINITY };

    /// Whether some of it lies between two positions.
    #[inline(always)]
    pub(super) fn meets(&self, [first, last]: [f32; 2]) -> bool {
        self.from < last && self.to > first
    }

    /// Whether all that lies between two positions is of it.
    #[inline(always)]
    pub(super) fn holds(&self, [first, last]: [f32; 2]) -> bool {
        self.from <= first && self.to >= last
    }
}

impl Limits {
    /// What scanlines see, told by a function that fills one: v, pixels that are [`Stretch::NOTHING`], and the holes in what they
    /// become, in order.
    pub(super) fn new(
        [width, height]: [usize; 2],
        scanline: impl Fn(usize, &mut [Stretch], &mut Vec<Hole>) + Sync,
    ) -> Self {
        let mut stretches = vec![Stretch::NOTHING; width * height];
        let filled = stretches.par_chunks_mut(width).enumerate().map(|(v, row)| {
            let mut holes = vec![];
            scanline(v, row, &mut holes);
            let of_word = |u: u32| holes.partition_point(|hole| hole.u < u);
            let word = |(n, row): (usize, &[Stretch])| {
                let theirs = of_word((n * WORD) as u32)..of_word(((n + 1) * WORD) as u32);
                let within = holes[theirs.clone()].iter().fold(Stretch::NOTHING, |all, Hole { stretch, .. }| Stretch {
                    from: all.from.min(stretch.from),
                    to: all.to.max(stretch.to),
                });
                Word { bounds: bounds(row), holes: theirs, within }
            };
            let words: Vec<_> = row.chunks(WORD).enumerate().map(word).collect();
            (holes, words)
        });
        let (holes, words): (Vec<_>, Vec<_>) = filled.unzip();
        let summaries = words.iter().map(|words| Summary::new(words)).collect();
        Self { width, stretches, holes, words: words.into_iter().flatten().collect(), summaries }
    }

    /// True where nothing is seen at all.
    pub(super) fn is_empty(&self) -> bool {
        self.words.iter().all(|Word { bounds: [least, greatest], .. }| {
            least.from == f32::INFINITY && greatest.to == f32::NEG_INFINITY
        })
    }

    /// What is seen of the ray of pixel (u, v), but for holes.
    #[inline(always)]
    pub fn at(&self, u: usize, v: usize) -> Stretch {
        self.stretches[v * self.width + u]
    }

    /// The holes in that, one behind another.
    #[inline(always)]
    pub fn holes(&self, u: usize, v: usize) -> impl Iterator<Item = Stretch> + '_ {
        let word = &self.words[v * self.width.div_ceil(WORD) + u / WORD];
        let theirs = self.holes[v][word.holes.clone()].iter().filter(move |hole| hole.u as usize == u);
        theirs.map(|hole| hole.stretch)
    }

    /// Whether what lies on some scanlines between two positions is seen.
    #[inline(always)]
    pub fn meets(&self, vs: Range<usize>, between: [f32; 2]) -> Meeting {
        let (mut some, mut all) = (false, true);
        for summary in &self.summaries[vs] {
            some |= summary.some.meets(between);
            all &= summary.whole.holds(between);
        }
        if all {
            Meeting::Inside
        } else if some {
            Meeting::Across
        } else {
            Meeting::Outside
        }
    }

    /// Of the 64 pixels of `word` of scanline `v`, those of which something is seen between two positions, and those of which
    /// all is.
    #[inline(always)]
    pub fn seen(&self, v: usize, word: usize, between: [f32; 2]) -> [u64; 2] {
        let Word { bounds: [least, greatest], holes, within } = &self.words[v * self.width.div_ceil(WORD) + word];
        if !(Stretch { from: least.from, to: greatest.to }).meets(between) {
            return [0; 2];
        }
        let mut seen = [u64::MAX; 2];
        if !(Stretch { from: greatest.from, to: least.to }).holds(between) {
            seen = [0; 2];
            let row = &self.stretches[v * self.width..][..self.width];
            for (at, stretch) in row[word * WORD..].iter().take(WORD).enumerate() {
                seen[0] |= u64::from(stretch.meets(between)) << at;
                seen[1] |= u64::from(stretch.holds(between)) << at;
            }
        }
        if within.meets(between) {
            for Hole { u, stretch } in &self.holes[v][holes.clone()] {
                let pixel = 1 << (*u as usize % WORD);
                if stretch.holds(between) {
                    seen[0] &= !pixel;
                }
                if stretch.meets(between) {
                    seen[1] &= !pixel;
                }
            }
        }
        seen
    }
}

/// The inverse warp of a depth buffer: what of it the pixels of an intermediate image meet.
#[derive(Debug)]
pub struct InverseWarp<'a> {
    depth: &'a SceneDepth,
    factorization: &'a Factorization,
    image_from_sheared: DMat3,
    along: AlongRays,
    size: DVec2,
    /// By pixel of the intermediate image.
    ends: Vec<f32>,
}

impl<'a> InverseWarp<'a> {
    /// `None` where the view has no depth buffer.
    pub fn of(view: &'a View, volume: &Volume, factorization: &'a Factorization) -> Option<Self> {
        let depth = view.depth()?;
        let mut inverse = Self {
            depth,
            factorization,
            image_from_sheared: factorization.sheared_from_image.inverse(),
            along: AlongRays::new(view, volume, factorization),
            size: DVec2::new(depth.width as f64, depth.height as f64),
            ends: vec![],
        };
        let [width, height] = factorization.size;
        let end = |at: usize| match inverse.image_point(DVec2::new((at % width) as f64, (at / width) as f64)) {
            Some(at) => inverse.end_at(at.clamp(DVec2::ZERO, inverse.size)) as f32,
            None => f32::INFINITY,
        };
        inverse.ends = (0..width * height).into_par_iter().map(end).collect();
        Some(inverse)
    }

    /// Where the ray of pixel (u, v) ends, in slices from the front one on; infinite where it goes on.
    pub fn end(&self, u: usize, v: usize) -> f32 {
        self.ends[v * self.factorization.size[0] + u]
    }

    /// The final image's coordinates of a place on the intermediate one; `None` where that is behind the eye.
    pub fn image_point(&self, sheared: DVec2) -> Option<DVec2> {
        let homogeneous = self.image_from_sheared * sheared.extend(1.0);
        (homogeneous.z > 0.0).then(|| homogeneous.truncate() / homogeneous.z)
    }

    /// Where the ray through a point of the final image ends.
    pub fn end_at(&self, at: DVec2) -> f64 {
        let distance = self.depth.between(at);
        if !distance.is_finite() {
            return f64::INFINITY;
        }
        self.factorization.position(self.along.index(at, distance.into()))
    }

    /// What is seen in front of it.
    pub fn limits(&self) -> Limits {
        Limits::new(self.factorization.size, |v, row, _| {
            for (u, stretch) in row.iter_mut().enumerate() {
                *stretch = Stretch { to: self.end(u, v), ..Stretch::ALL };
            }
        })
    }

    /// Whether what ends the rays is torn among the pixels from (u, v) to (u + 1, v + 1), both on the image. What lies beyond the
    /// volume is not told apart.
    pub fn is_torn(&self, u: usize, v: usize) -> bool {
        let [width, height] = self.factorization.size;
        let [a, b] = [0, 1].map(|du| self.within_volume(self.end(u + du, v)));
        let [c, d] = [0, 1].map(|du| self.within_volume(self.end(u + du, v + 1)));
        if [b - a, d - c, c - a, d - b].iter().all(|step| step.abs() <= FLAT) {
            return false;
        }
        let get = |du: usize, dv: usize| {
            // Of -1, 0, 1, 2 from the first pixel on.
            let at = |first: usize, n: usize, size: usize| (first + n).saturating_sub(1).min(size - 1);
            self.within_volume(self.end(at(u, du, width), at(v, dv, height)))
        };
        let row = |n: usize| goes_on([0, 1, 2, 3].map(|m| get(m, n)));
        let column = |n: usize| goes_on([0, 1, 2, 3].map(|m| get(n, m)));
        !(row(1) && row(2) && column(1) && column(2))
    }

    /// An end, or a slice beyond the volume where it is farther away than that.
    pub fn within_volume(&self, end: f32) -> f32 {
        end.clamp(-1.0, self.factorization.dims[2] as f32)
    }
}

/// Where points along the rays of a view are along a volume's principal axis, in voxels.
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
        let point = |p| index_from_world.transform_point3(p)[axis];
        let vector = |v| index_from_world.transform_vector3(v)[axis];
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

    /// Of the point at a distance (mm) along the ray of pixel coordinates.
    fn index(&self, at: DVec2, distance: f64) -> f64 {
        let told = self.corner + self.dx * at.x + self.dy * at.y;
        match self.rays {
            Rays::Parallel { .. } => told + self.other * distance,
            Rays::Perspective { corner, dx, dy, .. } => {
                self.other + told * (distance / (corner + dx * at.x + dy * at.y).length())
            }
        }
    }
}

/// The least and the greatest of some stretches.
fn bounds(stretches: &[Stretch]) -> [Stretch; 2] {
    let (mut least, mut greatest) = (stretches[0], stretches[0]);
    for stretch in stretches {
        least = Stretch { from: least.from.min(stretch.from), to: least.to.min(stretch.to) };
        greatest = Stretch { from: greatest.from.max(stretch.from), to: greatest.to.max(stretch.to) };
    }
    [least, greatest]
}

#[cfg(test)]
mod tests {
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
