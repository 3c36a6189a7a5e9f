//! What is known about volumes.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, RawQuery, State};
use serde::Serialize;

use super::App;
use super::error::Problem;
use super::store::{Entry, LoadedVolume, Status};
use crate::classify::TransferFunction;
use crate::volume::pyramid;

/// Bins of a histogram at most: one per code of a 12-bit scan.
const MAX_BINS: usize = 4096;

/// Bins unless told.
const DEFAULT_BINS: usize = 256;

#[derive(Serialize)]
pub struct VolumeList {
    volumes: Vec<VolumeBody>,
}

#[derive(Serialize)]
pub struct VolumeBody {
    id: String,
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    modality: Option<String>,
    status: &'static str,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    detail: Option<String>,
    /// Of a ready volume.
    #[serde(flatten)]
    facts: Option<Facts>,
}

/// What is known once a volume is in memory. Lengths in mm, LPS.
#[derive(Serialize)]
struct Facts {
    dimensions: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    /// Row-major.
    direction: [f64; 9],
    scalar_type: &'static str,
    components: u8,
    /// Of the pyramid.
    levels: usize,
    value_range: [f64; 2],
    default_preset: &'static str,
    import: Import,
    bytes: BTreeMap<&'static str, u64>,
}

#[derive(Serialize)]
struct Import {
    format: &'static str,
    non_finite: u64,
    quantized: bool,
    volumes_left_out: u64,
}

#[derive(Serialize)]
pub struct HistogramBody {
    bins: usize,
    min: f64,
    max: f64,
    counts: Vec<u64>,
}

/// A transfer function as frames of one volume have it.
#[derive(Serialize)]
pub struct FittedBody {
    /// A preset's name, or `automatic`.
    preset: String,
    shading: bool,
    transfer_function: TransferFunction,
}

/// `GET /v1/volumes`
pub async fn list(State(app): State<Arc<App>>) -> Json<VolumeList> {
    Json(VolumeList { volumes: app.store.entries().map(|entry| VolumeBody::of(entry)).collect() })
}

/// `GET /v1/volumes/{id}`
pub async fn one(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<VolumeBody>, Problem> {
    Ok(Json(VolumeBody::of(app.store.entry(&id?)?)))
}

/// `GET /v1/volumes/{id}/histogram`
pub async fn histogram(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
    RawQuery(query): RawQuery,
) -> Result<Json<HistogramBody>, Problem> {
    let volume = app.store.loaded(&id?)?;
    let bins = read_bins(query.as_deref().unwrap_or_default())?;
    let counted = volume.histogram.bins(volume.volume(), bins);
    Ok(Json(HistogramBody { bins, min: counted.min, max: counted.max, counts: counted.counts }))
}

/// `GET /v1/volumes/{id}/transfer-function`: what a preset's name, or none, stands for on this
/// volume, so that a client can start from it.
pub async fn transfer_function(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
    RawQuery(query): RawQuery,
) -> Result<Json<FittedBody>, Problem> {
    let volume = app.store.loaded(&id?)?;
    let (preset, shading, fitted) = match read_preset(query.as_deref().unwrap_or_default())? {
        None => {
            let default = &volume.presets.default;
            (default.name, default.shading, &default.transfer)
        }
        Some(name) => {
            let unknown =
                || Problem::refused("/preset", format!("unknown preset {name:?}; GET /v1/presets lists them"));
            let (preset, fitted) = volume.presets.get(&name).ok_or_else(unknown)?;
            (preset.name.as_str(), preset.shading, fitted)
        }
    };
    let mut transfer_function = fitted.clone();
    let reference = fitted.reference_length(volume.volume().smallest_spacing());
    transfer_function.opacity_distance = Some(reference);
    Ok(Json(FittedBody { preset: preset.into(), shading, transfer_function }))
}

fn read_preset(query: &str) -> Result<Option<String>, Problem> {
    let mut preset = None;
    for (name, text) in form_urlencoded::parse(query.as_bytes()) {
        if name != "preset" || preset.is_some() {
            return Err(Problem::refused(format!("/{name}"), "expected at most one parameter, preset"));
        }
        preset = Some(text.into_owned());
    }
    Ok(preset)
}

fn read_bins(query: &str) -> Result<usize, Problem> {
    let mut bins = None;
    for (name, text) in form_urlencoded::parse(query.as_bytes()) {
        if name != "bins" || bins.is_some() {
            return Err(Problem::refused(format!("/{name}"), "expected one parameter, bins"));
        }
        let number = text.parse().ok().filter(|n| (1..=MAX_BINS).contains(n));
        let expected =
            || Problem::refused("/bins", format!("expected a whole number from 1 to {MAX_BINS}, got {text:?}"));
        bins = Some(number.ok_or_else(expected)?);
    }
    Ok(bins.unwrap_or(DEFAULT_BINS))
}

impl VolumeBody {
    fn of(entry: &Entry) -> Self {
        let (status, detail, facts) = match entry.status() {
            Status::Loading => ("loading", None, None),
            Status::Failed(reason) => ("failed", Some(reason), None),
            Status::Ready(volume) => ("ready", None, Some(Facts::of(&volume))),
        };
        let (id, name, modality) = (entry.id.clone(), entry.name.clone(), entry.modality.clone());
        Self { id, name, modality, status, detail, facts }
    }
}

impl Facts {
    fn of(loaded: &LoadedVolume) -> Self {
        let volume = loaded.volume();
        let (placement, report) = (volume.placement(), volume.report());
        let (low, high) = volume.value_range();
        Self {
            dimensions: volume.dims(),
            spacing: placement.spacing.to_array(),
            origin: placement.origin.to_array(),
            direction: placement.direction.transpose().to_cols_array(),
            scalar_type: report.scalar_type.name(),
            components: volume.components(),
            levels: pyramid::levels(volume.dims()),
            value_range: [low, high],
            default_preset: loaded.presets.default.name,
            import: Import {
                format: report.format,
                non_finite: report.non_finite,
                quantized: report.quantized,
                volumes_left_out: report.volumes_left_out,
            },
            bytes: loaded.bytes().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_a_number_in_range_and_nothing_else_is_taken() {
        assert_eq!(read_bins("").unwrap(), 256);
        assert_eq!(read_bins("bins=4096").unwrap(), 4096);
        for bad in ["bins=0", "bins=4097", "bins=", "bins=1.5", "bins=x", "bin=3", "bins=3&bins=4", "bins=-1"] {
            assert!(matches!(read_bins(bad), Err(Problem::Refused(_))), "{bad}");
        }
    }
}
