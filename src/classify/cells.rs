//! Runs of cells: where a slab between two slices may show something.
//!
//! A slab's two scalars are interpolated from the corners of the cells that its ray passes, so what
//! pre-integration can skip is told by cells, not by voxels: a cell shows something if any scalar
//! between the smallest and the largest of its eight corners does. (Runs of voxels dilated by one
//! would do, but are wider: transfer functions that show thin ranges leave most of such a hull
//! empty.) A run is what it is for voxels, a stretch of a scanline; here there is nothing to store
//! for each cell, the scalars being read from the volume, and the runs of 64 cells are kept as the
//! bits of a word.
//!
//! Scanlines are stored in the two orders of [`super::rle`].

use super::marks::{Marks, VisibleCodes};
pub use super::marks::{WORD, words};
use super::visible::Visible;
use crate::volume::PreparedVolume;
use crate::volume::scanlines::AnyScanlines;

/// Marks the cells between whose corners `visible` (a flag for each code) has a set flag. `occupied` has a flag for each leaf of the
/// volume's octree: false only where no cell of the leaf is to be marked.
pub fn mark(prepared: &PreparedVolume, visible: &[bool], occupied: &[bool]) -> Visible {
    let visible = visible.iter().copied();
    let (marks, holding) = match prepared.scanlines(2) {
        AnyScanlines::U8(scanlines) => Marks::new::<_, true>(scanlines, &VisibleCodes::new(visible), occupied),
        AnyScanlines::U16(scanlines) => Marks::new::<_, true>(scanlines, &VisibleCodes::new(visible), occupied),
    };
    Visible::holding(marks, &holding)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classify::visible::AxisVisible;
    use crate::volume::{Scalars, phantom};

    /// The flags of leaves that a transfer function with such visible codes leaves, and the runs.
    fn encoded(prepared: &PreparedVolume, visible: &[bool]) -> Visible {
        let occupied = prepared.octree().occupied_leaves(|range| {
            let (low, high) = range.code;
            !visible[usize::from(low)..=usize::from(high)].contains(&true)
        });
        mark(prepared, visible, &occupied)
    }

    #[test]
    fn every_axis_has_the_cells_whose_corners_range_over_a_visible_code() {
        for dims in [[2, 3, 2], [65, 66, 5], [66, 9, 70], [130, 64, 3]] {
            // Lumps, so that there are empty leaves, and some noise.
            let field = |i: usize, j: usize, k: usize| {
                let [x, y, z] = [i, j, k].map(|at| at as f64 * 0.2);
                (150.0 * (x.sin() * y.cos() * (z + 1.0).sin()).max(0.0)).floor() + ((i * 7 + j * 5 + k * 3) % 5) as f64
            };
            let prepared = PreparedVolume::build(phantom::from_fn(dims, [1.0; 3], field));
            let Scalars::U16(codes) = prepared.volume().scalars() else { panic!("phantoms have 16 bits") };
            let visible: Vec<bool> = (0..200).map(|code| matches!(code, 40..=44 | 100..)).collect();
            let runs = encoded(&prepared, &visible);
            for axis in 0..3 {
                let AnyScanlines::U16(scanlines) = prepared.scanlines(axis) else { panic!("phantoms have 16 bits") };
                let [ni, nj, nk] = scanlines.dims();
                let strides = [1, dims[0], dims[0] * dims[1]];
                let strides = scanlines.axes().map(|axis| strides[axis]);
                for (j, k) in (0..nk - 1).flat_map(|k| (0..nj - 1).map(move |j| (j, k))) {
                    let AxisVisible { marks, shown } = runs.for_axis(axis);
                    let marks = marks.scanline(j, k);
                    assert_eq!(shown.holds(j, k), marks.iter().any(|word| *word != 0), "{j} {k} of {dims:?}, {axis}");
                    for i in 0..words(ni - 1) * WORD {
                        let corners = || {
                            (0..8).map(|corner| {
                                let at = [i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2)];
                                usize::from(codes[at[0] * strides[0] + at[1] * strides[1] + at[2] * strides[2]])
                            })
                        };
                        let shows =
                            i < ni - 1 && visible[corners().min().unwrap()..=corners().max().unwrap()].contains(&true);
                        assert_eq!(marks[i / WORD] >> (i % WORD) & 1 == 1, shows, "{i} {j} {k} of {dims:?}, {axis}");
                    }
                }
            }
        }
    }
}
