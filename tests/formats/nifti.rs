use std::f64::consts::FRAC_1_SQRT_2;
use std::fs;

use shearwarp::volume::decode::{DecodeError, load};
use shearwarp::volume::{ScalarType, Scalars};

use crate::files::*;

/// (version, vox_offset) of both versions.
const VERSIONS: [(u8, i64); 2] = [(1, 352), (2, 544)];

#[test]
fn every_type_version_and_byte_order_keeps_its_values() {
    for (version, vox_offset) in VERSIONS {
        for scalar_type in TYPES {
            for big in [false, true] {
                let file = NiftiFile { version, vox_offset, ..NiftiFile::of(scalar_type, big) };
                for bytes in [file.bytes(), gzip(&file.bytes())] {
                    let volume = read(&bytes).unwrap();
                    assert_eq!(volume.dims(), DIMS);
                    assert_eq!(values(&volume), sample(scalar_type), "{version} {scalar_type:?} big: {big}");
                    let report = volume.report();
                    assert_eq!(report.format, ["NIfTI-1", "NIfTI-2"][usize::from(version) - 1]);
                    assert_eq!((report.scalar_type, report.quantized, report.non_finite), (scalar_type, false, 0));
                }
            }
        }
    }
}

#[test]
fn eight_bits_stay_eight_bits() {
    for scalar_type in [ScalarType::U8, ScalarType::I8] {
        let volume = read(&NiftiFile::of(scalar_type, false).bytes()).unwrap();
        assert!(matches!(volume.scalars(), Scalars::U8(_)));
    }
}

#[test]
fn fractions_are_quantized_and_what_is_not_finite_is_counted() {
    let mut stored: Vec<f64> = (0..VOXELS).map(|n| n as f64 / 7.0 - 3.0).collect();
    (stored[5], stored[6]) = (f64::NAN, f64::NEG_INFINITY);
    for (scalar_type, big) in [(ScalarType::F32, false), (ScalarType::F64, true)] {
        let data = encode(&stored, scalar_type, big);
        let volume = read(&NiftiFile { data, ..NiftiFile::of(scalar_type, big) }.bytes()).unwrap();
        assert_eq!((volume.report().quantized, volume.report().non_finite), (true, 2));
        for (n, (got, wanted)) in values(&volume).into_iter().zip(&stored).enumerate() {
            let wanted = if wanted.is_finite() { *wanted } else { -3.0 };
            assert!((got - wanted).abs() < 1e-4, "voxel {n}: {got} for {wanted}");
        }
    }
}

#[test]
fn values_are_rescaled_by_slopes_of_either_sign() {
    for scalar_type in TYPES {
        for (slope, intercept) in [(2.0, -1024.0), (-0.5, 10.0), (0.0, 99.0), (f64::NAN, 99.0)] {
            let file = NiftiFile { scl: (slope, intercept), ..NiftiFile::of(scalar_type, false) };
            let volume = read(&file.bytes()).unwrap();
            let applied = if slope == 0.0 || slope.is_nan() { (1.0, 0.0) } else { (slope, intercept) };
            let wanted: Vec<f64> = sample(scalar_type).iter().map(|v| applied.1 + applied.0 * v).collect();
            assert_eq!(values(&volume), wanted, "{scalar_type:?} {slope}");
            assert!(volume.rescale().0 > 0.0);
        }
    }
    assert_says(read(&NiftiFile { scl: (1.0, f64::INFINITY), ..file() }.bytes()), "scl_inter");
    let huge = NiftiFile { version: 2, vox_offset: 544, scl: (1e307, 0.0), ..file() };
    assert_says(read(&huge.bytes()), "expected finite values");
}

fn file() -> NiftiFile {
    NiftiFile::of(ScalarType::U8, false)
}

#[test]
fn without_a_form_there_is_spacing_only() {
    let volume = read(&file().bytes()).unwrap();
    assert_placed(&volume, [1.0, 2.0, 3.0], IDENTITY, [0.0; 3]);
    let unset = NiftiFile { pixdim: [0.0, 0.0, -2.0, 3.0], ..file() };
    assert_placed(&read(&unset.bytes()).unwrap(), [1.0, 2.0, 3.0], IDENTITY, [0.0; 3]);
}

#[test]
fn the_sform_is_turned_from_ras_to_lps_and_preferred() {
    // Sheared and left-handed: columns (0, 2, 0), (-1, 0, 0) and (0, 3, 4).
    let sform = [[0.0, -1.0, 0.0, 10.0], [2.0, 0.0, 3.0, 20.0], [0.0, 0.0, 4.0, 30.0]];
    for (version, vox_offset) in VERSIONS {
        for big in [false, true] {
            let base = NiftiFile::of(ScalarType::I16, big);
            let file = NiftiFile {
                version,
                vox_offset,
                sform: Some(sform),
                qform: Some([0.5, 0.0, 0.0, 7.0, 8.0, 9.0]),
                ..base
            };
            let columns = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -0.6, 0.8]];
            assert_placed(&read(&file.bytes()).unwrap(), [2.0, 1.0, 5.0], columns, [-10.0, -20.0, 30.0]);
        }
    }
}

