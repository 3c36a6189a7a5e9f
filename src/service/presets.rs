//! The transfer functions that ship with the program.

use axum::Json;
use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use serde::Serialize;

use super::error::Problem;
use crate::classify::presets::{self, Preset};

#[derive(Serialize)]
pub struct PresetList {
    presets: &'static [Preset],
}

/// `GET /v1/presets`
pub async fn list() -> Json<PresetList> {
    Json(PresetList { presets: presets::all() })
}

/// `GET /v1/presets/{name}`
pub async fn one(name: Result<Path<String>, PathRejection>) -> Result<Json<&'static Preset>, Problem> {
    let Path(name) = name?;
    presets::get(&name).map(Json).ok_or(Problem::NoSuchPreset(name))
}
