//! The stages before a frame, by the papers' words: gradients, octree, summed-area table and run
//! lengths; and the encoding of the finished picture after it.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use shearwarp::classify::summed_area::SummedAreaTable;
use shearwarp::classify::{CellRuns, Classification, CodeTables, Encodings, Purpose, RunLengthVolume, presets};
use shearwarp::encode::{Format, encode};
use shearwarp::render::{Algorithm, Camera, Cancel, Orbit, Quality, Scene, Settings, View, render};
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
    criterion.bench_function("run_lengths", |b| {
        b.iter(|| RunLengthVolume::encode(&prepared, &tables, &transfer, &occupied));
    });
    let slabs = Classification::build(&prepared, &transfer, Purpose::Slabs { entries: 256 });
    let visible = slabs.slabs().expect("it is of slabs").visible_codes();
    criterion.bench_function("cell_runs", |b| b.iter(|| CellRuns::encode(&prepared, visible, slabs.occupied())));

    let classification = Classification::build(&prepared, &transfer, Purpose::Voxels { min_opacity: 0.002 });
    let encodings = Encodings::build(&prepared, &transfer, &classification);
    let scene = Scene {
        prepared: &prepared,
        transfer: &transfer,
        classification: Some(&classification),
        encodings: Some(&encodings),
    };
    let camera = Camera::Orbit(Orbit { azimuth: 30.0, elevation: 10.0, zoom: 1.3, ..Orbit::default() });
    let view = View::new(&camera, volume.centre(), volume.radius(), 512, 512).expect("an orbit is sound");
    let settings = Settings::new(Algorithm::Classified, Quality::Standard);
    let (image, _) = render(&scene, &view, &settings, &Cancel::default()).expect("the frame renders");
    for format in [Format::Png, Format::Jpeg, Format::Webp] {
        criterion.bench_function(&format!("encode/{}", format.name()), |b| b.iter(|| encode(&image, format)));
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
