//! Writers of the formats, independent of the readers under test.

use std::io::Write;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use glam::{DMat3, DVec3};
use shearwarp::volume::decode::{DecodeError, Limits, from_bytes};
use shearwarp::volume::{ScalarType, Volume};

pub const LIMITS: Limits = Limits { max_voxels: 1 << 20 };
pub const DIMS: [usize; 3] = [3, 4, 5];
pub const VOXELS: usize = 60;
pub const TYPES: [ScalarType; 8] = [
    ScalarType::U8,
    ScalarType::I8,
    ScalarType::U16,
    ScalarType::I16,
    ScalarType::U32,
    ScalarType::I32,
    ScalarType::F32,
    ScalarType::F64,
];

/// Whole numbers that a type holds and that narrowing must keep, its extremes among them.
pub fn sample(scalar_type: ScalarType) -> Vec<f64> {
    let (low, high) = match scalar_type {
        ScalarType::U8 => (0.0, 255.0),
        ScalarType::I8 => (-128.0, 127.0),
        ScalarType::U16 => (0.0, 65535.0),
        ScalarType::I16 => (-32768.0, 32767.0),
        ScalarType::U32 => (4_294_901_760.0, 4_294_967_295.0),
        ScalarType::I32 => (-2_147_483_648.0, -2_147_418_113.0),
        ScalarType::F32 | ScalarType::F64 => (-1024.0, 64511.0),
    };
    let middle = |n: usize| low + ((n * 7919) % 251) as f64;
    (0..VOXELS).map(|n| [low, high].get(n).copied().unwrap_or(middle(n))).collect()
}

