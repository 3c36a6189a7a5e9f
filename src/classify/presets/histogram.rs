//! How often each code occurs, and what can be read off that: ranges, peaks, thresholds.

use crate::volume::{Volume, histogram};

/// Counts over bins of equal width between the smallest and the largest code.
pub struct Histogram {
    counts: Vec<u64>,
    /// Value at the middle of the first bin, and from one bin to the next.
    first: f64,
    step: f64,
    /// Smallest and largest value.
    range: (f64, f64),
}

impl Histogram {
    /// Bins at most: one per code for 8 and 12 bit scans, thresholds as fine as anyone can see.
    const MAX_BINS: usize = 4096;

    /// Counts every voxel, in parallel.
    pub fn of(volume: &Volume) -> Self {
        let (low, high) = volume.code_range();
        let codes_per_bin = (usize::from(high - low) + 1).div_ceil(Self::MAX_BINS);
        let by_code = histogram::Histogram::of(volume);
        let counts = by_code.counts().chunks(codes_per_bin).map(|bin| bin.iter().sum()).collect();
        let (slope, _) = volume.rescale();
        let first = volume.value_of_code(f64::from(low) + (codes_per_bin - 1) as f64 / 2.0);
        Self { counts, first, step: slope * codes_per_bin as f64, range: volume.value_range() }
    }

    fn value(&self, bin: usize) -> f64 {
        self.first + self.step * bin as f64
    }

    /// Share of the voxels in the first bin: the padding or the cleaned air of a scan.
    pub fn share_at_minimum(&self) -> f64 {
        self.counts[0] as f64 / self.counts.iter().sum::<u64>() as f64
    }

    /// The value that a fraction `share` of the voxels above the first bin do not exceed.
    fn quantile_above_minimum(&self, share: f64) -> f64 {
        let total: u64 = self.counts[1..].iter().sum();
        let wanted = total as f64 * share;
        let mut seen = 0;
        for (bin, &n) in self.counts.iter().enumerate().skip(1) {
            seen += n;
            if n > 0 && seen as f64 >= wanted {
                return self.value(bin);
            }
        }
        self.value(0)
    }

    /// The smallest value, and the one that 99.9 % of the voxels above it stay below. A volume of one
    /// value gets a range of length 1, so that fractions of it remain apart.
    pub fn robust_range(&self) -> (f64, f64) {
        let low = self.range.0;
        let high = self.quantile_above_minimum(0.999).min(self.range.1);
        if high > low { (low, high) } else { (low, low + 1.0) }
    }

    /// What has to be added to Hounsfield units to get this scan's values: about 0 for a scan in
    /// Hounsfield units, `None` where no two heaps look like air (-1000) and soft tissue (40).
    pub fn hounsfield_shift(&self) -> Option<f64> {
        /// Both together must stand out: four in a hundred voxels each, at least.
        const LEAST_SHARE: f64 = 0.04;
        /// Metal reaches 3000 HU in 12-bit scans; more spread is another scale.
        const MOST_ABOVE_TISSUE: f64 = 4500.0;
        let below = self.cumulative_shares();
        let share = |from: f64, to: f64| below[self.bin_from(to)] - below[self.bin_from(from)];
        let evidence = |tissue: f64| {
            let soft = share(tissue - 60.0, tissue + 60.0);
            let air = share(tissue - 1140.0, tissue - 940.0);
            let gap = share(tissue - 740.0, tissue - 240.0);
            let plausible = soft > LEAST_SHARE && air > LEAST_SHARE && gap < soft.max(air);
            plausible.then_some((soft * air, tissue))
        };
        let candidates = (0..self.counts.len()).filter_map(|bin| evidence(self.value(bin)));
        let (_, near) = candidates.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let heap = self.bin_from(near - 60.0)..self.bin_from(near + 60.0);
        let weight: f64 = heap.clone().map(|bin| self.counts[bin] as f64).sum();
        let tissue = heap.map(|bin| self.value(bin) * self.counts[bin] as f64).sum::<f64>() / weight;
        (self.robust_range().1 < tissue + MOST_ABOVE_TISSUE).then_some(tissue - 40.0)
    }

    /// Three values that part the voxels into four classes with the least variance within them
    /// (Otsu 1979), over [`Self::robust_range`].
    pub fn otsu_thresholds(&self) -> [f64; 3] {
        const CLASSES: usize = 4;
        let coarse = self.coarse();
        let bins = coarse.len();
        // weight[b], moment[b]: sums over the bins below b.
        let sums = |term: &dyn Fn(usize) -> f64| {
            let mut sum = 0.0;
            let mut below = vec![0.0];
            below.extend((0..bins).map(|b| {
                sum += term(b);
                sum
            }));
            below
        };
        let weight = sums(&|b| coarse[b]);
        let moment = sums(&|b| coarse[b] * b as f64);
        // Least variance within is most sum of (class moment)^2 / class weight.
        let merit = |from: usize, to: usize| {
            let w = weight[to] - weight[from];
            if w > 0.0 { (moment[to] - moment[from]).powi(2) / w } else { 0.0 }
        };
        // best[b]: the merit of the bins below b in as many classes as steps were done.
        let mut best: Vec<f64> = (0..=bins).map(|b| merit(0, b)).collect();
        let mut cuts = Vec::with_capacity(CLASSES - 1);
        for _ in 1..CLASSES {
            let step = |b: usize| {
                let split = |cut: usize| (best[cut] + merit(cut, b), cut);
                (0..=b).map(split).max_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or((0.0, 0))
            };
            let (merits, cut): (Vec<_>, Vec<_>) = (0..=bins).map(step).unzip();
            best = merits;
            cuts.push(cut);
        }
        let mut end = bins;
        let mut thresholds = [0.0; CLASSES - 1];
        let (low, high) = self.robust_range();
        for (threshold, cut) in thresholds.iter_mut().zip(&cuts).rev() {
            end = cut[end];
            *threshold = low + (high - low) * end as f64 / bins as f64;
        }
        thresholds
    }

    /// Voxels over 256 bins of the robust range, what lies above it in the last.
    fn coarse(&self) -> Vec<f64> {
        const BINS: usize = 256;
        let (low, high) = self.robust_range();
        let mut coarse = vec![0.0; BINS];
        for (bin, &n) in self.counts.iter().enumerate() {
            // The cast saturates at 0.
            let at = (self.value(bin) - low) / (high - low) * BINS as f64;
            coarse[(at as usize).min(BINS - 1)] += n as f64;
        }
        coarse
    }

    /// Shares of the voxels in the bins below 0, 1, 2, ...; the last is 1.
    fn cumulative_shares(&self) -> Vec<f64> {
        let total = self.counts.iter().sum::<u64>() as f64;
        let mut sum = 0;
        let mut below = vec![0.0];
        below.extend(self.counts.iter().map(|n| {
            sum += n;
            sum as f64 / total
        }));
        below
    }

    /// The first bin whose value is not below `value`, or the number of bins.
    fn bin_from(&self, value: f64) -> usize {
        // The cast saturates at 0.
        (((value - self.first) / self.step).ceil() as usize).min(self.counts.len())
    }
}
