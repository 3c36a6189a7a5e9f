//! NIfTI-1 and NIfTI-2: the header's fields, the three ways it states a placement, the data's place.
//!
//! The `nifti` crate does not fit here: it reads NIfTI-1 only, its affine functions panic on
//! headers that a stranger may send, and it takes the memory that a header promises before the
//! bytes are there. The fields that matter are twenty; they stand here with their offsets, as in
//! nifti1.h and nifti2.h.
//!
//! NIfTI's world is RAS: x and y change sign on their way to LPS. A file with neither sform nor
//! qform states no orientation, so it gets the identity (in LPS), as the conventions say.

use glam::{DMat3, DQuat, DVec3};

use super::decode::{DecodeError, Limits};
use super::source::Source;
use super::voxels::{Endian, Header, placement_from_steps};
use super::{Placement, ScalarType, Volume};

/// Bytes that [`sniff`] wants to see: a NIfTI-1 header, which ends with its magic.
pub(super) const SNIFF_BYTES: u64 = 348;

/// Which header a file begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Version {
    One(Endian),
    Two(Endian),
}

/// Tells the version and the byte order by the header's size, its first field.
pub(super) fn sniff(head: &[u8]) -> Option<Version> {
    let size: [u8; 4] = head.get(..4)?.try_into().ok()?;
    match (i32::from_le_bytes(size), i32::from_be_bytes(size)) {
        (348, _) => Some(Version::One(Endian::Little)),
        (_, 348) => Some(Version::One(Endian::Big)),
        (540, _) => Some(Version::Two(Endian::Little)),
        (_, 540) => Some(Version::Two(Endian::Big)),
        _ => None,
    }
}

/// Reads the header, then the voxels from the same file or from the `.img` beside it.
pub(super) fn read(mut source: Source<'_>, version: Version, limits: &Limits) -> Result<Volume, DecodeError> {
    let (size, endian) = match version {
        Version::One(endian) => (348, endian),
        Version::Two(endian) => (540, endian),
    };
    let head = source.peek(size)?;
    if head.len() as u64 != size {
        return Err(malformed(format!("expected a header of {size} bytes, got {}", head.len())));
    }
    let fields = Fields { bytes: &head, endian };
    let nifti = match version {
        Version::One(_) => Nifti::one(&fields)?,
        Version::Two(_) => Nifti::two(&fields)?,
    };
    let header = nifti.header(endian)?;
    let mut data = if nifti.single_file { source } else { image_beside(&source)? };
    data.skip(nifti.data_offset(size)?)?;
    header.read_voxels(data, limits)
}

/// The `.img` (or `.img.gz`) of a `.hdr`.
fn image_beside<'a>(source: &Source<'_>) -> Result<Source<'a>, DecodeError> {
    let stem = source.path().and_then(|path| path.file_stem()).map_or_else(String::new, |s| s.to_string_lossy().into());
    let stem = stem.strip_suffix(".hdr").unwrap_or(&stem); // of x.hdr.gz
    let plain = source.companion(&format!("{stem}.img"));
    let mut image = match plain {
        Err(DecodeError::Io { .. }) => source.companion(&format!("{stem}.img.gz")).or(plain)?,
        other => other?,
    };
    Ok(if image.peek(2)? == Source::GZIP_MAGIC { image.gunzip() } else { image })
}

fn malformed(message: String) -> DecodeError {
    DecodeError::Malformed(format!("NIfTI: {message}"))
}

/// Numbers at fixed offsets of a header of checked length.
struct Fields<'a> {
    bytes: &'a [u8],
    endian: Endian,
}

impl Fields<'_> {
    /// The bytes of a number, least significant first.
    fn number<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&self.bytes[at..at + N]);
        if self.endian == Endian::Big {
            bytes.reverse();
        }
        bytes
    }

    fn i16(&self, at: usize) -> i64 {
        i16::from_le_bytes(self.number(at)).into()
    }

    fn i32(&self, at: usize) -> i64 {
        i32::from_le_bytes(self.number(at)).into()
    }

    fn i64(&self, at: usize) -> i64 {
        i64::from_le_bytes(self.number(at))
    }

    fn f32(&self, at: usize) -> f64 {
        f32::from_le_bytes(self.number(at)).into()
    }

    fn f64(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.number(at))
    }
}

