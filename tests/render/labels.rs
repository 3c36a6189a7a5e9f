//! Segmentations: voxels look as their label says.

use proptest::prelude::*;
use shearwarp::classify::labels::{LabelLook, LabelTables, union};
use shearwarp::classify::transfer::GradientPoint;
use shearwarp::classify::{Classification, Encodings, Purpose, TransferFunction};
use shearwarp::render::{
    Algorithm, Blend, Cancel, Image, IntensityProjection, Preintegration, Projection, Quality, Scene, Settings,
    Shading, View, Window, render,
};
use shearwarp::volume::{ImportReport, PreparedVolume, ScalarType, Scalars, Volume, phantom, pyramid};

use crate::scenes::{on_threads, orbit, plain, psnr, transfer};

/// A volume with a segmentation of it.
struct Labelled {
    prepared: PreparedVolume,
    labels: Volume,
    tables: LabelTables,
    transfer: TransferFunction,
    /// For single voxels, and for slabs.
    classified: [(Classification, Encodings); 2],
}

impl Labelled {
    fn new(volume: Volume, labels: Volume, looks: &[LabelLook], others: &TransferFunction) -> Self {
        let tables = LabelTables::new(&volume, &labels, looks, others, 0.0);
        let transfer = union([others].into_iter().chain(looks.iter().map(|look| &look.transfer)), 1.0);
        let prepared = PreparedVolume::build(volume);
        let classified = [Purpose::Voxels { min_opacity: 0.0 }, Purpose::Slabs { entries: 16 }].map(|purpose| {
            let classification = Classification::build(&prepared, &transfer, purpose);
            let encodings = Encodings::build(&prepared, &transfer, &classification);
            (classification, encodings)
        });
        Self { prepared, labels, tables, transfer, classified }
    }

    fn view(&self, projection: Projection, azimuth: f64, elevation: f64) -> View {
        let volume = self.prepared.volume();
        View::new(&orbit(projection, azimuth, elevation), volume.centre(), volume.radius(), 64, 56).unwrap()
    }

    fn frame(&self, view: &View, settings: &Settings) -> Image {
        self.frame_with(view, settings, settings.algorithm != Algorithm::FastClassification)
    }

    fn frame_with(&self, view: &View, settings: &Settings, encoded: bool) -> Image {
        let (classification, encodings) = &self.classified[usize::from(settings.algorithm == Algorithm::Preintegrated)];
        let scene = Scene {
            prepared: &self.prepared,
            transfer: &self.transfer,
            classification: Some(classification),
            encodings: encoded.then_some(encodings),
            labels: Some(self.tables.of(&self.labels)),
            shadow: None,
        };
        render(&scene, view, settings, &Cancel::default()).unwrap().0
    }
}

const ALGORITHMS: [Algorithm; 4] =
    [Algorithm::Classified, Algorithm::FastClassification, Algorithm::Preintegrated, Algorithm::Raycast];

/// Settings of frames that are to be like that of the ray caster, and by how much, dB.
fn compared(exact: &Settings) -> [(Settings, f64); 3] {
    let own_rays = Settings { algorithm: Algorithm::Preintegrated, ..exact.clone() };
    let fine = Settings { preintegration: Preintegration::of(Quality::High), ..own_rays.clone() };
    [(Settings { algorithm: Algorithm::Classified, ..exact.clone() }, 28.0), (own_rays, 40.0), (fine, 50.0)]
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
    // So it is on a coarser level.
    let coarse = pyramid::coarser(&volume);
    let scenes =
        [volume, coarse].map(|volume| Labelled::new(volume, labels.clone(), std::slice::from_ref(&gone), &medium));
    for (scene, projection) in
        scenes.iter().flat_map(|scene| [(scene, Projection::Parallel), (scene, Projection::Perspective)])
    {
        let view = scene.view(projection, 0.0, 0.0);
        for algorithm in ALGORITHMS {
            let frame = scene.frame(&view, &plain(algorithm));
            let alpha = |x: usize| frame.pixels[4 * (28 * 64 + x) + 3];
            // Looked at from in front, i grows to the right.
            // Opacities are for the length of a voxel, and those of the coarse level are twice as long.
            assert!(alpha(26) > 100 && alpha(38) == 0, "{algorithm:?}: {} {}", alpha(26), alpha(38));
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
                for (settings, floor) in compared(&exact) {
                    let db = psnr(&scene.frame(&view, &settings), &truth);
                    assert!(db > floor, "{projection:?} {azimuth} {settings:?}: {db} dB");
                }
            }
        }
    }
}

