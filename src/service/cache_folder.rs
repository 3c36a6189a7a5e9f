//! Encodings kept across restarts.
//!
//! A folder on disk outlives the program that wrote it, other programs can write to it, and a
//! machine can lose its power in the middle of a write. So nothing in it is taken on trust: a file
//! is written beside its place, synced and renamed; it names the format, the program and the key
//! (content of the volume, transfer function, threshold) that it was made for; a checksum over all
//! of it is compared before the first byte is interpreted. What does not fit is logged and built
//! anew. The checksum guards against accidents; who may write the folder may still write nonsense
//! with a good checksum, against which the reader of the payload checks every length.
//!
//! ```text
//! magic (8) | format: u32 | key length: u32 | key | payload | checksum: u128 (xxh3) of all before it
//! ```
//! Numbers are little endian.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use xxhash_rust::xxh3::{Xxh3, xxh3_128};

use super::metrics;

const MAGIC: &[u8; 8] = b"SHEARRLE";

/// Raised whenever the payload's layout changes.
const FORMAT: u32 = 2;

/// Bytes of the checksum at the end.
const CHECKSUM_BYTES: u64 = 16;

/// Extension of the files; no other file in the folder is touched.
const EXTENSION: &str = "encoding";

/// A folder of encodings, limited in bytes.
#[derive(Clone, Debug)]
pub struct CacheFolder {
    path: PathBuf,
    limit: u64,
}

impl CacheFolder {
    /// The folder at `path`, made if it is not there, for at most `limit` bytes.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn open(path: &Path, limit: u64) -> io::Result<Self> {
        fs::create_dir_all(path)?;
        Ok(Self { path: path.to_owned(), limit })
    }

    /// What was kept for `key`, read by `read`; `None` where there is nothing or nothing sound.
    pub fn load<T>(&self, key: &str, read: impl FnOnce(&mut dyn Read) -> io::Result<T>) -> Option<T> {
        let path = self.path_of(key);
        match self.try_load(&path, key, read) {
            Ok(value) => {
                metrics::cache_folder("hit");
                Some(value)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                metrics::cache_folder("absent");
                None
            }
            Err(error) => {
                metrics::cache_folder("refused");
                tracing::warn!(file = %path.display(), %error, "kept encoding is not used and will be built anew");
                None
            }
        }
    }

    fn try_load<T>(&self, path: &Path, key: &str, read: impl FnOnce(&mut dyn Read) -> io::Result<T>) -> io::Result<T> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        if length > self.limit {
            return Err(invalid(format!("expected at most {} bytes, got {length}", self.limit)));
        }
        let body = length.checked_sub(CHECKSUM_BYTES).ok_or_else(|| invalid("truncated"))?;

        // The checksum first: nothing is interpreted before all of it has been seen.
        let mut hash = Xxh3::new();
        let mut input = BufReader::with_capacity(1 << 20, &file);
        let hashed = io::copy(&mut (&mut input).take(body), &mut HashWriter(&mut hash))?;
        let mut expected = [0; CHECKSUM_BYTES as usize];
        input.read_exact(&mut expected)?;
        if hashed != body || hash.digest128().to_le_bytes() != expected {
            return Err(invalid("the checksum does not match"));
        }

        // Then the header, which must be the one that this program would write.
        file.seek(SeekFrom::Start(0))?;
        let mut input = BufReader::with_capacity(1 << 20, &file).take(body);
        let header = header(key);
        let mut got = vec![0; header.len()];
        input.read_exact(&mut got)?;
        if got != header {
            return Err(invalid("stale: made by another version or for other data"));
        }

        let value = read(&mut input)?;
        if input.limit() != 0 {
            return Err(invalid(format!("{} bytes too many", input.limit())));
        }
        // The time of the last use decides what goes first; a read-only folder still serves.
        let _ = file.set_modified(SystemTime::now());
        Ok(value)
    }

    /// Keeps what `write` writes for `key`, and deletes the files used least recently where the
    /// folder has grown beyond its limit.
    ///
    /// # Errors
    /// Where the folder cannot be written; what was there before is then still there.
    pub fn save(&self, key: &str, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        let file = tempfile::Builder::new().suffix(&format!(".{EXTENSION}")).tempfile_in(&self.path)?;
        let mut output =
            ChecksummedWriter { inner: BufWriter::with_capacity(1 << 20, file.as_file()), hash: Xxh3::new() };
        output.write_all(&header(key))?;
        write(&mut output)?;
        output.finish()?;
        file.as_file().sync_all()?;
        file.persist(self.path_of(key)).map_err(|error| error.error)?;
        File::open(&self.path)?.sync_all()?;
        self.prune()
    }

    fn prune(&self) -> io::Result<()> {
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.path)? {
            let path = entry?.path();
            if path.extension().is_some_and(|extension| extension == EXTENSION) {
                let metadata = fs::metadata(&path)?;
                files.push((metadata.modified()?, metadata.len(), path));
            }
        }
        files.sort();
        let mut total: u64 = files.iter().map(|(_, length, _)| length).sum();
        for (_, length, path) in files {
            if total <= self.limit {
                break;
            }
            tracing::info!(file = %path.display(), "kept encoding deleted: the cache folder is full");
            fs::remove_file(&path)?;
            total -= length;
        }
        Ok(())
    }

    /// One file a key, whatever version of the program wrote it, so that a new version replaces it.
    fn path_of(&self, key: &str) -> PathBuf {
        self.path.join(format!("{:032x}.{EXTENSION}", xxh3_128(key.as_bytes())))
    }
}

