//! The choice for a client that names no transfer function.
//!
//! A scan says what it is in two ways: a free text ("CT (micro)", "MR T1"), often missing, and its
//! histogram, often more honest than the text: "CT" is also written on scans that were shifted,
//! windowed to 8 bits or cleaned of their air. So, in this order:
//!
//! 1. Air and soft tissue 1000 apart, as Hounsfield units have them: skin over bone, or vessels for
//!    a CT angiography; shifted where a CT scan was.
//! 2. Hardly anything but background, or another angiography: the angiography preset.
//! 3. Magnetic resonance: the MR overview.
//! 4. Anything else: materials are told apart by Otsu's method on the histogram (N. Otsu: A Threshold
//!    Selection Method from Gray-Level Histograms, 1979; three thresholds here), the lightest one
//!    clear, the densest one opaque.
//!
//! A shifted preset and case 4 are no presets by name; they call themselves [`AUTOMATIC`].

use super::histogram::Histogram;
use super::{Preset, get};
use crate::classify::{Color, ControlPoint, TransferFunction};
use crate::volume::Volume;

/// The name of a choice that is not one of the presets: made for this volume's histogram.
pub const AUTOMATIC: &str = "automatic";

/// What a volume looks like unless told.
#[derive(Clone, Debug, PartialEq)]
pub struct DefaultPreset {
    /// A preset's name, or [`AUTOMATIC`].
    pub name: &'static str,
    /// Fitted to the volume.
    pub transfer: TransferFunction,
    pub shading: bool,
}

/// A transfer function that shows something of this volume, whatever it is. `modality` is free text.
pub fn default_for(volume: &Volume, modality: Option<&str>) -> DefaultPreset {
    if volume.colors().is_some() {
        return DefaultPreset { name: AUTOMATIC, transfer: as_they_are(), shading: false };
    }
    let histogram = Histogram::of(volume);
    let modality = Modality::from_text(modality.unwrap_or_default());
    if let Some(shift) = histogram.hounsfield_shift().filter(|_| modality != Modality::Mr) {
        let preset = named(if modality == Modality::Angiography { "ct-vessels" } else { "ct-skin-and-bone" });
        // Scanners are off by some ten units. Beyond that only a scan that says so is believed.
        if shift.abs() < 100.0 {
            return DefaultPreset::of(preset, volume);
        }
        if modality != Modality::Unknown {
            let mut transfer = preset.transfer_function(volume);
            transfer.points.iter_mut().for_each(|p| p.value += shift);
            return DefaultPreset { name: AUTOMATIC, transfer, shading: preset.shading };
        }
    }
    // Fewer than 3 % of the voxels above the background: nothing hides anything else.
    if modality == Modality::Angiography || histogram.share_at_minimum() > 0.97 {
        return DefaultPreset::of(named("mr-angio"), volume);
    }
    if modality == Modality::Mr {
        return DefaultPreset::of(named("mr-default"), volume);
    }
    DefaultPreset { name: AUTOMATIC, transfer: by_materials(&histogram), shading: true }
}

/// Voxels of colours as opaque as their alpha says, or their luminance.
fn as_they_are() -> TransferFunction {
    let point = |value: u8| ControlPoint {
        value: value.into(),
        opacity: f64::from(value) / 255.0,
        color: Color([f32::from(value) / 255.0; 3]),
    };
    TransferFunction { points: [0, 255].map(point).to_vec(), opacity_distance: None, gradient_opacity: vec![] }
}

impl DefaultPreset {
    fn of(preset: &'static Preset, volume: &Volume) -> Self {
        Self { name: &preset.name, transfer: preset.transfer_function(volume), shading: preset.shading }
    }
}

fn named(name: &str) -> &'static Preset {
    get(name).expect("the choice is among the embedded presets")
}

/// What the text says, as far as it matters here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Modality {
    Angiography,
    Mr,
    Ct,
    Unknown,
}

impl Modality {
    fn from_text(text: &str) -> Self {
        let text = text.to_lowercase();
        let word = |wanted: &[&str]| text.split(|c: char| !c.is_alphanumeric()).any(|w| wanted.contains(&w));
        if text.contains("angio") || word(&["xa", "mra", "cta"]) {
            Self::Angiography
        } else if word(&["mr", "mri"]) || text.contains("magnetic") {
            Self::Mr
        } else if word(&["ct", "cbct"]) || text.contains("tomography") {
            Self::Ct
        } else {
            Self::Unknown
        }
    }
}