/// Opacity of the scalars, and of the gradients.
fn by_gradient(points: &[(f64, f64)], gradients: &[(f64, f64)]) -> TransferFunction {
    let gradient_opacity = gradients.iter().map(|&(value, opacity)| GradientPoint { value, opacity }).collect();
    TransferFunction { gradient_opacity, ..transfer(points) }
}

#[test]
fn each_label_has_its_own_gradient_opacity() {
    // A ramp along x, of 3 a voxel, and where i is large of 30; halves along z.
    let volume =
        phantom::from_fn(
            [40, 24, 24],
            [1.0; 3],
            |x, _, _| if x < 20 { 3.0 * x as f64 } else { 30.0 * x as f64 - 540.0 },
        );
    let labels = segmentation(&volume, false, |[_, _, k]| u16::from(k >= 12));
    let medium = [(0.0, 0.05), (700.0, 0.05)];
    let (steep, gentle) = ([(10.0, 0.0), (20.0, 1.0)], [(10.0, 1.0), (20.0, 0.0)]);
    let plain_medium = transfer(&medium);
    let others = by_gradient(&medium, &steep);
    for (upper, wanted) in
        [(by_gradient(&medium, &gentle), [true, false]), (plain_medium, [true, true]), (others.clone(), [false, true])]
    {
        let scene = Labelled::new(volume.clone(), labels.clone(), &[LabelLook { label: 1, transfer: upper }], &others);
        for projection in [Projection::Parallel, Projection::Perspective] {
            let view = scene.view(projection, 0.0, 0.0);
            for algorithm in ALGORITHMS {
                let frame = scene.frame(&view, &plain(algorithm));
                // Above is label 1; the other half shows what is steep, on the right.
                let shown = |x: usize, y: usize| match frame.pixels[4 * (64 * y + x) + 3] {
                    0 => false,
                    150.. => true,
                    alpha => panic!("{algorithm:?}: {alpha} at {x}, {y}"),
                };
                let got = [shown(25, 23), shown(39, 23), shown(25, 33), shown(39, 33)];
                assert_eq!(got, [wanted[0], wanted[1], false, true], "{algorithm:?}");
            }
        }
    }
}

#[test]
fn gradient_opacities_of_labels_are_the_ray_casters() {
    let dims = [36, 40, 34];
    let volume = phantom::noise(dims, 9);
    let labels = segmentation(&volume, false, eighths(dims));
    let others = by_gradient(&[(0.0, 0.0), (1500.0, 0.0), (2800.0, 0.2)], &[(50.0, 0.2), (400.0, 1.0)]);
    let looks = [
        LabelLook { label: 1, transfer: by_gradient(&[(0.0, 0.05), (3000.0, 0.05)], &[(100.0, 1.0), (300.0, 0.1)]) },
        LabelLook { label: 5, transfer: transfer(&[(1000.0, 0.3), (2000.0, 0.0)]) },
    ];
    let scene = Labelled::new(volume, labels, &looks, &others);
    for (azimuth, elevation) in [(20.0, 10.0), (100.0, -30.0), (250.0, 75.0)] {
        let view = scene.view(Projection::Parallel, azimuth, elevation);
        let exact = Settings { sample_distance: 0.1, ..plain(Algorithm::Raycast) };
        let truth = scene.frame(&view, &exact);
        for (settings, floor) in compared(&exact) {
            let db = psnr(&scene.frame(&view, &settings), &truth);
            assert!(db > floor, "{azimuth} {settings:?}: {db} dB");
        }
    }
}

