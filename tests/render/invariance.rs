//! The picture belongs to the world, not to the way a volume is stored or placed in it.

use glam::{DMat3, DMat4, DVec3, DVec4, EulerRot};
use shearwarp::render::{
    Algorithm, Background, Blend, Camera, DepthCueing, Image, IntensityProjection, Light, LookAt, Preintegration,
    Projection, Quality, Settings, Shading, Window, check,
};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{Prepared, plain, transfer};

const DIMS: [usize; 3] = [36, 44, 30];
const SPACING: [f64; 3] = [1.0, 0.8, 1.5];

/// An asymmetric object in index space.
fn code([i, j, k]: [usize; 3]) -> u8 {
    let at = DVec3::new(i as f64, j as f64, k as f64);
    let part = |centre: DVec3, radius: f64, peak: f64| peak * (1.5 - at.distance(centre) / radius).clamp(0.0, 1.0);
    let object = part(DVec3::new(18.0, 22.0, 15.0), 9.0, 160.0)
        .max(part(DVec3::new(27.0, 15.0, 20.0), 5.0, 240.0))
        .max(part(DVec3::new(12.0, 34.0, 8.0), 4.0, 220.0));
    object as u8
}

/// A volume stored with its axes in another `order`, some of them `flipped`, at the same place in the
/// world as the plain one under `rotation`.
fn stored(order: [usize; 3], flipped: [bool; 3], rotation: DMat3) -> Volume {
    let dims = order.map(|axis| DIMS[axis]);
    let codes = (0..dims.iter().product()).map(|index: usize| {
        let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
        let mut original = [0; 3];
        for (position, &axis) in order.iter().enumerate() {
            original[axis] = if flipped[position] { dims[position] - 1 - at[position] } else { at[position] };
        }
        code(original)
    });
    let mut origin = DVec3::new(5.0, -7.0, 11.0);
    let mut columns = [DVec3::ZERO; 3];
    for (position, &axis) in order.iter().enumerate() {
        let unit = DVec3::from_array([0, 1, 2].map(|a| f64::from(u8::from(a == axis))));
        if flipped[position] {
            origin += unit * ((DIMS[axis] - 1) as f64 * SPACING[axis]);
        }
        columns[position] = rotation * if flipped[position] { -unit } else { unit };
    }
    let placement = Placement {
        spacing: DVec3::from_array(order.map(|axis| SPACING[axis])),
        direction: DMat3::from_cols(columns[0], columns[1], columns[2]),
        origin: rotation * origin,
    };
    let report = ImportReport::plain("test", ScalarType::U8);
    Volume::new(dims, placement, Scalars::U8(codes.collect()), (1.0, 0.0), report).unwrap()
}

/// Every algorithm and kind of picture.
fn every_way() -> Vec<Settings> {
    let of = |algorithm, quality| Settings {
        quality,
        preintegration: Preintegration::of(quality),
        background: Background::Opaque([0.1, 0.2, 0.3]),
        early_ray_termination: 0.99,
        ..plain(algorithm)
    };
    let high = of(Algorithm::Preintegrated, Quality::High);
    let window = Window { center: 100.0, width: 220.0 };
    vec![
        of(Algorithm::Classified, Quality::Standard),
        of(Algorithm::FastClassification, Quality::Standard),
        of(Algorithm::Preintegrated, Quality::Standard),
        Settings { depth_cueing: Some(DepthCueing { front: 1.1, density: 0.8 }), ..high.clone() },
        Settings { blend: Blend::Projection(IntensityProjection::Maximum, window), ..high.clone() },
        Settings { blend: Blend::Projection(IntensityProjection::Average, window), ..high },
        of(Algorithm::Raycast, Quality::Standard),
    ]
}

/// A camera from `direction`, and whether its rays are parallel.
#[derive(Clone, Copy, Debug)]
struct Look {
    direction: DVec3,
    projection: Projection,
}

/// From all around; parallel.
fn looks() -> impl Iterator<Item = Look> {
    DIRECTIONS.into_iter().map(|direction| Look { direction, projection: Projection::Parallel })
}

/// The picture of a volume, camera and light turned by `rotation`; `None` where the algorithm does not
/// take the view.
fn picture(volume: Volume, rotation: DMat3, look: Look, settings: &Settings) -> Option<Image> {
    let function = transfer(&[(0.0, 0.0), (60.0, 0.0), (110.0, 0.3), (255.0, 0.8)]);
    let scene = Prepared::new(volume, function, 0.002);
    let centre = scene.prepared.volume().centre();
    let distance = if look.projection == Projection::Parallel { 200.0 } else { 100.0 };
    let camera = Camera::LookAt(LookAt {
        projection: look.projection,
        position: centre + rotation * look.direction * distance,
        target: centre,
        up: rotation * DVec3::new(0.1, 0.2, 1.0),
        view_height: Some(60.0),
        fov_y: 30.0,
    });
    let light = Light::Directional { direction: rotation * DVec3::new(0.4, -1.0, 0.7), intensity: 0.6, shadows: false };
    let shading = Some(Shading { lights: vec![Light::Headlight, light], ..Shading::default() });
    let view = scene.view(&camera, 70, 60);
    let settings = Settings { shading, ..settings.clone() };
    check(scene.prepared.volume(), false, &view, &settings).is_ok().then(|| scene.frame(&view, &settings))
}

