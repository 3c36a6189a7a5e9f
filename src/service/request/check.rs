//! Fields -> [`RenderRequest`]: ranges, and what goes with what.
//!
//! Every check runs and reports; the request is there only where none complained.

use std::ops::{Bound, RangeBounds, RangeInclusive};

use glam::{DAffine3, DMat3, DMat4, DVec3, DVec4};

use super::fields::{
    Blend, BoxFields, CameraFields, ClipFields, DepthCueingFields, Either, Fields, GeometryFields, HullFields,
    ImageFields, Keep, LabelFields, LabelsFields, LightFields, LightName, LookAtFields, MatricesFields, PlaneFields,
    PreintegrationFields, RegionFields, ShadingFields, SphereFields, WindowFields,
};
use super::{
    AlgorithmChoice, GeometryRequest, InvalidField, LabelRequest, LabelsRequest, RegionRequest, RenderRequest,
    ShadingChoice, Spelling, Transfer,
};
use crate::classify::{Color, TransferFunction};
use crate::encode::{Format, Unfit};
use crate::render::regions::MAX_REGIONS;
use crate::render::{
    Background, Ball, Camera, Clip, DepthCueing, HalfSpace, IntensityProjection, Light, LookAt, Orbit, Preintegration,
    Projection, Quality, Shading, SlabTable,
};

/// Degrees: beyond, a float's steps show as jumps of the camera.
const ANGLE: RangeInclusive<f64> = -1e6..=1e6;
const ZOOM: RangeInclusive<f64> = 1e-3..=1e3;
/// Degrees: at 180 the image plane is infinite.
const FOV_Y: RangeInclusive<f64> = 1.0..=170.0;
/// World mm: a thousand kilometres, far from where squares overflow.
const POSITION: RangeInclusive<f64> = -1e9..=1e9;
const VIEW_HEIGHT: RangeInclusive<f64> = 1e-6..=1e9;
const MATRIX_ELEMENT: RangeInclusive<f64> = -1e12..=1e12;
/// Ambient, diffuse, specular, and a light's intensity: the sum is clamped to white anyway.
const COEFFICIENT: RangeInclusive<f64> = 0.0..=10.0;
const SHININESS: RangeInclusive<f64> = 0.0..=1000.0;
const MAX_LIGHTS: usize = 8;
const EARLY_RAY_TERMINATION: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Included(1.0));
const MIN_OPACITY: std::ops::Range<f64> = 0.0..1.0;
/// Smallest spacings: finer is a long wait for nothing, coarser skips the volume.
const SAMPLE_DISTANCE: RangeInclusive<f64> = 0.01..=8.0;
/// More than the levels of any volume, which say how many they are.
const LEVEL: RangeInclusive<f64> = 0.0..=16.0;
/// Window centres and widths: any value of a file, and widths above what divides to infinity.
const WINDOW_CENTER: RangeInclusive<f64> = -1e12..=1e12;
const WINDOW_WIDTH: RangeInclusive<f64> = 1e-6..=1e12;
const CUE_FRONT: RangeInclusive<f64> = 0.0..=10.0;
const CUE_DENSITY: RangeInclusive<f64> = 0.0..=100.0;
/// Of a two-dimensional table. 1024 take 16 MiB, as much as a large image in the making; more would tell 12-bit
/// values apart no better, between which a lookup interpolates.
const ENTRIES: RangeInclusive<f64> = 2.0..=1024.0;
/// Beyond, slabs are shorter than what 8-bit pixels tell apart.
const SAMPLES_PER_VOXEL: RangeInclusive<f64> = 1.0..=8.0;
/// Labels of a segmentation that something is told of.
const MAX_LABELS: usize = 64;
/// Points of a convex hull. Its sides are found by trying all planes through three of them.
const MAX_HULL: usize = 32;
/// Of a sphere, mm.
const RADIUS: RangeInclusive<f64> = 1e-3..=1e9;
/// Regions that cut something away; a box is six half-spaces.
const MAX_CLIP: usize = 16;
/// Regions that look otherwise. Pieces of rays within and between them are drawn layer by layer.
const MAX_SHOWN_REGIONS: usize = 4;
const _: () = assert!(MAX_CLIP + MAX_SHOWN_REGIONS <= MAX_REGIONS);
const REGION_OPACITY: RangeInclusive<f64> = 0.0..=1.0;
/// Meshes in one frame.
const MAX_GEOMETRY: usize = 32;
/// Of a mesh whose colour is not told.
const MESH_COLOR: Color = Color([0.8; 3]);
const DEFAULT_SIDE: u32 = 512;

