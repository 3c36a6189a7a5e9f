//! Frames on the output's own rays: skipping and threads change no bit, and the ray caster agrees.

use glam::{DMat3, DMat4, DVec2, DVec3};
use proptest::prelude::*;
use shearwarp::classify::{GradientPoint, TransferFunction};
use shearwarp::render::{
    Algorithm, Background, Blend, Camera, DepthCueing, Image, IntensityProjection, Light, LookAt, Lookup,
    OpacityCorrection, Orbit, Preintegration, Projection, Quality, Settings, Shading, SlabTable, Window,
};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{ANGLES, Prepared, medium, plain, same_bits, transfer};

/// Smooth lumps with empty space between them.
fn lumps(dims: [usize; 3], spacing: [f64; 3]) -> Volume {
    let codes = (0..dims.iter().product()).map(|index: usize| {
        let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
        let [x, y, z] = [0, 1, 2].map(|axis| at[axis] as f64 * (0.19 + 0.02 * axis as f64) + 0.7);
        ((x.sin() * (y * 1.1).sin() * (z * 0.9).sin()).max(0.0) * 4000.0) as u16
    });
    let report = ImportReport::plain("test", ScalarType::U16);
    let placement = Placement::from_spacing(spacing.into());
    Volume::new(dims, placement, Scalars::U16(codes.collect()), (1.0, 0.0), report).unwrap()
}

fn surface() -> TransferFunction {
    transfer(&[(0.0, 0.0), (900.0, 0.0), (1500.0, 0.3), (4000.0, 0.8)])
}

fn orbit(projection: Projection, (azimuth, elevation): (f64, f64)) -> Camera {
    Camera::Orbit(Orbit { projection, azimuth, elevation, roll: 7.0, zoom: 1.2, ..Orbit::default() })
}

fn high() -> Settings {
    Settings { early_ray_termination: 0.98, quality: Quality::High, ..plain(Algorithm::Preintegrated) }
}

/// Over black: where little shows, straight colours are mostly rounding.
fn to_the_end() -> Settings {
    Settings { early_ray_termination: 1.0, background: Background::Opaque([0.0; 3]), ..high() }
}

fn two_lights() -> Shading {
    let side = Light::Directional { direction: (1.0, -2.0, 0.5).into(), intensity: 0.7, shadows: false };
    Shading { lights: vec![Light::Headlight, side], ..Shading::default() }
}

/// Every kind of frame there is on own rays.
fn all_settings() -> Vec<Settings> {
    let options = |lookup, opacity_correction| Preintegration {
        lookup,
        opacity_correction,
        samples_per_voxel: 3,
        ..Preintegration::of(Quality::High)
    };
    let window = Window { center: 2000.0, width: 4000.0 };
    let projection = |which| Settings { blend: Blend::Projection(which, window), ..high() };
    vec![
        Settings { shading: Some(two_lights()), preintegration: Preintegration::of(Quality::High), ..high() },
        Settings { preintegration: options(Lookup::Nearest, OpacityCorrection::Lookup), ..high() },
        Settings {
            depth_cueing: Some(DepthCueing { front: 1.2, density: 0.7 }),
            preintegration: options(Lookup::Bilinear, OpacityCorrection::Off),
            ..high()
        },
        Settings {
            shading: Some(Shading::default()),
            preintegration: Preintegration { table: SlabTable::OneDimensional, ..Preintegration::of(Quality::High) },
            ..high()
        },
        projection(IntensityProjection::Maximum),
        projection(IntensityProjection::Minimum),
        projection(IntensityProjection::Average),
    ]
}

