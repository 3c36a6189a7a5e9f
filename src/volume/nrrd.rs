//! NRRD: attached and detached headers, raw and gzip data (teem.sourceforge.net/nrrd/format.html).
//!
//! A NRRD has axes rather than dimensions, and three of them must be space. The others (a list, or
//! time) number volumes, of which the first is taken; they may stand before the spatial axes, and
//! then the volumes are interleaved. A first axis of three or four colours makes a colour volume; other vectors are refused,
//! because their first component would be a picture of something else.

use glam::{DMat3, DVec3};

use super::decode::{DecodeError, Limits};
use super::source::Source;
use super::text::TextFields;
use super::voxels::{Endian, Header, placement_from_steps};
use super::{Placement, ScalarType, Volume};

const MAGIC: &[u8] = b"NRRD000";
/// As in teem's own reader.
const MAX_AXES: usize = 16;

/// True for the first bytes of a NRRD.
pub(super) fn sniff(head: &[u8]) -> bool {
    head.starts_with(MAGIC)
}

/// Reads the header, then the voxels that follow it or stand in the data file that it names.
pub(super) fn read(mut source: Source<'_>, limits: &Limits) -> Result<Volume, DecodeError> {
    let fields = read_fields(&mut source)?;
    let mut header = header(&fields)?;
    let mut data = match fields.get(&["datafile"]) {
        None => source,
        Some(name) if name == "LIST" || name.starts_with("LIST ") || name.contains('%') => {
            return Err(fields.unsupported(&format!("expected one data file, got {name:?}")));
        }
        Some(name) => source.companion(name)?,
    };
    data.skip_lines(fields.number(&["lineskip"])?.unwrap_or(0))?;
    let encoding = fields.required(&["encoding"])?.to_ascii_lowercase();
    data = match encoding.as_str() {
        "raw" => data,
        "gzip" | "gz" => data.gunzip(),
        _ => return Err(fields.unsupported(&format!("expected the encoding raw or gzip, got {encoding:?}"))),
    };
    match fields.number(&["byteskip"])?.unwrap_or(0) {
        -1 => header.at_end = true,
        skip => {
            let skip = u64::try_from(skip).map_err(|_| fields.malformed(&format!("byte skip: got {skip}")))?;
            data.skip(skip)?;
        }
    }
    header.read_voxels(data, limits)
}

/// The fields up to the blank line, or the end of a detached header. Their names lose their spaces:
/// `data file` and `datafile` are the same.
fn read_fields(source: &mut Source<'_>) -> Result<TextFields, DecodeError> {
    let mut fields = TextFields::new("NRRD");
    source.text_line()?; // the magic
    while let Some(line) = source.text_line()?.filter(|line| !line.is_empty()) {
        // Comments and key:=value pairs say nothing about the voxels.
        if line.starts_with('#') || line.contains(":=") {
            continue;
        }
        let field = line.split_once(':');
        let (name, value) =
            field.ok_or_else(|| fields.malformed(&format!("expected \"field: value\", got {line:?}")))?;
        fields.set(name.to_ascii_lowercase().replace(' ', ""), value);
    }
    Ok(fields)
}

/// Everything but the place of the data.
fn header(fields: &TextFields) -> Result<Header, DecodeError> {
    let axis_count: usize = fields.number(&["dimension"])?.ok_or_else(|| fields.malformed("expected a dimension"))?;
    if !(3..=MAX_AXES).contains(&axis_count) {
        return Err(fields.unsupported(&format!("expected 3 to {MAX_AXES} axes, got {axis_count}")));
    }
    let sizes: Vec<u64> = fields.numbers(&["sizes"], axis_count)?.ok_or_else(|| fields.malformed("expected sizes"))?;
    if sizes.contains(&0) {
        return Err(fields.malformed(&format!("expected positive sizes, got {sizes:?}")));
    }
    let steps = space_directions(fields, axis_count)?;
    let first = first_spatial_axis(fields, axis_count, steps.as_deref())?;
    let product = |sizes: &[u64]| sizes.iter().try_fold(1_u64, |product, &n| product.checked_mul(n));
    let overflow = || fields.malformed(&format!("expected sizes with a product below 2^64, got {sizes:?}"));
    let components = components(fields).unwrap_or(1);
    if components > 1 && first != 1 {
        return Err(fields.unsupported("expected the axis of colours first, and three axes of space behind it"));
    }
    let interleaved = product(&sizes[..first]).ok_or_else(overflow)? / components;
    let volumes = product(&sizes[first + 3..]).ok_or_else(overflow)?;
    let scalar_type = scalar_type(fields)?;
    Ok(Header {
        format: "NRRD",
        dims: [sizes[first], sizes[first + 1], sizes[first + 2]],
        scalar_type,
        endian: endian(fields, scalar_type)?,
        placement: placement(fields, axis_count, first, steps.as_deref())?,
        rescale: (1.0, 0.0),
        interleaved,
        components,
        following: volumes - 1,
        at_end: false,
    })
}

