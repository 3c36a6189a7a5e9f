//! Regions of a volume that look otherwise: what is not changed is as it was, and what is is where it should be.

use glam::DVec3;
use proptest::prelude::*;
use shearwarp::render::regions::{Region, render_with_regions};
use shearwarp::render::{
    Algorithm, Ball, Blend, Cancel, Clip, DepthCueing, HalfSpace, Image, IntensityProjection, Projection, Settings,
    Shading, View, Window,
};
use shearwarp::volume::{Volume, phantom};

use crate::scenes::{Prepared, high, medium, on_threads, orbit, plain, premultiplied, transfer};

const SIZE: [u32; 2] = [100, 90];

/// Every way to make a frame.
fn all_settings() -> [Settings; 5] {
    let [classified, fast, slabs, exact] =
        [Algorithm::Classified, Algorithm::FastClassification, Algorithm::Preintegrated, Algorithm::Raycast].map(plain);
    [classified, fast, slabs, high(), Settings { sample_distance: 0.1, ..exact }]
}

/// A ball beside the middle, with a part of its own in it, and a half of the world that holds some of both.
fn shapes(volume: &Volume) -> [Clip; 3] {
    let (centre, radius) = (volume.centre(), volume.radius());
    let ball =
        |at: DVec3, size: f64| Clip { halves: vec![], balls: vec![Ball::new(centre + at * radius, size * radius)] };
    let normal = DVec3::new(0.6, 0.0, 0.8);
    let half = HalfSpace { normal, offset: -normal.dot(centre + normal * radius * 0.25) };
    [
        ball(DVec3::new(0.1, -0.2, 0.0), 0.4),
        ball(DVec3::new(0.0, -0.2, 0.1), 0.2),
        Clip { halves: vec![half], balls: vec![] },
    ]
}

/// A frame of a scene with parts that look as told; `None`: as nothing.
fn frame(
    scene: &Prepared,
    view: &View,
    settings: &Settings,
    regions: &[(Clip, Option<(&Prepared, &Settings)>)],
    encoded: bool,
) -> Image {
    let regions: Vec<_> = regions
        .iter()
        .map(|(shape, shown)| Region {
            shape: shape.clone(),
            shown: shown.map(|(scene, settings)| (scene.scene(settings.algorithm, encoded), settings)),
        })
        .collect();
    let around = scene.scene(settings.algorithm, encoded);
    render_with_regions(&around, view, settings, &regions, &Cancel::default()).unwrap().0
}

/// How many in a thousand pixels differ by more than `steps` in any component.
fn beyond(a: &Image, b: &Image, steps: u8) -> f64 {
    let differ = |(a, b): &([f64; 4], [f64; 4])| (0..4).any(|n| (a[n] - b[n]).abs() > f64::from(steps) + 0.5);
    1000.0 * premultiplied(a).zip(premultiplied(b)).filter(differ).count() as f64 / f64::from(a.width * a.height)
}

fn alpha(image: &Image) -> impl Iterator<Item = f64> {
    image.pixels.chunks_exact(4).map(|pixel| f64::from(pixel[3]) / 255.0)
}

fn noise() -> Prepared {
    let function = transfer(&[(0.0, 0.0), (1400.0, 0.0), (2200.0, 0.03), (2900.0, 0.2)]);
    Prepared::new(phantom::noise([40, 36, 44], 5), function, 0.0)
}

#[test]
fn regions_that_look_like_what_is_around_them_do_not_show() {
    let scene = noise();
    let shapes = shapes(scene.prepared.volume());
    for projection in [Projection::Parallel, Projection::Perspective] {
        for (azimuth, elevation) in [(20.0, 10.0), (100.0, -30.0), (250.0, 75.0)] {
            let view = scene.view(&orbit(projection, azimuth, elevation), SIZE[0], SIZE[1]);
            for settings in &all_settings() {
                let whole = frame(&scene, &view, settings, &[], true);
                let regions = shapes.clone().map(|shape| (shape, Some((&scene, settings))));
                let parts = frame(&scene, &view, settings, &regions, true);
                let off = beyond(&whole, &parts, 2);
                let name = (settings.algorithm, settings.quality, projection, azimuth);
                // Slabs that end at a rim are two, looked up by the scalars there.
                assert!(off <= 0.5, "{name:?}: {off} in a thousand differ");
            }
        }
    }
}