#[test]
fn the_qform_is_a_quaternion_with_a_sign() {
    // A quarter turn about z: i -> y, j -> -x in RAS.
    let qform = Some([0.0, 0.0, FRAC_1_SQRT_2, 1.0, 2.0, 3.0]);
    for (version, vox_offset) in VERSIONS {
        for (qfac, k) in [(1.0, 1.0), (-1.0, -1.0), (0.0, 1.0)] {
            let file = NiftiFile { version, vox_offset, qform, pixdim: [qfac, 1.0, 2.0, 3.0], ..file() };
            let columns = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, k]];
            assert_placed(&read(&file.bytes()).unwrap(), [1.0, 2.0, 3.0], columns, [-1.0, -2.0, 3.0]);
        }
    }
    // A half turn about z: the quaternion's first number is 0.
    let half = NiftiFile { qform: Some([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), ..file() };
    assert_placed(&read(&half.bytes()).unwrap(), [1.0, 2.0, 3.0], IDENTITY, [0.0; 3]);
}

#[test]
fn metres_and_microns_become_millimetres() {
    let sform = Some([[-1.0, 0.0, 0.0, -4.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
    for (version, vox_offset) in VERSIONS {
        for (units, mm) in [(0, 1.0), (1, 1000.0), (2, 1.0), (3 + 8, 0.001)] {
            let plain = NiftiFile { version, vox_offset, xyzt_units: units, ..file() };
            assert_placed(&read(&plain.bytes()).unwrap(), [mm, 2.0 * mm, 3.0 * mm], IDENTITY, [0.0; 3]);
            let formed = NiftiFile { sform, ..plain };
            assert_placed(&read(&formed.bytes()).unwrap(), [mm; 3], IDENTITY, [4.0 * mm, 0.0, 0.0]);
        }
    }
}

#[test]
fn of_several_volumes_the_first_is_taken() {
    let mut file = file();
    file.dim = vec![3, 4, 5, 2, 3];
    file.data = file.data.repeat(6);
    for bytes in [file.bytes(), gzip(&file.bytes())] {
        let volume = read(&bytes).unwrap();
        assert_eq!((values(&volume), volume.report().volumes_left_out), (sample(ScalarType::U8), 5));
    }
}

#[test]
fn extensions_and_several_gzip_members_are_passed() {
    let file = NiftiFile { vox_offset: 1024, ..file() };
    let bytes = file.bytes();
    assert_eq!(values(&read(&bytes).unwrap()), sample(ScalarType::U8));
    let members = [gzip(&bytes[..500]), gzip(&bytes[500..])].concat();
    assert_eq!(values(&read(&members).unwrap()), sample(ScalarType::U8));
    let unset = NiftiFile { vox_offset: 0, ..NiftiFile::of(ScalarType::U8, false) };
    let with_flags = [unset.bytes()[..348].to_vec(), vec![0; 4], unset.data.clone()].concat();
    assert_eq!(values(&read(&with_flags).unwrap()), sample(ScalarType::U8));
}

#[test]
fn a_pair_is_read_from_a_path_and_refused_from_a_stream() {
    let folder = tempfile::tempdir().unwrap();
    let pair = NiftiFile { single: false, vox_offset: 0, ..NiftiFile::of(ScalarType::I16, true) };
    let path = folder.path().join("scan.hdr");
    fs::write(&path, pair.bytes()).unwrap();
    assert!(matches!(load(&path, &LIMITS), Err(DecodeError::Io { .. })));
    fs::write(folder.path().join("scan.img.gz"), gzip(&pair.data)).unwrap();
    assert_eq!(values(&load(&path, &LIMITS).unwrap()), sample(ScalarType::I16));
    fs::write(folder.path().join("scan.img"), &pair.data).unwrap();
    assert_eq!(values(&load(&path, &LIMITS).unwrap()), sample(ScalarType::I16));
    assert_says(read(&pair.bytes()), "data file");
}

#[test]
fn colours_are_read() {
    for (datatype, count) in [(128, 3), (2304, 4)] {
        let file = NiftiFile { datatype, data: components(count), ..NiftiFile::of(ScalarType::U8, false) };
        assert_colors(&read(&file.bytes()).unwrap(), count);
        let short = NiftiFile { data: components(count)[1..].to_vec(), ..file };
        assert!(matches!(read(&short.bytes()), Err(DecodeError::Truncated { .. })));
    }
}

#[test]
fn kinds_of_voxels_that_are_not_scalars_are_named() {
    for (datatype, name) in [(32, "complex"), (1024, "64-bit integer")] {
        let result = read(&NiftiFile { datatype, ..file() }.bytes());
        assert!(matches!(result, Err(DecodeError::Unsupported(_))));
        assert_says(result, name);
    }
    assert_says(read(&NiftiFile { datatype: 77, ..file() }.bytes()), "known datatype, got 77");
}
