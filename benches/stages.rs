//! The stages before a frame, by the papers' words: gradients, octree, summed-area table and run
//! lengths; the inverse warp of a depth buffer; and the encoding of the finished picture after it.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use glam::{DVec2, Vec4};
use shearwarp::classify::preintegration::{Bilinear, Form, Nearest, OneDimensional, SlabTables, Slabs};
use shearwarp::classify::summed_area::SummedAreaTable;
use shearwarp::classify::{
    Classification, CodeTables, Color, ControlPoint, Encodings, Purpose, RunLengthVolume, TransferFunction, Visible,
    cells, presets,
};
use shearwarp::encode::{Format, encode};
use shearwarp::render::depth::{InverseWarp, SceneDepth};
use shearwarp::render::factorization::Factorization;
use shearwarp::render::{Algorithm, Camera, Cancel, Orbit, Projection, Quality, Scene, Settings, View, render};
use shearwarp::volume::{PreparedVolume, phantom};

fn stages(criterion: &mut Criterion) {
    let prepared = PreparedVolume::build(phantom::head());
    let volume = prepared.volume();
    let transfer = presets::get("ct-bone").expect("the preset ships").transfer_function(volume);
    let tables = CodeTables::new(volume, &transfer, 0.002);
    let summed_area = SummedAreaTable::new(&tables, &transfer, prepared.octree());
    let occupied = prepared.octree().occupied_leaves(|range| summed_area.is_transparent(range));

    criterion.bench_function("phantom", |b| b.iter(phantom::head));
    criterion.bench_function("scanlines and octree", |b| {
        b.iter_batched(phantom::head, PreparedVolume::build, BatchSize::PerIteration);
    });
    criterion.bench_function("gradients", |b| {
        b.iter_batched_ref(
            || PreparedVolume::build(phantom::head()),
            |p| p.gradient_octree().bytes(),
            BatchSize::PerIteration,
        );
    });
    criterion.bench_function("summed_area_table", |b| {
        b.iter(|| SummedAreaTable::new(&tables, &transfer, prepared.octree()));
    });
    criterion.bench_function("visible_voxels", |b| {
        b.iter(|| Visible::new(&prepared, &tables, &occupied));
    });
    let visible = Arc::new(Visible::new(&prepared, &tables, &occupied));
    criterion.bench_function("run_lengths", |b| {
        b.iter(|| RunLengthVolume::encode(&prepared, &tables, &transfer, &visible));
    });
    let slabs = Classification::build(&prepared, &transfer, Purpose::Slabs { entries: 256 });
    let visible = slabs.slabs().expect("it is of slabs").visible_codes();
    criterion.bench_function("cell_runs", |b| b.iter(|| cells::mark(&prepared, visible, slabs.occupied())));

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
    let camera = Camera::Orbit(Orbit { azimuth: 30.0, elevation: 10.0, zoom: 1.3, ..Orbit::default() });
    let view = View::new(&camera, volume.centre(), volume.radius(), 512, 512).expect("an orbit is sound");
    let settings = Settings::new(Algorithm::Classified, Quality::Standard);
    let (image, _) = render(&scene, &view, &settings, &Cancel::default()).expect("the frame renders");
    for format in [Format::Png, Format::Jpeg, Format::Webp] {
        criterion.bench_function(&format!("encode/{}", format.name()), |b| b.iter(|| encode(&image, format)));
    }
}

