use glam::{DVec3, DVec4, Vec4};
use proptest::prelude::*;

use super::*;
use crate::classify::transfer::extinction;
use crate::classify::{Color, ControlPoint};
use crate::simd::shorts::{SLAB_ENTRIES, UNIT};
use crate::simd::wide::Portable;
use crate::volume::phantom;

/// A volume that has all codes from `low` to `high`, spacing 1 mm.
fn volume(low: u16, high: u16) -> Volume {
    let codes = f64::from(high - low);
    phantom::from_fn([2, 2, 2], [1.0; 3], |i, j, k| f64::from(low) + codes * ((i + j + k) as f64 / 3.0).floor())
}

fn transfer(points: &[(f64, f64, [f32; 3])]) -> TransferFunction {
    let points = points.iter().map(|&(value, opacity, color)| ControlPoint { value, opacity, color: Color(color) });
    TransferFunction { points: points.collect(), opacity_distance: None, gradient_opacity: vec![] }
}

/// A slab by brute force: premultiplied colour and opacity, and optical depth.
fn integrate(volume: &Volume, transfer: &TransferFunction, [front, back]: [f64; 2], length: f64) -> (DVec4, f64) {
    const STEPS: usize = 4000;
    let reference = transfer.reference_length(volume.smallest_spacing());
    let value = |share: f64| volume.value_of_code(front + (back - front) * share);
    // Steps begin and end at control points: between them nothing jumps.
    let mut cuts: Vec<f64> =
        transfer.points.iter().map(|p| (p.value - value(0.0)) / (value(1.0) - value(0.0))).collect();
    cuts.retain(|cut| (0.0..=1.0).contains(cut));
    cuts.extend([0.0, 1.0]);
    cuts.sort_by(f64::total_cmp);
    let (mut color, mut depth) = (DVec3::ZERO, 0f64);
    for ends in cuts.windows(2) {
        for step in 0..STEPS {
            // Dense at both ends, where an opacity of 1 has its logarithm.
            let t = (step as f64 + 0.5) / STEPS as f64;
            let (along, rate) = (t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t) / STEPS as f64);
            let value = value(ends[0] + (ends[1] - ends[0]) * along);
            let part = extinction(transfer.opacity(value), reference) * length * (ends[1] - ends[0]) * rate;
            color += DVec3::from(transfer.color(value)) * (-(-part).exp_m1() * (-depth).exp());
            depth += part;
        }
    }
    (color.extend(-(-depth).exp_m1()), depth)
}

/// Control points with steps, peaks and plateaus, whole and fractional values.
fn any_transfer(range: f64) -> impl Strategy<Value = TransferFunction> {
    let opacity = prop_oneof![Just(0.0), Just(1.0), 0.0..1.0, 0.0..0.05];
    let value = prop_oneof![2 => (0.0..range).prop_map(f64::round), 1 => 0.0..range];
    let point = (value, opacity, prop::array::uniform3(0f32..=1.0));
    (prop::collection::vec(point, 1..12), prop::bool::ANY).prop_map(|(mut points, steps)| {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if steps {
            for at in (1..points.len()).step_by(3) {
                points[at].0 = points[at - 1].0;
            }
        }
        transfer(&points)
    })
}

