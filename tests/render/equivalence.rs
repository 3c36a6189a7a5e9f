//! Fast paths and their slow twins give the same picture, bit for bit.

use proptest::prelude::*;
use shearwarp::classify::{Encodings, GradientPoint, Purpose, TransferFunction};
use shearwarp::render::{Algorithm, Camera, DepthCueing, Image, Light, Orbit, Projection, Settings, Shading};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{ANGLES, Prepared, floats_differ_by, on_threads, plain, transfer};

/// A volume of smooth lumps with empty space between them; scanlines of more than one mask word.
fn lumps(dims: [usize; 3], spacing: [f64; 3], seed: u32) -> Volume {
    let phase = f64::from(seed);
    let codes = (0..dims.iter().product()).map(|index: usize| {
        let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
        let [x, y, z] = [0, 1, 2].map(|axis| at[axis] as f64 * (0.21 + 0.02 * axis as f64) + phase);
        let lump = x.sin() * (y * 1.1).sin() * (z * 0.9 + phase).sin();
        (lump.max(0.0) * 255.0) as u8
    });
    let placement = Placement::from_spacing(spacing.into());
    Volume::new(dims, placement, Scalars::U8(codes.collect()), (1.0, 0.0), ImportReport::plain("test", ScalarType::U8))
        .unwrap()
}

fn orbit((azimuth, elevation): (f64, f64)) -> Camera {
    Camera::Orbit(Orbit { azimuth, elevation, roll: 7.0, zoom: 1.2, ..Orbit::default() })
}

/// The function of lumps that is solid inside; opaque pixels come early.
fn solid() -> TransferFunction {
    transfer(&[(0.0, 0.0), (60.0, 0.0), (90.0, 0.4), (255.0, 0.9)])
}

fn with_gradient_opacity() -> TransferFunction {
    let gradient_opacity = [(0.0, 0.0), (4.0, 0.1), (30.0, 1.0)];
    let gradient_opacity = gradient_opacity.map(|(value, opacity)| GradientPoint { value, opacity });
    TransferFunction { gradient_opacity: gradient_opacity.to_vec(), ..solid() }
}

fn lit() -> Settings {
    let side = Light::Directional { direction: (1.0, -2.0, 0.5).into(), intensity: 0.7, shadows: false };
    Settings {
        shading: Some(Shading { lights: vec![Light::Headlight, side], ..Shading::default() }),
        early_ray_termination: 0.98,
        ..plain(Algorithm::Classified)
    }
}

/// The frame of `classified`, after it was compared with its twins.
fn same_bits(scene: &Prepared, camera: &Camera, settings: &Settings) -> Image {
    let view = scene.view(camera, 90, 80);
    let encoded = scene.frame(&view, settings);
    let naive = |settings: &Settings| Settings { skipping: false, ..settings.clone() };
    assert!(encoded == scene.frame(&view, &naive(settings)), "differs from its twin: {camera:?} {settings:?}");
    let fast = Settings { algorithm: Algorithm::FastClassification, ..settings.clone() };
    assert!(encoded == scene.frame(&view, &fast), "fast classification differs: {camera:?} {settings:?}");
    assert!(encoded == scene.frame(&view, &naive(&fast)), "voxel by voxel it differs: {camera:?} {settings:?}");
    encoded
}

fn faded() -> Settings {
    Settings { depth_cueing: Some(DepthCueing { front: 1.3, density: 0.8 }), ..lit() }
}

#[test]
fn encoded_and_unencoded_voxels_and_their_naive_twins_are_one_along_every_axis_from_both_sides() {
    for transfer in [solid(), with_gradient_opacity()] {
        let scene = Prepared::new(lumps([140, 37, 70], [1.0, 1.5, 0.8], 1), transfer, 0.004);
        for angles in ANGLES {
            for settings in [lit(), plain(Algorithm::Classified), faded()] {
                let frame = same_bits(&scene, &orbit(angles), &settings);
                assert!(frame.pixels.iter().any(|&p| p > 0), "an empty picture at {angles:?}");
            }
        }
    }
}

/// A medium of which slices show next to nothing has floats anyway.
#[test]
fn fractions_of_16_bits_show_what_floats_show() {
    let unlit = Settings { early_ray_termination: 0.98, ..plain(Algorithm::Classified) };
    for (transfer, exact) in [(solid(), false), (transfer(&[(0.0, 0.0), (255.0, 0.004)]), true)] {
        let scene = Prepared::new(lumps([140, 37, 70], [1.0, 1.5, 0.8], 5), transfer, 0.0);
        for angles in ANGLES {
            for settings in [lit(), unlit.clone()] {
                let most = floats_differ_by(&scene, &scene.view(&orbit(angles), 90, 80), &settings);
                assert!(most <= if exact { 0.0 } else { 3.5 }, "{angles:?}: {most} {:?}", settings.shading);
                assert!(exact || most > 0.0, "{angles:?}: no fractions at all?");
            }
        }
    }
}

