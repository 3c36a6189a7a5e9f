//! Camera -> [`View`]: which ray belongs to which pixel.
//!
//! Every camera, whichever way it was told, comes down to rays that are linear in the pixel
//! coordinates: parallel rays share a direction and start on a plane, perspective rays share an eye
//! and pass through a plane. The factorization and the ray caster both start from here.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DMat4, DVec2, DVec3, DVec4};

use super::depth::SceneDepth;
use super::regions::Layer;

/// How a client tells where it looks from.
#[derive(Clone, Debug, PartialEq)]
pub enum Camera {
    /// Around a target, by angles in degrees.
    Orbit(Orbit),
    /// From a point towards another.
    LookAt(LookAt),
    /// WebGL matrices: `view` is rigid (world -> camera), `projection` maps into -1..1, y up.
    Matrices { view: DMat4, projection: DMat4 },
}

/// The two projections.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Projection {
    Parallel,
    Perspective,
}

/// A camera on a sphere around its target.
#[derive(Clone, Debug, PartialEq)]
pub struct Orbit {
    pub projection: Projection,
    /// Degrees; 0 looks at the patient's face, 90 stands at the patient's left.
    pub azimuth: f64,
    /// Degrees above the axial plane.
    pub elevation: f64,
    /// Degrees by which the camera turns counter-clockwise about its viewing axis.
    pub roll: f64,
    /// Magnification.
    pub zoom: f64,
    /// Vertical field of view in degrees (perspective).
    pub fov_y: f64,
    /// World mm; the volume's centre unless told.
    pub target: Option<DVec3>,
}

impl Default for Orbit {
    fn default() -> Self {
        Self {
            projection: Projection::Parallel,
            azimuth: 0.0,
            elevation: 0.0,
            roll: 0.0,
            zoom: 1.0,
            fov_y: 30.0,
            target: None,
        }
    }
}

/// A camera at a position.
#[derive(Clone, Debug, PartialEq)]
pub struct LookAt {
    pub projection: Projection,
    /// World mm.
    pub position: DVec3,
    pub target: DVec3,
    pub up: DVec3,
    /// Height of the image in mm (parallel); twice the volume's radius unless told.
    pub view_height: Option<f64>,
    /// Vertical field of view in degrees (perspective).
    pub fov_y: f64,
}

/// Why a camera gives no view.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ViewError {
    #[error("position and target must differ, and up must not point along the line of sight")]
    Degenerate,
    #[error("the view matrix must be rigid: a rotation and a translation")]
    NotRigid,
    #[error(
        "the projection matrix must be invertible and either parallel (last row 0 0 0 1) or a perspective one (last row 0 0 -1 0)"
    )]
    Projection,
}

impl ViewError {
    /// The field at fault, as a JSON pointer below `camera`.
    pub fn pointer(&self) -> &'static str {
        match self {
            Self::Degenerate => "/look_at",
            Self::NotRigid => "/matrices/view",
            Self::Projection => "/matrices/projection",
        }
    }
}

/// A ray in world mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    pub origin: DVec3,
    /// Of unit length.
    pub direction: DVec3,
}

/// Half of world space: points with `normal . p + offset >= 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    pub normal: DVec3,
    pub offset: f64,
}

impl HalfSpace {
    /// The other half.
    pub fn other(&self) -> Self {
        Self { normal: -self.normal, offset: -self.offset }
    }
}

/// What of a span has `distance + t rate >= 0`; it ends before it begins where that is nothing.
#[inline(always)]
pub fn cut([enter, leave]: [f64; 2], distance: f64, rate: f64) -> [f64; 2] {
    if rate > 0.0 {
        [enter.max(-distance / rate), leave]
    } else if rate < 0.0 {
        [enter, leave.min(-distance / rate)]
    } else if distance < 0.0 {
        [enter, f64::NEG_INFINITY]
    } else {
        [enter, leave]
    }
}

/// A ball of world space or, in the space of a volume's indices, what becomes of one: points that `unit_from_space` takes
/// within 1 of the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    unit_from_space: DAffine3,
}

