//! Shadows: how much of a light reaches each voxel, and what is seen of that.

use glam::DVec3;
use shearwarp::classify::labels::{LabelLook, LabelTables, Labels, union};
use shearwarp::classify::{GradientPoint, TransferFunction};
use shearwarp::render::shadow::{BIAS, Shadow};
use shearwarp::render::{
    Algorithm, Ball, Cancel, Clip, DepthCueing, HalfSpace, Image, Light, Projection, Scene, Settings, Shading, View,
    render,
};
use shearwarp::volume::{ImportReport, PreparedVolume, ScalarType, Scalars, Volume, phantom};

use crate::scenes::{ANGLES, Prepared, high, on_threads, orbit, plain, premultiplied, psnr, transfer};

/// What shows so little that it casts no shadow.
const FAINT: f64 = 1e-7;

/// Lights along every axis from both sides, and oblique ones.
const LIGHTS: [[f64; 3]; 9] = [
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
    [0.0, 3.0, 0.0],
    [0.0, -1.0, 0.0],
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.4, 0.3, 1.0],
    [-0.5, 1.0, 0.6],
    [-2.0, 0.7, -1.1],
];

fn cast(scene: &Prepared, towards: [f64; 3]) -> Shadow {
    Shadow::cast(&scene.prepared, &scene.transfer, None, towards.into(), &Clip::default(), &[])
}

fn with_light(settings: Settings, towards: [f64; 3], shadows: bool) -> Settings {
    let light = Light::Directional { direction: towards.into(), intensity: 0.9, shadows };
    let shading = Shading { lights: vec![Light::Headlight, light], diffuse: 0.5, ..Shading::default() };
    Settings { shading: Some(shading), ..settings }
}

fn frame(scene: &Scene<'_>, view: &View, settings: &Settings) -> Image {
    render(scene, view, settings, &Cancel::default()).unwrap().0
}

#[test]
fn behind_a_layer_is_what_it_lets_through() {
    // The layer holds 8 mm back, of 0.08 / mm.
    let opacity = 1.0 - (-0.08f64).exp();
    let medium = TransferFunction {
        opacity_distance: Some(1.0),
        ..transfer(&[(0.0, FAINT), (99.0, FAINT), (100.0, opacity), (255.0, opacity)])
    };
    for towards in LIGHTS {
        let light = DVec3::from_array(towards).normalize();
        let axis = (0..3).max_by(|a, b| light[*a].abs().total_cmp(&light[*b].abs())).unwrap();
        let dims = [48, 44, 46];
        let volume = phantom::from_fn(dims, [1.0; 3], |x, y, z| {
            let at = [x, y, z][axis] as i64;
            if (18..26).contains(&at) { 200.0 } else { 0.0 }
        });
        let scene = Prepared::new(volume, medium.clone(), 0.0);
        let shadow = cast(&scene, towards);
        let expected = 1.0 - (-0.08 * 8.0 / light[axis].abs()).exp();
        for (at, &lacking) in shadow.lacking().iter().enumerate() {
            let place = [at % dims[0], at / dims[0] % dims[1], at / (dims[0] * dims[1])];
            // Beside the middle, light comes in past the layer.
            if (0..3).any(|other| other != axis && !(20..24).contains(&place[other])) {
                continue;
            }
            let (from_layer, lit) = (place[axis] as f64 - 21.5, light[axis] > 0.0);
            let depth = if lit { -from_layer } else { from_layer };
            let lacking = f64::from(lacking) / 255.0;
            // Half of the layer, the bias, and a pixel of the buffer.
            if depth > 4.0 + BIAS as f64 && depth < 9.0 + BIAS as f64 {
                assert!((lacking - expected).abs() < 0.004, "{towards:?} {place:?}: {lacking} {expected}");
            } else if depth < -3.0 + BIAS as f64 {
                assert!(lacking == 0.0, "{towards:?} {place:?}: {lacking}");
            }
        }
    }
}

/// Lumps with empty space between them.
fn lumps(dims: [usize; 3], spacing: [f64; 3]) -> Volume {
    phantom::from_fn(dims, spacing, |x, y, z| {
        let lump = (x as f64 * 0.31).sin() * (y as f64 * 0.27).sin() * (z as f64 * 0.24 + 1.0).sin();
        lump.max(0.0) * 255.0
    })
}

fn soft() -> TransferFunction {
    transfer(&[(0.0, 0.0), (30.0, 0.0), (120.0, 0.1), (255.0, 0.3)])
}

