//! What is seen of the rays of an intermediate image, in slices from the front one on: from where to where, but for holes.
//!
//! Words of pixels in which nothing is told apart take no room, and kernels ask for 64 pixels at a time.

use std::ops::Range;

use glam::Vec4;
use rayon::prelude::*;

use crate::render::factorization::Meeting;
use crate::simd::masks::{Masks, WORD};
use crate::simd::wide::{LANES, least, most};
use crate::simd::{self, Kernel};

/// Scanlines of which it is told together what is seen: as many as a band has, which asks for all of its own.
const GROUP: usize = 16;

/// What is seen of the rays of an intermediate image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Limits {
    /// Scanlines that are told apart, from the first of them on; of all others the same is seen.
    scanlines: Vec<SeenScanline>,
    first: usize,
    others: SeenScanline,
    /// Of every so many scanlines: what is seen of any pixel is within the first, and of every pixel all of the second.
    groups: Vec<[Stretch; 2]>,
}

/// What is seen of the rays of a scanline.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeenScanline {
    /// The same for all pixels but for those of the words from one on.
    elsewhere: Stretch,
    first_word: usize,
    words: Vec<Word>,
    /// From where to where, by pixel of these words; [`Stretch::NOTHING`] where nothing is seen. Where all begin as elsewhere, `from` is empty.
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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
        let (words, filled) = words_of(&pixels);
        let [mut from, mut to] = [elsewhere.from, elsewhere.to].map(|end| vec![end; words.len() * WORD]);
        if !filled.is_empty() {
            fill(&mut from[filled.clone()], &mut to[filled]);
        }
        Self::of(elsewhere, words, from, to, holes)
    }

    /// Where all is seen from the front on, up to an end that `fill` writes of `pixels`, and elsewhere to `beyond` the volume.
    pub fn ending(beyond: f32, pixels: Range<usize>, fill: impl FnOnce(&mut [f32])) -> Self {
        let (words, filled) = words_of(&pixels);
        let mut to = vec![beyond; words.len() * WORD];
        if !filled.is_empty() {
            fill(&mut to[filled]);
        }
        Self::of(Stretch { from: f32::NEG_INFINITY, to: beyond }, words, vec![], to, vec![])
    }

    /// Of what is told for all pixels of some words.
    fn of(elsewhere: Stretch, told: Range<usize>, from: Vec<f32>, to: Vec<f32>, holes: Vec<Hole>) -> Self {
        let beyond = if elsewhere.is_nothing() { f32::INFINITY } else { elsewhere.to };
        let [begin, end] = [&from, &to].map(|numbers| simd::dispatch(Bounds { numbers, limit: beyond }));
        let of_word = |u: usize| holes.partition_point(|hole| (hole.u as usize) < u);
        let word = |n: usize| {
            let first = (told.start + n) * WORD;
            let theirs = of_word(first)..of_word(first + WORD);
            let within = holes[theirs.clone()].iter().fold(Stretch::NOTHING, |all, Hole { stretch, .. }| Stretch {
                from: all.from.min(stretch.from),
                to: all.to.max(stretch.to),
            });
            let [least, greatest] =
                begin.get(n).map_or([elsewhere.from; 2], |[least, greatest, _]| [*least, *greatest]);
            let bounds = [Stretch { from: least, to: end[n][0] }, Stretch { from: greatest, to: end[n][1] }];
            Word { bounds, holes: theirs, within }
        };
        let words: Vec<_> = (0..told.len()).map(word).collect();
        let (mut begun, mut ends, mut blind) = (f32::NEG_INFINITY, Stretch::NOTHING, elsewhere.is_nothing());
        if !blind {
            begun = elsewhere.from;
        }
        let (mut some, mut whole) = (elsewhere, elsewhere);
        for (n, Word { bounds: [least, greatest], holes, .. }) in words.iter().enumerate() {
            some = Stretch { from: some.from.min(least.from), to: some.to.max(greatest.to) };
            whole = Stretch { from: whole.from.max(greatest.from), to: whole.to.min(least.to) };
            if !holes.is_empty() {
                whole = Stretch::NOTHING;
            }
            let of_word = n * WORD..(n + 1) * WORD;
            if greatest.is_nothing() {
                // Of some of them nothing is seen.
                for (&from, &to) in from[of_word.clone()].iter().zip(&to[of_word]) {
                    let nothing = Stretch { from, to }.is_nothing();
                    blind |= nothing;
                    if !nothing {
                        begun = begun.max(from);
                    }
                    if !nothing && to < beyond {
                        ends = Stretch { from: ends.from.min(to), to: ends.to.max(to) };
                    }
                }
            } else {
                begun = begun.max(greatest.from);
                if least.to < beyond {
                    ends = Stretch { from: ends.from.min(least.to), to: ends.to.max(end[n][2]) };
                }
            }
        }
        let first_word = told.start;
        Self { elsewhere, first_word, words, from, to, holes, some, whole, begun, ends, blind }
    }

    /// What is seen of pixel `u`, but for holes.
    #[inline(always)]
    pub(super) fn at(&self, u: usize) -> Stretch {
        let at = u.wrapping_sub(self.first_word * WORD);
        let Stretch { from, to } = self.elsewhere;
        Stretch { from: *self.from.get(at).unwrap_or(&from), to: *self.to.get(at).unwrap_or(&to) }
    }

    /// Finds where what is seen of pixels from `u` on ends.
    #[inline(always)]
    pub(super) fn ends(&self, u: usize, ends: &mut [f32]) {
        ends.fill(self.elsewhere.to);
        let (us, told) = (u..u + ends.len(), self.told());
        let both = us.start.max(told.start)..us.end.min(told.end);
        if !both.is_empty() {
            let own = &self.to[both.start - told.start..both.end - told.start];
            ends[both.start - us.start..both.end - us.start].copy_from_slice(own);
        }
    }

    /// Pixels that have stretches of their own are among these.
    pub(super) fn told(&self) -> Range<usize> {
        self.first_word * WORD..(self.first_word + self.words.len()) * WORD
    }
}

