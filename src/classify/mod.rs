//! [`Volume`](crate::volume::Volume) + [`TransferFunction`] -> what a frame walks.
//!
//! Nothing here depends on the view, so it is done once for many frames and kept.

pub mod presets;
pub mod rle;
mod serial;
pub mod summed_area;
pub mod tables;
pub mod transfer;

use std::io::{self, Read, Write};
use std::time::{Duration, Instant};

use crate::volume::PreparedVolume;
pub use rle::RunLengthVolume;
use summed_area::SummedAreaTable;
pub use tables::CodeTables;
pub use transfer::{Color, ControlPoint, GradientPoint, InvalidField, TransferFunction};

/// How long a classification took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClassifyTimings {
    pub summed_area_table: Duration,
    pub run_lengths: Duration,
}

/// A volume under a transfer function: tables and run-length encodings for all three principal
/// axes. Independent of the view.
#[derive(Clone, Debug)]
pub struct ClassifiedVolume {
    tables: CodeTables,
    run_lengths: RunLengthVolume,
    timings: ClassifyTimings,
}

impl ClassifiedVolume {
    /// Classifies on the current rayon pool. Voxels whose opacity is at or below `min_opacity`
    /// count as transparent.
    pub fn build(prepared: &PreparedVolume, transfer: &TransferFunction, min_opacity: f64) -> Self {
        let start = Instant::now();
        let tables = CodeTables::new(prepared.volume(), transfer, min_opacity);
        let summed_area = SummedAreaTable::new(&tables, transfer, prepared.octree());
        let summed_area_table = start.elapsed();
        let occupied = prepared.octree().occupied_leaves(|range| summed_area.is_transparent(range));
        let run_lengths = RunLengthVolume::encode(prepared, &tables, transfer, &occupied);
        let timings = ClassifyTimings { summed_area_table, run_lengths: start.elapsed() - summed_area_table };
        Self { tables, run_lengths, timings }
    }

    /// Extinction and colour per code.
    pub fn tables(&self) -> &CodeTables {
        &self.tables
    }

    /// The encodings.
    pub fn run_lengths(&self) -> &RunLengthVolume {
        &self.run_lengths
    }

    /// How long it took.
    pub fn timings(&self) -> ClassifyTimings {
        self.timings
    }

    /// Bytes in memory, by structure: `run_lengths`, `tables`.
    pub fn bytes(&self) -> [(&'static str, u64); 2] {
        [("run_lengths", self.run_lengths.bytes()), ("tables", self.tables.bytes())]
    }

    /// Share of the voxels that are not transparent, 0..=1.
    pub fn nontransparent_share(&self) -> f64 {
        let [nx, ny, nz] = self.run_lengths.dims;
        self.run_lengths.voxels() as f64 / (nx * ny * nz) as f64
    }

    /// Writes the encodings for [`Self::read_from`]; the caller adds version and checksum.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_to(&self, out: &mut impl Write) -> io::Result<()> {
        serial::write(&self.run_lengths, out)
    }

    /// Reads what [`Self::write_to`] wrote for the same volume, transfer function and threshold.
    ///
    /// # Errors
    /// Where the bytes are truncated or do not fit `prepared`; nothing is taken on trust, and no
    /// more memory is taken than the encoding of such a volume can need.
    pub fn read_from(
        prepared: &PreparedVolume,
        transfer: &TransferFunction,
        min_opacity: f64,
        input: &mut impl Read,
    ) -> io::Result<Self> {
        let start = Instant::now();
        let tables = CodeTables::new(prepared.volume(), transfer, min_opacity);
        let with_factors = !transfer.gradient_opacity.is_empty();
        let run_lengths = serial::read(prepared.volume(), with_factors, input)?;
        let timings = ClassifyTimings { run_lengths: start.elapsed(), ..ClassifyTimings::default() };
        Ok(Self { tables, run_lengths, timings })
    }
}
