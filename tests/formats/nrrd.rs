use std::fs;

use shearwarp::volume::ScalarType;
use shearwarp::volume::decode::{DecodeError, load};

use crate::files::*;

const NAMES: [&str; 8] = ["uchar", "signed char", "unsigned short", "int16", "uint", "signed int", "float", "double"];

/// A header of 3x4x5 bytes, with more fields; ends with the blank line.
fn header(more: &str) -> String {
    format!("NRRD0004\n# a comment\ntype: uchar\ndimension: 3\nsizes: 3 4 5\nencoding: raw\nkey:=a: b\n{more}\n")
}

fn bytes() -> Vec<u8> {
    encode(&sample(ScalarType::U8), ScalarType::U8, false)
}

fn read_with(more: &str) -> Result<shearwarp::volume::Volume, DecodeError> {
    read(&attached(&header(more), &bytes()))
}

#[test]
fn every_type_byte_order_and_encoding_keeps_its_values() {
    for (scalar_type, name) in TYPES.into_iter().zip(NAMES) {
        for (big, endian) in [(false, "little"), (true, "big")] {
            let data = encode(&sample(scalar_type), scalar_type, big);
            for (encoding, data) in [("raw", data.clone()), ("gzip", gzip(&data)), ("gz", gzip(&data))] {
                let header = format!(
                    "NRRD0005\r\ntype: {name}\r\ndimension: 3\r\nsizes: 3 4 5\r\nendian: {endian}\r\nencoding: {encoding}\r\n\r\n"
                );
                let volume = read(&attached(&header, &data)).unwrap();
                assert_eq!((volume.dims(), volume.report().format), (DIMS, "NRRD"));
                assert_eq!(values(&volume), sample(scalar_type), "{name} {endian} {encoding}");
            }
        }
    }
}

#[test]
fn a_space_is_turned_to_lps() {
    let directions = "space directions: (0,2,0) (-1, 0, 0) (0,3,4)\nspace origin: (10,20,30)\n";
    for (space, [x, y, z]) in [
        ("left-posterior-superior", [1.0, 1.0, 1.0]),
        ("LPS", [1.0, 1.0, 1.0]),
        ("right-anterior-superior", [-1.0, -1.0, 1.0]),
        ("RAS", [-1.0, -1.0, 1.0]),
        ("left-anterior-superior", [1.0, -1.0, 1.0]),
        ("LAS", [1.0, -1.0, 1.0]),
        ("scanner-xyz", [1.0, 1.0, 1.0]),
    ] {
        let volume = read_with(&format!("space: {space}\n{directions}")).unwrap();
        let columns = [[0.0, y, 0.0], [-x, 0.0, 0.0], [0.0, 0.6 * y, 0.8 * z]];
        assert_placed(&volume, [2.0, 1.0, 5.0], columns, [10.0 * x, 20.0 * y, 30.0 * z]);
    }
    let volume = read_with(&format!("space dimension: 3\n{directions}space units: \"m\" \"m\" \"m\"\n")).unwrap();
    let columns = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.6, 0.8]];
    assert_placed(&volume, [2000.0, 1000.0, 5000.0], columns, [10000.0, 20000.0, 30000.0]);
    assert_says(read_with(&format!("space: left-left-superior\n{directions}")), "left-left-superior");
    assert_says(read_with("space: LPS\nspace directions: (1,0,0) (0,1,0)\n"), "expected 3 3D vectors");
    assert_says(read_with("space: LPS\nspace directions: (1,0,0) (2,0,0) (0,0,1)\n"), "span space");
}

#[test]
fn without_directions_there_is_spacing_only() {
    assert_placed(&read_with("spacings: 1 2 3\n").unwrap(), [1.0, 2.0, 3.0], IDENTITY, [0.0; 3]);
    assert_placed(&read_with("spacings: nan 2 3\n").unwrap(), [1.0, 2.0, 3.0], IDENTITY, [0.0; 3]);
    assert_placed(&read_with("").unwrap(), [1.0; 3], IDENTITY, [0.0; 3]);
}

#[test]
fn of_a_list_the_first_volume_is_taken_wherever_the_axis_stands() {
    let values_of_first = sample(ScalarType::I16);
    let other: Vec<f64> = values_of_first.iter().map(|v| -1.0 - v).collect();
    let last = [values_of_first.clone(), other.clone()].concat();
    let first: Vec<f64> = values_of_first.iter().zip(&other).flat_map(|(a, b)| [*a, *b]).collect();
    for (sizes, kinds, directions, stored) in [
        ("3 4 5 2", "domain domain domain list", "(1,0,0) (0,2,0) (0,0,3) none", &last),
        ("2 3 4 5", "list space space space", "none (1,0,0) (0,2,0) (0,0,3)", &first),
        ("2 3 4 5", "??? domain domain domain", "none (1,0,0) (0,2,0) (0,0,3)", &first),
    ] {
        for big in [false, true] {
            let endian = if big { "big" } else { "little" };
            let header = format!(
                "NRRD0004\ntype: short\ndimension: 4\nsizes: {sizes}\nendian: {endian}\nencoding: gzip\nkinds: {kinds}\n\
                 space: LPS\nspace directions: {directions}\n\n"
            );
            let volume = read(&attached(&header, &gzip(&encode(stored, ScalarType::I16, big)))).unwrap();
            assert_eq!(values(&volume), values_of_first, "{kinds}");
            assert_eq!((volume.dims(), volume.report().volumes_left_out), (DIMS, 1));
            assert_placed(&volume, [1.0, 2.0, 3.0], IDENTITY, [0.0; 3]);
        }
    }
}

