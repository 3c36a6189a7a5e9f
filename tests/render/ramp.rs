//! A volume that rises evenly: the scalar is linear along every ray, so that the opacity of any
//! transfer function has a closed form, and its colour is an integral over one variable.
//!
//! Over a stretch on which the opacity `a` runs linearly from `a0` to `a1`, the optical depth is
//! `length / (a1 - a0)` times the integral of `-ln(1 - a)`, whose antiderivative is
//! `(1 - a) ln(1 - a) + a`.

use glam::{DVec2, DVec3};
use proptest::prelude::*;
use shearwarp::classify::{Color, ControlPoint, TransferFunction};
use shearwarp::render::{
    Algorithm, Background, Camera, DepthCueing, Light, Orbit, Preintegration, Projection, Quality, Settings, Shading,
    View, check,
};
use shearwarp::volume::Volume;
use shearwarp::volume::decode::{Limits, from_bytes};

use crate::scenes::{Chord, Prepared, chord, plain};

/// Values of the first and the last voxel along the ramp.
const LOW: f64 = -20.5;
const HIGH: f64 = 199.25;
/// mm that opacities are for.
const REFERENCE: f64 = 2.5;
/// Pixels a side; rays along the ramp are all alike.
const SIZE: u32 = 10;
const SIZE_ALONG: u32 = 3;
/// Steps of 8 bits: half of one for rounding, and a fifth for tables and samples.
const TOLERANCE: f64 = 0.7;

/// 32-bit floats that rise along an axis, as a file: they become 16-bit codes when it is read.
fn ramp(dims: [usize; 3], spacing: [f64; 3], axis: usize) -> Volume {
    let [sizes, spacings] = [dims.map(|n| n.to_string()), spacing.map(|s| s.to_string())].map(|list| list.join(" "));
    let mut file = format!(
        "NRRD0004\ntype: float\ndimension: 3\nsizes: {sizes}\nspacings: {spacings}\nendian: little\nencoding: raw\n\n"
    )
    .into_bytes();
    for index in 0..dims.iter().product() {
        let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])][axis];
        let value = LOW + (HIGH - LOW) * at as f64 / (dims[axis] - 1) as f64;
        file.extend((value as f32).to_le_bytes());
    }
    from_bytes(&file[..], &Limits::default()).unwrap()
}

fn function(points: &[(f64, f64, [f32; 3])]) -> TransferFunction {
    let points = points.iter().map(|&(value, opacity, color)| ControlPoint { value, opacity, color: Color(color) });
    TransferFunction { points: points.collect(), opacity_distance: Some(REFERENCE), gradient_opacity: vec![] }
}

const RED: [f32; 3] = [1.0, 0.2, 0.1];
const GREEN: [f32; 3] = [0.1, 0.9, 0.3];
const BLUE: [f32; 3] = [0.2, 0.4, 1.0];

/// A straight line, one with all kinds of pieces, and peaks narrower than a voxel.
fn functions() -> [TransferFunction; 4] {
    [
        function(&[(LOW, 0.0, RED), (HIGH, 0.5, BLUE)]),
        function(&[(-5.0, 0.0, RED), (31.0, 0.12, GREEN), (40.0, 0.01, BLUE), (90.0, 0.01, RED), (160.0, 0.4, GREEN)]),
        function(&[
            (9.3, 0.0, RED),
            (10.0, 0.7, RED),
            (10.7, 0.0, GREEN),
            (77.0, 0.0, BLUE),
            (77.1, 0.8, BLUE),
            (77.9, 0.8, GREEN),
            (78.0, 0.0, GREEN),
            (150.0, 0.0, RED),
            (151.5, 0.3, RED),
            (153.0, 0.0, RED),
        ]),
        function(&[
            (20.0, 0.0, RED),
            (20.0, 0.1, GREEN),
            (60.0, 0.05, BLUE),
            (60.0, 0.0, RED),
            (140.0, 0.0, RED),
            (140.0, 1.0, RED),
        ]),
    ]
}

/// A ray from scalar to scalar.
struct Path {
    from: f64,
    to: f64,
    /// mm
    length: f64,
}

