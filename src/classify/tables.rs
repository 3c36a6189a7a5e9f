//! A transfer function tabulated over a volume's codes: extinction and colour, and which codes are
//! transparent.
//!
//! Scalars are codes of at most 16 bits, so the tables are exact: one entry per code, no
//! interpolation and no quantization.

use super::transfer::{TransferFunction, extinction};
use crate::volume::Volume;

/// Extinction and colour per code, 0 up to the volume's largest.
#[derive(Clone, Debug)]
pub struct CodeTables {
    /// Extinction per mm; 0 where the opacity is at or below the threshold.
    pub extinction: Vec<f32>,
    /// Red, green, blue, 0..=1.
    pub color: Vec<[f32; 3]>,
    /// The extinction per mm at or below which a voxel counts as transparent.
    pub threshold: f32,
}

impl CodeTables {
    /// Tabulates `transfer` for `volume`; opacities at or below `min_opacity` (for the reference
    /// length) count as zero.
    pub fn new(volume: &Volume, transfer: &TransferFunction, min_opacity: f64) -> Self {
        let length = transfer.reference_length(volume.smallest_spacing());
        let threshold = extinction(min_opacity, length) as f32;
        let codes = 0..=volume.code_range().1;
        let value = |code: u16| volume.value_of_code(f64::from(code));
        let visible = |tau: f32| if tau > threshold { tau } else { 0.0 };
        Self {
            extinction: codes.clone().map(|c| visible(extinction(transfer.opacity(value(c)), length) as f32)).collect(),
            color: codes.map(|c| transfer.color(value(c)).map(|channel| channel as f32)).collect(),
            threshold,
        }
    }

    /// True where a voxel of extinction `tau` (from [`Self::extinction`]) and gradient opacity
    /// `factor` (255 = 1) is drawn. Never falls as either grows.
    #[inline(always)]
    pub fn is_visible(&self, tau: f32, factor: u8) -> bool {
        tau > 0.0 && (factor == u8::MAX || tau * f32::from(factor) / 255.0 > self.threshold)
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.extinction[..]) + size_of_val(&self.color[..])) as u64
    }
}
