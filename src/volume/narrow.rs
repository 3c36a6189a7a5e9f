//! Wide scalars -> 16-bit codes with a rescale.
//!
//! Kernels know codes of 8 and 16 bits only, so wider types are mapped to `0..=65535` over their
//! finite range. Whole numbers whose range fits are kept exactly (slope 1): CT stored as i32 or
//! f32 loses nothing, and its tables need no more entries than it has values. Anything else gets
//! 65536 even steps, which is finer than an 8-bit picture can show, and the report says so. Two
//! passes over the file's own array, no f64 copy.

use rayon::prelude::*;

use super::Scalars;

/// Codes, and what they mean: stored value = intercept + slope * code, slope > 0.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Narrowed {
    pub scalars: Scalars,
    pub slope: f64,
    pub intercept: f64,
    /// NaN and infinite scalars, now the smallest finite one.
    pub non_finite: u64,
    /// True where the codes are not exact.
    pub quantized: bool,
}

impl Narrowed {
    /// Codes that are the stored values less `intercept`.
    pub(super) fn exact(scalars: Scalars, intercept: f64) -> Self {
        Self { scalars, slope: 1.0, intercept, non_finite: 0, quantized: false }
    }

    /// The same stored values from codes that run the other way (`max - code`) and a negative slope:
    /// times the negative slope of a file, that makes a positive one.
    pub(super) fn flipped(self) -> Self {
        let max = self.scalars.max_code();
        let scalars = match self.scalars {
            Scalars::U8(mut codes) => {
                codes.par_iter_mut().for_each(|code| *code = u8::MAX - *code);
                Scalars::U8(codes)
            }
            Scalars::U16(mut codes) => {
                codes.par_iter_mut().for_each(|code| *code = u16::MAX - *code);
                Scalars::U16(codes)
            }
        };
        Self { scalars, intercept: self.intercept + self.slope * max, slope: -self.slope, ..self }
    }
}

impl Scalars {
    /// The largest code that the type can hold.
    pub(super) fn max_code(&self) -> f64 {
        match self {
            Self::U8(_) => f64::from(u8::MAX),
            Self::U16(_) => f64::from(u16::MAX),
        }
    }
}

/// What the first pass learns about finite values.
#[derive(Clone, Copy, Debug)]
struct Range {
    low: f64,
    high: f64,
    non_finite: u64,
    /// True where all finite values are whole numbers.
    whole: bool,
}

impl Range {
    const EMPTY: Self = Self { low: f64::INFINITY, high: f64::NEG_INFINITY, non_finite: 0, whole: true };

    fn with(self, value: f64) -> Self {
        if !value.is_finite() {
            return Self { non_finite: self.non_finite + 1, ..self };
        }
        let whole = self.whole && value.fract() == 0.0;
        Self { low: self.low.min(value), high: self.high.max(value), whole, ..self }
    }

    fn joined(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            non_finite: self.non_finite + other.non_finite,
            whole: self.whole && other.whole,
        }
    }

    fn of<T: Copy + Into<f64> + Sync>(values: &[T]) -> Self {
        let chunks = values.par_chunks(1 << 16);
        let range = chunks.map(|chunk| chunk.iter().fold(Self::EMPTY, |range, &value| range.with(value.into())));
        let range = range.reduce(|| Self::EMPTY, Self::joined);
        // Without a finite value every voxel is 0.
        if range.low > range.high { Self { low: 0.0, high: 0.0, ..range } } else { range }
    }
}