/// Colour (premultiplied) and opacity along a path; `light` changes a colour, given how far along the
/// path it is (0..=1).
fn closed_form(function: &TransferFunction, path: &Path, light: impl Fn(DVec3, f64) -> DVec3) -> [f64; 4] {
    let scalar = |t: f64| path.from + (path.to - path.from) * t;
    let mut cuts: Vec<f64> = function
        .points
        .iter()
        .map(|p| (p.value - path.from) / (path.to - path.from))
        .filter(|t| *t > 0.0 && *t < 1.0)
        .collect();
    cuts.extend([0.0, 1.0]);
    cuts.sort_by(f64::total_cmp);
    let (mut color, mut depth) = (DVec3::ZERO, 0.0);
    for piece in cuts.windows(2).filter(|piece| piece[1] > piece[0]) {
        const STEPS: usize = 500;
        let (opacity, shade) = piece_of(function, scalar(0.5 * (piece[0] + piece[1])));
        let length = (piece[1] - piece[0]) * path.length;
        let before = depth;
        let at = |share: f64| piece[0] + (piece[1] - piece[0]) * share;
        let first = opacity(scalar(piece[0]));
        let after = |share: f64| before + mean_extinction(first, opacity(scalar(at(share)))) * share * length;
        for step in 0..STEPS {
            let [from, middle, to] = [0.0, 0.5, 1.0].map(|part| (step as f64 + part) / STEPS as f64);
            let emitted = (-after(from)).exp() - (-after(to)).exp();
            color += light(shade(scalar(at(middle))), at(middle)) * emitted;
        }
        depth = after(1.0);
    }
    [color.x, color.y, color.z, 1.0 - (-depth).exp()]
}

/// Opacity and colour on the linear piece that holds a value.
fn piece_of(function: &TransferFunction, value: f64) -> (impl Fn(f64) -> f64, impl Fn(f64) -> DVec3) {
    let points = &function.points;
    let high = points.iter().position(|p| p.value > value);
    let pair = match high {
        Some(0) => [points[0], points[0]],
        Some(high) => [points[high - 1], points[high]],
        None => [points[points.len() - 1]; 2],
    };
    let share = move |value: f64| {
        let width = pair[1].value - pair[0].value;
        if width > 0.0 { (value - pair[0].value) / width } else { 0.0 }
    };
    let opacity = move |value| pair[0].opacity + (pair[1].opacity - pair[0].opacity) * share(value);
    let [a, b] = pair.map(|point| DVec3::from_array(point.color.0.map(f64::from)));
    (opacity, move |value| a + (b - a) * share(value))
}

/// The mean of the extinction per mm while the opacity runs linearly from `a` to `b`.
fn mean_extinction(a: f64, b: f64) -> f64 {
    let [a, b] = [a, b].map(|opacity| opacity.min(1.0 - 1e-7));
    let antiderivative = |a: f64| (1.0 - a) * (1.0 - a).ln() + a;
    let mean = if (b - a).abs() < 1e-6 { -(1.0 - a).ln() } else { (antiderivative(b) - antiderivative(a)) / (b - a) };
    mean / REFERENCE
}

/// Asserts that a frame's pixels are the closed form's. `inside` tells the pixels to look at by where
/// their rays enter and leave; `light` changes a colour on its way along a chord.
fn assert_frame(
    scene: &Prepared,
    axis: usize,
    view: &View,
    settings: &Settings,
    inside: impl Fn([DVec3; 2]) -> bool,
    light: impl Fn(DVec3, &Chord, f64) -> DVec3,
) {
    let volume = scene.prepared.volume();
    let frame = |background| scene.frame(view, &Settings { background, ..settings.clone() });
    let (black, transparent) = (frame(Background::Opaque([0.0; 3])), frame(Background::Transparent));
    let (width, _) = view.size();
    let mut seen = 0;
    for (index, (rgb, rgba)) in black.pixels.chunks_exact(3).zip(transparent.pixels.chunks_exact(4)).enumerate() {
        let at = [index as u32 % width, index as u32 / width].map(|at| f64::from(at) + 0.5);
        let chord = chord(view, volume, DVec2::from_array(at));
        if chord.length <= 0.0 || !inside(chord.ends) {
            continue;
        }
        let [from, to] = chord.ends.map(|end| LOW + (HIGH - LOW) * end[axis] / (volume.dims()[axis] - 1) as f64);
        let path = Path { from, to, length: chord.length };
        let expected = closed_form(&scene.transfer, &path, |color, t| light(color, &chord, t));
        for (got, expected) in [rgb[0], rgb[1], rgb[2], rgba[3]].into_iter().zip(expected) {
            let difference = (f64::from(got) - 255.0 * expected).abs();
            let what = format!("axis {axis} at {at:?} under {:?}", scene.transfer.points);
            assert!(
                difference < TOLERANCE,
                "{} {}: off by {difference}, {what}",
                settings.algorithm.name(),
                settings.quality.name()
            );
        }
        seen += 1;
    }
    assert!(seen > 0, "no pixel was tested");
}

