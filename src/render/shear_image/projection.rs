//! Intensity projections along a packet: the largest, the smallest or the mean scalar.
//!
//! Nothing is classified, so what can be skipped are leaves of the octree whose range cannot change
//! what a ray has found: below its maximum, above its minimum, or of one scalar throughout.
//! Interpolated scalars can leave their voxels' range by a rounding error, so a leaf is passed over
//! only where its range is half a code from mattering: skipping changes no bit.
//!
//! With a segmentation a sample counts where the label of the voxel next to it shows anything. The half of a slab
//! that is closer to a sample is that one's.

use glam::Vec4;

use super::packet::Packet;
use super::sampler::Sampler;
use super::skip::Skip;
use super::{Frame, Pixels};
use crate::classify::labels::Labels;
use crate::render::{IntensityProjection, RenderError, Scene, Timings, Window};
use crate::simd::wide::{LANES, Lanes, Wide};
use crate::volume::gradient::Code;
use crate::volume::octree::{MinMaxOctree, Range};

/// A frame of a projection, shown through `window`.
pub(super) fn frame<T: Code>(
    codes: &[T],
    scene: &Scene<'_>,
    frame: &Frame<'_>,
    which: IntensityProjection,
    window: Window,
) -> Result<(Vec<Vec4>, Timings), RenderError> {
    let volume = scene.prepared.volume();
    let (slope, intercept) = volume.rescale();
    let black = window.center - window.width / 2.0;
    let walk = Walk {
        sampler: Sampler::new(codes, volume.dims()),
        // Of a mean, what of the ray counts matters everywhere.
        octree: (frame.settings.skipping && !(scene.labels.is_some() && which == IntensityProjection::Average))
            .then(|| scene.prepared.octree()),
        labels: scene.labels,
        skip: Skip::nothing(volume.dims()),
        steps: frame.settings.preintegration.samples_per_voxel,
        scale: (slope / window.width) as f32,
        offset: ((intercept - black) / window.width) as f32,
    };
    match which {
        IntensityProjection::Maximum => frame.render(&Project { walk: &walk, reduce: Maximum(volume.code_range().1) }),
        IntensityProjection::Minimum => frame.render(&Project { walk: &walk, reduce: Minimum(volume.code_range().0) }),
        IntensityProjection::Average => frame.render(&Project { walk: &walk, reduce: Average }),
    }
}

/// How packets walk, whatever is looked for.
struct Walk<'a, T> {
    sampler: Sampler<'a, T>,
    /// `None`: nothing is skipped.
    octree: Option<&'a MinMaxOctree>,
    labels: Option<Labels<'a>>,
    skip: Skip<'a>,
    /// Slabs from a slice of voxels to the next.
    steps: usize,
    /// Gray = code * scale + offset.
    scale: f32,
    offset: f32,
}

/// What is kept of a ray's scalars.
trait Reduce: Sync {
    /// Before the first scalar.
    const START: f32;

    /// After a slab between two scalars, of a length in slices.
    fn add(&self, found: f32, front: f32, back: f32, length: f32) -> f32;

    /// True where slabs within `range` may leave `found` other than without them.
    fn matters(&self, range: &Range, found: f32) -> bool;

    /// True where nothing further can change what was found.
    fn is_done(&self, found: f32) -> bool;

    /// The code to show after a ray of a length.
    fn code(&self, found: f32, length: f32) -> f32;
}

/// What eight rays have found.
struct Found {
    code: Lanes,
    /// Slices that counted, where that is not all of the ray.
    length: Lanes,
}

/// A code's half: more than any rounding error.
const MARGIN: f32 = 0.5;

/// With the volume's largest code.
struct Maximum(u16);

impl Reduce for Maximum {
    const START: f32 = f32::NEG_INFINITY;

    #[inline(always)]
    fn add(&self, found: f32, front: f32, back: f32, _: f32) -> f32 {
        found.max(front).max(back).min(f32::from(self.0))
    }

    #[inline(always)]
    fn matters(&self, range: &Range, found: f32) -> bool {
        f32::from(range.code.1) + MARGIN > found
    }

    #[inline(always)]
    fn is_done(&self, found: f32) -> bool {
        found >= f32::from(self.0)
    }

    #[inline(always)]
    fn code(&self, found: f32, _: f32) -> f32 {
        found
    }
}

/// With the volume's smallest code.
struct Minimum(u16);

impl Reduce for Minimum {
    const START: f32 = f32::INFINITY;

    #[inline(always)]
    fn add(&self, found: f32, front: f32, back: f32, _: f32) -> f32 {
        found.min(front).min(back).max(f32::from(self.0))
    }

    #[inline(always)]
    fn matters(&self, range: &Range, found: f32) -> bool {
        f32::from(range.code.0) - MARGIN < found
    }

    #[inline(always)]
    fn is_done(&self, found: f32) -> bool {
        found <= f32::from(self.0)
    }

    #[inline(always)]
    fn code(&self, found: f32, _: f32) -> f32 {
        found
    }
}

struct Average;

impl Reduce for Average {
    const START: f32 = 0.0;

    #[inline(always)]
    fn add(&self, found: f32, front: f32, back: f32, length: f32) -> f32 {
        found + 0.5 * (front + back) * length
    }

    /// Zeros add nothing.
    #[inline(always)]
    fn matters(&self, range: &Range, _: f32) -> bool {
        range.code != (0, 0)
    }

