//! Focus and context: convex regions that are shown in another way than the volume around them, or not at all.
//!
//! Bruckner, Schmalstieg, Hauser and Gröller 2003 keep the depths of a convex shape's front and back faces for each pixel and
//! choose, sample by sample, what the kernel does inside and outside. Here a ray is cut where it enters and leaves the shapes,
//! and each of its pieces belongs to the last region that holds it, or to the volume around. A piece of each ray that looks the
//! same, and has as many others before it, make a layer: a pass of its own, from which all else is left out, by the kernel that
//! there is. So no kernel knows of regions, and what is skipped is skipped exactly. Where nothing is shown in a region, pieces before
//! and behind it are one, with a hole: cutting something out takes no pass more.
//!
//! Layers are blended ray by ray: in the intermediate image, or in the picture where its pixels have rays of their own. Blended
//! after the warp, the rims of two layers that are seen side by side would each cover a pixel in part, one over the other, and let
//! the background through.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use glam::{DAffine3, DVec2, DVec3, Vec4};
use rayon::prelude::*;

use super::depth::{Hole, InverseWarp, Limits, SeenScanline, Stretch};
use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::ranges::{common, hull};
use super::view::{Clip, cut};
use super::{Cancel, Image, RenderError, Scene, Settings, Timings, View, awake, image, rays, shear_warp};
use crate::volume::Volume;

/// Regions at most.
pub const MAX_REGIONS: usize = 20;

/// A convex part of the world.
#[derive(Clone, Debug)]
pub struct Region<'a> {
    /// World mm.
    pub shape: Clip,
    /// What is in it, of the same volume; `None`: nothing. Algorithm, quality and background are those of the frame.
    pub shown: Option<(Scene<'a>, &'a Settings)>,
}

/// A region's shape, and whether anything is shown in it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shape {
    clip: Clip,
    is_shown: bool,
}

impl Shape {
    /// The shapes of regions.
    pub fn of(regions: &[Region<'_>]) -> Vec<Self> {
        regions.iter().map(|region| Self { clip: region.shape.clone(), is_shown: region.shown.is_some() }).collect()
    }

    /// The same where points are told by other coordinates.
    fn told_by(&self, space_from_other: DAffine3) -> Self {
        Self { clip: self.clip.told_by(space_from_other), ..*self }
    }
}

/// Which pieces of rays make a layer; in the order in which layers are blended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Which {
    /// Pieces of other looks before it, along a ray.
    before: u8,
    /// The region that they lie in; `None`: in none.
    pub within: Option<u8>,
}

impl Which {
    /// What is before all regions.
    const AROUND: Self = Self { before: 0, within: None };
}

/// What is shown in the pieces of a layer.
pub(super) fn shown<'a>(
    which: Which,
    around: (&'a Scene<'a>, &'a Settings),
    regions: &'a [Region<'_>],
) -> (&'a Scene<'a>, &'a Settings) {
    which.within.map_or(around, |region| {
        let (scene, settings) = regions[usize::from(region)].shown.as_ref().expect("layers are of what is shown");
        (scene, settings)
    })
}

