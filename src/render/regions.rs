//! Focus and context: convex regions that are shown in another way than the volume around them, or not at all.
//!
//! Bruckner, Schmalstieg, Hauser and Gröller 2003 keep the depths of a convex shape's front and back faces for each pixel and
//! choose, sample by sample, what the kernel does inside and outside. Here a ray is cut where it enters and leaves the shapes,
//! and each of its pieces belongs to the last region that holds it, or to the volume around. Pieces that are shown alike make
//! a layer: a pass of its own, from which all else is left out, by the kernel that there is. So no kernel knows of regions, and
//! what is skipped is skipped exactly.
//!
//! Layers are blended ray by ray: in the intermediate image, or in the picture where its pixels have rays of their own. Blended
//! after the warp, the rims of two layers that are seen side by side would each cover a pixel in part, one over the other, and let
//! the background through.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

use glam::{DAffine3, DVec2, DVec3, Vec4};
use rayon::prelude::*;

use super::depth::{InverseWarp, Limits, Stretch};
use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::view::{Clip, cut};
use super::{Cancel, Image, RenderError, Scene, Settings, Timings, View, image, rays, shear_warp};
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

/// Which pieces of rays make a layer; in the order in which layers are blended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Which {
    /// Pieces before it, along a ray.
    before: u8,
    /// The region that they lie in; `None`: in none.
    within: Option<u8>,
}

/// What is shown in the pieces of a layer.
pub(super) fn shown<'a>(
    which: Which,
    around: (&'a Scene<'a>, &'a Settings),
    regions: &'a [Region<'_>],
) -> Option<(&'a Scene<'a>, &'a Settings)> {
    match which.within {
        None => Some(around),
        Some(region) => regions[usize::from(region)].shown.as_ref().map(|(scene, settings)| (scene, *settings)),
    }
}

/// Cuts a span of `start + t step` where regions begin and end. The pieces follow each other without a gap.
fn pieces(
    shapes: &[Clip],
    start: DVec3,
    step: DVec3,
    [enter, leave]: [f64; 2],
    mut found: impl FnMut(Which, [f64; 2]),
) {
    const NOTHING: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];
    if enter >= leave {
        return;
    }
    let mut inside = [NOTHING; MAX_REGIONS];
    let mut ends = [leave; 2 * MAX_REGIONS + 1];
    let mut count = 0;
    for (inside, shape) in inside.iter_mut().zip(shapes) {
        let span = shape.span(start, step, [enter, leave]);
        if span[0] < span[1] {
            *inside = span;
            ends[count..count + 2].copy_from_slice(&span);
            count += 2;
        }
    }
    ends[..count].sort_unstable_by(f64::total_cmp);
    // Pieces end where the region that holds them does, not where another's shape is passed within it.
    let mut piece: Option<(Which, [f64; 2])> = None;
    let mut at = enter;
    for &end in ends[..=count].iter().filter(|end| **end > enter) {
        if end <= at {
            continue;
        }
        let within = inside.iter().rposition(|span| span[0] <= at && end <= span[1]).map(|region| region as u8);
        piece = Some(match piece {
            Some((which, [from, _])) if which.within == within => (which, [from, end]),
            Some((which, span)) => {
                found(which, span);
                (Which { before: which.before + 1, within }, [at, end])
            }
            None => (Which { before: 0, within }, [at, end]),
        });
        at = end;
    }
    if let Some((which, span)) = piece {
        found(which, span);
    }
}

/// The pieces of a picture's rays that make one layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// In the order of the regions; of two that hold a point the later one is meant.
    shapes: Arc<[Clip]>,
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
        let mut found = [f64::INFINITY, f64::NEG_INFINITY];
        pieces(&self.shapes, start, step, span, |which, span| {
            if which == self.which {
                found = span;
            }
        });
        found
    }
}

/// The pieces of the rays of an intermediate image.
pub(super) struct Layers {
    size: [usize; 2],
    /// By scanline: the pixel, and what is seen there.
    pieces: Vec<Vec<(u32, Which, Stretch)>>,
}