/// Two fifths of what 8 bits tell apart. Where a slab begins at an opacity of 1, light comes from where Gauss's rule is coarsest: three parts of
/// a ramp from there were found to be off by a little more than a quarter.
const TOLERANCE: f64 = 1.5e-3;

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_entry_is_the_integral_over_its_slab(
        transfer in any_transfer(60.0),
        low in 0u16..10,
        entries in prop_oneof![Just(256usize), 2usize..50],
        length in prop_oneof![Just(1f32), 0.1f32..3.0],
        slabs in prop::collection::vec((0f64..=1.0, 0f64..=1.0), 8),
    ) {
        let volume = volume(low, 60);
        let tables = SlabTables::new(&volume, &transfer, entries);
        let [table, depths] = [Form::Opacity, Form::OpticalDepth].map(|form| tables.table(form, length));
        let codes = table.axis().codes();
        let last = (codes.len() - 1) as f64;
        for (front, back) in slabs.into_iter().map(|(f, b)| ((f * last).round() as usize, (b * last).round() as usize)) {
            let (exact, depth) = integrate(&volume, &transfer, [front, back].map(|entry| codes[entry]), table.length().into());
            for slab in [table.nearest(front as f32, back as f32), table.bilinear(front as f32, back as f32)] {
                let error = (slab.as_dvec4() - exact).abs().max_element();
                prop_assert!(error < TOLERANCE, "{front} to {back}: {slab}, not {exact}");
            }
            let scaled = depths.nearest(front as f32, back as f32).as_dvec4();
            prop_assert!((scaled.w - depth).abs() < 1e-4 * (1.0 + depth), "{front} to {back}: depth {}, not {depth}", scaled.w);
            let exact = exact * if depth > 0.0 { depth / exact.w } else { 0.0 };
            prop_assert!((scaled - exact).abs().max_element() < TOLERANCE * (1.0 + depth), "{front} to {back}: {scaled}, not {exact}");
        }
    }

    #[test]
    fn entries_of_16_bits_are_those_of_floats_and_scalars_lie_where_codes_do(
        transfer in any_transfer(600.0),
        low in 0u16..10,
        high in 20u16..600,
        length in prop_oneof![Just(1f32), 0.1f32..3.0],
    ) {
        let tables = SlabTables::new(&volume(low, high), &transfer, 256);
        let table = tables.table(Form::Opacity, length);
        let short = tables.short_table(length, 100).expect("no error comes near the greatest within 100 slabs");
        let unit = f32::from(UNIT);
        let entries = table.axis().entries();
        for (front, back) in (0..=entries).flat_map(|front| (0..=entries).map(move |back| (front, back))) {
            let slab = Vec4::from_array(short.slabs()[front * SLAB_ENTRIES + back].0.map(f32::from)) / unit;
            let exact = table.nearest(front.min(entries - 1) as f32, back.min(entries - 1) as f32);
            prop_assert!((slab - exact).abs().max_element() <= 0.51 / unit, "{front} {back}: {slab}, not {exact}");
        }
        let positions = |scalar: i16| short.axis().positions().map_or(scalar, |positions| positions[scalar as usize]);
        let mut last = 0;
        for code in low..=high {
            let position = positions(short.axis().scalars().of(code));
            let exact = table.axis().coordinate(code.into());
            prop_assert!((f32::from(position) / 128.0 - exact).abs() <= 0.51 / 128.0, "{code}: {position}, not {exact}");
            prop_assert!(position >= last);
            last = position;
        }
    }

    #[test]
    fn running_sums_are_never_more_opaque_than_exact_and_their_depths_are(
        transfer in any_transfer(60.0),
        length in 0.2f32..3.0,
        slabs in prop::collection::vec((0u8..=60, 0u8..=60), 8),
    ) {
        let volume = volume(0, 60);
        let tables = SlabTables::new(&volume, &transfer, 256);
        let forms = [Form::Opacity, Form::OpticalDepth];
        let [opacities, depths] = forms.map(|form| tables.running_sums(form, length));
        for (front, back) in slabs {
            let (exact, depth) = integrate(&volume, &transfer, [front.into(), back.into()], opacities.length().into());
            let opacity = f64::from(read(OneDimensional(&opacities), front.into(), back.into()).w);
            prop_assert!(opacity < exact.w + 1e-4, "{front} to {back}: {opacity} above {}", exact.w);
            let read = f64::from(read(OneDimensional(&depths), front.into(), back.into()).w);
            prop_assert!((read - depth).abs() < 1e-4 * (1.0 + depth), "{front} to {back}: {read}, not {depth}");
        }
    }

    #[test]
    fn between_codes_of_which_none_is_visible_every_table_reads_zero(
        transfer in any_transfer(100.0),
        (low, span) in (0u16..100, prop_oneof![Just(0u16), Just(1), 2u16..256, 256u16..5000, 5000u16..60000]),
        stretched in prop::bool::ANY,
        entries in prop_oneof![Just(256usize), 2usize..300],
        length in 0.2f32..3.0,
        shares in prop::collection::vec((0f32..=1.0, 0f32..=1.0), 4),
    ) {
        let volume = volume(low, low + span);
        let transfer = if stretched { stretch(&transfer, f64::from(span) / 90.0) } else { transfer };
        let tables = SlabTables::new(&volume, &transfer, entries);
        let visible = tables.visible_codes();
        prop_assert_eq!(visible.len(), usize::from(low + span) + 1);
        let forms = [Form::Opacity, Form::OpticalDepth];
        let tables = forms.map(|form| (tables.table(form, length), tables.running_sums(form, length)));
        // Runs of codes that are not visible, and scalars between their ends, rounded as sampled ones are.
        let codes: Vec<usize> = (usize::from(low)..visible.len()).collect();
        for run in codes.chunk_by(|&a, &b| visible[a] == visible[b]).filter(|run| !visible[run[0]]) {
            let (first, last) = (run[0] as f32, run[run.len() - 1] as f32);
            let rounded = |share: f32, noise: f32| (first + (last - first) * share) * (1.0 + noise);
            let inner = shares.iter().map(|&(f, b)| (rounded(f, 4e-7), rounded(b, -4e-7)));
            let ends = [(first, last), (last, first), (first, first), (last, last)];
            let noisy = ends.map(|(f, b)| (f * (1.0 - 4e-7), b * (1.0 + 4e-7)));
            for (front, back) in inner.chain(ends).chain(noisy) {
                for (table, sums) in &tables {
                    for slab in [read(Nearest(table), front, back), read(Bilinear(table), front, back), read(OneDimensional(sums), front, back)] {
                        prop_assert_eq!(slab.to_array().map(f32::to_bits), [0; 4], "{} to {}", front, back);
                    }
                }
            }
        }
    }
}

