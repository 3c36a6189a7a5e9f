//! What is seen of the rays of an intermediate image, in slices from the front one on: from where to where, but for holes.
//!
//! Words of pixels in which nothing is told apart take no room, and kernels ask for 64 pixels at a time.

use std::ops::Range;

use glam::Vec4;
use rayon::prelude::*;

use crate::render::factorization::Meeting;

/// Pixels of a word of masks.
const WORD: usize = 64;

/// What is seen of the rays of an intermediate image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Limits {
    scanlines: Vec<SeenScanline>,
}

/// What is seen of the rays of a scanline.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenScanline {
    /// The same for all pixels but for those of the words from one on.
    elsewhere: Stretch,
    first_word: usize,
    words: Vec<Word>,
    /// From where to where, by pixel of these words; `from` is infinite where nothing is seen.
    from: Vec<f32>,
    to: Vec<f32>,
    /// In the order of pixels and, within one, of its ray.
    holes: Vec<Hole>,
    /// What is seen of any pixel is within `some`, and of every pixel all of `whole`.
    some: Stretch,
    whole: Stretch,
}

/// From where to where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    pub from: f32,
    pub to: f32,
}

/// A part of a pixel's stretch of which nothing is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    pub u: u32,
    pub stretch: Stretch,
}

/// What is the same for 64 pixels.
#[derive(Clone, Debug, PartialEq)]
struct Word {
    /// The least and the greatest of each end of their stretches.
    bounds: [Stretch; 2],
    /// Which of the scanline's holes are theirs, and the stretch that these are within.
    holes: Range<usize>,
    within: Stretch,
}

impl SeenScanline {
    /// With holes, in order, in what is seen of `pixels`, whose stretches `fill` writes; of other pixels `elsewhere` is seen, and they may be
    /// as many as it takes.
    pub fn new(
        elsewhere: Stretch,
        pixels: Range<usize>,
        holes: Vec<Hole>,
        fill: impl FnOnce(&mut [f32], &mut [f32]),
    ) -> Self {
        let first_word = pixels.start / WORD;
        let words = if pixels.is_empty() { 0 } else { pixels.end.div_ceil(WORD) - first_word };
        let (mut from, mut to) = (vec![elsewhere.from; words * WORD], vec![elsewhere.to; words * WORD]);
        let filled = pixels.start - first_word * WORD..pixels.end - first_word * WORD;
        if !filled.is_empty() {
            fill(&mut from[filled.clone()], &mut to[filled]);
        }
        let of_word = |u: usize| holes.partition_point(|hole| (hole.u as usize) < u);
        let word = |(n, (from, to)): (usize, (&[f32], &[f32]))| {
            let first = (first_word + n) * WORD;
            let theirs = of_word(first)..of_word(first + WORD);
            let within = holes[theirs.clone()].iter().fold(Stretch::NOTHING, |all, Hole { stretch, .. }| Stretch {
                from: all.from.min(stretch.from),
                to: all.to.max(stretch.to),
            });
            let [[least_from, greatest_from], [least_to, greatest_to]] = [from, to].map(bounds);
            let bounds = [Stretch { from: least_from, to: least_to }, Stretch { from: greatest_from, to: greatest_to }];
            Word { bounds, holes: theirs, within }
        };
        let words: Vec<_> = from.chunks_exact(WORD).zip(to.chunks_exact(WORD)).enumerate().map(word).collect();
        let (mut some, mut whole) = (elsewhere, elsewhere);
        for Word { bounds: [least, greatest], holes, .. } in &words {
            some = Stretch { from: some.from.min(least.from), to: some.to.max(greatest.to) };
            whole = Stretch { from: whole.from.max(greatest.from), to: whole.to.min(least.to) };
            if !holes.is_empty() {
                whole = Stretch::NOTHING;
            }
        }
        Self { elsewhere, first_word, words, from, to, holes, some, whole }
    }

    /// What is seen of pixel `u`, but for holes.
    #[inline(always)]
    pub(super) fn at(&self, u: usize) -> Stretch {
        let at = u.wrapping_sub(self.first_word * WORD);
        match (self.from.get(at), self.to.get(at)) {
            (Some(&from), Some(&to)) => Stretch { from, to },
            _ => self.elsewhere,
        }
    }

    /// Pixels that have stretches of their own are among these.
    pub(super) fn told(&self) -> Range<usize> {
        self.first_word * WORD..(self.first_word + self.words.len()) * WORD
    }
}

impl Stretch {
    pub const NOTHING: Self = Self { from: f32::INFINITY, to: f32::NEG_INFINITY };

