//! The transfer functions that ship with the program, by name, and the choice among them.
//!
//! A preset for computed tomography speaks Hounsfield units and is taken as it stands. Magnetic
//! resonance has no units that mean anything from one scan to the next: such presets are written
//! over fractions of the volume's range and fitted when they are used. Where a client names none,
//! [`default_for`] looks at the modality and the histogram (`automatic.rs`).
//!
//! The files of `config/presets` are embedded: what a reader sees there is what the program does.

mod automatic;
mod fitted;
mod histogram;

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::TransferFunction;
use crate::volume::Volume;
pub use automatic::{AUTOMATIC, DefaultPreset, default_for};
pub use fitted::FittedPresets;
use histogram::Histogram;

/// A transfer function with a name, as its file states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preset {
    /// What requests call it; its file's name.
    pub name: String,
    /// What people call it.
    pub title: String,
    pub description: String,
    /// Modalities that it is meant for ("CT", "MR", "XA"); empty: any.
    pub modality: Vec<String>,
    /// What the control points' values mean.
    pub values: Values,
    /// Whether it looks best shaded.
    pub shading: bool,
    /// Values as `values` says; see [`Preset::transfer_function`].
    pub transfer_function: TransferFunction,
}

/// What the values of a preset's control points mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Values {
    /// The file's own units: Hounsfield units.
    File,
    /// Fractions of the volume's robust range: 0 is its smallest value, 1 the value that all but one
    /// in a thousand of the voxels above the smallest value stay below. Gradient magnitudes are
    /// fractions of that range per mm.
    Range,
}

impl Preset {
    /// The preset on this volume: fitted to its range where [`Values::Range`] asks for it.
    pub fn transfer_function(&self, volume: &Volume) -> TransferFunction {
        match self.values {
            Values::File => self.transfer_function.clone(),
            Values::Range => self.fitted(Histogram::of(volume).robust_range()),
        }
    }

    /// Fractions become values between `low` and `high`.
    fn fitted(&self, (low, high): (f64, f64)) -> TransferFunction {
        let mut fitted = self.transfer_function.clone();
        fitted.points.iter_mut().for_each(|p| p.value = low + (high - low) * p.value);
        fitted.gradient_opacity.iter_mut().for_each(|p| p.value *= high - low);
        fitted
    }
}

/// Every preset, in the order in which to offer them.
pub fn all() -> &'static [Preset] {
    &PRESETS
}

/// The preset of this name.
pub fn get(name: &str) -> Option<&'static Preset> {
    all().iter().find(|p| p.name == name)
}

/// Names the files once and embeds them.
macro_rules! preset_files {
    ($($name:literal),* $(,)?) => {
        [$(($name, include_str!(concat!("../../config/presets/", $name, ".json")))),*]
    };
}

const FILES: [(&str, &str); 11] = preset_files![
    "ct-skin-and-bone",
    "ct-bone",
    "ct-skin",
    "ct-soft-tissue",
    "ct-vessels",
    "ct-lung",
    "ct-industrial",
    "mr-default",
    "mr-brain",
    "mr-angio",
    "gray-ramp",
];

static PRESETS: LazyLock<Vec<Preset>> = LazyLock::new(|| {
    let parse = |(name, text)| serde_json::from_str(text).unwrap_or_else(|e| panic!("config/presets/{name}.json: {e}"));
    FILES.into_iter().map(parse).collect()
});

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::phantom;

    #[test]
    fn every_preset_is_sound_and_named_like_its_file() {
        for ((file, _), preset) in FILES.iter().zip(all()) {
            assert_eq!(*file, preset.name);
            assert_eq!(preset.transfer_function.validate(), [], "{file}");
            assert!(!preset.title.is_empty() && !preset.description.is_empty(), "{file}");
            assert_eq!(get(file), Some(preset));
        }
        assert_eq!(get("no-such-preset"), None);
    }

    #[test]
    fn every_file_in_the_folder_is_embedded() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/config/presets");
        let mut names: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
            .collect();
        names.sort();
        let mut embedded = FILES.map(|(name, _)| name);
        embedded.sort_unstable();
        assert_eq!(names, embedded);
    }

    #[test]
    fn hounsfield_presets_do_not_depend_on_the_spacing() {
        for preset in all() {
            let expected = (preset.values == Values::File).then_some(1.0);
            assert_eq!(preset.transfer_function.opacity_distance, expected, "{}", preset.name);
        }
    }

    #[test]
    fn presets_over_a_range_are_fitted_to_the_volumes_values() {
        let volume = phantom::ball(24, 8.0, 5000.0, 2.0);
        let ramp = get("gray-ramp").unwrap().transfer_function(&volume);
        assert_eq!(ramp.points.first().unwrap().value, 0.0);
        assert_eq!(ramp.points.last().unwrap().value, 5000.0);
    }

    #[test]
    fn every_preset_shows_something_and_something_through_which_one_sees() {
        let head = phantom::head();
        let value = |index: usize| head.value_of_code(f64::from(head.scalars().code(index)));
        // Every 37th voxel is enough to tell.
        let values: Vec<f64> = (0..head.scalars().len()).step_by(37).map(value).collect();
        for preset in all() {
            let transfer = preset.transfer_function(&head);
            let visible = values.iter().filter(|&&v| transfer.opacity(v) > 0.0).count();
            assert!(visible * 1000 > values.len(), "{} shows {visible} of {} voxels", preset.name, values.len());
            assert!(transfer.opacity(-1000.0) < 0.01, "{} shows air", preset.name);
        }
    }
}
