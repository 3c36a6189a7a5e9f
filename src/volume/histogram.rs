//! How often each value occurs: codes are counted once a volume, bins are summed up from that.
//!
//! A code is the finest bin there is, so any number of bins follows from the counts per code
//! without another look at the voxels.

use rayon::prelude::*;

use super::{Scalars, Volume};

/// Voxels counted together by one task; small enough to share out, large beside a table of counts.
const CHUNK: usize = 1 << 22;

/// Voxels per code.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Histogram {
    /// Of the codes from the volume's smallest to its largest.
    counts: Vec<u64>,
}

/// Voxels in bins of equal width from `min` to `max`, the volume's smallest and largest value.
#[derive(Clone, Debug, PartialEq)]
pub struct Bins {
    pub min: f64,
    pub max: f64,
    /// A value on the border of two bins counts in the upper one, `max` in the last.
    pub counts: Vec<u64>,
}

impl Histogram {
    /// Counts every voxel, on the current rayon pool.
    pub fn of(volume: &Volume) -> Self {
        let (low, high) = volume.code_range();
        let size = usize::from(high - low) + 1;
        let counts = match volume.scalars() {
            Scalars::U8(codes) => count(codes, size, low),
            Scalars::U16(codes) => count(codes, size, low),
        };
        Self { counts }
    }

    /// The counts of `volume`, which must be the one counted, in `bins` (at least 1) bins.
    pub fn bins(&self, volume: &Volume, bins: usize) -> Bins {
        let (min, max) = volume.value_range();
        let last_code = (self.counts.len() - 1).max(1);
        let mut counts = vec![0; bins];
        for (code, count) in self.counts.iter().enumerate() {
            // Integers: a border between bins must not depend on how a float was rounded.
            counts[(code * bins / last_code).min(bins - 1)] += count;
        }
        Bins { min, max, counts }
    }

    /// Voxels of each code from the volume's smallest to its largest.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        size_of_val(&self.counts[..]) as u64
    }
}

/// Counts of the `size` codes from `low` on.
fn count<T: Copy + Into<u16> + Sync>(codes: &[T], size: usize, low: u16) -> Vec<u64> {
    let parts = codes.par_chunks(CHUNK).map(|chunk| {
        // Neighbours are often alike, and a count that was just written is waited for: each of four has its own.
        let mut counts = vec![[0u32; 4]; size];
        let (fours, rest) = chunk.as_chunks::<4>();
        let mut add = |n: usize, code: T| counts[usize::from(code.into() - low)][n] += 1;
        for four in fours {
            four.iter().enumerate().for_each(|(n, &code)| add(n, code));
        }
        rest.iter().for_each(|&code| add(0, code));
        counts.into_iter().map(|four| four.into_iter().map(u64::from).sum()).collect::<Vec<u64>>()
    });
    let add = |mut sum: Vec<u64>, part: Vec<u64>| {
        sum.iter_mut().zip(part).for_each(|(s, p)| *s += p);
        sum
    };
    parts.reduce_with(add).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::volume::{ImportReport, Placement, ScalarType};

    fn volume(scalars: Scalars, rescale: (f64, f64)) -> Volume {
        let placement = Placement::from_spacing(DVec3::ONE);
        Volume::new([2, 2, 2], placement, scalars, rescale, ImportReport::plain("test", ScalarType::U16)).unwrap()
    }

    #[test]
    fn every_voxel_is_in_one_bin_and_the_largest_in_the_last() {
        let volume = volume(Scalars::U16(vec![100, 100, 150, 199, 200, 299, 300, 300]), (2.0, -1000.0));
        let histogram = Histogram::of(&volume);
        let bins = histogram.bins(&volume, 2);
        assert_eq!((bins.min, bins.max), (-800.0, -400.0));
        assert_eq!(bins.counts, [4, 4]);
        assert_eq!(histogram.bins(&volume, 4096).counts.iter().sum::<u64>(), 8);
        assert_eq!(*histogram.bins(&volume, 4096).counts.last().unwrap(), 2);
    }

    #[test]
    fn a_volume_of_one_value_fills_one_bin() {
        let volume = volume(Scalars::U8(vec![7; 8]), (1.0, 0.0));
        let bins = Histogram::of(&volume).bins(&volume, 4);
        assert_eq!(bins.counts, [8, 0, 0, 0]);
    }
}
