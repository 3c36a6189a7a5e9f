//! [`View`] + volume -> [`Factorization`]: principal axis, shear, warp, size of the intermediate
//! image (Lacroute and Levoy 1994, section 2).
//!
//! With `i, j, k` the permuted voxel indices and `k` along the principal viewing axis, a parallel
//! ray advances by `d = (d_i, d_j, d_k)` indices per mm. Shearing slice `k` by `-d_i/d_k, -d_j/d_k`
//! a slice makes all rays parallel to `k`; a further translation by whole pixels makes the
//! intermediate image start at 0:
//!
//! ```text
//! u = i + shear_u (k - front) + translation_u        v = j + shear_v (k - front) + translation_v
//! ```
//!
//! The front slice, the one nearest to the viewer, stays on the pixel lattice: what is seen first is
//! not blurred, and the lattice does not depend on the direction in which slices are stored. A
//! final pixel's ray meets the front slice in one point, which gives the warp without inverting a view
//! matrix: (u, v) is an affine function of (x, y).
//!
//! Perspective rays become parallel where slices are scaled too, about the eye; `perspective`
//! has the argument. What follows sees one kind of thing: pixel (u, v) meets slice `k` in voxel
//! coordinates `offset + scale (u, v)`, the slice's [`Lattice`]. Under parallel projection the scale is 1.

mod convex;
mod perspective;
mod rows;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine2, DAffine3, DMat3, DMat4, DVec2, DVec3};

use super::RenderError;
use super::depth::{Limits, Stretch};
use super::ranges::hull;
use super::regions::MAX_REGIONS;
use super::view::{Clip, Rays, View};
use crate::volume::Volume;
use convex::Convex;
pub use convex::{Halves, Meeting};
pub use rows::{SlicePlane, Spans};

/// For each principal axis the volume's axes that i, j, k stand for, as the encodings store them.
pub const PERMUTATIONS: [[usize; 3]; 3] = [[1, 2, 0], [0, 2, 1], [0, 1, 2]];

/// An axis must beat another by this factor to become the principal one, so that a view between
/// two axes does not flip from one to the other by rounding.
const AXIS_MARGIN: f64 = 1.0 + 1e-6;

/// A slice's position is rounded to this many pixels: a shear that differs from a whole number of
/// pixels by rounding only gets whole pixels, and the same voxels are inside the volume's box.
const OFFSET_STEP: f64 = 1.0 / 16384.0;

/// Parts of the way through the slices in which shapes are looked for, and scanlines that are taken together.
const PARTS: usize = 8;
const TOGETHER: usize = 16;

/// What shows lies so many pixels within those that are told to lie over it: as far as is looked for where the ends of rays are torn.
const AROUND: f64 = 4.0;

/// Pixels of an intermediate image at most (1 GiB).
const MAX_PIXELS: usize = 1 << 26;

/// The shear-warp factorization of a view, or of a part of one: rays with one principal axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Factorization {
    /// The volume's axis along which slices are stacked.
    pub principal_axis: usize,
    /// Voxels along i, j, k.
    pub dims: [usize; 3],
    /// True where the viewer stands beyond the last slice: front to back is k descending.
    pub reversed: bool,
    /// Slices in front of the viewer: all of them, unless the eye stands among them.
    pub slices: Range<usize>,
    /// The slice that positions along the rays are counted from: the nearest to the viewer or, where the
    /// eye stands among the slices, the one that it stands on or has just behind it.
    pub front: usize,
    /// Position of the eye where it stands among the slices, 0..1; else 0.
    pub start: f64,
    shear: Shear,
    /// Pixels of the intermediate image along u and v.
    pub size: [usize; 2],
    /// The camera's axis in the world, unit; under parallel projection the rays' direction.
    pub direction: DVec3,
    /// Length of a ray between two slices, mm; in perspective, of the shortest.
    pub slice_distance: f64,
    /// World mm that the ray of pixel (u, v, 1) advances by from slice to slice.
    ray: DMat3,
    /// The warp: intermediate pixels (samples at integers), homogeneous, from final pixel coordinates.
    pub sheared_from_image: DMat3,
    /// The least and the greatest position, in pixels, at which a final pixel sees a slice. The image
    /// has at least one pixel more along either axis.
    pub extent: [DVec2; 2],
    /// What the view clips to.
    clip: Convex,
    /// What is cut out of that.
    holes: Vec<Convex>,
    /// What is seen of the rays of pixels.
    limits: Option<Arc<Limits>>,
}

