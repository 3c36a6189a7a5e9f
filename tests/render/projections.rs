//! Intensity projections against closed forms, by the ray caster and on the output's own rays, and
//! skipping against no skipping.

use glam::{DVec2, DVec3};
use proptest::prelude::*;
use shearwarp::render::{
    Algorithm, Background, Blend, Camera, IntensityProjection, Orbit, Projection, Quality, Settings, View, Window,
};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume, phantom};

use crate::scenes::{Chord, Prepared, chord, medium, plain, transfer};

const SIZE: u32 = 24;
const WHICH: [IntensityProjection; 3] =
    [IntensityProjection::Maximum, IntensityProjection::Minimum, IntensityProjection::Average];
const BLUE: [f32; 3] = [0.0, 0.0, 1.0];

/// A few views from all around, of either projection.
fn views(scene: &Prepared) -> Vec<View> {
    let orbit = |n: u32| Orbit {
        projection: if n.is_multiple_of(2) { Projection::Parallel } else { Projection::Perspective },
        azimuth: f64::from(n) * 137.508,
        elevation: (1.0 - 2.0 * (f64::from(n) + 0.5) / 12.0).asin().to_degrees(),
        zoom: 1.3,
        ..Orbit::default()
    };
    let along = Orbit { azimuth: 90.0, ..Orbit::default() };
    (0..12).map(orbit).chain([along]).map(|orbit| scene.view(&Camera::Orbit(orbit), SIZE, SIZE)).collect()
}

/// Both ways to make a projection.
fn settings(which: IntensityProjection, window: Window) -> [Settings; 2] {
    let common = Settings {
        blend: Blend::Projection(which, window),
        background: Background::Opaque(BLUE),
        sample_distance: 0.125,
        ..plain(Algorithm::Raycast)
    };
    [Settings { algorithm: Algorithm::Preintegrated, quality: Quality::High, ..common.clone() }, common]
}

/// Asserts that every ray that misses the volume shows the background, and that every other one is the
/// gray of a value between those that `expected` gives, to a step of 8 bits.
fn assert_gray(
    scene: &Prepared,
    which: IntensityProjection,
    window: Window,
    expected: impl Fn(&View, DVec2, &Chord) -> (f64, f64),
) {
    let (mut hits, mut shades) = (0, [false; 256]);
    for view in views(scene) {
        for settings in settings(which, window) {
            let image = scene.frame(&view, &settings);
            for (index, pixel) in image.pixels.chunks_exact(3).enumerate() {
                let at = [index as u32 % SIZE, index as u32 / SIZE].map(|at| f64::from(at) + 0.5);
                let at = DVec2::from_array(at);
                let chord = chord(&view, scene.prepared.volume(), at);
                // Whether the shortest chords are there at all is a matter of rounding.
                if chord.length > 0.0 && chord.length < 1e-3 {
                    continue;
                } else if chord.length <= 0.0 {
                    assert_eq!(pixel, [0, 0, 255], "{which:?} beside the volume");
                    continue;
                }
                assert!(pixel[0] == pixel[1] && pixel[1] == pixel[2], "{which:?}: {pixel:?} is no gray");
                let gray = |value: f64| (255.0 * ((value - window.center) / window.width + 0.5)).clamp(0.0, 255.0);
                let (low, high) = expected(&view, at, &chord);
                let got = f64::from(pixel[0]);
                let range = gray(low) - 0.6..=gray(high) + 0.6;
                assert!(
                    range.contains(&got),
                    "{} {which:?} at {at}: {got} is not in {range:?}",
                    settings.algorithm.name()
                );
                hits += 1;
                shades[usize::from(pixel[0])] = true;
            }
        }
    }
    let shades = shades.iter().filter(|seen| **seen).count();
    assert!(hits > 1000 && shades > 40, "only {hits} pixels of {shades} shades were tested");
}

/// Where the scalar is linear, a ray's extremes are at its ends and its mean is in its middle.
#[test]
fn a_ramp_has_its_extremes_at_the_ends_of_rays_and_its_mean_in_the_middle() {
    for axis in 0..3 {
        let scene = Prepared::new(phantom::ramp(30, axis), medium(0.1, 1.0), 0.0);
        // Some of the ramp is beyond black, some beyond white.
        let window = Window { center: 1500.0, width: 2300.0 };
        for which in WHICH {
            assert_gray(&scene, which, window, |_, _, chord| {
                let [a, b] = chord.ends.map(|end| 100.0 * end[axis]);
                let value = match which {
                    IntensityProjection::Maximum => a.max(b),
                    IntensityProjection::Minimum => a.min(b),
                    IntensityProjection::Average => (a + b) / 2.0,
                };
                (value, value)
            });
        }
    }
}

/// A ball whose value falls with the square of the distance from its centre.
#[derive(Clone, Copy)]
struct Ball {
    centre: DVec3,
    radius: f64,
    peak: f64,
}

impl Ball {
    fn value(&self, at: DVec3) -> f64 {
        (self.peak * (1.0 - at.distance_squared(self.centre) / self.radius.powi(2))).max(0.0)
    }

    /// What interpolation between voxels of 1 mm takes from a square at most: the parabola's height over
    /// its chord, a quarter, for each axis.
    fn slack(&self) -> f64 {
        0.75 * self.peak / self.radius.powi(2)
    }

