//! The bytes of one volume file: counted, bounded, perhaps inflated.
//!
//! A [`Source`] knows how many bytes remain where that can be known (a plain file), so that a
//! promise can be held against it before memory is taken; where it cannot (a stream, anything
//! compressed) it says so, and the reader takes memory as bytes come. Which other file a header may
//! name is decided here too.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read};
use std::path::{Component, Path, PathBuf};

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use super::decode::DecodeError;

/// Bytes of a header's comments, extensions and skips at most where the length of the file is not
/// known: enough for any real file, and a bound on the work of inflating zeros.
const MAX_SKIP: u64 = 1 << 28;
/// Bytes of a text header at most.
const MAX_TEXT_HEADER: u64 = 1 << 20;

/// A file's bytes from the current position on.
pub(super) struct Source<'a> {
    input: BufReader<Box<dyn Read + 'a>>,
    /// Bytes that remain, where that is known before they are read.
    left: Option<u64>,
    /// True where a checksum follows the bytes.
    compressed: bool,
    /// The file, where it is one: data files are looked for beside it.
    path: Option<PathBuf>,
    /// Bytes that lines of text may still take.
    text_left: u64,
}

impl<'a> Source<'a> {
    pub(super) const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

    fn new(bytes: Box<dyn Read + 'a>, left: Option<u64>, compressed: bool, path: Option<PathBuf>) -> Self {
        Self { input: BufReader::with_capacity(1 << 16, bytes), left, compressed, path, text_left: MAX_TEXT_HEADER }
    }

    /// A regular file of `length` bytes that may name files beside it.
    pub(super) fn from_file(file: File, length: u64, path: &Path) -> Self {
        Self::new(Box::new(file), Some(length), false, Some(path.to_owned()))
    }

    /// Bytes from anywhere, which may name no files.
    pub(super) fn from_stream(bytes: impl Read + 'a) -> Self {
        Self::new(Box::new(bytes), None, false, None)
    }

    /// The bytes that follow, inflated (gzip, of any number of members).
    pub(super) fn gunzip(self) -> Self {
        Self::new(Box::new(MultiGzDecoder::new(self.input)), None, true, self.path)
    }

    /// The bytes that follow, inflated (zlib).
    pub(super) fn inflate(self) -> Self {
        Self::new(Box::new(ZlibDecoder::new(self.input)), None, true, self.path)
    }

    /// Bytes that remain, where that is known.
    pub(super) fn left(&self) -> Option<u64> {
        self.left
    }

    /// The file's path, where it is one.
    pub(super) fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// The next `count` bytes, fewer where the file ends, without moving on.
    pub(super) fn peek(&mut self, count: u64) -> Result<Vec<u8>, DecodeError> {
        let mut head = Vec::new();
        self.input.by_ref().take(count).read_to_end(&mut head).map_err(read_error)?;
        let rest = std::mem::replace(&mut self.input, BufReader::with_capacity(0, Box::new(io::empty())));
        self.input = BufReader::with_capacity(1 << 16, Box::new(Cursor::new(head.clone()).chain(rest)));
        Ok(head)
    }

    /// The next line of a text header without its line end; `None` at the end of the file.
    pub(super) fn text_line(&mut self) -> Result<Option<String>, DecodeError> {
        let mut line = Vec::new();
        let budget = self.text_left;
        let taken = self.by_ref().take(budget).read_until(b'\n', &mut line).map_err(read_error)? as u64;
        self.text_left -= taken;
        if taken == budget && line.last() != Some(&b'\n') {
            return Err(DecodeError::Malformed(format!("expected a text header of at most {MAX_TEXT_HEADER} bytes")));
        }
        let text = String::from_utf8_lossy(&line);
        Ok((taken > 0).then(|| text.trim_end_matches(['\n', '\r']).to_owned()))
    }

    /// Moves on by `count` bytes.
    pub(super) fn skip(&mut self, count: u64) -> Result<(), DecodeError> {
        let most = self.left.unwrap_or(MAX_SKIP);
        if count > most {
            let message =
                format!("expected the voxels within {most} bytes, got a header that puts {count} before them");
            return Err(DecodeError::Malformed(message));
        }
        let skipped = io::copy(&mut self.by_ref().take(count), &mut io::sink()).map_err(read_error)?;
        if skipped < count {
            let message = format!("expected {count} bytes before the voxels, got {skipped}");
            return Err(DecodeError::Malformed(message));
        }
        Ok(())
    }

