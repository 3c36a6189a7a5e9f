//! Volumes whose voxels have colours of their own: both ways to sample them, by every kernel that does.

use glam::DVec3;
use proptest::prelude::*;
use shearwarp::classify::{Color, ControlPoint, TransferFunction};
use shearwarp::render::{Algorithm, Projection, Quality, Sampling, Settings, Shading};
use shearwarp::volume::pyramid::{BoxFilter, coarser, coarser_by};
use shearwarp::volume::{Colors, ImportReport, Placement, ScalarType, Volume, phantom};

use crate::scenes::{Prepared, high, on_threads, orbit, plain, premultiplied, psnr, same_bits};

const SIZE: [u32; 2] = [90, 80];
const SAMPLINGS: [Sampling; 2] = [Sampling::Extinction, Sampling::Opacity];

/// Voxels as opaque as their alpha says over 1 mm, or as `opaque` at 255.
fn by_alpha(opaque: f64) -> TransferFunction {
    let point = |value: f64, opacity: f64| ControlPoint { value, opacity, color: Color([0.5; 3]) };
    TransferFunction {
        points: vec![point(0.0, 0.0), point(255.0, opaque)],
        opacity_distance: Some(1.0),
        gradient_opacity: vec![],
    }
}

fn volume(dims: [usize; 3], voxel: impl Fn(usize, usize, usize) -> [u8; 4]) -> Volume {
    let at = |n: usize| voxel(n % dims[0], n / dims[0] % dims[1], n / (dims[0] * dims[1]));
    let colors = Colors { voxels: (0..dims.iter().product()).map(at).collect(), has_alpha: true };
    let placement = Placement::from_spacing(DVec3::ONE);
    Volume::of_colors(dims, placement, colors, ImportReport::plain("test", ScalarType::U8)).unwrap()
}

/// Smooth blobs, of other colours here and there.
fn blobs(dims: [usize; 3], seed: u32) -> Volume {
    let channels = [0, 1, 2, 3].map(|channel| phantom::noise(dims, seed + channel));
    volume(dims, |i, j, k| {
        let n = (k * dims[1] + j) * dims[0] + i;
        let [r, g, b, a] = [0, 1, 2, 3].map(|c: usize| f64::from(channels[c].scalars().code(n)) / 4095.0);
        let alpha = ((a - 0.5) * 2.0).clamp(0.0, 1.0) * 90.0;
        [(r * 255.0) as u8, (g * 255.0) as u8, (b * 255.0) as u8, alpha as u8]
    })
}

#[test]
fn a_uniform_medium_has_its_colour_and_its_opacity_whatever_is_interpolated() {
    let scene = Prepared::new(volume([30, 34, 28], |_, _, _| [200, 100, 50, 6]), by_alpha(1.0), 0.0);
    for projection in [Projection::Parallel, Projection::Perspective] {
        let view = scene.view(&orbit(projection, 40.0, 20.0), SIZE[0], SIZE[1]);
        for sampling in SAMPLINGS {
            let exact = Settings { sampling, sample_distance: 0.25, ..plain(Algorithm::Raycast) };
            // The scalars of a scene that has none are its alpha, and their medium is the same.
            let truth = scene.frame(&view, &exact);
            let middle = (SIZE[1] / 2 * SIZE[0] + SIZE[0] / 2) as usize;
            assert!(truth.pixels[4 * middle + 3] > 100);
            for (settings, off_by, at_most) in [
                (plain(Algorithm::Classified), 8.0, 60),
                (plain(Algorithm::FastClassification), 8.0, 60),
                (plain(Algorithm::Preintegrated), 1.0, 0),
                (high(), 1.0, 0),
            ] {
                let frame = scene.frame(&view, &Settings { sampling, ..settings });
                let pairs = premultiplied(&frame).zip(premultiplied(&truth));
                let off = pairs.filter(|(a, b)| (a[3] - b[3]).abs() > off_by).count();
                assert!(off <= at_most, "{off}: outlines only");
                let [r, g, b] = [0, 1, 2].map(|n| frame.pixels[4 * middle + n]);
                assert!(r.abs_diff(200) <= 1 && g.abs_diff(100) <= 1 && b.abs_diff(50) <= 1, "{r} {g} {b}");
            }
        }
    }
}

