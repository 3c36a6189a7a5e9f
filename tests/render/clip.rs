//! Clip planes: what is cut away is gone, what is left is as it was, and faces lie where they should.

use glam::{DMat3, DVec3};
use proptest::prelude::*;
use shearwarp::render::{Algorithm, Ball, Camera, Clip, HalfSpace, Image, Projection, Quality, Settings, Shading};
use shearwarp::volume::phantom;

use crate::scenes::{Prepared, high, medium, orbit, plain, same_bits, transfer};

const SIZE: [u32; 2] = [100, 90];

/// Thirty planes through or near the middle of a volume, every way round.
fn planes(scene: &Prepared) -> impl Iterator<Item = HalfSpace> {
    let (centre, radius) = (scene.prepared.volume().centre(), scene.prepared.volume().radius());
    (0..30).map(move |n| {
        let turn = DMat3::from_rotation_z(f64::from(n) * 2.4) * DMat3::from_rotation_x(f64::from(n) * 1.7);
        let normal = turn * DVec3::new(0.3, 0.2, 1.0).normalize();
        let point = centre + normal * radius * 0.3 * (f64::from(n) * 0.9).sin();
        HalfSpace { normal, offset: -normal.dot(point) }
    })
}

/// One of many cameras, every way round.
fn camera(projection: Projection, n: u32) -> Camera {
    orbit(projection, f64::from(n) * 77.0, (f64::from(n) * 1.3).sin() * 80.0)
}

/// All of what some planes leave.
fn by(planes: &[HalfSpace]) -> Clip {
    Clip { halves: planes.to_vec(), balls: vec![] }
}

/// A frame and the ray caster's, which is exact.
fn frame_and_truth(scene: &Prepared, camera: &Camera, clip: &Clip, settings: &Settings) -> [Image; 2] {
    let view = scene.view(camera, SIZE[0], SIZE[1]).clipped(clip);
    let exact = Settings { algorithm: Algorithm::Raycast, sample_distance: 0.1, ..settings.clone() };
    [settings, &exact].map(|settings| scene.frame(&view, settings))
}

fn alphas(image: &Image) -> impl Iterator<Item = i32> {
    image.pixels.chunks_exact(4).map(|pixel| i32::from(pixel[3]))
}

/// How many in a thousand pixels differ by more than `steps`.
fn beyond([a, b]: &[Image; 2], steps: i32) -> f64 {
    let beyond = alphas(a).zip(alphas(b)).filter(|(a, b)| (a - b).abs() > steps).count();
    1000.0 * beyond as f64 / f64::from(SIZE[0] * SIZE[1])
}

/// A cube of a uniform medium: its opacity has a closed form, which the ray caster meets.
fn cube() -> Prepared {
    Prepared::new(phantom::from_fn([40, 36, 44], [1.0, 1.1, 0.9], |_, _, _| 100.0), medium(0.04, 1.0), 0.0)
}

/// `high` is the ray caster's to a step of 8 bits. Slabs and single slices draw the volume's own sides to the nearest half, cut or
/// not, and the warp blurs outlines; a cut adds no more than an outline of its own.
#[test]
fn a_cut_medium_is_as_deep_as_what_is_left_of_it() {
    let scene = cube();
    for projection in [Projection::Parallel, Projection::Perspective] {
        for (n, plane) in (0..).zip(planes(&scene)) {
            let camera = camera(projection, n);
            let off = |settings: &Settings, planes: &[HalfSpace], steps| {
                beyond(&frame_and_truth(&scene, &camera, &by(planes), settings), steps)
            };
            let cut = off(&high(), &[plane], 1);
            assert!(cut <= 1.0, "{projection:?} {n}, high: {cut} in a thousand differ by more than 1");
            for settings in [plain(Algorithm::Preintegrated), plain(Algorithm::Classified)] {
                let (cut, whole) = (off(&settings, &[plane], 6), off(&settings, &[], 6));
                let algorithm = settings.algorithm;
                assert!(cut <= whole + 30.0, "{projection:?} {n}, {algorithm:?}: {cut} in a thousand against {whole}");
            }
        }
    }
}

