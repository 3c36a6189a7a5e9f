//! Opaque geometry within the volume: rays end where they meet it.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use proptest::prelude::*;
use shearwarp::render::depth::SceneDepth;
use shearwarp::render::{Algorithm, Image, Projection, Ray, Settings, Shading, View};
use shearwarp::volume::phantom;

use crate::scenes::{Prepared, high, medium, orbit, plain, same_bits, transfer};

const SIZE: [u32; 2] = [120, 100];

/// Where a ray first meets a sphere and a cone that stands on its tip beside it; mm, infinite where it meets neither.
fn sphere_and_cone(ray: &Ray, centre: DVec3, size: f64) -> f64 {
    let roots = |a: f64, b: f64, c: f64| {
        let root = (b * b - 4.0 * a * c).sqrt();
        [(-b - root) / (2.0 * a), (-b + root) / (2.0 * a)].into_iter().filter(|t| t.is_finite())
    };
    let to = ray.origin - (centre - DVec3::X * size * 0.4);
    let sphere =
        roots(1.0, 2.0 * to.dot(ray.direction), to.dot(to) - (size * 0.5).powi(2)).fold(f64::INFINITY, f64::min);
    // x^2 + y^2 = z^2 / 2 for 0 <= z <= 1.2 size.
    let (o, d) = (ray.origin - (centre + DVec3::X * size * 0.5 - DVec3::Z * size * 0.6), ray.direction);
    let dot = |a: DVec3, b: DVec3| a.x * b.x + a.y * b.y - 0.5 * a.z * b.z;
    let on = |t: &f64| (0.0..1.2 * size).contains(&(o.z + t * d.z));
    let cone = roots(dot(d, d), 2.0 * dot(o, d), dot(o, o)).filter(on).fold(f64::INFINITY, f64::min);
    let lid = Some((1.2 * size - o.z) / d.z).filter(|t| (o + d * *t).truncate().length() * 2f64.sqrt() < 1.2 * size);
    sphere.min(cone).min(lid.unwrap_or(f64::INFINITY))
}

/// The view with the two in the middle of the volume.
fn with_scene(scene: &Prepared, view: View) -> View {
    let volume = scene.prepared.volume();
    let (centre, size) = (volume.centre(), volume.radius() * 0.6);
    let (width, height) = view.size();
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)));
    let distances = pixels.map(|at| sphere_and_cone(&view.ray(at), centre, size) as f32).collect();
    let depth = SceneDepth::new(&view, distances);
    view.ending_at(Arc::new(depth))
}

/// In a thousand: pixels whose opacity differs by more than `steps`.
fn beyond(a: &Image, b: &Image, steps: u8) -> f64 {
    let pixels = a.pixels.chunks_exact(4).zip(b.pixels.chunks_exact(4));
    1000.0 * pixels.filter(|(a, b)| a[3].abs_diff(b[3]) > steps).count() as f64 / f64::from(SIZE[0] * SIZE[1])
}

#[test]
fn a_sphere_and_a_cone_in_a_uniform_medium_end_rays_where_they_are() {
    let scene = Prepared::new(phantom::from_fn([60, 64, 56], [1.0, 1.0, 1.1], |_, _, _| 100.0), medium(0.01, 1.0), 0.0);
    for projection in [Projection::Parallel, Projection::Perspective] {
        for (azimuth, elevation) in [(10.0, 5.0), (75.0, 20.0), (200.0, -35.0), (130.0, 70.0)] {
            let view = scene.view(&orbit(projection, azimuth, elevation), SIZE[0], SIZE[1]);
            let hybrid = with_scene(&scene, view.clone());
            let exact = Settings { sample_distance: 0.05, ..plain(Algorithm::Raycast) };
            let [truth, whole] = [&hybrid, &view].map(|view| scene.frame(view, &exact));
            let ended = beyond(&truth, &whole, 3);
            assert!(ended > 80.0, "the scene is seen in {ended} of a thousand pixels only");
            let at = format!("{projection:?} {azimuth} {elevation}");
            let off = beyond(&scene.frame(&hybrid, &high()), &truth, 1);
            assert!(off <= 1.0, "{at}: {off} in a thousand pixels of high are more than 1 off");
            for algorithm in [Algorithm::Preintegrated, Algorithm::Classified] {
                // The volume's own sides are drawn to the nearest half slab, with a scene or without.
                let own = beyond(&scene.frame(&view, &plain(algorithm)), &whole, 1);
                let off = beyond(&scene.frame(&hybrid, &plain(algorithm)), &truth, 1);
                assert!(off <= own + 25.0, "{at}, {algorithm:?}: {off} in a thousand, {own} without a scene");
            }
        }
    }
}

#[test]
fn geometry_in_front_hides_all_and_behind_nothing() {
    let scene =
        Prepared::new(phantom::noise([30, 28, 26], 5), transfer(&[(0.0, 0.0), (1500.0, 0.0), (2500.0, 0.7)]), 0.002);
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = scene.view(&orbit(projection, 40.0, 20.0), 60, 50);
        for settings in
            [high(), plain(Algorithm::Preintegrated), plain(Algorithm::Classified), plain(Algorithm::Raycast)]
        {
            let frame = |distance: f32| {
                let depth = SceneDepth::new(&view, vec![distance; 3000]);
                scene.frame(&view.clone().ending_at(Arc::new(depth)), &settings)
            };
            let whole = scene.frame(&view, &settings);
            assert!(frame(f32::INFINITY) == whole, "{settings:?}");
            assert!(frame(1e6) == whole, "{settings:?}");
            assert!(frame(-1e6).pixels.iter().all(|&byte| byte == 0), "{settings:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn ending_rays_leaves_the_twins_the_same(
        seed in 0u32..1000,
        azimuth in 0.0f64..360.0,
        elevation in -80.0f64..80.0,
        perspective: bool,
        lit: bool,
        slabs: bool,
    ) {
        let scene =
            Prepared::new(phantom::noise([26, 22, 24], seed), transfer(&[(0.0, 0.0), (1400.0, 0.0), (2300.0, 0.4)]), 0.002);
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let view = with_scene(&scene, scene.view(&orbit(projection, azimuth, elevation), 40, 36));
        let algorithm = if slabs { Algorithm::Preintegrated } else { Algorithm::Classified };
        let settings = Settings { shading: lit.then(Shading::default), early_ray_termination: 0.98, ..plain(algorithm) };
        same_bits(&scene, &view, &settings);
    }
}
