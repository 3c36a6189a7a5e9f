//! Slabs of 16-bit fractions, to be looked up four at once ([`simd::shorts`](crate::simd::shorts)).
//!
//! An entry takes eight bytes in place of sixteen, and two neighbours are one load. Scalars are fractions, too, of at
//! most fifteen bits, and so are positions on the table's axis: eight bits of entry and seven behind the point. Where an entry is not a code, a table has the
//! position of any scalar there can be.
//!
//! Sixteen bits are too coarse for media of which a slab shows next to nothing: [`error`] tells by how much.

use std::sync::Arc;

use glam::Vec4;
use rayon::prelude::*;

use super::ranges::{EightSlabs, Ranges};
use super::{Form, SlabAxis};
use crate::simd::shorts::{POSITION_BITS, Positions, SLAB_ENTRIES, Scalars, Short, ShortSlabs, UNIT};
use crate::simd::wide::{LANES, Lanes};
use crate::simd::{self, Kernel};

/// Scalar codes -> scalars of fifteen bits -> positions on the axis of a table of at most 256 entries.
#[derive(Clone, Debug)]
pub struct ShortAxis {
    scalars: Scalars,
    /// Positions by scalar, where those are not the same.
    positions: Option<Box<Positions>>,
}

/// Fifteen bits.
const SCALARS: usize = 1 << 15;

impl ShortAxis {
    /// For codes from `first` to `last` on `axis`; `None` where there are more than fifteen bits of them, or too many entries.
    pub(super) fn new(axis: &SlabAxis, (first, last): (u16, u16)) -> Option<Self> {
        let codes = usize::from(last - first) + 1;
        if codes > SCALARS || axis.entries() >= SLAB_ENTRIES {
            return None;
        }
        if axis.are_codes() {
            return Some(Self { scalars: Scalars { first_code: first, shift: POSITION_BITS }, positions: None });
        }
        let shift = (SCALARS / codes).ilog2();
        let mut positions: Box<Positions> = vec![0; SCALARS].try_into().expect("as many as there are scalars");
        let a_code = f32::from(1u16 << shift);
        for (scalar, position) in positions.iter_mut().take(codes << shift).enumerate() {
            let code = (f32::from(first) + scalar as f32 / a_code).min(last.into());
            *position = (axis.coordinate(code) * (1 << POSITION_BITS) as f32).round() as i16;
        }
        Some(Self { scalars: Scalars { first_code: first, shift }, positions: Some(positions) })
    }

    /// Scalars by code of the volume's.
    #[inline(always)]
    pub fn scalars(&self) -> Scalars {
        self.scalars
    }

    /// Positions by scalar; `None` where those are the same.
    #[inline(always)]
    pub fn positions(&self) -> Option<&Positions> {
        self.positions.as_deref()
    }

    /// Bytes in memory at most.
    pub(super) const fn bytes() -> u64 {
        size_of::<Positions>() as u64
    }
}

/// A table of slabs of one length, premultiplied colour and opacity.
#[derive(Clone, Debug)]
pub struct ShortSlabTable {
    axis: Arc<ShortAxis>,
    slabs: Box<ShortSlabs>,
}

impl ShortSlabTable {
    /// Integrates the slabs of `length` mm.
    pub(super) fn new(ranges: &Ranges, axis: Arc<ShortAxis>, length: f32) -> Self {
        let entries = ranges.codes().len();
        let mut slabs = vec![Short::CLEAR; SLAB_ENTRIES * SLAB_ENTRIES];
        // From each entry to each later one and, for now beside the table, back.
        let rows = slabs.par_chunks_exact_mut(SLAB_ENTRIES).take(entries).enumerate();
        let back: Vec<Vec<Short>> = rows
            .map(|(from, row)| {
                row[from] = rounded(ranges.constant(from, length, Form::Opacity));
                let eights = ranges.slabs(from, length);
                let mut back = vec![Short::CLEAR; eights.len() * LANES];
                simd::dispatch(Round { eights: &eights, row: &mut row[from + 1..entries], back: &mut back });
                back
            })
            .collect();
        slabs.par_chunks_exact_mut(SLAB_ENTRIES).take(entries).enumerate().for_each(|(to, row)| {
            for (from, slab) in row[..to].iter_mut().enumerate() {
                *slab = back[from][to - from - 1];
            }
            row[entries] = row[entries - 1];
        });
        slabs.copy_within((entries - 1) * SLAB_ENTRIES..entries * SLAB_ENTRIES, entries * SLAB_ENTRIES);
        Self { axis, slabs: slabs.try_into().expect("a square of entries") }
    }

    /// Codes -> scalars -> positions.
    #[inline(always)]
    pub fn axis(&self) -> &ShortAxis {
        &self.axis
    }

    /// By two positions.
    #[inline(always)]
    pub fn slabs(&self) -> &ShortSlabs {
        &self.slabs
    }

    /// Bytes in memory of a table.
    pub(super) const fn bytes() -> u64 {
        size_of::<ShortSlabs>() as u64
    }
}

/// By how much the opacity of a ray may be off where slabs of `length` mm are rounded, if all of `count` slabs or the first of them are of one
/// scalar.
///
/// After `n` slabs of opacity `a`, each off by `e`, it is about `n e exp(-n a)`, most at `n = 1 / a`.
pub(super) fn error(ranges: &Ranges, length: f32, count: usize) -> f32 {
    let of_entry = |entry: usize| {
        let opacity = ranges.constant(entry, length, Form::Opacity).w;
        let error = (opacity - f32::from(fraction(opacity)) / f32::from(UNIT)).abs();
        let slabs = (count as f32).min(1.0 / opacity.max(f32::MIN_POSITIVE));
        error * slabs * (-opacity * slabs).exp()
    };
    (0..ranges.codes().len()).map(of_entry).fold(0.0, f32::max)
}

/// The nearest fraction to a number from 0 to 1. Adding 1.5 * 2^23 leaves it in the low mantissa bits.
#[inline(always)]
fn fraction(number: f32) -> i16 {
    (number * f32::from(UNIT) + 12_582_912.0).to_bits() as i16
}

fn rounded(slab: Vec4) -> Short {
    Short(slab.to_array().map(fraction))
}

/// Slabs to be rounded and dealt out.
struct Round<'a> {
    eights: &'a [EightSlabs],
    /// There may be fewer than in the eights.
    row: &'a mut [Short],
    back: &'a mut [Short],
}

impl Kernel for Round<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { eights, row, back } = self;
        for (n, (eight, back)) in eights.iter().zip(back.as_chunks_mut::<LANES>().0).enumerate() {
            *back = dealt(&eight.down);
            let up = dealt(&eight.up);
            let row = &mut row[n * LANES..];
            match row.first_chunk_mut::<LANES>() {
                Some(row) => *row = up,
                None => row.copy_from_slice(&up[..row.len()]),
            }
        }
    }
}

/// By component -> by lane, rounded.
#[inline(always)]
fn dealt(components: &[Lanes; 4]) -> [Short; LANES] {
    let mut fractions = [[0; LANES]; 4];
    for c in 0..4 {
        for n in 0..LANES {
            fractions[c][n] = fraction(components[c][n]);
        }
    }
    let mut slabs = [Short::CLEAR; LANES];
    for (n, Short(slab)) in slabs.iter_mut().enumerate() {
        for c in 0..4 {
            slab[c] = fractions[c][n];
        }
    }
    slabs
}