/// Tables of slabs, and reading them: for 8-bit codes, one entry each, and for 12-bit ones.
fn preintegration(criterion: &mut Criterion) {
    for bits in [8, 12] {
        let last = f64::from((1 << bits) - 1);
        let volume = phantom::from_fn([2; 3], [1.0; 3], |i, j, k| last * ((i + j + k) / 3) as f64);
        let point = |share: f64, opacity, color| ControlPoint { value: share * last, opacity, color: Color(color) };
        let transfer = TransferFunction {
            points: vec![
                point(0.15, 0.0, [0.5, 0.5, 0.6]),
                point(0.25, 0.03, [0.6, 0.65, 0.8]),
                point(0.55, 0.06, [0.8, 0.85, 1.0]),
                point(0.7, 0.2, [1.0, 0.7, 0.2]),
                point(1.0, 0.9, [1.0, 0.5, 0.1]),
            ],
            opacity_distance: None,
            gradient_opacity: vec![],
        };
        let fresh = || SlabTables::new(&volume, &transfer, 256);
        let name = |what: &str| format!("{what}, {bits} bits");
        criterion.bench_function(&name("preintegration_table/for all lengths"), |b| b.iter(fresh));
        criterion.bench_function(&name("preintegration_table/2D"), |b| {
            b.iter_batched_ref(fresh, |tables| tables.table(Form::Opacity, 1.0), BatchSize::LargeInput);
        });
        criterion.bench_function(&name("preintegration_table/1D"), |b| {
            b.iter_batched_ref(fresh, |tables| tables.running_sums(Form::Opacity, 1.0), BatchSize::LargeInput);
        });

        // A ray's scalars: a slow wave and a fast one.
        let code = |n: usize| (0.5 + 0.4 * (n as f64 * 0.01).sin() + 0.05 * (n as f64 * 0.37).sin()) * last;
        let codes: Vec<f32> = (0..4096).map(|n| code(n) as f32).collect();
        let (table, sums) = (fresh().table(Form::Opacity, 1.0), fresh().running_sums(Form::Opacity, 1.0));
        criterion.bench_function(&name("slab/coordinate"), |b| b.iter(|| coordinates(Bilinear(&table), &codes)));
        criterion.bench_function(&name("slab/2D nearest"), |b| b.iter(|| slabs(Nearest(&table), &codes)));
        criterion.bench_function(&name("slab/2D bilinear"), |b| b.iter(|| slabs(Bilinear(&table), &codes)));
        criterion.bench_function(&name("slab/1D"), |b| b.iter(|| slabs(OneDimensional(&sums), &codes)));
    }
}

/// Positions of all codes, summed up.
fn coordinates(table: impl Slabs, codes: &[f32]) -> f32 {
    black_box(codes).iter().map(|&code| table.coordinate(code)).sum()
}

/// The slabs between each code and the next, summed up.
fn slabs(table: impl Slabs, codes: &[f32]) -> Vec4 {
    let mut front = table.coordinate(codes[0]);
    let mut sum = Vec4::ZERO;
    for &code in &black_box(codes)[1..] {
        let back = table.coordinate(code);
        sum += table.slab(front, back);
        front = back;
    }
    sum
}

/// A depth buffer in which every pixel meets something, a slanted plane: its distances, and where the rays of an intermediate image end.
fn depth_buffer(criterion: &mut Criterion) {
    let volume = phantom::head();
    for (name, projection) in [("parallel", Projection::Parallel), ("perspective", Projection::Perspective)] {
        let orbit = Orbit { projection, azimuth: 30.0, elevation: 10.0, zoom: 1.3, ..Orbit::default() };
        let view =
            View::new(&Camera::Orbit(orbit), volume.centre(), volume.radius(), 512, 512).expect("an orbit is sound");
        let distance = |at: usize| {
            let ray = view.ray(DVec2::new((at % 512) as f64 + 0.5, (at / 512) as f64 + 0.5));
            (volume.centre() - ray.origin).dot(ray.direction) + (at % 512) as f64 / 8.0 - 32.0
        };
        let distances: Vec<f32> = (0..512 * 512).map(|at| distance(at) as f32).collect();
        criterion.bench_function(&format!("depth_buffer/surfaces, {name}"), |b| {
            b.iter_batched(|| distances.clone(), |distances| SceneDepth::new(&view, distances), BatchSize::LargeInput);
        });
        let view = view.clone().ending_at(Arc::new(SceneDepth::new(&view, distances)));
        let parts = Factorization::parts(&view, &volume).expect("the view can be rendered");
        criterion.bench_function(&format!("depth_buffer/inverse warp, {name}"), |b| {
            b.iter(|| {
                parts
                    .iter()
                    .filter_map(|part| InverseWarp::of(&view, &volume, part, part.size.map(|size| 0..size)))
                    .count()
            });
        });
    }
}

criterion_group!(benches, stages, preintegration, depth_buffer);
criterion_main!(benches);