pub const NO_AZIMUTH: &str = "expected an orbit camera: frames around the vertical axis start from its azimuth";

/// The request that the fields make.
///
/// # Errors
/// Every field at fault.
pub fn check(fields: Fields) -> Result<RenderRequest, Vec<InvalidField>> {
    let mut refusals = Refusals(vec![]);
    refusals.options_of_algorithms(&fields);
    let camera = refusals.camera(&fields.camera);
    let (width, height, format, background) = refusals.image(&fields.image);
    let transfer = refusals.transfer("", fields.transfer_function);
    let shading = refusals.shading("", fields.shading);
    refusals.range("/early_ray_termination", fields.early_ray_termination, EARLY_RAY_TERMINATION);
    refusals.range("/min_opacity", fields.min_opacity, MIN_OPACITY);
    refusals.range("/sample_distance", fields.sample_distance, SAMPLE_DISTANCE);
    refusals.range("/level", fields.level.map(f64::from), LEVEL);
    let projection = projection(fields.blend.unwrap_or(Blend::Composite));
    let window = refusals.window("", projection, fields.window);
    let preintegration = refusals.preintegration(fields.quality, fields.preintegration.as_ref());
    let depth_cueing = fields.depth_cueing.as_ref().map(|cueing| refusals.depth_cueing(cueing));
    let (clip, cut_out) = refusals.clip(fields.clip.unwrap_or_default());
    let labels = fields.labels.map(|labels| refusals.labels(labels));
    let geometry = refusals.geometry(fields.geometry.unwrap_or_default());
    let regions = refusals.regions(fields.regions.unwrap_or_default(), projection, fields.algorithm);
    let request = RenderRequest {
        camera,
        width,
        height,
        format,
        background,
        stage: fields.image.stage,
        transfer,
        shading,
        algorithm: fields.algorithm,
        quality: fields.quality,
        early_ray_termination: fields.early_ray_termination,
        min_opacity: fields.min_opacity,
        sample_distance: fields.sample_distance,
        level: fields.level,
        sampling: fields.sampling,
        projection,
        window,
        preintegration,
        depth_cueing,
        clip,
        cut_out,
        regions,
        labels,
        geometry,
        spelling: Spelling::Json,
    };
    if refusals.0.is_empty() { Ok(request) } else { Err(refusals.0) }
}

/// Whether `format` holds the image.
///
/// # Errors
/// The field at fault.
pub fn fit(format: Format, width: u32, height: u32, alpha: bool) -> Result<(), InvalidField> {
    format.holds(width, height, alpha).map_err(|unfit| {
        let pointer = match unfit {
            Unfit::Alpha => "/image/background",
            Unfit::Side { .. } if width >= height => "/image/width",
            Unfit::Side { .. } => "/image/height",
        };
        InvalidField { pointer: pointer.into(), detail: unfit.to_string() }
    })
}

/// What a blend projects; `None`: it composites.
fn projection(blend: Blend) -> Option<IntensityProjection> {
    match blend {
        Blend::Composite => None,
        Blend::Maximum => Some(IntensityProjection::Maximum),
        Blend::Minimum => Some(IntensityProjection::Minimum),
        Blend::Average => Some(IntensityProjection::Average),
    }
}

/// What was wrong so far.
struct Refusals(Vec<InvalidField>);

impl Refusals {
    fn refuse(&mut self, pointer: impl Into<String>, detail: impl Into<String>) {
        self.0.push(InvalidField { pointer: pointer.into(), detail: detail.into() });
    }

    /// Refuses what is there and out of range.
    fn range(&mut self, pointer: impl Into<String>, value: Option<f64>, range: impl RangeBounds<f64>) {
        if let Some(got) = value.filter(|v| !range.contains(v)) {
            let end = |bound: Bound<&f64>, excluded: &str| match bound {
                Bound::Included(end) => format!("{end}"),
                Bound::Excluded(end) => format!("{excluded} {end}"),
                Bound::Unbounded => "any".into(),
            };
            let (low, high) = (end(range.start_bound(), "above"), end(range.end_bound(), "below"));
            self.refuse(pointer, format!("expected {low} to {high}, got {got}"));
        }
    }

