//! [`Volume`](crate::volume::Volume) + [`TransferFunction`] -> what a frame walks.
//!
//! Nothing here depends on the view, so it is done once for many frames and kept. It comes in two
//! parts. A [`Classification`] holds the tables, what octree and summed-area table say about
//! every leaf, and which single voxels are visible: made in milliseconds, and enough for a frame (Lacroute and Levoy 1994, section 3.3).
//! [`Encodings`] hold runs (section 3.1): they take longer and make frames faster, and change no bit
//! of them, so a frame is never kept waiting for them.

pub mod cells;
pub mod labels;
pub mod marks;
pub mod preintegration;
pub mod presets;
pub mod rle;
mod serial;
pub mod summed_area;
pub mod tables;
pub mod transfer;
pub mod visible;

use std::io::{self, Read, Write};
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::volume::PreparedVolume;
use crate::volume::octree::LEAF;
use preintegration::SlabTables;
pub use rle::RunLengthVolume;
use summed_area::{SummedAreaTable, octree_for};
pub use tables::CodeTables;
pub use transfer::{Color, ControlPoint, GradientPoint, InvalidField, TransferFunction};
pub use visible::Visible;

/// What is classified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Purpose {
    /// Single voxels. Those whose opacity for the reference length is at or below `min_opacity`
    /// count as transparent.
    Voxels { min_opacity: f64 },
    /// Slabs between slices, looked up in a table of so many entries along an axis. Only what is
    /// exactly zero counts as transparent.
    Slabs { entries: usize },
}

/// A volume under a transfer function: tables, and which leaves of the octree may show something.
/// Independent of the view.
#[derive(Debug)]
pub struct Classification {
    purpose: Purpose,
    tables: CodeTables,
    slabs: Option<SlabTables>,
    occupied: Vec<bool>,
    bounds: [Range<usize>; 3],
    visible: Option<Arc<Visible>>,
    summed_area_table: Duration,
}

impl Classification {
    /// Classifies on the current rayon pool.
    pub fn build(prepared: &PreparedVolume, transfer: &TransferFunction, purpose: Purpose) -> Self {
        let octree = octree_for(prepared, transfer);
        let start = Instant::now();
        let min_opacity = match purpose {
            Purpose::Voxels { min_opacity } => min_opacity,
            Purpose::Slabs { .. } => 0.0,
        };
        let tables = CodeTables::new(prepared.volume(), transfer, min_opacity);
        let slabs = match purpose {
            Purpose::Voxels { .. } => None,
            Purpose::Slabs { entries } => Some(SlabTables::new(prepared.volume(), transfer, entries)),
        };
        let occupied = match &slabs {
            None => Self::leaves(prepared, transfer, &tables),
            Some(slabs) => {
                let summed_area = SummedAreaTable::of_slabs(slabs.visible_codes(), transfer, octree);
                octree.occupied_leaves(|range| summed_area.is_transparent(range))
            }
        };
        let bounds = bounds(&occupied, octree.leaf_dims(), prepared.volume().dims());
        let visible = slabs.is_none().then(|| Arc::new(Visible::new(prepared, &tables, &occupied)));
        Self { purpose, tables, slabs, occupied, bounds, visible, summed_area_table: start.elapsed() }
    }

    /// A flag for each leaf of the volume's octree: false only where none of its voxels shows by `tables`.
    pub fn leaves(prepared: &PreparedVolume, transfer: &TransferFunction, tables: &CodeTables) -> Vec<bool> {
        let octree = octree_for(prepared, transfer);
        let summed_area = SummedAreaTable::new(tables, transfer, octree);
        octree.occupied_leaves(|range| summed_area.is_transparent(range))
    }

    /// What it is for.
    pub fn purpose(&self) -> Purpose {
        self.purpose
    }

    /// Extinction and colour per code.
    pub fn tables(&self) -> &CodeTables {
        &self.tables
    }

    /// Pre-integration tables; `None` where single voxels are classified.
    pub fn slabs(&self) -> Option<&SlabTables> {
        self.slabs.as_ref()
    }

    /// A flag for each leaf of the volume's octree, `i` fastest: false only where nothing in the
    /// leaf, values interpolated in it included, shows.
    pub fn occupied(&self) -> &[bool] {
        &self.occupied
    }

    /// The voxels along x, y, z that all that shows lies between, ends included; none where nothing does.
    pub fn bounds(&self) -> &[Range<usize>; 3] {
        &self.bounds
    }

