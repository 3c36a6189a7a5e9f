//! Meshes in a view: where rays meet them, and how they are lit.

use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3, Vec3};
use proptest::prelude::*;
use shearwarp::mesh::Mesh;
use shearwarp::render::depth::SceneDepth;
use shearwarp::render::raster::{Drawn, Solid, draw};
use shearwarp::render::{
    Algorithm, Background, Camera, Cancel, DepthCueing, LookAt, Projection, Quality, Settings, Shading, View,
};
use shearwarp::volume::{Volume, phantom};

use crate::scenes::{Prepared, high, medium, on_threads, orbit, plain};

const SIZE: [u32; 2] = [120, 100];

/// A ball of radius 1, its surface cut into so many parts along a meridian.
fn ball(parts: u32) -> Arc<Mesh> {
    let (rows, columns) = (parts, 2 * parts);
    let mut positions = vec![];
    for row in 0..=rows {
        for column in 0..columns {
            let (theta, phi) = (row as f32 / rows as f32, column as f32 / columns as f32);
            let (theta, phi) = (theta * std::f32::consts::PI, phi * std::f32::consts::TAU);
            positions.push(Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()));
        }
    }
    let mut triangles = vec![];
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [row * columns + column, row * columns + (column + 1) % columns];
            triangles.extend([[a, a + columns, b], [b, a + columns, b + columns]]);
        }
    }
    Arc::new(Mesh::new(positions.clone(), positions, triangles).unwrap())
}

fn volume() -> Volume {
    phantom::from_fn([40, 36, 44], [1.0, 1.1, 0.9], |_, _, _| 100.0)
}

fn view(volume: &Volume, camera: &Camera) -> View {
    View::new(camera, volume.centre(), volume.radius(), SIZE[0], SIZE[1]).unwrap()
}

fn solid(mesh: &Arc<Mesh>, centre: DVec3, radius: f64) -> Solid {
    let world_from_mesh = DAffine3::from_translation(centre) * DAffine3::from_scale(DVec3::splat(radius));
    Solid { mesh: Arc::clone(mesh), world_from_mesh, color: [0.2, 0.6, 1.0] }
}

fn drawn(solids: &[Solid], view: &View, settings: &Settings) -> Drawn {
    draw(solids, view, &volume(), settings, &Cancel::default()).unwrap()
}

/// Where a ray first meets a ball, mm; infinite where it does not.
fn meets(view: &View, at: DVec2, centre: DVec3, radius: f64) -> f64 {
    let ray = view.ray(at);
    let from = ray.origin - centre;
    let (b, c) = (from.dot(ray.direction), from.length_squared() - radius * radius);
    let root = b * b - c;
    if root < 0.0 { f64::INFINITY } else { -b - root.sqrt() }
}

fn pixels() -> impl Iterator<Item = (usize, usize, DVec2)> {
    (0..SIZE[1] as usize)
        .flat_map(|y| (0..SIZE[0] as usize).map(move |x| (x, y, DVec2::new(x as f64 + 0.5, y as f64 + 0.5))))
}

#[test]
fn a_ball_is_as_far_away_and_as_bright_as_a_ball() {
    let (volume, mesh) = (volume(), ball(180));
    let centre = volume.centre() + DVec3::new(3.0, -2.0, 4.0);
    let settings = Settings {
        shading: Some(Shading::default()),
        depth_cueing: Some(DepthCueing { front: 1.0, density: 0.7 }),
        ..plain(Algorithm::Preintegrated)
    };
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = view(&volume, &orbit(projection, 40.0, 25.0));
        let Drawn { depth, picture } = drawn(&[solid(&mesh, centre, 15.0)], &view, &settings);
        let (mut rim, mut seen) = (0, 0);
        for (x, y, at) in pixels() {
            let (expected, got) = (meets(&view, at, centre, 15.0), f64::from(depth.at(x, y)));
            let pixel = &picture.pixels[4 * (y * SIZE[0] as usize + x)..][..4];
            assert_eq!(pixel[3], if got.is_finite() { 255 } else { 0 });
            if expected.is_finite() != got.is_finite() {
                rim += 1;
                continue;
            }
            if !expected.is_finite() {
                continue;
            }
            seen += 1;
            let ray = view.ray(at);
            let normal = (ray.origin + ray.direction * expected - centre).normalize();
            let facing = normal.dot(ray.direction).abs();
            // Flat triangles lie within the ball; where it is seen from the side they are passed at a slant.
            assert!((got - expected).abs() < 0.01 / facing.max(0.05), "{x} {y}: {got}, not {expected}");
            let along = (ray.origin + ray.direction * expected - volume.centre()).dot(view.forward());
            let fade = (-0.7 * (along / (2.0 * volume.radius()) + 0.5)).exp();
            for (channel, color) in [0.2, 0.6, 1.0].into_iter().enumerate() {
                let lit = (color * (0.2 + 0.8 * facing) + 0.2 * facing.powi(20)).min(1.0) * fade;
                let off = (f64::from(pixel[channel]) - 255.0 * lit).abs();
                assert!(facing < 0.1 || off < 2.0, "{x} {y}: {pixel:?}, not {}", 255.0 * lit);
            }
        }
        assert!(rim <= 8 && seen > 1500, "{rim} pixels of {seen} differ on the rim");
    }
}