fn read(table: impl Slabs, front: f32, back: f32) -> Vec4 {
    let [front_at, back_at] = [front, back].map(|code| table.coordinate(code));
    let slab = table.slab(front_at, back_at);
    // The same of eight at once.
    let [fronts, backs] = [front, back].map(|code| table.coordinates::<Portable>(&[code; LANES]));
    assert_eq!([fronts, backs], [[front_at; LANES], [back_at; LANES]]);
    assert_eq!(table.slabs::<Portable>(&fronts, &backs), slab.to_array().map(|component| [component; LANES]));
    slab
}

/// Control points moved apart.
fn stretch(transfer: &TransferFunction, factor: f64) -> TransferFunction {
    let mut stretched = transfer.clone();
    stretched.points.iter_mut().for_each(|point| point.value *= factor);
    stretched
}

/// Its colour is that of its front, and of what is seen a little way in.
/// Of a scalar whose slabs are all as far off, many off by half a step each.
#[test]
fn media_too_clear_for_16_bits_have_none() {
    let opacity = |fractions: f64| transfer(&[(0.0, fractions / f64::from(UNIT), [1.0; 3])]);
    let small = volume(0, 10);
    let is_there =
        |fractions, count| SlabTables::new(&small, &opacity(fractions), 256).short_table(1.0, count).is_some();
    assert!(is_there(2.5, 100));
    assert!(!is_there(2.5, 1000));
    assert!(is_there(2.0, 1000), "nothing is off");
    assert!(is_there(200.5, 100_000), "what is seen is off by a 400th of it");
    let sixteen = phantom::from_fn([2, 2, 2], [1.0; 3], |i, j, k| 20_000.0 * (i + j + k) as f64);
    assert!(SlabTables::new(&sixteen, &opacity(1e4), 256).short_table(1.0, 10).is_none(), "more codes than scalars");
    assert!(SlabTables::new(&volume(0, 999), &opacity(1e4), 999).short_table(1.0, 10).is_none());
}