/// What makes the rays parallel to `k`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shear {
    /// Slice `k` begins at pixel `per_slice k + translation`.
    Parallel { per_slice: DVec2, translation: DVec2 },
    /// Pixel (u, v) lies at voxel coordinates `origin + (u, v)` of a plane that is parallel to the slices
    /// and `distance` of them away from the eye.
    /// Rays have these directions in voxels of the volume's own axes, by final pixel coordinates (x, y, 1).
    Perspective { eye: DVec3, distance: f64, origin: DVec2, directions: DMat3 },
}

/// What may clip pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clipping {
    /// Clip planes and balls, if they do, and which of the planes.
    pub by_planes: Option<Halves>,
    pub holes: Holes,
    /// The ends of rays.
    pub by_limits: bool,
}

/// Some of a factorization's holes, a bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Holes(u32);

impl Holes {
    /// All that there may be.
    pub const ALL: Self = Self(u32::MAX);

    /// True where there is one.
    #[inline(always)]
    pub fn is_any(self) -> bool {
        self.0 != 0
    }
}

impl Clipping {
    /// True where shapes may, whatever ends rays.
    #[inline(always)]
    pub fn by_shapes(&self) -> bool {
        self.by_planes.is_some() || self.holes.is_any()
    }
}

/// Where pixels meet a slice: (u, v) at voxel coordinates `offset + scale (u, v)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lattice {
    pub offset: DVec2,
    /// Voxels from one pixel to the next.
    pub scale: f64,
}

/// Where a slice lies over the intermediate image: pixel (u, v) gathers from the voxels
/// `(u - first_u, v - first_v)` and their successors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlicePlacement {
    /// First pixel that lies on the slice, along u and v.
    pub first: [usize; 2],
    /// How far between a voxel and its successor pixels lie, 0..1, along u and v.
    pub fraction: [f32; 2],
}

impl Factorization {
    /// The parts of `view` on `volume`, each with its own principal axis: one for most views, none where
    /// nothing of the volume is in the picture.
    ///
    /// # Errors
    /// [`RenderError::Unsupported`] where the intermediate image would outgrow memory.
    pub fn parts(view: &View, volume: &Volume) -> Result<Vec<Self>, RenderError> {
        let parts = match *view.rays() {
            Rays::Parallel { corner, dx, dy, direction } => {
                let whole = Self::parallel([dx, dy, corner], direction, volume);
                vec![whole.clipped(view, &volume.world_from_index())]
            }
            Rays::Perspective { eye, corner, dx, dy } => perspective::parts([dx, dy, corner], eye, view, volume),
        };
        for Self { size: [width, height], .. } in &parts {
            if width.saturating_mul(*height) > MAX_PIXELS {
                let detail = format!("the intermediate image would have {width} x {height} pixels, over {MAX_PIXELS}");
                return Err(RenderError::Unsupported { pointer: "/camera", detail });
            }
        }
        Ok(parts)
    }

    /// Rays along a direction (world, unit), whatever the picture.
    pub fn along_rays(direction: DVec3, volume: &Volume) -> Self {
        Self::parallel([DVec3::ZERO, DVec3::ZERO, volume.centre()], direction, volume)
    }

