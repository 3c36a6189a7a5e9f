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
//! The transfer function is integrated where the table is made ([`medium`]), however sharp its peaks
//! are, and not sampled where the slices happen to be.

mod medium;
mod table;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use glam::Vec4;

use super::transfer::TransferFunction;
use crate::volume::Volume;
use medium::Medium;
use table::Intervals;
pub use table::SlabTable;

/// What all slab tables of a volume under a transfer function share, and the tables made so far.
#[derive(Debug)]
pub struct SlabTables {
    axis: SlabAxis,
    /// Codes at which a slab may show something, one flag for each.
    visible: Vec<bool>,
    intervals: Intervals,
    made: Mutex<HashMap<(Form, u32), Arc<SlabTable>>>,
}

/// Scalar codes -> positions on a table's axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlabAxis {
    first_code: f32,
    entries_per_code: f32,
    entries: usize,
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

/// Rounding of a sampled scalar and of its position, as a share of the scalar: what is resampled from
/// voxels of code `c` alone is within `c * ROUNDING` of it.
const ROUNDING: f32 = 1e-5;

impl SlabAxis {
    /// Position of a (fractional) code on the axis, 0..=entries - 1.
    #[inline(always)]
    pub fn coordinate(&self, code: f32) -> f32 {
        (code - self.first_code) * self.entries_per_code
    }

    /// Entries along the axis.
    pub fn entries(&self) -> usize {
        self.entries
    }

    fn code(&self, entry: usize) -> f64 {
        f64::from(self.first_code) + entry as f64 / f64::from(self.entries_per_code)
    }
}

impl SlabTables {
    /// For `transfer` on `volume`, with at most so many `entries` along an axis (2 or more).
    pub fn new(volume: &Volume, transfer: &TransferFunction, entries: usize) -> Self {
        let (low, high) = volume.code_range();
        let codes = usize::from(high - low) + 1;
        let entries = entries.min(codes).max(2);
        let span = f32::from(high - low).max(1.0);
        let axis = SlabAxis { first_code: f32::from(low), entries_per_code: (entries - 1) as f32 / span, entries };

        let medium = Medium::new(volume, transfer);
        let mut stretches = Vec::new();
        let counts: Vec<usize> = (1..entries)
            .map(|entry| {
                let before = stretches.len();
                medium.stretches(axis.code(entry - 1), axis.code(entry), &mut stretches);
                stretches.len() - before
            })
            .collect();
        let media = (0..entries).map(|entry| {
            let (extinction, color) = medium.at(axis.code(entry));
            color.as_vec3().extend(extinction as f32)
        });
        let codes_per_entry = 1.0 / f64::from(axis.entries_per_code);
        let intervals = Intervals::new(&counts, &stretches, media.collect(), codes_per_entry);
        let visible = (0..=high)
            .map(|code| {
                let code = f32::from(code);
                let within = |share: f32| axis.coordinate(code * share).clamp(0.0, (entries - 1) as f32);
                let (below, above) = (within(1.0 - ROUNDING), within(1.0 + ROUNDING));
                intervals.shows(table::entry_before(below), table::entry_after(above))
            })
            .collect();
        Self { axis, visible, intervals, made: Mutex::default() }
    }

    /// A flag for each code, 0 up to the volume's largest: true where a slab that reaches the code may
    /// show something, as its table is read, neighbouring entries included. A slab between whose
    /// two scalars no flag is set is exactly zero.
    pub fn visible_codes(&self) -> &[bool] {
        &self.visible
    }

    /// The table for slabs of `length` mm, made if it is not there yet.
    pub fn table(&self, form: Form, length: f32) -> Arc<SlabTable> {
        let key = (form, length.to_bits());
        if let Some(made) = self.made.lock().expect("no panic while it is held").get(&key) {
            return Arc::clone(made);
        }
        let table = Arc::new(SlabTable::new(&self.intervals, self.axis, form, length));
        self.made.lock().expect("no panic while it is held").insert(key, Arc::clone(&table));
        table
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        let made = self.made.lock().expect("no panic while it is held");
        let tables: u64 = made.values().map(|table| table.bytes()).sum();
        tables + self.visible.len() as u64 + self.intervals.bytes()
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