/// A uniform medium with a ball of triangles in it is what it is with the ball's own depths.
#[test]
fn rays_end_at_meshes_in_every_algorithm() {
    let scene = Prepared::new(volume(), medium(0.03, 1.0), 0.0);
    let (mesh, centre) = (ball(180), scene.prepared.volume().centre());
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = view(scene.prepared.volume(), &orbit(projection, 130.0, -20.0));
        let exact: Vec<f32> = pixels().map(|(.., at)| meets(&view, at, centre, 12.0) as f32).collect();
        let truth =
            scene.frame(&view.clone().ending_at(Arc::new(SceneDepth::new(&view, exact))), &plain(Algorithm::Raycast));
        let depth = Arc::new(drawn(&[solid(&mesh, centre, 12.0)], &view, &plain(Algorithm::Raycast)).depth);
        for settings in
            [high(), plain(Algorithm::Preintegrated), plain(Algorithm::Classified), plain(Algorithm::Raycast)]
        {
            let frame = scene.frame(&view.clone().ending_at(Arc::clone(&depth)), &settings);
            let alphas = frame.pixels.chunks_exact(4).zip(truth.pixels.chunks_exact(4));
            let off = alphas.filter(|(a, b)| a[3].abs_diff(b[3]) > 6).count();
            let least = if settings.quality == Quality::High { 24 } else { 360 };
            assert!(off <= least, "{projection:?} {:?}: {off} of 12000 pixels differ", settings.algorithm);
        }
    }
}

/// Where some rays end before a bright volume and their neighbours go on into it, no pixel shows a mixture of the two.
#[test]
fn a_rim_before_the_volume_is_clean() {
    let scene = Prepared::new(volume(), medium(0.95, 1.0), 0.0);
    for (projection, size) in [(Projection::Parallel, SIZE), (Projection::Perspective, [240, 200])] {
        let volume = scene.prepared.volume();
        let view = View::new(&orbit(projection, 130.0, -20.0), volume.centre(), volume.radius(), size[0], size[1]);
        let view = view.unwrap();
        let before = volume.centre() - view.forward() * 0.9 * volume.radius();
        let drawn = draw(&[solid(&ball(48), before, 8.0)], &view, volume, &high(), &Cancel::default()).unwrap();
        let ended: Vec<bool> = drawn.picture.pixels.chunks_exact(4).map(|pixel| pixel[3] > 0).collect();
        let (without, view) = (view.clone(), view.ending_at(Arc::new(drawn.depth)));
        let truth = scene.frame(&view, &plain(Algorithm::Raycast));
        for algorithm in [Algorithm::Preintegrated, Algorithm::Classified] {
            let [frame, without] = [&view, &without].map(|view| scene.frame(view, &plain(algorithm)));
            let [mut mixed, mut dark] = [0, 0];
            for (n, ended) in ended.iter().enumerate() {
                let [got, truth, without] = [&frame, &truth, &without].map(|image| image.pixels[4 * n + 3]);
                mixed += usize::from(*ended && got.abs_diff(truth) > 8);
                dark += usize::from(!ended && got.abs_diff(without) > 8);
            }
            let of = ended.iter().filter(|ended| **ended).count();
            assert!(mixed <= 4, "{projection:?} {algorithm:?}: {mixed} of {of} pixels that have ended show the volume");
            assert!(dark <= 4, "{projection:?} {algorithm:?}: {dark} beside them do not");
        }
    }
}

