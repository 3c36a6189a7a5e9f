//! What is seen of the rays of an intermediate image, in slices from the front one on: from where to where, but for holes.
//!
//! Words of pixels in which nothing is told apart take no room, and kernels ask for 64 pixels at a time.

use std::ops::Range;

use glam::Vec4;
use rayon::prelude::*;

use crate::render::factorization::Meeting;

/// Pixels of a word of masks.
const WORD: usize = 64;

/// Scanlines of which it is told together what is seen: as many as a band has, which asks for all of its own.
const GROUP: usize = 16;

/// What is seen of the rays of an intermediate image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Limits {
    scanlines: Vec<SeenScanline>,
    /// Of every so many scanlines: what is seen of any pixel is within the first, and of every pixel all of the second.
    groups: Vec<[Stretch; 2]>,
}

/// What is seen of the rays of a scanline.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenScanline {
    /// The same for all pixels but for those of the words from one on.
    elsewhere: Stretch,
    first_word: usize,
    words: Vec<Word>,
    /// From where to where, by pixel of these words; [`Stretch::NOTHING`] where nothing is seen.
    from: Vec<f32>,
    to: Vec<f32>,
    /// In the order of pixels and, within one, of its ray.
    holes: Vec<Hole>,
    /// What is seen of any pixel is within `some`, and of every pixel all of `whole`.
    some: Stretch,
    whole: Stretch,
    /// Of pixels that see something: where the last of them begins to.
    begun: f32,
    /// Of those that end before those elsewhere: where the first and where the last does.
    ends: Stretch,
    /// True where pixels see nothing at all.
    blind: bool,
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
    /// as many as it takes; that is nothing, or all there is to behind the volume.
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
        let (mut begun, mut ends, mut blind) = (f32::NEG_INFINITY, Stretch::NOTHING, elsewhere.is_nothing());
        if !blind {
            begun = elsewhere.from;
        }
        for (&from, &to) in from.iter().zip(&to) {
            let nothing = Stretch { from, to }.is_nothing();
            blind |= nothing;
            if !nothing {
                begun = begun.max(from);
            }
            if !nothing && (to < elsewhere.to || elsewhere.is_nothing()) {
                ends = Stretch { from: ends.from.min(to), to: ends.to.max(to) };
            }
        }
        let (mut some, mut whole) = (elsewhere, elsewhere);
        for Word { bounds: [least, greatest], holes, .. } in &words {
            some = Stretch { from: some.from.min(least.from), to: some.to.max(greatest.to) };
            whole = Stretch { from: whole.from.max(greatest.from), to: whole.to.min(least.to) };
            if !holes.is_empty() {
                whole = Stretch::NOTHING;
            }
        }
        Self { elsewhere, first_word, words, from, to, holes, some, whole, begun, ends, blind }
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

    /// True where it holds nothing.
    #[inline(always)]
    fn is_nothing(&self) -> bool {
        self.from == f32::INFINITY
    }

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
        let scanlines: Vec<_> = (0..height).into_par_iter().map(scanline).collect();
        let group = |scanlines: &[SeenScanline]| {
            let both = scanlines.iter().map(|scanline| [scanline.some, scanline.whole]);
            both.reduce(|[some, whole], [other, another]| {
                let some = Stretch { from: some.from.min(other.from), to: some.to.max(other.to) };
                [some, Stretch { from: whole.from.max(another.from), to: whole.to.min(another.to) }]
            })
        };
        let groups = scanlines.chunks(GROUP).filter_map(group).collect();
        Self { scanlines, groups }
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

    /// Whether pixels of scanline `v` are to be told apart between two positions ([`Self::seen`]), those aside that have
    /// [ended](Self::ended) by then.
    #[inline(always)]
    pub fn tells_apart(&self, v: usize, [first, last]: [f32; 2]) -> bool {
        let SeenScanline { holes, begun, ends, .. } = &self.scanlines[v];
        *begun > first || !holes.is_empty() || (ends.from < last && ends.to > first)
    }

    /// Whether all rays of scanline `v` of which anything is seen are seen from a position on, or from before it.
    #[inline(always)]
    pub fn have_begun(&self, v: usize, position: f32) -> bool {
        self.scanlines[v].begun <= position
    }

    /// Whether rays of scanline `v` end behind a position, not after a later one; behind no position, also those of which nothing is seen.
    #[inline(always)]
    pub fn end_between(&self, v: usize, behind: Option<f32>, until: f32) -> bool {
        let SeenScanline { ends, blind, .. } = &self.scanlines[v];
        match behind {
            Some(behind) => ends.from <= until && ends.to > behind,
            None => *blind || ends.from <= until,
        }
    }

    /// Of the 64 pixels of `word` of scanline `v`, those of which nothing is seen behind a position.
    #[inline(always)]
    pub fn ended(&self, v: usize, word: usize, position: f32) -> u64 {
        let SeenScanline { elsewhere, first_word, words, to, .. } = &self.scanlines[v];
        let at = word.wrapping_sub(*first_word);
        let [least, greatest] = words.get(at).map_or([elsewhere; 2], |word| word.bounds.each_ref());
        if greatest.to <= position {
            return u64::MAX;
        }
        let mut ended = 0;
        if least.to <= position {
            for (four, to) in to[at * WORD..][..WORD].chunks_exact(4).enumerate() {
                let before = Vec4::from_slice(to).cmple(Vec4::splat(position));
                ended |= u64::from(before.bitmask()) << (4 * four);
            }
        }
        ended
    }

    /// Whether what may lie on some scanlines between two positions is seen.
    #[inline(always)]
    pub fn meets(&self, vs: Range<usize>, between: [f32; 2]) -> Meeting {
        let (mut some, mut all) = (false, true);
        for [of_any, of_all] in &self.groups[vs.start / GROUP..vs.end.div_ceil(GROUP)] {
            some |= of_any.meets(between);
            all &= of_all.holds(between);
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// What ends at a place, begins there, or does not at all, and holes.
    fn scanline() -> impl Strategy<Value = (bool, usize, Vec<(u8, u8, u8)>)> {
        (any::<bool>(), 0usize..150, prop::collection::vec((0u8..5, 0u8..12, 0u8..12), 0..100))
    }

    const BEYOND: f32 = 12.0;

    proptest! {
        /// As a walk does it: rays that have ended are put away, and where no others are told apart, all of them are whole.
        #[test]
        fn a_walk_sees_what_is_seen_of_each_pixel(
            scanlines in prop::collection::vec(scanline(), 1..40),
            steps in prop::collection::vec((0.3f32..2.5, any::<bool>()), 1..12),
        ) {
            let limits = Limits::new(scanlines.len(), |v| {
                let (nothing_elsewhere, first, pixels) = &scanlines[v];
                let elsewhere = Stretch { from: f32::NEG_INFINITY, to: BEYOND };
                let holes = (*first as u32..).zip(pixels).filter(|(_, (kind, ..))| *kind == 4);
                let holes = holes.map(|(u, (_, at, length))| {
                    let stretch = Stretch { from: (*at).into(), to: f32::from(at + length) };
                    Hole { u, stretch }
                });
                let fill = |from: &mut [f32], to: &mut [f32]| {
                    for ((from, to), (kind, begins, ends)) in from.iter_mut().zip(to).zip(pixels) {
                        match kind {
                            0 => (*from, *to) = (f32::NEG_INFINITY, BEYOND),
                            1 => (*from, *to) = (f32::INFINITY, f32::NEG_INFINITY),
                            2 => (*from, *to) = (f32::NEG_INFINITY, (*ends).into()),
                            _ => (*from, *to) = ((*begins).into(), f32::from(begins + ends)),
                        }
                    }
                };
                let elsewhere = if *nothing_elsewhere { Stretch::NOTHING } else { elsewhere };
                SeenScanline::new(elsewhere, *first..first + pixels.len(), holes.collect(), fill)
            });
            let (mut open, mut known) = (vec![[u64::MAX; 4]; scanlines.len()], vec![None; scanlines.len()]);
            let mut position = -1.0;
            for (step, visited) in steps {
                let between = [position, f32::min(position + step, BEYOND)];
                position += step;
                if !visited || between[0] >= between[1] {
                    continue;
                }
                for (v, open) in open.iter_mut().enumerate() {
                    let met = limits.meets(v..v + 1, between);
                    if limits.end_between(v, known[v], between[0]) {
                        (0..4).for_each(|word| open[word] &= !limits.ended(v, word, between[0]));
                    }
                    known[v] = Some(between[0]);
                    let apart = limits.tells_apart(v, between);
                    for u in 0..4 * WORD {
                        let [some, whole] =
                            if apart { limits.seen(v, u / WORD, between) } else { [u64::MAX; 2] };
                        let [is_open, some, whole] =
                            [open[u / WORD], some, whole].map(|bits| bits >> (u % WORD) & 1 == 1);
                        let at = limits.at(u, v);
                        let hidden = limits.holes(u, v).any(|hole| hole.holds(between));
                        let clear = !limits.holes(u, v).any(|hole| hole.meets(between));
                        let expected = [at.meets(between) && !hidden, at.holds(between) && clear];
                        prop_assert_eq!([is_open && some, is_open && whole], expected, "({}, {}) {:?}", u, v, between);
                        prop_assert!(met != Meeting::Outside || !expected[0]);
                        prop_assert!(met != Meeting::Inside || expected[1]);
                    }
                }
            }
        }
    }
}