    /// Refuses elements out of range, each by its index.
    fn elements(&mut self, pointer: &str, values: &[f64], range: &RangeInclusive<f64>) {
        for (index, value) in values.iter().enumerate() {
            self.range(format!("{pointer}/{index}"), Some(*value), range.clone());
        }
    }

    fn vector(&mut self, pointer: &str, vector: [f64; 3]) -> DVec3 {
        self.elements(pointer, &vector, &POSITION);
        DVec3::from_array(vector)
    }

    fn camera(&mut self, camera: &CameraFields) -> Camera {
        let orbit_fields = [
            ("azimuth", camera.azimuth.is_some()),
            ("elevation", camera.elevation.is_some()),
            ("roll", camera.roll.is_some()),
            ("zoom", camera.zoom.is_some()),
            ("target", camera.target.is_some()),
        ];
        let told_by = match (&camera.look_at, &camera.matrices) {
            (None, None) => None,
            (Some(_), _) => Some("look_at"),
            (None, Some(_)) => Some("matrices"),
        };
        if let Some(told_by) = told_by {
            for (name, _) in orbit_fields.iter().filter(|(_, there)| *there) {
                self.refuse(
                    format!("/camera/{name}"),
                    format!("belongs to an orbit, but the camera is told by {told_by}"),
                );
            }
        }
        self.range("/camera/fov_y", camera.fov_y, FOV_Y);
        self.range("/camera/view_height", camera.view_height, VIEW_HEIGHT);
        if camera.view_height.is_some() && camera.look_at.is_none() {
            self.refuse("/camera/view_height", "belongs to look_at; an orbit has zoom");
        }
        match (&camera.look_at, &camera.matrices) {
            (Some(_), Some(_)) => {
                self.refuse("/camera/matrices", "expected one of orbit, look_at and matrices, got two");
                Camera::Orbit(Orbit::default())
            }
            (Some(look), None) => Camera::LookAt(self.look_at(camera, look)),
            (None, Some(matrices)) => self.matrices(camera, matrices),
            (None, None) => Camera::Orbit(self.orbit(camera)),
        }
    }

    fn orbit(&mut self, camera: &CameraFields) -> Orbit {
        let default = Orbit::default();
        self.range("/camera/azimuth", camera.azimuth, ANGLE);
        self.range("/camera/elevation", camera.elevation, ANGLE);
        self.range("/camera/roll", camera.roll, ANGLE);
        self.range("/camera/zoom", camera.zoom, ZOOM);
        Orbit {
            projection: camera.projection.map_or(default.projection, Projection::from),
            azimuth: camera.azimuth.unwrap_or(default.azimuth),
            elevation: camera.elevation.unwrap_or(default.elevation),
            roll: camera.roll.unwrap_or(default.roll),
            zoom: camera.zoom.unwrap_or(default.zoom),
            fov_y: camera.fov_y.unwrap_or(default.fov_y),
            target: camera.target.map(|target| self.vector("/camera/target", target)),
        }
    }

    fn look_at(&mut self, camera: &CameraFields, look: &LookAtFields) -> LookAt {
        let default = Orbit::default();
        LookAt {
            projection: camera.projection.map_or(default.projection, Projection::from),
            position: self.vector("/camera/look_at/position", look.position),
            target: self.vector("/camera/look_at/target", look.target),
            up: look.up.map_or(DVec3::Z, |up| self.vector("/camera/look_at/up", up)),
            view_height: camera.view_height,
            fov_y: camera.fov_y.unwrap_or(default.fov_y),
        }
    }

    fn matrices(&mut self, camera: &CameraFields, matrices: &MatricesFields) -> Camera {
        for (name, there) in [("projection", camera.projection.is_some()), ("fov_y", camera.fov_y.is_some())] {
            if there {
                self.refuse(format!("/camera/{name}"), "the projection matrix says it already");
            }
        }
        self.elements("/camera/matrices/view", &matrices.view, &MATRIX_ELEMENT);
        self.elements("/camera/matrices/projection", &matrices.projection, &MATRIX_ELEMENT);
        Camera::Matrices {
            view: DMat4::from_cols_array(&matrices.view),
            projection: DMat4::from_cols_array(&matrices.projection),
        }
    }