#[test]
fn projections_are_of_what_labels_show() {
    // Bright where i is large, and dark within it; both may be hidden.
    let dims = [32, 28, 24];
    let bright = |[i, j, k]: [usize; 3]| i >= 16 && (4..24).contains(&j) && (4..20).contains(&k);
    let volume = phantom::from_fn(dims, [1.0; 3], |x, y, z| {
        let at = [x, y, z];
        if at == [24, 14, 12] {
            0.0
        } else if bright(at) {
            200.0
        } else {
            100.0
        }
    });
    let labels = segmentation(&volume, false, |at| if at == [24, 14, 12] { 3 } else { u16::from(bright(at)) });
    let (shown, hidden) = (transfer(&[(0.0, 0.1)]), transfer(&[(0.0, 0.0)]));
    let look = |label, transfer: &TransferFunction| LabelLook { label, transfer: transfer.clone() };
    let window = Window { center: 128.0, width: 256.0 };
    // Looked at from in front: gray in the middle of the left half, of the right half, and beside the bright part.
    let gray = |looks: &[LabelLook], others: &TransferFunction, which| {
        let scene = Labelled::new(volume.clone(), labels.clone(), looks, others);
        let view = scene.view(Projection::Parallel, 0.0, 0.0);
        let settings = |algorithm| Settings {
            quality: Quality::High,
            preintegration: Preintegration::of(Quality::High),
            blend: Blend::Projection(which, window),
            ..plain(algorithm)
        };
        let frames = [Algorithm::Preintegrated, Algorithm::Raycast].map(|a| scene.frame(&view, &settings(a)));
        let without = Settings { skipping: false, ..settings(Algorithm::Preintegrated) };
        assert!(frames[0] == scene.frame(&view, &without), "{which:?} skips");
        let pixels = frames.map(|frame| {
            [22, 40].map(|x| {
                let pixel = &frame.pixels[4 * (28 * 64 + x)..][..4];
                (pixel[3] > 0).then_some(pixel[0])
            })
        });
        for (a, b) in pixels[0].iter().zip(&pixels[1]) {
            let near = a.is_some() == b.is_some() && a.unwrap_or(0).abs_diff(b.unwrap_or(0)) <= 3;
            assert!(near, "{which:?}: {pixels:?}");
        }
        pixels[0]
    };
    use IntensityProjection::{Average, Maximum, Minimum};
    assert_eq!(gray(&[], &shown, Maximum), [Some(100), Some(199)]);
    // At the border of what is hidden, samples closer to what is not are between both.
    let [left, right] = gray(&[look(1, &hidden), look(3, &hidden)], &shown, Maximum);
    assert!(left == Some(100) && (100..=150).contains(&right.unwrap()), "{right:?}");
    assert_eq!(gray(&[look(1, &shown)], &hidden, Maximum), [None, Some(199)]);
    assert_eq!(gray(&[look(1, &shown)], &hidden, Minimum)[0], None);
    let [left, right] = gray(&[look(1, &shown)], &hidden, Average);
    assert!(left.is_none() && right.unwrap() > 190, "{right:?}");
    assert_eq!(gray(&[], &hidden, Average), [None, None]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn encodings_skipping_and_threads_change_no_bit(
        azimuth in 0.0..360.0, elevation in -90.0..90.0, perspective: bool, lit: bool, wide: bool, seed in 0..100u32,
        opacity in 0.0..1.0, gradients: bool,
    ) {
        let dims = [19, 23, 17];
        let volume = phantom::noise(dims, seed);
        let labels = segmentation(&volume, wide, eighths(dims));
        let looks = [
            LabelLook { label: 3, transfer: transfer(&[(0.0, opacity), (2000.0, 0.0)]) },
            LabelLook { label: 4, transfer: transfer(&[(0.0, 0.0)]) },
        ];
        let curve = if gradients { &[(100.0, 0.0), (200.0, 0.7), (200.0, 0.1)][..] } else { &[] };
        let scene = Labelled::new(volume, labels, &looks, &by_gradient(&[(1700.0, 0.0), (2500.0, 0.4)], curve));
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let view = scene.view(projection, azimuth, elevation);
        let shading = lit.then(Shading::default);
        for algorithm in [Algorithm::Classified, Algorithm::Preintegrated, Algorithm::Raycast] {
            let settings = Settings { shading: shading.clone(), early_ray_termination: 0.97, ..plain(algorithm) };
            let frame = scene.frame(&view, &settings);
            prop_assert!(frame == scene.frame(&view, &Settings { skipping: false, ..settings.clone() }), "{algorithm:?} skips");
            prop_assert!(frame == on_threads(3, || scene.frame(&view, &settings)), "{algorithm:?}: threads");
            prop_assert!(frame == scene.frame_with(&view, &settings, false), "{algorithm:?}: encodings");
            if algorithm == Algorithm::Classified {
                let fast = Settings { algorithm: Algorithm::FastClassification, ..settings };
                prop_assert!(frame == scene.frame(&view, &fast), "fast classification differs");
            }
        }
    }
}
