//! The request as it is written: every field, its type, and nothing about ranges.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::{BoolDeserializer, MapAccessDeserializer, StrDeserializer};
use serde::de::{self, Deserialize, Deserializer, MapAccess, Visitor};

use super::AlgorithmChoice;
use crate::classify::TransferFunction;
use crate::render::{BufferSlice, Lookup, OpacityCorrection, Projection, Quality, Sampling, SlabTable, Stage};

#[derive(Default, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Fields {
    pub camera: CameraFields,
    pub image: ImageFields,
    pub transfer_function: Option<Either<String, TransferFunction>>,
    pub shading: Option<Either<bool, ShadingFields>>,
    pub blend: Option<Blend>,
    pub window: Option<WindowFields>,
    pub algorithm: AlgorithmChoice,
    pub quality: Quality,
    pub early_ray_termination: Option<f64>,
    pub min_opacity: Option<f64>,
    pub sample_distance: Option<f64>,
    pub level: Option<u32>,
    pub sampling: Option<Sampling>,
    pub depth_cueing: Option<DepthCueingFields>,
    pub clip: Option<Vec<ClipFields>>,
    pub regions: Option<Vec<RegionFields>>,
    pub labels: Option<LabelsFields>,
    pub geometry: Option<Vec<GeometryFields>>,
    pub preintegration: Option<PreintegrationFields>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraFields {
    pub projection: Option<ProjectionName>,
    pub azimuth: Option<f64>,
    pub elevation: Option<f64>,
    pub roll: Option<f64>,
    pub zoom: Option<f64>,
    pub fov_y: Option<f64>,
    pub target: Option<[f64; 3]>,
    pub look_at: Option<LookAtFields>,
    pub view_height: Option<f64>,
    pub matrices: Option<MatricesFields>,
}

#[derive(Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ProjectionName {
    Parallel,
    Perspective,
}

impl From<ProjectionName> for Projection {
    fn from(name: ProjectionName) -> Self {
        match name {
            ProjectionName::Parallel => Self::Parallel,
            ProjectionName::Perspective => Self::Perspective,
        }
    }
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LookAtFields {
    pub position: [f64; 3],
    pub target: [f64; 3],
    /// Superior unless told.
    pub up: Option<[f64; 3]>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MatricesFields {
    pub view: [f64; 16],
    pub projection: [f64; 16],
}

#[derive(Default, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImageFields {
    pub width: Option<u32>,
    pub height: Option<u32>,
    pub format: Option<String>,
    pub background: Option<String>,
    pub stage: Stage,
}

#[derive(Default, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShadingFields {
    pub ambient: Option<f64>,
    pub diffuse: Option<f64>,
    pub specular: Option<f64>,
    pub shininess: Option<f64>,
    pub lights: Option<Vec<Either<LightName, LightFields>>>,
}

#[derive(serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightName {
    Headlight,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightFields {
    pub direction: [f64; 3],
    pub intensity: Option<f64>,
    pub shadows: Option<bool>,
}

#[derive(Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Blend {
    Composite,
    Maximum,
    Minimum,
    Average,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WindowFields {
    pub center: Option<f64>,
    pub width: Option<f64>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthCueingFields {
    pub front: Option<f64>,
    pub density: Option<f64>,
}

/// A convex region, told in one of several ways.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClipFields {
    pub plane: Option<PlaneFields>,
    pub r#box: Option<BoxFields>,
    pub sphere: Option<SphereFields>,
    pub hull: Option<HullFields>,
    pub keep: Option<Keep>,
}

/// A convex region, and what is shown in another way there.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionFields {
    pub plane: Option<PlaneFields>,
    pub r#box: Option<BoxFields>,
    pub sphere: Option<SphereFields>,
    pub hull: Option<HullFields>,
    pub transfer_function: Option<Either<String, TransferFunction>>,
    /// Factor of the transfer function's opacities.
    pub opacity: Option<f64>,
    pub shading: Option<Either<bool, ShadingFields>>,
    pub blend: Option<Blend>,
    pub window: Option<WindowFields>,
}

/// A segmentation, and what is told of its labels.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelsFields {
    /// The volume of labels.
    pub volume: String,
    #[serde(default)]
    pub looks: Vec<LabelFields>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelFields {
    pub label: u16,
    pub visible: Option<bool>,
    pub color: Option<String>,
    /// Factor of the transfer function's opacities.
    pub opacity: Option<f64>,
    pub transfer_function: Option<Either<String, TransferFunction>>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaneFields {
    pub point: [f64; 3],
    /// Towards the inside.
    pub normal: [f64; 3],
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeometryFields {
    pub mesh: String,
    pub color: Option<String>,
    /// World mm from the mesh's, column by column; affine.
    pub pose: Option<[f64; 16]>,
    pub opacity: Option<f64>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoxFields {
    pub min: [f64; 3],
    pub max: [f64; 3],
    /// From the box's coordinates to the world's, column by column; rigid.
    pub pose: Option<[f64; 16]>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SphereFields {
    pub center: [f64; 3],
    pub radius: f64,
}

/// The convex hull of points, say of a mesh's vertices.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HullFields {
    pub points: Vec<[f64; 3]>,
}

#[derive(Clone, Copy, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Keep {
    #[default]
    Inside,
    Outside,
}

#[derive(Default, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreintegrationFields {
    pub table: Option<SlabTableName>,
    pub entries: Option<u32>,
    pub lookup: Option<Lookup>,
    pub opacity_correction: Option<OpacityCorrection>,
    pub buffer: Option<BufferSlice>,
    pub samples_per_voxel: Option<u32>,
}

#[derive(Clone, Copy, serde::Deserialize)]
pub enum SlabTableName {
    #[serde(rename = "1d")]
    OneDimensional,
    #[serde(rename = "2d")]
    TwoDimensional,
}

impl From<SlabTableName> for SlabTable {
    fn from(name: SlabTableName) -> Self {
        match name {
            SlabTableName::OneDimensional => Self::OneDimensional,
            SlabTableName::TwoDimensional => Self::TwoDimensional,
        }
    }
}

/// A word for short (a name, or true and false), or an object in full.
pub enum Either<Short, Full> {
    Short(Short),
    Full(Full),
}

/// What stands for an object in short.
pub trait Word {
    /// Completes "expected ...".
    const EXPECTED: &'static str;
}

impl Word for bool {
    const EXPECTED: &'static str = "true, false or an object";
}

impl Word for String {
    const EXPECTED: &'static str = "a name or an object";
}

impl Word for LightName {
    const EXPECTED: &'static str = "\"headlight\" or an object";
}

impl<'de, Short: Word + Deserialize<'de>, Full: Deserialize<'de>> Deserialize<'de> for Either<Short, Full> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(EitherVisitor(PhantomData))
    }
}

/// Unlike serde's untagged enums it says which field of `Full` is wrong.
struct EitherVisitor<Short, Full>(PhantomData<(Short, Full)>);

impl<'de, Short: Word + Deserialize<'de>, Full: Deserialize<'de>> Visitor<'de> for EitherVisitor<Short, Full> {
    type Value = Either<Short, Full>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(Short::EXPECTED)
    }

    fn visit_bool<E: de::Error>(self, value: bool) -> Result<Self::Value, E> {
        Short::deserialize(BoolDeserializer::new(value)).map(Either::Short)
    }

    fn visit_str<E: de::Error>(self, value: &str) -> Result<Self::Value, E> {
        Short::deserialize(StrDeserializer::new(value)).map(Either::Short)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        Full::deserialize(MapAccessDeserializer::new(map)).map(Either::Full)
    }
}