    fn image(&mut self, image: &ImageFields) -> (u32, u32, Option<Format>, Background) {
        let (width, height) = (image.width.unwrap_or(DEFAULT_SIDE), image.height.unwrap_or(DEFAULT_SIDE));
        for (name, side) in [("width", width), ("height", height)] {
            if side == 0 {
                self.refuse(format!("/image/{name}"), "expected at least 1 pixel, got 0");
            }
        }
        let background = match image.background.as_deref() {
            None => Background::Opaque([0.0; 3]),
            Some("transparent") => Background::Transparent,
            Some(text) => match Color::from_hex(text) {
                Some(Color(color)) => Background::Opaque(color),
                None => {
                    self.refuse("/image/background", "expected \"#rrggbb\" or \"transparent\"");
                    Background::Transparent
                }
            },
        };
        let format = image.format.as_deref().and_then(|name| {
            let format = Format::from_name(name);
            if format.is_none() {
                let names = Format::ALL.map(Format::name).join(", ");
                self.refuse("/image/format", format!("expected one of {names}"));
            }
            format
        });
        if let Some(Err(field)) = format.map(|f| fit(f, width, height, background == Background::Transparent)) {
            self.0.push(field);
        }
        (width, height, format, background)
    }

    /// `place` is a pointer to what holds the transfer function; here and below.
    fn transfer(&mut self, place: &str, transfer: Option<Either<String, TransferFunction>>) -> Transfer {
        match transfer {
            None => Transfer::Automatic,
            Some(Either::Short(name)) => Transfer::Preset(name),
            Some(Either::Full(transfer)) => {
                for field in transfer.validate() {
                    self.refuse(format!("{place}/transfer_function{}", field.pointer), field.detail);
                }
                Transfer::Given(transfer)
            }
        }
    }

    fn shading(&mut self, place: &str, shading: Option<Either<bool, ShadingFields>>) -> ShadingChoice {
        let fields = match shading {
            None => return ShadingChoice::Automatic,
            Some(Either::Short(false)) => return ShadingChoice::Off,
            Some(Either::Short(true)) => return ShadingChoice::On(Shading::default()),
            Some(Either::Full(fields)) => fields,
        };
        let default = Shading::default();
        self.range(format!("{place}/shading/ambient"), fields.ambient, COEFFICIENT);
        self.range(format!("{place}/shading/diffuse"), fields.diffuse, COEFFICIENT);
        self.range(format!("{place}/shading/specular"), fields.specular, COEFFICIENT);
        self.range(format!("{place}/shading/shininess"), fields.shininess, SHININESS);
        let lights = fields.lights.map_or(default.lights, |lights| {
            if lights.len() > MAX_LIGHTS {
                let detail = format!("expected at most {MAX_LIGHTS} lights, got {}", lights.len());
                self.refuse(format!("{place}/shading/lights"), detail);
            }
            let light = |(index, light)| self.light(&format!("{place}/shading/lights/{index}"), light);
            let lights: Vec<_> = lights.iter().enumerate().map(light).collect();
            self.shadows(place, &lights);
            lights
        });
        ShadingChoice::On(Shading {
            ambient: fields.ambient.unwrap_or(default.ambient),
            diffuse: fields.diffuse.unwrap_or(default.diffuse),
            specular: fields.specular.unwrap_or(default.specular),
            shininess: fields.shininess.unwrap_or(default.shininess),
            lights,
        })
    }

    /// One light casts shadows at most, and it is one of the frame's own.
    fn shadows(&mut self, place: &str, lights: &[Light]) {
        let (allowed, detail) = match place {
            "" => (1, "one light casts shadows at most, and another does"),
            _ => (0, "regions that look otherwise are not in shadow"),
        };
        let casts = |light: &Light| matches!(light, Light::Directional { shadows: true, .. });
        let casting = lights.iter().enumerate().filter(|(_, light)| casts(light));
        for (index, _) in casting.skip(allowed) {
            self.refuse(format!("{place}/shading/lights/{index}/shadows"), detail);
        }
    }