#[test]
fn what_is_cut_out_and_what_is_left_of_a_medium_make_the_whole() {
    let scene = Prepared::new(phantom::from_fn([40, 36, 44], [1.0, 1.1, 0.9], |_, _, _| 100.0), medium(0.03, 1.0), 0.0);
    let [ball, _, half] = shapes(scene.prepared.volume());
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = scene.view(&orbit(projection, 130.0, 25.0), SIZE[0], SIZE[1]);
        for settings in &all_settings() {
            for shape in [&ball, &half] {
                let whole = frame(&scene, &view, settings, &[], true);
                let outside = frame(&scene, &view, settings, &[(shape.clone(), None)], true);
                let inside = frame(&scene, &view.clone().clipped(shape), settings, &[], true);
                let seen = alpha(&inside).filter(|a| *a > 0.3).count();
                assert!(seen > 500, "only {seen} pixels are of the inside");
                let off = alpha(&whole).zip(alpha(&inside)).zip(alpha(&outside)).map(|((whole, inside), outside)| {
                    let both = 1.0 - (1.0 - inside) * (1.0 - outside);
                    255.0 * (whole - both).abs()
                });
                let (mut off, name) = (off.collect::<Vec<_>>(), (settings.algorithm, settings.quality, projection));
                off.sort_unstable_by(f64::total_cmp);
                // Along the rims of parts that are warped one by one opacities are interpolated, and not their products.
                let [most, largest] = [off[off.len() * 99 / 100], off[off.len() - 1]];
                assert!(most <= 2.5 && largest <= 6.0, "{name:?}: off by {most} in 99 %, by {largest} at most");
            }
        }
    }
}

#[test]
fn regions_are_where_the_ray_caster_has_them() {
    let around = noise();
    let within =
        Prepared::new(phantom::noise([40, 36, 44], 5), transfer(&[(0.0, 0.02), (2000.0, 0.0), (2900.0, 0.05)]), 0.0);
    let [ball, inner, half] = shapes(around.prepared.volume());
    let window = Window { center: 1500.0, width: 3000.0 };
    let maximum = |settings: &Settings| Settings {
        blend: Blend::Projection(IntensityProjection::Maximum, window),
        ..settings.clone()
    };
    for projection in [Projection::Parallel, Projection::Perspective] {
        for (azimuth, elevation) in [(20.0, 10.0), (100.0, -30.0), (250.0, 75.0)] {
            let view = around.view(&orbit(projection, azimuth, elevation), SIZE[0], SIZE[1]);
            let made = |settings: &Settings, project: bool| {
                let inside = if project { maximum(settings) } else { settings.clone() };
                let regions = [
                    (ball.clone(), Some((&within, settings))),
                    (inner.clone(), Some((&around, &inside))),
                    (half.clone(), None),
                ];
                frame(&around, &view, settings, &regions, true)
            };
            for project in [false, true] {
                let [classified, fast, slabs, high, exact] = &all_settings();
                let truth = made(exact, project);
                let whole = frame(&around, &view, exact, &[], true);
                assert!(beyond(&truth, &whole, 8) > 100.0, "nothing looks otherwise");
                let name = (projection, azimuth, project);
                let off = beyond(&made(high, project), &truth, 3);
                assert!(off <= 2.0, "{name:?}: {off} in a thousand of high are off");
                // As far off as a frame without regions is, and some along their rims.
                for settings in [slabs, classified, fast].into_iter().take(if project { 1 } else { 3 }) {
                    let own = beyond(&frame(&around, &view, settings, &[], true), &whole, 8);
                    let off = beyond(&made(settings, project), &truth, 8);
                    assert!(off <= own + 40.0, "{name:?} {:?}: {off} in a thousand, {own} without", settings.algorithm);
                }
            }
        }
    }
}