/// What a sound file for `key` starts with.
fn header(key: &str) -> Vec<u8> {
    let key = format!("{} {key}", env!("CARGO_PKG_VERSION"));
    let mut header = MAGIC.to_vec();
    header.extend(FORMAT.to_le_bytes());
    header.extend(u32::try_from(key.len()).expect("a key is shorter than 4 GiB").to_le_bytes());
    header.extend(key.as_bytes());
    header
}

fn invalid(detail: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, detail.into())
}

/// Feeds a hash.
struct HashWriter<'a>(&'a mut Xxh3);

impl Write for HashWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes through and hashes what it writes.
struct ChecksummedWriter<W> {
    inner: W,
    hash: Xxh3,
}

impl<W: Write> ChecksummedWriter<W> {
    /// Writes the checksum of what was written.
    fn finish(mut self) -> io::Result<()> {
        self.inner.write_all(&self.hash.digest128().to_le_bytes())?;
        self.inner.flush()
    }
}

impl<W: Write> Write for ChecksummedWriter<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.hash.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "volume transfer 0.002";

    fn folder(limit: u64) -> (tempfile::TempDir, CacheFolder) {
        let temp = tempfile::tempdir().unwrap();
        let folder = CacheFolder::open(&temp.path().join("made"), limit).unwrap();
        (temp, folder)
    }

    fn save(folder: &CacheFolder, key: &str, payload: &[u8]) {
        folder.save(key, |out| out.write_all(payload)).unwrap();
    }

    fn load(folder: &CacheFolder, key: &str) -> Option<Vec<u8>> {
        folder.load(key, |input| {
            let mut payload = vec![];
            input.read_to_end(&mut payload)?;
            Ok(payload)
        })
    }

    #[test]
    fn what_was_saved_is_loaded_and_nothing_else() {
        let (_temp, folder) = folder(1 << 20);
        assert_eq!(load(&folder, KEY), None);
        save(&folder, KEY, b"payload");
        assert_eq!(load(&folder, KEY).as_deref(), Some(&b"payload"[..]));
        assert_eq!(load(&folder, "another key"), None);
        save(&folder, KEY, b"newer");
        assert_eq!(load(&folder, KEY).as_deref(), Some(&b"newer"[..]));
    }

    #[test]
    fn every_flipped_byte_and_every_truncation_is_noticed() {
        let (_temp, folder) = folder(1 << 20);
        save(&folder, KEY, b"payload");
        let path = folder.path_of(KEY);
        let sound = fs::read(&path).unwrap();
        for index in 0..sound.len() {
            let mut corrupt = sound.clone();
            corrupt[index] ^= 1;
            fs::write(&path, &corrupt).unwrap();
            assert_eq!(load(&folder, KEY), None, "byte {index} flipped");
            fs::write(&path, &sound[..index]).unwrap();
            assert_eq!(load(&folder, KEY), None, "cut to {index} bytes");
        }
        fs::write(&path, [&sound[..], b"x"].concat()).unwrap();
        assert_eq!(load(&folder, KEY), None, "one byte too many");
    }

    #[test]
    fn a_file_for_another_key_or_version_is_stale_though_its_checksum_is_right() {
        let (_temp, folder) = folder(1 << 20);
        save(&folder, "other", b"payload");
        fs::rename(folder.path_of("other"), folder.path_of(KEY)).unwrap();
        assert_eq!(load(&folder, KEY), None);
    }

    #[test]
    fn a_payload_that_is_not_read_to_its_end_is_refused() {
        let (_temp, folder) = folder(1 << 20);
        save(&folder, KEY, b"payload");
        assert!(folder.load(KEY, |input| input.read_exact(&mut [0; 3])).is_none());
    }

    #[test]
    fn a_failed_write_leaves_what_was_there() {
        let (_temp, folder) = folder(1 << 20);
        save(&folder, KEY, b"payload");
        assert!(folder.save(KEY, |_| Err(invalid("disk full"))).is_err());
        assert_eq!(load(&folder, KEY).as_deref(), Some(&b"payload"[..]));
        assert_eq!(fs::read_dir(&folder.path).unwrap().count(), 1, "no temporary file stays");
    }

    #[test]
    fn the_folder_stays_below_its_limit_and_keeps_the_newest_and_foreign_files() {
        let (_temp, folder) = folder(700);
        fs::write(folder.path.join("notes.txt"), [0; 2000]).unwrap();
        for key in ["a", "b", "c"] {
            save(&folder, key, &[7; 300]);
            let file = File::options().write(true).open(folder.path_of(key)).unwrap();
            let age = std::time::Duration::from_secs(if key == "a" { 100 } else { 50 });
            file.set_modified(SystemTime::now() - age).unwrap();
        }
        assert_eq!(load(&folder, "a"), None);
        assert!(load(&folder, "c").is_some());
        assert!(folder.path.join("notes.txt").exists());
    }
}