#[test]
fn colours_are_read_and_other_vectors_refused() {
    let file = |kind: &str, count: usize, name: &str| {
        let size = TYPES[NAMES.iter().position(|n| *n == name).unwrap()].size();
        let header = format!(
            "NRRD0004\ntype: {name}\ndimension: 4\nsizes: {count} 3 4 5\nencoding: raw\nendian: little\n\
             kinds: {kind} domain domain domain\n\n"
        );
        read(&attached(&header, &components(count * size)))
    };
    for (kind, count) in
        [("RGB-color", 3), ("3-vector", 3), ("vector", 3), ("RGBA-color", 4), ("4-color", 4), ("vector", 4)]
    {
        assert_colors(&file(kind, count, "uchar").unwrap(), count);
    }
    for (kind, count) in [("RGB-color", 4), ("vector", 2), ("3-matrix", 9), ("quaternion", 4)] {
        assert_says(file(kind, count, "uchar"), &format!("got an axis of kind {kind}"));
    }
    let spatial = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 3 4 5\nencoding: raw\nkinds: RGB-color domain domain\n\
                   space: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n\n";
    assert_says(read(&attached(spatial, &components(1))), "expected the axis of colours first");
    assert_says(file("RGB-color", 3, "float"), "expected colours of 8 bits, got f32");
}

#[test]
fn a_detached_header_is_followed_beside_it_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.nhdr");
    let data = [b"two\nlines\nxyz".to_vec(), bytes()].concat();
    fs::write(folder.path().join("scan.raw"), &data).unwrap();
    fs::write(folder.path().join("scan.raw.gz"), gzip(&[b"xyz".to_vec(), bytes()].concat())).unwrap();
    for more in [
        "data file: scan.raw\nline skip: 2\nbyte skip: 3\n",
        "datafile: ./scan.raw\nbyte skip: -1\n",
        "data file: scan.raw.gz\nencoding: gzip\nbyte skip: 3\n",
    ] {
        fs::write(&path, header(more).trim_end()).unwrap();
        assert_eq!(values(&load(&path, &LIMITS).unwrap()), sample(ScalarType::U8), "{more}");
        assert_says(read(header(more).as_bytes()), "data file");
    }
    for (name, message) in [
        ("/etc/hostname", "header's own folder"),
        ("../scan.raw", "header's own folder"),
        ("missing.raw", "missing.raw"),
        ("LIST", "one data file"),
        ("scan%03d.raw 1 5 1", "one data file"),
    ] {
        fs::write(&path, header(&format!("data file: {name}\n"))).unwrap();
        assert_says(load(&path, &LIMITS), message);
    }
    fs::write(&path, header("data file: scan.raw\nbyte skip: 14\n")).unwrap();
    assert!(matches!(load(&path, &LIMITS), Err(DecodeError::Truncated { expected: 60, got: 59 })));
}

#[test]
fn what_a_header_lacks_is_named() {
    for (lacking, message) in [
        ("type: uchar\nsizes: 3 4 5\nencoding: raw\n", "dimension"),
        ("type: uchar\ndimension: 3\nencoding: raw\n", "sizes"),
        ("dimension: 3\nsizes: 3 4 5\nencoding: raw\n", "type"),
        ("type: uchar\ndimension: 3\nsizes: 3 4 5\n", "encoding"),
        ("type: short\ndimension: 3\nsizes: 3 4 5\nencoding: raw\n", "endian"),
        ("type: uchar\ndimension: 3\nsizes: 3 4 5\nencoding: ascii\n", "raw or gzip, got \"ascii\""),
        ("type: int64\ndimension: 3\nsizes: 3 4 5\nencoding: raw\n", "got \"int64\""),
        ("type: uchar\ndimension: 2\nsizes: 3 4\nencoding: raw\n", "got 2"),
        ("type: uchar\ndimension: 3\nsizes: 3 -4 5\nencoding: raw\n", "expected 3 numbers, got \"3 -4 5\""),
        ("type: uchar\ndimension: 3\nsizes: 3 4 0\nencoding: raw\n", "positive sizes"),
        ("no colon\n", "expected \"field: value\""),
    ] {
        assert_says(read(&attached(&format!("NRRD0004\n{lacking}\n"), &bytes().repeat(2))), message);
    }
}