#[test]
fn threads_and_bands_change_nothing() {
    let scene = Prepared::new(lumps([70, 80, 66], [1.0; 3], 2), solid(), 0.002);
    for angles in ANGLES {
        let view = scene.view(&orbit(angles), 64, 64);
        for settings in [lit(), plain(Algorithm::FastClassification), plain(Algorithm::Raycast)] {
            let one = on_threads(1, || scene.frame(&view, &settings));
            for threads in [2, 7] {
                let many = on_threads(threads, || scene.frame(&view, &settings));
                assert!(one == many, "{threads} threads, {:?}, {angles:?}", settings.algorithm);
            }
        }
    }
}

#[test]
fn the_ray_caster_skips_exact_zeros_only() {
    for transfer in [solid(), with_gradient_opacity()] {
        let scene = Prepared::new(lumps([40, 37, 41], [1.0, 1.5, 0.8], 3), transfer, 0.0);
        for projection in [Projection::Parallel, Projection::Perspective] {
            for (azimuth, elevation) in ANGLES {
                let camera = Camera::Orbit(Orbit { projection, azimuth, elevation, ..Orbit::default() });
                let view = scene.view(&camera, 40, 40);
                let settings = Settings { early_ray_termination: 0.99, ..plain(Algorithm::Raycast) };
                let skipping = scene.frame(&view, &settings);
                let all = scene.frame(&view, &Settings { skipping: false, ..settings });
                assert!(skipping == all, "{projection:?} {azimuth} {elevation}");
            }
        }
    }
}

#[test]
fn an_encoding_survives_its_bytes() {
    for transfer in [solid(), with_gradient_opacity()] {
        let scene = Prepared::new(lumps([70, 35, 20], [1.0; 3], 4), transfer, 0.004);
        for (classification, encodings) in &scene.classified {
            let mut bytes = vec![];
            encodings.write_to(&mut bytes).unwrap();
            let purpose = classification.purpose();
            let read = |bytes: &[u8]| Encodings::read_from(&scene.prepared, &scene.transfer, purpose, &mut &bytes[..]);
            assert_eq!(&read(&bytes).unwrap(), encodings);
            for cut in [0, 3, 15, 40, bytes.len() / 2, bytes.len() - 1] {
                assert!(read(&bytes[..cut]).is_err(), "{cut} bytes of {}", bytes.len());
            }
            // Whatever is flipped, nothing that is read may leave the kernel's bounds.
            let view = scene.view(&orbit((30.0, 20.0)), 20, 20);
            let algorithm = match purpose {
                Purpose::Voxels { .. } => Algorithm::Classified,
                Purpose::Slabs { .. } => continue,
            };
            let settings = Settings { algorithm, ..lit() };
            for at in (0..bytes.len()).step_by(997) {
                let mut damaged = bytes.clone();
                damaged[at] ^= 0x55;
                if let Ok(damaged) = read(&damaged) {
                    scene.frame_with(classification, Some(&damaged), &view, &settings);
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn any_volume_view_and_function_render_as_their_twins(
        dims in prop::array::uniform3(2usize..80),
        codes in prop::collection::vec(any::<u8>(), 97),
        azimuth in -180.0f64..180.0,
        elevation in -90.0f64..90.0,
        low in 0.0f64..200.0,
        opacity in 0.05f64..1.0,
        termination in 0.5f32..=1.0,
        fading in any::<bool>(),
        by_gradient in any::<bool>(),
    ) {
        // Noise in blocks, so that there are runs of both kinds.
        let scalars = (0..dims.iter().product()).map(|at: usize| codes[at / 5 % 97]).collect();
        let report = ImportReport::plain("test", ScalarType::U8);
        let placement = Placement::from_spacing([1.0, 0.7, 1.6].into());
        let volume = Volume::new(dims, placement, Scalars::U8(scalars), (1.0, 0.0), report).unwrap();
        let points = transfer(&[(low, 0.0), (low + 20.0, opacity), (255.0, opacity / 2.0)]);
        let gradient_opacity = if by_gradient { with_gradient_opacity().gradient_opacity } else { vec![] };
        let transfer = TransferFunction { gradient_opacity, ..points };
        let scene = Prepared::new(volume, transfer, 0.01);
        let settings = Settings { early_ray_termination: termination, ..if fading { faded() } else { lit() } };
        on_threads(2, || same_bits(&scene, &orbit((azimuth, elevation)), &settings));
    }
}