#[test]
fn frames_are_near_the_ray_casters_by_either() {
    let scene = Prepared::new(blobs([40, 44, 36], 7), by_alpha(1.0), 0.0);
    for projection in [Projection::Parallel, Projection::Perspective] {
        for (azimuth, elevation) in [(20.0, 10.0), (100.0, -30.0), (250.0, 75.0)] {
            let view = scene.view(&orbit(projection, azimuth, elevation), SIZE[0], SIZE[1]);
            for sampling in SAMPLINGS {
                for shading in [None, Some(Shading::default())] {
                    let exact = Settings { sampling, shading, sample_distance: 0.1, ..plain(Algorithm::Raycast) };
                    let settings = Settings { algorithm: Algorithm::Classified, ..exact.clone() };
                    let dark = Settings { shading: None, ..exact.clone() };
                    let lit = if exact.shading.is_some() {
                        psnr(&scene.frame(&view, &dark), &scene.frame(&view, &exact))
                    } else {
                        0.0
                    };
                    assert!(lit < 40.0, "light changes nothing");
                    let own_rays = Settings { algorithm: Algorithm::Preintegrated, ..exact.clone() };
                    let fine = Settings { preintegration: high().preintegration, ..own_rays.clone() };
                    for (settings, floor) in [(settings, 28.0), (own_rays, 40.0), (fine, 50.0)] {
                        let db = psnr(&scene.frame(&view, &settings), &scene.frame(&view, &exact));
                        assert!(db > floor, "{projection:?} {azimuth} {settings:?}: {db} dB");
                    }
                }
            }
        }
    }
}

/// The wall of the paper's figures 5 and 6, one voxel thick. Its opacity over a ray is that of a voxel, wherever samples fall.
#[test]
fn a_thin_wall_keeps_its_opacity_by_extinction_at_coarser_steps() {
    let wall = volume([48, 40, 48], |_, j, _| if j == 20 { [255, 255, 255, 255] } else { [0; 4] });
    // Rays enter by other faces than those along the wall, so that samples fall at every distance from it.
    let camera = orbit(Projection::Parallel, 35.0, 28.0);
    let spread = |sampling: Sampling, distance: f64| {
        // As in the paper, opacities are for the sample distance.
        let transfer = TransferFunction { opacity_distance: Some(distance), ..by_alpha(1.0) };
        let scene = Prepared::new(wall.clone(), transfer, 0.0);
        let settings = Settings { sampling, sample_distance: distance, ..plain(Algorithm::Raycast) };
        let alphas = scene.rays(&scene.view(&camera, 64, 64), &settings);
        let inside = (24..40).flat_map(|y| (24..40).map(move |x| 64 * y + x)).map(|n: usize| alphas[n].w);
        let (low, high) = inside.fold((1.0f32, 0.0f32), |(low, high), a| (low.min(a), high.max(a)));
        (high - low) * 255.0
    };
    let of = |sampling| [0.4, 0.8, 1.2].map(|distance| spread(sampling, distance));
    let (by_extinction, by_opacity) = (of(Sampling::Extinction), of(Sampling::Opacity));
    assert!(by_extinction.iter().all(|steps| *steps < 1.0), "{by_extinction:?}");
    assert!(by_opacity[0] < 1.0 && by_opacity[1] > 1.0 && by_opacity[2] > by_opacity[1], "{by_opacity:?}");
}

