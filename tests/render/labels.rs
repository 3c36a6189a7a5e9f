//! Segmentations: voxels look as their label says.

use proptest::prelude::*;
use shearwarp::classify::labels::{LabelLook, LabelTables, Labels, union};
use shearwarp::classify::{Classification, Encodings, Purpose, TransferFunction};
use shearwarp::render::{Algorithm, Cancel, Image, Projection, Scene, Settings, Shading, View, render};
use shearwarp::volume::{ImportReport, PreparedVolume, ScalarType, Scalars, Volume, phantom};

use crate::scenes::{on_threads, orbit, plain, psnr, transfer};

/// A volume with a segmentation of it.
struct Labelled {
    prepared: PreparedVolume,
    labels: Volume,
    tables: LabelTables,
    transfer: TransferFunction,
    classified: (Classification, Encodings),
}

impl Labelled {
    fn new(volume: Volume, labels: Volume, looks: &[LabelLook], others: &TransferFunction) -> Self {
        let tables = LabelTables::new(&volume, &labels, looks, others, 0.0);
        let transfer = union(looks.iter().map(|look| &look.transfer).chain([others]), 1.0);
        let prepared = PreparedVolume::build(volume);
        let classification = Classification::build(&prepared, &transfer, Purpose::Voxels { min_opacity: 0.0 });
        let encodings = Encodings::build(&prepared, &transfer, &classification);
        Self { prepared, labels, tables, transfer, classified: (classification, encodings) }
    }

    fn view(&self, projection: Projection, azimuth: f64, elevation: f64) -> View {
        let volume = self.prepared.volume();
        View::new(&orbit(projection, azimuth, elevation), volume.centre(), volume.radius(), 64, 56).unwrap()
    }

    fn frame(&self, view: &View, settings: &Settings) -> Image {
        let encoded = settings.algorithm == Algorithm::Classified;
        let scene = Scene {
            prepared: &self.prepared,
            transfer: &self.transfer,
            classification: Some(&self.classified.0),
            encodings: encoded.then_some(&self.classified.1),
            labels: Some(Labels { voxels: self.labels.scalars(), tables: &self.tables }),
            shadow: None,
        };
        render(&scene, view, settings, &Cancel::default()).unwrap().0
    }
}

/// Numbers on a grid like that of a volume.
fn segmentation(like: &Volume, wide: bool, label: impl Fn([usize; 3]) -> u16) -> Volume {
    let dims = like.dims();
    let labels: Vec<u16> = (0..dims.iter().product())
        .map(|n: usize| label([n % dims[0], n / dims[0] % dims[1], n / (dims[0] * dims[1])]))
        .collect();
    let scalars =
        if wide { Scalars::U16(labels) } else { Scalars::U8(labels.into_iter().map(|label| label as u8).collect()) };
    let report = ImportReport::plain("test", ScalarType::U16);
    Volume::new(dims, *like.placement(), scalars, (1.0, 0.0), report).unwrap()
}

/// In each eighth of the volume another label.
fn eighths(dims: [usize; 3]) -> impl Fn([usize; 3]) -> u16 {
    move |at| [0, 1, 2].map(|axis| u16::from(at[axis] >= dims[axis] / 2) << axis).iter().sum()
}

#[test]
fn a_label_that_is_not_visible_is_gone_and_the_others_stay() {
    let volume = phantom::from_fn([30, 28, 26], [1.0; 3], |_, _, _| 100.0);
    let medium = transfer(&[(0.0, 0.05), (200.0, 0.05)]);
    // What the patient has on the left goes; label 300 is seen from the right half of the picture only.
    let labels = segmentation(&volume, true, |[i, ..]| if i < 15 { 7 } else { 300 });
    let gone = LabelLook { label: 300, transfer: transfer(&[(0.0, 0.0)]) };
    let scene = Labelled::new(volume, labels, &[gone], &medium);
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = scene.view(projection, 0.0, 0.0);
        for algorithm in [Algorithm::Classified, Algorithm::FastClassification, Algorithm::Raycast] {
            let frame = scene.frame(&view, &plain(algorithm));
            let alpha = |x: usize| frame.pixels[4 * (28 * 64 + x) + 3];
            // Looked at from in front, i grows to the right.
            assert!(alpha(26) > 150 && alpha(38) == 0, "{algorithm:?}: {} {}", alpha(26), alpha(38));
        }
    }
}

#[test]
fn labels_are_where_the_ray_caster_has_them() {
    let dims = [36, 40, 34];
    let volume = phantom::noise(dims, 9);
    let labels = segmentation(&volume, false, eighths(dims));
    let others = transfer(&[(0.0, 0.0), (1500.0, 0.0), (2800.0, 0.2)]);
    let looks = [
        LabelLook { label: 1, transfer: transfer(&[(0.0, 0.02), (3000.0, 0.02)]) },
        LabelLook { label: 2, transfer: transfer(&[(0.0, 0.0)]) },
        LabelLook { label: 5, transfer: transfer(&[(1000.0, 0.3), (2000.0, 0.0)]) },
    ];
    let scene = Labelled::new(volume, labels, &looks, &others);
    let without =
        Labelled::new(phantom::noise(dims, 9), segmentation(&phantom::noise(dims, 9), false, |_| 0), &looks, &others);
    for projection in [Projection::Parallel, Projection::Perspective] {
        for (azimuth, elevation) in [(20.0, 10.0), (100.0, -30.0), (250.0, 75.0)] {
            let view = scene.view(projection, azimuth, elevation);
            for shading in [None, Some(Shading::default())] {
                let exact = Settings { shading, sample_distance: 0.1, ..plain(Algorithm::Raycast) };
                let truth = scene.frame(&view, &exact);
                assert!(psnr(&truth, &without.frame(&view, &exact)) < 30.0, "labels change nothing");
                let db = psnr(&scene.frame(&view, &Settings { algorithm: Algorithm::Classified, ..exact }), &truth);
                assert!(db > 28.0, "{projection:?} {azimuth}: {db} dB");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn encodings_skipping_and_threads_change_no_bit(
        azimuth in 0.0..360.0, elevation in -90.0..90.0, perspective: bool, lit: bool, wide: bool, seed in 0..100u32,
        opacity in 0.0..1.0,
    ) {
        let dims = [19, 23, 17];
        let volume = phantom::noise(dims, seed);
        let labels = segmentation(&volume, wide, eighths(dims));
        let looks = [
            LabelLook { label: 3, transfer: transfer(&[(0.0, opacity), (2000.0, 0.0)]) },
            LabelLook { label: 4, transfer: transfer(&[(0.0, 0.0)]) },
        ];
        let scene = Labelled::new(volume, labels, &looks, &transfer(&[(1700.0, 0.0), (2500.0, 0.4)]));
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let view = scene.view(projection, azimuth, elevation);
        let shading = lit.then(Shading::default);
        for algorithm in [Algorithm::Classified, Algorithm::Raycast] {
            let settings = Settings { shading: shading.clone(), early_ray_termination: 0.97, ..plain(algorithm) };
            let frame = scene.frame(&view, &settings);
            prop_assert!(frame == scene.frame(&view, &Settings { skipping: false, ..settings.clone() }), "{algorithm:?} skips");
            prop_assert!(frame == on_threads(3, || scene.frame(&view, &settings)), "{algorithm:?}: threads");
            if algorithm == Algorithm::Classified {
                let fast = Settings { algorithm: Algorithm::FastClassification, ..settings };
                prop_assert!(frame == scene.frame(&view, &fast), "fast classification differs");
            }
        }
    }
}
