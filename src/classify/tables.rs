//! A transfer function tabulated over a volume's codes: extinction and colour, and which codes are
//! transparent.
//!
//! Scalars are codes of at most 16 bits, so the tables are exact: one entry per code, no
//! interpolation and no quantization.

use rayon::prelude::*;

use super::transfer::{TransferFunction, extinction};
use crate::volume::Volume;

/// Entries that one job computes.
const CHUNK: usize = 2048;

/// Extinction and colour per code, 0 up to the volume's largest.
#[derive(Clone, Debug)]
pub struct CodeTables {
    /// Extinction per mm; 0 where the opacity is at or below the threshold.
    pub extinction: Vec<f32>,
    /// Red, green, blue, 0..=1; black where nothing shows.
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
        let (first, last) = volume.code_range();
        let mut tables = Self {
            extinction: vec![0.0; usize::from(last) + 1],
            color: vec![[0.0; 3]; usize::from(last) + 1],
            threshold,
        };
        let first = usize::from(first);
        let chunks = tables.extinction[first..].par_chunks_mut(CHUNK).zip(tables.color[first..].par_chunks_mut(CHUNK));
        chunks.enumerate().for_each(|(chunk, (taus, colors))| {
            for (at, (tau, color)) in taus.iter_mut().zip(colors).enumerate() {
                let value = volume.value_of_code((first + chunk * CHUNK + at) as f64);
                let opacity = transfer.opacity(value);
                let exact = if opacity > 0.0 { extinction(opacity, length) as f32 } else { 0.0 };
                if exact > threshold {
                    *tau = exact;
                    *color = transfer.color(value).map(|channel| channel as f32);
                }
            }
        });
        tables
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
