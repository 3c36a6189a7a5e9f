//! Bytes -> [`Volume`]: what was measured, and the structures that depend on nothing else.
//!
//! A volume is a box of scalars with a place in the world (LPS millimetres). Scalars are kept as
//! unsigned codes of 8 or 16 bits with an affine rescale to the file's own units, so that every
//! kernel knows two voxel types only and every table over scalars is a plain array over codes.

pub mod decode;
pub mod gradient;
pub mod histogram;
pub mod octree;
pub mod phantom;
pub mod pyramid;
pub mod scanlines;

mod metaimage;
mod narrow;
mod nifti;
mod nrrd;
mod prepared;
mod raw;
mod source;
mod text;
mod voxels;

pub use prepared::{PrepareTimings, PreparedVolume};

use glam::{DMat3, DMat4, DVec3};
use rayon::prelude::*;

use crate::simd::{self, Kernel};
use gradient::Code;

/// The scalar type that a file stored, before narrowing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ScalarType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl ScalarType {
    /// Bytes of one scalar.
    pub const fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The name used by the API and the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// The type with this [`ScalarType::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::U8, Self::I8, Self::U16, Self::I16, Self::U32, Self::I32, Self::F32, Self::F64]
            .into_iter()
            .find(|t| t.name() == name)
    }
}

/// Voxel codes, `i` fastest, then `j`, then `k`. A voxel's value is [`Volume::value_of_code`].
#[derive(Clone, Debug, PartialEq)]
pub enum Scalars {
    U8(Vec<u8>),
    U16(Vec<u16>),
}

impl Scalars {
    /// Number of voxels.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::U16(v) => v.len(),
        }
    }

    /// True for a volume without voxels (which [`Volume::new`] refuses).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of memory that the codes take.
    pub fn bytes(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::U16(v) => 2 * v.len(),
        }
    }

    /// The code of voxel `index`.
    pub fn code(&self, index: usize) -> u16 {
        match self {
            Self::U8(v) => u16::from(v[index]),
            Self::U16(v) => v[index],
        }
    }
}

/// Colours that voxels have of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Colors {
    /// Red, green and blue, not premultiplied, 255 = 1, and the voxel's code; `i` fastest.
    pub voxels: Vec<[u8; 4]>,
    /// Where opacity comes from: alpha if the voxels have one, else their luminance.
    pub has_alpha: bool,
}

impl Colors {
    /// Luma of red, green and blue (ITU-R BT.709), rounded.
    pub fn luminance([r, g, b]: [u8; 3]) -> u8 {
        const WEIGHTS: [u32; 3] = [13_933, 46_871, 4_732];
        let sum: u32 = WEIGHTS.iter().zip([r, g, b]).map(|(weight, component)| weight * u32::from(component)).sum();
        ((sum + (1 << 15)) >> 16) as u8
    }
}

/// Where the voxels stand in the world: LPS millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Distance between voxel centres along i, j, k in mm; positive and finite.
    pub spacing: DVec3,
    /// Columns are the directions of i, j, k; of unit length, invertible, of either handedness.
    pub direction: DMat3,
    /// Centre of voxel (0, 0, 0) in mm.
    pub origin: DVec3,
}

impl Placement {
    /// Origin 0, identity direction: what a file without orientation gets.
    pub fn from_spacing(spacing: DVec3) -> Self {
        Self { spacing, direction: DMat3::IDENTITY, origin: DVec3::ZERO }
    }
}

/// What happened to the scalars on their way into memory; for reports, not for rendering.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportReport {
    /// The type in the file.
    pub scalar_type: ScalarType,
    /// NaN and infinite scalars that became the smallest finite value.
    pub non_finite: u64,
    /// True where a wider type was mapped to 16 bits with a step that is not exact.
    pub quantized: bool,
    /// Volumes of a 4D file that were left out (the first one is used).
    pub volumes_left_out: u64,
    /// Name of the format ("NIfTI-1", "NRRD", "MetaImage", "raw", "phantom").
    pub format: &'static str,
}

impl ImportReport {
    /// A report of scalars taken as they were.
    pub fn plain(format: &'static str, scalar_type: ScalarType) -> Self {
        Self { scalar_type, non_finite: 0, quantized: false, volumes_left_out: 0, format }
    }
}

/// Why voxels and a placement do not make a volume.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum VolumeError {
    #[error("dimensions must be 2 to {max} along each axis, got {dims:?}", max = Volume::MAX_DIMENSION)]
    Dimensions { dims: [usize; 3] },
    #[error("dimensions {dims:?} ask for {expected} voxels, got {got}")]
    VoxelCount { dims: [usize; 3], expected: usize, got: usize },
    #[error("spacing must be positive and finite, got {0:?}")]
    Spacing([f64; 3]),
    #[error("direction must be finite, with unit columns that span space, got columns {0:?}")]
    Direction([[f64; 3]; 3]),
    #[error("origin must be finite, got {0:?}")]
    Origin([f64; 3]),
    #[error("rescale must be finite with a slope above zero, got slope {slope}, intercept {intercept}")]
    Rescale { slope: f64, intercept: f64 },
}

/// A scalar field on a regular grid, with its place in the world. A colour volume's scalars are what its opacity follows from
/// ([`Colors`]), 0 to 255.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    dims: [usize; 3],
    placement: Placement,
    scalars: Scalars,
    colors: Option<Colors>,
    slope: f64,
    intercept: f64,
    code_range: (u16, u16),
    report: ImportReport,
}

impl Volume {
    /// Voxels along one axis at most: run starts and lengths are kept in 16 bits.
    pub const MAX_DIMENSION: usize = 32_767;