    fn light(&mut self, pointer: &str, light: &Either<LightName, LightFields>) -> Light {
        let light = match light {
            Either::Short(LightName::Headlight) => return Light::Headlight,
            Either::Full(light) => light,
        };
        self.range(format!("{pointer}/intensity"), light.intensity, COEFFICIENT);
        let direction = self.vector(&format!("{pointer}/direction"), light.direction).try_normalize();
        if direction.is_none() {
            self.refuse(format!("{pointer}/direction"), "expected a direction of length above 0");
        }
        Light::Directional {
            direction: direction.unwrap_or(DVec3::Z),
            intensity: light.intensity.unwrap_or(1.0),
            shadows: light.shadows.unwrap_or(false),
        }
    }

    fn window(
        &mut self,
        place: &str,
        projection: Option<IntensityProjection>,
        window: Option<WindowFields>,
    ) -> WindowFields {
        if projection.is_none() && window.is_some() {
            self.refuse(format!("{place}/window"), "belongs to the blends maximum, minimum and average");
        }
        let window = window.unwrap_or_default();
        self.range(format!("{place}/window/center"), window.center, WINDOW_CENTER);
        self.range(format!("{place}/window/width"), window.width, WINDOW_WIDTH);
        window
    }

    fn depth_cueing(&mut self, fields: &DepthCueingFields) -> DepthCueing {
        self.range("/depth_cueing/front", fields.front, CUE_FRONT);
        self.range("/depth_cueing/density", fields.density, CUE_DENSITY);
        DepthCueing { front: fields.front.unwrap_or(1.0), density: fields.density.unwrap_or(1.0) }
    }

