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
use std::sync::Arc;

use glam::{DMat3, DMat4, DVec2, DVec3, Vec4};
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_128;

use super::factorization::{Factorization, Meeting};
use super::view::{Rays, View};
use super::warp::inside;
use crate::volume::Volume;

/// A step between two pixels that is so many times as large as the larger of the two beside it is a tear.
const TEAR: f32 = 2.0;

/// No pixel is so far from a picture, pixels.
const BEYOND: f64 = 1e12;

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

/// Pixels of a word of masks.
const WORD: usize = 64;

/// What is seen of the rays of an intermediate image, in slices from the front one on: from where to where, but for holes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Limits {
    scanlines: Vec<Scanline>,
}

/// Of a scanline.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scanline {
    /// The same for all pixels but for those of the words from one on.
    elsewhere: Stretch,
    first_word: usize,
    words: Vec<Word>,
    /// From where to where, by pixel of these words; `from` is infinite where nothing is seen.
    from: Vec<f32>,
    to: Vec<f32>,
    /// In the order of pixels and, within one, of its ray.
    holes: Vec<Hole>,
    /// What is seen of any pixel is within `some`, and of every pixel all of `whole`.
    some: Stretch,
    whole: Stretch,
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

impl Scanline {
    /// With holes, in order, in what is seen of `pixels`, whose stretches `fill` writes; of other pixels `elsewhere` is seen, and they may be
    /// as many as it takes.
    pub(super) fn new(
        elsewhere: Stretch,
        pixels: Range<usize>,
        holes: Vec<Hole>,
        fill: impl FnOnce(&mut [f32], &mut [f32]),
    ) -> Self {
        let first_word = pixels.start / WORD;
        let words = if pixels.is_empty() { 0 } else { pixels.end.div_ceil(WORD) - first_word };
        let (mut from, mut to) = (vec![elsewhere.from; words * WORD], vec![elsewhere.to; words * WORD]);
        let filled = pixels.start - first_word * WORD..pixels.end - first_word * WORD;
        if !filled.is_empty() {
            fill(&mut from[filled.clone()], &mut to[filled]);
        }
        let of_word = |u: usize| holes.partition_point(|hole| (hole.u as usize) < u);
        let word = |(n, (from, to)): (usize, (&[f32], &[f32]))| {
            let first = (first_word + n) * WORD;
            let theirs = of_word(first)..of_word(first + WORD);
            let within = holes[theirs.clone()].iter().fold(Stretch::NOTHING, |all, Hole { stretch, .. }| Stretch {
                from: all.from.min(stretch.from),
                to: all.to.max(stretch.to),
            });
            let [[least_from, greatest_from], [least_to, greatest_to]] = [from, to].map(bounds);
            let bounds = [Stretch { from: least_from, to: least_to }, Stretch { from: greatest_from, to: greatest_to }];
            Word { bounds, holes: theirs, within }
        };
        let words: Vec<_> = from.chunks_exact(WORD).zip(to.chunks_exact(WORD)).enumerate().map(word).collect();
        let (mut some, mut whole) = (elsewhere, elsewhere);
        for Word { bounds: [least, greatest], holes, .. } in &words {
            some = Stretch { from: some.from.min(least.from), to: some.to.max(greatest.to) };
            whole = Stretch { from: whole.from.max(greatest.from), to: whole.to.min(least.to) };
            if !holes.is_empty() {
                whole = Stretch::NOTHING;
            }
        }
        Self { elsewhere, first_word, words, from, to, holes, some, whole }
    }

    /// What is seen of pixel `u`, but for holes.
    #[inline(always)]
    fn at(&self, u: usize) -> Stretch {
        let at = u.wrapping_sub(self.first_word * WORD);
        match (self.from.get(at), self.to.get(at)) {
            (Some(&from), Some(&to)) => Stretch { from, to },
            _ => self.elsewhere,
        }
    }

    /// Pixels that have stretches of their own are among these.
    fn told(&self) -> Range<usize> {
        self.first_word * WORD..(self.first_word + self.words.len()) * WORD
    }
}

impl Stretch {
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
    /// What scanlines see, so many of them.
    pub(super) fn new(height: usize, scanline: impl Fn(usize) -> Scanline + Sync + Send) -> Self {
        Self { scanlines: (0..height).into_par_iter().map(scanline).collect() }
    }

    /// True where nothing is seen at all.
    pub(super) fn is_empty(&self) -> bool {
        self.scanlines.iter().all(|scanline| scanline.some == Stretch::NOTHING)
    }

    /// What is seen of the ray of pixel (u, v), but for holes.
    #[inline(always)]
    pub fn at(&self, u: usize, v: usize) -> Stretch {
        self.scanlines[v].at(u)
    }

