//! Where a surface goes on between a depth buffer's pixels, and where it is torn.

use rayon::prelude::*;

use super::BAND_HEIGHT;
use crate::simd::{self, Kernel};

/// A step between two pixels that is so many times as large as the larger of the two beside it is a tear.
const TEAR: f32 = 2.0;

/// Shorter steps, mm, are none: rounding of depth buffers.
const FLAT: f32 = 1e-3;

/// By pixel of rows of `width`, whether a surface goes on between it and its neighbours to the right and below.
pub fn smooth(distances: &[f32], width: usize) -> Vec<bool> {
    let mut smooth = vec![false; distances.len()];
    smooth.par_chunks_mut((width * BAND_HEIGHT).max(1)).enumerate().for_each(|(band, smooth)| {
        simd::dispatch(Smooth { distances, width, first: band * BAND_HEIGHT, smooth });
    });
    smooth
}

/// The job: where surfaces go on in rows from `first` on.
struct Smooth<'a> {
    distances: &'a [f32],
    width: usize,
    first: usize,
    smooth: &'a mut [bool],
}

impl Kernel for Smooth<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { distances, width, first, smooth } = self;
        let last = distances.len() / width - 1;
        // With one before it and two behind it; beyond the picture it is as on its border.
        let fill = |padded: &mut [f32], y: usize| {
            let row = &distances[y.min(last) * width..][..width];
            padded[0] = row[0];
            padded[1..=width].copy_from_slice(row);
            padded[width + 1..].fill(row[width - 1]);
        };
        let along = |row: &[f32], on: &mut [bool]| go_on([row, &row[1..], &row[2..], &row[3..]], on);
        // The one before a row, that, and the two below it.
        let mut rows = [(); 4].map(|()| vec![0.0; width + 3]);
        for (row, y) in rows.iter_mut().zip([first.saturating_sub(1), first, first + 1]) {
            fill(row, y);
        }
        let (mut upper, mut lower) = (vec![false; width], vec![false; width]);
        let mut across = vec![false; width + 1];
        along(&rows[1], &mut lower);
        for (n, smooth) in smooth.chunks_exact_mut(width).enumerate() {
            fill(&mut rows[3], first + n + 2);
            std::mem::swap(&mut upper, &mut lower);
            along(&rows[2], &mut lower);
            go_on([&rows[0][1..], &rows[1][1..], &rows[2][1..], &rows[3][1..]], &mut across);
            let [across, next] = [&across[..width], &across[1..]];
            for (x, smooth) in smooth.iter_mut().enumerate() {
                *smooth = upper[x] & lower[x] & across[x] & next[x];
            }
            rows.rotate_left(1);
        }
    }
}

/// Whether a surface goes on between the middle two of four neighbours, for as many as are asked.
#[inline(always)]
fn go_on([before, a, b, after]: [&[f32]; 4], on: &mut [bool]) {
    let length = on.len();
    let (before, a, b, after) = (&before[..length], &a[..length], &b[..length], &after[..length]);
    for n in 0..length {
        on[n] = goes_on(before[n], a[n], b[n], after[n]);
    }
}

/// Whether a surface goes on between the middle two of four neighbours.
#[inline(always)]
pub fn goes_on(before: f32, a: f32, b: f32, after: f32) -> bool {
    let (before, step, after) = ((a - before).abs(), (b - a).abs(), (after - b).abs());
    let beside = if before > after { before } else { after };
    (step <= TEAR * beside + FLAT) & a.is_finite() & b.is_finite()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn surfaces_go_on_where_four_neighbours_along_all_sides_say_so(
            width in 1usize..7,
            steps in prop::collection::vec((0..4, -2.0f32..3.0), 1..40),
        ) {
            let mut distance = 10.0;
            let mut distances: Vec<_> = steps.iter().map(|&(kind, step)| {
                distance += if kind == 1 { 20.0 * step } else { step };
                if kind == 0 { f32::INFINITY } else { distance }
            }).collect();
            distances.resize(steps.len().next_multiple_of(width), distance);
            let height = distances.len() / width;
            let at = |x: isize, y: isize| {
                distances[y.clamp(0, height as isize - 1) as usize * width + x.clamp(0, width as isize - 1) as usize]
            };
            let told = smooth(&distances, width);
            for (pixel, told) in told.into_iter().enumerate() {
                let (x, y) = ((pixel % width) as isize, (pixel / width) as isize);
                let row = |y: isize| goes_on(at(x - 1, y), at(x, y), at(x + 1, y), at(x + 2, y));
                let column = |x: isize| goes_on(at(x, y - 1), at(x, y), at(x, y + 1), at(x, y + 2));
                let expected = row(y) && row(y + 1) && column(x) && column((x + 1).min(width as isize - 1));
                prop_assert_eq!(told, expected, "pixel {} of {:?}", pixel, distances);
            }
        }
    }
}