#[test]
fn the_nearest_of_several_is_seen_and_behind_the_eye_is_nothing() {
    let volume = volume();
    let mesh = ball(24);
    let background = Background::Opaque([1.0, 0.0, 0.0]);
    let settings = Settings { background, ..plain(Algorithm::Preintegrated) };
    let centre = volume.centre();
    let look = |position: DVec3, target: DVec3| {
        let look = LookAt {
            position,
            target,
            up: DVec3::Z,
            projection: Projection::Perspective,
            fov_y: 60.0,
            view_height: None,
        };
        view(&volume, &Camera::LookAt(look))
    };
    let middle = |solids: &[Solid], view: &View| {
        let Drawn { depth, picture } = drawn(solids, view, &settings);
        let at = (SIZE[1] / 2 * SIZE[0] + SIZE[0] / 2) as usize;
        let pixel: [u8; 3] = picture.pixels[3 * at..][..3].try_into().unwrap();
        (depth.at(SIZE[0] as usize / 2, SIZE[1] as usize / 2), pixel)
    };
    let near = Solid { color: [0.0, 1.0, 0.0], ..solid(&mesh, centre - DVec3::Y * 30.0, 5.0) };
    let far = Solid { color: [0.0, 0.0, 1.0], ..solid(&mesh, centre, 9.0) };
    let front = look(centre - DVec3::Y * 80.0, centre);
    for solids in [[near.clone(), far.clone()], [far.clone(), near.clone()]] {
        let (distance, pixel) = middle(&solids, &front);
        assert!((distance - 45.0).abs() < 0.2, "{distance}");
        assert_eq!(pixel, [0, 255, 0]);
    }
    // Turned away; and from within, where the far side is seen.
    assert_eq!(
        middle(std::slice::from_ref(&near), &look(centre - DVec3::Y * 80.0, centre - DVec3::Y * 90.0)),
        (f32::INFINITY, [255, 0, 0])
    );
    let (distance, pixel) = middle(&[far], &look(centre, centre + DVec3::Y));
    assert!((distance - 9.0).abs() < 0.2 && pixel == [0, 0, 255], "{distance}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    /// A square that is cut into triangles about a point of it: each pixel that it covers is exactly one triangle's.
    #[test]
    fn triangles_that_share_an_edge_share_no_pixel(
        across in prop::array::uniform2(0.2f32..0.8), azimuth in 0.0..360.0, elevation in -80.0..80.0, perspective: bool,
        aligned: bool,
    ) {
        let volume = volume();
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], if aligned { [0.5, 0.5] } else { across }];
        let positions = corners.map(|[x, z]| Vec3::new(x - 0.5, 0.0, z - 0.5)).to_vec();
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let (azimuth, elevation) = if aligned { (0.0, 0.0) } else { (azimuth, elevation) };
        let view = view(&volume, &orbit(projection, azimuth, elevation));
        let settings = plain(Algorithm::Preintegrated);
        let covered = |triangles: &[[u32; 3]]| -> Vec<u32> {
            let mesh = Arc::new(Mesh::new(positions.clone(), vec![], triangles.to_vec()).unwrap());
            let drawn = drawn(&[solid(&mesh, volume.centre(), 40.0)], &view, &settings);
            drawn.picture.pixels.chunks_exact(4).map(|pixel| u32::from(pixel[3] > 0)).collect()
        };
        let fan = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]];
        let mut sum = vec![0; covered(&fan).len()];
        for triangle in fan {
            sum.iter_mut().zip(covered(&[triangle])).for_each(|(sum, one)| *sum += one);
        }
        prop_assert!(sum.iter().all(|times| *times <= 1), "a pixel is covered twice");
        prop_assert_eq!(&sum, &covered(&fan));
        prop_assert_eq!(&sum, &covered(&[[0, 1, 2], [0, 2, 3]]), "a hole");
        let threads = on_threads(3, || covered(&fan));
        prop_assert_eq!(&sum, &threads);
    }
}
