//! Rays in index space, eight pixels of a row at a time: the lanes of a 256-bit register.
//!
//! A ray is told by where it meets the slices: along the principal axis it advances by one index a
//! slice, along the other two by its slopes. Slices are counted in the order in which the rays meet
//! them, `t = 0` being the first of the volume, whichever way it is stored.

use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec3};

use crate::render::depth::SceneDepth;
use crate::render::regions::Layer;
use crate::render::view::{Clip, HalfSpace, Rays, View, cut};
use crate::simd::numbers::{Array, Numbers};
use crate::simd::wide::{LANES, Lanes};
use crate::volume::Volume;

/// The volume's axes that `i, j` stand for, by principal axis: as the runs are stored.
pub const IN_SLICE: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// An axis must beat another by this factor to become the principal one, so that a view between
/// two axes does not flip from one to the other by rounding.
const AXIS_MARGIN: f64 = 1.0 + 1e-6;

/// A ray must stay this long in the volume (in slices) to be followed.
const SHORTEST: f64 = 1e-6;

/// Layers from one on.
const EIGHT_LAYERS: Lanes = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// The rays of an image in index space.
#[derive(Clone, Debug)]
pub struct IndexRays {
    /// Pixels across and down.
    pub size: (usize, usize),
    dims: [usize; 3],
    /// Rays start at `corner + x dx + y dy` where `moves`, else at `eye`.
    parallel: bool,
    eye: DVec3,
    corner: DVec3,
    dx: DVec3,
    dy: DVec3,
    world_from_index: DMat4,
    /// What rays must stay within, besides the box of voxels.
    clip: Clip,
    /// Which pieces of the rays are meant.
    layer: Option<Layer>,
    /// Opaque geometry that ends rays.
    scene: Option<Arc<SceneDepth>>,
    /// Depth 0..1 through the bounding sphere along the camera's axis: `normal . p + offset`.
    depth: HalfSpace,
}

/// Eight rays and where they are in the volume.
#[derive(Clone, Debug)]
pub struct Packet {
    /// The principal axis.
    pub axis: usize,
    /// True where slices are met in descending order of their index.
    pub reversed: bool,
    /// The first and the last lane of this axis and order.
    pub lanes: (usize, usize),
    /// Index along `i` and `j` where t = 0, by lane.
    pub start: [Lanes; 2],
    /// Indices along `i` and `j` from a slice to the next.
    pub slope: [Lanes; 2],
    /// Where rays enter and leave the volume, in slices. Lanes that miss it enter after they leave.
    pub enter: Lanes,
    pub leave: Lanes,
    /// Length of the ray from a slice to the next, mm.
    pub length: Lanes,
    /// Unit vector towards the eye, world, by component.
    pub to_eye: [Lanes; 3],
    /// Depth 0..1 where t = 0, and from a slice to the next.
    pub depth: [Lanes; 2],
}

impl IndexRays {
    /// The rays of `view` in the index space of `volume`.
    pub fn new(view: &View, volume: &Volume) -> Self {
        let world_from_index = volume.world_from_index();
        let index_from_world = world_from_index.inverse();
        let point = |p| index_from_world.transform_point3(p);
        let vector = |v| index_from_world.transform_vector3(v);
        let (parallel, eye, corner, dx, dy) = match *view.rays() {
            Rays::Parallel { corner, dx, dy, direction } => (true, vector(direction), point(corner), dx, dy),
            Rays::Perspective { eye, corner, dx, dy } => (false, point(eye), vector(corner), dx, dy),
        };
        let in_index = |half: &HalfSpace| HalfSpace {
            normal: world_from_index.transpose().transform_vector3(half.normal),
            offset: half.normal.dot(world_from_index.col(3).truncate()) + half.offset,
        };
        let (width, height) = view.size();
        let across = view.forward() / (2.0 * volume.radius());
        let depth = HalfSpace { normal: across, offset: 0.5 - across.dot(volume.centre()) };
        Self {
            size: (width as usize, height as usize),
            dims: volume.dims(),
            parallel,
            eye,
            corner,
            dx: vector(dx),
            dy: vector(dy),
            world_from_index,
            clip: view.clip().told_by(DAffine3::from_mat4(world_from_index)),
            layer: view.layer().map(|layer| layer.told_by(DAffine3::from_mat4(world_from_index))),
            scene: view.depth().cloned(),
            depth: in_index(&depth),
        }
    }