    /// The holes in that, one behind another.
    #[inline(always)]
    pub fn holes(&self, u: usize, v: usize) -> impl Iterator<Item = Stretch> + '_ {
        let Scanline { first_word, words, holes, .. } = &self.scanlines[v];
        let word = words.get((u / WORD).wrapping_sub(*first_word));
        let theirs = word.map_or(&[][..], |word| &holes[word.holes.clone()]).iter();
        theirs.filter(move |hole| hole.u as usize == u).map(|hole| hole.stretch)
    }

    /// Whether what lies on some scanlines between two positions is seen.
    #[inline(always)]
    pub fn meets(&self, vs: Range<usize>, between: [f32; 2]) -> Meeting {
        let (mut some, mut all) = (false, true);
        for scanline in &self.scanlines[vs] {
            some |= scanline.some.meets(between);
            all &= scanline.whole.holds(between);
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
        let scanline = &self.scanlines[v];
        let at = word.wrapping_sub(scanline.first_word);
        let every = |is: bool| if is { u64::MAX } else { 0 };
        let Some(Word { bounds: [least, greatest], holes, within }) = scanline.words.get(at) else {
            return [scanline.elsewhere.meets(between), scanline.elsewhere.holds(between)].map(every);
        };
        if !(Stretch { from: least.from, to: greatest.to }).meets(between) {
            return [0; 2];
        }
        let mut seen = [u64::MAX; 2];
        if !(Stretch { from: greatest.from, to: least.to }).holds(between) {
            seen = [0; 2];
            let [from, to] = [&scanline.from, &scanline.to].map(|ends| ends[at * WORD..][..WORD].chunks_exact(4));
            let [first, last] = between.map(Vec4::splat);
            // Four pixels of `Stretch::meets` and `Stretch::holds`.
            for (four, (from, to)) in from.zip(to).enumerate() {
                let [from, to] = [from, to].map(Vec4::from_slice);
                let meets = from.cmplt(last) & to.cmpgt(first);
                let holds = from.cmple(first) & to.cmpge(last);
                seen[0] |= u64::from(meets.bitmask()) << (4 * four);
                seen[1] |= u64::from(holds.bitmask()) << (4 * four);
            }
        }
        if within.meets(between) {
            for Hole { u, stretch } in &scanline.holes[holes.clone()] {
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
    limits: Arc<Limits>,
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
            limits: Arc::default(),
        };
        let elsewhere = Stretch { from: f32::NEG_INFINITY, to: inverse.beyond() };
        inverse.limits = Arc::new(Limits::new(factorization.size[1], |v| {
            let met = inverse.met_by(v);
            Scanline::new(elsewhere, met.clone(), vec![], |_, to| {
                for (u, to) in met.zip(to) {
                    if let Some(at) = inverse.image_point(DVec2::new(u as f64, v as f64)) {
                        *to = inverse.end_at(at);
                    }
                }
            })
        }));
        Some(inverse)
    }

    /// The pixels of scanline `v` that may meet something.
    fn met_by(&self, v: usize) -> Range<usize> {
        let Some([mut low, mut high]) = self.depth.met else { return 0..0 };
        // What touches the picture's border goes on beyond it; and a pixel around is not told apart.
        for axis in 0..2 {
            low[axis] = if low[axis] > 0.0 { low[axis] - 1.0 } else { -BEYOND };
            high[axis] = if high[axis] < self.size[axis] { high[axis] + 1.0 } else { BEYOND };
        }
        let start = self.image_from_sheared * DVec3::new(0.0, v as f64, 1.0);
        inside([low, high], start, self.image_from_sheared.x_axis, self.factorization.size[0])
    }

    /// Where rays end that go on behind the volume.
    fn beyond(&self) -> f32 {
        self.factorization.dims[2] as f32
    }

    /// Where the ray of pixel (u, v) ends, in slices from the front one on: a slice before or behind the volume at most.
    pub fn end(&self, u: usize, v: usize) -> f32 {
        self.limits.at(u, v).to
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
        let end = self.factorization.position(self.along.index(at, distance.into()));
        (end as f32).clamp(-1.0, self.beyond())
    }

    /// What is seen in front of it.
    pub fn limits(&self) -> Arc<Limits> {
        Arc::clone(&self.limits)
    }

    /// The pixels u of scanline v, but for the last ones, where what ends the rays is torn among those from (u, v) to (u + 1, v + 1): by more
    /// than `least` slices.
    pub fn torn(&self, v: usize, least: f32) -> impl Iterator<Item = usize> {
        let [width, height] = self.factorization.size;
        // Of -1, 0, 1, 2 scanlines from that one on.
        let rows = [0, 1, 2, 3].map(|n| &self.limits.scanlines[(v + n).saturating_sub(1).min(height - 1)]);
        let [_, upper, lower, _] = rows;
        let met = [upper.told(), lower.told()].into_iter().filter(|told| !told.is_empty());
        let (first, end) = met.fold((width, 0), |(first, end), met| (first.min(met.start), end.max(met.end)));
        let cells = first.saturating_sub(1)..end.min(width - 1);
        let apart = cells.filter(move |&u| {
            let [low, high] = bounds(&[upper.at(u), upper.at(u + 1), lower.at(u), lower.at(u + 1)].map(|at| at.to));
            high - low > least
        });
        apart.filter(move |u| {
            let get = |du: usize, row: usize| rows[row].at((u + du).saturating_sub(1).min(width - 1)).to;
            let row = |n: usize| goes_on([0, 1, 2, 3].map(|m| get(m, n)));
            let column = |n: usize| goes_on([0, 1, 2, 3].map(|m| get(n, m)));
            !(row(1) && row(2) && column(1) && column(2))
        })
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

/// The least and the greatest of some numbers.
#[inline(always)]
fn bounds(numbers: &[f32]) -> [f32; 2] {
    let (mut least, mut greatest) = (numbers[0], numbers[0]);
    for &number in numbers {
        least = if number < least { number } else { least };
        greatest = if number > greatest { number } else { greatest };
    }
    [least, greatest]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::render::{Camera, Orbit, Projection};
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
                    let warp = InverseWarp::of(&view, &volume, &factorization).unwrap();
                    let [width, height] = factorization.size;
                    let mut met = 0;
                    for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
                        let at = warp.image_point(DVec2::new(u as f64, v as f64));
                        let end = at.map_or(warp.beyond(), |at| warp.end_at(at));
                        assert_eq!(warp.end(u, v), end, "{projection:?} pixel ({u}, {v})");
                        met += usize::from(end < warp.beyond());
                    }
                    assert!(met > 0 && met < width * height / 2, "{met}");
                }
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
