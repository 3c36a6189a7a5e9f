//! Slabs between sheared slices: fast paths and their slow twins give the same picture, bit for bit.

use proptest::prelude::*;
use shearwarp::classify::{GradientPoint, TransferFunction};
use shearwarp::render::{
    Algorithm, Camera, DepthCueing, Image, Light, Lookup, OpacityCorrection, Orbit, Preintegration, Projection,
    Quality, Settings, Shading, SlabTable,
};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{ANGLES, Prepared, floats_differ_by, plain, same_bits, transfer};

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

/// The same, looked up in running sums.
fn running_sums(settings: Settings) -> Settings {
    let preintegration = Preintegration { table: SlabTable::OneDimensional, ..settings.preintegration };
    Settings { preintegration, ..settings }
}

/// Every kind of frame there is of slabs.
fn all_settings() -> Vec<Settings> {
    let side = Light::Directional { direction: (1.0, -2.0, 0.5).into(), intensity: 0.7, shadows: false };
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
        slabs(),
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
        running_sums(Settings { shading: Some(Shading::default()), ..slabs() }),
        running_sums(Settings {
            depth_cueing: cueing,
            preintegration: options(Lookup::Bilinear, OpacityCorrection::Lookup, 2),
            ..slabs()
        }),
    ]
}

#[test]
fn skipping_encodings_buffers_and_threads_change_no_bit_along_any_axis() {
    for (bits, function) in [(8, surface()), (16, surface()), (16, by_gradient())] {
        let scene = Prepared::new(lumps([140, 37, 45], [1.0, 1.5, 0.8], bits), function, 0.0);
        for angles in ANGLES {
            for settings in all_settings() {
                let frame = same_bits(&scene, &scene.view(&orbit(angles), 47, 40), &settings);
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
        which in 0usize..8,
    ) {
        let scalars = (0..dims.iter().product()).map(|at: usize| codes[at / 5 % 97]).collect();
        let report = ImportReport::plain("test", ScalarType::U8);
        let placement = Placement::from_spacing([1.0, 0.7, 1.6].into());
        let volume = Volume::new(dims, placement, Scalars::U8(scalars), (1.0, 0.0), report).unwrap();
        let function = transfer(&[(low, 0.0), (low + 20.0, opacity), (255.0, opacity / 2.0)]);
        let scene = Prepared::new(volume, function, 0.0);
        let settings = Settings { early_ray_termination: termination, ..all_settings()[which].clone() };
        same_bits(&scene, &scene.view(&orbit(angles), 47, 40), &settings);
    }
}

#[test]
fn fractions_of_16_bits_show_what_floats_show() {
    for bits in [8, 16] {
        let scene = Prepared::new(lumps([140, 37, 45], [1.0, 1.5, 0.8], bits), surface(), 0.0);
        for angles in ANGLES {
            for settings in all_settings().into_iter().take(2) {
                let most = floats_differ_by(&scene, &scene.view(&orbit(angles), 90, 80), &settings);
                assert!(most <= 3.5, "{bits} bits, {angles:?}: {most} {:?}", settings.shading);
                assert!(most > 0.0, "{bits} bits, {angles:?}: no fractions at all?");
            }
        }
    }
}

/// Alpha's largest difference between a table and running sums, whatever the projection and the quality.
fn alpha_differs_by(function: TransferFunction) -> u8 {
    let scene = Prepared::new(lumps([40, 37, 45], [1.0, 1.5, 0.8], 16), function, 0.0);
    let mut largest = 0;
    for (projection, quality) in [
        (Projection::Parallel, Quality::Standard),
        (Projection::Perspective, Quality::Standard),
        (Projection::Parallel, Quality::High),
        (Projection::Perspective, Quality::High),
    ] {
        let camera = Camera::Orbit(Orbit { projection, azimuth: 25.0, elevation: 10.0, ..Orbit::default() });
        let settings = Settings { quality, preintegration: Preintegration::of(quality), ..slabs() };
        let [table, sums] = [settings.clone(), running_sums(settings)]
            .map(|settings| scene.frame(&scene.view(&camera, 47, 40), &settings));
        assert!(table.pixels.iter().any(|&p| p > 0), "an empty picture");
        let alphas = |image: &Image| image.pixels.iter().skip(3).step_by(4).copied().collect::<Vec<_>>();
        let differences = alphas(&table).into_iter().zip(alphas(&sums)).map(|(a, b)| a.abs_diff(b));
        largest = differences.fold(largest, u8::max);
    }
    largest
}

#[test]
fn running_sums_are_exact_in_a_uniform_medium_and_wherever_they_are_of_depths() {
    assert!(alpha_differs_by(transfer(&[(0.0, 0.03)])) <= 1);
    assert!(alpha_differs_by(by_gradient()) <= 1);
    assert!(alpha_differs_by(surface()) > 1, "otherwise nothing is shown of an approximation");
}