impl Stretch {
    pub const ALL: Self = Self { from: f32::NEG_INFINITY, to: f32::INFINITY };
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
    /// What scanlines `told` of an image of `height` see; all others are alike.
    pub fn new(
        height: usize,
        told: Range<usize>,
        others: SeenScanline,
        scanline: impl Fn(usize) -> SeenScanline + Sync + Send,
    ) -> Self {
        let first = told.start;
        // In small parts: much may meet few of them.
        let all = told.into_par_iter().with_min_len(GROUP / 2).with_max_len(GROUP);
        let mut limits = Self { scanlines: all.map(scanline).collect(), first, others, groups: vec![] };
        let group = |first: usize| {
            let both = |v| {
                let SeenScanline { some, whole, .. } = limits.scanline(v);
                [*some, *whole]
            };
            (first..(first + GROUP).min(height)).map(both).reduce(|[some, whole], [other, another]| {
                let some = Stretch { from: some.from.min(other.from), to: some.to.max(other.to) };
                [some, Stretch { from: whole.from.max(another.from), to: whole.to.min(another.to) }]
            })
        };
        limits.groups = (0..height).step_by(GROUP).filter_map(group).collect();
        limits
    }

    /// True where nothing is seen at all.
    pub fn is_empty(&self) -> bool {
        self.groups.iter().all(|[some, _]| *some == Stretch::NOTHING)
    }

    /// The scanlines that are told apart.
    pub(super) fn told(&self) -> Range<usize> {
        self.first..self.first + self.scanlines.len()
    }

    /// The words of scanline `v` of which pixels may be told apart ([`Self::seen`]); all there may be, where of others nothing is seen.
    #[inline(always)]
    pub fn told_apart(&self, v: usize) -> Range<usize> {
        let SeenScanline { elsewhere, first_word, words, .. } = self.scanline(v);
        if elsewhere.is_nothing() { 0..usize::MAX } else { *first_word..first_word + words.len() }
    }

    /// Of scanline `v`.
    #[inline(always)]
    pub(super) fn scanline(&self, v: usize) -> &SeenScanline {
        self.scanlines.get(v.wrapping_sub(self.first)).unwrap_or(&self.others)
    }