/// Scalars as a file has them.
pub fn encode(values: &[f64], scalar_type: ScalarType, big: bool) -> Vec<u8> {
    let one = |&value: &f64| {
        let mut bytes = match scalar_type {
            ScalarType::U8 => (value as u8).to_le_bytes().to_vec(),
            ScalarType::I8 => (value as i8).to_le_bytes().to_vec(),
            ScalarType::U16 => (value as u16).to_le_bytes().to_vec(),
            ScalarType::I16 => (value as i16).to_le_bytes().to_vec(),
            ScalarType::U32 => (value as u32).to_le_bytes().to_vec(),
            ScalarType::I32 => (value as i32).to_le_bytes().to_vec(),
            ScalarType::F32 => (value as f32).to_le_bytes().to_vec(),
            ScalarType::F64 => value.to_le_bytes().to_vec(),
        };
        if big {
            bytes.reverse();
        }
        bytes
    };
    values.iter().flat_map(one).collect()
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

pub fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A text header followed by data.
pub fn attached(header: &str, data: &[u8]) -> Vec<u8> {
    [header.as_bytes(), data].concat()
}

pub fn read(bytes: &[u8]) -> Result<Volume, DecodeError> {
    from_bytes(bytes, &LIMITS)
}

/// All values of a volume in the file's own units.
pub fn values(volume: &Volume) -> Vec<f64> {
    (0..volume.scalars().len()).map(|n| volume.value_of_code(f64::from(volume.scalars().code(n)))).collect()
}

/// Asserts where a volume stands, in LPS mm.
#[track_caller]
pub fn assert_placed(volume: &Volume, spacing: [f64; 3], columns: [[f64; 3]; 3], origin: [f64; 3]) {
    let placement = volume.placement();
    let close = |got: DVec3, wanted: [f64; 3]| got.abs_diff_eq(DVec3::from_array(wanted), 1e-5);
    assert!(close(placement.spacing, spacing), "spacing {}", placement.spacing);
    let wanted = DMat3::from_cols_array_2d(&columns);
    assert!(placement.direction.abs_diff_eq(wanted, 1e-6), "direction {} for {wanted}", placement.direction);
    assert!(close(placement.origin, origin), "origin {}", placement.origin);
}

/// Asserts what an error says.
#[track_caller]
pub fn assert_says(result: Result<Volume, DecodeError>, part: &str) {
    let message = result.expect_err("expected an error").to_string();
    assert!(message.contains(part), "expected {part:?} in {message:?}");
}

pub const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// A NIfTI file, to be changed field by field; `bytes` writes it.
#[derive(Clone)]
pub struct NiftiFile {
    pub version: u8,
    pub big: bool,
    pub single: bool,
    pub dim: Vec<i64>,
    pub datatype: i16,
    pub pixdim: [f64; 4],
    pub vox_offset: i64,
    pub scl: (f64, f64),
    pub xyzt_units: u8,
    pub qform: Option<[f64; 6]>,
    pub sform: Option<[[f64; 4]; 3]>,
    pub data: Vec<u8>,
}

impl NiftiFile {
    pub fn of(scalar_type: ScalarType, big: bool) -> Self {
        let codes = [2, 256, 512, 4, 768, 8, 16, 64];
        let datatype = TYPES.iter().zip(codes).find(|(t, _)| **t == scalar_type).unwrap().1;
        Self {
            version: 1,
            big,
            single: true,
            dim: DIMS.map(|n| n as i64).to_vec(),
            datatype,
            pixdim: [1.0, 1.0, 2.0, 3.0],
            vox_offset: 352,
            scl: (0.0, 0.0),
            xyzt_units: 2,
            qform: None,
            sform: None,
            data: encode(&sample(scalar_type), scalar_type, big),
        }
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = if self.version == 1 { self.header1() } else { self.header2() };
        bytes.resize(bytes.len().max(usize::try_from(self.vox_offset).unwrap_or(0)), 0);
        if self.single { [bytes, self.data.clone()].concat() } else { bytes }
    }

    fn header1(&self) -> Vec<u8> {
        let mut h = Header { bytes: vec![0; 348], big: self.big };
        h.put(0, 348_i32.to_le_bytes());
        h.put(40, (self.dim.len() as i16).to_le_bytes());
        (0..7).for_each(|n| h.put(42 + 2 * n, (self.dim.get(n).copied().unwrap_or(1) as i16).to_le_bytes()));
        h.put(70, self.datatype.to_le_bytes());
        (0..4).for_each(|n| h.put(76 + 4 * n, (self.pixdim[n] as f32).to_le_bytes()));
        h.put(108, (self.vox_offset as f32).to_le_bytes());
        h.put(112, (self.scl.0 as f32).to_le_bytes());
        h.put(116, (self.scl.1 as f32).to_le_bytes());
        h.put(123, [self.xyzt_units]);
        if let Some(qform) = self.qform {
            h.put(252, 1_i16.to_le_bytes());
            (0..6).for_each(|n| h.put(256 + 4 * n, (qform[n] as f32).to_le_bytes()));
        }
        if let Some(sform) = self.sform {
            h.put(254, 2_i16.to_le_bytes());
            (0..12).for_each(|n| h.put(280 + 4 * n, (sform[n / 4][n % 4] as f32).to_le_bytes()));
        }
        h.bytes[344..348].copy_from_slice(if self.single { b"n+1\0" } else { b"ni1\0" });
        h.bytes
    }

    fn header2(&self) -> Vec<u8> {
        let mut h = Header { bytes: vec![0; 540], big: self.big };
        h.put(0, 540_i32.to_le_bytes());
        h.bytes[4..12].copy_from_slice(if self.single { b"n+2\0\r\n\x1a\n" } else { b"ni2\0\r\n\x1a\n" });
        h.put(12, self.datatype.to_le_bytes());
        h.put(16, (self.dim.len() as i64).to_le_bytes());
        (0..7).for_each(|n| h.put(24 + 8 * n, self.dim.get(n).copied().unwrap_or(1).to_le_bytes()));
        (0..4).for_each(|n| h.put(104 + 8 * n, self.pixdim[n].to_le_bytes()));
        h.put(168, self.vox_offset.to_le_bytes());
        h.put(176, self.scl.0.to_le_bytes());
        h.put(184, self.scl.1.to_le_bytes());
        if let Some(qform) = self.qform {
            h.put(344, 1_i32.to_le_bytes());
            (0..6).for_each(|n| h.put(352 + 8 * n, qform[n].to_le_bytes()));
        }
        if let Some(sform) = self.sform {
            h.put(348, 2_i32.to_le_bytes());
            (0..12).for_each(|n| h.put(400 + 8 * n, sform[n / 4][n % 4].to_le_bytes()));
        }
        h.put(500, i32::from(self.xyzt_units).to_le_bytes());
        h.bytes
    }
}

struct Header {
    bytes: Vec<u8>,
    big: bool,
}

impl Header {
    fn put<const N: usize>(&mut self, at: usize, mut number: [u8; N]) {
        if self.big {
            number.reverse();
        }
        self.bytes[at..at + N].copy_from_slice(&number);
    }
}

/// Voxels of so many bytes each, 3 x 4 x 5.
pub fn components(count: usize) -> Vec<u8> {
    (0..VOXELS * count).map(|n| (n * 7 % 251) as u8).collect()
}

/// The volume is made of [`components`]: colours, and what their opacity comes from.
pub fn assert_colors(volume: &Volume, count: usize) {
    let colors = volume.colors().expect("a colour volume");
    assert_eq!((volume.dims(), usize::from(volume.components()), colors.has_alpha), (DIMS, count, count == 4));
    for (n, (voxel, got)) in components(count).chunks(count).zip(&colors.voxels).enumerate() {
        let luma = (0.2126 * f64::from(voxel[0]) + 0.7152 * f64::from(voxel[1]) + 0.0722 * f64::from(voxel[2])).round();
        let code = if count == 4 { voxel[3] } else { luma as u8 };
        assert_eq!(*got, [voxel[0], voxel[1], voxel[2], code], "voxel {n}");
        assert_eq!(volume.scalars().code(n), u16::from(code), "voxel {n}");
    }
}