impl Layers {
    /// Rays end where `depth` says.
    pub fn new(
        volume: &Volume,
        factorization: &Factorization,
        depth: Option<&InverseWarp<'_>>,
        shapes: &[Clip],
    ) -> Self {
        let world_from_voxel = factorization.world_from_voxel(volume);
        let shapes: Vec<_> = shapes.iter().map(|shape| shape.told_by(world_from_voxel)).collect();
        let [width, height] = factorization.size;
        let last = factorization.layers() as f64 + 1.0;
        let scanline = |v: usize| {
            let mut found = Vec::with_capacity(width);
            for u in 0..width {
                // Slices behind the front one: an eye among the slices may have passed that.
                let [first, second] = [1.0, 2.0].map(|position| {
                    factorization.voxel_from_sheared(u as f64, v as f64, factorization.along(position))
                });
                let step = second - first;
                let start = first - step;
                // Pixels beside the volume's outermost voxels show something of them.
                let mut span = [if factorization.start > 0.0 { factorization.start } else { -1.0 }, last];
                for axis in 0..2 {
                    span = cut(span, start[axis] + 1.0, step[axis]);
                    span = cut(span, factorization.dims[axis] as f64 - start[axis], -step[axis]);
                }
                let [enter, leave] = span;
                let end = depth.map_or(f64::INFINITY, |depth| depth.end(u, v));
                pieces(&shapes, start, step, [enter, leave.min(end)], |which, [from, to]| {
                    let from = if from > enter { from as f32 } else { f32::NEG_INFINITY };
                    let to = if to < leave { to as f32 } else { f32::INFINITY };
                    found.push((u as u32, which, Stretch { from, to }));
                });
            }
            found
        };
        Self { size: factorization.size, pieces: (0..height).into_par_iter().map(scanline).collect() }
    }

    /// The layers there are, front to back.
    pub fn which(&self) -> BTreeSet<Which> {
        let of_scanline = |pieces: &Vec<(u32, Which, Stretch)>| pieces.iter().map(|(_, which, _)| *which).collect();
        self.pieces.par_iter().map(of_scanline).reduce(BTreeSet::new, |mut all: BTreeSet<_>, some| {
            all.extend(some);
            all
        })
    }

    /// What is seen of a layer behind an image: nothing where that is as opaque as `termination`.
    pub fn limits(&self, which: Which, image: &IntermediateImage, termination: f32) -> Limits {
        Limits::new(self.size, |v, row| {
            for &(u, piece, stretch) in &self.pieces[v] {
                let u = u as usize;
                if piece == which && image.opacity(u, v) < termination {
                    row[u] = stretch;
                }
            }
        })
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
    let mut looks = regions.iter().filter_map(|region| region.shown).map(|(_, settings)| settings);
    if settings.is_warped() && looks.all(Settings::is_warped) {
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
    let shapes: Arc<[Clip]> = regions.iter().map(|region| region.shape.clone()).collect();
    let (width, height) = view.size();
    let mut pixels = vec![Vec4::ZERO; width as usize * height as usize];
    let mut timings = Timings { shade: start.elapsed(), ..Timings::default() };
    for which in which(view, scene.prepared.volume(), &shapes) {
        let Some((scene, settings)) = shown(which, (scene, settings), regions) else { continue };
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
fn which(view: &View, volume: &Volume, shapes: &[Clip]) -> BTreeSet<Which> {
    let index_from_world = volume.world_from_index().inverse();
    let (width, height) = view.size();
    let row = |y: u32| {
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
            pieces(shapes, ray.origin, ray.direction, span, |which, _| {
                found.insert(which);
            });
        }
        found
    };
    (0..height).into_par_iter().map(row).reduce(BTreeSet::new, |mut all, some| {
        all.extend(some);
        all
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{Ball, HalfSpace};

    fn ball(at: f64, radius: f64) -> Clip {
        Clip { balls: vec![Ball::new(DVec3::X * at, radius)], halves: vec![] }
    }

    /// Pieces along x, and the regions that they lie in.
    fn pieces(shapes: &[Clip]) -> Vec<(Option<usize>, [f64; 2])> {
        let mut found = vec![];
        super::pieces(shapes, DVec3::X * -20.0, DVec3::X, [0.0, 40.0], |which, span| {
            assert_eq!(usize::from(which.before), found.len());
            found.push((which.within.map(usize::from), span.map(|at| ((at - 20.0) * 1e6).round() / 1e6)));
        });
        found
    }

    #[test]
    fn pieces_follow_each_other_and_belong_to_the_last_region_that_holds_them() {
        let around = |pieces: &[(Option<usize>, [f64; 2])]| {
            assert_eq!((pieces[0].1[0], pieces.last().unwrap().1[1]), (-20.0, 20.0));
            assert!(pieces.windows(2).all(|pair| pair[0].1[1] == pair[1].1[0]), "{pieces:?}");
        };
        for shapes in [
            vec![ball(0.0, 5.0)],
            vec![ball(0.0, 5.0), ball(0.0, 2.0)],
            vec![ball(-3.0, 5.0), ball(3.0, 5.0)],
            vec![ball(0.0, 2.0), ball(0.0, 5.0)],
            vec![ball(-9.0, 2.0), ball(9.0, 3.0), Clip::default()],
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
        let half = Clip { halves: vec![HalfSpace { normal: DVec3::X, offset: -3.0 }], balls: vec![] };
        assert_eq!(pieces(&[half]), [(None, [-20.0, 3.0]), (Some(0), [3.0, 20.0])]);
    }
}
