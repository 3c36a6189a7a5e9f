//! How a segmentation makes voxels look.

use super::{Look, fitted};
use crate::classify::TransferFunction;
use crate::classify::labels::{LabelLook, LabelTables, gradient_points, union};
use crate::classify::presets::FittedPresets;
use crate::render::Algorithm;
use crate::service::request::{LabelRequest, LabelsRequest, RequestError};
use crate::volume::Volume;

/// How voxels look by their labels.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedLabels {
    /// The id of the volume of labels.
    pub volume: String,
    looks: Vec<LabelLook>,
    /// Of voxels with other labels.
    others: TransferFunction,
    min_opacity: f64,
}

impl ResolvedLabels {
    /// Refuses a volume of labels that is not on the volume's grid.
    ///
    /// # Errors
    /// [`RequestError::Refused`], for the field that names it.
    pub fn suit(&self, volume: &Volume, labels: &Volume) -> Result<(), RequestError> {
        let refused = |detail: String| Err(RequestError::refused("/labels/volume", detail));
        let (wanted, got) = (volume.dims(), labels.dims());
        if wanted != got {
            return refused(format!("expected labels on the volume's grid of {wanted:?} voxels, got {got:?}"));
        }
        if labels.colors().is_some() {
            return refused("expected labels, got colours".into());
        }
        let (slope, intercept) = labels.rescale();
        if labels.report().quantized || slope.fract() != 0.0 || intercept.fract() != 0.0 {
            return refused("expected labels, which are whole numbers up to 65535, got other values".into());
        }
        let [a, b] = [volume, labels].map(Volume::world_from_index);
        let apart = (a - b).to_cols_array().iter().fold(0.0, |most: f64, element| most.max(element.abs()));
        let extent = 1e-3 * volume.smallest_spacing();
        if apart > extent {
            return refused("expected labels on the volume's grid, got another place, spacing or orientation".into());
        }
        Ok(())
    }

    /// The tables of both volumes.
    pub fn tables(&self, volume: &Volume, labels: &Volume) -> LabelTables {
        LabelTables::new(volume, labels, &self.looks, &self.others, self.min_opacity)
    }
}

impl Look {
    /// The same by label: its transfer function becomes one for all labels. What labels say themselves has so much of its `opacity`.
    pub(super) fn by_label(
        mut self,
        labels: &LabelsRequest,
        opacity: f64,
        volume: &Volume,
        presets: &FittedPresets,
    ) -> Result<Self, RequestError> {
        let others = self.transfer;
        let of_label = |(index, told): (usize, &LabelRequest)| {
            let (mut transfer, factor) = match &told.transfer {
                None => (others.clone(), 1.0),
                Some(transfer) => {
                    (fitted(transfer, presets, &format!("/labels/looks/{index}/transfer_function"))?.0, opacity)
                }
            };
            transfer.opacity_distance = Some(transfer.reference_length(volume.smallest_spacing()));
            for point in &mut transfer.points {
                point.opacity *= told.opacity * factor;
                point.color = told.color.unwrap_or(point.color);
            }
            Ok(LabelLook { label: told.label, transfer })
        };
        let looks = labels.looks.iter().enumerate().map(of_label).collect::<Result<Vec<_>, RequestError>>()?;
        let transfers = || [&others].into_iter().chain(looks.iter().map(|look| &look.transfer));
        let points = gradient_points(transfers());
        if points > TransferFunction::MAX_POINTS {
            let detail = format!(
                "expected gradient opacities with points at {} gradient magnitudes at most, of all looks and of other voxels, got {points}",
                TransferFunction::MAX_POINTS
            );
            return Err(RequestError::refused("/labels/looks", detail));
        }
        // What is skipped is transparent for every label.
        self.transfer = union(transfers(), volume.smallest_spacing());
        let min_opacity = match self.settings.algorithm {
            Algorithm::Classified | Algorithm::FastClassification => self.min_opacity,
            Algorithm::Preintegrated | Algorithm::Raycast => 0.0,
        };
        self.min_opacity = 0.0;
        self.labels = Some(ResolvedLabels { volume: labels.volume.clone(), looks, others, min_opacity });
        Ok(self)
    }
}