/// What light does to a colour where there is none.
fn unlit(color: DVec3, _: &Chord, _: f64) -> DVec3 {
    color
}

/// A camera that looks along an axis of the world, from either side.
fn along(axis: usize, from_front: bool) -> Orbit {
    let (azimuth, elevation) = match (axis, from_front) {
        (0, true) => (270.0, 0.0),
        (0, false) => (90.0, 0.0),
        (1, true) => (0.0, 0.0),
        (1, false) => (180.0, 0.0),
        (_, true) => (0.0, -90.0),
        (_, false) => (0.0, 90.0),
    };
    Orbit { azimuth, elevation, ..Orbit::default() }
}

/// The ray caster with this step, and pre-integration at voxel resolution and at the output's.
fn all(sample_distance: f64) -> [Settings; 3] {
    let preintegrated =
        |quality| Settings { quality, preintegration: Preintegration::of(quality), ..plain(Algorithm::Preintegrated) };
    [
        Settings { sample_distance, ..plain(Algorithm::Raycast) },
        preintegrated(Quality::Standard),
        preintegrated(Quality::High),
    ]
}

fn accepts(scene: &Prepared, view: &View, settings: &Settings) -> bool {
    check(scene.prepared.volume(), false, view, settings).is_ok()
}

#[test]
fn along_the_ramp_any_function_has_its_closed_form() {
    for axis in 0..3 {
        for function in functions() {
            let scene = Prepared::new(ramp([24, 18, 20], [1.0, 1.4, 1.2], axis), function, 0.0);
            for from_front in [true, false] {
                let view = scene.view(&Camera::Orbit(along(axis, from_front)), SIZE_ALONG, SIZE_ALONG);
                for settings in all(1.0 / 256.0).iter().filter(|settings| accepts(&scene, &view, settings)) {
                    assert_frame(&scene, axis, &view, settings, |_| true, unlit);
                }
            }
        }
    }
}

/// Where rays are oblique to the ramp they begin and end between voxels, anywhere in the transfer
/// function. The ray caster and slabs on the output's own rays meet all of the box; a lattice of voxels
/// with a warp meets what enters through its first slice and leaves through its last, away from the sides.
/// A ray that ends within a peak gets as much of it as the table's entries resolve, so those are
/// left to rays along the ramp.
#[test]
fn across_the_ramp_functions_without_peaks_have_their_closed_form() {
    for (axis, smooth) in [(0, 0), (1, 1), (2, 1), (2, 0)] {
        let function = functions()[smooth].clone();
        let scene = Prepared::new(ramp([24, 18, 20], [1.0, 1.4, 1.2], axis), function, 0.0);
        let last = DVec3::from_array(scene.prepared.volume().dims().map(|n| (n - 1) as f64));
        let through = |ends: [DVec3; 2]| {
            let across = (0..3).filter(|&other| other != axis);
            across.into_iter().all(|other| ends.iter().all(|end| end[other] > 2.0 && end[other] < last[other] - 2.0))
        };
        for (orbit, slanted) in slanted(axis) {
            let view = scene.view(&Camera::Orbit(orbit), SIZE, SIZE);
            for settings in all(1.0 / 32.0).iter().filter(|settings| accepts(&scene, &view, settings)) {
                let own_rays = settings.algorithm == Algorithm::Raycast || settings.quality == Quality::High;
                if own_rays || !slanted {
                    assert_frame(&scene, axis, &view, settings, |ends| own_rays || through(ends), unlit);
                }
            }
        }
    }
}