    #[inline(always)]
    fn is_done(&self, _: f32) -> bool {
        false
    }

    #[inline(always)]
    fn code(&self, found: f32, length: f32) -> f32 {
        found / length
    }
}

/// The kernel.
struct Project<'a, T, R> {
    walk: &'a Walk<'a, T>,
    reduce: R,
}

impl<T: Code, R: Reduce> Pixels for Project<'_, T, R> {
    type Buffers = ();

    #[inline(always)]
    fn pixels<W: Wide>(&self, tile: &[Packet], (): &mut (), out: &mut [[Vec4; LANES]]) {
        for (packet, out) in tile.iter().zip(out) {
            *out = self.packet(packet);
        }
    }
}

impl<T: Code, R: Reduce> Project<'_, T, R> {
    /// The pixels of a packet.
    #[inline(always)]
    fn packet(&self, packet: &Packet) -> [Vec4; LANES] {
        let Walk { sampler, steps, scale, offset, .. } = self.walk;
        let hits = packet.hits();
        let mut open = hits;
        let mut found = Found { code: [R::START; LANES], length: [0.0; LANES] };
        let (enter, leave) = packet.span();
        let inside = packet.inside(hits);
        let end = (leave.ceil() as usize).min(sampler.dims()[packet.axis] - 1);
        let step = 1.0 / *steps as f32;
        let mut front = [0.0; LANES];
        let (mut layer, mut reached) = (enter.floor() as usize, usize::MAX);
        while open != 0 {
            layer = self.next_layer(packet, layer, end, open, &found.code);
            if layer >= end {
                break;
            }
            if layer != reached {
                front = sampler.on_slice(packet, layer);
            }
            for n in 1..=*steps {
                let back = if n == *steps {
                    sampler.on_slice(packet, layer + 1)
                } else {
                    sampler.between(packet, layer, n as f32 * step)
                };
                let span = [layer as f32 + (n - 1) as f32 * step, layer as f32 + n as f32 * step];
                if span[0] < inside.0 || span[1] > inside.1 || self.walk.labels.is_some() {
                    self.ray_by_ray(packet, open, span, &front, &back, &mut found);
                } else {
                    for lane in 0..LANES {
                        let added = self.reduce.add(found.code[lane], front[lane], back[lane], span[1] - span[0]);
                        found.code[lane] = if open >> lane & 1 == 1 { added } else { found.code[lane] };
                    }
                }
                front = back;
            }
            open &= !(0..LANES).fold(0, |done, lane| done | u32::from(self.reduce.is_done(found.code[lane])) << lane);
            layer += 1;
            reached = layer;
        }
        std::array::from_fn(|lane| {
            let length = match self.walk.labels {
                None => packet.leave[lane] - packet.enter[lane],
                Some(_) => found.length[lane],
            };
            if hits >> lane & 1 == 0 || length <= 0.0 {
                return Vec4::ZERO;
            }
            let code = self.reduce.code(found.code[lane], length);
            Vec4::splat((code * scale + offset).clamp(0.0, 1.0)).with_w(1.0)
        })
    }
}

impl<T: Code, R: Reduce> Project<'_, T, R> {
    /// The first layer from `layer` on whose leaves matter to an open lane.
    #[inline(always)]
    fn next_layer(&self, packet: &Packet, mut layer: usize, end: usize, open: u32, found: &Lanes) -> usize {
        let Some(octree) = self.walk.octree else { return layer };
        let skip = &self.walk.skip;
        while layer < end {
            let leaf_end = skip.leaf_end(packet, layer).min(end);
            let touched = skip.leaves(packet, layer, leaf_end);
            for j in 0..touched.counts[1] {
                for i in 0..touched.counts[0] {
                    let range = octree.leaf(touched.at(i, j));
                    for lane in 0..LANES {
                        if open >> lane & 1 == 1 && self.reduce.matters(range, found[lane]) {
                            return layer;
                        }
                    }
                }
            }
            layer = leaf_end;
        }
        end
    }

    /// Slabs some of which are cut by an end of their ray, or of which counts what labels show.
    #[inline(never)]
    fn ray_by_ray(
        &self,
        packet: &Packet,
        open: u32,
        [from, to]: [f32; 2],
        front: &Lanes,
        back: &Lanes,
        found: &mut Found,
    ) {
        let Walk { sampler, labels, .. } = self.walk;
        for lane in (0..LANES).filter(|lane| open >> lane & 1 == 1) {
            let (enter, leave) = (packet.enter[lane].max(from), packet.leave[lane].min(to));
            if enter >= leave {
                continue;
            }
            let at = |t: f32, whole: f32, on_slice: f32| {
                if t == whole { on_slice } else { sampler.scalar(sampler.position(packet, lane, t)) }
            };
            let (front, back) = (at(enter, from, front[lane]), at(leave, to, back[lane]));
            let shows =
                |t| labels.is_none_or(|labels| labels.shows(sampler.nearest_voxel(sampler.position(packet, lane, t))));
            let (front, back, length) = match (shows(enter), shows(leave)) {
                (true, true) => (front, back, leave - enter),
                (true, false) => (front, front, 0.5 * (leave - enter)),
                (false, true) => (back, back, 0.5 * (leave - enter)),
                (false, false) => continue,
            };
            found.code[lane] = self.reduce.add(found.code[lane], front, back, length);
            found.length[lane] += length;
        }
    }
}
