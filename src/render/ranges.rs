//! Ranges of pixels, scanlines and words.

use std::ops::Range;

/// From the first of two ranges to the last; an empty one counts for nothing.
#[inline(always)]
pub fn hull(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    match (a.is_empty(), b.is_empty()) {
        (true, _) => b.clone(),
        (_, true) => a.clone(),
        _ => a.start.min(b.start)..a.end.max(b.end),
    }
}

/// What two ranges have in common.
#[inline(always)]
pub fn common(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    a.start.max(b.start)..a.end.min(b.end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hull_goes_from_the_first_to_the_last_and_empty_ranges_count_for_nothing() {
        assert_eq!(hull(&(5..7), &(1..3)), 1..7);
        assert_eq!(hull(&(1..7), &(2..3)), 1..7);
        assert_eq!(hull(&(0..0), &(2..3)), 2..3);
        assert_eq!(hull(&(2..3), &(Range { start: 9, end: 1 })), 2..3);
        assert!(hull(&(4..4), &(0..0)).is_empty());
        assert_eq!(common(&(1..7), &(3..9)), 3..7);
        assert!(common(&(1..3), &(5..9)).is_empty());
    }
}
