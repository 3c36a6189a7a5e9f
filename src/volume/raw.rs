//! Bare arrays: voxels without a header, described on the command line.

use glam::DVec3;

use super::decode::{DecodeError, Limits};
use super::source::Source;
use super::voxels::{Endian, Header};
use super::{Placement, ScalarType, Volume};

/// What a bare array holds: `NX,NY,NZ,TYPE[,SX,SY,SZ]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawLayout {
    /// Voxels along x (fastest), y, z.
    pub dims: [usize; 3],
    /// Type of the scalars.
    pub scalar_type: ScalarType,
    /// Of a voxel: 1, 3 (red, green, blue) or 4 (and alpha).
    pub components: u8,
    /// True for scalars with the most significant byte first.
    pub big_endian: bool,
    /// Distance between voxel centres in mm.
    pub spacing: DVec3,
}

/// Why a text is not a layout.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RawLayoutError {
    #[error("expected NX,NY,NZ,TYPE[,SX,SY,SZ], got {0:?}")]
    Fields(String),
    #[error("expected a whole number of voxels, got {0:?}")]
    Dimension(String),
    #[error("expected one of u8 i8 u16 i16 u32 i32 f32 f64 u8x3 u8x4, with :be for big endian, got {0:?}")]
    Type(String),
    #[error("expected a spacing above zero in mm, got {0:?}")]
    Spacing(String),
}

impl RawLayout {
    /// Reads `256,256,113,u16:be,1,1,2`: dimensions, type (little endian without `:be`), and the
    /// spacing in mm, 1 where it is left out.
    ///
    /// # Errors
    /// Says which part was expected and what came. Whether the volume can be loaded is told later.
    pub fn parse(text: &str) -> Result<Self, RawLayoutError> {
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let (nx, ny, nz, scalars, spacing) = match parts[..] {
            [nx, ny, nz, scalars] => (nx, ny, nz, scalars, ["1"; 3]),
            [nx, ny, nz, scalars, sx, sy, sz] => (nx, ny, nz, scalars, [sx, sy, sz]),
            _ => return Err(RawLayoutError::Fields(text.to_owned())),
        };
        let dimension = |text: &str| text.parse().map_err(|_| RawLayoutError::Dimension(text.to_owned()));
        let distance = |text: &str| {
            let valid = text.parse().ok().filter(|&mm: &f64| mm.is_finite() && mm > 0.0);
            valid.ok_or_else(|| RawLayoutError::Spacing(text.to_owned()))
        };
        let (name, big_endian) = scalars.strip_suffix(":be").map_or((scalars, false), |name| (name, true));
        let (name, components) = match name {
            "u8x3" => ("u8", 3),
            "u8x4" => ("u8", 4),
            name => (name, 1),
        };
        Ok(Self {
            dims: [dimension(nx)?, dimension(ny)?, dimension(nz)?],
            scalar_type: ScalarType::from_name(name).ok_or_else(|| RawLayoutError::Type(scalars.to_owned()))?,
            components,
            big_endian,
            spacing: DVec3::new(distance(spacing[0])?, distance(spacing[1])?, distance(spacing[2])?),
        })
    }
}

/// Reads an array whose file has exactly the size of the layout: another size means another layout.
pub(super) fn read(source: Source<'_>, layout: &RawLayout, limits: &Limits) -> Result<Volume, DecodeError> {
    let dims = layout.dims.map(|n| n as u64);
    let voxel = layout.scalar_type.size() as u64 * u64::from(layout.components);
    let expected = dims.iter().try_fold(voxel, |bytes, &n| bytes.checked_mul(n));
    if let (Some(expected), Some(got)) = (expected, source.left())
        && expected < got
    {
        let message = format!("raw: expected a file of {expected} bytes for this layout, got {got}");
        return Err(DecodeError::Malformed(message));
    }
    let header = Header {
        format: "raw",
        dims,
        scalar_type: layout.scalar_type,
        endian: if layout.big_endian { Endian::Big } else { Endian::Little },
        placement: Placement::from_spacing(layout.spacing),
        rescale: (1.0, 0.0),
        interleaved: 1,
        components: layout.components.into(),
        following: 0,
        at_end: false,
    };
    header.read_voxels(source, limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layout_is_dimensions_type_and_spacing() {
        let layout = RawLayout::parse("256,256,113,u16:be,1,1,2.5").unwrap();
        let wanted = RawLayout {
            dims: [256, 256, 113],
            scalar_type: ScalarType::U16,
            components: 1,
            big_endian: true,
            spacing: DVec3::new(1.0, 1.0, 2.5),
        };
        assert_eq!(layout, wanted);
        let plain = RawLayout::parse(" 2, 3,4 ,f64").unwrap();
        assert_eq!((plain.dims, plain.big_endian, plain.spacing), ([2, 3, 4], false, DVec3::ONE));
    }

    #[test]
    fn what_is_wrong_with_a_layout_is_said() {
        for (text, message) in [
            ("2,2,2", "expected NX,NY,NZ,TYPE[,SX,SY,SZ]"),
            ("2,2,2,u8,1", "expected NX,NY,NZ,TYPE[,SX,SY,SZ]"),
            ("2,-2,2,u8", "whole number of voxels, got \"-2\""),
            ("2,2,2,u64", "got \"u64\""),
            ("2,2,2,u8x2", "got \"u8x2\""),
            ("2,2,2,u16x4", "got \"u16x4\""),
            ("2,2,2,u8,1,0,1", "above zero in mm, got \"0\""),
            ("2,2,2,u8,1,nan,1", "above zero in mm, got \"nan\""),
            ("", "expected NX,NY,NZ,TYPE[,SX,SY,SZ]"),
        ] {
            let error = RawLayout::parse(text).unwrap_err().to_string();
            assert!(error.contains(message), "{text}: {error}");
        }
    }
}
