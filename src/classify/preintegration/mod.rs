//! Pre-integration: a slab's colour and opacity by its front and back scalar.
//!
//! Between two slices the scalar is taken as linear, so that what a ray picks up in a slab depends on
//! the two scalars and the slab's length alone (Schulze et al. 2003):
//!
//! ```text
//! alpha(f, b) = 1 - exp(-d * int_0^1 tau(s(w)) dw)                       s(w) = (1 - w) f + w b
//! color(f, b) = int_0^1 tau(s(w)) c(s(w)) exp(-d * int_0^w tau) d dw     premultiplied
//! ```
//!
//! The transfer function is integrated where the table is made (`medium.rs`), however sharp its peaks
//! are, and not sampled where the slices happen to be. What does not depend on the length is integrated
//! once (`ranges.rs`), so that a table for another view's slabs takes a fraction of a millisecond; entries
//! lie where they matter (`axis.rs`). For 12 to 16 bits there is a table over one scalar, too
//! (`running.rs`): made faster still, and less exact.

mod axis;
mod fixed;
mod kept;
mod medium;
mod ranges;
mod running;
mod shorts;
mod table;
#[cfg(test)]
mod tests;

use std::sync::{Arc, OnceLock};

use glam::Vec4;

use super::transfer::TransferFunction;
use crate::simd::wide::{LANES, Lanes, Wide, rows};
use crate::volume::Volume;
pub use axis::SlabAxis;
use kept::Kept;
use medium::Medium;
use ranges::Ranges;
use running::Scale;
pub use running::{OneDimensional, RunningSums};
pub use shorts::{ShortAxis, ShortSlabTable};
pub use table::{Bilinear, Nearest, SlabTable};

/// What all slab tables of a volume under a transfer function share, and the newest of those tables.
#[derive(Debug)]
pub struct SlabTables {
    medium: Medium,
    axis: Arc<SlabAxis>,
    /// First and last.
    codes: (u16, u16),
    /// Made when it is first asked for; `None` inside where there are too many codes or entries for it.
    short_axis: OnceLock<Option<Arc<ShortAxis>>>,
    scale: Scale,
    /// Codes at which a slab may show something, one flag for each.
    visible: Vec<bool>,
    ranges: Ranges,
    tables: Kept<(Form, u32), SlabTable, KEPT>,
    short_tables: Kept<u32, ShortSlabTable, SHORT_KEPT>,
    /// What rounding changes at worst, by length and number of slabs.
    short_errors: Kept<(u32, usize), f32, SHORT_KEPT>,
    sums: Kept<(Form, u32), RunningSums, KEPT>,
}

/// A way to read slabs.
pub trait Slabs: Copy + Send + Sync {
    /// Position of a (fractional) code on the axis of the table.
    fn coordinate(self, code: f32) -> f32;

    /// The slab between two positions.
    fn slab(self, front: f32, back: f32) -> Vec4;

    /// Positions of eight codes.
    #[inline(always)]
    fn coordinates<W: Wide>(self, codes: &Lanes) -> Lanes {
        let mut positions = *codes;
        for position in &mut positions {
            *position = self.coordinate(*position);
        }
        positions
    }

    /// Eight slabs, by component.
    #[inline(always)]
    fn slabs<W: Wide>(self, front: &Lanes, back: &Lanes) -> [Lanes; 4] {
        let mut slabs = [Vec4::ZERO; LANES];
        for lane in 0..LANES {
            slabs[lane] = self.slab(front[lane], back[lane]);
        }
        rows(&slabs)
    }
}

/// What a table's entries hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Form {
    /// Premultiplied colour and opacity.
    Opacity,
    /// Colour times optical depth, and optical depth: for slabs whose length or density is scaled
    /// sample by sample.
    OpticalDepth,
}

impl Form {
    /// A slab of premultiplied colour and opacity in this form, given its optical depth.
    #[inline(always)]
    fn slab(self, slab: Vec4, depth: f32) -> Vec4 {
        match self {
            Self::Opacity => slab,
            Self::OpticalDepth if slab.w > 0.0 => (slab * (depth / slab.w)).with_w(depth),
            Self::OpticalDepth => Vec4::ZERO,
        }
    }
}

/// Tables of floats that are kept, and as many running sums.
const KEPT: usize = 4;

/// Tables of 16-bit fractions that are kept: half a megabyte each.
const SHORT_KEPT: usize = 32;

/// By how much rounding slabs to 16 bits may change a ray's opacity, at worst.
const GREATEST_ERROR: f32 = 1.0 / 128.0;

/// Rounding of a sampled scalar: what is resampled from voxels of code `c` alone is within `c * ROUNDING`.
const ROUNDING: f32 = 1e-5;

impl SlabTables {
    /// Entries along an axis at most.
    pub const MAX_ENTRIES: usize = 4096;

