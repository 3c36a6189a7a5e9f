//! Intermediate images: warped by a sampler of this test's own they are the final frames.

use glam::{DVec2, DVec3, Vec4};
use shearwarp::render::{Algorithm, Background, Camera, Image, Orbit, Projection, Quality, Settings, Stage};
use shearwarp::volume::phantom;

use crate::scenes::{ANGLES, Prepared, plain, transfer};

const SIZE: [u32; 2] = [150, 130];

/// A ball of layers, some of them empty, with room around it.
fn ball() -> Prepared {
    let volume = phantom::from_fn([44, 48, 46], [1.0; 3], |i, j, k| {
        let at = DVec3::new(i as f64 - 21.5, j as f64 - 23.5, k as f64 - 22.5);
        ((18.0 - at.length()).clamp(0.0, 4.0) * 25.0 * (1.0 + (at.x * 0.4).sin() * (at.y * 0.3).cos())).round()
    });
    Prepared::new(volume, transfer(&[(0.0, 0.0), (20.0, 0.0), (60.0, 0.3), (200.0, 0.8)]), 0.002)
}

fn orbit((azimuth, elevation): (f64, f64), projection: Projection, zoom: f64) -> Camera {
    Camera::Orbit(Orbit { azimuth, elevation, roll: 17.0, zoom, projection, ..Orbit::default() })
}

/// An image's pixel, premultiplied, 0..255.
fn pixel(image: &Image, x: usize, y: usize) -> Vec4 {
    let channels = usize::from(image.channels);
    match image.pixels[(y * image.width as usize + x) * channels..][..channels] {
        [r, g, b] => Vec4::new(r.into(), g.into(), b.into(), 255.0),
        [r, g, b, a] => Vec4::new(r.into(), g.into(), b.into(), 255.0) * Vec4::splat(f32::from(a) / 255.0),
        _ => unreachable!(),
    }
}

/// Pixels of the final image, premultiplied, by what the documentation says of the matrix.
fn warped(image: &Image, behind: Vec4) -> Vec<Vec4> {
    let intermediate_from_image = image.warp.unwrap().image_from_intermediate.inverse();
    let at = |x: u32, y: u32| {
        let at = intermediate_from_image * DVec3::new(f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0);
        let at = at.truncate() / at.z - 0.5;
        let last = DVec2::new(f64::from(image.width) - 1.0, f64::from(image.height) - 1.0);
        if at.min_element() < 0.0 || (last - at).min_element() < 0.0 {
            return behind;
        }
        let (first, part) = (at.floor(), (at - at.floor()).as_vec2());
        let next = (first + 1.0).min(last);
        let row = |y: f64| {
            let [left, right] = [first.x, next.x].map(|x| pixel(image, x as usize, y as usize));
            left.lerp(right, part.x)
        };
        row(first.y).lerp(row(next.y), part.y)
    };
    (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect()
}

/// The greatest difference of a component between the final frame and the warped intermediate image, 0..255; how far that is from
/// blank; and its size.
fn compared(scene: &Prepared, camera: &Camera, settings: &Settings) -> (f32, f32, [u32; 2]) {
    let view = scene.view(camera, SIZE[0], SIZE[1]);
    let frame = scene.frame(&view, settings);
    let image = scene.frame(&view, &Settings { stage: Stage::Intermediate, ..settings.clone() });
    assert_eq!((frame.warp, frame.width, frame.height), (None, SIZE[0], SIZE[1]));
    assert!(image.width * image.height <= SIZE[0] * SIZE[1]);
    let behind = settings.background.behind() * 255.0;
    let (mut most, mut shown) = (0.0, 0.0);
    for (at, warped) in warped(&image, behind).into_iter().enumerate() {
        let expected = pixel(&frame, at % SIZE[0] as usize, at / SIZE[0] as usize);
        most = f32::max(most, (warped - expected).abs().max_element());
        shown = f32::max(shown, (expected - behind).abs().max_element());
    }
    (most, shown, [image.width, image.height])
}

#[test]
fn a_warped_intermediate_image_is_the_final_frame() {
    let scene = ball();
    for algorithm in [Algorithm::Classified, Algorithm::FastClassification, Algorithm::Preintegrated] {
        for background in [Background::Opaque([0.1, 0.3, 0.9]), Background::Transparent] {
            for projection in [Projection::Parallel, Projection::Perspective] {
                for angles in ANGLES {
                    let settings = Settings { background, ..Settings::new(algorithm, Quality::Standard) };
                    let (most, shown, _) = compared(&scene, &orbit(angles, projection, 1.2), &settings);
                    assert!(shown > 60.0);
                    // 8 bits before the warp and after it; colours of straight alpha are rounded more coarsely.
                    assert!(most <= 1.5, "{most} in {algorithm:?} {background:?} {projection:?} {angles:?}");
                }
            }
        }
    }
}

#[test]
fn only_what_is_seen_and_drawn_is_sent() {
    let scene = ball();
    let settings = plain(Algorithm::Preintegrated);
    let size = |zoom| compared(&scene, &orbit((25.0, 10.0), Projection::Parallel, zoom), &settings).2;
    let ([width, height], [near_width, near_height]) = (size(1.2), size(6.0));
    assert!(width < 70 && height < 70, "{width} x {height}");
    assert!(
        3 * near_width < 2 * width && 3 * near_height < 2 * height,
        "{near_width} x {near_height} of {width} x {height}"
    );
}

#[test]
fn frames_that_are_not_one_warp_of_an_image_worth_it_are_final() {
    let scene = ball();
    let stage = Stage::Intermediate;
    let image = |camera: &Camera, side: u32, settings: Settings| {
        scene.frame(&scene.view(camera, side, side), &Settings { stage, ..settings })
    };
    let front = orbit((25.0, 10.0), Projection::Parallel, 1.2);
    let standard = Settings::new(Algorithm::Preintegrated, Quality::Standard);
    assert!(image(&front, 150, standard.clone()).warp.is_some());
    for (why, camera, side, settings) in [
        ("high", front.clone(), 150, Settings::new(Algorithm::Preintegrated, Quality::High)),
        ("raycast", front.clone(), 60, Settings::new(Algorithm::Raycast, Quality::Standard)),
        ("larger than the final one", front.clone(), 20, standard.clone()),
        (
            "nothing in sight",
            Camera::Orbit(Orbit { target: Some(DVec3::splat(9999.0)), ..Orbit::default() }),
            60,
            standard.clone(),
        ),
        (
            "in parts",
            Camera::Orbit(Orbit {
                azimuth: 45.0,
                fov_y: 100.0,
                projection: Projection::Perspective,
                ..Orbit::default()
            }),
            150,
            standard.clone(),
        ),
    ] {
        let image = image(&camera, side, settings);
        assert_eq!((image.warp, image.width, image.height), (None, side, side), "{why}");
    }
}