#[test]
fn a_voxel_lacks_what_slices_before_it_hold_back() {
    let by_gradient = TransferFunction {
        gradient_opacity: [(0.0, 0.1), (20.0, 1.0)].map(|(value, opacity)| GradientPoint { value, opacity }).to_vec(),
        ..soft()
    };
    for (medium, towards) in [soft(), by_gradient].iter().flat_map(|m| LIGHTS.map(|towards| (m, towards))) {
        let (dims, spacing) = ([40usize, 37, 43], [1.0, 0.8, 1.3]);
        let volume = lumps(dims, spacing);
        let scene = Prepared::new(volume, medium.clone(), 0.0);
        let volume = scene.prepared.volume();
        let shadow = cast(&scene, towards);
        // Slice by slice towards the light, opacities being interpolated where the ray meets them.
        let along = volume.world_from_index().inverse().transform_vector3(DVec3::from_array(towards).normalize());
        let axis = (0..3).max_by(|a, b| along[*a].abs().total_cmp(&along[*b].abs())).unwrap();
        let (step, distance) = (along / along[axis].abs(), 1.0 / along[axis].abs());
        let opacities = opacities(volume, medium, distance);
        let opacity = |at: [i64; 3]| {
            let inside = (0..3).all(|n| (0..dims[n] as i64).contains(&at[n]));
            if inside { opacities[(at[2] as usize * dims[1] + at[1] as usize) * dims[0] + at[0] as usize] } else { 0.0 }
        };
        let others: Vec<usize> = (0..3).filter(|n| *n != axis).collect();
        let (mut worst, mut sum, mut count) = (0.0f64, 0.0, 0);
        for (at, &lacking) in shadow.lacking().iter().enumerate().filter(|(at, _)| at % 3 == 0) {
            let place = [at % dims[0], at / dims[0] % dims[1], at / (dims[0] * dims[1])];
            let start = DVec3::from_array(place.map(|n| n as f64));
            let mut through = 1.0;
            for n in BIAS + 1.. {
                let on = start + step * n as f64;
                if !(-0.5..dims[axis] as f64 - 0.5).contains(&on[axis]) {
                    break;
                }
                let mut held = 0.0;
                for corner in 0..4 {
                    let (mut voxel, mut weight) = ([0i64; 3], 1.0);
                    voxel[axis] = on[axis].round() as i64;
                    for (bit, &other) in others.iter().enumerate() {
                        let (low, fraction) = (on[other].floor(), on[other].fract().rem_euclid(1.0));
                        let upper = corner >> bit & 1;
                        voxel[other] = low as i64 + upper as i64;
                        weight *= if upper == 1 { fraction } else { 1.0 - fraction };
                    }
                    held += weight * opacity(voxel);
                }
                through *= 1.0 - held;
            }
            // Where nothing shows nearby, nothing is told.
            if lacking > 0 || opacity(place.map(|n| n as i64)) > 0.0 {
                let error = (f64::from(lacking) / 255.0 - (1.0 - through)).abs();
                (worst, sum, count) = (worst.max(error), sum + error, count + 1);
            }
        }
        let mean = sum / f64::from(count);
        // Along an axis nothing is resampled.
        let (mean_bound, worst_bound) =
            if distance == scene.prepared.volume().placement().spacing[axis] { (0.002, 0.003) } else { (0.01, 0.2) };
        assert!(count > 3000 && mean < mean_bound && worst < worst_bound, "{towards:?}: {mean} {worst} of {count}");
    }
}

/// Opacity of a slice at every voxel.
fn opacities(volume: &Volume, medium: &TransferFunction, distance: f64) -> Vec<f64> {
    let [nx, ny, nz] = volume.dims();
    let code = |at: [usize; 3]| f64::from(volume.scalars().code((at[2] * ny + at[1]) * nx + at[0]));
    let difference = |at: [usize; 3], axis: usize| {
        let (mut after, mut before) = (at, at);
        after[axis] = (at[axis] + 1).min([nx, ny, nz][axis] - 1);
        before[axis] = at[axis].saturating_sub(1);
        (code(after) - code(before)) / (2.0 * volume.placement().spacing[axis]) * volume.rescale().0
    };
    let voxels = (0..nx * ny * nz).map(|n| [n % nx, n / nx % ny, n / (nx * ny)]);
    let opacity = |at: [usize; 3]| {
        let opacity = medium.opacity(volume.value_of_code(code(at)));
        let tau = -(1.0 - opacity).ln() / medium.reference_length(volume.smallest_spacing());
        let gradient = DVec3::from_array([0, 1, 2].map(|axis| difference(at, axis)));
        1.0 - (-tau * medium.gradient_factor(gradient.length()) * distance).exp()
    };
    voxels.map(opacity).collect()
}