    /// For `transfer` on `volume`, with at most so many `entries` along an axis (2 to
    /// [`Self::MAX_ENTRIES`]); no more than the volume has codes.
    pub fn new(volume: &Volume, transfer: &TransferFunction, entries: usize) -> Self {
        let medium = Medium::new(volume, transfer);
        let codes @ (_, last) = volume.code_range();
        let axis = SlabAxis::new(&medium, codes, entries.clamp(2, Self::MAX_ENTRIES), volume.smallest_spacing());
        let ranges = Ranges::new(&medium, axis.codes());
        let scale = Scale::new(codes);
        let reach = |code: u16| {
            let (code, rounding) = (f32::from(code), f32::from(code) * ROUNDING);
            let (two, one) = (axis.reach(ranges.codes(), code, rounding), scale.reach(code, rounding));
            (two.0.min(one.0), two.1.max(one.1))
        };
        let visible = visible_codes(&medium, last, reach);
        Self {
            visible,
            axis: Arc::new(axis),
            codes,
            short_axis: OnceLock::new(),
            medium,
            scale,
            ranges,
            tables: Kept::new(),
            short_tables: Kept::new(),
            short_errors: Kept::new(),
            sums: Kept::new(),
        }
    }

    /// A flag for each code, 0 up to the volume's largest: true where a slab that reaches the code may
    /// show something, as tables of either kind are read, neighbouring entries included. A slab
    /// between whose two scalars no flag is set is exactly zero.
    pub fn visible_codes(&self) -> &[bool] {
        &self.visible
    }

    /// The table for slabs of `length` mm (above 0), made if it is not there yet. It is for the length that
    /// [`SlabTable::length`] tells: `length` to ten binary digits.
    pub fn table(&self, form: Form, length: f32) -> Arc<SlabTable> {
        let length = rounded(length);
        let make = || SlabTable::new(&self.ranges, Arc::clone(&self.axis), form, length);
        self.tables.get((form, length.to_bits()), make)
    }

    /// The table for slabs of `length` mm in 16-bit fractions, made if it is not there yet. `None` where these will not do: where there are more than
    /// fifteen bits of codes or more entries than 256, or where rounding may change the opacity of a ray through `count` slabs by more than
    /// 1/128.
    pub fn short_table(&self, length: f32, count: usize) -> Option<Arc<ShortSlabTable>> {
        let length = rounded(length);
        let axis = || ShortAxis::new(&self.axis, self.codes).map(Arc::new);
        let axis = self.short_axis.get_or_init(axis).as_ref()?;
        let error = || shorts::error(&self.ranges, length, count);
        if *self.short_errors.get((length.to_bits(), count), error) > GREATEST_ERROR {
            return None;
        }
        let make = || ShortSlabTable::new(&self.ranges, Arc::clone(axis), length);
        Some(self.short_tables.get(length.to_bits(), make))
    }

    /// The running sums for slabs of `length` mm (above 0), made if they are not there yet; rounded as
    /// tables are.
    pub fn running_sums(&self, form: Form, length: f32) -> Arc<RunningSums> {
        let length = rounded(length);
        let make = || RunningSums::new(&self.medium, self.scale, form, length);
        self.sums.get((form, length.to_bits()), make)
    }

    /// Bytes in memory, once as many tables were made as are kept.
    pub fn bytes(&self) -> u64 {
        let shared = self.medium.bytes() + self.axis.bytes() + self.ranges.bytes() + self.visible.len() as u64;
        let tables = SlabTable::bytes(self.axis.entries()) + RunningSums::bytes(self.scale);
        shared + ShortAxis::bytes() + KEPT as u64 * tables + SHORT_KEPT as u64 * ShortSlabTable::bytes()
    }
}

/// The length that a table is made for: to [`LENGTH_BITS`] binary digits, so that views that differ by
/// little share a table, and lengths such as 1 or 0.75 are kept exactly.
///
/// A length that is wrong by a share `e` of itself makes all optical depths wrong by `e`, so that of a
/// ray of depth `u` the opacity errs by `u exp(-u) e`, which is never above `e / e^1`: with `e` = 2^-10
/// a tenth of what 8 bits tell apart, however many slabs there are.
fn rounded(length: f32) -> f32 {
    let dropped = f32::MANTISSA_DIGITS - LENGTH_BITS;
    f32::from_bits((length.to_bits() + (1 << (dropped - 1))) >> dropped << dropped)
}

/// Binary digits of a table's length.
const LENGTH_BITS: u32 = 10;

/// Flags for codes from 0 to `last`: whether anything shows between the two codes that each of them
/// reaches, which must rise with the code.
fn visible_codes(medium: &Medium, last: u16, reach: impl Fn(u16) -> (f64, f64)) -> Vec<bool> {
    let mut flags = vec![false; usize::from(last) + 1];
    let codes: Vec<u16> = (0..=last).collect();
    for (from, to, closed) in medium.visible() {
        let first = codes.partition_point(|&code| {
            let (_, high) = reach(code);
            if closed { high < from } else { high <= from }
        });
        let end = codes.partition_point(|&code| reach(code).0 < to);
        flags[first..end.max(first)].fill(true);
    }
    flags
}
