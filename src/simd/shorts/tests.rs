use proptest::prelude::*;

use super::*;
use crate::simd::{Kernel, dispatch};

#[derive(Clone, Debug)]
struct Steps {
    pixels: [Short; FOUR],
    rows: [[Short; FOUR + 1]; 2],
    weights: ShortWeights,
    limit: i16,
    touched: u64,
    lights: [ShortLight; FOUR],
}

/// Any slabs.
fn table() -> &'static ShortSlabs {
    static TABLE: std::sync::LazyLock<Box<ShortSlabs>> = std::sync::LazyLock::new(|| {
        let number = |n: u64| (n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 49) as i16;
        let slabs: Vec<Short> =
            (0..(SLAB_ENTRIES * SLAB_ENTRIES) as u64).map(|n| Short([0, 1, 2, 3].map(|c| number(4 * n + c)))).collect();
        slabs.try_into().expect("as many as there are entries")
    });
    &TABLE
}

/// Any positions.
fn positions() -> &'static Positions {
    static POSITIONS: std::sync::LazyLock<Box<Positions>> = std::sync::LazyLock::new(|| {
        let positions: Vec<i16> = (0..1 << 15).map(|n: i32| (n * 7919 % 32749) as i16).collect();
        positions.try_into().expect("as many as there are scalars")
    });
    &POSITIONS
}

/// What each step makes of it.
fn results<W: Shorts>(steps: &Steps) -> Vec<(Vec<Short>, u64)> {
    let Steps { pixels, rows: [upper, lower], weights, limit, touched, lights } = steps;
    let rows = [upper, lower];
    let blend = |by: fn(&mut [Short; FOUR], _, &ShortWeights, i16, u64) -> u64| {
        let mut pixels = *pixels;
        let done = by(&mut pixels, rows, weights, *limit, *touched);
        (pixels.to_vec(), done)
    };
    let packed = W::shade::<true>(*pixels, *lights, *touched).to_vec();
    let in_place = W::shade::<false>(*pixels, *lights, *touched).to_vec();
    let mut between = [Short::CLEAR; FOUR];
    W::between(rows, weights.upper, &mut between);
    let mut placed = between;
    W::place(&mut placed, positions());
    let mut voxels = *pixels;
    let scalars = Scalars { first_code: lights[0][0] as u16, shift: touched.trailing_zeros() % 8 };
    W::voxels([0, 1, 2, 3].map(|n| lights[n][1] as u16), *lights, scalars, &mut voxels);
    let samples = rows.map(|row| row.first_chunk().expect("five numbers"));
    let (mut lit, mut unlit) = (*pixels, *pixels);
    let done = [
        W::blend_slabs::<true>(table(), samples, &mut lit, *limit, *touched),
        W::blend_slabs::<false>(table(), samples, &mut unlit, *limit, *touched),
    ];
    let [a, b, c, d] = *lights;
    let darkened = W::darken(*lights, [d, c, b, a], touched.to_le_bytes()[4..].try_into().expect("four bytes"));
    let darkened = darkened.map(|[factor, addend]| Short([factor, addend, 0, 0]));
    let looked_up = [(between, 0), (placed, 0), (voxels, 0), (darkened, 0), (lit, done[0]), (unlit, done[1])];
    let looked_up = looked_up.map(|(samples, done)| (samples.to_vec(), done));
    [blend(W::blend::<true>), blend(W::blend::<false>), (packed, 0), (in_place, 0)]
        .into_iter()
        .chain(looked_up)
        .collect()
}

struct Both<'a>(&'a Steps);

impl Kernel for Both<'_> {
    type Output = [Vec<(Vec<Short>, u64)>; 2];

    fn run(self) -> Self::Output {
        [(); 2].map(|()| results::<Portable>(self.0))
    }

    #[cfg(target_arch = "x86_64")]
    fn run_avx2(self) -> Self::Output {
        [results::<Portable>(self.0), results::<super::super::wide::Avx2>(self.0)]
    }
}

fn pixel() -> impl Strategy<Value = Short> {
    prop::array::uniform4(0..=UNIT).prop_map(Short)
}

prop_compose! {
    fn steps()(
        pixels in prop::array::uniform4(pixel()), upper in prop::array::uniform5(pixel()), lower in prop::array::uniform5(pixel()),
        weights in prop::array::uniform4(0..=UNIT), limit in -1..UNIT, touched: u64,
        lights in prop::array::uniform4(prop::array::uniform2(0..=UNIT)),
    ) -> Steps {
        let weights = ShortWeights { upper: [weights[0], weights[1]], lower: [weights[2], weights[3]] };
        Steps { pixels, rows: [upper, lower], weights, limit, touched, lights }
    }
}

