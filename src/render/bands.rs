//! Bands of an image, each filled by whoever is free.

use rayon::prelude::*;

/// Gives bands, which are told from one end to the other, to threads one by one, those in the middle first. There is most to do, and what is
/// given last is what everyone waits for: a band at an end, which is soon done.
pub fn middle_first<B: Send>(bands: impl Iterator<Item = B>) -> impl ParallelIterator<Item = B> {
    let mut bands: Vec<(usize, B)> = bands.enumerate().collect();
    let count = bands.len();
    bands.sort_by_key(|(n, _)| (2 * n + 1).abs_diff(count));
    bands.into_iter().map(|(_, band)| band).par_bridge()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_band_is_given_once_and_the_middle_ones_first() {
        let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let given: Vec<i32> = one_thread.install(|| middle_first(0..5).collect());
        assert_eq!(given, [2, 1, 3, 0, 4]);
        let mut given: Vec<i32> = middle_first(0..100).collect();
        given.sort_unstable();
        assert_eq!(given, (0..100).collect::<Vec<_>>());
    }
}
