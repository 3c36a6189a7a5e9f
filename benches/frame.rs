//! Whole frames: from the view to the pixels in memory, on one thread and on all.

use criterion::{Criterion, criterion_group, criterion_main};
use shearwarp::classify::{Classification, Encodings, Purpose, presets};
use shearwarp::render::{Algorithm, Camera, Cancel, Orbit, Projection, Quality, Scene, Settings, View, render};
use shearwarp::volume::{PreparedVolume, phantom};

const SIDE: u32 = 512;

fn frames(criterion: &mut Criterion) {
    let prepared = PreparedVolume::build(phantom::head());
    let volume = prepared.volume();
    let transfer = presets::get("ct-bone").expect("the preset ships").transfer_function(volume);
    let classification = Classification::build(&prepared, &transfer, Purpose::Voxels { min_opacity: 0.002 });
    let encodings = Encodings::build(&prepared, &transfer, &classification);
    let scene = Scene {
        prepared: &prepared,
        transfer: &transfer,
        classification: Some(&classification),
        encodings: Some(&encodings),
        labels: None,
        shadow: None,
    };
    let view = |projection, azimuth, elevation| {
        let orbit = Orbit { projection, azimuth, elevation, zoom: 1.3, ..Orbit::default() };
        View::new(&Camera::Orbit(orbit), volume.centre(), volume.radius(), SIDE, SIDE).expect("an orbit is sound")
    };
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        let mut group = criterion.benchmark_group(format!("frame/{threads} threads"));
        for (name, azimuth, elevation) in [("x", 80.0, 10.0), ("y", 10.0, 15.0), ("z", 20.0, 80.0)] {
            let (view, settings) = (
                view(Projection::Parallel, azimuth, elevation),
                Settings::new(Algorithm::Classified, Quality::Standard),
            );
            group.bench_function(format!("classified along {name}"), |bencher| {
                pool.install(|| bencher.iter(|| render(&scene, &view, &settings, &Cancel::default())));
            });
        }
        group.finish();
    }
    let mut group = criterion.benchmark_group("frame/reference");
    group.sample_size(10);
    let (view, settings) =
        (view(Projection::Perspective, 30.0, 15.0), Settings::new(Algorithm::Raycast, Quality::Standard));
    group.bench_function("raycast", |bencher| {
        bencher.iter(|| render(&scene, &view, &settings, &Cancel::default()));
    });
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