/// `space directions`: one step per axis, `None` for an axis that is not space.
fn space_directions(fields: &TextFields, axis_count: usize) -> Result<Option<Vec<Option<DVec3>>>, DecodeError> {
    let Some(text) = fields.get(&["spacedirections"]) else { return Ok(None) };
    let wrong =
        || fields.malformed(&format!("space directions: expected {axis_count} 3D vectors or none, got {text:?}"));
    let mut steps = Vec::new();
    let mut rest = text.trim_start();
    while !rest.is_empty() {
        rest = if let Some(rest) = rest.strip_prefix("none") {
            steps.push(None);
            rest
        } else {
            let (vector, rest) = rest.split_once(')').ok_or_else(wrong)?;
            steps.push(Some(vector3(vector).ok_or_else(wrong)?));
            rest
        }
        .trim_start();
    }
    if steps.len() != axis_count {
        return Err(wrong());
    }
    Ok(Some(steps))
}

/// The numbers of `(x, y, z`.
fn vector3(text: &str) -> Option<DVec3> {
    let numbers: Option<Vec<f64>> = text.trim().strip_prefix('(')?.split(',').map(|n| n.trim().parse().ok()).collect();
    <[f64; 3]>::try_from(numbers?).ok().map(DVec3::from_array)
}

/// The first of the three axes of space, which must be neighbours; the others must be lists.
fn first_spatial_axis(
    fields: &TextFields,
    axis_count: usize,
    steps: Option<&[Option<DVec3>]>,
) -> Result<usize, DecodeError> {
    let kinds: Vec<&str> = fields.get(&["kinds"]).map_or_else(Vec::new, |kinds| kinds.split_whitespace().collect());
    if !kinds.is_empty() && kinds.len() != axis_count {
        return Err(fields.malformed(&format!("expected {axis_count} kinds, got {kinds:?}")));
    }
    let kind = |axis: usize| kinds.get(axis).copied().unwrap_or("???").to_ascii_lowercase();
    let list = |axis: usize| ["list", "time", "scalar", "stub"].contains(&kind(axis).as_str());
    let of_colors = |axis: usize| axis == 0 && components(fields).is_some();
    if let Some(axis) = (0..axis_count).find(|&axis| {
        !list(axis) && !of_colors(axis) && !["domain", "space", "none", "???"].contains(&kind(axis).as_str())
    }) {
        return Err(fields.unsupported(&format!("expected scalars or colours, got an axis of kind {}", kinds[axis])));
    }
    // Directions say which axes are space; else kinds do; else the first three are.
    let spatial: Vec<usize> = match steps {
        Some(steps) => (0..axis_count).filter(|&axis| steps[axis].is_some()).collect(),
        None => (0..axis_count).filter(|&axis| !list(axis) && !of_colors(axis)).take(3).collect(),
    };
    match spatial[..] {
        [i, j, k] if j == i + 1 && k == i + 2 => Ok(i),
        _ => Err(fields.unsupported(&format!("expected three neighbouring axes of space, got axes {spatial:?}"))),
    }
}

/// Components of a voxel that is a colour: what `kinds` calls one, or a vector of as many, on the first axis.
fn components(fields: &TextFields) -> Option<u64> {
    let kinds = fields.get(&["kinds"])?.to_ascii_lowercase();
    let size = fields.get(&["sizes"])?.split_whitespace().next()?.parse().ok()?;
    let of_size = match kinds.split_whitespace().next()? {
        "rgb-color" | "3-color" | "3-vector" => [3, 3],
        "rgba-color" | "4-color" | "4-vector" => [4, 4],
        "vector" => [3, 4],
        _ => return None,
    };
    of_size.contains(&size).then_some(size)
}