    /// Of the middle ray: its length from a slice to the next, and the distance of slices; mm.
    pub fn lengths(&self, volume: &Volume) -> (f64, f64) {
        let (width, height) = self.size;
        let (_, direction) = self.ray(width as f64 / 2.0, height as f64 / 2.0);
        let axis = principal_axis(direction);
        let length = self.world_from_index.transform_vector3(direction).length() / direction[axis].abs();
        (length, volume.placement().spacing[axis])
    }

    /// True where all rays have one length between two slices.
    pub fn is_parallel(&self) -> bool {
        self.parallel
    }

    /// Origin and direction of the ray through pixel coordinates.
    #[inline(always)]
    fn ray(&self, x: f64, y: f64) -> (DVec3, DVec3) {
        let at = self.corner + self.dx * x + self.dy * y;
        if self.parallel { (at, self.eye) } else { (self.eye, at) }
    }

    /// The end of the lanes from `first` on (of `lanes` pixels from (x, y) on) that are of one part of the
    /// view: one principal axis, slices met in one order. All of them but where parts meet.
    #[inline(always)]
    pub fn part_end(&self, x: usize, y: usize, first: usize, lanes: usize) -> usize {
        // The directions of one part are a convex cone: where both ends are in it, all are.
        let here = self.part(x + first, y);
        if self.parallel || self.part(x + lanes - 1, y) == here {
            return lanes;
        }
        let mut end = first + 1;
        while end < lanes && self.part(x + end, y) == here {
            end += 1;
        }
        end
    }

    /// The principal axis of a pixel's ray, and whether it meets slices in descending order.
    #[inline(always)]
    pub fn part(&self, x: usize, y: usize) -> (usize, bool) {
        let (_, direction) = self.ray(x as f64 + 0.5, y as f64 + 0.5);
        let axis = principal_axis(direction);
        (axis, direction[axis] < 0.0)
    }

    /// True where the view has several parts.
    pub fn has_joints(&self) -> bool {
        let [right, bottom] = [self.size.0 - 1, self.size.1 - 1];
        let corners = [(0, 0), (right, 0), (0, bottom), (right, bottom)].map(|(x, y)| self.part(x, y));
        // The directions of a part are a convex cone.
        corners.iter().any(|part| *part != corners[0])
    }

    /// The rays of `lanes` of the pixels from (x, y) on, which are of one part; `None` where none meets
    /// the volume.
    #[inline(always)]
    pub fn packet(&self, x: usize, y: usize, lanes: Range<usize>) -> Option<Packet> {
        let (axis, reversed) = self.part(x + lanes.start, y);
        let row = y;
        let y = y as f64 + 0.5;
        let in_slice = IN_SLICE[axis];
        let first_slice = if reversed { (self.dims[axis] - 1) as f64 } else { 0.0 };
        let mut packet = Packet {
            axis,
            reversed,
            lanes: (lanes.start, lanes.end - 1),
            start: [[0.0; LANES]; 2],
            slope: [[0.0; LANES]; 2],
            enter: [f32::INFINITY; LANES],
            leave: [f32::NEG_INFINITY; LANES],
            length: [0.0; LANES],
            to_eye: [[0.0; LANES]; 3],
            depth: [[0.0; LANES]; 2],
        };
        let mut any = false;
        for lane in lanes {
            let (origin, direction) = self.ray((x + lane) as f64 + 0.5, y);
            let per_slice = direction / direction[axis].abs();
            let at_first = origin + per_slice * ((first_slice - origin[axis]) * per_slice[axis]);
            let step = self.world_from_index.transform_vector3(per_slice);
            let length = step.length();
            let [enter, mut leave] = self.span(at_first, per_slice, origin, axis);
            if let Some(scene) = &self.scene {
                let from_origin = f64::from(scene.at(x + lane, row)) / length;
                leave = leave.min((origin[axis] - first_slice) * per_slice[axis] + from_origin);
            }
            if leave - enter > SHORTEST {
                any = true;
                packet.enter[lane] = enter as f32;
                packet.leave[lane] = leave as f32;
            }
            for n in 0..2 {
                packet.start[n][lane] = at_first[in_slice[n]] as f32;
                packet.slope[n][lane] = per_slice[in_slice[n]] as f32;
            }
            packet.length[lane] = length as f32;
            for axis in 0..3 {
                packet.to_eye[axis][lane] = (step[axis] / -length) as f32;
            }
            packet.depth[0][lane] = (self.depth.normal.dot(at_first) + self.depth.offset) as f32;
            packet.depth[1][lane] = self.depth.normal.dot(per_slice) as f32;
        }
        any.then_some(packet)
    }