/// Depth cueing may make colours brighter than their opacity: no sum of layers is more than white.
#[test]
fn colours_of_layers_end_at_white() {
    let scene = noise();
    let [ball, ..] = shapes(scene.prepared.volume());
    let view = scene.view(&orbit(Projection::Parallel, 20.0, 10.0), SIZE[0], SIZE[1]);
    for settings in all_settings() {
        let settings = Settings { depth_cueing: Some(DepthCueing { front: 10.0, density: 0.5 }), ..settings };
        let whole = frame(&scene, &view, &settings, &[], true);
        assert!(whole.pixels.chunks_exact(4).filter(|pixel| pixel[0] == 255 && pixel[3] < 200).count() > 100);
        let parts = frame(&scene, &view, &settings, &[(ball.clone(), Some((&scene, &settings)))], true);
        let off = beyond(&whole, &parts, 3);
        assert!(off <= 3.0, "{:?} {:?}: {off} in a thousand differ", settings.algorithm, settings.quality);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn neither_skipping_nor_encodings_nor_threads_change_a_bit(
        azimuth in 0.0..360.0, elevation in -90.0..90.0, perspective: bool, seed in 0..100u32, size in 0.2..1.0,
    ) {
        let volume = phantom::noise([20, 24, 18], seed);
        let around = Prepared::new(volume.clone(), transfer(&[(1500.0, 0.0), (2500.0, 0.4)]), 0.0);
        let within = Prepared::new(volume, transfer(&[(0.0, 0.05), (1800.0, 0.0), (2600.0, 0.9)]), 0.0);
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let view = around.view(&orbit(projection, azimuth, elevation), 48, 40);
        let [ball, _, half] = shapes(around.prepared.volume());
        let centre = around.prepared.volume().centre();
        let small = Clip { halves: vec![], balls: vec![Ball::new(centre, 10.0 * size)] };
        // Holes in what is around, and one that is thinner than a slab.
        let thin = [HalfSpace { normal: DVec3::Y, offset: 0.3 - centre.y }, HalfSpace { normal: -DVec3::Y, offset: centre.y }];
        let thin = Clip { halves: thin.to_vec(), balls: vec![Ball::new(centre, 7.0)] };
        for settings in all_settings() {
            let settings = Settings { shading: Some(Shading::default()), early_ray_termination: 0.97, ..settings };
            let made = |skipping: bool, encoded: bool| {
                let settings = Settings { skipping, ..settings.clone() };
                let regions = [
                    (ball.clone(), Some((&within, &settings))),
                    (half.clone(), None),
                    (small.clone(), Some((&around, &settings))),
                    (thin.clone(), None),
                ];
                frame(&around, &view, &settings, &regions, encoded)
            };
            let first = made(true, true);
            prop_assert!(first == made(false, true), "skipping changes {:?}", settings.algorithm);
            prop_assert!(first == made(true, false), "encodings change {:?}", settings.algorithm);
            prop_assert!(first == on_threads(3, || made(true, true)), "threads change {:?}", settings.algorithm);
            // Holes alone, in what a ball leaves.
            let view = view.clone().clipped(&Clip { halves: vec![], balls: vec![Ball::new(centre, 11.0)] });
            let hollow = |skipping: bool, encoded: bool| {
                let settings = Settings { skipping, ..settings.clone() };
                let holes = [&half, &thin, &small].map(|hole| (hole.clone(), None));
                frame(&around, &view, &settings, &holes, encoded)
            };
            let first = hollow(true, true);
            prop_assert!(first == hollow(false, true), "skipping changes holes of {:?}", settings.algorithm);
            prop_assert!(first == hollow(true, false), "encodings change holes of {:?}", settings.algorithm);
        }
    }
}