    /// A parallel view: rays along `direction` from points that `point_from_image` gives as columns for
    /// x, y and 1.
    fn parallel([dx, dy, corner]: [DVec3; 3], direction: DVec3, volume: &Volume) -> Self {
        let world_from_index = volume.world_from_index();
        let index_from_world = world_from_index.inverse();
        let along = index_from_world.transform_vector3(direction);
        let principal_axis = principal_axis(along);
        let dims = PERMUTATIONS[principal_axis].map(|axis| volume.dims()[axis]);
        let d = permuted(principal_axis, along);
        let shear = -d.truncate() / d.z;
        let last_slice = (dims[2] - 1) as f64;
        let reversed = d.z < 0.0;
        let (front, depth) = if reversed { (last_slice, -last_slice) } else { (0.0, last_slice) };
        let translation = (-shear * depth).max(DVec2::ZERO).ceil() - shear * front;
        // All points of a ray shear to the same place.
        let sheared = |p: DVec3| p.truncate() + shear * p.z;
        let vector = |v: DVec3| sheared(permuted(principal_axis, index_from_world.transform_vector3(v)));
        let start = sheared(permuted(principal_axis, index_from_world.transform_point3(corner)));
        let [first, last] = [0.0, last_slice].map(|k| shear * k + translation);
        let face = DVec2::new((dims[0] - 1) as f64, (dims[1] - 1) as f64);
        Self {
            principal_axis,
            dims,
            reversed,
            slices: 0..dims[2],
            front: if reversed { dims[2] - 1 } else { 0 },
            start: 0.0,
            shear: Shear::Parallel { per_slice: shear, translation },
            size: [0, 1].map(|axis| dims[axis] + (shear[axis].abs() * last_slice).ceil() as usize + 1),
            direction,
            slice_distance: 1.0 / d.z.abs(),
            ray: DMat3::from_cols(DVec3::ZERO, DVec3::ZERO, direction / d.z.abs()),
            sheared_from_image: DAffine2::from_cols(vector(dx), vector(dy), start + translation).into(),
            extent: [DVec2::ZERO, first.max(last) + face],
            clip: Convex::default(),
            holes: vec![],
            limits: None,
        }
    }

    /// From an element to the next along i, j, k, of an array in the volume's order (x fastest) that has so many of them along
    /// i, j, k.
    pub fn strides(&self, counts: [usize; 3]) -> [usize; 3] {
        let permutation = PERMUTATIONS[self.principal_axis];
        let (mut strides, mut stride) = ([0; 3], 1);
        for axis in 0..3 {
            let place = permutation.iter().position(|&a| a == axis).expect("a permutation of the axes");
            strides[place] = stride;
            stride *= counts[place];
        }
        strides
    }

    /// Slices from the front one to the last.
    pub fn layers(&self) -> usize {
        if self.reversed { self.front - self.slices.start } else { self.slices.end - 1 - self.front }
    }

    /// Where along k the position is that rays reach after so many slices from the front one.
    pub fn along(&self, position: f64) -> f64 {
        let front = self.front as f64;
        if self.reversed { front - position } else { front + position }
    }

    /// [`Self::along`], the other way round.
    pub fn position(&self, along: f64) -> f64 {
        let front = self.front as f64;
        if self.reversed { front - along } else { along - front }
    }

    /// How many intervals between slices slice `k` stands for: half of each that it bounds, and all of what
    /// lies between the eye and the first slice in front of it. n slices span n - 1 intervals.
    pub fn share(&self, k: usize) -> f64 {
        let (nearest, farthest) = if self.reversed {
            (self.slices.end - 1, self.slices.start)
        } else {
            (self.slices.start, self.slices.end - 1)
        };
        let before = match k == nearest {
            true if nearest == self.front => 0.0,
            true => 1.0 - self.start,
            false => 0.5,
        };
        before + if k == farthest { 0.0 } else { 0.5 }
    }

    /// True where no slice is scaled: each lies on the pixel lattice but for an offset.
    pub fn is_parallel(&self) -> bool {
        matches!(self.shear, Shear::Parallel { .. })
    }

    /// True where final pixel coordinates belong to this part of a picture that has several.
    pub fn owns(&self, at: DVec2) -> bool {
        match self.shear {
            Shear::Parallel { .. } => true,
            Shear::Perspective { directions, .. } => {
                let direction = directions * at.extend(1.0);
                let axis = principal_axis(direction);
                axis == self.principal_axis && (direction[axis] < 0.0) == self.reversed
            }
        }
    }

    /// Where pixels meet slice `k`, which may be between two slices of voxels.
    pub fn lattice(&self, k: f64) -> Lattice {
        match self.shear {
            Shear::Parallel { per_slice, translation } => {
                Lattice { offset: -(per_slice * k + translation), scale: 1.0 }
            }
            Shear::Perspective { eye, distance, origin, .. } => {
                let scale = (k - eye.z).abs() / distance;
                Lattice { offset: eye.truncate() * (1.0 - scale) + origin * scale, scale }
            }
        }
    }

