//! Which pixels of a scanline a slice has work for: those that touch a drawn voxel and are open.
//!
//! Open pixels are machine words, a bit for each (the paper's links to the next pixel that is not opaque). A run of voxels
//! touches one pixel more than it has voxels, or as many, and fits one word: whether there is work under it
//! takes a shift and an intersection.

use super::{WORD, below};

/// The pixels of a scanline that are neither opaque nor clipped away, and how they lie over one of voxels.
#[derive(Clone, Copy, Debug)]
pub struct Open<'a> {
    /// By pixel of the image, and at least a word more.
    pub words: &'a [u64],
    /// The pixel that lies on voxel 0 or, where pixels are between voxels, after it.
    pub first: usize,
    /// True where pixels are between voxels: each touches the one before it and the one after.
    pub between: bool,
    /// Voxels.
    pub length: usize,
}

/// Open pixels that touch a stretch of voxels.
#[derive(Clone, Copy, Debug)]
pub struct Around {
    /// The pixel of the image that bit 0 stands for.
    pub first: usize,
    pub pixels: u64,
    /// 1 where bit 0 is of the pixel before the first voxel, else 0.
    lead: usize,
    between: bool,
}

impl Open<'_> {
    /// The open pixels that touch the `length` voxels from `start` on: at most 63, or 64 where `start` is 0.
    #[inline(always)]
    pub fn around(&self, start: usize, length: usize) -> Around {
        let between = usize::from(self.between);
        let lead = between & usize::from(start > 0);
        let (from, end) = (start - lead, (start + length).min(self.length - between));
        let count = end.saturating_sub(from);
        let first = self.first + from;
        let (word, shift) = (first / WORD, first % WORD);
        let bits = self.words[word] >> shift | self.words[word + 1] << 1 << (WORD - 1 - shift);
        // A scanline of one voxel has no pixel after it.
        let pixels = if count == 0 { 0 } else { bits & (u64::MAX >> (WORD - count)) };
        Around { first, pixels, lead, between: self.between }
    }

    /// Those that touch the voxels of a word.
    #[inline(always)]
    pub fn word(&self, at: usize) -> OpenWord {
        let first = self.first + at * WORD;
        let (word, shift) = (first / WORD, first % WORD);
        let bits = self.words[word] >> shift | self.words[word + 1] << 1 << (WORD - 1 - shift);
        let pixels = bits & below(self.length - usize::from(self.between), at);
        let before = if at > 0 { self.words[(first - 1) / WORD] >> ((first - 1) % WORD) & 1 } else { 0 };
        OpenWord { first, pixels, before, between: self.between }
    }
}

/// The open pixels that touch the voxels of one word of a scanline.
#[derive(Clone, Copy, Debug)]
pub struct OpenWord {
    /// The pixel on the word's first voxel or after it.
    first: usize,
    /// From that one on.
    pixels: u64,
    /// 1 where the one before it is open and touches the first voxel, too; else 0.
    before: u64,
    between: bool,
}

impl OpenWord {
    /// The voxels that they touch.
    #[inline(always)]
    pub fn voxels(&self) -> u64 {
        if self.between { self.pixels | self.pixels << 1 | self.before } else { self.pixels }
    }

    /// Adds those that touch any of `drawn` voxels to `touched`.
    #[inline(always)]
    pub fn touch(&self, drawn: u64, touched: &mut Touched) {
        if self.between {
            touched.add(self.first, (drawn | drawn >> 1) & self.pixels);
            if drawn & self.before != 0 {
                touched.add(self.first - 1, 1);
            }
        } else {
            touched.add(self.first, drawn & self.pixels);
        }
    }
}

impl Around {
    /// The voxels that the pixels touch, from the stretch's first on, of which there are `length`.
    #[inline(always)]
    pub fn voxels(&self, length: usize) -> u64 {
        let under = if self.between { self.pixels | self.pixels << 1 } else { self.pixels };
        under >> self.lead & (u64::MAX >> (WORD - length))
    }
}

