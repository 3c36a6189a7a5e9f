//! A table of slabs by front and back scalar, and how it is made in a millisecond.
//!
//! All slabs of a diagonal, `n` entries from front to back, stretch the scalar axis over their length
//! in the same way: an interval between two entries has the same colour and opacity in each of
//! them. They are computed once for the diagonal, and a slab is `n` of them composited, for which no
//! more than three "over" are needed whatever `n` is: cut the intervals into blocks of `n`; a window of
//! `n` is the end of one block and the beginning of the next, and ends and beginnings of blocks
//! follow one from another (van Herk 1992, for maxima). Nothing is ever taken out again, so nothing
//! cancels, and transparent stays zero. That is 3 N^2 "over" and N exponentials for each of N diagonals,
//! in place of the N^3 of integrating each slab for itself.
//!
//! Front to back and back to front share what a diagonal computes. Diagonals are independent; the
//! table is written by rows afterwards.

use std::cmp::Ordering;

use glam::Vec4;
use rayon::prelude::*;

use super::medium::Stretch;
use super::{Form, SlabAxis};

/// A table of slabs of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabTable {
    axis: SlabAxis,
    /// By `front * stride + back`; a row and a column more than there are entries, so that what
    /// lies on the last entry can be read as if it lay before another.
    slabs: Vec<Vec4>,
    stride: usize,
}

/// Added to a position, rounds it to 2^-10 and leaves it as an integer in the lowest bits: between
/// 2^13 and 2^14 neighbouring floats are 2^-10 apart.
const FIXED: f32 = 12288.0;
const FRACTION_BITS: u32 = 10;

/// A position's entry and fraction.
#[inline(always)]
fn split(position: f32) -> (usize, f32) {
    let fixed = (position + FIXED).to_bits().wrapping_sub(FIXED.to_bits());
    let fraction = fixed & ((1 << FRACTION_BITS) - 1);
    ((fixed >> FRACTION_BITS) as usize, fraction as i32 as f32 * (1.0 / (1 << FRACTION_BITS) as f32))
}

/// The last entry at or before a position, as [`split`] rounds it.
pub(super) fn entry_before(position: f32) -> usize {
    split(position).0
}

/// The first entry at or after a position, as [`split`] rounds it.
pub(super) fn entry_after(position: f32) -> usize {
    let (entry, fraction) = split(position);
    entry + usize::from(fraction > 0.0)
}

impl SlabTable {
    /// Integrates the slabs of `length` mm.
    pub(super) fn new(intervals: &Intervals, axis: SlabAxis, form: Form, length: f32) -> Self {
        let entries = axis.entries();
        let diagonals: Vec<_> = (1..entries)
            .into_par_iter()
            .map_init(Default::default, |scratch, n| intervals.diagonal(n, form, length, scratch))
            .collect();
        let stride = entries + 1;
        let mut slabs = vec![Vec4::ZERO; stride * (entries + 1)];
        slabs[..stride * entries].par_chunks_mut(stride).enumerate().for_each(|(front, row)| {
            for (back, slab) in row[..entries].iter_mut().enumerate() {
                *slab = match back.cmp(&front) {
                    Ordering::Greater => diagonals[back - front - 1][front][0],
                    Ordering::Less => diagonals[front - back - 1][back][1],
                    Ordering::Equal => intervals.constant(front, form, length),
                };
            }
        });
        Self { axis, slabs, stride }
    }

    /// Scalar codes -> positions on the table's axis.
    #[inline(always)]
    pub fn axis(&self) -> SlabAxis {
        self.axis
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        size_of_val(&self.slabs[..]) as u64
    }

    /// The entry nearest to two positions on the axis.
    #[inline(always)]
    pub fn nearest(&self, front: f32, back: f32) -> Vec4 {
        let ((front, near), (back, far)) = (split(front), split(back));
        self.slabs[(front + usize::from(near >= 0.5)) * self.stride + back + usize::from(far >= 0.5)]
    }

    /// Interpolated between the four entries around two positions on the axis.
    #[inline(always)]
    pub fn bilinear(&self, front: f32, back: f32) -> Vec4 {
        let ((front, wf), (back, wb)) = (split(front), split(back));
        let four = &self.slabs[front * self.stride + back..][..self.stride + 2];
        let near = four[0] + (four[1] - four[0]) * wb;
        let far = four[self.stride] + (four[self.stride + 1] - four[self.stride]) * wb;
        near + (far - near) * wf
    }
}

/// The medium between a table's entries.
#[derive(Clone, Debug)]
pub(super) struct Intervals {
    /// Where each interval's stretches begin, and where the last one's end.
    starts: Vec<u32>,
    /// Optical depth of stretches, per mm of a slab that is one entry deep.
    depths: Vec<f32>,
    /// Colours of stretches, at the lower and the upper end.
    colors: Vec<[Vec4; 2]>,
    /// Depths summed up to each entry.
    running: Vec<f64>,
    /// Extinction per mm and colour at each entry.
    media: Vec<Vec4>,
}

