//! Files -> volumes: sniff the format, enforce limits before memory is taken, dispatch.
//!
//! A volume file is somebody else's bytes: its name says little and its header may lie. So the
//! format is told by content, every format is parsed to one `voxels::Header`, and
//! one place checks that header against the [`Limits`] and against the bytes that are really there
//! before it takes memory. What arrives as a stream of unknown length (uploads, anything
//! compressed) is read into memory that grows with what has come, never with what was promised,
//! and never beyond the promise.
//!
//! A header whose voxels stand in another file is followed only from a path, and only to a plain
//! file name in the header's own folder; [`from_bytes`] follows none.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use super::source::Source;
use super::{Volume, VolumeError, metaimage, nifti, nrrd, raw};

pub use super::raw::{RawLayout, RawLayoutError};

/// What a file may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Voxels of one volume at most, its left-out interleaved components included. Memory while
    /// decoding stays below 10 bytes per voxel (f64; 2 for 8 bit, 4 for 16 bit, 6 for 32 bit).
    pub max_voxels: u64,
}

impl Default for Limits {
    /// 1024^3 voxels.
    fn default() -> Self {
        Self { max_voxels: 1 << 30 }
    }
}

/// Why a file did not become a volume.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// No format that is known.
    #[error("unknown format: expected NIfTI-1, NIfTI-2, NRRD or MetaImage, got a file that starts with {head}")]
    UnknownFormat {
        /// The first bytes, escaped.
        head: String,
    },
    /// A volume beyond [`Limits::max_voxels`].
    #[error("too large: expected at most {limit} voxels, got dimensions {dims}")]
    TooLarge {
        /// The dimensions as the header gives them, `256 x 256 x 128`.
        dims: String,
        limit: u64,
    },
    /// A header or a compressed stream that breaks its format's rules.
    #[error("{0}")]
    Malformed(String),
    /// Fewer voxels than the header promises.
    #[error("truncated: expected {expected} bytes of voxels, got {got}")]
    Truncated { expected: u64, got: u64 },
    /// A valid file of a kind that is not rendered.
    #[error("{0}")]
    Unsupported(String),
    /// Voxels and a placement that do not make a volume.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// The file, or the data file that its header names, could not be read.
    #[error("cannot read {what}: {source}")]
    Io { what: String, source: io::Error },
}

/// Reads a NIfTI, NRRD or MetaImage file, told apart by content.
///
/// # Errors
/// See [`DecodeError`]; nothing is kept in memory.
pub fn load(path: &Path, limits: &Limits) -> Result<Volume, DecodeError> {
    decode(open(path)?, limits)
}

/// Reads a bare array of the given layout; the file must have exactly its size.
///
/// # Errors
/// See [`DecodeError`]; a file of another size is [`DecodeError::Malformed`].
pub fn load_raw(path: &Path, layout: &RawLayout, limits: &Limits) -> Result<Volume, DecodeError> {
    raw::read(open(path)?, layout, limits)
}

/// Reads one file's bytes from a stream. A header whose voxels stand in another file is refused.
///
/// # Errors
/// See [`DecodeError`].
pub fn from_bytes(bytes: impl Read, limits: &Limits) -> Result<Volume, DecodeError> {
    decode(Source::from_stream(bytes), limits)
}

/// The id of a volume file: its name without the known extension, `engine.nii.gz` -> `engine`.
/// `None` where the name has none of them, or nothing else.
pub fn volume_id(file_name: &str) -> Option<String> {
    const EXTENSIONS: [&str; 7] = [".nii.gz", ".nii", ".nrrd", ".nhdr", ".mha", ".mhd", ".hdr"];
    EXTENSIONS.iter().find_map(|extension| {
        let stem = file_name.len().checked_sub(extension.len()).filter(|&stem| stem > 0)?;
        let found = file_name.get(stem..)?.eq_ignore_ascii_case(extension);
        found.then(|| file_name[..stem].to_owned())
    })
}

/// True for a file name that [`volume_id`] knows.
pub fn is_volume_name(file_name: &str) -> bool {
    volume_id(file_name).is_some()
}

/// Opens a regular file (a pipe or a device could block for ever, or never end).
pub(super) fn open<'a>(path: &Path) -> Result<Source<'a>, DecodeError> {
    let failed = |source| DecodeError::Io { what: path.display().to_string(), source };
    let metadata = path.metadata().map_err(failed)?;
    if !metadata.is_file() {
        return Err(failed(io::Error::new(io::ErrorKind::InvalidInput, "expected a regular file")));
    }
    Ok(Source::from_file(File::open(path).map_err(failed)?, metadata.len(), path))
}

/// Looks at the first bytes (inside one layer of gzip) and hands over to the format.
fn decode(mut source: Source<'_>, limits: &Limits) -> Result<Volume, DecodeError> {
    if source.peek(2)? == Source::GZIP_MAGIC {
        source = source.gunzip();
    }
    let head = source.peek(nifti::SNIFF_BYTES)?;
    if let Some(version) = nifti::sniff(&head) {
        nifti::read(source, version, limits)
    } else if nrrd::sniff(&head) {
        nrrd::read(source, limits)
    } else if metaimage::sniff(&head) {
        metaimage::read(source, limits)
    } else {
        let head = format!("\"{}\" ({} bytes looked at)", head[..head.len().min(8)].escape_ascii(), head.len());
        Err(DecodeError::UnknownFormat { head })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_id_is_the_name_without_its_known_extension() {
        for (name, id) in [
            ("engine.nii.gz", Some("engine")),
            ("Head.NII", Some("Head")),
            ("a.b.nrrd", Some("a.b")),
            ("x.mha", Some("x")),
            ("x.mhd", Some("x")),
            ("x.hdr", Some("x")),
            ("größe.nhdr", Some("größe")),
            (".nii", None),
            (".nii.gz", None),
            ("notes.gz", None),
            ("notes.txt", None),
            ("ß", None),
            ("", None),
        ] {
            assert_eq!(volume_id(name).as_deref(), id, "{name}");
            assert_eq!(is_volume_name(name), id.is_some(), "{name}");
        }
    }
}