    /// What is left, all of which is within it, and what is cut out of that.
    fn clip(&mut self, regions: Vec<ClipFields>) -> (Clip, Vec<Clip>) {
        if regions.len() > MAX_CLIP {
            self.refuse("/clip", format!("expected at most {MAX_CLIP} regions, got {}", regions.len()));
        }
        let (mut left, mut cut_out) = (Clip::default(), vec![]);
        for (index, region) in regions.into_iter().enumerate() {
            let outside = region.keep == Some(Keep::Outside);
            let is_plane = region.plane.is_some();
            let shape =
                self.convex(&format!("/clip/{index}"), (region.plane, region.r#box, region.sphere, region.hull));
            match (outside, is_plane) {
                (false, _) => {
                    left.halves.extend(shape.halves);
                    left.balls.extend(shape.balls);
                }
                // All that is not in one half is in the other.
                (true, true) => left.halves.extend(shape.halves.iter().map(HalfSpace::other)),
                (true, false) => cut_out.push(shape),
            }
        }
        (left, cut_out)
    }

    /// What is shown in another way; the frame itself is of `around`.
    fn regions(
        &mut self,
        regions: Vec<RegionFields>,
        around: Option<IntensityProjection>,
        algorithm: AlgorithmChoice,
    ) -> Vec<RegionRequest> {
        // What they have classified is of no use to a frame of rays, as all are where one projects.
        let of_voxels = matches!(algorithm, AlgorithmChoice::Classified | AlgorithmChoice::FastClassification);
        if regions.len() > MAX_SHOWN_REGIONS {
            self.refuse("/regions", format!("expected at most {MAX_SHOWN_REGIONS} regions, got {}", regions.len()));
        }
        let region = |(index, region): (usize, RegionFields)| {
            let place = format!("/regions/{index}");
            self.range(format!("{place}/opacity"), region.opacity, REGION_OPACITY);
            if region.blend.is_some() && of_voxels {
                self.refuse(format!("{place}/blend"), "goes with preintegrated and raycast");
            }
            RegionRequest {
                shape: self.convex(&place, (region.plane, region.r#box, region.sphere, region.hull)),
                transfer: region.transfer_function.map(|transfer| self.transfer(&place, Some(transfer))),
                opacity: region.opacity.unwrap_or(1.0),
                shading: region.shading.map(|shading| self.shading(&place, Some(shading))),
                projection: region.blend.map_or(around, projection),
                window: region
                    .window
                    .map(|window| self.window(&place, region.blend.and_then(projection), Some(window))),
            }
        };
        regions.into_iter().enumerate().map(region).collect()
    }

    fn labels(&mut self, fields: LabelsFields) -> LabelsRequest {
        if fields.looks.len() > MAX_LABELS {
            self.refuse("/labels/looks", format!("expected at most {MAX_LABELS} labels, got {}", fields.looks.len()));
        }
        let look = |(index, look): (usize, LabelFields)| {
            let place = format!("/labels/looks/{index}");
            self.range(format!("{place}/opacity"), look.opacity, REGION_OPACITY);
            let color = look.color.and_then(|text| {
                let color = Color::from_hex(&text);
                if color.is_none() {
                    self.refuse(format!("{place}/color"), "expected \"#rrggbb\"");
                }
                color
            });
            LabelRequest {
                label: look.label,
                opacity: if look.visible == Some(false) { 0.0 } else { look.opacity.unwrap_or(1.0) },
                color,
                transfer: look.transfer_function.map(|transfer| self.transfer(&place, Some(transfer))),
            }
        };
        LabelsRequest { volume: fields.volume, looks: fields.looks.into_iter().enumerate().map(look).collect() }
    }

    fn geometry(&mut self, geometry: Vec<GeometryFields>) -> Vec<GeometryRequest> {
        if geometry.len() > MAX_GEOMETRY {
            self.refuse("/geometry", format!("expected at most {MAX_GEOMETRY} meshes, got {}", geometry.len()));
        }
        let solid = |(index, fields): (usize, GeometryFields)| {
            let place = format!("/geometry/{index}");
            if fields.opacity.is_some_and(|opacity| opacity != 1.0) {
                self.refuse(format!("{place}/opacity"), "expected 1: meshes are opaque");
            }
            let color = fields.color.as_deref().map_or(Some(MESH_COLOR), Color::from_hex);
            if color.is_none() {
                self.refuse(format!("{place}/color"), "expected \"#rrggbb\"");
            }
            let pose = fields.pose.map_or(DMat4::IDENTITY, |pose| DMat4::from_cols_array(&pose));
            self.elements(&format!("{place}/pose"), &pose.to_cols_array(), &POSITION);
            let size = DMat3::from_mat4(pose).determinant().abs();
            if (pose.row(3) - DVec4::W).abs().max_element() > 1e-6 || !(size.is_normal() && size.recip().is_normal()) {
                let detail = "expected an affine transform with an inverse, column by column";
                self.refuse(format!("{place}/pose"), detail);
            }
            GeometryRequest {
                mesh: fields.mesh,
                color: color.unwrap_or(MESH_COLOR),
                world_from_mesh: DAffine3::from_mat4(pose),
            }
        };
        geometry.into_iter().enumerate().map(solid).collect()
    }

    /// A convex part of the world; `place` points to what tells it.
    fn convex(
        &mut self,
        place: &str,
        told: (Option<PlaneFields>, Option<BoxFields>, Option<SphereFields>, Option<HullFields>),
    ) -> Clip {
        match told {
            (Some(plane), None, None, None) => Clip { halves: vec![self.plane(place, &plane)], balls: vec![] },
            (None, Some(fields), None, None) => Clip { halves: self.sides(place, &fields), balls: vec![] },
            (None, None, Some(sphere), None) => {
                let centre = self.vector(&format!("{place}/sphere/center"), sphere.center);
                self.range(format!("{place}/sphere/radius"), Some(sphere.radius), RADIUS);
                Clip { halves: vec![], balls: vec![Ball::new(centre, sphere.radius)] }
            }
            (None, None, None, Some(hull)) => self.hull(&format!("{place}/hull/points"), &hull.points),
            _ => {
                self.refuse(place, "expected one of plane, box, sphere and hull");
                Clip::default()
            }
        }
    }

    /// The half that the normal points into.
    fn plane(&mut self, pointer: &str, plane: &PlaneFields) -> HalfSpace {
        let point = self.vector(&format!("{pointer}/plane/point"), plane.point);
        let normal = self.vector(&format!("{pointer}/plane/normal"), plane.normal).try_normalize();
        if normal.is_none() {
            self.refuse(format!("{pointer}/plane/normal"), "expected a direction of length above 0");
        }
        let inwards = normal.unwrap_or(DVec3::Z);
        HalfSpace { normal: inwards, offset: -inwards.dot(point) }
    }

    fn hull(&mut self, pointer: &str, points: &[[f64; 3]]) -> Clip {
        if points.len() > MAX_HULL {
            self.refuse(pointer, format!("expected at most {MAX_HULL} points, got {}", points.len()));
            return Clip::default();
        }
        let at = |(index, point): (usize, &[f64; 3])| self.vector(&format!("{pointer}/{index}"), *point);
        let points: Vec<_> = points.iter().enumerate().map(at).collect();
        Clip::hull(&points).unwrap_or_else(|| {
            self.refuse(pointer, "expected points that do not all lie in one plane");
            Clip::default()
        })
    }

    fn sides(&mut self, pointer: &str, region: &BoxFields) -> Vec<HalfSpace> {
        let min = self.vector(&format!("{pointer}/box/min"), region.min);
        let max = self.vector(&format!("{pointer}/box/max"), region.max);
        for axis in (0..3).filter(|&axis| min[axis] >= max[axis]) {
            let detail = format!("expected more than min's {}, got {}", min[axis], max[axis]);
            self.refuse(format!("{pointer}/box/max/{axis}"), detail);
        }
        let side = |axis: usize| {
            let normal = DVec3::AXES[axis];
            [HalfSpace { normal, offset: -min[axis] }, HalfSpace { normal: -normal, offset: max[axis] }]
        };
        let halves = (0..3).flat_map(side).collect();
        let Some(pose) = region.pose else { return halves };
        self.elements(&format!("{pointer}/box/pose"), &pose, &POSITION);
        let world_from_box = DMat4::from_cols_array(&pose);
        let turn = DMat3::from_mat4(world_from_box);
        let turned = (turn * turn.transpose() - DMat3::IDENTITY).to_cols_array().iter().all(|e| e.abs() < 1e-4);
        if !turned || (world_from_box.row(3) - DVec4::W).abs().max_element() > 1e-6 {
            self.refuse(format!("{pointer}/box/pose"), "expected a rotation and a translation, column by column");
            return vec![];
        }
        let box_from_world = DAffine3::from_mat3_translation(turn, world_from_box.w_axis.truncate()).inverse();
        Clip { halves, balls: vec![] }.told_by(box_from_world).halves
    }

    fn preintegration(&mut self, quality: Quality, fields: Option<&PreintegrationFields>) -> Preintegration {
        let default = Preintegration::of(quality);
        let Some(fields) = fields else { return default };
        self.range("/preintegration/entries", fields.entries.map(f64::from), ENTRIES);
        let samples = fields.samples_per_voxel.map(f64::from);
        self.range("/preintegration/samples_per_voxel", samples, SAMPLES_PER_VOXEL);
        let table = fields.table.map_or(default.table, SlabTable::from);
        // Running sums have entries of their own and one way to read them: the same whatever is asked for.
        let (entries, lookup) = match table {
            SlabTable::TwoDimensional => (fields.entries, fields.lookup),
            SlabTable::OneDimensional => (None, None),
        };
        Preintegration {
            table,
            entries: entries.map_or(default.entries, |n| n as usize),
            lookup: lookup.unwrap_or(default.lookup),
            opacity_correction: fields.opacity_correction.unwrap_or(default.opacity_correction),
            buffer: fields.buffer.unwrap_or(default.buffer),
            samples_per_voxel: fields.samples_per_voxel.map_or(default.samples_per_voxel, |n| n as usize),
        }
    }

    /// Options that another algorithm would not look at. `auto` may come to need any of them; what counts
    /// as transparent may be told to `preintegrated`, which skips exact zeros only.
    fn options_of_algorithms(&mut self, fields: &Fields) {
        use AlgorithmChoice::{Auto, Classified, FastClassification, Preintegrated, Raycast};
        let algorithm = fields.algorithm;
        if fields.min_opacity.is_some() && algorithm == Raycast {
            self.refuse("/min_opacity", "belongs to classified and fast-classification");
        }
        if fields.sample_distance.is_some() && !matches!(algorithm, Auto | Raycast) {
            self.refuse("/sample_distance", "belongs to raycast");
        }
        if fields.preintegration.is_some() && !matches!(algorithm, Auto | Preintegrated) {
            self.refuse("/preintegration", "belongs to preintegrated");
        }
        if fields.quality == Quality::High && matches!(algorithm, Classified | FastClassification) {
            self.refuse("/quality", "classified and fast-classification render draft and standard only");
        }
    }
}
