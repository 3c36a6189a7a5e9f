//! The transfer functions that ship with the program, by name.

use super::{Color, ControlPoint, TransferFunction};
use crate::volume::Volume;

/// A transfer function with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Preset {
    pub name: String,
    pub shading: bool,
}

/// What a volume looks like unless told.
#[derive(Clone, Debug, PartialEq)]
pub struct DefaultPreset {
    pub transfer: TransferFunction,
    pub shading: bool,
}

static PRESETS: std::sync::LazyLock<[Preset; 1]> =
    std::sync::LazyLock::new(|| [Preset { name: "gray-ramp".into(), shading: false }]);

impl Preset {
    /// A ramp over the volume's range.
    pub fn transfer_function(&self, volume: &Volume) -> TransferFunction {
        let (low, high) = volume.value_range();
        let point = |value, opacity, c| ControlPoint { value, opacity, color: Color([c; 3]) };
        let points = vec![point(low, 0.0, 0.0), point(high, 0.1, 1.0)];
        TransferFunction { points, opacity_distance: None, gradient_opacity: vec![] }
    }
}

/// Every preset.
pub fn all() -> &'static [Preset] {
    &*PRESETS
}

/// The preset of this name.
pub fn get(name: &str) -> Option<&'static Preset> {
    all().iter().find(|p| p.name == name)
}

/// A transfer function that shows something of this volume.
pub fn default_for(volume: &Volume, _modality: Option<&str>) -> DefaultPreset {
    DefaultPreset { transfer: all()[0].transfer_function(volume), shading: true }
}