impl Ball {
    /// `radius` above 0.
    pub fn new(centre: DVec3, radius: f64) -> Self {
        Self { unit_from_space: DAffine3::from_scale(DVec3::splat(1.0 / radius)) * DAffine3::from_translation(-centre) }
    }

    /// The same ball where points are told by other coordinates.
    pub fn told_by(&self, space_from_other: DAffine3) -> Self {
        Self { unit_from_space: self.unit_from_space * space_from_other }
    }

    /// The space in which it is the unit ball, from its own.
    pub fn unit_from_space(&self) -> DAffine3 {
        self.unit_from_space
    }

    /// Half-spaces along the axes that hold it as closely as they can.
    pub fn bounds(&self) -> [HalfSpace; 6] {
        let space_from_unit = self.unit_from_space.inverse();
        let centre = space_from_unit.translation;
        let rows = space_from_unit.matrix3.transpose();
        let sides = [(DVec3::X, rows.x_axis), (DVec3::Y, rows.y_axis), (DVec3::Z, rows.z_axis)].map(|(axis, row)| {
            let (middle, reach) = (axis.dot(centre), row.length());
            [HalfSpace { normal: axis, offset: reach - middle }, HalfSpace { normal: -axis, offset: reach + middle }]
        });
        let [[a, b], [c, d], [e, f]] = sides;
        [a, b, c, d, e, f]
    }

    /// Where `start + t step` enters and leaves it; the first above the second where it does not.
    #[inline(always)]
    pub fn span(&self, start: DVec3, step: DVec3) -> [f64; 2] {
        let from = self.unit_from_space.transform_point3(start);
        let along = self.unit_from_space.transform_vector3(step);
        let (a, b, c) = (along.length_squared(), from.dot(along), from.length_squared() - 1.0);
        let root = (b * b - a * c).max(-1.0);
        if root < 0.0 || a == 0.0 {
            return if a == 0.0 && c <= 0.0 { [f64::NEG_INFINITY, f64::INFINITY] } else { [1.0, 0.0] };
        }
        [(-b - root.sqrt()) / a, (-b + root.sqrt()) / a]
    }
}

/// What cuts something of the volume away: all that lies outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clip {
    pub halves: Vec<HalfSpace>,
    pub balls: Vec<Ball>,
}

impl Clip {
    /// True where nothing is cut away.
    pub fn is_empty(&self) -> bool {
        self.halves.is_empty() && self.balls.is_empty()
    }

    /// The convex hull of points; `None` where they lie in one plane. Takes time by the fourth power of their number.
    pub fn hull(points: &[DVec3]) -> Option<Self> {
        let centre = points.iter().sum::<DVec3>() / points.len() as f64;
        let size = points.iter().map(|point| point.distance(centre)).fold(0.0, f64::max);
        let tolerance = 1e-9 * size;
        let mut sides: Vec<(DVec3, DVec3)> = vec![];
        for (a, &first) in points.iter().enumerate() {
            for (b, &second) in points.iter().enumerate().skip(a + 1) {
                for &third in &points[b + 1..] {
                    let normal = (second - first).cross(third - first);
                    if normal.length() <= 1e-9 * size * size {
                        continue;
                    }
                    // A side, if all points lie on one side of it; inwards is where the middle is. Distances are told from
                    // one of its points, for the origin may be far away.
                    let normal = normal.normalize() * normal.dot(centre - first).signum();
                    let distance = |(normal, on): (DVec3, DVec3), point: DVec3| normal.dot(point - on);
                    let is_side = points.iter().all(|point| distance((normal, first), *point) >= -tolerance);
                    let is_new = !sides.iter().any(|&other| {
                        [first, second, third].into_iter().all(|point| distance(other, point).abs() <= tolerance)
                    });
                    if is_side && is_new {
                        sides.push((normal, first));
                    }
                }
            }
        }
        let half = |&(normal, on): &(DVec3, DVec3)| HalfSpace { normal, offset: -normal.dot(on) };
        (sides.len() >= 4).then(|| Self { halves: sides.iter().map(half).collect(), balls: vec![] })
    }

