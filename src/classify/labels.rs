//! Segmentations: voxels that look as their label says.
//!
//! Labels are names, so that nothing is interpolated between them: each voxel is classified by its own label's transfer
//! function, and what is interpolated are extinctions and colours, as between voxels with colours of their own.

mod gradients;

use super::transfer::{ControlPoint, TransferFunction};
use super::{CodeTables, Color};
use crate::volume::{Scalars, Volume, pyramid};
use gradients::CommonGradientOpacity;

/// What voxels of one label look like.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelLook {
    /// The value of its voxels in the label volume.
    pub label: u16,
    pub transfer: TransferFunction,
}

/// Tables by label.
#[derive(Clone, Debug)]
pub struct LabelTables {
    /// For every code of the label volume which of the tables.
    by_code: Vec<u8>,
    /// First that of voxels whose label nothing was said of, then those of the looks. What follows is in the same order.
    tables: Vec<CodeTables>,
    transfers: Vec<TransferFunction>,
    /// False for those that show nothing.
    shown: Vec<bool>,
    /// What a voxel's byte of gradient opacity, which is that of the [`union`], says of each; empty where none has one.
    factors: Vec<[f32; 256]>,
    /// Where they are for a coarser level: its labels.
    coarse: Option<Scalars>,
}

impl LabelTables {
    /// Tabulates the transfer functions of labels, and of all `others`, for `volume`, which may be a coarser level of the one that `labels`
    /// are on the grid of. Of two looks of one label the last is meant.
    ///
    /// # Panics
    /// With more than 255 looks.
    pub fn new(
        volume: &Volume,
        labels: &Volume,
        looks: &[LabelLook],
        others: &TransferFunction,
        min_opacity: f64,
    ) -> Self {
        assert!(looks.len() < usize::from(u8::MAX));
        let transfers: Vec<_> = [others].into_iter().chain(looks.iter().map(|look| &look.transfer)).collect();
        let common = CommonGradientOpacity::new(&transfers);
        let table_of = |code: u16| {
            let value = labels.value_of_code(code.into());
            let at = looks.iter().rposition(|look| f64::from(look.label) == value);
            at.map_or(0, |at| at as u8 + 1)
        };
        Self {
            by_code: (0..=labels.code_range().1).map(table_of).collect(),
            tables: transfers.iter().map(|transfer| CodeTables::new(volume, transfer, min_opacity)).collect(),
            factors: common
                .map_or(vec![], |common| transfers.iter().map(|transfer| common.factors(transfer)).collect()),
            coarse: (volume.dims() != labels.dims()).then(|| pyramid::labels_of_level(labels, volume.dims())),
            shown: transfers.iter().map(|transfer| transfer.points.iter().any(|point| point.opacity > 0.0)).collect(),
            transfers: transfers.into_iter().cloned().collect(),
        }
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        let tables = self.tables.iter().map(CodeTables::bytes).sum::<u64>();
        let points = self.transfers.iter().map(|transfer| transfer.points.len() + transfer.gradient_opacity.len());
        let points = points.sum::<usize>() * size_of::<ControlPoint>();
        let coarse = self.coarse.as_ref().map_or(0, Scalars::bytes);
        tables + (coarse + self.by_code.len() + size_of_val(&self.factors[..]) + points) as u64
    }

    /// The labels, which are those that the tables were made for, or of its coarser level if they are for one.
    pub fn of<'a>(&'a self, labels: &'a Volume) -> Labels<'a> {
        Labels { voxels: self.coarse.as_ref().unwrap_or(labels.scalars()), tables: self }
    }

    /// Which of the tables is for a label, told by its code.
    #[inline(always)]
    fn table(&self, label: u16) -> usize {
        self.by_code[usize::from(label)].into()
    }

    /// Colour and extinction per mm of a voxel, by its label's code and its own.
    #[inline(always)]
    pub fn look(&self, label: u16, code: u16) -> ([f32; 3], f32) {
        let table = &self.tables[self.table(label)];
        (table.color[usize::from(code)], table.extinction[usize::from(code)])
    }

    /// Gradient opacity of a voxel, by its label's code and its byte of what the [`union`] has of it.
    #[inline(always)]
    pub fn gradient_factor(&self, label: u16, byte: u8) -> f32 {
        self.factors.get(self.table(label)).map_or(1.0, |factors| factors[usize::from(byte)])
    }

    /// The same by a gradient's magnitude in scalar units per mm, exactly.
    pub fn gradient_factor_at(&self, label: u16, magnitude: f64) -> f64 {
        self.transfers[self.table(label)].gradient_factor(magnitude)
    }