/// An opaque cube, cut: few pixels of some 300 along its outline are more than half covered in one picture and less than half
/// in the other, as of the whole cube.
#[test]
fn cut_silhouettes_lie_within_half_a_pixel() {
    let scene =
        Prepared::new(phantom::from_fn([40, 36, 44], [1.0, 1.1, 0.9], |_, _, _| 100.0), medium(0.999, 1.0), 0.0);
    for algorithm in [Algorithm::Preintegrated, Algorithm::Classified] {
        for projection in [Projection::Parallel, Projection::Perspective] {
            for (n, plane) in (0..).zip(planes(&scene)) {
                let camera = camera(projection, n);
                let off = |planes: &[HalfSpace]| {
                    beyond(&frame_and_truth(&scene, &camera, &by(planes), &plain(algorithm)), 128)
                };
                let (cut, whole) = (off(&[plane]), off(&[]));
                assert!(cut <= whole + 8.0, "{algorithm:?} {projection:?} {n}: {cut} in a thousand against {whole}");
            }
        }
    }
}

/// A ball of a uniform medium that is larger: its rim is all there is of outlines.
#[test]
fn a_ball_that_is_left_of_a_medium_is_as_deep_as_a_ball() {
    let scene = cube();
    let centre = scene.prepared.volume().centre();
    let clip = Clip { halves: vec![], balls: vec![Ball::new(centre + DVec3::new(1.0, -2.0, 0.5), 15.0)] };
    for projection in [Projection::Parallel, Projection::Perspective] {
        for n in 0..8 {
            let camera = camera(projection, n);
            let off = |settings: &Settings, steps| beyond(&frame_and_truth(&scene, &camera, &clip, settings), steps);
            let high = off(&high(), 1);
            assert!(high <= 1.0, "{projection:?} {n}: {high} in a thousand pixels of high differ by more than 1");
            for algorithm in [Algorithm::Preintegrated, Algorithm::Classified] {
                let off = off(&plain(algorithm), 6);
                assert!(off <= 30.0, "{projection:?} {n}, {algorithm:?}: {off} in a thousand");
            }
        }
    }
}

/// Slices 5 mm apart, and shapes that are thinner and lie between two of them. Seen from the side they lie between two of the
/// intermediate image's scanlines, and only rays of the picture's own meet them.
#[test]
fn what_lies_between_two_slices_is_left() {
    let scene = Prepared::new(phantom::from_fn([40, 36, 12], [1.0, 1.1, 5.0], |_, _, _| 100.0), medium(0.5, 1.0), 0.0);
    let middle = scene.prepared.volume().centre();
    // The middle lies half-way between two slices.
    let corners =
        [0, 1, 2, 3, 4, 5, 6, 7].map(|n| DVec3::new(f64::from(n % 2), f64::from(n / 2 % 2), f64::from(n / 4)) - 0.5);
    let shape = |size: DVec3| Clip::hull(&corners.map(|corner| middle + corner * size)).unwrap();
    let ball = Clip { halves: vec![], balls: vec![Ball::new(middle, 2.0)] };
    for (shape, least) in [(shape(DVec3::new(24.0, 20.0, 1.0)), 30), (ball, 8)] {
        for projection in [Projection::Parallel, Projection::Perspective] {
            for (azimuth, elevation) in [(0.0, 90.0), (30.0, 83.0), (200.0, -85.0), (0.0, 0.0), (40.0, 15.0)] {
                let camera = orbit(projection, azimuth, elevation);
                for settings in [
                    high(),
                    plain(Algorithm::Preintegrated),
                    plain(Algorithm::Classified),
                    plain(Algorithm::FastClassification),
                ] {
                    if settings.quality != Quality::High && f64::abs(elevation) < 80.0 {
                        continue;
                    }
                    let images = frame_and_truth(&scene, &camera, &shape, &settings);
                    let seen = alphas(&images[1]).filter(|alpha| *alpha > 100).count();
                    assert!(seen >= least, "{seen} pixels show it");
                    let sum = |image: &Image| f64::from(alphas(image).sum::<i32>());
                    let ratio = sum(&images[0]) / sum(&images[1]);
                    let name = (settings.algorithm, settings.quality, projection, azimuth, elevation);
                    // Of a ball of four pixels the warp makes more or less.
                    let most = if settings.quality == Quality::High { 0.1 } else { 0.25 };
                    assert!((ratio - 1.0).abs() < most, "{name:?}: {ratio} of it");
                }
            }
        }
    }
}