#[test]
fn what_is_cut_away_casts_none() {
    let dims = [40, 40, 40];
    // A plate over a block.
    let volume = phantom::from_fn(dims, [1.0; 3], |_, _, z| if (15..=30).contains(&z) { 0.0 } else { 100.0 });
    let scene = Prepared::new(volume, transfer(&[(0.0, 0.0), (50.0, 0.0), (51.0, 0.5)]), 0.0);
    let centre = scene.prepared.volume().centre();
    let lacking = |clip: &Clip, holes: &[Clip]| {
        let shadow = Shadow::cast(&scene.prepared, &scene.transfer, None, DVec3::Z, clip, holes);
        let at = |x: usize| shadow.lacking()[(13 * 40 + 20) * 40 + x];
        [at(8), at(20), at(32)]
    };
    let (none, plate) = (Clip::default(), centre + DVec3::Z * 15.0);
    let [left, middle, right] = lacking(&none, &[]);
    assert!(left > 240 && left == middle && middle == right);
    let below = HalfSpace { normal: -DVec3::Z, offset: plate.z - 7.0 };
    let clipped = Clip { halves: vec![below], balls: vec![] };
    assert_eq!(lacking(&clipped, &[]), [0, 0, 0]);
    let hole = Clip { halves: vec![], balls: vec![Ball::new(plate, 9.0)] };
    let [left, middle, right] = lacking(&none, &[hole]);
    assert!(left > 240 && middle == 0 && right > 240, "{left} {middle} {right}");
}

#[test]
fn labels_that_are_not_visible_cast_none() {
    let dims = [32, 32, 32];
    let volume = phantom::from_fn(dims, [1.0; 3], |_, _, z| if (12..=24).contains(&z) { 0.0 } else { 100.0 });
    let labels: Vec<u8> = (0..32 * 32 * 32).map(|n| u8::from(n >= 24 * 32 * 32 && n % 32 < 16)).collect();
    let report = ImportReport::plain("test", ScalarType::U8);
    let labels = Volume::new(dims, *volume.placement(), Scalars::U8(labels), (1.0, 0.0), report).unwrap();
    let medium = transfer(&[(0.0, 0.0), (50.0, 0.0), (51.0, 0.5)]);
    let gone = LabelLook { label: 1, transfer: transfer(&[(0.0, 0.0)]) };
    let tables = LabelTables::new(&volume, &labels, &[gone], &medium, 0.0);
    let prepared = PreparedVolume::build(volume);
    let labels = Labels { voxels: labels.scalars(), tables: &tables };
    let shadow = Shadow::cast(&prepared, &medium, Some(labels), DVec3::Z, &Clip::default(), &[]);
    let at = |x: usize| shadow.lacking()[(10 * 32 + 16) * 32 + x];
    assert!(at(8) == 0 && at(24) > 200, "{} {}", at(8), at(24));
}

#[test]
fn labels_cast_shadows_by_their_own_gradient_opacity() {
    // No gradient anywhere: only the label shows that asks for none.
    let volume = phantom::from_fn([32; 3], [1.0; 3], |_, _, _| 100.0);
    let labels: Vec<u8> = (0..32 * 32 * 32).map(|n| u8::from(n >= 24 * 32 * 32 && n % 32 < 16)).collect();
    let report = ImportReport::plain("test", ScalarType::U8);
    let labels = Volume::new([32; 3], *volume.placement(), Scalars::U8(labels), (1.0, 0.0), report).unwrap();
    let flat = transfer(&[(0.0, 0.5)]);
    let gradient_opacity = [(0.5, 0.0), (1.0, 1.0)].map(|(value, opacity)| GradientPoint { value, opacity }).to_vec();
    let steep = TransferFunction { gradient_opacity, ..flat.clone() };
    let look = LabelLook { label: 1, transfer: flat };
    let tables = LabelTables::new(&volume, &labels, std::slice::from_ref(&look), &steep, 0.0);
    let transfer = union([&steep, &look.transfer].into_iter(), 1.0);
    let prepared = PreparedVolume::build(volume);
    let labels = Labels { voxels: labels.scalars(), tables: &tables };
    let shadow = Shadow::cast(&prepared, &transfer, Some(labels), DVec3::Z, &Clip::default(), &[]);
    let at = |x: usize| shadow.lacking()[(10 * 32 + 16) * 32 + x];
    assert!(at(8) > 200 && at(24) == 0, "{} {}", at(8), at(24));
}