    /// Where slice `k` of a parallel view lies over the intermediate image.
    pub fn slice(&self, k: usize) -> SlicePlacement {
        self.placement(k as f64)
    }

    /// Where a slice of a parallel view lies over the intermediate image that may be between two slices
    /// of voxels.
    pub fn placement(&self, k: f64) -> SlicePlacement {
        let offset = -self.lattice(k).offset / OFFSET_STEP;
        let offset = offset.round().max(DVec2::ZERO) * OFFSET_STEP;
        let first = offset.ceil();
        let fraction = (first - offset).as_vec2();
        SlicePlacement { first: [first.x as usize, first.y as usize], fraction: fraction.to_array() }
    }

    /// What slice `k` of single voxels stands for, along k and in the order of the walk: half-way to its neighbours.
    pub fn interval(&self, k: usize) -> [f64; 2] {
        let last = (self.dims[2] - 1) as f64;
        let [low, high] = [(k as f64 - 0.5).max(0.0), (k as f64 + 0.5).min(last)];
        if self.reversed { [high, low] } else { [low, high] }
    }

    /// With what the view clips to.
    fn clipped(mut self, view: &View, world_from_index: &DMat4) -> Self {
        let [i, j, k] = PERMUTATIONS[self.principal_axis].map(|axis| world_from_index.col(axis).truncate());
        let translation = world_from_index.col(3).truncate();
        self.clip = Convex::new(&view.clip().told_by(DAffine3 { matrix3: DMat3::from_cols(i, j, k), translation }));
        self
    }