    /// Moves past `count` line ends.
    pub(super) fn skip_lines(&mut self, count: u64) -> Result<(), DecodeError> {
        for line in 0..count {
            if self.skip_until(b'\n').map_err(read_error)? == 0 {
                return Err(DecodeError::Malformed(format!("expected {count} lines before the voxels, got {line}")));
            }
        }
        Ok(())
    }

    /// Checks the checksum of a compressed stream that ends here; says nothing of any other.
    pub(super) fn check_end(&mut self) -> Result<(), DecodeError> {
        if self.compressed {
            self.fill_buf().map_err(read_error)?;
        }
        Ok(())
    }

    /// Opens the data file that a header names: a plain file name in the header's own folder.
    pub(super) fn companion<'b>(&self, name: &str) -> Result<Source<'b>, DecodeError> {
        let Some(path) = &self.path else {
            let message = format!("expected voxels in the file itself, got a header that names the data file {name:?}");
            return Err(DecodeError::Unsupported(message));
        };
        let name = name.strip_prefix("./").unwrap_or(name);
        let mut components = Path::new(name).components();
        let plain = matches!((components.next(), components.next()), (Some(Component::Normal(_)), None));
        if !plain || name.contains(['/', '\\', ':', '\0']) {
            let message =
                format!("expected a data file in the header's own folder, named without a path, got {name:?}");
            return Err(DecodeError::Malformed(message));
        }
        super::decode::open(&path.with_file_name(name))
    }
}

impl Read for Source<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        self.left = self.left.map(|left| left.saturating_sub(count as u64));
        Ok(count)
    }
}

impl BufRead for Source<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.input.fill_buf()
    }

    fn consume(&mut self, count: usize) {
        self.input.consume(count);
        self.left = self.left.map(|left| left.saturating_sub(count as u64));
    }
}

/// Tells a corrupt stream, whose sender is to blame, from a failing disk or connection.
pub(super) fn read_error(error: io::Error) -> DecodeError {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => DecodeError::Malformed("compressed data ends early".to_owned()),
        io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => {
            DecodeError::Malformed(format!("compressed data is corrupt: {error}"))
        }
        _ => DecodeError::Io { what: "the file".to_owned(), source: error },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peeking_moves_nothing_and_left_counts_down() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        std::fs::write(&path, b"first\r\nsecond\nrest").unwrap();
        let mut source = Source::from_file(File::open(&path).unwrap(), 18, &path);
        assert_eq!(source.peek(5).unwrap(), b"first");
        assert_eq!(source.left(), Some(18));
        assert_eq!(source.text_line().unwrap().as_deref(), Some("first"));
        source.skip_lines(1).unwrap();
        assert_eq!(source.left(), Some(4));
        source.skip(1).unwrap();
        assert!(source.skip(4).is_err());
        assert_eq!(source.peek(99).unwrap(), b"est");
    }

    #[test]
    fn only_plain_names_in_the_same_folder_are_followed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.nhdr");
        std::fs::write(&path, b"x").unwrap();
        std::fs::write(folder.path().join("x.raw"), b"data").unwrap();
        let source = Source::from_file(File::open(&path).unwrap(), 1, &path);
        for name in ["x.raw", "./x.raw"] {
            assert_eq!(source.companion(name).unwrap().left(), Some(4));
        }
        for name in ["/etc/passwd", "../x.raw", "..", ".", "", "a/x.raw", "././x.raw", "a\\x.raw", "C:x.raw", "x\0.raw"]
        {
            assert!(matches!(source.companion(name), Err(DecodeError::Malformed(_))), "{name:?}");
        }
        assert!(matches!(source.companion("missing.raw"), Err(DecodeError::Io { .. })));
        assert!(matches!(source.companion(".hidden"), Err(DecodeError::Io { .. })));
    }

    #[test]
    fn a_header_without_end_is_given_up() {
        let mut endless = Source::from_stream(io::repeat(b'x'));
        assert!(matches!(endless.text_line(), Err(DecodeError::Malformed(_))));
        let mut lines = Source::from_stream(Cursor::new(b"y\n".repeat(1 << 20)));
        let stop = std::iter::repeat_with(|| lines.text_line()).find(|line| !matches!(line, Ok(Some(_))));
        assert!(matches!(stop, Some(Err(DecodeError::Malformed(_)))), "{stop:?}");
    }
}