/// Cuts a span of `start + t step` where regions begin and end: the pieces that are shown, front to back, and the regions that
/// they lie in.
fn pieces(
    shapes: &[Shape],
    start: DVec3,
    step: DVec3,
    [enter, leave]: [f64; 2],
    mut found: impl FnMut(Option<u8>, [f64; 2]),
) {
    const NOTHING: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];
    if enter >= leave {
        return;
    }
    let mut inside = [NOTHING; MAX_REGIONS];
    let mut ends = [leave; 2 * MAX_REGIONS + 1];
    let mut count = 0;
    for (inside, shape) in inside.iter_mut().zip(shapes) {
        let span = shape.clip.span(start, step, [enter, leave]);
        if span[0] < span[1] {
            *inside = span;
            ends[count..count + 2].copy_from_slice(&span);
            count += 2;
        }
    }
    if count == 0 {
        found(None, [enter, leave]);
        return;
    }
    ends[..count].sort_unstable_by(f64::total_cmp);
    // Pieces end where the region that holds them does, not where another's shape is passed within it.
    let mut piece: Option<(Option<u8>, [f64; 2])> = None;
    let mut at = enter;
    for &end in ends[..=count].iter().filter(|end| **end > enter) {
        if end <= at {
            continue;
        }
        let within = inside.iter().rposition(|span| span[0] <= at && end <= span[1]).map(|region| region as u8);
        match &mut piece {
            Some((same, span)) if *same == within && span[1] == at => span[1] = end,
            _ if within.is_none_or(|region| shapes[usize::from(region)].is_shown) => {
                if let Some((within, span)) = piece.replace((within, [at, end])) {
                    found(within, span);
                }
            }
            _ => {}
        }
        at = end;
    }
    if let Some((within, span)) = piece {
        found(within, span);
    }
}

/// The pieces of a picture's rays that make one layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// In the order of the regions; of two that hold a point the later one is meant.
    shapes: Arc<[Shape]>,
    which: Which,
}

impl Layer {
    /// The same where points are told by other coordinates.
    pub fn told_by(&self, space_from_other: DAffine3) -> Self {
        Self { shapes: self.shapes.iter().map(|shape| shape.told_by(space_from_other)).collect(), which: self.which }
    }

    /// What of a span of `start + t step`, within the volume, belongs to the layer; it ends before it begins where that is
    /// nothing.
    pub fn span(&self, start: DVec3, step: DVec3, span: [f64; 2]) -> [f64; 2] {
        let mut of_layer = [f64::INFINITY, f64::NEG_INFINITY];
        each_layer(&self.shapes, start, step, span, |which, span| {
            if which == self.which {
                of_layer = span;
            }
        });
        of_layer
    }
}

/// The pieces of a ray without holes, and the layers that they are of.
fn each_layer(shapes: &[Shape], start: DVec3, step: DVec3, span: [f64; 2], mut found: impl FnMut(Which, [f64; 2])) {
    let mut before = 0;
    pieces(shapes, start, step, span, |within, span| {
        found(Which { before, within }, span);
        before += 1;
    });
}

/// The pieces of the rays of an intermediate image.
pub(super) struct Layers {
    scanlines: Vec<Scanline>,
    width: usize,
}

/// What is seen of its rays, front to back.
struct Scanline {
    /// Of other pixels' rays all is, and lies in no region.
    told: Range<usize>,
    /// Of these, the pixel and what is seen there but for holes.
    pieces: Vec<(u32, Which, Stretch)>,
    holes: Vec<(Which, Hole)>,
}

