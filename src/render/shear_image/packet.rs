//! Rays in index space, eight pixels of a row at a time.
//!
//! A ray is told by where it meets the slices: along the principal axis it advances by one index a
//! slice, along the other two by its slopes. Slices are counted in the order in which the rays meet
//! them, `t = 0` being the first of the volume, whichever way it is stored.

use std::ops::Range;

use glam::{DMat4, DVec3, Vec3};

use crate::render::view::{HalfSpace, Rays, View};
use crate::volume::Volume;

/// Pixels of a packet: the lanes of a 256-bit register.
pub const LANES: usize = 8;

/// A number for each lane.
pub type Lanes = [f32; LANES];

/// The volume's axes that `i, j` stand for, by principal axis: as the runs are stored.
pub const IN_SLICE: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// An axis must beat another by this factor to become the principal one, so that a view between
/// two axes does not flip from one to the other by rounding.
const AXIS_MARGIN: f64 = 1.0 + 1e-6;

/// A ray must stay this long in the volume (in slices) to be followed.
const SHORTEST: f64 = 1e-6;

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
    /// What rays must stay within, besides the box of voxels: `normal . p + offset >= 0`.
    clip: Vec<HalfSpace>,
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
    /// Unit vector towards the eye, world.
    pub to_eye: [Vec3; LANES],
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
            clip: view.clip().iter().map(in_index).collect(),
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

    /// The rays of `lanes` pixels from (x, y) on, as packets of one principal axis and one order of
    /// slices each: one packet but where two parts of a perspective view meet. Lanes that a packet
    /// leaves out miss the volume.
    #[inline(always)]
    pub fn packets(&self, x: usize, y: usize, lanes: usize, mut each: impl FnMut(&Packet)) {
        let y = y as f64 + 0.5;
        let part = |lane: usize| {
            let (_, direction) = self.ray((x + lane) as f64 + 0.5, y);
            let axis = principal_axis(direction);
            (axis, direction[axis] < 0.0)
        };
        // The directions of one part are a convex cone: where both ends are in it, all are.
        let mut first = 0;
        while first < lanes {
            let here = part(first);
            let mut end = lanes;
            if part(lanes - 1) != here {
                end = (first + 1..lanes).find(|&lane| part(lane) != here).unwrap_or(lanes);
            }
            if let Some(packet) = self.packet(x, y, first..end, here) {
                each(&packet);
            }
            first = end;
        }
    }

    #[inline(always)]
    fn packet(&self, x: usize, y: f64, lanes: Range<usize>, (axis, reversed): (usize, bool)) -> Option<Packet> {
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
            to_eye: [Vec3::ZERO; LANES],
            depth: [[0.0; LANES]; 2],
        };
        let mut any = false;
        for lane in lanes {
            let (origin, direction) = self.ray((x + lane) as f64 + 0.5, y);
            let per_slice = direction / direction[axis].abs();
            let at_first = origin + per_slice * ((first_slice - origin[axis]) * per_slice[axis]);
            let (enter, leave) = self.span(at_first, per_slice, origin, axis);
            if leave - enter > SHORTEST {
                any = true;
                packet.enter[lane] = enter as f32;
                packet.leave[lane] = leave as f32;
            }
            for (n, axis) in in_slice.into_iter().enumerate() {
                packet.start[n][lane] = at_first[axis] as f32;
                packet.slope[n][lane] = per_slice[axis] as f32;
            }
            let step = self.world_from_index.transform_vector3(per_slice);
            let length = step.length();
            packet.length[lane] = length as f32;
            packet.to_eye[lane] = (step / -length).as_vec3();
            packet.depth[0][lane] = (self.depth.normal.dot(at_first) + self.depth.offset) as f32;
            packet.depth[1][lane] = self.depth.normal.dot(per_slice) as f32;
        }
        any.then_some(packet)
    }

    /// Where `start + t step` is inside the volume, in front of the eye and within the clip planes.
    #[inline(always)]
    fn span(&self, start: DVec3, step: DVec3, origin: DVec3, axis: usize) -> (f64, f64) {
        let last = (self.dims[axis] - 1) as f64;
        let behind_eye = (origin[axis] - start[axis]) * step[axis];
        let mut enter = if self.parallel { 0.0 } else { f64::max(0.0, behind_eye) };
        let mut leave = last;
        let mut cut = |distance: f64, rate: f64| {
            // distance + t rate >= 0
            if rate > 0.0 {
                enter = enter.max(-distance / rate);
            } else if rate < 0.0 {
                leave = leave.min(-distance / rate);
            } else if distance < 0.0 {
                leave = f64::NEG_INFINITY;
            }
        };
        for axis in IN_SLICE[axis] {
            cut(start[axis], step[axis]);
            cut((self.dims[axis] - 1) as f64 - start[axis], -step[axis]);
        }
        for half in &self.clip {
            cut(half.normal.dot(start) + half.offset, half.normal.dot(step));
        }
        (enter, leave)
    }
}

/// The axis most parallel to a direction in index space.
#[inline(always)]
fn principal_axis(along: DVec3) -> usize {
    let along = along.abs();
    [1, 0].into_iter().fold(2, |best, axis| if along[axis] > along[best] * AXIS_MARGIN { axis } else { best })
}

impl Packet {
    /// Positions along `i` (0) or `j` (1) at slice position `t`.
    #[inline(always)]
    pub fn at(&self, n: usize, t: f32) -> Lanes {
        std::array::from_fn(|lane| self.start[n][lane] + t * self.slope[n][lane])
    }

    /// The lanes that meet the volume, a bit each.
    #[inline(always)]
    pub fn hits(&self) -> u32 {
        (0..LANES).fold(0, |hits, lane| hits | u32::from(self.enter[lane] < self.leave[lane]) << lane)
    }

    /// The first slice position of any lane, and the last.
    #[inline(always)]
    pub fn span(&self) -> (f32, f32) {
        (smallest(&self.enter), largest(&self.leave))
    }

    /// All lanes that hit are inside the volume between these positions.
    #[inline(always)]
    pub fn inside(&self, hits: u32) -> (f32, f32) {
        let hit = |lane: &usize| hits >> lane & 1 == 1;
        let enter = (0..LANES).filter(hit).fold(f32::NEG_INFINITY, |all, lane| all.max(self.enter[lane]));
        let leave = (0..LANES).filter(hit).fold(f32::INFINITY, |all, lane| all.min(self.leave[lane]));
        (enter, leave)
    }

    /// The smallest and the largest cell index along `i` or `j`, of `cells`, that lanes touch between two
    /// slice positions. Positions are monotonous along a row of pixels and along a ray, so the
    /// corners bound them all.
    #[inline(always)]
    pub fn bounds(&self, n: usize, [from, to]: [f32; 2], cells: usize) -> [usize; 2] {
        let (first, last) = self.lanes;
        let at = |lane: usize, t: f32| self.start[n][lane] + t * self.slope[n][lane];
        let (a, b, c, d) = (at(first, from), at(first, to), at(last, from), at(last, to));
        let end = (cells - 1) as f32;
        [a.min(b).min(c.min(d)), a.max(b).max(c.max(d))].map(|p| p.clamp(0.0, end) as usize)
    }
}

#[inline(always)]
fn smallest(lanes: &Lanes) -> f32 {
    lanes.iter().fold(f32::INFINITY, |all, &lane| all.min(lane))
}

#[inline(always)]
fn largest(lanes: &Lanes) -> f32 {
    lanes.iter().fold(f32::NEG_INFINITY, |all, &lane| all.max(lane))
}