    /// What is seen of the ray of pixel (u, v), but for holes.
    #[inline(always)]
    pub fn at(&self, u: usize, v: usize) -> Stretch {
        self.scanline(v).at(u)
    }

    /// The holes in that, one behind another.
    #[inline(always)]
    pub fn holes(&self, u: usize, v: usize) -> impl Iterator<Item = Stretch> + '_ {
        let SeenScanline { first_word, words, holes, .. } = self.scanline(v);
        let word = words.get((u / WORD).wrapping_sub(*first_word));
        let theirs = word.map_or(&[][..], |word| &holes[word.holes.clone()]).iter();
        theirs.filter(move |hole| hole.u as usize == u).map(|hole| hole.stretch)
    }

    /// Whether pixels of scanline `v` are to be told apart between two positions ([`Self::seen`]), those aside that have
    /// [ended](Seen::ended) by then.
    #[inline(always)]
    pub fn tells_apart(&self, v: usize, [first, last]: [f32; 2]) -> bool {
        let SeenScanline { holes, begun, ends, .. } = self.scanline(v);
        *begun > first || !holes.is_empty() || (ends.from < last && ends.to > first)
    }

    /// Whether all rays of scanline `v` of which anything is seen are seen from a position on, or from before it.
    #[inline(always)]
    pub fn have_begun(&self, v: usize, position: f32) -> bool {
        self.scanline(v).begun <= position
    }

    /// Whether rays of scanline `v` end behind a position, not after a later one; behind no position, also those of which nothing is seen.
    #[inline(always)]
    pub fn end_between(&self, v: usize, behind: Option<f32>, until: f32) -> bool {
        let SeenScanline { ends, blind, .. } = self.scanline(v);
        match behind {
            Some(behind) => ends.from <= until && ends.to > behind,
            None => *blind || ends.from <= until,
        }
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

    /// What is seen of the 64 pixels of `word` of scanline `v` between two positions.
    #[inline(always)]
    pub fn seen<W: Masks>(&self, v: usize, word: usize, between: [f32; 2]) -> Seen {
        let scanline = self.scanline(v);
        let at = word.wrapping_sub(scanline.first_word);
        let every = |is: bool| if is { u64::MAX } else { 0 };
        let Some(Word { bounds: [least, greatest], holes, within }) = scanline.words.get(at) else {
            let elsewhere = scanline.elsewhere;
            let ended = every(elsewhere.to <= between[0]);
            return Seen { ended, some: every(elsewhere.meets(between)), whole: every(elsewhere.holds(between)) };
        };
        let [first, last] = between;
        if greatest.to <= first {
            return Seen { ended: u64::MAX, some: 0, whole: 0 };
        }
        // As `Stretch::meets` and `Stretch::holds`.
        let (mut ended, mut whole) = (0, u64::MAX);
        if let (true, Some(to)) = (least.to < last, scanline.to[at * WORD..].first_chunk()) {
            let [until_first, below_last] = W::numbers(to, first, last);
            (ended, whole) = (until_first, !below_last);
        }
        let mut some = !ended;
        if greatest.from > first {
            for (four, from) in scanline.from[at * WORD..][..WORD].chunks_exact(4).enumerate() {
                let from = Vec4::from_slice(from);
                some &= !(u64::from(from.cmpge(Vec4::splat(last)).bitmask()) << (4 * four));
                whole &= !(u64::from(from.cmpgt(Vec4::splat(first)).bitmask()) << (4 * four));
            }
        }
        if within.meets(between) {
            for Hole { u, stretch } in &scanline.holes[holes.clone()] {
                let pixel = 1 << (*u as usize % WORD);
                if stretch.holds(between) {
                    some &= !pixel;
                }
                if stretch.meets(between) {
                    whole &= !pixel;
                }
            }
        }
        Seen { ended, some, whole }
    }
}

/// Which of 64 pixels see what between two positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    /// Those of which nothing is seen from the first position on.
    pub ended: u64,
    /// Those of which something is.
    pub some: u64,
    /// Those of which all is.
    pub whole: u64,
}