fn largest_difference(a: &Image, b: &Image) -> u8 {
    a.pixels.iter().zip(&b.pixels).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

const DIRECTIONS: [DVec3; 6] = [
    DVec3::new(0.2, -1.0, 0.3),
    DVec3::new(1.0, 0.25, 0.1),
    DVec3::new(-0.3, 0.2, -1.0),
    DVec3::new(0.1, 1.0, 0.4),
    DVec3::new(-1.0, -0.4, 0.35),
    DVec3::new(0.0, -1.0, 0.0),
];

#[test]
fn turning_volume_camera_and_light_together_changes_no_pixel_by_more_than_one() {
    let rotations = [(0.3, -1.1, 2.0), (1.5, 0.4, -0.7), (-2.2, 0.9, 0.1)];
    let perspective = looks().step_by(2).map(|look| Look { projection: Projection::Perspective, ..look });
    for look in looks().chain(perspective) {
        for settings in every_way() {
            let turned_by = |rotation| picture(stored([0, 1, 2], [false; 3], rotation), rotation, look, &settings);
            let Some(plain) = turned_by(DMat3::IDENTITY) else { continue };
            for (a, b, c) in rotations {
                let turned = turned_by(DMat3::from_euler(EulerRot::XYZ, a, b, c)).unwrap();
                let difference = largest_difference(&plain, &turned);
                assert!(difference <= 1, "{settings:?} {look:?} {a} {b} {c}: {difference}");
            }
        }
    }
}

#[test]
fn the_order_and_handedness_of_stored_axes_changes_pixels_by_quantized_normals_only() {
    let orders = [([1, 0, 2], [false; 3]), ([2, 1, 0], [true, false, false]), ([1, 2, 0], [true, false, true])];
    for look in looks() {
        for settings in every_way() {
            let stored =
                |order, flipped| picture(stored(order, flipped, DMat3::IDENTITY), DMat3::IDENTITY, look, &settings);
            let Some(plain) = stored([0, 1, 2], [false; 3]) else { continue };
            // Normals are quantized in the stored frame, to within 1.1 degrees: up to 4 steps of 8 bits
            // of a light's diffuse part.
            let exact_normals = settings.algorithm == Algorithm::Raycast || settings.quality == Quality::High;
            let allowed = if exact_normals { 1 } else { 4 };
            for (order, flipped) in orders {
                let difference = largest_difference(&plain, &stored(order, flipped).unwrap());
                assert!(difference <= allowed, "{settings:?} {look:?} {order:?}: {difference}");
            }
        }
    }
}

#[test]
fn near_and_far_planes_cut_both_algorithms_alike() {
    let scene = Prepared::new(
        stored([0, 1, 2], [false; 3], DMat3::IDENTITY),
        transfer(&[(0.0, 0.0), (60.0, 0.0), (110.0, 0.3), (255.0, 0.8)]),
        0.0,
    );
    let centre = scene.prepared.volume().centre();
    let eye = centre + DVec3::new(30.0, -90.0, 20.0);
    let forward = (centre - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rows = DMat3::from_cols(right, right.cross(forward), -forward).transpose();
    let view = DMat4::from_mat3_translation(rows, rows * -eye);
    // Half a side of 30 mm; WebGL depth from -1 at `near` to 1 at `far`.
    let orthographic = |near: f64, far: f64| {
        DMat4::from_cols(
            DVec4::X / 30.0,
            DVec4::Y / 30.0,
            DVec4::Z * (-2.0 / (far - near)),
            DVec4::new(0.0, 0.0, -(far + near) / (far - near), 1.0),
        )
    };
    let full = orthographic(1.0, 500.0);
    let distance = eye.distance(centre);
    let front = orthographic(1.0, distance);
    let frame = |projection, algorithm| {
        let camera = Camera::Matrices { view, projection };
        let settings = Settings { background: Background::Opaque([0.0; 3]), ..plain(algorithm) };
        scene.frame(&scene.view(&camera, 60, 60), &settings)
    };
    let mean = |a: &Image, b: &Image| {
        let sum: u64 = a.pixels.iter().zip(&b.pixels).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        sum as f64 / a.pixels.len() as f64
    };
    let [cut, reference] = [Algorithm::Classified, Algorithm::Raycast].map(|algorithm| frame(front, algorithm));
    let [whole, whole_reference] = [Algorithm::Classified, Algorithm::Raycast].map(|algorithm| frame(full, algorithm));
    let removed = mean(&cut, &whole);
    assert!(removed > 2.0, "the far plane changes the picture by {removed} only");
    let (with_cut, without) = (mean(&cut, &reference), mean(&whole, &whole_reference));
    assert!(with_cut < without + 0.5, "{with_cut} against {without} without a cut");
}