    /// The same where points are told by other coordinates.
    pub fn told_by(&self, space_from_other: DAffine3) -> Self {
        let half = |half: &HalfSpace| HalfSpace {
            normal: space_from_other.matrix3.transpose() * half.normal,
            offset: half.normal.dot(space_from_other.translation) + half.offset,
        };
        Self {
            halves: self.halves.iter().map(half).collect(),
            balls: self.balls.iter().map(|ball| ball.told_by(space_from_other)).collect(),
        }
    }

    /// What of a span of `start + t step` is left; it ends before it begins where that is nothing.
    #[inline(always)]
    pub fn span(&self, start: DVec3, step: DVec3, [mut enter, mut leave]: [f64; 2]) -> [f64; 2] {
        for half in &self.halves {
            [enter, leave] = cut([enter, leave], half.normal.dot(start) + half.offset, half.normal.dot(step));
        }
        for ball in &self.balls {
            let [first, last] = ball.span(start, step);
            (enter, leave) =
                if first > last { (enter, f64::NEG_INFINITY) } else { (enter.max(first), leave.min(last)) };
        }
        [enter, leave]
    }
}

/// The rays of an image. Pixel coordinates are continuous: column `i` has its centre at `i + 0.5`,
/// row 0 is on top.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    width: u32,
    height: u32,
    rays: Rays,
    /// Unit vector from the eye into the picture, perpendicular to the image plane.
    forward: DVec3,
    /// Near and far planes of a camera told by matrices, and what else is cut away.
    clip: Clip,
    /// Opaque geometry.
    depth: Option<Arc<SceneDepth>>,
    /// Which pieces of the rays are meant, where not all are.
    layer: Option<Arc<Layer>>,
}

/// Rays, linear in the pixel coordinates; world mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rays {
    /// From `corner + x dx + y dy` along `direction` (unit).
    Parallel { corner: DVec3, dx: DVec3, dy: DVec3, direction: DVec3 },
    /// From `eye` along `corner + x dx + y dy`.
    Perspective { eye: DVec3, corner: DVec3, dx: DVec3, dy: DVec3 },
}

impl Rays {
    fn is_finite(&self) -> bool {
        let vectors = match *self {
            Self::Parallel { corner, dx, dy, direction } => [corner, dx, dy, direction],
            Self::Perspective { eye, corner, dx, dy } => [eye, corner, dx, dy],
        };
        vectors.iter().all(|vector| vector.is_finite())
    }
}

impl View {
    /// The view of `camera` on a volume with this `centre` and `radius` (world mm), as an image of
    /// `width` x `height` pixels.
    ///
    /// # Errors
    /// Where the camera's vectors or matrices are degenerate.
    pub fn new(camera: &Camera, centre: DVec3, radius: f64, width: u32, height: u32) -> Result<Self, ViewError> {
        match camera {
            Camera::Orbit(orbit) => Ok(Self::from_orbit(orbit, centre, radius, width, height)),
            Camera::LookAt(look) => Self::from_look_at(look, radius, width, height),
            Camera::Matrices { view, projection } => Self::from_matrices(view, projection, width, height),
        }
    }

    fn from_orbit(orbit: &Orbit, centre: DVec3, radius: f64, width: u32, height: u32) -> Self {
        let (sin_a, cos_a) = exact_sin_cos(orbit.azimuth);
        let (sin_e, cos_e) = exact_sin_cos(orbit.elevation);
        let (sin_r, cos_r) = exact_sin_cos(orbit.roll);
        let back = DVec3::new(sin_a * cos_e, -cos_a * cos_e, sin_e);
        let up = DVec3::new(-sin_a * sin_e, cos_a * sin_e, cos_e);
        let right = (-back).cross(up);
        let (right, up) = (right * cos_r + up * sin_r, up * cos_r - right * sin_r);
        let target = orbit.target.unwrap_or(centre);
        let tan_half = (orbit.fov_y.to_radians() / 2.0).tan();
        let (eye, half_height) = match orbit.projection {
            Projection::Parallel => (target + back * (4.0 * radius), radius / orbit.zoom),
            Projection::Perspective => {
                let distance = radius / (orbit.fov_y.to_radians() / 2.0).sin();
                (target + back * distance, tan_half / orbit.zoom)
            }
        };
        Self::from_basis(orbit.projection, eye, [right, up, -back], half_height, width, height)
    }