/// Where the voxels stand: `space directions` in `space`, else the `spacings` alone.
fn placement(
    fields: &TextFields,
    axis_count: usize,
    first: usize,
    steps: Option<&[Option<DVec3>]>,
) -> Result<Placement, DecodeError> {
    let Some(steps) = steps else {
        let spacings: Option<Vec<f64>> = fields.numbers(&["spacings"], axis_count)?;
        let mm = |axis: usize| spacings.as_ref().map(|all| all[axis]).filter(|mm| !mm.is_nan()).unwrap_or(1.0);
        return Ok(Placement::from_spacing(DVec3::new(mm(first), mm(first + 1), mm(first + 2))));
    };
    let [i, j, k] = [0, 1, 2].map(|n| steps[first + n].unwrap_or(DVec3::ZERO));
    let origin = match fields.get(&["spaceorigin"]) {
        None => DVec3::ZERO,
        Some(text) => {
            let vector = text.strip_suffix(')').and_then(vector3);
            vector.ok_or_else(|| fields.malformed(&format!("space origin: expected (x,y,z), got {text:?}")))?
        }
    };
    let to_mm = units_in_mm(fields)?;
    let lps_from_space = DMat3::from_diagonal(space_signs(fields)? * to_mm);
    Ok(placement_from_steps(lps_from_space * DMat3::from_cols(i, j, k), lps_from_space * origin))
}

/// The signs that turn the file's space to LPS. A space without anatomy is taken as it is.
fn space_signs(fields: &TextFields) -> Result<DVec3, DecodeError> {
    let Some(space) = fields.get(&["space"]) else { return Ok(DVec3::ONE) };
    let lower = space.to_ascii_lowercase();
    let initials: String = if lower.contains('-') {
        lower.split('-').filter_map(|word| word.chars().next()).collect()
    } else {
        lower.clone()
    };
    let mut letters = initials.chars();
    let signs = [('l', 'r'), ('p', 'a'), ('s', 'i')].map(|(plus, minus)| match letters.next() {
        Some(letter) if letter == plus => Some(1.0),
        Some(letter) if letter == minus => Some(-1.0),
        _ => None,
    });
    match (signs, letters.next(), lower.as_str()) {
        ([Some(x), Some(y), Some(z)], None, _) => Ok(DVec3::new(x, y, z)),
        (_, _, "scanner-xyz" | "3d-right-handed" | "3d-left-handed") => Ok(DVec3::ONE),
        _ => {
            Err(fields.unsupported(&format!("expected a space such as left-posterior-superior or RAS, got {space:?}")))
        }
    }
}

/// Millimetres of one unit of `space units`, which must be the same along all axes.
fn units_in_mm(fields: &TextFields) -> Result<f64, DecodeError> {
    let Some(text) = fields.get(&["spaceunits"]) else { return Ok(1.0) };
    let units: Vec<&str> = text.split('"').map(str::trim).filter(|unit| !unit.is_empty()).collect();
    let unit = units.first().copied().unwrap_or("");
    if units.iter().any(|other| *other != unit) {
        return Err(fields.unsupported(&format!("expected one unit for all axes of space, got {text}")));
    }
    match unit {
        "m" | "meter" | "meters" => Ok(1000.0),
        "cm" => Ok(10.0),
        "um" | "µm" | "μm" | "micron" | "microns" => Ok(0.001),
        // Millimetres, or a unit that nobody can convert.
        _ => Ok(1.0),
    }
}

/// The scalar type by any of the names that the format allows.
fn scalar_type(fields: &TextFields) -> Result<ScalarType, DecodeError> {
    let name = fields.required(&["type"])?;
    match name.to_ascii_lowercase().as_str() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Ok(ScalarType::U8),
        "signed char" | "int8" | "int8_t" => Ok(ScalarType::I8),
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Ok(ScalarType::U16),
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Ok(ScalarType::I16),
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Ok(ScalarType::U32),
        "int" | "signed int" | "int32" | "int32_t" => Ok(ScalarType::I32),
        "float" => Ok(ScalarType::F32),
        "double" => Ok(ScalarType::F64),
        _ => {
            Err(fields
                .unsupported(&format!("expected a scalar type of 8, 16 or 32 bits, float or double, got {name:?}")))
        }
    }
}

/// The byte order, which matters beyond one byte only.
fn endian(fields: &TextFields, scalar_type: ScalarType) -> Result<Endian, DecodeError> {
    match fields.get(&["endian"]).map(str::to_ascii_lowercase).as_deref() {
        Some("little") => Ok(Endian::Little),
        Some("big") => Ok(Endian::Big),
        None if scalar_type.size() == 1 => Ok(Endian::Little),
        other => Err(fields.malformed(&format!("expected endian: little or big, got {other:?}"))),
    }
}