/// The words that some pixels are in, and where among the pixels of these they are.
fn words_of(pixels: &Range<usize>) -> (Range<usize>, Range<usize>) {
    let first = pixels.start / WORD;
    if pixels.is_empty() {
        return (first..first, 0..0);
    }
    (first..pixels.end.div_ceil(WORD), pixels.start - first * WORD..pixels.end - first * WORD)
}

/// The least and the greatest of some numbers, and the greatest of those that are less than `limit`.
#[inline(always)]
fn bounds_of(numbers: &[f32; WORD], limit: f32) -> [f32; 3] {
    // Side by side, as registers have room.
    let (mut lowest, mut highest, mut below) = ([numbers[0]; LANES], [numbers[0]; LANES], [f32::NEG_INFINITY; LANES]);
    let mut add = |lane: usize, number: f32| {
        lowest[lane] = least(number, lowest[lane]);
        highest[lane] = most(number, highest[lane]);
        below[lane] = if (number > below[lane]) & (number < limit) { number } else { below[lane] };
    };
    for chunk in numbers.as_chunks::<LANES>().0 {
        for (lane, &number) in chunk.iter().enumerate() {
            add(lane, number);
        }
    }
    let greatest = |lanes: [f32; LANES]| lanes.into_iter().fold(f32::NEG_INFINITY, f32::max);
    [lowest.into_iter().fold(f32::INFINITY, f32::min), greatest(highest), greatest(below)]
}

/// The job: of each word of numbers the least, the greatest, and the greatest of those that are less than `limit`.
struct Bounds<'a> {
    numbers: &'a [f32],
    limit: f32,
}

impl Kernel for Bounds<'_> {
    type Output = Vec<[f32; 3]>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let (words, _) = self.numbers.as_chunks::<WORD>();
        let mut bounds = Vec::with_capacity(words.len());
        for word in words {
            bounds.push(bounds_of(word, self.limit));
        }
        bounds
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::simd::wide::Portable;

    /// What ends at a place, begins there, or does not at all, and holes.
    fn scanline() -> impl Strategy<Value = (bool, usize, Vec<(u8, u8, u8)>)> {
        let kinds = prop_oneof![prop::collection::vec(0u8..5, 0..100), prop::collection::vec(0u8..2, 0..100)];
        (any::<bool>(), 0usize..150, kinds, any::<u64>()).prop_map(|(nothing_elsewhere, first, kinds, seed)| {
            let only_ends = kinds.iter().all(|kind| *kind < 2);
            let numbers = (0..).map(|n: u64| (seed.wrapping_mul(2 * n + 1) >> 40) as u8);
            let pixels = kinds
                .into_iter()
                .zip(numbers)
                .map(|(kind, number)| (if only_ends { 2 * kind } else { kind }, number % 12, number / 12 % 12));
            (nothing_elsewhere, first, pixels.collect())
        })
    }

    const BEYOND: f32 = 12.0;

    proptest! {
        /// As a walk does it: rays that have ended are put away, and where no others are told apart, all of them are whole.
        #[test]
        fn a_walk_sees_what_is_seen_of_each_pixel(
            scanlines in prop::collection::vec(scanline(), 1..40),
            steps in prop::collection::vec((0.3f32..2.5, any::<bool>()), 1..12),
        ) {
            let limits = Limits::new(scanlines.len(), 0..scanlines.len(), SeenScanline::default(), |v| {
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
                // The same where none begins within and there are no holes.
                if !nothing_elsewhere && pixels.iter().all(|(kind, ..)| [0, 2].contains(kind)) {
                    let ending = SeenScanline::ending(BEYOND, *first..first + pixels.len(), |to| {
                        for (to, (kind, _, ends)) in to.iter_mut().zip(pixels) {
                            *to = if *kind == 0 { BEYOND } else { (*ends).into() };
                        }
                    });
                    return ending;
                }
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
                        (0..4).for_each(|word| open[word] &= !limits.seen::<Portable>(v, word, between).ended);
                    }
                    known[v] = Some(between[0]);
                    let apart = limits.tells_apart(v, between);
                    for u in 0..4 * WORD {
                        let Seen { some, whole, .. } = limits.seen::<Portable>(v, u / WORD, between);
                        let [some, whole] = if apart { [some, whole] } else { [u64::MAX; 2] };
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