    fn from_look_at(look: &LookAt, radius: f64, width: u32, height: u32) -> Result<Self, ViewError> {
        let forward = (look.target - look.position).try_normalize().ok_or(ViewError::Degenerate)?;
        let up = look.up.try_normalize().ok_or(ViewError::Degenerate)?;
        let across = forward.cross(up);
        if across.length() < 1e-6 {
            return Err(ViewError::Degenerate);
        }
        let right = across.normalize();
        let half_height = match look.projection {
            Projection::Parallel => look.view_height.unwrap_or(2.0 * radius) / 2.0,
            Projection::Perspective => (look.fov_y.to_radians() / 2.0).tan(),
        };
        let basis = [right, right.cross(forward), forward];
        Ok(Self::from_basis(look.projection, look.position, basis, half_height, width, height))
    }

    /// `half_height` is in mm for parallel rays, at distance 1 for perspective ones.
    fn from_basis(
        projection: Projection,
        eye: DVec3,
        [right, up, forward]: [DVec3; 3],
        half_height: f64,
        width: u32,
        height: u32,
    ) -> Self {
        let half_width = half_height * f64::from(width) / f64::from(height);
        let dx = right * (2.0 * half_width / f64::from(width));
        let dy = up * (-2.0 * half_height / f64::from(height));
        let corner = up * half_height - right * half_width;
        let rays = match projection {
            Projection::Parallel => Rays::Parallel { corner: eye + corner, dx, dy, direction: forward },
            Projection::Perspective => Rays::Perspective { eye, corner: forward + corner, dx, dy },
        };
        Self { width, height, rays, forward, clip: Clip::default(), depth: None, layer: None }
    }