#[test]
fn downsampling_keeps_what_is_opaque() {
    // Figures 2 and 3: half of the voxels have extinction 4.
    let halves =
        |i: usize| if i.is_multiple_of(2) { [255, 0, 0, (255.0 * -(-4.0f64).exp_m1()).round() as u8] } else { [0; 4] };
    let fine = volume([16, 16, 16], |i, _, _| halves(i));
    for filter in [BoxFilter::Two, BoxFilter::Four] {
        let level = coarser_by(&fine, filter);
        assert_eq!(level.dims(), [8; 3]);
        let [r, g, b, alpha] = level.colors().unwrap().voxels[(4 * 8 + 4) * 8 + 4];
        assert_eq!([r, g, b], [255, 0, 0], "colour is weighted by extinction");
        let twice = 1.0 - (1.0 - f64::from(alpha) / 255.0).powi(2);
        assert!((twice - 0.98).abs() < 0.01, "{filter:?}: {twice} over the length of a coarse voxel");
    }
    // The means of colours without opacity are plain.
    let gray = |i: usize| if i.is_multiple_of(2) { [200, 100, 0, 0] } else { [100, 200, 0, 0] };
    let without = Colors { has_alpha: false, ..volume([8, 8, 8], |i, _, _| gray(i)).colors().unwrap().clone() };
    let report = ImportReport::plain("test", ScalarType::U8);
    let fine = Volume::of_colors([8; 3], Placement::from_spacing(DVec3::ONE), without, report).unwrap();
    let [r, g, b, luma] = coarser(&fine).colors().unwrap().voxels[(2 * 4 + 2) * 4 + 2];
    assert!(r.abs_diff(150) <= 12 && g.abs_diff(150) <= 12 && b == 0, "{r} {g} {b}");
    assert_eq!(luma, Colors::luminance([r, g, b]));
}

#[test]
fn a_draft_is_where_the_volume_is() {
    let fine = blobs([40, 44, 36], 3);
    let (scene, level) =
        (Prepared::new(fine.clone(), by_alpha(0.5), 0.0), Prepared::new(coarser(&fine), by_alpha(0.5), 0.0));
    let view = scene.view(&orbit(Projection::Parallel, 30.0, 20.0), SIZE[0], SIZE[1]);
    let settings = Settings { quality: Quality::Draft, ..plain(Algorithm::Classified) };
    let db = psnr(&level.frame(&view, &settings), &scene.frame(&view, &settings));
    assert!(db > 24.0, "{db} dB");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn encodings_tables_skipping_and_threads_change_no_bit(
        azimuth in 0.0..360.0, elevation in -90.0..90.0, perspective: bool, lit: bool, by_opacity: bool, seed in 0..100u32,
        opaque in 0.1..1.0,
    ) {
        let scene = Prepared::new(blobs([19, 23, 17], seed), by_alpha(opaque), 0.002);
        let projection = if perspective { Projection::Perspective } else { Projection::Parallel };
        let view = scene.view(&orbit(projection, azimuth, elevation), 48, 40);
        let settings = Settings {
            sampling: SAMPLINGS[usize::from(by_opacity)],
            shading: lit.then(Shading::default),
            early_ray_termination: 0.97,
            ..plain(Algorithm::Classified)
        };
        let frame = scene.frame(&view, &settings);
        prop_assume!(frame.pixels.iter().any(|component| *component > 0));
        same_bits(&scene, &view, &Settings { algorithm: Algorithm::Preintegrated, ..settings.clone() });
        let naive = scene.frame(&view, &Settings { skipping: false, ..settings.clone() });
        prop_assert!(frame == naive, "differs from its twin");
        let fast = Settings { algorithm: Algorithm::FastClassification, ..settings.clone() };
        prop_assert!(frame == scene.frame(&view, &fast), "fast classification differs");
        prop_assert!(frame == on_threads(3, || scene.frame(&view, &settings)), "threads change something");
        let exact = Settings { algorithm: Algorithm::Raycast, ..settings };
        let skipped = scene.frame(&view, &exact);
        prop_assert!(skipped == scene.frame(&view, &Settings { skipping: false, ..exact }), "the ray caster skips something");
    }
}