/// From the lightest material, a veil, to the densest, opaque; background and the gaps between stay
/// clear. Opacities are per smallest spacing: nothing is known of the units, so take the voxels'.
fn by_materials(histogram: &Histogram) -> TransferFunction {
    let (_, top) = histogram.robust_range();
    let [light, middle, dense] = histogram.otsu_thresholds();
    let between = |a: f64, b: f64, share: f64| a + (b - a) * share;
    let point = |value: f64, opacity: f64, color: u32| {
        let [_, r, g, b] = color.to_be_bytes();
        ControlPoint { value, opacity, color: Color([r, g, b].map(|c| f32::from(c) / 255.0)) }
    };
    let points = vec![
        point(light, 0.0, 0x8a_5f_4a),
        point(between(light, middle, 0.5), 0.025, 0xb9_85_66),
        point(middle, 0.025, 0xd0_a0_7c),
        point(between(middle, dense, 0.3), 0.15, 0xdc_b4_8c),
        point(dense, 0.15, 0xe4_c9_a4),
        point(between(dense, top, 0.3), 0.9, 0xf4_ea_d6),
        point(top, 0.9, 0xff_ff_ff),
    ];
    TransferFunction { points, opacity_distance: None, gradient_opacity: vec![] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{ImportReport, Scalars, phantom};

    /// A ball of `ball` in `background`, the same volume that a scanner with this intercept would give.
    fn scan(background: f64, ball: f64, intercept: f64) -> Volume {
        let share = phantom::ball(32, 12.0, 1000.0, 2.0);
        let Scalars::U16(shares) = share.scalars() else { panic!("phantoms have 16-bit codes") };
        let value = |&s: &u16| background + (ball - background) * f64::from(s) / 1000.0;
        let codes = shares.iter().map(|s| (value(s) - intercept).round() as u16).collect();
        let report = ImportReport::plain("phantom", share.report().scalar_type);
        Volume::new(share.dims(), *share.placement(), Scalars::U16(codes), (1.0, intercept), report).unwrap()
    }

    #[test]
    fn hounsfield_units_are_known_by_their_air_and_tissue() {
        let ct = scan(-1000.0, 40.0, -1024.0);
        assert_eq!(default_for(&ct, Some("CT")).name, "ct-skin-and-bone");
        assert_eq!(default_for(&ct, None).name, "ct-skin-and-bone");
        assert_eq!(default_for(&ct, Some("CT angiography")).name, "ct-vessels");
        assert_eq!(default_for(&ct, Some("MR T1")).name, "mr-default");
    }

    #[test]
    fn a_shifted_ct_scan_gets_the_shifted_preset() {
        let choice = default_for(&scan(24.0, 1064.0, 0.0), Some("CT"));
        assert_eq!(choice.name, AUTOMATIC);
        let preset = &get("ct-skin-and-bone").unwrap().transfer_function;
        for (chosen, preset) in choice.transfer.points.iter().zip(&preset.points) {
            assert!((chosen.value - preset.value - 1024.0).abs() < 50.0, "{chosen:?} for {preset:?}");
            assert_eq!((chosen.opacity, chosen.color), (preset.opacity, preset.color));
        }
    }

    #[test]
    fn materials_without_units_are_told_apart_by_the_histogram() {
        for modality in [None, Some("CT (industrial)")] {
            let choice = default_for(&scan(0.0, 200.0, 0.0), modality);
            assert_eq!(choice.name, AUTOMATIC);
            assert_eq!(choice.transfer.validate(), []);
            assert_eq!(choice.transfer.opacity(0.0), 0.0);
            assert!(choice.transfer.opacity(200.0) > 0.5);
        }
    }

    #[test]
    fn sparse_volumes_and_angiographies_get_the_angiography_preset() {
        assert_eq!(default_for(&phantom::ball(64, 8.0, 200.0, 1.0), None).name, "mr-angio");
        assert_eq!(default_for(&scan(0.0, 200.0, 0.0), Some("rotational C-arm X-ray angiography")).name, "mr-angio");
    }

    #[test]
    fn a_volume_of_one_value_still_gets_a_sound_transfer_function() {
        let choice = default_for(&phantom::uniform([4; 3], 9.0), Some("CT"));
        assert_eq!(choice.transfer.validate(), []);
    }

    #[test]
    fn modalities_are_read_from_free_text() {
        let expected = [
            ("CT (micro)", Modality::Ct),
            ("MR T1", Modality::Mr),
            ("rotational C-arm X-ray angiography", Modality::Angiography),
            ("Computed Tomography", Modality::Ct),
            ("spectral", Modality::Unknown),
            ("", Modality::Unknown),
        ];
        for (text, modality) in expected {
            assert_eq!(Modality::from_text(text), modality, "{text}");
        }
    }
}