    /// Which voxels are visible; `None` where slabs are classified.
    pub fn visible(&self) -> Option<&Visible> {
        self.visible.as_deref()
    }

    /// How long tables, flags and visible voxels took.
    pub fn summed_area_table(&self) -> Duration {
        self.summed_area_table
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        let visible = self.visible().map_or(0, Visible::bytes);
        self.tables.bytes() + self.slabs.as_ref().map_or(0, SlabTables::bytes) + self.occupied.len() as u64 + visible
    }
}

/// The voxels along each axis of a volume of `dims` that occupied leaves lie among, so many of them along each axis.
fn bounds(occupied: &[bool], [nx, ny, nz]: [usize; 3], dims: [usize; 3]) -> [Range<usize>; 3] {
    let (mut low, mut high) = ([nx, ny, nz], [0; 3]);
    for (row, leaves) in occupied.chunks_exact(nx).enumerate() {
        let Some(first) = leaves.iter().position(|occupied| *occupied) else { continue };
        let last = leaves.iter().rposition(|occupied| *occupied).unwrap_or(first);
        for (axis, [first, last]) in [[first, last], [row % ny; 2], [row / ny; 2]].into_iter().enumerate() {
            (low[axis], high[axis]) = (low[axis].min(first), high[axis].max(last + 1));
        }
    }
    // Neighbours share a face of voxels.
    [0, 1, 2].map(|axis| {
        let (first, last) = (low[axis] * LEAF, (high[axis] * LEAF).min(dims[axis] - 1));
        if low[axis] < high[axis] { first..last + 1 } else { 0..0 }
    })
}

/// The runs of a classified volume, for all three principal axes.
#[derive(Clone, Debug, PartialEq)]
pub enum Encodings {
    /// For [`Purpose::Voxels`]: runs of non-transparent voxels, and those voxels.
    Voxels(RunLengthVolume),
    /// For [`Purpose::Slabs`]: [`cells`] in which something shows.
    Cells(Visible),
}

impl Encodings {
    /// Encodes on the current rayon pool.
    pub fn build(prepared: &PreparedVolume, transfer: &TransferFunction, classification: &Classification) -> Self {
        let Classification { tables, slabs, occupied, visible, .. } = classification;
        match (slabs, visible) {
            (Some(slabs), _) => Self::Cells(cells::mark(prepared, slabs.visible_codes(), occupied)),
            (None, Some(visible)) => Self::Voxels(RunLengthVolume::encode(prepared, tables, transfer, visible)),
            (None, None) => unreachable!("either slabs or voxels are classified"),
        }
    }

    /// What [`Self::build`] can take in memory at most, told without building.
    pub fn bytes_at_most(prepared: &PreparedVolume, classification: &Classification) -> u64 {
        let dims = prepared.volume().dims();
        match classification.purpose {
            Purpose::Slabs { .. } => Visible::bytes_of(dims.map(|n| n - 1)),
            Purpose::Voxels { .. } => {
                let leaves @ [lx, ly, _] = prepared.octree().leaf_dims();
                // The last leaf along an axis has what is left.
                let side = |axis: usize, at: usize| {
                    if at + 1 < leaves[axis] { LEAF } else { dims[axis] - at * LEAF }
                };
                let voxels = |at: usize| side(0, at % lx) * side(1, at / lx % ly) * side(2, at / (lx * ly));
                let occupied = classification.occupied.iter().enumerate().filter(|(_, occupied)| **occupied);
                RunLengthVolume::bytes_at_most(dims, occupied.map(|(at, _)| voxels(at) as u64).sum())
            }
        }
    }

    /// The encodings of voxels, where that is what they are of.
    pub fn voxels(&self) -> Option<&RunLengthVolume> {
        match self {
            Self::Voxels(voxels) => Some(voxels),
            Self::Cells(_) => None,
        }
    }

    /// The runs of cells, where that is what they are of.
    pub fn cells(&self) -> Option<&Visible> {
        match self {
            Self::Voxels(_) => None,
            Self::Cells(cells) => Some(cells),
        }
    }

    /// Share of the voxels (or cells) that are not transparent, 0..=1.
    pub fn nontransparent_share(&self) -> f64 {
        match self {
            Self::Voxels(voxels) => voxels.nontransparent_share(),
            Self::Cells(cells) => cells.share(),
        }
    }

    /// Bytes in memory, all axes.
    pub fn bytes(&self) -> u64 {
        match self {
            Self::Voxels(voxels) => voxels.bytes(),
            Self::Cells(cells) => cells.bytes(),
        }
    }