    fn from_matrices(view: &DMat4, projection: &DMat4, width: u32, height: u32) -> Result<Self, ViewError> {
        let rotation = DMat3::from_mat4(*view);
        let rigid = view.is_finite()
            && (view.row(3) - DVec4::W).abs().max_element() < 1e-6
            && (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array().iter().all(|e| e.abs() < 1e-4)
            && rotation.determinant() > 0.0;
        if !rigid {
            return Err(ViewError::NotRigid);
        }
        let last = projection.row(3);
        let scale = last.abs().max_element();
        let parallel = last.truncate().abs().max_element() <= 1e-9 * scale && last.w > 0.0;
        let perspective = last.x.abs().max(last.y.abs()).max(last.w.abs()) <= 1e-9 * scale && last.z < 0.0;
        let inverse = projection.inverse();
        if !(projection.is_finite() && inverse.is_finite() && (parallel || perspective)) {
            return Err(ViewError::Projection);
        }
        // The plane of rays: any depth in clip space does, all its points lie on the pixel's ray. They
        // may be infinitely far, so perspective rays are found from homogeneous points.
        let world_from_camera = view.inverse();
        let homogeneous = |x: f64, y: f64, z: f64| inverse * DVec4::new(x, y, z, 1.0);
        let corners = [[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0]].map(|[x, y]| homogeneous(x, y, 0.0));
        let forward = world_from_camera.transform_vector3(DVec3::NEG_Z);
        let rays = if parallel {
            let [left_top, right_top, left_bottom] = corners.map(|corner| corner.truncate() / corner.w);
            let near = homogeneous(-1.0, 1.0, -1.0);
            let towards = left_top - near.truncate() / near.w;
            let towards = world_from_camera.transform_vector3(towards * towards.dot(DVec3::NEG_Z).signum());
            Rays::Parallel {
                corner: world_from_camera.transform_point3(left_top),
                dx: world_from_camera.transform_vector3(right_top - left_top) / f64::from(width),
                dy: world_from_camera.transform_vector3(left_bottom - left_top) / f64::from(height),
                direction: towards.try_normalize().ok_or(ViewError::Projection)?,
            }
        } else {
            // On the plane at distance 1 in front of the eye, whatever the sign of the depth mapping.
            let [left_top, right_top, left_bottom] = corners.map(|corner| corner.truncate() / -corner.z);
            Rays::Perspective {
                eye: world_from_camera.transform_point3(DVec3::ZERO),
                corner: world_from_camera.transform_vector3(left_top),
                dx: world_from_camera.transform_vector3(right_top - left_top) / f64::from(width),
                dy: world_from_camera.transform_vector3(left_bottom - left_top) / f64::from(height),
            }
        };
        if !rays.is_finite() {
            return Err(ViewError::Projection);
        }
        let clip_from_world = *projection * *view;
        let (z, w) = (clip_from_world.row(2), clip_from_world.row(3));
        let halves = [w + z, w - z].map(|p| HalfSpace { normal: p.truncate(), offset: p.w }).to_vec();
        let clip = Clip { halves, balls: vec![] };
        Ok(Self { width, height, rays, forward, clip, depth: None, layer: None })
    }

    /// Pixels across and down.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// The rays' equations.
    pub fn rays(&self) -> &Rays {
        &self.rays
    }

    /// Parallel or perspective.
    pub fn projection(&self) -> Projection {
        match self.rays {
            Rays::Parallel { .. } => Projection::Parallel,
            Rays::Perspective { .. } => Projection::Perspective,
        }
    }

    /// Unit vector into the picture, perpendicular to the image plane.
    pub fn forward(&self) -> DVec3 {
        self.forward
    }

    /// The same view of what lies inside, besides what it keeps to already.
    pub fn clipped(mut self, clip: &Clip) -> Self {
        self.clip.halves.extend_from_slice(&clip.halves);
        self.clip.balls.extend_from_slice(&clip.balls);
        self
    }

    /// The same view with rays that end at opaque geometry, which was measured along this view's rays.
    pub fn ending_at(mut self, depth: Arc<SceneDepth>) -> Self {
        self.depth = Some(depth);
        self
    }

    /// The same view of some pieces of its rays.
    pub(super) fn of_layer(mut self, layer: Arc<Layer>) -> Self {
        self.layer = Some(layer);
        self
    }

    /// Which pieces of the rays are meant, where not all are.
    pub fn layer(&self) -> Option<&Layer> {
        self.layer.as_deref()
    }

    /// Where rays end at opaque geometry, if there is any.
    pub fn depth(&self) -> Option<&Arc<SceneDepth>> {
        self.depth.as_ref()
    }

    /// What is seen must lie inside.
    pub fn clip(&self) -> &Clip {
        &self.clip
    }

    /// Width of a pixel where the view passes a point, mm; in perspective, 0 for a point that is not in front of the eye.
    pub fn pixel_size(&self, point: DVec3) -> f64 {
        match self.rays {
            Rays::Parallel { dx, .. } => dx.length(),
            Rays::Perspective { eye, corner, dx, .. } => {
                let distance = self.forward.dot(point - eye) / self.forward.dot(corner);
                dx.length() * distance.max(0.0)
            }
        }
    }

    /// Where rays begin, mm from their origins: under parallel projection all is in front of the viewer.
    pub fn nearest(&self) -> f64 {
        match self.projection() {
            Projection::Parallel => f64::NEG_INFINITY,
            Projection::Perspective => 0.0,
        }
    }

    /// The ray through pixel coordinates `at`.
    pub fn ray(&self, at: DVec2) -> Ray {
        match self.rays {
            Rays::Parallel { corner, dx, dy, direction } => Ray { origin: corner + dx * at.x + dy * at.y, direction },
            Rays::Perspective { eye, corner, dx, dy } => {
                Ray { origin: eye, direction: (corner + dx * at.x + dy * at.y).normalize() }
            }
        }
    }
}

/// Sine and cosine of degrees, exact at multiples of 90, so that axis-aligned views have no shear.
fn exact_sin_cos(degrees: f64) -> (f64, f64) {
    let turn = degrees.rem_euclid(360.0);
    if turn == 0.0 {
        (0.0, 1.0)
    } else if turn == 90.0 {
        (1.0, 0.0)
    } else if turn == 180.0 {
        (0.0, -1.0)
    } else if turn == 270.0 {
        (-1.0, 0.0)
    } else {
        turn.to_radians().sin_cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera at (3, -80, 7) that looks along y, and a projection by columns.
    fn matrices(columns: [[f64; 4]; 4]) -> Result<View, ViewError> {
        let rotation = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y);
        let view = DMat4::from_mat3(rotation) * DMat4::from_translation(DVec3::new(-3.0, 80.0, -7.0));
        let projection = DMat4::from_cols_array_2d(&columns);
        View::new(&Camera::Matrices { view, projection }, DVec3::ZERO, 50.0, 64, 48)
    }

    fn perspective(depth: [f64; 2]) -> Result<View, ViewError> {
        matrices([[1.5, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0], [0.1, -0.2, depth[0], -1.0], [0.0, 0.0, depth[1], 0.0]])
    }

    #[test]
    fn a_hull_has_the_sides_of_its_points() {
        let corners = [0, 1, 2, 3, 4, 5, 6, 7].map(|n| {
            DVec3::new(f64::from(n & 1), f64::from(n >> 1 & 1) * 2.0, f64::from(n >> 2) * 3.0)
                + DVec3::new(5.0, -7.0, 100.0)
        });
        let inner = corners.iter().sum::<DVec3>() / 8.0;
        let cube = Clip::hull(&[&corners[..], &[inner, (corners[0] + corners[1]) / 2.0]].concat()).unwrap();
        assert_eq!(cube.halves.len(), 6);
        let span = |hull: &Clip, from: DVec3, along: DVec3| hull.span(from, along, [f64::NEG_INFINITY, f64::INFINITY]);
        for (axis, size) in [(DVec3::X, 1.0), (DVec3::Y, 2.0), (DVec3::Z, 3.0)] {
            let [enter, leave] = span(&cube, inner, axis);
            assert!((enter + size / 2.0).abs() < 1e-9 && (leave - size / 2.0).abs() < 1e-9);
        }
        let simplex = Clip::hull(&corners[..3].iter().chain(&corners[4..5]).copied().collect::<Vec<_>>()).unwrap();
        assert_eq!(simplex.halves.len(), 4);
        for far in [1e5, 1e7] {
            let moved = corners.map(|corner| corner + DVec3::splat(far));
            assert_eq!(Clip::hull(&moved).unwrap().halves.len(), 6, "{far} mm away");
        }
        for flat in [&corners[..4], &corners[..2], &[inner; 9], &[]] {
            assert_eq!(Clip::hull(flat), None);
        }
    }

    #[test]
    fn a_projections_rays_do_not_depend_on_how_it_maps_depth() {
        let (near, far) = (2.0, 300.0);
        let usual = perspective([(far + near) / (near - far), 2.0 * far * near / (near - far)]).unwrap();
        let reversed = perspective([(far + near) / (far - near), 2.0 * far * near / (far - near)]).unwrap();
        // Infinitely far planes: at depth 1, and at depth 0, where the middle of clip space is.
        let infinite = perspective([-1.0, -2.0 * near]).unwrap();
        let reversed_infinite = perspective([0.0, near]).unwrap();
        for at in [DVec2::ZERO, DVec2::new(20.5, 7.5), DVec2::new(64.0, 48.0)] {
            let Ray { origin, direction } = usual.ray(at);
            assert!((origin - DVec3::new(3.0, -80.0, 7.0)).length() < 1e-9);
            for other in [&reversed, &infinite, &reversed_infinite] {
                assert!((other.ray(at).direction - direction).length() < 1e-9, "{at}: {other:?}");
            }
        }
        // Clip coordinates of the middle of the picture, off the centre by the third column.
        let expected = DVec3::new(0.1 / 1.5, 1.0, -0.2 / 2.0).normalize();
        assert!((usual.ray(DVec2::new(32.0, 24.0)).direction - expected).length() < 1e-9);
    }

    #[test]
    fn matrices_without_finite_rays_are_refused() {
        for (x, w) in [(0.0, 1.0), (1e-320, 1.0), (1e-308, 1.0), (1.0, 0.0)] {
            let columns = [[x, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, w]];
            assert_eq!(matrices(columns), Err(ViewError::Projection), "{x} {w}");
        }
    }
}
