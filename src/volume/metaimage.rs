//! MetaImage (.mha, .mhd): `Key = Value` lines, the last of which says where the voxels are.
//!
//! Its world is LPS millimetres already. The rows of `TransformMatrix` are the directions of the
//! axes (so they are the columns of our matrix), as ITK writes them.

use glam::{DMat3, DVec3};

use super::decode::{DecodeError, Limits};
use super::source::Source;
use super::text::TextFields;
use super::voxels::{Endian, Header, placement_from_steps};
use super::{Placement, ScalarType, Volume};

const MAX_AXES: usize = 10;

/// True where the first line is `Key = …` with a key that MetaImage files begin with.
pub(super) fn sniff(head: &[u8]) -> bool {
    const FIRST_KEYS: [&str; 5] = ["ObjectType", "NDims", "Comment", "ObjectSubType", "Name"];
    let line = head.split(|&byte| byte == b'\n').next().unwrap_or(head);
    let key = line.split(|&byte| byte == b'=').next().filter(|key| key.len() < line.len());
    key.is_some_and(|key| FIRST_KEYS.iter().any(|first| key.trim_ascii() == first.as_bytes()))
}

/// Reads the header, then the voxels that follow it or stand in the data file that it names.
pub(super) fn read(mut source: Source<'_>, limits: &Limits) -> Result<Volume, DecodeError> {
    let fields = read_fields(&mut source)?;
    let mut header = header(&fields)?;
    let name = fields.required(&["elementdatafile"])?;
    let mut data = match name {
        "LOCAL" | "Local" | "local" => source,
        _ if name.starts_with("LIST") || name.contains('%') => {
            return Err(fields.unsupported(&format!("expected one data file, got {name:?}")));
        }
        _ => source.companion(name)?,
    };
    match fields.number(&["headersize"])?.unwrap_or(0) {
        -1 => header.at_end = true,
        skip => {
            let skip = u64::try_from(skip).map_err(|_| fields.malformed(&format!("HeaderSize: got {skip}")))?;
            data.skip(skip)?;
        }
    }
    if flag(&fields, &["compresseddata"])?.unwrap_or(false) {
        data = if data.peek(2)? == Source::GZIP_MAGIC { data.gunzip() } else { data.inflate() };
    }
    header.read_voxels(data, limits)
}

/// The fields up to `ElementDataFile`, which is the last by definition.
fn read_fields(source: &mut Source<'_>) -> Result<TextFields, DecodeError> {
    let mut fields = TextFields::new("MetaImage");
    while let Some(line) = source.text_line()? {
        if line.trim().is_empty() {
            continue;
        }
        let field = line.split_once('=');
        let (name, value) =
            field.ok_or_else(|| fields.malformed(&format!("expected \"Key = Value\", got {line:?}")))?;
        let name = name.trim().to_ascii_lowercase();
        let last = name == "elementdatafile";
        fields.set(name, value);
        if last {
            break;
        }
    }
    Ok(fields)
}

/// Everything but the place of the data.
fn header(fields: &TextFields) -> Result<Header, DecodeError> {
    let axis_count: usize = fields.number(&["ndims"])?.ok_or_else(|| fields.malformed("expected NDims"))?;
    if !(3..=MAX_AXES).contains(&axis_count) {
        return Err(fields.unsupported(&format!("expected 3 to {MAX_AXES} dimensions, got {axis_count}")));
    }
    let channels: u64 = fields.number(&["elementnumberofchannels"])?.unwrap_or(1);
    if ![1, 3, 4].contains(&channels) {
        return Err(fields.unsupported(&format!("expected 1 channel, or 3 or 4 of colours, got {channels}")));
    }
    if flag(fields, &["binarydata"])? == Some(false) {
        return Err(fields.unsupported("expected binary data, got BinaryData = False"));
    }
    let sizes: Vec<u64> =
        fields.numbers(&["dimsize"], axis_count)?.ok_or_else(|| fields.malformed("expected DimSize"))?;
    let volumes =
        sizes[3..].iter().try_fold(1_u64, |product, &n| product.checked_mul(n)).filter(|&volumes| volumes > 0);
    let volumes = volumes.ok_or_else(|| fields.malformed(&format!("expected positive sizes, got {sizes:?}")))?;
    let big = flag(fields, &["elementbyteordermsb", "binarydatabyteordermsb"])?.unwrap_or(false);
    Ok(Header {
        format: "MetaImage",
        dims: [sizes[0], sizes[1], sizes[2]],
        scalar_type: scalar_type(fields)?,
        endian: if big { Endian::Big } else { Endian::Little },
        placement: placement(fields, axis_count)?,
        rescale: (1.0, 0.0),
        interleaved: 1,
        components: channels,
        following: volumes - 1,
        at_end: false,
    })
}

/// Spacing, directions and origin: the first three components of each.
fn placement(fields: &TextFields, axis_count: usize) -> Result<Placement, DecodeError> {
    let first3 = |numbers: &[f64]| DVec3::new(numbers[0], numbers[1], numbers[2]);
    let spacing: Option<Vec<f64>> = fields.numbers(&["elementspacing", "elementsize"], axis_count)?;
    let spacing = spacing.map_or(DVec3::ONE, |spacing| first3(&spacing));
    let origin: Option<Vec<f64>> = fields.numbers(&["offset", "position", "origin"], axis_count)?;
    let origin = origin.map_or(DVec3::ZERO, |origin| first3(&origin));
    let names = ["transformmatrix", "rotation", "orientation"];
    let Some(matrix) = fields.numbers::<f64>(&names, axis_count * axis_count)? else {
        return Ok(Placement { origin, ..Placement::from_spacing(spacing) });
    };
    let axis = |n: usize| first3(&matrix[n * axis_count..]);
    // A negative spacing would turn an axis round without anybody having said so.
    if spacing.min_element() <= 0.0 {
        return Err(fields.malformed(&format!("expected positive spacings, got {spacing}")));
    }
    let steps = DMat3::from_cols(axis(0), axis(1), axis(2)) * DMat3::from_diagonal(spacing);
    Ok(placement_from_steps(steps, origin))
}

/// A truth value, `None` where the field is absent.
fn flag(fields: &TextFields, names: &[&str]) -> Result<Option<bool>, DecodeError> {
    match fields.get(names).map(str::to_ascii_lowercase).as_deref() {
        None => Ok(None),
        Some("true" | "t" | "1") => Ok(Some(true)),
        Some("false" | "f" | "0") => Ok(Some(false)),
        Some(other) => Err(fields.malformed(&format!("{}: expected True or False, got {other:?}", names[0]))),
    }
}

/// The scalar type of `ElementType`. MetaImage's LONG has 4 bytes on every machine.
fn scalar_type(fields: &TextFields) -> Result<ScalarType, DecodeError> {
    match fields.required(&["elementtype"])? {
        "MET_UCHAR" => Ok(ScalarType::U8),
        "MET_CHAR" => Ok(ScalarType::I8),
        "MET_USHORT" => Ok(ScalarType::U16),
        "MET_SHORT" => Ok(ScalarType::I16),
        "MET_UINT" | "MET_ULONG" => Ok(ScalarType::U32),
        "MET_INT" | "MET_LONG" => Ok(ScalarType::I32),
        "MET_FLOAT" => Ok(ScalarType::F32),
        "MET_DOUBLE" => Ok(ScalarType::F64),
        other => Err(fields.unsupported(&format!("expected an ElementType such as MET_SHORT, got {other:?}"))),
    }
}