#[test]
fn an_opaque_slab_shows_less_of_its_depth_the_deeper_it_is() {
    let volume = volume(0, 50);
    let ramp = transfer(&[(0.0, 1.0, [0.0, 0.0, 0.0]), (50.0, 1.0, [0.0, 0.0, 1.0])]);
    let tables = SlabTables::new(&volume, &ramp, 256);
    for length in [0.5, 2.0, 8.0, 1000.0] {
        let table = tables.table(Form::Opacity, length);
        let depth = extinction(1.0, 1.0) * f64::from(table.length());
        // int_0^1 w u exp(-u w) dw
        let expected = (1.0 - (-depth).exp() * (1.0 + depth)) / depth;
        let blue = f64::from(table.nearest(0.0, 50.0).z);
        assert!((blue / expected - 1.0).abs() < 1e-3, "{length}: {blue}, not {expected}");
    }
}

#[test]
fn what_a_transfer_function_does_not_reach_is_not_visible() {
    let white = [1.0; 3];
    // A ramp from the first code: voxels of that code alone are transparent, and most of many volumes.
    let ramp = SlabTables::new(&volume(0, 255), &transfer(&[(0.0, 0.0, white), (255.0, 0.5, white)]), 256);
    assert!(!ramp.visible_codes()[0] && ramp.visible_codes()[1..].iter().all(|&visible| visible));
    // A peak, and a step that falls to nothing.
    let points = [(40.0, 0.0, white), (42.0, 0.5, white), (44.0, 0.0, white), (46.0, 0.0, white), (46.0, 0.3, white)];
    let peak = [&points[..], &[(48.0, 0.3, white), (48.0, 0.0, white)]].concat();
    let visible = SlabTables::new(&volume(0, 255), &transfer(&peak), 256).visible;
    let codes: Vec<usize> = (0..=255).filter(|&code| visible[code]).collect();
    assert_eq!(codes, [41, 42, 43, 46, 47]);
}

/// Twelve bits, or as many as `high` takes.
fn head(high: u16) -> (Volume, TransferFunction) {
    let (skin, bone) = ([0.9, 0.6, 0.4], [1.0, 1.0, 0.9]);
    let points = [
        (700.0, 0.0, skin),
        (1000.0, 0.02, skin),
        (1150.0, 0.02, [0.9, 0.5, 0.4]),
        (1250.0, 0.0, [1.0; 3]),
        (1500.0, 0.6, bone),
        (3272.0, 0.9, [1.0; 3]),
    ];
    (volume(0, high), transfer(&points))
}

/// Slabs with a scalar anywhere and another at some distance, near ones as often as far ones.
fn slabs(range: f64) -> impl Iterator<Item = [f64; 2]> {
    let mut state = 1u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    std::iter::repeat_with(move || {
        let front = range * random();
        let distance = range * 0.5f64.powf(12.0 * random());
        [front, (front + if random() < 0.5 { distance } else { -distance }).clamp(0.0, range)]
    })
}

/// The largest and the mean error of slabs read from a table of 256 entries, in units of 8 bits.
fn errors(volume: &Volume, transfer: &TransferFunction, range: f64, length: f32) -> (f64, f64) {
    let tables = SlabTables::new(volume, transfer, 256);
    let table = tables.table(Form::Opacity, length);
    let errors: Vec<f64> = slabs(range)
        .take(400)
        .map(|[front, back]| {
            let (exact, _) = integrate(volume, transfer, [front, back], table.length().into());
            let slab = read(Bilinear(&table), front as f32, back as f32);
            255.0 * (slab.as_dvec4() - exact).abs().max_element()
        })
        .collect();
    (errors.iter().copied().fold(0.0, f64::max), errors.iter().sum::<f64>() / errors.len() as f64)
}

#[test]
fn slabs_of_twelve_bits_are_exact_to_eight_bits_between_256_entries() {
    for length in [1.0, 0.5] {
        let (volume, transfer) = head(3272);
        let (largest, mean) = errors(&volume, &transfer, 3272.0, length);
        assert!(largest < 0.25 && mean < 0.02, "largest {largest}, mean {mean}");
    }
}