#[test]
fn neither_skipping_nor_encodings_nor_threads_change_a_bit() {
    let gradient_opacity =
        [(0.0, 0.0), (40.0, 0.1), (400.0, 1.0)].map(|(value, opacity)| GradientPoint { value, opacity });
    let by_gradient = TransferFunction { gradient_opacity: gradient_opacity.to_vec(), ..surface() };
    for function in [surface(), by_gradient] {
        let scene = Prepared::new(lumps([70, 37, 45], [1.0, 1.5, 0.8]), function, 0.0);
        for projection in [Projection::Parallel, Projection::Perspective] {
            for angles in ANGLES {
                for settings in all_settings() {
                    let frame = same_bits(&scene, &scene.view(&orbit(projection, angles), 37, 30), &settings);
                    assert!(frame.pixels.iter().any(|&p| p > 0), "an empty picture at {angles:?}");
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn any_volume_view_and_function_render_as_without_skipping(
        dims in prop::array::uniform3(2usize..40),
        codes in prop::collection::vec(any::<u8>(), 97),
        angles in (-180.0f64..180.0, -90.0f64..90.0),
        perspective in any::<bool>(),
        low in 0.0f64..200.0,
        opacity in 0.05f64..1.0,
        which in 0usize..7,
    ) {
        let scalars = (0..dims.iter().product()).map(|at: usize| codes[at / 5 % 97]).collect();
        let report = ImportReport::plain("test", ScalarType::U8);
        let placement = Placement::from_spacing([1.0, 0.7, 1.6].into());
        let volume = Volume::new(dims, placement, Scalars::U8(scalars), (1.0, 0.0), report).unwrap();
        let function = transfer(&[(low, 0.0), (low + 20.0, opacity), (255.0, opacity / 2.0)]);
        let scene = Prepared::new(volume, function, 0.0);
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        same_bits(&scene, &scene.view(&orbit(projection, angles), 37, 30), &all_settings()[which]);
    }
}

/// The largest difference of any channel, and the mean one.
fn differences(a: &Image, b: &Image) -> (u8, f64) {
    let differences: Vec<u8> = a.pixels.iter().zip(&b.pixels).map(|(a, b)| a.abs_diff(*b)).collect();
    let sum: f64 = differences.iter().map(|d| f64::from(*d)).sum();
    (*differences.iter().max().unwrap(), sum / differences.len() as f64)
}

/// An eye in a corner of the volume that looks through it: all parts of a view at once, and a joint
/// between each two.
#[test]
fn wide_views_from_within_are_the_ray_casters_without_a_step_at_the_joints() {
    let scene = Prepared::new(lumps([60, 50, 55], [1.0, 1.1, 0.9]), surface(), 0.0);
    let (position, target) = (DVec3::new(21.0, 17.0, 18.0), DVec3::new(25.0, 21.3, 22.0));
    for (fov_y, turn) in [(150.0, 0.0), (100.0, 1.0), (40.0, 2.0)] {
        let look = LookAt {
            projection: Projection::Perspective,
            position,
            target: target + DVec3::X * turn,
            up: DVec3::Z,
            view_height: None,
            fov_y,
        };
        let view = scene.view(&Camera::LookAt(look), 64, 48);
        let settings = Settings { shading: Some(Shading::default()), ..to_the_end() };
        let frame = scene.frame(&view, &settings);
        let reference = Settings { algorithm: Algorithm::Raycast, sample_distance: 0.05, ..settings };
        let (largest, mean) = differences(&frame, &scene.frame(&view, &reference));
        assert!(largest <= 4 && mean < 0.3, "{fov_y}: {largest} at most, {mean} in the mean");
    }
}

#[test]
fn near_and_far_planes_cut_as_the_ray_caster_does() {
    let scene = Prepared::new(lumps([40, 44, 36], [1.0; 3]), surface(), 0.0);
    // From (20, -60, 40) towards (20, 20, 16).
    let back = DVec3::new(0.0, -80.0, 24.0).normalize();
    let eye = DVec3::new(20.0, -60.0, 40.0);
    let rotation = DMat3::from_cols(DVec3::X, back.cross(DVec3::X), back).transpose();
    let view = DMat4::from_mat3(rotation) * DMat4::from_translation(-eye);
    let (near, far) = (65.0, 95.0);
    let depth = (far + near) / (near - far);
    let perspective =
        [[3.2, 0.0, 0.0, 0.0], [0.0, 3.2, 0.0, 0.0], [0.0, 0.0, depth, -1.0], [0.0, 0.0, far * (depth - 1.0), 0.0]];
    let parallel =
        [[1.0 / 22.0, 0.0, 0.0, 0.0], [0.0, 1.0 / 21.0, 0.0, 0.0], [0.0, 0.0, -0.1, 0.0], [-0.1, 0.05, -8.0, 1.0]];
    for projection in [perspective, parallel].map(|columns| DMat4::from_cols_array_2d(&columns)) {
        let view = scene.view(&Camera::Matrices { view, projection }, 48, 48);
        let settings = to_the_end();
        let frame = scene.frame(&view, &settings);
        let reference = Settings { algorithm: Algorithm::Raycast, sample_distance: 0.05, ..settings };
        let (largest, mean) = differences(&frame, &scene.frame(&view, &reference));
        assert!(largest <= 3 && mean < 0.2, "{largest} at most, {mean} in the mean");
    }
}

#[test]
fn projections_are_the_ray_casters() {
    let scene = Prepared::new(lumps([40, 44, 36], [1.0, 0.8, 1.3]), surface(), 0.0);
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = scene.view(&orbit(projection, (35.0, 20.0)), 48, 48);
        for settings in &all_settings()[4..] {
            let settings = Settings {
                preintegration: Preintegration { samples_per_voxel: 8, ..settings.preintegration },
                ..settings.clone()
            };
            let frame = scene.frame(&view, &settings);
            let reference = Settings { algorithm: Algorithm::Raycast, sample_distance: 0.05, ..settings };
            let (largest, _) = differences(&frame, &scene.frame(&view, &reference));
            assert!(largest <= 1, "{projection:?} {:?}: {largest}", reference.blend);
        }
    }
}

/// Slabs at the ends of rays are cut where these enter and leave, so nothing is left to tolerate but
/// the rounding to 8 bits and a table's.
#[test]
fn a_uniform_box_has_its_closed_form_from_everywhere() {
    let dims = [20, 26, 17];
    let report = ImportReport::plain("test", ScalarType::U8);
    let placement = Placement::from_spacing([1.0, 0.7, 1.6].into());
    let scalars = Scalars::U8(vec![9; dims.iter().product()]);
    let volume = Volume::new(dims, placement, scalars, (1.0, 0.0), report).unwrap();
    let scene = Prepared::new(volume, medium(0.05, 1.0), 0.0);
    let tau = -(1.0f64 - 0.05).ln();
    for n in 0..50 {
        let projection = if n % 2 == 0 { Projection::Parallel } else { Projection::Perspective };
        let camera = orbit(projection, (f64::from(n) * 137.5, (1.0 - (f64::from(n) + 0.5) / 25.0).asin().to_degrees()));
        let view = scene.view(&camera, 32, 32);
        let frame = scene.frame(&view, &Settings { early_ray_termination: 1.0, ..high() });
        let index_from_world = scene.prepared.volume().world_from_index().inverse();
        for (at, pixel) in frame.pixels.chunks_exact(4).enumerate() {
            let ray = view.ray(DVec2::new((at % 32) as f64 + 0.5, (at / 32) as f64 + 0.5));
            let start = index_from_world.transform_point3(ray.origin);
            let along = index_from_world.transform_vector3(ray.direction);
            let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
            for axis in 0..3 {
                let ends = [-start[axis] / along[axis], ((dims[axis] - 1) as f64 - start[axis]) / along[axis]];
                enter = enter.max(ends[0].min(ends[1]));
                leave = leave.min(ends[0].max(ends[1]));
            }
            let expected = 255.0 * (1.0 - (-tau * (leave - enter).max(0.0)).exp());
            // Rounding to 8 bits, and a tenth of a step for lengths of slabs, which are rounded too.
            assert!((f64::from(pixel[3]) - expected).abs() <= 0.6, "{camera:?} {at}: {} {expected}", pixel[3]);
        }
    }
}
