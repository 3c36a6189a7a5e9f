//! From positions on a table to entries and fractions, without a conversion from float to integer.
//!
//! Such a conversion saturates, which takes a handful of instructions and keeps loops from being
//! vectorized. Adding a number so large that only the wanted bits are left below it does the same
//! by one addition.

use crate::simd::wide;

/// Added to a number, rounds it to an integer, tie to even, and leaves that in the lowest bits.
const INTEGER: f32 = 12_582_912.0;

/// Entry and fraction of a position from 0 up to 4095.
///
/// Rounded to 2^-10 of an entry: more than the rounding of a scalar that was resampled between
/// voxels, so that between voxels of one code nothing but that code's entry is read.
#[inline(always)]
pub fn split(position: f32) -> (usize, f32) {
    let (entry, fraction) = wide::split(position);
    (entry as usize, fraction)
}

/// The entry nearest to a position from 0 on.
#[inline(always)]
pub fn nearest(position: f32) -> usize {
    (position + INTEGER).to_bits().wrapping_sub(INTEGER.to_bits()) as usize
}

/// The cell that a position from 0 on is in, and how far, 0..=1; of two cells that meet there, either.
#[inline(always)]
pub fn cell(position: f32) -> (usize, f32) {
    // Rounding may have left a position a hair below 0.
    let position = if position > 0.0 { position } else { 0.0 };
    let shifted = (position - 0.5) + INTEGER;
    ((shifted.to_bits() - INTEGER.to_bits()) as usize, position - (shifted - INTEGER))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_taken_apart_and_put_together_again() {
        for step in 0..=4095 * 37 {
            let position = step as f32 / 37.0;
            let (entry, fraction) = split(position);
            assert!((0.0..1.0).contains(&fraction));
            assert!((entry as f32 + fraction - position).abs() <= 1.0 / 2048.0, "{position}");
            assert!((nearest(position) as f32 - position).abs() <= 0.5, "{position}");
            let (index, share) = cell(position);
            assert!((0.0..=1.0).contains(&share));
            assert_eq!(index as f32 + share, position);
        }
    }

    #[test]
    fn what_rounding_adds_to_an_entry_is_dropped() {
        for entry in [0usize, 1, 40, 255, 4095] {
            for noise in [-4e-4, 0.0, 4e-4] {
                assert_eq!(split(entry as f32 + noise), (entry, 0.0));
                assert_eq!(nearest(entry as f32 + noise), entry);
            }
        }
        assert_eq!(cell(-1e-6), (0, 0.0));
    }
}