#[test]
fn a_part_and_what_was_cut_from_it_are_the_whole() {
    let scene = cube();
    for (n, plane) in (0..).zip(planes(&scene)) {
        let other = HalfSpace { normal: -plane.normal, offset: -plane.offset };
        for settings in [high(), plain(Algorithm::Preintegrated), plain(Algorithm::Classified)] {
            let view = scene.view(&camera(Projection::Parallel, n), SIZE[0], SIZE[1]);
            let clear = |planes: &[HalfSpace]| -> Vec<f64> {
                let image = scene.frame(&view.clone().clipped(&by(planes)), &settings);
                alphas(&image).map(|alpha| 1.0 - f64::from(alpha) / 255.0).collect()
            };
            let (one, two, whole) = (clear(&[plane]), clear(&[other]), clear(&[]));
            let off =
                one.iter().zip(&two).zip(&whole).filter(|((a, b), whole)| (*a * *b - *whole).abs() > 0.02).count();
            assert!(off < 150, "{n} {:?} {:?}: {off} pixels", settings.algorithm, settings.quality);
        }
    }
}

#[test]
fn a_plane_that_misses_the_volume_changes_no_bit() {
    let scene =
        Prepared::new(phantom::noise([30, 28, 26], 5), transfer(&[(0.0, 0.0), (1500.0, 0.0), (2500.0, 0.7)]), 0.002);
    let far = HalfSpace { normal: DVec3::X, offset: 1e6 };
    for projection in [Projection::Parallel, Projection::Perspective] {
        for settings in
            [high(), plain(Algorithm::Preintegrated), plain(Algorithm::Classified), plain(Algorithm::Raycast)]
        {
            let view = scene.view(&camera(projection, 3), 60, 50);
            assert!(scene.frame(&view, &settings) == scene.frame(&view.clone().clipped(&by(&[far])), &settings));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn cutting_leaves_the_twins_the_same(
        n in 0u32..1000,
        normal in prop::array::uniform3(-1.0f64..1.0),
        part in -0.5f64..0.5,
        thickness in 0.05f64..0.8,
        perspective: bool,
        lit: bool,
        slabs: bool,
    ) {
        let normal = DVec3::from_array(normal).try_normalize().unwrap_or(DVec3::Z);
        let scene =
            Prepared::new(phantom::noise([26, 22, 24], n), transfer(&[(0.0, 0.0), (1400.0, 0.0), (2300.0, 0.4)]), 0.002);
        let (centre, radius) = (scene.prepared.volume().centre(), scene.prepared.volume().radius());
        // A slice of the volume between two planes.
        let at = |part: f64| normal.dot(centre + normal * radius * part);
        let planes = [
            HalfSpace { normal, offset: -at(part) },
            HalfSpace { normal: -normal, offset: at(part + thickness) },
        ];
        let ball = Ball::new(centre + normal * 2.0, radius * (0.5 + thickness));
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let view = scene.view(&camera(projection, n), 40, 36).clipped(&Clip { halves: planes.to_vec(), balls: vec![ball] });
        let algorithm = if slabs { Algorithm::Preintegrated } else { Algorithm::Classified };
        let settings = Settings { shading: lit.then(Shading::default), early_ray_termination: 0.98, ..plain(algorithm) };
        same_bits(&scene, &view, &settings);
    }
}
