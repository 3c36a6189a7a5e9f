//! Every preset on one volume.
//!
//! Fitting a preset and choosing the default look at the volume's histogram, and so at every voxel.
//! Whoever renders more than one frame of a volume does that once.

use super::{DefaultPreset, Preset, all, default_for};
use crate::classify::TransferFunction;
use crate::volume::Volume;

/// The transfer functions that a volume has without a client's saying any.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedPresets {
    /// What the volume looks like unless told.
    pub default: DefaultPreset,
    /// In the order of [`all`].
    fitted: Vec<TransferFunction>,
}

impl FittedPresets {
    /// Fits every preset to `volume`, on the current rayon pool. `modality` is free text.
    pub fn of(volume: &Volume, modality: Option<&str>) -> Self {
        let fitted = all().iter().map(|preset| preset.transfer_function(volume)).collect();
        Self { default: default_for(volume, modality), fitted }
    }

    /// The preset of this name, and its transfer function on the volume.
    pub fn get(&self, name: &str) -> Option<(&'static Preset, &TransferFunction)> {
        all().iter().zip(&self.fitted).find(|(preset, _)| preset.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::phantom;

    #[test]
    fn fitted_beforehand_is_fitted_when_asked() {
        let volume = phantom::ball(24, 8.0, 5000.0, 2.0);
        let fitted = FittedPresets::of(&volume, Some("MR"));
        assert_eq!(fitted.default, default_for(&volume, Some("MR")));
        for preset in all() {
            assert_eq!(fitted.get(&preset.name), Some((preset, &preset.transfer_function(&volume))));
        }
        assert_eq!(fitted.get("no-such-preset"), None);
    }
}