/// Views near a ramp's axis, and (true) far from it.
fn slanted(axis: usize) -> Vec<(Orbit, bool)> {
    let mut views = vec![];
    for projection in [Projection::Parallel, Projection::Perspective] {
        for from_front in [true, false] {
            let Orbit { azimuth, elevation, .. } = along(axis, from_front);
            let near =
                Orbit { projection, azimuth: azimuth + 9.0, elevation: 0.9 * elevation + 5.0, ..Orbit::default() };
            let far =
                Orbit { projection, azimuth: azimuth + 40.0, elevation: 0.4 * elevation + 25.0, ..Orbit::default() };
            views.extend([(near, false), (far, true)]);
        }
    }
    views
}

/// On a ramp the normal is the same everywhere, and what light does to a colour depends on the ray alone:
/// several lights of their own directions, a headlight along every pixel's own ray, and colours that
/// fade with depth.
#[test]
fn light_and_depth_on_a_ramp_have_their_closed_form() {
    let key = DVec3::new(1.0, -2.0, 2.0);
    let fill = DVec3::new(-0.5, -0.4, -1.0);
    let shading = Shading {
        ambient: 0.1,
        diffuse: 0.3,
        specular: 0.15,
        shininess: 6.5,
        lights: vec![
            Light::Headlight,
            Light::Directional { direction: key, intensity: 0.8, shadows: false },
            Light::Directional { direction: fill, intensity: 0.5, shadows: false },
        ],
    };
    let (front, density) = (0.9, 1.7);
    for axis in 0..3 {
        let scene = Prepared::new(ramp([24, 18, 20], [1.0, 1.4, 1.2], axis), functions()[0].clone(), 0.0);
        let volume = scene.prepared.volume();
        let normal = volume.placement().direction.col(axis);
        for projection in [Projection::Parallel, Projection::Perspective] {
            let orbit = Orbit { azimuth: 33.0, elevation: 21.0, roll: 50.0, projection, ..Orbit::default() };
            let view = scene.view(&Camera::Orbit(orbit), SIZE, SIZE);
            let light = |color: DVec3, chord: &Chord, t: f64| {
                let eye = -chord.direction;
                let lights = [(eye, 1.0), (key.normalize(), 0.8), (fill.normalize(), 0.5)];
                let (mut factor, mut addend) = (0.1, 0.0);
                for (towards, intensity) in lights {
                    factor += 0.3 * intensity * normal.dot(towards).abs();
                    addend += 0.15 * intensity * normal.dot((towards + eye).normalize()).abs().powf(6.5);
                }
                let at = chord.ends[0] + (chord.ends[1] - chord.ends[0]) * t;
                let from_centre = volume.world_from_index().transform_point3(at) - volume.centre();
                let depth = 0.5 + from_centre.dot(view.forward()) / (2.0 * volume.radius());
                (color * factor + addend).min(DVec3::ONE) * front * (-density * depth).exp()
            };
            for settings in
                all(1.0 / 32.0).iter().filter(|s| s.algorithm == Algorithm::Raycast || s.quality == Quality::High)
            {
                let depth_cueing = Some(DepthCueing { front, density });
                let settings = Settings { shading: Some(shading.clone()), depth_cueing, ..settings.clone() };
                assert_frame(&scene, axis, &view, &settings, |_| true, light);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn slabs_integrate_any_piecewise_linear_function(
        // Values in tens, so that some are equal and make steps; opacities small ones mostly.
        points in prop::collection::vec(
            (-3i32..21, (0.0f64..1.0).prop_map(|a| a * a * a), prop::array::uniform3(0f32..1.0)),
            1..9,
        ),
        slices in 3usize..70,
        from_front: bool,
    ) {
        let mut points: Vec<_> = points.into_iter().map(|(value, a, c)| (10.0 * f64::from(value) + 3.7, a, c)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let scene = Prepared::new(ramp([24, 25, slices], [1.0, 1.4, 1.2], 2), function(&points), 0.0);
        let view = scene.view(&Camera::Orbit(along(2, from_front)), SIZE_ALONG, SIZE_ALONG);
        for settings in all(1.0).iter().filter(|s| s.algorithm == Algorithm::Preintegrated && accepts(&scene, &view, s)) {
            assert_frame(&scene, 2, &view, settings, |_| true, unlit);
        }
    }
}