/// Pixels of a scanline to work on.
#[derive(Debug)]
pub struct Touched {
    /// By pixel of the image. Zero outside of the range.
    words: Vec<u64>,
    from: usize,
    to: usize,
}

impl Touched {
    /// For scanlines of `width` pixels.
    pub fn new(width: usize) -> Self {
        Self { words: vec![0; width.div_ceil(WORD) + 1], from: usize::MAX, to: 0 }
    }

    /// Adds pixels, of which bit 0 is the image's `first`.
    #[inline(always)]
    pub fn add(&mut self, first: usize, pixels: u64) {
        let (word, shift) = (first / WORD, first % WORD);
        self.words[word] |= pixels << shift;
        self.words[word + 1] |= pixels >> 1 >> (WORD - 1 - shift);
        self.from = self.from.min(word);
        self.to = self.to.max(word + 2);
    }

    /// True where there is no work.
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.to == 0
    }

    /// Takes the words, with the number of each, and leaves none.
    #[inline(always)]
    pub fn take(&mut self, mut each: impl FnMut(usize, u64)) {
        for word in self.from..self.to {
            let bits = std::mem::take(&mut self.words[word]);
            if bits != 0 {
                each(word, bits);
            }
        }
        (self.from, self.to) = (usize::MAX, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Pixel by pixel and voxel by voxel.
        #[test]
        fn a_stretch_touches_the_pixels_beside_its_voxels(
            words in prop::array::uniform5(any::<u64>()), first in 0usize..64, length in 1usize..200, between: bool,
            at in 0.0..1.0, share in 0.0..1.0,
        ) {
            let start = (at * (length - 1) as f64) as usize;
            let most = (length - start).min(if start == 0 { 64 } else { 63 });
            let count = 1 + (share * (most - 1) as f64) as usize;
            let open = Open { words: &words, first, between, length };
            let is_open = |u: usize| words[u / WORD] >> (u % WORD) & 1 == 1;
            let mut expected = vec![];
            let mut voxels = 0u64;
            for pixel in 0..length - usize::from(between) {
                let touches = pixel..=pixel + usize::from(between);
                let inside: Vec<_> = touches.filter(|i| (start..start + count).contains(i)).collect();
                if !inside.is_empty() && is_open(first + pixel) {
                    expected.push(first + pixel);
                    inside.iter().for_each(|i| voxels |= 1 << (i - start));
                }
            }
            let around = open.around(start, count);
            prop_assert_eq!(around.voxels(count), voxels);
            let mut touched = Touched::new(320);
            if around.pixels != 0 {
                touched.add(around.first, around.pixels);
            }
            prop_assert_eq!(touched.is_empty(), expected.is_empty());
            let mut found = vec![];
            touched.take(|word, bits| found.extend((0..WORD).filter(|n| bits >> n & 1 == 1).map(|n| word * WORD + n)));
            prop_assert_eq!(&found, &expected);
            touched.take(|_, _| panic!("nothing is left"));

            // The same by words of voxels.
            let (mut under, mut found) = (vec![], vec![]);
            for word in 0..length.div_ceil(WORD) {
                let drawn = (0..WORD).filter(|n| (start..start + count).contains(&(word * WORD + n)));
                let drawn = drawn.fold(0, |bits, n| bits | 1 << n);
                let open = open.word(word);
                under.extend((0..WORD).filter(|n| drawn & open.voxels() & 1 << n != 0).map(|n| word * WORD + n));
                open.touch(drawn, &mut touched);
            }
            touched.take(|word, bits| found.extend((0..WORD).filter(|n| bits >> n & 1 == 1).map(|n| word * WORD + n)));
            prop_assert_eq!(found, expected);
            let voxels: Vec<_> = (0..WORD).filter(|n| voxels >> n & 1 == 1).map(|n| start + n).collect();
            prop_assert_eq!(under, voxels);
        }
    }
}
