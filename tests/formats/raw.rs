use std::fs;

use shearwarp::volume::decode::{DecodeError, Limits, RawLayout, load_raw};

use crate::files::*;

#[test]
fn every_type_and_byte_order_keeps_its_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("array");
    for scalar_type in TYPES {
        for (big, suffix) in [(false, ""), (true, ":be")] {
            fs::write(&path, encode(&sample(scalar_type), scalar_type, big)).unwrap();
            let layout = RawLayout::parse(&format!("3,4,5,{}{suffix},1,2,3.5", scalar_type.name())).unwrap();
            let volume = load_raw(&path, &layout, &LIMITS).unwrap();
            assert_eq!((values(&volume), volume.report().format), (sample(scalar_type), "raw"));
            assert_placed(&volume, [1.0, 2.0, 3.5], IDENTITY, [0.0; 3]);
        }
    }
}

#[test]
fn colours_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("array");
    for count in [3, 4] {
        fs::write(&path, components(count)).unwrap();
        let layout = RawLayout::parse(&format!("3,4,5,u8x{count},1,2,3.5")).unwrap();
        assert_colors(&load_raw(&path, &layout, &LIMITS).unwrap(), count);
        let beyond = load_raw(&path, &layout, &Limits { max_voxels: 60 * count as u64 - 1 });
        assert_says(beyond, &format!("got dimensions 3 x 4 x 5 of {count} scalars"));
    }
}

#[test]
fn a_file_of_another_size_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("array");
    fs::write(&path, [0; 120]).unwrap();
    let load = |layout: &str, limits: &Limits| load_raw(&path, &RawLayout::parse(layout).unwrap(), limits);
    assert!(load("3,4,5,u16", &LIMITS).is_ok());
    assert_says(load("3,4,5,u8", &LIMITS), "expected a file of 60 bytes for this layout, got 120");
    let short = load("3,4,5,f32", &LIMITS);
    assert!(matches!(short, Err(DecodeError::Truncated { expected: 240, got: 120 })));
    assert_says(short, "truncated: expected 240 bytes of voxels, got 120");
    let beyond = load("3,4,5,u16", &Limits { max_voxels: 59 });
    assert_says(beyond, "too large: expected at most 59 voxels, got dimensions 3 x 4 x 5");
    let overflow = load("9999999999999,9999999999999,9999999999999,u8", &LIMITS);
    assert!(matches!(overflow, Err(DecodeError::TooLarge { .. })));
    assert_says(load("120,1,1,u8", &LIMITS), "dimensions must be 2 to 32767");
    assert!(matches!(
        load_raw(folder.path(), &RawLayout::parse("2,2,2,u8").unwrap(), &LIMITS),
        Err(DecodeError::Io { .. })
    ));
}
