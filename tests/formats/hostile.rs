//! Files that lie, end early, or never end.

use std::io::{self, Read};

use proptest::prelude::*;
use shearwarp::volume::ScalarType;
use shearwarp::volume::decode::{DecodeError, Limits, from_bytes};

use crate::files::*;

/// Counts what was taken from a stream.
struct Counted<R> {
    input: R,
    taken: u64,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        self.taken += count as u64;
        Ok(count)
    }
}

/// A header of each format that promises `dims` u8 voxels, without the voxels.
fn promises([nx, ny, nz]: [i64; 3]) -> Vec<Vec<u8>> {
    let nifti = NiftiFile { dim: vec![nx, ny, nz], data: Vec::new(), ..NiftiFile::of(ScalarType::U8, false) };
    let nifti2 = NiftiFile { version: 2, vox_offset: 544, ..nifti.clone() };
    let nrrd = format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: {nx} {ny} {nz}\nencoding: raw\n\n");
    let meta = format!("NDims = 3\nDimSize = {nx} {ny} {nz}\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n");
    vec![nifti.bytes(), nifti2.bytes(), nrrd.into_bytes(), meta.into_bytes()]
}

#[test]
fn a_promise_over_the_limit_is_refused_before_a_voxel_is_read() {
    for header in promises([1000, 1000, 1000]) {
        let header_bytes = header.len() as u64;
        let mut endless = Counted { input: header.chain(io::repeat(0)), taken: 0 };
        let result = from_bytes(&mut endless, &LIMITS);
        assert!(matches!(result, Err(DecodeError::TooLarge { limit: 1_048_576, .. })), "{result:?}");
        assert!(endless.taken <= header_bytes + (1 << 17), "{} bytes taken", endless.taken);
    }
}

#[test]
fn dimensions_that_overflow_are_too_large() {
    let nifti2 = NiftiFile { version: 2, vox_offset: 544, ..NiftiFile::of(ScalarType::U8, false) };
    for dim in [vec![i64::MAX; 3], vec![1 << 32, 1 << 32, 2], vec![1 << 21, 1 << 21, 1 << 22]] {
        let result = from_bytes(&*NiftiFile { dim, ..nifti2.clone() }.bytes(), &Limits { max_voxels: u64::MAX });
        assert!(matches!(result, Err(DecodeError::TooLarge { .. })), "{result:?}");
    }
    assert_says(read(&NiftiFile { dim: vec![3, 4, 5, i64::MAX, 2, 2], ..nifti2.clone() }.bytes()), "fewer volumes");
    let following = NiftiFile { dim: vec![3, 4, 5, i64::MAX], ..nifti2 };
    assert_eq!(read(&following.bytes()).unwrap().report().volumes_left_out, i64::MAX as u64 - 1);
    for sizes in ["18446744073709551615 18446744073709551615 18446744073709551615", "4294967296 4294967296 1"] {
        let header = format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: {sizes}\nencoding: raw\n\n");
        assert!(matches!(read(header.as_bytes()), Err(DecodeError::TooLarge { .. })));
    }
}

#[test]
fn interleaved_volumes_count_towards_the_limit() {
    for (list, limited) in [(1 << 17, true), (1 << 12, false)] {
        let header = format!(
            "NRRD0004\ntype: uchar\ndimension: 4\nsizes: {list} 3 4 5\nencoding: raw\n\
             space directions: none (1,0,0) (0,1,0) (0,0,1)\n\n"
        );
        let result = from_bytes(header.as_bytes().chain(io::repeat(3)), &LIMITS);
        assert_eq!(matches!(result, Err(DecodeError::TooLarge { .. })), limited);
        assert_eq!(result.is_ok(), !limited);
    }
}