#[test]
fn a_voxel_of_metal_does_not_blur_the_transfer_function() {
    let (volume, transfer) = head(u16::MAX);
    let (largest, mean) = errors(&volume, &transfer, 3272.0, 1.0);
    assert!(largest < 0.5 && mean < 0.05, "largest {largest}, mean {mean}");
}

#[test]
fn peaks_narrower_than_an_even_distance_of_entries_are_kept() {
    let (red, blue) = ([1.0, 0.2, 0.1], [0.1, 0.2, 1.0]);
    let points = [(1000.0, 0.0, red), (1004.0, 0.8, red), (1008.0, 0.0, red), (2501.0, 0.0, blue), (2501.0, 0.6, blue)];
    let transfer = transfer(&[&points[..], &[(2506.0, 0.6, blue), (2506.0, 0.0, blue)]].concat());
    let (largest, mean) = errors(&volume(0, 4095), &transfer, 4095.0, 1.0);
    assert!(largest < 4.0 && mean < 0.1, "largest {largest}, mean {mean}");
}

#[test]
fn the_depth_of_a_linear_opacity_has_its_closed_form() {
    let transfer = transfer(&[(0.0, 0.0, [1.0; 3]), (250.0, 1.0, [1.0; 3])]);
    let tables = SlabTables::new(&volume(0, 250), &transfer, 256);
    let (opacities, depths) = (tables.table(Form::Opacity, 1.5), tables.table(Form::OpticalDepth, 1.5));
    // int -ln(1 - a) da = (1 - a) ln(1 - a) + a
    let antiderivative = |a: f64| if a < 1.0 { (1.0 - a) * (1.0 - a).ln() + a } else { 1.0 };
    for (front, back) in (0..250).flat_map(|f| [(f, f + 1), (f, 250), (250, f), (f / 2, f + 1)]) {
        let (low, high) = (f64::from(front.min(back)) / 250.0, f64::from(front.max(back)) / 250.0);
        let depth = 1.5 * (antiderivative(high) - antiderivative(low)) / (high - low);
        let read = |table: &SlabTable| f64::from(table.bilinear(front as f32, back as f32).w);
        // Extinction is cut off where opacity is above 1 - 1e-7, which takes 1e-7 of its integral.
        let cut_off = if high == 1.0 { 1.5e-7 / (high - low) } else { 0.0 };
        assert!(
            (read(&depths) - depth).abs() < 2e-6 * (1.0 + depth) + cut_off,
            "{front} to {back}: {}, not {depth}",
            read(&depths)
        );
        assert!((read(&opacities) + (-depth).exp_m1()).abs() < 1e-6, "{front} to {back}");
    }
}

#[test]
fn a_slab_of_one_scalar_is_that_scalars_medium() {
    let transfer = transfer(&[(10.0, 0.1, [1.0, 0.0, 0.0]), (11.0, 0.7, [0.0, 1.0, 0.0]), (12.0, 0.0, [0.0; 3])]);
    let tables = SlabTables::new(&volume(0, 20), &transfer, 256);
    let (table, sums) = (tables.table(Form::Opacity, 2.0), tables.running_sums(Form::Opacity, 2.0));
    for code in 0..=20u8 {
        let opacity = (1.0 - (1.0 - transfer.opacity(code.into())).powi(2)) as f32;
        let color = transfer.color(code.into()).map(|channel| channel as f32 * opacity);
        let expected = Vec4::new(color[0], color[1], color[2], opacity);
        let code = f32::from(code);
        for slab in [
            read(Nearest(&table), code, code),
            read(Bilinear(&table), code, code),
            read(OneDimensional(&sums), code, code),
        ] {
            assert!((slab - expected).abs().max_element() < 1e-6, "{code}: {slab}, not {expected}");
        }
    }
}