/// The fields that matter, whatever the version; names as in nifti1.h.
struct Nifti {
    format: &'static str,
    /// True where the voxels follow in the same file.
    single_file: bool,
    dim: [i64; 8],
    datatype: i64,
    pixdim: [f64; 8],
    vox_offset: f64,
    scl_slope: f64,
    scl_inter: f64,
    xyzt_units: i64,
    qform_code: i64,
    sform_code: i64,
    quatern: DVec3,
    qoffset: DVec3,
    srow: [[f64; 4]; 3],
}

impl Nifti {
    /// Fields of the 348-byte header.
    fn one(f: &Fields<'_>) -> Result<Self, DecodeError> {
        let f32s = |at: usize| DVec3::new(f.f32(at), f.f32(at + 4), f.f32(at + 8));
        Ok(Self {
            format: "NIfTI-1",
            single_file: single_file(&f.bytes[344..348], b"n+1\0", b"ni1\0")?,
            dim: std::array::from_fn(|n| f.i16(40 + 2 * n)),
            datatype: f.i16(70),
            pixdim: std::array::from_fn(|n| f.f32(76 + 4 * n)),
            vox_offset: f.f32(108),
            scl_slope: f.f32(112),
            scl_inter: f.f32(116),
            xyzt_units: f.bytes[123].into(),
            qform_code: f.i16(252),
            sform_code: f.i16(254),
            quatern: f32s(256),
            qoffset: f32s(268),
            srow: std::array::from_fn(|row| std::array::from_fn(|n| f.f32(280 + 16 * row + 4 * n))),
        })
    }

    /// Fields of the 540-byte header.
    fn two(f: &Fields<'_>) -> Result<Self, DecodeError> {
        let f64s = |at: usize| DVec3::new(f.f64(at), f.f64(at + 8), f.f64(at + 16));
        Ok(Self {
            format: "NIfTI-2",
            single_file: single_file(&f.bytes[4..12], b"n+2\0\r\n\x1a\n", b"ni2\0\r\n\x1a\n")?,
            dim: std::array::from_fn(|n| f.i64(16 + 8 * n)),
            datatype: f.i16(12),
            pixdim: std::array::from_fn(|n| f.f64(104 + 8 * n)),
            vox_offset: f.i64(168) as f64,
            scl_slope: f.f64(176),
            scl_inter: f.f64(184),
            xyzt_units: f.i32(500),
            qform_code: f.i32(344),
            sform_code: f.i32(348),
            quatern: f64s(352),
            qoffset: f64s(376),
            srow: std::array::from_fn(|row| std::array::from_fn(|n| f.f64(400 + 32 * row + 8 * n))),
        })
    }

    /// What is to be read.
    fn header(&self, endian: Endian) -> Result<Header, DecodeError> {
        let (dims, following) = self.dims()?;
        Ok(Header {
            format: self.format,
            dims,
            scalar_type: scalar_type(self.datatype)?,
            components: match self.datatype {
                128 => 3,
                2304 => 4,
                _ => 1,
            },
            endian,
            placement: self.placement(),
            rescale: self.rescale()?,
            interleaved: 1,
            following,
            at_end: false,
        })
    }

    /// The first three dimensions, and how many volumes follow the first one.
    fn dims(&self) -> Result<([u64; 3], u64), DecodeError> {
        let axes = usize::try_from(self.dim[0]).ok().filter(|n| (1..=7).contains(n));
        let axes = axes.ok_or_else(|| malformed(format!("expected 1 to 7 dimensions, got {}", self.dim[0])))?;
        let mut sizes = [1; 7];
        for (size, &dim) in sizes.iter_mut().zip(&self.dim[1..=axes]) {
            let positive = u64::try_from(dim).ok().filter(|&dim| dim > 0);
            *size = positive.ok_or_else(|| malformed(format!("expected positive dimensions, got {dim}")))?;
        }
        let volumes = sizes[3..].iter().try_fold(1_u64, |product, &size| product.checked_mul(size));
        let volumes = volumes.ok_or_else(|| malformed(format!("expected fewer volumes, got {:?}", &sizes[3..])))?;
        Ok(([sizes[0], sizes[1], sizes[2]], volumes - 1))
    }