    /// Where `start + t step` is inside the volume, in front of the eye and within the clip planes.
    #[inline(always)]
    fn span(&self, start: DVec3, step: DVec3, origin: DVec3, axis: usize) -> [f64; 2] {
        let behind_eye = (origin[axis] - start[axis]) * step[axis];
        let mut span = [if self.parallel { 0.0 } else { f64::max(0.0, behind_eye) }, (self.dims[axis] - 1) as f64];
        for axis in IN_SLICE[axis] {
            span = cut(span, start[axis], step[axis]);
            span = cut(span, (self.dims[axis] - 1) as f64 - start[axis], -step[axis]);
        }
        let span = self.clip.span(start, step, span);
        self.layer.as_ref().map_or(span, |layer| layer.span(start, step, span))
    }
}

/// The axis most parallel to a direction in index space.
#[inline(always)]
fn principal_axis(along: DVec3) -> usize {
    let along = along.abs();
    let mut best = 2;
    for axis in [1, 0] {
        if along[axis] > along[best] * AXIS_MARGIN {
            best = axis;
        }
    }
    best
}

impl Packet {
    /// Positions along `i` (0) or `j` (1) at slice position `t`.
    #[inline(always)]
    pub fn at(&self, n: usize, t: f32) -> Lanes {
        let mut at = [0.0; LANES];
        for lane in 0..LANES {
            at[lane] = self.start[n][lane] + t * self.slope[n][lane];
        }
        at
    }

    /// The lanes that meet the volume, a bit each.
    #[inline(always)]
    pub fn hits(&self) -> u32 {
        let mut hits = 0;
        for lane in 0..LANES {
            hits |= u32::from(self.enter[lane] < self.leave[lane]) << lane;
        }
        hits
    }

    /// The first slice position of any lane, and the last.
    #[inline(always)]
    pub fn span(&self) -> (f32, f32) {
        let (mut enter, mut leave) = (f32::INFINITY, f32::NEG_INFINITY);
        for lane in 0..LANES {
            enter = enter.min(self.enter[lane]);
            leave = leave.max(self.leave[lane]);
        }
        (enter, leave)
    }

    /// All lanes that hit are inside the volume between these positions.
    #[inline(always)]
    pub fn inside(&self, hits: u32) -> (f32, f32) {
        let (mut enter, mut leave) = (f32::NEG_INFINITY, f32::INFINITY);
        for lane in 0..LANES {
            if hits >> lane & 1 == 1 {
                enter = enter.max(self.enter[lane]);
                leave = leave.min(self.leave[lane]);
            }
        }
        (enter, leave)
    }

    /// The smallest and the largest cell index along `i` or `j`, of `cells`, that lanes touch between two
    /// slice positions. Positions are monotonous along a row of pixels and along a ray, so the
    /// corners bound them all.
    #[inline(always)]
    pub fn bounds(&self, n: usize, [from, to]: [f32; 2], cells: usize) -> [usize; 2] {
        let [Array([low]), Array([high])] = self.extent(n, [Array([from]), Array([to])], cells);
        [low as u32 as usize, high as u32 as usize]
    }

    /// The same between the two slices of each of some layers from one on, whole numbers but for what is behind the point.
    #[inline(always)]
    pub fn bounds_of_layers<V: Numbers<Memory = Lanes>>(&self, n: usize, layer: usize, cells: usize) -> [Lanes; 2] {
        let from = V::all(layer as f32) + V::load(&EIGHT_LAYERS);
        let [low, high] = self.extent(n, [from, from + V::all(1.0)], cells);
        [low.store(), high.store()]
    }

    /// Where lanes are between two slice positions, as far as there are cells; side by side.
    #[inline(always)]
    fn extent<V: Numbers>(&self, n: usize, [from, to]: [V; 2], cells: usize) -> [V; 2] {
        let (first, last) = self.lanes;
        let (start, slope) = (&self.start[n], &self.slope[n]);
        let (along, at_0) = (V::all(slope[first]), V::all(start[first]));
        let (a, b) = (at_0 + from * along, at_0 + to * along);
        let (along, at_0) = (V::all(slope[last]), V::all(start[last]));
        let (c, d) = (at_0 + from * along, at_0 + to * along);
        let (zero, end) = (V::all(0.0), V::all((cells - 1) as f32));
        let (low, high) = (a.least(b).least(c.least(d)), a.most(b).most(c.most(d)));
        [low.most(zero).least(end), high.most(zero).least(end)]
    }
}