    /// The largest value on a ray, what interpolation may add to it where the ray touches the surface
    /// only, and the integral of the value along the ray, mm.
    fn along(&self, view: &View, at: DVec2) -> (f64, f64, f64) {
        let ray = view.ray(at);
        let from_centre = ray.origin - self.centre;
        let away = from_centre - ray.direction * from_centre.dot(ray.direction);
        let half = (self.radius.powi(2) - away.length_squared()).max(0.0).sqrt();
        let cell = 3f64.sqrt();
        // Half of what lies on either side of the middle of a cell's diagonal.
        let touching = (away.length() - self.radius).abs() < cell;
        let rounded = if touching { 2.0 * self.peak / self.radius * cell / 4.0 } else { 0.0 };
        (self.value(self.centre + away), rounded, self.peak * 4.0 / 3.0 * half.powi(3) / self.radius.powi(2))
    }
}

/// Samples are at most half a voxel apart along an axis, so the largest is within 0.25 sqrt(3) mm of
/// the ray's nearest point to a centre: closer than `slack` again.
fn assert_balls(balls: &[Ball], inverted: bool, which: IntensityProjection) {
    let top: f64 = 4000.0;
    let volume = phantom::from_fn([49, 41, 45], [1.0; 3], |i, j, k| {
        let at = DVec3::new(i as f64, j as f64, k as f64);
        let sum: f64 = balls.iter().map(|ball| ball.value(at)).sum();
        if inverted { top - sum } else { sum }
    });
    let scene = Prepared::new(volume, medium(0.1, 1.0), 0.0);
    let slack = balls.iter().map(Ball::slack).fold(0.0, f64::max);
    let window = Window { center: 1900.0, width: 3600.0 };
    assert_gray(&scene, which, window, |view, at, chord| {
        let along = balls.iter().map(|ball| ball.along(view, at));
        let largest = along.clone().map(|(largest, ..)| largest).fold(0.0, f64::max);
        let most = along.clone().map(|(largest, rounded, _)| largest + rounded).fold(0.0, f64::max);
        let mean = along.map(|(.., integral)| integral).sum::<f64>() / chord.length;
        match (which, inverted) {
            (IntensityProjection::Average, false) => (mean - slack - 0.5, mean + slack + 0.5),
            (IntensityProjection::Average, true) => (top - mean - slack - 0.5, top - mean + slack + 0.5),
            (_, false) => (largest - 2.0 * slack - 0.5, most + 0.5),
            (_, true) => (top - most - 0.5, top - largest + 2.0 * slack + 0.5),
        }
    });
}

const LARGE: Ball = Ball { centre: DVec3::new(24.0, 20.0, 22.0), radius: 18.0, peak: 3600.0 };
const TWO: [Ball; 2] = [
    Ball { centre: DVec3::new(14.0, 15.0, 16.0), radius: 12.0, peak: 2000.0 },
    Ball { centre: DVec3::new(33.0, 27.0, 30.0), radius: 11.0, peak: 3500.0 },
];

#[test]
fn a_balls_largest_value_is_where_the_ray_comes_nearest_to_its_centre() {
    assert_balls(&[LARGE], false, IntensityProjection::Maximum);
    assert_balls(&[LARGE], true, IntensityProjection::Minimum);
}

#[test]
fn of_two_balls_the_brighter_one_shows_whichever_is_in_front() {
    assert_balls(&TWO, false, IntensityProjection::Maximum);
    assert_balls(&TWO, true, IntensityProjection::Minimum);
}

#[test]
fn a_mean_is_the_integral_over_the_length_inside_the_volume() {
    assert_balls(&[LARGE], false, IntensityProjection::Average);
    assert_balls(&TWO, true, IntensityProjection::Average);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    /// The ray caster's; those on the output's own rays have their test beside their modes'.
    #[test]
    fn any_projection_is_the_same_with_skipping_and_lies_between_the_others(
        dims in prop::array::uniform3(2usize..40),
        codes in prop::collection::vec(any::<u16>(), 97),
        block in 1usize..600,
        azimuth in -180.0f64..180.0,
        elevation in -90.0f64..90.0,
        perspective: bool,
        sample_distance in 0.1f64..2.0,
    ) {
        // Noise in blocks, so that there are leaves of one scalar.
        let scalars = (0..dims.iter().product()).map(|at: usize| codes[at / block % 97]).collect();
        let report = ImportReport::plain("test", ScalarType::U16);
        let placement = Placement::from_spacing([1.0, 0.7, 1.6].into());
        let volume = Volume::new(dims, placement, Scalars::U16(scalars), (0.5, -70.0), report).unwrap();
        let scene = Prepared::new(volume, transfer(&[(0.0, 0.0), (65535.0, 0.5)]), 0.0);
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let camera = Camera::Orbit(Orbit { projection, azimuth, elevation, ..Orbit::default() });
        let view = scene.view(&camera, 20, 20);
        let window = Window { center: 16000.0, width: 33000.0 };
        let [maximum, minimum, average] = WHICH.map(|which| {
            let [_, settings] = settings(which, window);
            let settings = Settings { sample_distance, ..settings };
            let skipping = scene.frame(&view, &settings);
            let all = scene.frame(&view, &Settings { skipping: false, ..settings });
            assert!(skipping == all, "{which:?}");
            skipping
        });
        for ((high, low), mean) in maximum.pixels.iter().zip(&minimum.pixels).zip(&average.pixels) {
            prop_assert!(low <= mean && mean <= high, "{low} {mean} {high}");
        }
    }
}
