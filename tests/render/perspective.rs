//! Perspective: scaled slices, parts, eyes in and near the volume.

use glam::DVec3;
use shearwarp::render::{Algorithm, Camera, Light, LookAt, Orbit, Projection, Settings, Shading};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{ANGLES, Prepared, plain, transfer};

fn volume(dims: [usize; 3], spacing: [f64; 3], code: impl Fn([f64; 3]) -> f64) -> Volume {
    let codes = (0..dims.iter().product()).map(|index: usize| {
        let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
        code(at.map(|i| i as f64)).round() as u8
    });
    let report = ImportReport::plain("test", ScalarType::U8);
    Volume::new(dims, Placement::from_spacing(spacing.into()), Scalars::U8(codes.collect()), (1.0, 0.0), report)
        .unwrap()
}

/// Smooth lumps with empty space between them.
fn lumps(dims: [usize; 3], spacing: [f64; 3]) -> Volume {
    volume(dims, spacing, |[x, y, z]| {
        ((x * 0.23 + 1.0).sin() * (y * 0.25 + 1.2).sin() * (z * 0.19 + 2.0).sin()).max(0.0) * 255.0
    })
}

fn lit(algorithm: Algorithm) -> Settings {
    let side = Light::Directional { direction: (1.0, -2.0, 0.5).into(), intensity: 0.7 };
    Settings {
        shading: Some(Shading { lights: vec![Light::Headlight, side], ..Shading::default() }),
        early_ray_termination: 0.98,
        ..plain(algorithm)
    }
}

fn solid() -> shearwarp::classify::TransferFunction {
    transfer(&[(0.0, 0.0), (60.0, 0.0), (90.0, 0.4), (255.0, 0.9)])
}

fn look(position: DVec3, target: DVec3, fov_y: f64) -> Camera {
    let up = DVec3::new(0.1, 0.2, 0.9);
    Camera::LookAt(LookAt { projection: Projection::Perspective, position, target, up, view_height: None, fov_y })
}

/// Cameras along every axis from both sides, near ones and wide ones, some within the volume.
fn cameras(scene: &Prepared) -> Vec<Camera> {
    let around = ANGLES.map(|(azimuth, elevation)| {
        let orbit = Orbit { azimuth, elevation, roll: 7.0, zoom: 1.2, fov_y: 40.0, ..Orbit::default() };
        Camera::Orbit(Orbit { projection: Projection::Perspective, ..orbit })
    });
    let (centre, radius) = (scene.prepared.volume().centre(), scene.prepared.volume().radius());
    let near = [
        ([0.0, 0.0, 0.0], [1.0, 0.8, 0.6], 100.0),
        ([0.2, 0.1, -0.15], [-1.0, 0.1, 0.2], 150.0),
        ([-0.9, 0.1, 0.05], [1.0, 0.0, 0.0], 90.0),
        ([0.7, -0.8, 0.5], [-1.0, 0.9, -0.8], 140.0),
    ];
    let near = near.map(|(from, along, fov_y)| {
        let position = centre + DVec3::from(from) * radius;
        look(position, position + DVec3::from(along), fov_y)
    });
    around.into_iter().chain(near).collect()
}

const ALGORITHMS: [Algorithm; 3] = [Algorithm::Preintegrated, Algorithm::Classified, Algorithm::FastClassification];

#[test]
fn skipping_changes_no_bit_in_perspective() {
    let scene = Prepared::new(lumps([140, 37, 70], [1.0, 1.5, 0.8]), solid(), 0.004);
    for camera in cameras(&scene) {
        let view = scene.view(&camera, 70, 60);
        for algorithm in ALGORITHMS {
            for settings in [lit(algorithm), plain(algorithm)] {
                let fast = scene.frame(&view, &settings);
                let naive = scene.frame(&view, &Settings { skipping: false, ..settings });
                assert!(fast.pixels.iter().any(|&p| p > 0), "an empty picture by {camera:?}");
                assert!(fast == naive, "{algorithm:?} differs from its twin by {camera:?}");
            }
        }
    }
}