impl Intervals {
    /// `stretches` between entries: as many as `counts` tells for each interval; and the `media` at the
    /// entries: colour, and extinction per mm. A slab one entry deep passes `codes_per_entry`.
    pub fn new(counts: &[usize], stretches: &[Stretch], media: Vec<Vec4>, codes_per_entry: f64) -> Self {
        let mut starts = vec![0];
        let mut running = vec![0.0];
        for count in counts {
            let start = starts[starts.len() - 1];
            let end = start + *count as u32;
            let depth: f64 = stretches[start as usize..end as usize].iter().map(|stretch| stretch.depth).sum();
            running.push(running[running.len() - 1] + depth / codes_per_entry);
            starts.push(end);
        }
        Self {
            starts,
            depths: stretches.iter().map(|stretch| (stretch.depth / codes_per_entry) as f32).collect(),
            colors: stretches.iter().map(|s| s.colors.map(|color| color.as_vec3().extend(1.0))).collect(),
            running,
            media,
        }
    }

    /// True where something shows between two entries, both included.
    pub fn shows(&self, first: usize, last: usize) -> bool {
        self.media[first..=last].iter().any(|medium| medium.w > 0.0)
            || self.depths[self.starts[first] as usize..self.starts[last] as usize].iter().any(|&depth| depth > 0.0)
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        let Self { starts, depths, colors, running, media } = self;
        (size_of_val(&starts[..]) + size_of_val(&depths[..]) + size_of_val(&colors[..])) as u64
            + (size_of_val(&running[..]) + size_of_val(&media[..])) as u64
    }

    /// The slab of the one scalar at `entry`.
    fn constant(&self, entry: usize, form: Form, length: f32) -> Vec4 {
        let medium = self.media[entry];
        let depth = medium.w * length;
        let opacity = light(depth)[0];
        form.slab((medium * opacity).with_w(opacity), depth)
    }

    /// The slabs `n` entries deep: from entry `f` to `f + n`, and from `f + n` to `f`, for all `f`.
    fn diagonal(&self, n: usize, form: Form, length: f32, intervals: &mut [Vec<Vec4>; 2]) -> Vec<[Vec4; 2]> {
        let scale = length / n as f32;
        self.composite_intervals(scale, intervals);
        let [up, down] = &*intervals;
        let mut slabs = vec![[Vec4::ZERO; 2]; self.media.len() - n];
        for (block, slabs) in slabs.chunks_mut(n).enumerate() {
            let block = block * n;
            // From each entry to the block's end, and back.
            let (mut to_end, mut from_end) = (Vec4::ZERO, Vec4::ZERO);
            for at in (0..n).rev() {
                to_end = over(up[block + at], to_end);
                from_end = over(from_end, down[block + at]);
                if let Some(slab) = slabs.get_mut(at) {
                    *slab = [to_end, from_end];
                }
            }
            // From the block's end on, and back to it.
            let (mut beyond, mut back) = (Vec4::ZERO, Vec4::ZERO);
            for (at, slab) in slabs.iter_mut().enumerate() {
                *slab = [over(slab[0], beyond), over(back, slab[1])];
                if let (Some(up), Some(down)) = (up.get(block + at + n), down.get(block + at + n)) {
                    beyond = over(beyond, *up);
                    back = over(*down, back);
                }
            }
        }
        if form == Form::OpticalDepth {
            for (at, slab) in slabs.iter_mut().enumerate() {
                let depth = (self.running[at + n] - self.running[at]) as f32 * scale;
                *slab = slab.map(|slab| form.slab(slab, depth));
            }
        }
        slabs
    }

    /// Colour and opacity of each interval, upwards and downwards, in slabs of `scale` mm an entry.
    fn composite_intervals(&self, scale: f32, [up, down]: &mut [Vec<Vec4>; 2]) {
        up.clear();
        down.clear();
        for ends in self.starts.windows(2) {
            let (mut rising, mut falling) = (Vec4::ZERO, Vec4::ZERO);
            let stretches = ends[0] as usize..ends[1] as usize;
            for (depth, [low, high]) in self.depths[stretches.clone()].iter().zip(&self.colors[stretches]) {
                let [opacity, behind] = light(depth * scale);
                let ahead = opacity - behind;
                rising = over(rising, (*low * ahead + *high * behind).with_w(opacity));
                falling = over((*high * ahead + *low * behind).with_w(opacity), falling);
            }
            up.push(rising);
            down.push(falling);
        }
    }
}

/// A slab behind another.
#[inline(always)]
fn over(front: Vec4, back: Vec4) -> Vec4 {
    front + back * (1.0 - front.w)
}

/// What a stretch of optical depth `u` absorbs, and how much of its light is of its farther end's
/// colour: `int_0^1 u exp(-u w) dw` and `int_0^1 w u exp(-u w) dw`.
///
/// Their series for u / 64, then six doublings: of two halves the farther one's light is dimmed by the
/// nearer one. All terms are positive, so that small depths lose no digits.
#[inline(always)]
fn light(depth: f32) -> [f32; 2] {
    const DOUBLINGS: i32 = 6;
    // Nothing in an f32 tells a depth of 32 from more.
    let x = depth.min(32.0) * (1.0 / (1 << DOUBLINGS) as f32);
    let mut opacity = x * (1.0 - x * (1.0 / 2.0 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0)))));
    let mut behind = x * (1.0 / 2.0 - x * (1.0 / 3.0 - x * (1.0 / 8.0 - x * (1.0 / 30.0 - x * (1.0 / 144.0)))));
    for _ in 0..DOUBLINGS {
        behind = 0.5 * (behind * (2.0 - opacity) + opacity * (1.0 - opacity));
        opacity *= 2.0 - opacity;
    }
    [opacity, behind]
}