    /// False where no voxel of a label shows, whatever its scalar.
    #[inline(always)]
    pub fn is_shown(&self, label: u16) -> bool {
        self.shown[self.table(label)]
    }
}

/// A segmentation of a volume, on its grid.
#[derive(Clone, Copy, Debug)]
pub struct Labels<'a> {
    pub voxels: &'a Scalars,
    pub tables: &'a LabelTables,
}

impl Labels<'_> {
    /// False where nothing shows of the label of a voxel, told by its index (x fastest).
    #[inline(always)]
    pub fn shows(&self, voxel: usize) -> bool {
        self.tables.is_shown(self.voxels.code(voxel))
    }
}

/// Gradient magnitudes at which any of several transfer functions' gradient opacity has a point.
pub fn gradient_points<'a>(transfers: impl Iterator<Item = &'a TransferFunction>) -> usize {
    gradients::magnitudes(&transfers.collect::<Vec<_>>()).len()
}

/// A transfer function that shows nothing exactly where none of several shows anything: what is skipped by it is transparent,
/// whatever its label. Its gradient opacity tells those of all ([`LabelTables::gradient_factor`]).
pub fn union<'a>(transfers: impl Iterator<Item = &'a TransferFunction>, opacity_distance: f64) -> TransferFunction {
    let transfers: Vec<_> = transfers.collect();
    let common = CommonGradientOpacity::new(&transfers);
    // Something shows between two points of which one does, and beyond the outermost ones as on them.
    let mut shown: Vec<[f64; 2]> = vec![];
    for TransferFunction { points, .. } in transfers {
        let outer = [(points.first(), f64::NEG_INFINITY), (points.last(), f64::INFINITY)];
        let outer =
            outer.into_iter().filter_map(|(point, beyond)| Some((point.filter(|p| p.opacity > 0.0)?.value, beyond)));
        shown.extend(outer.map(|(value, beyond)| [value.min(beyond), value.max(beyond)]));
        let pairs = points.windows(2).filter(|pair| pair.iter().any(|point| point.opacity > 0.0));
        shown.extend(pairs.map(|pair| [pair[0].value, pair[1].value]));
    }
    shown.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
    shown.dedup_by(|next, last| {
        let meet = next[0] <= last[1];
        if meet {
            last[1] = last[1].max(next[1]);
        }
        meet
    });
    let corners = |&[from, to]: &[f64; 2]| [(from, 0.0), (from, 1.0), (to, 1.0), (to, 0.0)];
    let mut corners: Vec<_> = shown.iter().flat_map(corners).filter(|(value, _)| value.is_finite()).collect();
    corners.dedup();
    if corners.is_empty() {
        corners.push((0.0, if shown.is_empty() { 0.0 } else { 1.0 }));
    }
    let point = |(value, opacity)| ControlPoint { value, opacity, color: Color([1.0; 3]) };
    TransferFunction {
        points: corners.into_iter().map(point).collect(),
        opacity_distance: Some(opacity_distance),
        gradient_opacity: common.map_or(vec![], |common| common.points()),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn transfer(points: &[(f64, f64)]) -> TransferFunction {
        let point = |&(value, opacity): &(f64, f64)| ControlPoint { value, opacity, color: Color([0.5; 3]) };
        TransferFunction {
            points: points.iter().map(point).collect(),
            opacity_distance: None,
            gradient_opacity: vec![],
        }
    }

    proptest! {
        #[test]
        fn what_any_shows_the_union_shows(
            mut a in prop::collection::vec((0.0..50.0, 0.0..1.0), 1..5),
            mut b in prop::collection::vec((0i32..50, 0..2), 1..6),
            value in -5.0..60.0,
        ) {
            a.sort_by(|a: &(f64, f64), b| a.0.total_cmp(&b.0));
            b.sort_by_key(|point| point.0);
            let b: Vec<_> = b.iter().map(|&(value, opacity)| (f64::from(value), f64::from(opacity))).collect();
            let (a, b) = (transfer(&a), transfer(&b));
            let union = union([&a, &b].into_iter(), 1.0);
            for value in [value, f64::round(value)] {
                for of in [&a, &b] {
                    prop_assert!(union.opacity(value) >= of.opacity(value) - 1e-12, "{value}: {union:?}");
                }
            }
            // No more points than are needed.
            prop_assert!(union.points.len() <= 4 * (a.points.len() + b.points.len()));
            prop_assert!(union.points.windows(2).all(|pair| pair[0] != pair[1]));
            for (low, high) in [(value, value + 3.0), (value, value)] {
                let clear = |of: &TransferFunction| of.is_transparent((low, high), (0.0, 1.0));
                prop_assert!(!clear(&union) || clear(&a) && clear(&b));
            }
        }
    }
}
