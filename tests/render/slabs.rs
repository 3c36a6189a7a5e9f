//! Slabs between sheared slices: fast paths and their slow twins give the same picture, bit for bit.

use proptest::prelude::*;
use shearwarp::classify::{GradientPoint, TransferFunction};
use shearwarp::render::{
    Algorithm, BufferSlice, Camera, DepthCueing, Image, Light, Lookup, OpacityCorrection, Orbit, Preintegration,
    Quality, Settings, Shading,
};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{ANGLES, Prepared, on_threads, plain, transfer};

/// Smooth lumps with empty space between them, some of them cut by the volume's sides.
fn lump([x, y, z]: [usize; 3]) -> f64 {
    let at = |n: usize, axis: usize| n as f64 * (0.19 + 0.02 * axis as f64) + 1.1;
    (at(x, 0).sin() * (at(y, 1) * 1.1).sin() * (at(z, 2) * 0.9).sin()).max(0.0)
}

fn lumps(dims: [usize; 3], spacing: [f64; 3], bits: u32) -> Volume {
    let at = |index: usize| [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
    let values = (0..dims.iter().product()).map(|index| lump(at(index)));
    let (scalars, kind) = match bits {
        8 => (Scalars::U8(values.map(|value| (value * 255.0) as u8).collect()), ScalarType::U8),
        _ => (Scalars::U16(values.map(|value| (value * 4000.0) as u16).collect()), ScalarType::U16),
    };
    let slope = if bits == 8 { 1.0 } else { 255.0 / 4000.0 };
    let placement = Placement::from_spacing(spacing.into());
    Volume::new(dims, placement, scalars, (slope, 0.0), ImportReport::plain("test", kind)).unwrap()
}

fn surface() -> TransferFunction {
    transfer(&[(0.0, 0.0), (60.0, 0.0), (90.0, 0.4), (255.0, 0.9)])
}

fn by_gradient() -> TransferFunction {
    let points = [(0.0, 0.0), (4.0, 0.1), (30.0, 1.0)].map(|(value, opacity)| GradientPoint { value, opacity });
    TransferFunction { gradient_opacity: points.to_vec(), ..surface() }
}

fn orbit((azimuth, elevation): (f64, f64)) -> Camera {
    Camera::Orbit(Orbit { azimuth, elevation, roll: 7.0, zoom: 1.2, ..Orbit::default() })
}

fn slabs() -> Settings {
    Settings { early_ray_termination: 0.98, ..plain(Algorithm::Preintegrated) }
}

/// Every kind of frame there is of slabs.
fn all_settings() -> Vec<Settings> {
    let side = Light::Directional { direction: (1.0, -2.0, 0.5).into(), intensity: 0.7 };
    let two_lights = Shading { lights: vec![Light::Headlight, side], ..Shading::default() };
    let options = |lookup, opacity_correction, samples_per_voxel| Preintegration {
        lookup,
        opacity_correction,
        samples_per_voxel,
        ..Preintegration::of(Quality::Standard)
    };
    let cueing = Some(DepthCueing { front: 1.2, density: 0.7 });
    vec![
        Settings { shading: Some(two_lights.clone()), ..slabs() },
        Settings { preintegration: options(Lookup::Nearest, OpacityCorrection::Off, 1), ..slabs() },
        Settings { preintegration: options(Lookup::Bilinear, OpacityCorrection::Lookup, 3), ..slabs() },
        Settings {
            shading: Some(two_lights),
            depth_cueing: cueing,
            preintegration: options(Lookup::Bilinear, OpacityCorrection::View, 2),
            ..slabs()
        },
        Settings {
            depth_cueing: cueing,
            preintegration: options(Lookup::Nearest, OpacityCorrection::Lookup, 1),
            ..slabs()
        },
    ]
}

/// The frame, after it was compared with its twins.
fn same_bits(scene: &Prepared, camera: &Camera, settings: &Settings) -> Image {
    let view = scene.view(camera, 47, 40);
    let (classification, _) = &scene.classified[1];
    let frame = scene.frame(&view, settings);
    let naive = scene.frame(&view, &Settings { skipping: false, ..settings.clone() });
    assert!(frame == naive, "differs from its twin: {camera:?} {settings:?}");
    let by_leaves = scene.frame_with(classification, None, &view, settings);
    assert!(frame == by_leaves, "encodings change {camera:?} {settings:?}");
    let preintegration = Preintegration { buffer: BufferSlice::Image, ..settings.preintegration };
    let image_buffer = scene.frame(&view, &Settings { preintegration, ..settings.clone() });
    assert!(frame == image_buffer, "the buffer slice changes {camera:?} {settings:?}");
    for threads in [1, 2, 7] {
        let on = on_threads(threads, || scene.frame(&view, settings));
        assert!(frame == on, "{threads} threads change {camera:?} {settings:?}");
    }
    frame
}

#[test]
fn skipping_encodings_buffers_and_threads_change_no_bit_along_any_axis() {
    for (bits, function) in [(8, surface()), (16, by_gradient())] {
        let scene = Prepared::new(lumps([140, 37, 45], [1.0, 1.5, 0.8], bits), function, 0.0);
        for angles in ANGLES {
            for settings in all_settings() {
                let frame = same_bits(&scene, &orbit(angles), &settings);
                assert!(frame.pixels.iter().any(|&p| p > 0), "an empty picture at {angles:?}");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn any_volume_view_and_function_render_as_their_twins(
        dims in prop::array::uniform3(2usize..70),
        codes in prop::collection::vec(any::<u8>(), 97),
        angles in (-180.0f64..180.0, -90.0f64..90.0),
        low in 0.0f64..200.0,
        opacity in 0.05f64..1.0,
        termination in 0.5f32..=1.0,
        which in 0usize..5,
    ) {
        let scalars = (0..dims.iter().product()).map(|at: usize| codes[at / 5 % 97]).collect();
        let report = ImportReport::plain("test", ScalarType::U8);
        let placement = Placement::from_spacing([1.0, 0.7, 1.6].into());
        let volume = Volume::new(dims, placement, Scalars::U8(scalars), (1.0, 0.0), report).unwrap();
        let function = transfer(&[(low, 0.0), (low + 20.0, opacity), (255.0, opacity / 2.0)]);
        let scene = Prepared::new(volume, function, 0.0);
        let settings = Settings { early_ray_termination: termination, ..all_settings()[which].clone() };
        same_bits(&scene, &orbit(angles), &settings);
    }
}