#[test]
fn frames_with_shadows_are_those_of_their_twins() {
    // Fractions are too coarse for much of the first one, and serve the second.
    let mut by_fractions = 0;
    for transfer in [soft(), transfer(&[(0.0, 0.0), (30.0, 0.0), (30.0, 0.1), (255.0, 0.3)])] {
        let scene = Prepared::new(lumps([70, 39, 44], [1.0, 0.8, 1.3]), transfer, 0.0);
        let shadow = cast(&scene, [-0.5, 1.0, 0.6]);
        for threads in [1, 3] {
            assert!(
                shadow == on_threads(threads, || cast(&scene, [-0.5, 1.0, 0.6])),
                "{threads} threads change shadows"
            );
        }
        for (projection, (azimuth, elevation)) in
            [Projection::Parallel, Projection::Perspective].into_iter().flat_map(|p| ANGLES.map(|angles| (p, angles)))
        {
            let view = scene.view(&orbit(projection, azimuth, elevation), 70, 60);
            let shadowed = |algorithm: Algorithm, encoded: bool, settings: &Settings| {
                let scene = Scene { shadow: Some(&shadow), ..scene.scene(algorithm, encoded) };
                frame(&scene, &view, &Settings { algorithm, ..settings.clone() })
            };
            for settings in [plain(Algorithm::Classified), plain(Algorithm::Preintegrated), high()] {
                let settings = with_light(settings, [-0.5, 1.0, 0.6], true);
                let algorithm = settings.algorithm;
                let all = shadowed(algorithm, true, &settings);
                let naive = Settings { skipping: false, ..settings.clone() };
                assert!(all == shadowed(algorithm, true, &naive), "{projection:?} {azimuth} {elevation} {settings:?}");
                assert!(
                    all == shadowed(algorithm, false, &settings),
                    "{projection:?} {azimuth} {elevation} {settings:?}"
                );
                if algorithm == Algorithm::Classified {
                    let fast = shadowed(Algorithm::FastClassification, false, &settings);
                    assert!(all == fast, "{projection:?} {azimuth} {elevation}");
                }
                // Depth cueing of no density fades nothing, but asks for floats.
                let clear = Some(DepthCueing { front: 1.0, density: 0.0 });
                let floats = shadowed(algorithm, true, &Settings { depth_cueing: clear, ..settings.clone() });
                by_fractions += u32::from(all != floats);
                let off = premultiplied(&all).flatten().zip(premultiplied(&floats).flatten());
                let off = off.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(off <= 3.0, "{off}: {projection:?} {azimuth} {elevation} {settings:?}");
            }
        }
    }
    assert!(by_fractions > 20, "{by_fractions}");
}

#[test]
fn all_algorithms_show_the_shadows_of_the_ray_caster() {
    // A ball before a wall, the light beside the viewer.
    let volume = phantom::from_fn([64, 64, 64], [1.0; 3], |x, y, z| {
        let from_ball = (DVec3::new(x as f64, y as f64, z as f64) - DVec3::new(32.0, 20.0, 32.0)).length();
        let (ball, wall) = (200.0 - 40.0 * (from_ball - 7.0).max(0.0), 200.0 - 40.0 * (50.0 - y as f64).max(0.0));
        ball.max(wall).max(0.0)
    });
    let scene = Prepared::new(volume, transfer(&[(0.0, 0.0), (60.0, 0.0), (180.0, 0.6), (255.0, 0.6)]), 0.0);
    let towards = [-0.6, -1.0, 0.2];
    let shadow = cast(&scene, towards);
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = scene.view(&orbit(projection, 10.0, 5.0), 128, 128);
        let of = |settings: Settings, shadows: bool| {
            let settings = with_light(settings, towards, shadows);
            let scene = Scene { shadow: shadows.then_some(&shadow), ..scene.scene(settings.algorithm, true) };
            frame(&scene, &view, &settings)
        };
        let (lit, shadowed) = (of(plain(Algorithm::Raycast), false), of(plain(Algorithm::Raycast), true));
        let (mut darker, mut brighter) = (0, 0);
        for (a, b) in lit.pixels.iter().zip(&shadowed.pixels) {
            darker += u32::from(*a > b.saturating_add(20));
            brighter += u32::from(*b > a.saturating_add(1));
        }
        assert!(darker > 900 && brighter == 0, "{projection:?}: {darker} {brighter}");
        for settings in [plain(Algorithm::Classified), plain(Algorithm::Preintegrated), high()] {
            let name = format!("{projection:?} {:?} {:?}", settings.algorithm, settings.quality);
            let without = psnr(&of(settings.clone(), false), &lit);
            let with = psnr(&of(settings, true), &shadowed);
            assert!(with > without - 1.5 && with > 28.0, "{name}: {with} with shadows, {without} without");
        }
    }
}