/// Maps scalars of 32 or 64 bits to 16-bit codes.
pub(super) fn narrow_wide<T: Copy + Into<f64> + Sync>(values: &[T]) -> Narrowed {
    const LAST: f64 = u16::MAX as f64;
    let Range { low, high, non_finite, whole } = Range::of(values);
    // Halves keep the difference of two f64 finite; a range too small to divide by counts as none.
    let half_range = high / 2.0 - low / 2.0;
    let constant = !half_range.is_normal();
    let exact = low == high || (whole && high - low <= LAST);
    let (slope, codes_per_half) =
        if exact || constant { (1.0, 2.0) } else { (half_range / LAST * 2.0, LAST / half_range) };
    let code = |&value: &T| {
        let value: f64 = value.into();
        if constant || !value.is_finite() {
            return 0;
        }
        // Saturates: rounding may reach past the last code by a hair, never beyond the type.
        ((value / 2.0 - low / 2.0) * codes_per_half).round() as u16
    };
    let scalars = Scalars::U16(values.par_iter().map(code).collect());
    Narrowed { scalars, slope, intercept: low, non_finite, quantized: !exact }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(narrowed: &Narrowed) -> Vec<f64> {
        let value = |index| narrowed.intercept + narrowed.slope * f64::from(narrowed.scalars.code(index));
        (0..narrowed.scalars.len()).map(value).collect()
    }

    #[test]
    fn whole_numbers_of_a_small_range_stay_exact_in_every_wide_type() {
        let integers = [-1024, 0, 64511, 7, 3071];
        let wanted: Vec<f64> = integers.iter().map(|&v| f64::from(v)).collect();
        let from_i32 = narrow_wide(&integers);
        assert_eq!((values(&from_i32), from_i32.slope, from_i32.quantized), (wanted.clone(), 1.0, false));
        assert_eq!(narrow_wide(&integers.map(|v| v as f32)), from_i32);
        assert_eq!(narrow_wide(&wanted), from_i32);
        let large = narrow_wide(&[u32::MAX, u32::MAX - 65535]);
        assert_eq!((values(&large), large.quantized), (vec![4_294_967_295.0, 4_294_901_760.0], false));
        assert!(narrow_wide(&[u32::MAX, u32::MAX - 65536]).quantized);
    }

    #[test]
    fn a_wide_range_is_off_by_half_a_step_at_most() {
        for scale in [1e-300, 1e-3, 1.0, 1e30, 1e300] {
            let input: Vec<f64> = (0..1000).map(|i| (f64::from(i).sin() * 1.5 + 0.1) * scale).collect();
            let narrowed = narrow_wide(&input);
            assert!(narrowed.quantized);
            for (got, wanted) in values(&narrowed).iter().zip(&input) {
                assert!((got - wanted).abs() <= 0.5001 * narrowed.slope, "{got} for {wanted}");
            }
        }
        let range = narrow_wide(&[i32::MIN, 0, i32::MAX]);
        assert_eq!(range.scalars, Scalars::U16(vec![0, 32768, 65535]));
    }

    #[test]
    fn what_is_not_finite_becomes_the_smallest_finite_value() {
        let narrowed = narrow_wide(&[f32::NAN, 2.5, f32::INFINITY, -1.5, f32::NEG_INFINITY]);
        assert_eq!((narrowed.non_finite, narrowed.scalars.code(0)), (3, 0));
        let got = values(&narrowed);
        assert_eq!((got[0], got[2], got[3], got[4]), (-1.5, -1.5, -1.5, -1.5));
        assert!((got[1] - 2.5).abs() < 1e-9);
        let nothing = narrow_wide(&[f64::NAN; 3]);
        assert_eq!((values(&nothing), nothing.slope, nothing.non_finite), (vec![0.0; 3], 1.0, 3));
    }

    #[test]
    fn constants_have_slope_one() {
        for value in [0.0, -7.25, 5e-324, f64::MAX] {
            let narrowed = narrow_wide(&[value; 4]);
            assert_eq!((narrowed.slope, narrowed.intercept, narrowed.quantized), (1.0, value, false));
            assert_eq!(narrowed.scalars, Scalars::U16(vec![0; 4]));
        }
    }

    #[test]
    fn flipped_codes_keep_their_values() {
        let narrowed = Narrowed { slope: 0.5, ..Narrowed::exact(Scalars::U16(vec![0, 1, 65535]), -3.0) };
        let flipped = narrowed.clone().flipped();
        assert_eq!(values(&flipped), values(&narrowed));
        assert_eq!(flipped.scalars, Scalars::U16(vec![65535, 65534, 0]));
        assert!(flipped.slope < 0.0);
    }
}