    /// Whether some of it lies between two positions.
    #[inline(always)]
    pub fn meets(&self, [first, last]: [f32; 2]) -> bool {
        self.from < last && self.to > first
    }

    /// Whether all that lies between two positions is of it.
    #[inline(always)]
    pub fn holds(&self, [first, last]: [f32; 2]) -> bool {
        self.from <= first && self.to >= last
    }
}

impl Limits {
    /// What scanlines see, so many of them.
    pub fn new(height: usize, scanline: impl Fn(usize) -> SeenScanline + Sync + Send) -> Self {
        Self { scanlines: (0..height).into_par_iter().map(scanline).collect() }
    }

    /// True where nothing is seen at all.
    pub fn is_empty(&self) -> bool {
        self.scanlines.iter().all(|scanline| scanline.some == Stretch::NOTHING)
    }

    /// Of scanline `v`.
    pub(super) fn scanline(&self, v: usize) -> &SeenScanline {
        &self.scanlines[v]
    }

    /// What is seen of the ray of pixel (u, v), but for holes.
    #[inline(always)]
    pub fn at(&self, u: usize, v: usize) -> Stretch {
        self.scanlines[v].at(u)
    }

    /// The holes in that, one behind another.
    #[inline(always)]
    pub fn holes(&self, u: usize, v: usize) -> impl Iterator<Item = Stretch> + '_ {
        let SeenScanline { first_word, words, holes, .. } = &self.scanlines[v];
        let word = words.get((u / WORD).wrapping_sub(*first_word));
        let theirs = word.map_or(&[][..], |word| &holes[word.holes.clone()]).iter();
        theirs.filter(move |hole| hole.u as usize == u).map(|hole| hole.stretch)
    }

    /// Whether what lies on some scanlines between two positions is seen.
    #[inline(always)]
    pub fn meets(&self, vs: Range<usize>, between: [f32; 2]) -> Meeting {
        let (mut some, mut all) = (false, true);
        for scanline in &self.scanlines[vs] {
            some |= scanline.some.meets(between);
            all &= scanline.whole.holds(between);
        }
        if all {
            Meeting::Inside
        } else if some {
            Meeting::Across
        } else {
            Meeting::Outside
        }
    }

    /// Of the 64 pixels of `word` of scanline `v`, those of which something is seen between two positions, and those of which
    /// all is.
    #[inline(always)]
    pub fn seen(&self, v: usize, word: usize, between: [f32; 2]) -> [u64; 2] {
        let scanline = &self.scanlines[v];
        let at = word.wrapping_sub(scanline.first_word);
        let every = |is: bool| if is { u64::MAX } else { 0 };
        let Some(Word { bounds: [least, greatest], holes, within }) = scanline.words.get(at) else {
            return [scanline.elsewhere.meets(between), scanline.elsewhere.holds(between)].map(every);
        };
        if !(Stretch { from: least.from, to: greatest.to }).meets(between) {
            return [0; 2];
        }
        let mut seen = [u64::MAX; 2];
        if !(Stretch { from: greatest.from, to: least.to }).holds(between) {
            seen = [0; 2];
            let [from, to] = [&scanline.from, &scanline.to].map(|ends| ends[at * WORD..][..WORD].chunks_exact(4));
            let [first, last] = between.map(Vec4::splat);
            // Four pixels of `Stretch::meets` and `Stretch::holds`.
            for (four, (from, to)) in from.zip(to).enumerate() {
                let [from, to] = [from, to].map(Vec4::from_slice);
                let meets = from.cmplt(last) & to.cmpgt(first);
                let holds = from.cmple(first) & to.cmpge(last);
                seen[0] |= u64::from(meets.bitmask()) << (4 * four);
                seen[1] |= u64::from(holds.bitmask()) << (4 * four);
            }
        }
        if within.meets(between) {
            for Hole { u, stretch } in &scanline.holes[holes.clone()] {
                let pixel = 1 << (*u as usize % WORD);
                if stretch.holds(between) {
                    seen[0] &= !pixel;
                }
                if stretch.meets(between) {
                    seen[1] &= !pixel;
                }
            }
        }
        seen
    }
}

/// The least and the greatest of some numbers.
#[inline(always)]
pub(super) fn bounds(numbers: &[f32]) -> [f32; 2] {
    let (mut least, mut greatest) = (numbers[0], numbers[0]);
    for &number in numbers {
        least = if number < least { number } else { least };
        greatest = if number > greatest { number } else { greatest };
    }
    [least, greatest]
}
