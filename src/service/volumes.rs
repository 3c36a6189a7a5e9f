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
            components: 1,
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