impl Layers {
    /// Rays end where `depth` says; of pixels beside some along u and v nothing shows.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`].
    pub fn new(
        volume: &Volume,
        factorization: &Factorization,
        [us, vs]: &[Range<usize>; 2],
        depth: Option<&InverseWarp<'_>>,
        shapes: &[Shape],
        cancel: &Cancel,
    ) -> Result<Self, RenderError> {
        let world_from_voxel = factorization.world_from_voxel(volume);
        let shapes: Vec<_> = shapes.iter().map(|shape| shape.told_by(world_from_voxel)).collect();
        let [width, height] = factorization.size;
        let met = factorization.pixels_that_meet(shapes.iter().map(|shape| &shape.clip));
        let last = factorization.layers() as f64 + 1.0;
        let scanline = |v: usize| {
            if cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            let told = hull(&met[v], &depth.map_or(0..0, |depth| depth.may_end(v)));
            let told = if vs.contains(&v) { common(&told, us) } else { 0..0 };
            let mut found = Scanline { pieces: Vec::with_capacity(told.len()), holes: vec![], told };
            // Slices behind the front one: an eye among the slices may have passed that.
            let [[first, first_step], [second, second_step]] = [1.0, 2.0].map(|position| {
                let k = factorization.along(position);
                let [at, next] = [0.0, 1.0].map(|u| factorization.voxel_from_sheared(u, v as f64, k));
                [at, next - at]
            });
            for u in found.told.clone() {
                let [first, second] = [first + first_step * u as f64, second + second_step * u as f64];
                let step = second - first;
                let start = first - step;
                // Pixels beside the volume's outermost voxels show something of them.
                let mut span = [if factorization.start > 0.0 { factorization.start } else { -1.0 }, last];
                for axis in 0..2 {
                    span = cut(span, start[axis] + 1.0, step[axis]);
                    span = cut(span, factorization.dims[axis] as f64 - start[axis], -step[axis]);
                }
                let [enter, leave] = span;
                let end = depth.map_or(f64::INFINITY, |depth| depth.end(u, v).into());
                let before = found.pieces.len();
                pieces(&shapes, start, step, [enter, leave.min(end)], |within, [from, to]| {
                    let from = if from > enter { from as f32 } else { f32::NEG_INFINITY };
                    let to = if to < leave { to as f32 } else { f32::INFINITY };
                    found.add(before, u as u32, within, Stretch { from, to });
                });
            }
            Ok(found)
        };
        let scanlines = (0..height).into_par_iter().map(scanline).collect::<Result<_, _>>()?;
        Ok(Self { scanlines, width })
    }

    /// The layers there are, front to back.
    pub fn which(&self) -> BTreeSet<Which> {
        let of_scanline = |scanline: &Scanline| {
            // Neighbours are mostly of the same.
            let changes = scanline.pieces.chunk_by(|a, b| a.1 == b.1);
            let others = (scanline.told.len() < self.width).then_some(Which::AROUND);
            changes.map(|pieces| pieces[0].1).chain(others).collect::<BTreeSet<_>>()
        };
        self.scanlines
            .par_iter()
            .map(of_scanline)
            .reduce(BTreeSet::new, |all, some| all.union(&some).copied().collect())
    }

    /// What is seen of a layer behind an image: nothing where that is as opaque as `termination`.
    pub fn limits(&self, which: Which, image: &IntermediateImage, termination: f32) -> Limits {
        Limits::new(self.scanlines.len(), 0..self.scanlines.len(), SeenScanline::default(), |v| {
            let Scanline { told, pieces, holes } = &self.scanlines[v];
            let seen =
                pieces.iter().filter(|piece| piece.1 == which && image.opacity(piece.0 as usize, v) < termination);
            let seen: Vec<_> = seen.collect();
            let (elsewhere, pixels) = match &seen[..] {
                // Nothing is in front of it.
                _ if which == Which::AROUND => (Stretch::ALL, told.clone()),
                [] => (Stretch::NOTHING, 0..0),
                [first, .., last] | [first @ last] => (Stretch::NOTHING, first.0 as usize..last.0 as usize + 1),
            };
            let holes = holes.iter().filter(|(of, _)| *of == which).map(|(_, hole)| *hole).collect();
            SeenScanline::new(elsewhere, pixels.clone(), holes, |from, to| {
                from.fill(Stretch::NOTHING.from);
                to.fill(Stretch::NOTHING.to);
                for &&(u, _, stretch) in &seen {
                    let at = u as usize - pixels.start;
                    (from[at], to[at]) = (stretch.from, stretch.to);
                }
            })
        })
    }
}

impl Scanline {
    /// The next piece of the ray of pixel `u`, whose pieces begin with the one at `first`. Behind one that looks the same, with
    /// nothing else between the two, it belongs to that.
    fn add(&mut self, first: usize, u: u32, within: Option<u8>, stretch: Stretch) {
        if let Some((_, which, last)) = self.pieces[first..].last_mut()
            && which.within == within
        {
            let hole = Stretch { from: last.to, to: stretch.from };
            self.holes.push((*which, Hole { u, stretch: hole }));
            last.to = stretch.to;
            return;
        }
        let which = Which { before: (self.pieces.len() - first) as u8, within };
        self.pieces.push((u, which, stretch));
    }
}