#[test]
fn dimensions_that_no_volume_has_are_refused() {
    for header in promises([-3, 4, 5]).into_iter().chain(promises([3, 0, 5])).chain(promises([3, 4, 1])) {
        assert!(read(&[header, vec![0; 60]].concat()).is_err());
    }
    for dim in [vec![-3, 4, 5], vec![3, 0, 5]] {
        let file = NiftiFile { dim, ..NiftiFile::of(ScalarType::U8, false) };
        assert_says(read(&file.bytes()), "expected positive dimensions");
    }
    assert_says(read(&NiftiFile { dim: vec![8, 8], ..NiftiFile::of(ScalarType::U8, false) }.bytes()), "2 to 32767");
    let mut many_axes = NiftiFile::of(ScalarType::U8, false).bytes();
    many_axes[40] = 8;
    assert_says(read(&many_axes), "expected 1 to 7 dimensions, got 8");
}

#[test]
fn a_file_that_ends_early_says_what_was_expected() {
    for header in promises([16, 16, 16]) {
        let short = [header.clone(), vec![1; 1000]].concat();
        for bytes in [short.clone(), gzip(&short)] {
            let result = read(&bytes);
            assert!(matches!(result, Err(DecodeError::Truncated { expected: 4096, got: 1000 })), "{result:?}");
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("short");
        std::fs::write(&path, short).unwrap();
        let result = shearwarp::volume::decode::load(&path, &LIMITS);
        assert!(matches!(result, Err(DecodeError::Truncated { expected: 4096, got: 1000 })), "{result:?}");
    }
}

#[test]
fn a_compressed_stream_that_is_cut_or_changed_is_noticed() {
    let noise: Vec<u8> = (0..4096_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for header in promises([16, 16, 16]) {
        let whole = gzip(&[header, noise.clone()].concat());
        assert!(read(&whole).is_ok());
        for length in [0, 1, 2, 5, 30, whole.len() / 2, whole.len() - 20, whole.len() - 1] {
            assert!(read(&whole[..length]).is_err(), "cut to {length}");
        }
        let mut changed = whole.clone();
        let checksum = whole.len() - 8;
        changed[checksum] ^= 1;
        assert_says(read(&changed), "corrupt");
    }
}

#[test]
fn a_gzip_bomb_is_left_at_the_promised_size() {
    let zeros = gzip(&vec![0; 1 << 20]);
    for header in promises([16, 16, 16]) {
        // A thousand members of a megabyte each: a gigabyte of zeros behind a promise of 4096.
        let bomb = [gzip(&header), zeros.repeat(1000)].concat();
        let mut counted = Counted { input: bomb.as_slice(), taken: 0 };
        assert!(from_bytes(&mut counted, &LIMITS).is_ok());
        assert!(counted.taken < bomb.len() as u64 / 2, "{} of {} bytes taken", counted.taken, bomb.len());
    }
    let mut nested = gzip(&gzip(&promises([4, 4, 4])[0]));
    assert!(matches!(read(&nested), Err(DecodeError::UnknownFormat { .. })));
    nested.truncate(3);
    assert!(read(&nested).is_err());
}

#[test]
fn voxels_that_a_header_puts_far_away_are_not_looked_for() {
    let file = NiftiFile { version: 2, vox_offset: 544, ..NiftiFile::of(ScalarType::U8, false) };
    for offset in [i64::MAX, i64::MIN, -1, 100, 1 << 40] {
        let mut bytes = file.bytes();
        bytes[168..176].copy_from_slice(&offset.to_le_bytes());
        assert!(matches!(read(&bytes), Err(DecodeError::Malformed(_))), "{offset}");
        assert!(matches!(read(&gzip(&bytes)), Err(DecodeError::Malformed(_))), "{offset}");
    }
    let mut bytes = NiftiFile::of(ScalarType::U8, false).bytes();
    bytes[108..112].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_says(read(&bytes), "vox_offset NaN");
}

#[test]
fn placements_that_are_not_finite_or_flat_are_refused() {
    let file = NiftiFile::of(ScalarType::U8, false);
    let flat = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]];
    assert_says(read(&NiftiFile { sform: Some(flat), ..file.clone() }.bytes()), "spacing must be positive");
    let nan = [[f64::NAN; 4]; 3];
    assert!(matches!(read(&NiftiFile { sform: Some(nan), ..file.clone() }.bytes()), Err(DecodeError::Volume(_))));
    let qform = Some([f64::INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert!(matches!(read(&NiftiFile { qform, ..file.clone() }.bytes()), Err(DecodeError::Volume(_))));
    let pixdim = [1.0, f64::INFINITY, 1.0, 1.0];
    assert!(matches!(read(&NiftiFile { pixdim, ..file }.bytes()), Err(DecodeError::Volume(_))));
}

#[test]
fn what_is_no_volume_is_an_unknown_format() {
    for bytes in [&b""[..], b"\0", b"GIF89a", b"NRRD", b"Objects = 3\n", b"NDims 3\n", &[0x1f, 0x8b]] {
        let result = read(bytes);
        assert!(matches!(result, Err(DecodeError::UnknownFormat { .. } | DecodeError::Malformed(_))), "{bytes:?}");
    }
    assert_says(read(b"GIF89a\x01\x02\x03"), "got a file that starts with \"GIF89a\\x01\\x02\"");
    assert_says(read(&348_i32.to_le_bytes()), "expected a header of 348 bytes, got 4");
    let mut analyze = NiftiFile::of(ScalarType::U8, false).bytes();
    analyze[344..348].fill(0);
    assert_says(read(&analyze), "expected the magic n+1");
}

/// Valid files of every format, to be changed.
fn seeds() -> Vec<Vec<u8>> {
    let nifti = NiftiFile { qform: Some([0.1; 6]), ..NiftiFile::of(ScalarType::I16, false) };
    let sheared = [[1.0, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0]];
    let nifti2 =
        NiftiFile { version: 2, vox_offset: 544, sform: Some(sheared), ..NiftiFile::of(ScalarType::F64, true) };
    let floats = encode(&sample(ScalarType::F32), ScalarType::F32, true);
    let nrrd = "NRRD0004\ntype: float\ndimension: 4\nsizes: 1 3 4 5\nendian: big\nencoding: gzip\nkinds: list space space space\n\
                space: RAS\nspace directions: none (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\nbyte skip: 0\n\n";
    let meta = "ObjectType = Image\nNDims = 3\nDimSize = 3 4 5\nElementType = MET_FLOAT\nElementByteOrderMSB = True\n\
                TransformMatrix = 1 0 0 0 1 0 0 0 1\nElementSpacing = 1 1 2\nCompressedData = True\nElementDataFile = LOCAL\n";
    let files = vec![nifti.bytes(), nifti2.bytes(), attached(nrrd, &gzip(&floats)), attached(meta, &zlib(&floats))];
    files.iter().for_each(|file| assert!(read(file).is_ok()));
    files.iter().map(|file| gzip(file)).chain(files.clone()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_never_panic(
        start in prop::sample::select(vec![&b""[..], b"NRRD0005\n", b"NDims = 3\n", b"\x1f\x8b\x08\0", b"\x5c\x01\0\0", b"\0\0\x02\x1c"]),
        rest in prop::collection::vec(any::<u8>(), 0..800),
    ) {
        let _ = read(&[start, &rest].concat());
    }

    #[test]
    fn changed_files_never_panic(
        seed in 0..8_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        within in prop::sample::select(vec![60_usize, 400, 100_000]),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = seeds().swap_remove(seed);
        let within = within.min(bytes.len());
        changes.iter().for_each(|(index, byte)| bytes[index.index(within)] = *byte);
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(volume) = read(&bytes) {
            prop_assert!(volume.scalars().len() as u64 <= LIMITS.max_voxels);
            let (low, high) = volume.value_range();
            prop_assert!(low.is_finite() && high.is_finite() && low <= high);
        }
    }
}