proptest! {
    #[test]
    fn wide_registers_give_the_same_bits(steps in steps()) {
        let [portable, wide] = dispatch(Both(&steps));
        prop_assert_eq!(portable, wide);
    }

    /// In floating point, to a few units.
    #[test]
    fn shading_is_a_factor_and_an_addend_below_the_opacity(mut entry in pixel(), light in prop::array::uniform2(0..=UNIT)) {
        let unit = f32::from(UNIT);
        let opacity = entry.0[3];
        entry.0 = entry.0.map(|component| component.min(opacity));
        let Short(shaded) = entry.lit(light);
        prop_assert_eq!(shaded[3], opacity);
        let [factor, addend] = light.map(|number| 2.0 * f32::from(number) / unit);
        for (component, lit) in entry.0.into_iter().zip(shaded).take(3) {
            let expected = (f32::from(component) * factor + f32::from(opacity) * addend).min(opacity.into());
            prop_assert!((f32::from(lit) - expected).abs() <= 5.0, "{:?}: {} {}", entry, lit, expected);
        }
    }

    /// In floating point, to a unit; nothing where nothing is lacking.
    #[test]
    fn light_lacks_a_part_of_what_casts_shadows(light in prop::array::uniform2(0..=UNIT), left: f32, lacking: u8) {
        let in_shadow = light.map(|number| (f32::from(number) * left.abs().fract()) as i16);
        for (n, darkened) in darkened(light, in_shadow, lacking).into_iter().enumerate() {
            let [all, left] = [light, in_shadow].map(|light| f32::from(light[n]));
            prop_assert!((f32::from(darkened) - (all + (left - all) * f32::from(lacking) / 255.0)).abs() <= 1.5);
        }
        prop_assert_eq!(darkened(light, in_shadow, 0), light);
    }

    /// One after the other.
    #[test]
    fn shaded_voxels_come_to_where_they_are_marked(steps in steps()) {
        let mut next = 0;
        let packed = Portable::shade::<true>(steps.pixels, steps.lights, steps.touched);
        let in_place = Portable::shade::<false>(steps.pixels, steps.lights, steps.touched);
        for (n, (shaded, in_place)) in packed.into_iter().zip(in_place).enumerate() {
            let is_marked = steps.touched >> n & 1 == 1;
            prop_assert_eq!(shaded, if is_marked { steps.pixels[next].lit(steps.lights[next]) } else { Short::CLEAR });
            prop_assert_eq!(in_place, if is_marked { steps.pixels[n].lit(steps.lights[n]) } else { Short::CLEAR });
            next += usize::from(is_marked);
        }
    }

    /// In floating point, to a few units; and of equal numbers it is theirs, whatever the fractions.
    #[test]
    fn what_is_between_is_interpolated(steps in steps(), same in pixel()) {
        let Steps { rows: [upper, lower], weights, .. } = &steps;
        let fractions = weights.upper;
        let unit = 32768.0;
        let [along, down] = fractions.map(|fraction| f32::from(fraction) / unit);
        let mut between = [Short::CLEAR; FOUR];
        Portable::between([&[same; FOUR + 1]; 2], fractions, &mut between);
        prop_assert_eq!(between, [same; FOUR]);
        Portable::between([upper, lower], fractions, &mut between);
        for (n, got) in between.into_iter().enumerate() {
            for c in 0..4 {
                let number = |row: &[Short; FOUR + 1], n: usize| f32::from(row[n].0[c]);
                let column = |n: usize| number(upper, n) + (number(lower, n) - number(upper, n)) * down;
                let expected = column(n) + (column(n + 1) - column(n)) * along;
                prop_assert!((f32::from(got.0[c]) - expected).abs() <= 1.5, "{} {}", got.0[c], expected);
            }
        }
    }

    /// In floating point, to a few units.
    #[test]
    fn slabs_are_between_four_entries(front in pixel(), back in pixel()) {
        let [(row, front_part), (column, back_part)] = [front, back].map(|sample| {
            let position = sample.0[POSITION] as usize;
            (position / 128, (position % 128) as f32 / 128.0)
        });
        let got = front.slab::<false>(table(), back);
        for c in 0..4 {
            let entry = |row: usize, column: usize| f32::from(table()[row * SLAB_ENTRIES + column].0[c]);
            let across = |column: usize| entry(row, column) * (1.0 - front_part) + entry(row + 1, column) * front_part;
            let expected = across(column) * (1.0 - back_part) + across(column + 1) * back_part;
            prop_assert!((f32::from(got.0[c]) - expected).abs() <= 1.5, "{} {}", got.0[c], expected);
        }
        let mean = [FACTOR, ADDEND].map(|n| (front.0[n] as u16 + back.0[n] as u16).div_ceil(2) as i16);
        prop_assert_eq!(front.slab::<true>(table(), back), got.lit(mean));
    }

    /// In floating point, to a few units; what is not touched stays as it is.
    #[test]
    fn blending_is_over(steps in steps()) {
        let Steps { pixels, rows: [upper, lower], weights, limit, touched, .. } = &steps;
        let unit = f32::from(UNIT);
        let mut blended = *pixels;
        let done = Portable::blend::<true>(&mut blended, [upper, lower], weights, *limit, *touched);
        for n in 0..FOUR {
            let before = pixels[n].0;
            prop_assert_eq!(done >> n & 1 == 1, blended[n].0[3] > *limit);
            for c in 0..4 {
                let around = [(upper[n], weights.upper[0]), (upper[n + 1], weights.upper[1]), (lower[n], weights.lower[0]),
                    (lower[n + 1], weights.lower[1])];
                let sample: f32 = around.iter().map(|(voxel, weight)| f32::from(voxel.0[c]) * f32::from(*weight) / unit).sum();
                let behind = sample.min(unit) * (unit - f32::from(before[3])) / unit;
                let expected = if touched >> n & 1 == 0 { before[c].into() } else { (f32::from(before[c]) + behind).min(unit) };
                prop_assert!((f32::from(blended[n].0[c]) - expected).abs() <= 5.0, "{} {}", blended[n].0[c], expected);
            }
        }
    }
}
