use glam::{DVec3, DVec4};
use proptest::prelude::*;

use super::*;
use crate::classify::transfer::extinction;
use crate::classify::{Color, ControlPoint};
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

/// A quarter of what 8 bits tell apart.
const TOLERANCE: f64 = 1e-3;

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
            let (exact, depth) = integrate(&volume, &transfer, [front, back].map(|entry| codes[entry]), length.into());
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
}

#[test]
fn the_newest_tables_are_kept_and_no_more_than_are_counted() {
    let transfer = transfer(&[(0.0, 0.0, [1.0; 3]), (60.0, 0.5, [0.5; 3])]);
    let tables = SlabTables::new(&volume(0, 60), &transfer, 61);
    let made: Vec<_> = (1..10).map(|length| tables.table(Form::Opacity, length as f32)).collect();
    for (length, table) in (1..10).zip(&made).rev().take(KEPT) {
        assert!(Arc::ptr_eq(table, &tables.table(Form::Opacity, length as f32)), "{length}");
    }
    assert_eq!(tables.kept().len(), KEPT);
    assert!(tables.bytes() >= KEPT as u64 * SlabTable::bytes(61));
    assert!(!Arc::ptr_eq(&made[0], &tables.table(Form::Opacity, 1.0)), "made anew");
    assert_eq!(*made[0], *tables.table(Form::Opacity, 1.0), "and the same");
}
