//! Uniform media: alpha is 1 - exp(-tau L), L the length of the ray inside.

use glam::{DVec2, DVec3};
use shearwarp::render::{Algorithm, Camera, Image, Orbit, Projection};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{Prepared, chord, medium, plain, transfer};

const SIZE: u32 = 48;
const OPACITY: f64 = 0.03;

/// Fifty views that cover the sphere.
fn views() -> impl Iterator<Item = Orbit> {
    (0..50).map(|n| Orbit {
        azimuth: f64::from(n) * 137.508 - 180.0,
        elevation: (1.0 - 2.0 * (f64::from(n) + 0.5) / 50.0).asin().to_degrees(),
        roll: f64::from(n) * 11.0,
        ..Orbit::default()
    })
}

fn volume(dims: [usize; 3], spacing: [f64; 3], code: impl Fn(DVec3) -> u8) -> Volume {
    let codes = (0..dims.iter().product()).map(|index: usize| {
        let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
        code(DVec3::from_array(at.map(|i| i as f64)))
    });
    let report = ImportReport::plain("test", ScalarType::U8);
    let placement = Placement::from_spacing(spacing.into());
    Volume::new(dims, placement, Scalars::U8(codes.collect()), (1.0, 0.0), report).unwrap()
}

fn alpha(image: &Image, x: u32, y: u32) -> f64 {
    f64::from(image.pixels[((y * image.width + x) * 4 + 3) as usize]) / 255.0
}

/// The extinction of the test medium per mm.
fn tau() -> f64 {
    -(1.0 - OPACITY).ln()
}

/// Asserts that each pixel's alpha lies between those of the shortest and the longest length.
fn assert_alpha(image: &Image, lengths: impl Fn(DVec2) -> (f64, f64), what: &str) {
    let opacity = |length: f64| 1.0 - (-tau() * length.max(0.0)).exp();
    let mut solid = 0;
    for y in 0..SIZE {
        for x in 0..SIZE {
            let (short, long) = lengths(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
            let got = alpha(image, x, y);
            // One step of 8 bits for rounding.
            let range = opacity(short) - 1.0 / 255.0..=opacity(long) + 1.0 / 255.0;
            assert!(range.contains(&got), "{what}, pixel {x} {y}: {got} is not in {range:?}");
            solid += usize::from(short > 0.0);
        }
    }
    assert!(solid > 100, "{what}: only {solid} pixels were tested inside");
}

/// The ray caster's samples of a uniform medium are all alike, so their number does not matter:
/// nothing is left but rounding.
#[test]
fn the_ray_caster_meets_a_uniform_box_to_rounding() {
    let scene = Prepared::new(volume([20, 24, 18], [1.0, 1.3, 2.0], |_| 9), medium(OPACITY, 1.0), 0.0);
    for projection in [Projection::Parallel, Projection::Perspective] {
        for orbit in views() {
            let view = scene.view(&Camera::Orbit(Orbit { projection, ..orbit.clone() }), SIZE, SIZE);
            let image = scene.frame(&view, &plain(Algorithm::Raycast));
            let length = |at| chord(&view, scene.prepared.volume(), at).length;
            assert_alpha(&image, |at| (length(at), length(at)), &format!("{projection:?} {orbit:?}"));
        }
    }
}

/// Two things separate the slices' sum from the integral. A ray that enters or leaves through a side
/// between two slices has up to half a slice distance more or less at each end. And the warp blends
/// the rays of intermediate pixels less than a voxel away along either axis, so that a pixel lies
/// between the shortest and the longest of its neighbourhood.
#[test]
fn slices_and_slabs_meet_a_uniform_box_to_a_slice_and_a_voxel() {
    let scene = Prepared::new(volume([40, 48, 36], [1.0, 1.2, 1.5], |_| 9), medium(OPACITY, 1.0), 0.0);
    let volume = scene.prepared.volume();
    for orbit in views() {
        let view = scene.view(&Camera::Orbit(orbit.clone()), SIZE, SIZE);
        let index_from_world = volume.world_from_index().inverse();
        let along = index_from_world.transform_vector3(view.forward()).abs();
        let slice_distance = 1.0 / along.max_element();
        let pixel = 2.0 * volume.radius() / f64::from(SIZE);
        let reach = volume.placement().spacing.max_element() * 2f64.sqrt() / pixel;
        let lengths = |at: DVec2| {
            let offsets = (-2..=2).flat_map(|x| (-2..=2).map(move |y| DVec2::new(f64::from(x), f64::from(y)) / 2.0));
            let near: Vec<f64> = offsets.map(|o| chord(&view, volume, at + o * reach).length).collect();
            let shortest = near.iter().copied().fold(f64::INFINITY, f64::min);
            let longest = near.iter().copied().fold(0.0, f64::max);
            let end = if longest > 0.0 { slice_distance } else { 0.0 };
            (shortest - end, longest + end)
        };
        for algorithm in [Algorithm::Classified, Algorithm::FastClassification, Algorithm::Preintegrated] {
            let image = scene.frame(&view, &plain(algorithm));
            assert_alpha(&image, lengths, &format!("{algorithm:?} {orbit:?}"));
        }
    }
}

/// A ball's surface is smoothed over 1.5 voxels and then resampled, so its radius is known to a voxel
/// and a half; inside, the chords are those of the ball.
#[test]
fn every_algorithm_meets_a_ball_to_a_voxel_and_a_half_of_radius() {
    let (centre, radius) = (DVec3::splat(24.0), 18.0);
    let ball = volume([49; 3], [1.0; 3], |at| {
        (((radius - at.distance(centre)) / 1.5 + 0.5).clamp(0.0, 1.0) * 200.0).round() as u8
    });
    let steep = transfer(&[(0.0, 0.0), (80.0, 0.0), (120.0, OPACITY), (255.0, OPACITY)]);
    let scene = Prepared::new(ball, steep, 0.0);
    let pixel = 2.0 * scene.prepared.volume().radius() / f64::from(SIZE);
    for orbit in views() {
        let view = scene.view(&Camera::Orbit(orbit.clone()), SIZE, SIZE);
        for algorithm in [Algorithm::Raycast, Algorithm::Classified, Algorithm::Preintegrated] {
            let image = scene.frame(&view, &plain(algorithm));
            let lengths = |at: DVec2| {
                let away = at.distance(DVec2::splat(f64::from(SIZE) / 2.0)) * pixel;
                let chord = |r: f64| if r > away { 2.0 * (r * r - away * away).sqrt() } else { 0.0 };
                (chord(radius - 1.5), chord(radius + 1.5))
            };
            assert_alpha(&image, lengths, &format!("{algorithm:?} {orbit:?}"));
        }
    }
}