    /// A volume of `dims` = (nx, ny, nz) voxels; value = intercept + slope * code.
    ///
    /// # Errors
    /// Where a dimension is below 2 or above [`Self::MAX_DIMENSION`], the voxels do not match the
    /// dimensions, or the placement or rescale is not finite and invertible.
    pub fn new(
        dims: [usize; 3],
        placement: Placement,
        scalars: Scalars,
        (slope, intercept): (f64, f64),
        report: ImportReport,
    ) -> Result<Self, VolumeError> {
        if dims.iter().any(|&n| !(2..=Self::MAX_DIMENSION).contains(&n)) {
            return Err(VolumeError::Dimensions { dims });
        }
        let expected = dims.iter().product();
        if scalars.len() != expected {
            return Err(VolumeError::VoxelCount { dims, expected, got: scalars.len() });
        }
        let Placement { spacing, direction, origin } = placement;
        if !(spacing.is_finite() && spacing.min_element() > 0.0) {
            return Err(VolumeError::Spacing(spacing.to_array()));
        }
        let unit =
            [direction.x_axis, direction.y_axis, direction.z_axis].iter().all(|c| (c.length() - 1.0).abs() < 1e-3);
        if !(direction.is_finite() && unit && direction.determinant().abs() > 1e-3) {
            return Err(VolumeError::Direction(direction.to_cols_array_2d()));
        }
        if !origin.is_finite() {
            return Err(VolumeError::Origin(origin.to_array()));
        }
        if !(slope.is_finite() && slope > 0.0 && intercept.is_finite()) {
            return Err(VolumeError::Rescale { slope, intercept });
        }
        let code_range = code_range(&scalars);
        Ok(Self { dims, placement, scalars, colors: None, slope, intercept, code_range, report })
    }

    /// A volume whose voxels have colours of their own.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_colors(
        dims: [usize; 3],
        placement: Placement,
        colors: Colors,
        report: ImportReport,
    ) -> Result<Self, VolumeError> {
        let codes = colors.voxels.iter().map(|voxel| voxel[3]).collect();
        let volume = Self::new(dims, placement, Scalars::U8(codes), (1.0, 0.0), report)?;
        Ok(Self { colors: Some(colors), ..volume })
    }

    /// Voxels along i, j, k.
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Where the voxels stand.
    pub fn placement(&self) -> &Placement {
        &self.placement
    }

    /// The voxels' codes, `i` fastest.
    pub fn scalars(&self) -> &Scalars {
        &self.scalars
    }

    /// The voxels' own colours, if they have any.
    pub fn colors(&self) -> Option<&Colors> {
        self.colors.as_ref()
    }

    /// Components of a voxel: 1 (scalars), 3 (colours) or 4 (colours and opacity).
    pub fn components(&self) -> u8 {
        self.colors.as_ref().map_or(1, |colors| if colors.has_alpha { 4 } else { 3 })
    }

    /// How the scalars came in.
    pub fn report(&self) -> &ImportReport {
        &self.report
    }

    /// (slope, intercept) of value = intercept + slope * code.
    pub fn rescale(&self) -> (f64, f64) {
        (self.slope, self.intercept)
    }

    /// The file's own value of a code (fractional where it was interpolated).
    pub fn value_of_code(&self, code: f64) -> f64 {
        self.intercept + self.slope * code
    }

    /// Smallest and largest code in the volume.
    pub fn code_range(&self) -> (u16, u16) {
        self.code_range
    }

    /// Smallest and largest value in the volume, in the file's own units.
    pub fn value_range(&self) -> (f64, f64) {
        let (low, high) = self.code_range;
        (self.value_of_code(f64::from(low)), self.value_of_code(f64::from(high)))
    }

    /// The smallest of the three spacings in mm: the default reference length of opacities.
    pub fn smallest_spacing(&self) -> f64 {
        self.placement.spacing.min_element()
    }

    /// World mm of voxel index coordinates.
    pub fn world_from_index(&self) -> DMat4 {
        let Placement { spacing, direction, origin } = self.placement;
        let linear = direction * DMat3::from_diagonal(spacing);
        DMat4::from_cols(
            linear.x_axis.extend(0.0),
            linear.y_axis.extend(0.0),
            linear.z_axis.extend(0.0),
            origin.extend(1.0),
        )
    }

    /// Middle of the box of voxel centres, world mm.
    pub fn centre(&self) -> DVec3 {
        let last = DVec3::from_array(self.dims.map(|n| (n - 1) as f64));
        self.world_from_index().transform_point3(last / 2.0)
    }

    /// Half the diagonal of the box of voxel centres, mm. Conventions measure it along i, j, k,
    /// as for an orthogonal direction matrix.
    pub fn radius(&self) -> f64 {
        let last = DVec3::from_array(self.dims.map(|n| (n - 1) as f64));
        (last * self.placement.spacing).length() / 2.0
    }
}

/// Smallest and largest code.
fn code_range(scalars: &Scalars) -> (u16, u16) {
    fn range<T: Code>(codes: &[T]) -> (u16, u16) {
        let parts = codes.par_chunks(1 << 18).map(|codes| simd::dispatch(CodeRange(codes)));
        parts.reduce_with(|a, b| (a.0.min(b.0), a.1.max(b.1))).map_or((0, 0), |(low, high)| (low.into(), high.into()))
    }
    match scalars {
        Scalars::U8(v) => range(v),
        Scalars::U16(v) => range(v),
    }
}

/// Codes whose smallest and largest are wanted.
struct CodeRange<'a, T>(&'a [T]);

impl<T: Code> Kernel for CodeRange<'_, T> {
    type Output = (T, T);

    #[inline(always)]
    fn run(self) -> (T, T) {
        self.0.iter().fold((T::MAX, T::default()), |(low, high), &code| (code.min(low), code.max(high)))
    }
}
