//! A few small frames as pictures. A test that fails writes what it got, and the difference, to
//! `target/golden`; `UPDATE_GOLDEN=1` takes what it got as the new truth.

use std::path::{Path, PathBuf};

use shearwarp::encode::{Format, encode};
use shearwarp::render::{
    Algorithm, Background, Camera, Image, Orbit, Preintegration, Projection, Quality, Settings, Shading,
};
use shearwarp::volume::phantom;

use crate::scenes::{Prepared, plain, transfer};

/// Other machines may round differently.
const TOLERANCE: u8 = 2;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/render/golden")
}

fn write(path: &Path, image: &Image) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, encode(image, Format::Png).unwrap()).unwrap();
}

fn check(name: &str, image: &Image) {
    let path = folder().join(format!("{name}.png"));
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        write(&path, image);
        return;
    }
    let file = std::fs::File::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    let mut golden = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut golden).unwrap();
    assert_eq!((info.width, info.height), (image.width, image.height), "{name}: another size");
    let differences: Vec<u8> = golden.iter().zip(&image.pixels).map(|(a, b)| a.abs_diff(*b)).collect();
    let largest = differences.iter().max().unwrap();
    if *largest > TOLERANCE {
        let failed = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/golden");
        write(&failed.join(format!("{name}.png")), image);
        let pixels = differences.iter().map(|d| d.saturating_mul(16)).collect();
        write(&failed.join(format!("{name}-difference.png")), &Image { pixels, ..image.clone() });
        panic!("{name} differs by up to {largest}: see {}", failed.display());
    }
}

#[test]
fn a_lit_surface_and_a_translucent_one_look_as_they_did() {
    let function = transfer(&[(0.0, 0.0), (1500.0, 0.0), (1700.0, 0.05), (1900.0, 0.0), (2300.0, 0.0), (2900.0, 0.9)]);
    let scene = Prepared::new(phantom::noise([48, 40, 56], 3), function, 0.002);
    let settings = |algorithm, quality| Settings {
        shading: Some(Shading::default()),
        background: Background::Opaque([0.1, 0.12, 0.2]),
        early_ray_termination: 0.99,
        quality,
        preintegration: Preintegration::of(quality),
        ..plain(algorithm)
    };
    for (name, algorithm, quality, projection, azimuth, elevation) in [
        ("classified-x", Algorithm::Classified, Quality::Standard, Projection::Parallel, 75.0, 10.0),
        ("classified-y", Algorithm::Classified, Quality::Standard, Projection::Parallel, 190.0, -20.0),
        ("classified-z", Algorithm::Classified, Quality::Standard, Projection::Parallel, 30.0, 70.0),
        ("classified-perspective", Algorithm::Classified, Quality::Standard, Projection::Perspective, 30.0, 20.0),
        ("preintegrated", Algorithm::Preintegrated, Quality::Standard, Projection::Parallel, 75.0, 10.0),
        ("preintegrated-perspective", Algorithm::Preintegrated, Quality::Standard, Projection::Perspective, 30.0, 20.0),
        ("high-perspective", Algorithm::Preintegrated, Quality::High, Projection::Perspective, 30.0, 20.0),
        ("raycast-perspective", Algorithm::Raycast, Quality::Standard, Projection::Perspective, 30.0, 20.0),
    ] {
        let camera = Camera::Orbit(Orbit { projection, azimuth, elevation, ..Orbit::default() });
        let image = scene.frame(&scene.view(&camera, 96, 80), &settings(algorithm, quality));
        let lit = image.pixels.chunks(3).filter(|p| **p != image.pixels[..3]).count();
        assert!(lit > 800, "{name}: only {lit} pixels show anything");
        check(name, &image);
    }
}
