use std::fs;

use shearwarp::volume::ScalarType;
use shearwarp::volume::decode::load;

use crate::files::*;

const NAMES: [&str; 8] =
    ["MET_UCHAR", "MET_CHAR", "MET_USHORT", "MET_SHORT", "MET_UINT", "MET_INT", "MET_FLOAT", "MET_DOUBLE"];

fn header(element_type: &str, more: &str, data_file: &str) -> String {
    format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nDimSize = 3 4 5\nElementType = {element_type}\n{more}\
         ElementDataFile = {data_file}\n"
    )
}

fn bytes() -> Vec<u8> {
    encode(&sample(ScalarType::U8), ScalarType::U8, false)
}

fn read_with(more: &str) -> Result<shearwarp::volume::Volume, shearwarp::volume::decode::DecodeError> {
    read(&attached(&header("MET_UCHAR", more, "LOCAL"), &bytes()))
}

#[test]
fn every_type_byte_order_and_compression_keeps_its_values() {
    for (scalar_type, name) in TYPES.into_iter().zip(NAMES) {
        for big in [false, true] {
            let data = encode(&sample(scalar_type), scalar_type, big);
            let msb = if big { "ElementByteOrderMSB = True\n" } else { "BinaryDataByteOrderMSB = False\n" };
            for (compressed, data) in [("False", data.clone()), ("True", zlib(&data)), ("True", gzip(&data))] {
                let header = header(name, &format!("{msb}CompressedData = {compressed}\n"), "LOCAL");
                let volume = read(&attached(&header, &data)).unwrap();
                assert_eq!((volume.dims(), volume.report().format), (DIMS, "MetaImage"));
                assert_eq!(values(&volume), sample(scalar_type), "{name} big: {big}, compressed: {compressed}");
            }
        }
    }
}

#[test]
fn rows_of_the_transform_are_directions_of_axes() {
    // Left-handed and sheared.
    let more = "TransformMatrix = 0 1 0 -1 0 0 0 0.6 -0.8\nOffset = 10 20 30\nElementSpacing = 1 2 3\n";
    let columns = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.6, -0.8]];
    assert_placed(&read_with(more).unwrap(), [1.0, 2.0, 3.0], columns, [10.0, 20.0, 30.0]);
    let synonyms = "Rotation = 0 1 0 -1 0 0 0 0.6 -0.8\nPosition = 10 20 30\nElementSize = 1 2 3\n";
    assert_placed(&read_with(synonyms).unwrap(), [1.0, 2.0, 3.0], columns, [10.0, 20.0, 30.0]);
    assert_placed(&read_with("Origin = 1 2 3\n").unwrap(), [1.0; 3], IDENTITY, [1.0, 2.0, 3.0]);
    assert_placed(&read_with("").unwrap(), [1.0; 3], IDENTITY, [0.0; 3]);
    assert_says(read_with("TransformMatrix = 1 0 0 1 0 0 0 0 1\n"), "span space");
    assert_says(read_with("ElementSpacing = 1 0 1\n"), "spacing must be positive");
    assert_says(read_with("ElementSpacing = 1 -1 1\nTransformMatrix = 1 0 0 0 1 0 0 0 1\n"), "positive spacings");
}

#[test]
fn of_a_series_the_first_volume_is_taken() {
    let header = "NDims = 4\nDimSize = 3 4 5 3\nElementType = MET_UCHAR\nElementSpacing = 1 2 3 9\n\
                  TransformMatrix = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\nOffset = 1 2 3 0\nElementDataFile = LOCAL\n";
    let volume = read(&attached(header, &bytes().repeat(3))).unwrap();
    assert_eq!((values(&volume), volume.report().volumes_left_out), (sample(ScalarType::U8), 2));
    assert_placed(&volume, [1.0, 2.0, 3.0], IDENTITY, [1.0, 2.0, 3.0]);
}

#[test]
fn a_data_file_is_followed_beside_the_header_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mhd");
    fs::write(folder.path().join("scan.raw"), [b"xyz".to_vec(), bytes()].concat()).unwrap();
    fs::write(folder.path().join("scan.zraw"), zlib(&bytes())).unwrap();
    for (more, name) in [
        ("HeaderSize = 3\n", "scan.raw"),
        ("HeaderSize = -1\n", "scan.raw"),
        ("CompressedData = True\nCompressedDataSize = 17\n", "scan.zraw"),
    ] {
        let header = header("MET_UCHAR", more, name);
        fs::write(&path, &header).unwrap();
        assert_eq!(values(&load(&path, &LIMITS).unwrap()), sample(ScalarType::U8), "{more}");
        assert_says(read(header.as_bytes()), "data file");
    }
    for (name, message) in [
        ("/etc/hostname", "header's own folder"),
        ("../scan.raw", "header's own folder"),
        ("missing.raw", "missing.raw"),
        ("LIST", "one data file"),
        ("scan%03d.raw 1 5 1", "one data file"),
    ] {
        fs::write(&path, header("MET_UCHAR", "", name)).unwrap();
        assert_says(load(&path, &LIMITS), message);
    }
}

#[test]
fn colours_are_read() {
    for count in [3, 4] {
        let header = header("MET_UCHAR", &format!("ElementNumberOfChannels = {count}\n"), "LOCAL");
        assert_colors(&read(&attached(&header, &components(count))).unwrap(), count);
    }
}

#[test]
fn what_is_not_read_is_named() {
    assert_says(read_with("ElementNumberOfChannels = 2\n"), "1 channel, or 3 or 4 of colours, got 2");
    assert_says(read_with("BinaryData = False\n"), "binary data");
    assert_says(read_with("CompressedData = maybe\n"), "True or False, got \"maybe\"");
    assert_says(read_with("ElementType = MET_LONG_LONG\n"), "MET_LONG_LONG");
    assert_says(read_with("HeaderSize = -2\n"), "HeaderSize: got -2");
    assert_says(read_with("DimSize = 3 4\n"), "expected 3 numbers");
    assert_says(read_with("NDims = 2\n"), "got 2");
    assert_says(read_with("Nonsense\n"), "Key = Value");
    assert_says(read(b"NDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\n"), "elementdatafile");
}
