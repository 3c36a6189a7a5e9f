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
//! The transfer function is integrated where the table is made (`medium`), however sharp its peaks
//! are, and not sampled where the slices happen to be.

mod axis;
mod medium;
mod ranges;
mod table;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

use glam::Vec4;

use super::transfer::TransferFunction;
use crate::volume::Volume;
pub use axis::SlabAxis;
use medium::Medium;
use ranges::Ranges;
pub use table::SlabTable;

/// What all slab tables of a volume under a transfer function share, and the newest of those tables.
#[derive(Debug)]
pub struct SlabTables {
    axis: Arc<SlabAxis>,
    /// Codes at which a slab may show something, one flag for each.
    visible: Vec<bool>,
    ranges: Ranges,
    kept: Mutex<Kept>,
}

/// Tables by form and the bits of their length, the oldest first.
type Kept = VecDeque<((Form, u32), Arc<SlabTable>)>;

/// Tables kept for another frame of the same view, or of one whose slabs are as long. A client that
/// turns a volume asks for another length with every frame, and comes back to few.
const KEPT: usize = 4;

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

/// Rounding of a sampled scalar: what is resampled from voxels of code `c` alone is within `c * ROUNDING`.
const ROUNDING: f32 = 1e-5;

/// Rounding of a position on the axis, below what [`table`] rounds positions to.
const POSITION_ROUNDING: f32 = 1.0 / 4096.0;

impl SlabTables {
    /// Entries along an axis at most.
    pub const MAX_ENTRIES: usize = 4096;

    /// For `transfer` on `volume`, with at most so many `entries` along an axis (2 to
    /// [`Self::MAX_ENTRIES`]); no more than the volume has codes.
    pub fn new(volume: &Volume, transfer: &TransferFunction, entries: usize) -> Self {
        let medium = Medium::new(volume, transfer);
        let codes @ (_, high) = volume.code_range();
        let axis = SlabAxis::new(&medium, codes, entries.clamp(2, Self::MAX_ENTRIES), volume.smallest_spacing());
        let ranges = Ranges::new(&medium, axis.codes());
        let last = (axis.entries() - 1) as f32;
        let visible = (0..=high)
            .map(|code| {
                let position = |share: f32| axis.coordinate(f32::from(code) * share);
                let first = table::entry_before((position(1.0 - ROUNDING) - POSITION_ROUNDING).max(0.0));
                let end = table::entry_after((position(1.0 + ROUNDING) + POSITION_ROUNDING).clamp(0.0, last));
                ranges.shows(first, end)
            })
            .collect();
        Self { axis: Arc::new(axis), visible, ranges, kept: Mutex::default() }
    }

    /// A flag for each code, 0 up to the volume's largest: true where a slab that reaches the code may
    /// show something, as its table is read, neighbouring entries included. A slab between whose
    /// two scalars no flag is set is exactly zero.
    pub fn visible_codes(&self) -> &[bool] {
        &self.visible
    }

    /// The table for slabs of `length` mm, made if it is not there yet.
    pub fn table(&self, form: Form, length: f32) -> Arc<SlabTable> {
        let wanted = (form, length.to_bits());
        if let Some((_, table)) = self.kept().iter().find(|(kept, _)| *kept == wanted) {
            return Arc::clone(table);
        }
        let table = Arc::new(SlabTable::new(&self.ranges, Arc::clone(&self.axis), form, length));
        let mut kept = self.kept();
        kept.push_back((wanted, Arc::clone(&table)));
        if kept.len() > KEPT {
            kept.pop_front();
        }
        table
    }

    /// Bytes in memory, once as many tables were made as are kept.
    pub fn bytes(&self) -> u64 {
        let tables = KEPT as u64 * SlabTable::bytes(self.axis.entries());
        tables + self.visible.len() as u64 + self.ranges.bytes() + self.axis.bytes()
    }

    /// Held for look-ups alone, never while a table is made.
    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().expect("no panic while it is held")
    }
}

/// A way to read slabs.
pub trait Slabs: Copy + Send + Sync {
    /// Position of a (fractional) code on the axis of the table.
    fn coordinate(self, code: f32) -> f32;

    /// The slab between two positions.
    fn slab(self, front: f32, back: f32) -> Vec4;
}

/// The nearest entry.
#[derive(Clone, Copy, Debug)]
pub struct Nearest<'a>(pub &'a SlabTable);

impl Slabs for Nearest<'_> {
    #[inline(always)]
    fn coordinate(self, code: f32) -> f32 {
        self.0.axis().coordinate(code)
    }

    #[inline(always)]
    fn slab(self, front: f32, back: f32) -> Vec4 {
        self.0.nearest(front, back)
    }
}

/// Between four entries.
#[derive(Clone, Copy, Debug)]
pub struct Bilinear<'a>(pub &'a SlabTable);

impl Slabs for Bilinear<'_> {
    #[inline(always)]
    fn coordinate(self, code: f32) -> f32 {
        self.0.axis().coordinate(code)
    }

    #[inline(always)]
    fn slab(self, front: f32, back: f32) -> Vec4 {
        self.0.bilinear(front, back)
    }
}