#[test]
fn running_sums_are_exact_in_a_constant_medium() {
    let transfer = transfer(&[(0.0, 0.3, [0.2, 0.5, 0.9])]);
    for high in [200, 4000, 60000] {
        let volume = volume(0, high);
        let tables = SlabTables::new(&volume, &transfer, 256);
        for form in [Form::Opacity, Form::OpticalDepth] {
            let (sums, table) = (tables.running_sums(form, 1.7), tables.table(form, 1.7));
            for [front, back] in slabs(f64::from(high)).take(200).map(|slab| slab.map(|code| code as f32)) {
                let (slab, expected) = (read(OneDimensional(&sums), front, back), read(Bilinear(&table), front, back));
                assert!((slab - expected).abs().max_element() < 1e-6, "{front} to {back}: {slab}, not {expected}");
            }
        }
    }
}

#[test]
fn running_sums_over_a_peak_are_half_as_opaque_and_their_depths_exact() {
    let peak =
        transfer(&[(100.0, 0.0, [1.0; 3]), (100.0, 0.999, [1.0; 3]), (150.0, 0.999, [1.0; 3]), (150.0, 0.0, [1.0; 3])]);
    let volume = volume(0, 4000);
    let tables = SlabTables::new(&volume, &peak, 256);
    let slab = |form| read(OneDimensional(&tables.running_sums(form, 1.0)), 100.0, 200.0);
    let (exact, depth) = integrate(&volume, &peak, [100.0, 200.0], 1.0);
    assert!((slab(Form::Opacity).w - 0.4995).abs() < 1e-5);
    assert!((f64::from(slab(Form::OpticalDepth).w) - depth).abs() < 1e-5);
    assert!(exact.w > 0.96);
}

#[test]
fn a_rounded_length_changes_no_ray_by_a_tenth_of_what_8_bits_tell_apart() {
    for length in [1.0f32, 0.75, 0.5, 2.0, 1.25, 0.001953125] {
        assert_eq!(rounded(length), length);
    }
    for step in 1..5000 {
        let length = 0.01 + step as f32 * 0.000731;
        let error = f64::from(rounded(length) / length) - 1.0;
        assert!(error.abs() <= 1.0 / 1024.0, "{length}");
        for depth in [0.1, 0.5, 1.0, 2.0, 5.0f64] {
            let change = (-depth).exp() - (-depth * (1.0 + error)).exp();
            assert!(255.0 * change.abs() < 0.1, "{length}: {change}");
        }
    }
    let (volume, transfer) = head(3272);
    let tables = SlabTables::new(&volume, &transfer, 256);
    let table = tables.table(Form::Opacity, 1.2345);
    assert_eq!(table.length(), rounded(1.2345));
    assert!(Arc::ptr_eq(&table, &tables.table(Form::Opacity, 1.2346)));
    assert!(tables.bytes() >= KEPT as u64 * SlabTable::bytes(256));
}

#[test]
fn a_scalar_that_rounding_left_outside_of_the_codes_reads_the_outermost_one() {
    for (low, high) in [(200, 255), (60_000, 60_100), (3000, 4095), (1000, u16::MAX)] {
        let white = [1.0; 3];
        let transfer = transfer(&[(f64::from(low), 0.3, white), (f64::from(high), 0.6, white)]);
        let tables = SlabTables::new(&volume(low, high), &transfer, 256);
        let (table, sums) = (tables.table(Form::Opacity, 1.0), tables.running_sums(Form::Opacity, 1.0));
        for (code, noise, opacity) in [(low, -ROUNDING, 0.3), (high, ROUNDING, 0.6)] {
            let outside = f32::from(code) * (1.0 + noise);
            for slab in [
                read(Nearest(&table), outside, outside),
                read(Bilinear(&table), outside, outside),
                read(OneDimensional(&sums), outside, outside),
                read(OneDimensional(&sums), code.into(), outside),
            ] {
                assert!((slab - Vec4::splat(opacity)).abs().max_element() < 1e-3, "{code} of {low} to {high}: {slab}");
            }
        }
    }
}