    /// (slope, intercept); a slope of 0 (or none) means that the stored values are the values.
    fn rescale(&self) -> Result<(f64, f64), DecodeError> {
        if self.scl_slope == 0.0 || !self.scl_slope.is_finite() {
            return Ok((1.0, 0.0));
        }
        if !self.scl_inter.is_finite() {
            return Err(malformed(format!("expected a finite scl_inter, got {}", self.scl_inter)));
        }
        Ok((self.scl_slope, self.scl_inter))
    }

    /// Where the voxels stand: sform, else qform, else the spacing alone.
    fn placement(&self) -> Placement {
        let to_mm = match self.xyzt_units & 7 {
            1 => 1000.0, // metres
            3 => 0.001,  // microns
            _ => 1.0,    // millimetres, or not said
        };
        let (steps, origin) = if self.sform_code > 0 {
            let [x, y, z] = self.srow.map(|row| DVec3::new(row[0], row[1], row[2]));
            let origin = DVec3::from_array(self.srow.map(|row| row[3]));
            (DMat3::from_cols(x, y, z).transpose(), origin)
        } else if self.qform_code > 0 {
            let qfac = if self.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
            let scale = self.spacing() * DVec3::new(1.0, 1.0, qfac);
            (self.rotation() * DMat3::from_diagonal(scale), self.qoffset)
        } else {
            return Placement::from_spacing(self.spacing() * to_mm);
        };
        let lps_from_ras = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0) * to_mm);
        placement_from_steps(lps_from_ras * steps, lps_from_ras * origin)
    }

    /// pixdim[1..=3]; signs are not allowed there, and 0 stands for "not said": both as nibabel reads them.
    fn spacing(&self) -> DVec3 {
        let size = |pixdim: f64| if pixdim == 0.0 { 1.0 } else { pixdim.abs() };
        DVec3::new(size(self.pixdim[1]), size(self.pixdim[2]), size(self.pixdim[3]))
    }

    /// The rotation of the unit quaternion (a, b, c, d) of which the file leaves a >= 0 out.
    fn rotation(&self) -> DMat3 {
        let rest = 1.0 - self.quatern.length_squared();
        let a = rest.max(0.0).sqrt();
        let [b, c, d] = self.quatern.to_array();
        DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize())
    }

    /// Where the voxels begin; `header` is the size of the header in bytes.
    fn data_offset(&self, header: u64) -> Result<u64, DecodeError> {
        // A single file has at least four bytes of extension flags after the header; 0 is "not said".
        let least = if self.single_file { header + 4 } else { 0 };
        let offset = if self.vox_offset == 0.0 { least as f64 } else { self.vox_offset };
        if !(offset >= least as f64 && offset < 2_f64.powi(63)) {
            return Err(malformed(format!("expected voxels from byte {least} on, got vox_offset {offset}")));
        }
        Ok(offset as u64)
    }
}

/// Tells `n+1` (voxels in the same file) from `ni1` (voxels in an `.img`).
fn single_file(magic: &[u8], single: &[u8], pair: &[u8]) -> Result<bool, DecodeError> {
    if magic == single {
        Ok(true)
    } else if magic == pair {
        Ok(false)
    } else {
        let [single, pair, got] = [single, pair, magic].map(<[u8]>::escape_ascii);
        Err(malformed(format!("expected the magic {single} or {pair}, got {got}")))
    }
}

/// The scalar type of a datatype code.
fn scalar_type(code: i64) -> Result<ScalarType, DecodeError> {
    let unsupported = |what: &str| {
        Err(DecodeError::Unsupported(format!("NIfTI: {what} volumes are not supported yet (datatype {code})")))
    };
    match code {
        // Scalars, red-green-blue, and that with alpha.
        2 | 128 | 2304 => Ok(ScalarType::U8),
        4 => Ok(ScalarType::I16),
        8 => Ok(ScalarType::I32),
        16 => Ok(ScalarType::F32),
        64 => Ok(ScalarType::F64),
        256 => Ok(ScalarType::I8),
        512 => Ok(ScalarType::U16),
        768 => Ok(ScalarType::U32),
        1 => unsupported("1-bit"),
        32 | 1792 | 2048 => unsupported("complex"),
        1024 | 1280 => unsupported("64-bit integer"),
        1536 => unsupported("128-bit float"),
        _ => Err(malformed(format!("expected a known datatype, got {code}"))),
    }
}
