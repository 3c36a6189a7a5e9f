//! Is a range of (scalar, gradient magnitude) transparent? In O(1).
//!
//! The transfer function is summed over its domain once; whether a block's range holds anything
//! non-transparent is then a difference of four entries (Lacroute and Levoy 1994, section 3.3;
//! Crow 1984). The domain must stay small: codes are binned, and a bin counts as non-transparent if
//! anything in it is, so that ranges are quantized outwards. Where the opacity does not depend on
//! the gradient, the table has one row.

use super::tables::CodeTables;
use super::transfer::TransferFunction;
use crate::volume::PreparedVolume;
use crate::volume::octree::{MinMaxOctree, Range};

/// Bins along the scalar axis at most: exact for 12-bit data.
const SCALAR_BINS: usize = 4096;
/// Bins along the gradient axis, where it matters.
const GRADIENT_BINS: usize = 64;

/// The octree with the ranges that the opacity of `transfer` depends on.
pub fn octree_for<'a>(prepared: &'a PreparedVolume, transfer: &TransferFunction) -> &'a MinMaxOctree {
    if transfer.gradient_opacity.is_empty() { prepared.octree() } else { prepared.gradient_octree() }
}

/// Counts of non-transparent bins, summed over both axes.
#[derive(Clone, Debug)]
pub struct SummedAreaTable {
    /// `(scalar_bins + 1) x (gradient_bins + 1)`, scalar fastest; entry (x, y) counts the bins below x and y.
    sums: Vec<u32>,
    scalar_bins: usize,
    gradient_bins: usize,
    /// A code's bin is `(code - first) >> shift`.
    first: u16,
    shift: u32,
    /// Gradient bins per scalar unit per mm.
    gradient_scale: f32,
}

impl SummedAreaTable {
    /// Sums `tables` (and the gradient opacity of `transfer`) over the ranges that `octree` knows: that of
    /// [`octree_for`].
    pub fn new(tables: &CodeTables, transfer: &TransferFunction, octree: &MinMaxOctree) -> Self {
        let densest = |bin: &[f32]| bin.iter().fold(0f32, |a, &b| a.max(b));
        Self::sum(&tables.extinction, transfer, octree, densest, |densest, factor| tables.is_visible(densest, factor))
    }

    /// Sums the codes at which slabs may show something. What is interpolated may have a smaller
    /// gradient than all that it was made of, so a leaf shows if any of its gradients, or zero, does.
    pub fn of_slabs(visible: &[bool], transfer: &TransferFunction, octree: &MinMaxOctree) -> Self {
        let any = |bin: &[bool]| bin.contains(&true);
        Self::sum(visible, transfer, octree, any, |any, factor| any && factor > 0)
    }

    /// Counts the bins of which `drawn` says, of what is left of the codes' entries and a gradient
    /// opacity, that something shows.
    fn sum<E, B: Copy>(
        by_code: &[E],
        transfer: &TransferFunction,
        octree: &MinMaxOctree,
        reduce: impl Fn(&[E]) -> B,
        drawn: impl Fn(B, u8) -> bool,
    ) -> Self {
        let Range { code: (first, last), gradient: (_, steepest) } = octree.root();
        let codes = usize::from(last - first) + 1;
        let shift = (0..16).find(|shift| (codes - 1) >> shift < SCALAR_BINS).unwrap_or(16);
        let scalar_bins = ((codes - 1) >> shift) + 1;
        let gradient_bins = if transfer.gradient_opacity.is_empty() { 1 } else { GRADIENT_BINS };
        // With one bin any scale will do; gradients may reach to infinity then.
        let gradient_scale =
            if gradient_bins > 1 { gradient_bins as f32 / steepest.max(f32::MIN_POSITIVE) } else { 0.0 };
        let strongest = |bin: usize| match gradient_bins {
            1 => u8::MAX,
            _ => largest_factor(transfer, bin as f32 / gradient_scale, (bin + 1) as f32 / gradient_scale),
        };
        let bins: Vec<B> = by_code[usize::from(first)..].chunks(1 << shift).map(reduce).collect();
        let mut sums = vec![0; (scalar_bins + 1) * (gradient_bins + 1)];
        let width = scalar_bins + 1;
        for y in 0..gradient_bins {
            let factor = strongest(y);
            let mut along = 0;
            for (x, bin) in bins.iter().enumerate() {
                along += u32::from(drawn(*bin, factor));
                sums[(y + 1) * width + x + 1] = sums[y * width + x + 1] + along;
            }
        }
        Self { sums, scalar_bins, gradient_bins, first, shift, gradient_scale }
    }

    /// True where no voxel in this range is drawn.
    pub fn is_transparent(&self, range: &Range) -> bool {
        let bin = |code: u16| usize::from(code - self.first) >> self.shift;
        let gradient_bin = |g: f32| ((g * self.gradient_scale) as usize).min(self.gradient_bins - 1);
        let (x0, x1) = (bin(range.code.0), (bin(range.code.1) + 1).min(self.scalar_bins));
        // One bin wider on both sides: what rounding puts over a bin's edge stays inside.
        let y0 = gradient_bin(range.gradient.0).saturating_sub(1);
        let y1 = (gradient_bin(range.gradient.1) + 2).min(self.gradient_bins);
        let width = self.scalar_bins + 1;
        let at = |x: usize, y: usize| self.sums[y * width + x];
        at(x1, y1) + at(x0, y0) == at(x0, y1) + at(x1, y0)
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        size_of_val(&self.sums[..]) as u64
    }
}

/// The largest gradient opacity over an interval, at its ends or at a point inside; rounded up.
fn largest_factor(transfer: &TransferFunction, low: f32, high: f32) -> u8 {
    let (low, high) = (f64::from(low), f64::from(high));
    let inside = transfer.gradient_opacity.iter().filter(|p| low <= p.value && p.value <= high);
    let ends = [low, high].map(|g| transfer.gradient_factor(g));
    (inside.map(|p| p.opacity).chain(ends).fold(0.0, f64::max) * 255.0).ceil() as u8
}
