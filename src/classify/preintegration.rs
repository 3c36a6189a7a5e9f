//! Pre-integration tables: a slab's colour and opacity by its front and back scalar.
//!
//! Between two slices the scalar is taken as linear, so that what a ray picks up in a slab depends on
//! the two scalars and the slab's length alone (Schulze et al. 2003):
//!
//! ```text
//! alpha(f, b) = 1 - exp(-d * int_0^1 tau(s(w)) dw)                       s(w) = (1 - w) f + w b
//! color(f, b) = int_0^1 tau(s(w)) c(s(w)) exp(-d * int_0^w tau) d dw     premultiplied
//! ```
//!
//! The transfer function is integrated where the table is made, however sharp its peaks are, and not
//! sampled where the slices happen to be.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use glam::Vec4;
use rayon::prelude::*;

use super::transfer::{TransferFunction, extinction};
use crate::volume::Volume;

/// What all slab tables of a volume under a transfer function share, and the tables made so far.
#[derive(Debug)]
pub struct SlabTables {
    axis: SlabAxis,
    /// Codes at which a slab may show something, one flag for each.
    visible: Vec<bool>,
    /// Optical depth per mm and its product with the colour, integrated over each entry's interval:
    /// `fine[e]` is over entries e..e + 1 in `SUBSTEPS` steps.
    fine: Vec<Vec4>,
    made: Mutex<HashMap<(Form, u32), Arc<SlabTable>>>,
}

/// Steps of the transfer function between two entries of a table.
const SUBSTEPS: usize = 4;

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

/// A table of slabs of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabTable {
    axis: SlabAxis,
    /// By `front * entries + back`.
    slabs: Vec<Vec4>,
}

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

    fn code(&self, entry: f64) -> f64 {
        f64::from(self.first_code) + entry / f64::from(self.entries_per_code)
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
        let reference = transfer.reference_length(volume.smallest_spacing());
        let fine: Vec<Vec4> = (0..(entries - 1) * SUBSTEPS)
            .map(|step| {
                let value = volume.value_of_code(axis.code((step as f64 + 0.5) / SUBSTEPS as f64));
                let tau = extinction(transfer.opacity(value), reference) as f32;
                let [r, g, b] = transfer.color(value).map(|channel| channel as f32);
                Vec4::new(r * tau, g * tau, b * tau, tau)
            })
            .collect();
        let shows = |entry: usize| fine[entry * SUBSTEPS..][..SUBSTEPS].iter().any(|step| step.w > 0.0);
        let visible = (0..=high)
            .map(|code| {
                let at = axis.coordinate(f32::from(code)).max(0.0);
                let (first, last) = ((at.floor() as usize).saturating_sub(1), at.ceil() as usize);
                (first..=last).any(|entry| entry < entries - 1 && shows(entry))
            })
            .collect();
        Self { axis, visible, fine, made: Mutex::default() }
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
        let table = Arc::new(self.make(form, length));
        self.made.lock().expect("no panic while it is held").insert(key, Arc::clone(&table));
        table
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        let made = self.made.lock().expect("no panic while it is held");
        let tables: usize = made.values().map(|table| size_of_val(&table.slabs[..])).sum();
        (tables + self.visible.len() + size_of_val(&self.fine[..])) as u64
    }

    fn make(&self, form: Form, length: f32) -> SlabTable {
        let entries = self.axis.entries;
        let mut slabs = vec![Vec4::ZERO; entries * entries];
        slabs.par_chunks_mut(entries).enumerate().for_each(|(front, row)| {
            for (back, slab) in row.iter_mut().enumerate() {
                *slab = self.integrate(front, back, form, length);
            }
        });
        SlabTable { axis: self.axis, slabs }
    }

    fn integrate(&self, front: usize, back: usize, form: Form, length: f32) -> Vec4 {
        let (low, high) = (front.min(back), front.max(back));
        // A slab of one scalar takes the interval after it (the last entry: before it).
        let range =
            if low == high { low.min(self.axis.entries - 2)..low.min(self.axis.entries - 2) + 1 } else { low..high };
        let steps = &self.fine[range.start * SUBSTEPS..range.end * SUBSTEPS];
        let step_length = length / steps.len() as f32;
        let (mut color, mut depth, mut transmittance) = (Vec4::ZERO, 0f32, 1f32);
        let mut step = |fine: &Vec4| {
            if fine.w > 0.0 {
                let opacity = -(-fine.w * step_length).exp_m1();
                color += *fine * (transmittance * opacity / fine.w);
                transmittance *= 1.0 - opacity;
                depth += fine.w * step_length;
            }
        };
        if front <= back {
            steps.iter().for_each(&mut step)
        } else {
            steps.iter().rev().for_each(&mut step)
        }
        let opacity = -(-depth).exp_m1();
        match form {
            _ if depth == 0.0 => Vec4::ZERO,
            Form::Opacity => color.with_w(opacity),
            Form::OpticalDepth => (color * (depth / opacity)).with_w(depth),
        }
    }
}

impl SlabTable {
    /// Scalar codes -> positions on the table's axis.
    #[inline(always)]
    pub fn axis(&self) -> SlabAxis {
        self.axis
    }

    /// The entry nearest to two positions on the axis.
    #[inline(always)]
    pub fn nearest(&self, front: f32, back: f32) -> Vec4 {
        let at = |position: f32| ((position + 0.5) as usize).min(self.axis.entries - 1);
        self.slabs[at(front) * self.axis.entries + at(back)]
    }

    /// Interpolated between the four entries around two positions on the axis.
    #[inline(always)]
    pub fn bilinear(&self, front: f32, back: f32) -> Vec4 {
        let entries = self.axis.entries;
        let at = |position: f32| (position as usize).min(entries - 2);
        let (f, b) = (at(front), at(back));
        let (wf, wb) = (front - f as f32, back - b as f32);
        let near = &self.slabs[f * entries + b..][..2];
        let far = &self.slabs[(f + 1) * entries + b..][..2];
        let (near, far) = (near[0] + (near[1] - near[0]) * wb, far[0] + (far[1] - far[0]) * wb);
        near + (far - near) * wf
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
        self.0.axis.coordinate(code)
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
        self.0.axis.coordinate(code)
    }

    #[inline(always)]
    fn slab(self, front: f32, back: f32) -> Vec4 {
        self.0.bilinear(front, back)
    }
}