    /// Without what lies in convex parts of the world, [`MAX_REGIONS`] at most.
    pub(super) fn cut_out<'a>(mut self, volume: &Volume, parts: impl Iterator<Item = &'a Clip>) -> Self {
        let world_from_voxel = self.world_from_voxel(volume);
        self.holes = parts.map(|part| Convex::new(&part.told_by(world_from_voxel))).collect();
        self
    }

    /// With what is seen of the rays of pixels.
    pub(super) fn limited(mut self, limits: Option<Arc<Limits>>) -> Self {
        self.limits = limits;
        self
    }

    /// Voxel coordinates i, j, k of pixel (u, v) of a slice, which may be between two slices of voxels.
    pub fn voxel_from_sheared(&self, u: f64, v: f64, k: f64) -> DVec3 {
        let Lattice { offset, scale } = self.lattice(k);
        (offset + DVec2::new(u, v) * scale).extend(k)
    }

    /// Index coordinates (the volume's axes x, y, z) of voxel coordinates i, j, k.
    pub fn index_from_voxel(&self, voxel: DVec3) -> DVec3 {
        let mut index = DVec3::ZERO;
        for (axis, at) in PERMUTATIONS[self.principal_axis].into_iter().zip(voxel.to_array()) {
            index[axis] = at;
        }
        index
    }

    /// Two slices, which may be between slices of voxels, and where pixels meet them.
    #[inline(always)]
    pub fn slice_planes(&self, slices: [f64; 2]) -> [SlicePlane; 2] {
        slices.map(|k| SlicePlane { lattice: self.lattice(k), k })
    }

    /// Pixels u of `N` scanlines from `v` on of which clipping by some half-spaces, and by balls, may leave something between two slices (in the
    /// order of the walk), and those of which it leaves all, but for holes.
    #[inline(always)]
    pub fn clipped_pixels<const N: usize>(&self, v: usize, slices: &[SlicePlane; 2], halves: Halves) -> [Spans<N>; 2] {
        self.clip.pixels(v, slices, halves)
    }

    /// Finds for each hole of some the pixels u of `N` scanlines from `v` on of which it may take something between two slices, and those of
    /// which it takes all.
    #[inline(always)]
    pub fn hollow_pixels<const N: usize>(
        &self,
        v: usize,
        slices: &[SlicePlane; 2],
        which: Holes,
        mut found: impl FnMut([Spans<N>; 2]),
    ) {
        for (n, hole) in self.holes.iter().enumerate() {
            if which.0 >> n & 1 == 1 {
                found(hole.pixels(v, slices, Halves::ALL));
            }
        }
    }

    /// By scanline the pixels, and perhaps some beside them, with rays that meet one of some shapes (in voxel coordinates) among the slices.
    pub fn pixels_that_meet<'a>(&self, shapes: impl Iterator<Item = &'a Clip>) -> Vec<Range<usize>> {
        let [width, height] = self.size;
        let shapes: Vec<_> = shapes.map(Convex::new).collect();
        // The thinner what is looked at, the fewer are told in vain.
        let at =
            |part: usize| self.along(self.start + (self.layers() as f64 - self.start) * part as f64 / PARTS as f64);
        let parts: Vec<_> = (0..PARTS).map(|part| self.slice_planes([at(part), at(part + 1)])).collect();
        let mut met = vec![0..0; height];
        for (group, met) in met.chunks_mut(TOGETHER).enumerate() {
            for (shape, part) in shapes.iter().flat_map(|shape| parts.iter().map(move |part| (shape, part))) {
                let [some, _] = shape.pixels::<TOGETHER>(group * TOGETHER, part, Halves::ALL);
                for (row, met) in met.iter_mut().enumerate() {
                    let Range { start, end } = some.pixels(row, width);
                    if start < end {
                        *met = hull(met, &(start.saturating_sub(1)..(end + 1).min(width)));
                    }
                }
            }
        }
        met
    }

    /// Pixels along u and v that some voxels along the volume's axes x, y, z lie under, and a few around; none for no voxels.
    pub fn pixels_over(&self, voxels: &[Range<usize>; 3]) -> [Range<usize>; 2] {
        if voxels.iter().any(Range::is_empty) {
            return [0..0, 0..0];
        }
        if self.slices != (0..self.dims[2]) {
            // An eye among the slices has a slab of its own.
            return self.size.map(|size| 0..size);
        }
        let [i, j, k] =
            PERMUTATIONS[self.principal_axis].map(|axis| voxels[axis].start as f64..=voxels[axis].end as f64 - 1.0);
        // Along a ray of the volume's, pixels go one way from slice to slice.
        let ends = [*k.start(), *k.end()].map(|k| self.lattice(k));
        [(i, 0), (j, 1)].map(|(voxels, axis)| {
            let pixels = |voxel: f64| ends.map(|Lattice { offset, scale }| (voxel - offset[axis]) / scale);
            // What is outermost in the volume is seen a voxel beside it.
            let [[a, b], [c, d]] = [voxels.start() - 1.0, voxels.end() + 1.0].map(pixels);
            let (low, high) = (a.min(b) - AROUND, c.max(d) + AROUND + 1.0);
            low.floor().max(0.0) as usize..(high.ceil().max(0.0) as usize).min(self.size[axis])
        })
    }

    /// What may clip pixels of some scanlines between two slices; `None` where nothing of any is left.
    #[inline(always)]
    pub fn clipping(&self, vs: Range<usize>, slices: [f64; 2]) -> Option<Clipping> {
        let mut clipping = Clipping::default();
        if let Some(limits) = &self.limits {
            match limits.meets(vs.clone(), slices.map(|k| self.position(k) as f32)) {
                Meeting::Outside => return None,
                Meeting::Inside => {}
                Meeting::Across => clipping.by_limits = true,
            }
        }
        if self.clip.is_empty() && self.holes.is_empty() {
            return Some(clipping);
        }
        // Pixels beside a slice see nothing of it.
        let beside = [-1.0, self.dims[0] as f64];
        let [a, b] = slices.map(|k| {
            let Lattice { offset, scale } = self.lattice(k);
            let [left, right] =
                [0, self.size[0] - 1].map(|u| (offset.x + scale * u as f64).clamp(beside[0], beside[1]));
            let [top, bottom] = [vs.start, vs.end - 1].map(|v| offset.y + scale * v as f64);
            [DVec3::new(left, top, k), DVec3::new(right, bottom, k)]
        });
        let block = [a[0].min(b[0]), a[1].max(b[1])];
        match self.clip.meets(block) {
            Meeting::Outside => return None,
            Meeting::Inside => {}
            Meeting::Across => clipping.by_planes = Some(self.clip.cutting(block)),
        }
        for (n, hole) in self.holes.iter().enumerate() {
            match hole.meets(block) {
                Meeting::Inside => return None,
                Meeting::Outside => {}
                Meeting::Across => clipping.holes.0 |= 1 << n,
            }
        }
        Some(clipping)
    }

    /// True where pixels may be clipped.
    pub fn is_clipped(&self) -> bool {
        self.limits.is_some() || !self.clip.is_empty() || !self.holes.is_empty()
    }

    /// What is seen of the rays of pixels, where that is not all that clip planes leave.
    pub fn limits(&self) -> Option<&Limits> {
        self.limits.as_deref()
    }

    /// What clip planes, holes and limits leave of the ray of pixel (u, v) between two slices, as fractions of the way from the first to
    /// the second: pieces with their ends, one behind another.
    pub fn left(&self, u: usize, v: usize, slices: [f64; 2]) -> impl Iterator<Item = [f32; 2]> {
        let [from, to] = slices.map(|k| self.voxel_from_sheared(u as f64, v as f64, k));
        let [mut enter, mut leave] = self.clip.span(from, to - from, [0.0, 1.0]);
        let [first, last] = slices.map(|k| self.position(k));
        let part = move |Stretch { from, to }| [from, to].map(|at| (f64::from(at) - first) / (last - first));
        if let Some(limits) = &self.limits {
            let [first, last] = part(limits.at(u, v));
            (enter, leave) = (enter.max(first), leave.min(last));
        }
        // Between holes; the last piece ends with the ray.
        let of_limits = self.limits.iter().flat_map(|limits| limits.holes(u, v)).map(part);
        let convex = self.holes.iter().map(|hole| hole.span(from, to - from, [0.0, 1.0]));
        let mut holes = [[leave; 2]; MAX_REGIONS + 1];
        let mut count = 0;
        for hole in of_limits.chain(convex).filter(|[from, to]| from < to) {
            holes[count] = hole;
            count += 1;
        }
        holes[..count].sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let mut begin = enter;
        let pieces = holes.into_iter().take(count + 1).map(move |[from, to]| {
            let piece = [begin, from.min(leave)];
            begin = begin.max(to);
            piece.map(|at| at as f32)
        });
        pieces.filter(|[enter, leave]| enter < leave)
    }

    /// The eye in voxel coordinates i, j, k; `None` where rays are parallel.
    pub fn eye(&self) -> Option<DVec3> {
        match self.shear {
            Shear::Parallel { .. } => None,
            Shear::Perspective { eye, .. } => Some(eye),
        }
    }

    /// World mm from voxel coordinates i, j, k.
    pub(super) fn world_from_voxel(&self, volume: &Volume) -> DAffine3 {
        let translation = volume.world_from_index().col(3).truncate();
        DAffine3 { matrix3: self.world_from_steps(volume), translation }
    }

    /// From a voxel to the next along i, j, k, world mm.
    pub fn world_from_steps(&self, volume: &Volume) -> DMat3 {
        let world_from_index = volume.world_from_index();
        let [i, j, k] = PERMUTATIONS[self.principal_axis].map(|axis| world_from_index.col(axis).truncate());
        DMat3::from_cols(i, j, k)
    }

    /// [`Self::relative_length`] of all pixels of some scanlines.
    #[inline(always)]
    pub fn relative_lengths(&self, vs: Range<usize>, lengths: &mut Vec<f32>) {
        lengths.resize(vs.len() * self.size[0], 0.0);
        for (v, lengths) in vs.zip(lengths.chunks_exact_mut(self.size[0])) {
            for (u, length) in lengths.iter_mut().enumerate() {
                *length = self.relative_length(u, v);
            }
        }
    }

    /// Length of the ray of pixel (u, v) between two slices, in units of [`Self::slice_distance`].
    #[inline(always)]
    pub fn relative_length(&self, u: usize, v: usize) -> f32 {
        ((self.ray * DVec3::new(f64::from(u as u32), f64::from(v as u32), 1.0)).length() / self.slice_distance) as f32
    }
}

/// A vector or point in the order i, j, k of a principal axis.
fn permuted(principal_axis: usize, v: DVec3) -> DVec3 {
    DVec3::from_array(PERMUTATIONS[principal_axis].map(|axis| v[axis]))
}

/// The axis most parallel to the rays, in index space, so that no slice shears by more than a voxel.
fn principal_axis(along: DVec3) -> usize {
    let along = along.abs();
    [1, 0].into_iter().fold(2, |best, axis| if along[axis] > along[best] * AXIS_MARGIN { axis } else { best })
}