    /// Writes the encodings for [`Self::read_from`]; the caller adds version and checksum.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_to(&self, out: &mut impl Write) -> io::Result<()> {
        match self {
            Self::Voxels(voxels) => serial::write(voxels, out),
            Self::Cells(cells) => serial::write_cells(cells, out),
        }
    }

    /// Reads what [`Self::write_to`] wrote for the same volume, transfer function and purpose.
    ///
    /// # Errors
    /// Where the bytes are truncated or do not fit `prepared`; nothing is taken on trust, and no
    /// more memory is taken than the encoding of such a volume can need.
    pub fn read_from(
        prepared: &PreparedVolume,
        transfer: &TransferFunction,
        purpose: Purpose,
        input: &mut impl Read,
    ) -> io::Result<Self> {
        let with_factors = !transfer.gradient_opacity.is_empty();
        Ok(match purpose {
            Purpose::Voxels { .. } => Self::Voxels(serial::read(prepared.volume(), with_factors, input)?),
            Purpose::Slabs { .. } => Self::Cells(serial::read_cells(prepared.volume(), input)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::volume::{ImportReport, Placement, ScalarType, Scalars, Volume, phantom};

    /// Opacity over a ramp between two values, scaled by the gradient or not.
    fn ramp(from: f64, to: f64, gradients: &[(f64, f64)]) -> TransferFunction {
        let point = |value, opacity| ControlPoint { value, opacity, color: Color([1.0; 3]) };
        TransferFunction {
            points: vec![point(from, 0.0), point(to, 0.5)],
            opacity_distance: Some(1.0),
            gradient_opacity: gradients.iter().map(|&(value, opacity)| GradientPoint { value, opacity }).collect(),
        }
    }

    #[test]
    fn all_that_shows_lies_within_the_bounds() {
        let mut codes = vec![0u8; 20 * 30 * 17];
        let at = |x: usize, y: usize, z: usize| (z * 30 + y) * 20 + x;
        let volume = |codes: &[u8]| {
            let placement = Placement::from_spacing(DVec3::ONE);
            let scalars = Scalars::U8(codes.to_vec());
            let report = ImportReport::plain("test", ScalarType::U8);
            PreparedVolume::build(Volume::new([20, 30, 17], placement, scalars, (1.0, 0.0), report).unwrap())
        };
        let bounds = |codes: &[u8], purpose| {
            Classification::build(&volume(codes), &ramp(9.0, 99.0, &[]), purpose).bounds().clone()
        };
        for purpose in [Purpose::Voxels { min_opacity: 0.0 }, Purpose::Slabs { entries: 64 }] {
            assert_eq!(bounds(&codes, purpose), [0..0, 0..0, 0..0]);
        }
        codes[at(9, 20, 16)] = 50;
        codes[at(17, 23, 10)] = 50;
        for purpose in [Purpose::Voxels { min_opacity: 0.0 }, Purpose::Slabs { entries: 64 }] {
            assert_eq!(bounds(&codes, purpose), [8..20, 16..25, 8..17]);
        }
        codes[at(0, 8, 0)] = 50;
        for purpose in [Purpose::Voxels { min_opacity: 0.0 }, Purpose::Slabs { entries: 64 }] {
            // The voxel is of two leaves.
            assert_eq!(bounds(&codes, purpose), [0..20, 0..25, 0..17]);
        }
    }

    #[test]
    fn encodings_take_no_more_than_was_told_before() {
        let volumes =
            [phantom::noise([70, 9, 10], 7), phantom::ball(33, 9.0, 200.0, 2.0), phantom::noise([3, 2, 130], 1)];
        let transfers =
            [ramp(0.0, 1.0, &[]), ramp(20_000.0, 40_000.0, &[]), ramp(50.0, 300.0, &[(0.0, 0.0), (9.0, 1.0)])];
        for prepared in volumes.map(PreparedVolume::build) {
            for transfer in &transfers {
                for purpose in [Purpose::Voxels { min_opacity: 0.0 }, Purpose::Slabs { entries: 64 }] {
                    let classification = Classification::build(&prepared, transfer, purpose);
                    let told = Encodings::bytes_at_most(&prepared, &classification);
                    let built = Encodings::build(&prepared, transfer, &classification).bytes();
                    assert!(built <= told, "{purpose:?}: {built} > {told}");
                }
            }
        }
    }
}
