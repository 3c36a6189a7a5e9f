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
    /// The least and the greatest end of every eight.
    least_to: [f32; WORD / EIGHT],
    greatest_to: [f32; WORD / EIGHT],
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
        let of_word = |u: usize| holes.partition_point(|hole| (hole.u as usize) < u);
        let word = |n: usize| {
            let first = (told.start + n) * WORD;
            let theirs = of_word(first)..of_word(first + WORD);
            let within = holes[theirs.clone()].iter().fold(Stretch::NOTHING, |all, Hole { stretch, .. }| Stretch {
                from: all.from.min(stretch.from),
                to: all.to.max(stretch.to),
            });
            let [least_from, greatest_from] = from.get(n * WORD..(n + 1) * WORD).map_or([elsewhere.from; 2], bounds);
            let (mut least, mut greatest) = ([0.0; WORD / EIGHT], [0.0; WORD / EIGHT]);
            for (at, eight) in to[n * WORD..][..WORD].chunks_exact(EIGHT).enumerate() {
                [least[at], greatest[at]] = bounds(eight);
            }
            let ([least_to, _], [_, greatest_to]) = (bounds(&least), bounds(&greatest));
            let bounds = [Stretch { from: least_from, to: least_to }, Stretch { from: greatest_from, to: greatest_to }];
            Word { bounds, least_to: least, greatest_to: greatest, holes: theirs, within }
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
            let beyond = if elsewhere.is_nothing() { f32::INFINITY } else { elsewhere.to };
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
                    ends = Stretch {
                        from: ends.from.min(least.to),
                        to: ends.to.max(greatest_below(&to[of_word], beyond)),
                    };
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
    /// [ended](Seen::ended) by then.
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
    pub fn seen(&self, v: usize, word: usize, between: [f32; 2]) -> Seen {
        let scanline = &self.scanlines[v];
        let at = word.wrapping_sub(scanline.first_word);
        let every = |is: bool| if is { u64::MAX } else { 0 };
        let Some(Word { bounds: [least, greatest], least_to, greatest_to, holes, within }) = scanline.words.get(at)
        else {
            let elsewhere = scanline.elsewhere;
            let ended = every(elsewhere.to <= between[0]);
            return Seen { ended, some: every(elsewhere.meets(between)), whole: every(elsewhere.holds(between)) };
        };
        let [first, last] = between;
        if greatest.to <= first {
            return Seen { ended: u64::MAX, some: 0, whole: 0 };
        }
        // `Stretch::meets` and `Stretch::holds`, where the bounds of eight neighbours do not tell.
        let (mut ended, mut whole) = (0, u64::MAX);
        if least.to < last {
            let any_end = below(least_to, last);
            let all_ended = EIGHTS & !above(greatest_to, first);
            (ended, whole) = (spread(all_ended), !spread(any_end));
            let mut mixed = any_end & !all_ended;
            while mixed != 0 {
                let n = mixed.trailing_zeros() as usize;
                mixed &= mixed - 1;
                let to = &scanline.to[at * WORD + n * EIGHT..][..EIGHT];
                ended |= (EIGHTS & !above(to, first)) << (n * EIGHT);
                whole |= (EIGHTS & !below(to, last)) << (n * EIGHT);
            }
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

/// Neighbours whose ends are bounded together, and a bit for each.
const EIGHT: usize = 8;
const EIGHTS: u64 = 0xff;

/// Which of eight numbers are below another.
#[inline(always)]
fn below(eight: &[f32], number: f32) -> u64 {
    let [a, b] = [0, 4].map(|n| Vec4::from_slice(&eight[n..n + 4]).cmplt(Vec4::splat(number)).bitmask());
    u64::from(a | b << 4)
}

/// Which of eight numbers are above another.
#[inline(always)]
fn above(eight: &[f32], number: f32) -> u64 {
    let [a, b] = [0, 4].map(|n| Vec4::from_slice(&eight[n..n + 4]).cmpgt(Vec4::splat(number)).bitmask());
    u64::from(a | b << 4)
}

/// All bits of a byte for each of eight.
#[inline(always)]
fn spread(bits: u64) -> u64 {
    // Bit n of each byte n, then of those that are not zero the lowest one.
    let apart = bits.wrapping_mul(0x0101_0101_0101_0101) & 0x8040_2010_0804_0201;
    let set = ((apart + 0x7f7f_7f7f_7f7f_7f7f) | apart) >> 7 & 0x0101_0101_0101_0101;
    set * 0xff
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

/// The least and the greatest of some numbers.
#[inline(always)]
pub(super) fn bounds(numbers: &[f32]) -> [f32; 2] {
    // Side by side, as registers have room.
    const LANES: usize = 8;
    let (mut least, mut greatest) = ([numbers[0]; LANES], [numbers[0]; LANES]);
    let mut add = |lane: usize, number: f32| {
        least[lane] = if number < least[lane] { number } else { least[lane] };
        greatest[lane] = if number > greatest[lane] { number } else { greatest[lane] };
    };
    let (chunks, rest) = numbers.as_chunks::<LANES>();
    for chunk in chunks {
        (0..LANES).for_each(|lane| add(lane, chunk[lane]));
    }
    rest.iter().for_each(|&number| add(0, number));
    [least.into_iter().fold(numbers[0], f32::min), greatest.into_iter().fold(numbers[0], f32::max)]
}

/// The greatest of some numbers that are less than `bound`.
fn greatest_below(numbers: &[f32], bound: f32) -> f32 {
    const LANES: usize = 8;
    let mut greatest = [f32::NEG_INFINITY; LANES];
    let (chunks, rest) = numbers.as_chunks::<LANES>();
    debug_assert!(rest.is_empty(), "words are whole");
    for chunk in chunks {
        for (greatest, &number) in greatest.iter_mut().zip(chunk) {
            *greatest = if (number > *greatest) & (number < bound) { number } else { *greatest };
        }
    }
    greatest.into_iter().fold(f32::NEG_INFINITY, f32::max)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

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

    #[test]
    fn bits_become_bytes() {
        for bits in 0..=EIGHTS {
            let bytes = (0..8).filter(|n| bits >> n & 1 == 1).fold(0, |all, n| all | 0xff << (8 * n));
            assert_eq!(spread(bits), bytes, "{bits:b}");
        }
    }

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
                        (0..4).for_each(|word| open[word] &= !limits.seen(v, word, between).ended);
                    }
                    known[v] = Some(between[0]);
                    let apart = limits.tells_apart(v, between);
                    for u in 0..4 * WORD {
                        let Seen { some, whole, .. } = limits.seen(v, u / WORD, between);
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