/// A frame of a volume with regions.
///
/// # Errors
/// As [`super::render`].
///
/// # Panics
/// With more than [`MAX_REGIONS`], and where regions ask for another kind of classification than the frame's: with
/// [`super::Algorithm::Classified`] and [`super::Algorithm::FastClassification`] all are composited, or none.
pub fn render_with_regions(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    regions: &[Region<'_>],
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    assert!(regions.len() <= MAX_REGIONS);
    let _frame = awake::Frame::begin();
    let mut looks = regions.iter().filter_map(|region| region.shown).map(|(_, settings)| settings);
    let painted = scene.is_painted();
    if settings.is_warped(painted) && looks.all(|settings| settings.is_warped(painted)) {
        return shear_warp::frame(scene, view, settings, regions, cancel);
    }
    let start = Instant::now();
    let (pixels, timings) = if regions.is_empty() {
        rays(scene, view, settings, cancel)?
    } else {
        layered(scene, view, settings, regions, cancel)?
    };
    let (width, height) = view.size();
    let image = image::write(&pixels, &settings.background, width, height);
    Ok((image, Timings { render: start.elapsed(), ..timings }))
}

/// The pixels of rays of their own.
fn layered(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    regions: &[Region<'_>],
    cancel: &Cancel,
) -> Result<(Vec<Vec4>, Timings), RenderError> {
    let start = Instant::now();
    let shapes: Arc<[Shape]> = Shape::of(regions).into();
    let layers = which(view, scene.prepared.volume(), &shapes, cancel)?;
    let (width, height) = view.size();
    let mut pixels = vec![Vec4::ZERO; width as usize * height as usize];
    let mut timings = Timings { shade: start.elapsed(), ..Timings::default() };
    for which in layers {
        let (scene, settings) = shown(which, (scene, settings), regions);
        let view = view.clone().of_layer(Arc::new(Layer { shapes: Arc::clone(&shapes), which }));
        let (layer, took) = rays(scene, &view, settings, cancel)?;
        pixels.par_iter_mut().zip(layer).for_each(|(front, behind)| *front += behind * (1.0 - front.w));
        timings.preintegration_table += took.preintegration_table;
        timings.shade += took.shade;
        timings.composite += took.composite;
    }
    Ok((pixels, timings))
}

/// The layers that there are among the rays of a picture.
fn which(view: &View, volume: &Volume, shapes: &[Shape], cancel: &Cancel) -> Result<BTreeSet<Which>, RenderError> {
    let index_from_world = volume.world_from_index().inverse();
    let (width, height) = view.size();
    let row = |y: u32| {
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        let mut found = BTreeSet::new();
        for x in 0..width {
            let ray = view.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
            let start = index_from_world.transform_point3(ray.origin);
            let step = index_from_world.transform_vector3(ray.direction);
            let mut span = [view.nearest(), f64::INFINITY];
            for axis in 0..3 {
                span = cut(span, start[axis], step[axis]);
                span = cut(span, (volume.dims()[axis] - 1) as f64 - start[axis], -step[axis]);
            }
            let span = view.clip().span(ray.origin, ray.direction, span);
            each_layer(shapes, ray.origin, ray.direction, span, |which, _| {
                found.insert(which);
            });
        }
        Ok(found)
    };
    (0..height).into_par_iter().map(row).try_reduce(BTreeSet::new, |all, some| Ok(all.union(&some).copied().collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{Ball, HalfSpace};

    fn ball(at: f64, radius: f64) -> Shape {
        let clip = Clip { balls: vec![Ball::new(DVec3::X * at, radius)], halves: vec![] };
        Shape { clip, is_shown: true }
    }

    fn cut_out(at: f64, radius: f64) -> Shape {
        Shape { is_shown: false, ..ball(at, radius) }
    }

    /// Pieces along x, and the regions that they lie in.
    fn pieces(shapes: &[Shape]) -> Vec<(Option<u8>, [f64; 2])> {
        let mut found = vec![];
        super::pieces(shapes, DVec3::X * -20.0, DVec3::X, [0.0, 40.0], |within, span| {
            found.push((within, span.map(|at| ((at - 20.0) * 1e6).round() / 1e6)));
        });
        found
    }

    #[test]
    fn pieces_follow_each_other_and_belong_to_the_last_region_that_holds_them() {
        let around = |pieces: &[(Option<u8>, [f64; 2])]| {
            assert_eq!((pieces[0].1[0], pieces.last().unwrap().1[1]), (-20.0, 20.0));
            assert!(pieces.windows(2).all(|pair| pair[0].1[1] == pair[1].1[0]), "{pieces:?}");
        };
        let all = Shape { clip: Clip::default(), is_shown: true };
        for shapes in [
            vec![ball(0.0, 5.0)],
            vec![ball(0.0, 5.0), ball(0.0, 2.0)],
            vec![ball(-3.0, 5.0), ball(3.0, 5.0)],
            vec![ball(0.0, 2.0), ball(0.0, 5.0)],
            vec![ball(-9.0, 2.0), ball(9.0, 3.0), all],
        ] {
            around(&pieces(&shapes));
        }
        assert_eq!(
            pieces(&[ball(0.0, 5.0), ball(0.0, 2.0)]),
            [
                (None, [-20.0, -5.0]),
                (Some(0), [-5.0, -2.0]),
                (Some(1), [-2.0, 2.0]),
                (Some(0), [2.0, 5.0]),
                (None, [5.0, 20.0])
            ]
        );
        // The later one hides the earlier one whole.
        assert_eq!(
            pieces(&[ball(0.0, 2.0), ball(0.0, 5.0)]),
            [(None, [-20.0, -5.0]), (Some(1), [-5.0, 5.0]), (None, [5.0, 20.0])]
        );
        let clip = Clip { halves: vec![HalfSpace { normal: DVec3::X, offset: -3.0 }], balls: vec![] };
        let half = Shape { clip, is_shown: true };
        assert_eq!(pieces(&[half]), [(None, [-20.0, 3.0]), (Some(0), [3.0, 20.0])]);
    }

    #[test]
    fn what_is_cut_out_leaves_gaps() {
        // Two that overlap are one gap.
        let shapes = [cut_out(-3.0, 3.5), cut_out(2.0, 2.0), ball(9.0, 3.0), cut_out(9.0, 1.0)];
        assert_eq!(
            pieces(&shapes),
            [
                (None, [-20.0, -6.5]),
                (None, [4.0, 6.0]),
                (Some(2), [6.0, 8.0]),
                (Some(2), [10.0, 12.0]),
                (None, [12.0, 20.0])
            ]
        );
        assert_eq!(pieces(&[cut_out(0.0, 30.0)]), []);
        // Pieces that look the same are of one layer.
        let mut scanline = Scanline { told: 0..0, pieces: vec![], holes: vec![] };
        for (within, span) in pieces(&shapes) {
            let [from, to] = span.map(|at| at as f32);
            scanline.add(0, 7, within, Stretch { from, to });
        }
        let of_layer = |before, within, from, to| (7, Which { before, within }, Stretch { from, to });
        let layers = [of_layer(0, None, -20.0, 6.0), of_layer(1, Some(2), 6.0, 12.0), of_layer(2, None, 12.0, 20.0)];
        assert_eq!(scanline.pieces, layers);
        let holes = scanline.holes.iter().map(|(which, hole)| (hole.u, *which, hole.stretch));
        assert!(holes.eq([of_layer(0, None, -6.5, 4.0), of_layer(1, Some(2), 8.0, 10.0)]));
    }
}
