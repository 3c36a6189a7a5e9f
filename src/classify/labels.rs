//! Segmentations: voxels that look as their label says.
//!
//! Labels are names, so that nothing is interpolated between them: each voxel is classified by its own label's transfer
//! function, and what is interpolated are extinctions and colours, as between voxels with colours of their own.

use super::transfer::{ControlPoint, TransferFunction};
use super::{CodeTables, Color};
use crate::volume::{Scalars, Volume};

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
    /// First that of voxels whose label nothing was said of.
    tables: Vec<CodeTables>,
}

impl LabelTables {
    /// Tabulates the transfer functions of labels, and of all `others`, for `volume`. Of two looks of one label the last is
    /// meant.
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
        let transfers = [others].into_iter().chain(looks.iter().map(|look| &look.transfer));
        let table_of = |code: u16| {
            let value = labels.value_of_code(code.into());
            let at = looks.iter().rposition(|look| f64::from(look.label) == value);
            at.map_or(0, |at| at as u8 + 1)
        };
        Self {
            by_code: (0..=labels.code_range().1).map(table_of).collect(),
            tables: transfers.map(|transfer| CodeTables::new(volume, transfer, min_opacity)).collect(),
        }
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        self.by_code.len() as u64 + self.tables.iter().map(CodeTables::bytes).sum::<u64>()
    }

    /// Colour and extinction per mm of a voxel, by its label's code and its own.
    #[inline(always)]
    pub fn look(&self, label: u16, code: u16) -> ([f32; 3], f32) {
        let table = &self.tables[usize::from(self.by_code[usize::from(label)])];
        (table.color[usize::from(code)], table.extinction[usize::from(code)])
    }
}

/// A segmentation of a volume, on its grid.
#[derive(Clone, Copy, Debug)]
pub struct Labels<'a> {
    pub voxels: &'a Scalars,
    pub tables: &'a LabelTables,
}

/// A transfer function that shows nothing exactly where none of several shows anything: what is skipped by it is transparent,
/// whatever its label.
pub fn union<'a>(transfers: impl Iterator<Item = &'a TransferFunction>, opacity_distance: f64) -> TransferFunction {
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
        gradient_opacity: vec![],
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
