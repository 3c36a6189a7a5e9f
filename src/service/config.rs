//! What an operator may choose.
//!
//! The problem with defaults in code is that their documentation drifts away from them. Here the
//! documented file `config/default.toml` is built into the program and is the only place where a
//! default stands; a file, the environment and the command line's flags are laid over it in this
//! order. Every struct refuses unknown keys, so that a typing error ends the start with a message.

use std::net::SocketAddr;
use std::num::{NonZeroU32, NonZeroU64, NonZeroUsize};
use std::path::{Path, PathBuf};
use std::time::Duration;

use figment::Figment;
use figment::providers::{Env, Format, Toml};
use serde::{Deserialize, Deserializer, de};

use super::request::ImageLimits;

/// The built-in defaults, with the reason for each.
pub const DEFAULTS: &str = include_str!("../../config/default.toml");

/// Prefix of environment variables that set a key.
const ENVIRONMENT: &str = "SHEARWARP_";

/// Variables with the prefix that are no keys: `SHEARWARP_DATA` tells the tests where scans are.
const NOT_KEYS: &[&str] = &["data"];

/// The whole configuration; see `config/default.toml` for units and reasons.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    pub listen: SocketAddr,
    #[serde(deserialize_with = "folder")]
    pub volumes: Option<PathBuf>,
    pub log: Log,
    pub http: Http,
    pub render: Render,
    pub stream: Stream,
    pub image: Image,
    pub volume: Volume,
    pub meshes: Meshes,
    pub cache: Cache,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    pub format: LogFormat,
    pub filter: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    Text,
    Json,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Http {
    pub max_connections: NonZeroUsize,
    #[serde(rename = "header_timeout_seconds", deserialize_with = "seconds")]
    pub header_timeout: Duration,
    #[serde(rename = "body_timeout_seconds", deserialize_with = "seconds")]
    pub body_timeout: Duration,
    #[serde(rename = "write_timeout_seconds", deserialize_with = "seconds")]
    pub write_timeout: Duration,
    pub max_body_bytes: NonZeroUsize,
    pub max_scene_bytes: NonZeroUsize,
    pub max_scenes: NonZeroUsize,
    #[serde(rename = "shutdown_seconds", deserialize_with = "seconds")]
    pub shutdown: Duration,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Render {
    /// 0: as many as there are cores.
    pub threads: usize,
    pub jobs: NonZeroUsize,
    pub queue: usize,
    pub retry_after_seconds: NonZeroU64,
    #[serde(rename = "deadline_seconds", deserialize_with = "seconds")]
    pub deadline: Duration,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stream {
    pub max_streams: NonZeroUsize,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Image {
    pub max_side: u32,
    pub max_pixels: u64,
    pub max_frames: NonZeroU32,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Volume {
    pub max_voxels: u64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Meshes {
    pub max_upload_bytes: NonZeroUsize,
    pub max_bytes: u64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cache {
    pub classified_bytes: u64,
    #[serde(deserialize_with = "folder")]
    pub folder: Option<PathBuf>,
    pub folder_bytes: u64,
}

impl Image {
    /// As requests are checked against them.
    pub fn limits(&self) -> ImageLimits {
        ImageLimits { max_side: self.max_side, max_pixels: self.max_pixels }
    }
}

/// The keys that have a flag on the command line; `None` leaves what the other sources say.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    pub listen: Option<SocketAddr>,
    pub volumes: Option<PathBuf>,
    pub threads: Option<usize>,
}

/// Why there is no configuration: the key, where it was set, and what was expected.
#[derive(Debug, thiserror::Error)]
#[error("configuration: {0}")]
pub struct ConfigError(Box<figment::Error>);

impl From<figment::Error> for ConfigError {
    fn from(error: figment::Error) -> Self {
        Self(Box::new(error))
    }
}

impl Config {
    /// The defaults, then `file`, then the environment, then `overrides`.
    ///
    /// # Errors
    /// Where the file cannot be read, a key is unknown, or a value is of the wrong type or range.
    pub fn load(file: Option<&Path>, overrides: &Overrides) -> Result<Self, ConfigError> {
        let mut figment = Figment::from(Toml::string(DEFAULTS));
        if let Some(file) = file {
            figment = figment.merge(Toml::file_exact(file));
        }
        figment = figment.merge(Env::prefixed(ENVIRONMENT).ignore(NOT_KEYS).split("__"));
        if let Some(listen) = overrides.listen {
            figment = figment.merge(("listen", listen));
        }
        if let Some(volumes) = &overrides.volumes {
            figment = figment.merge(("volumes", volumes));
        }
        if let Some(threads) = overrides.threads {
            figment = figment.merge(("render.threads", threads));
        }
        Ok(figment.extract()?)
    }
}

/// A positive number of seconds, fractions allowed.
fn seconds<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
    let seconds = f64::deserialize(deserializer)?;
    let longest = Duration::from_secs(7 * 24 * 3600);
    Duration::try_from_secs_f64(seconds).ok().filter(|d| !d.is_zero() && *d <= longest).ok_or_else(|| {
        de::Error::custom(format!("expected a number of seconds above 0 and at most a week, got {seconds}"))
    })
}

/// A folder; the empty string is none.
fn folder<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<PathBuf>, D::Error> {
    Ok(Some(PathBuf::deserialize(deserializer)?).filter(|path| !path.as_os_str().is_empty()))
}

#[cfg(test)]
mod tests {
    use figment::Jail;

    use super::*;

    #[test]
    #[expect(clippy::result_large_err, reason = "the type of Jail's closure")]
    fn flags_beat_the_environment_beats_the_file_beats_the_defaults() {
        Jail::expect_with(|jail| {
            jail.create_file("a.toml", "listen = \"127.0.0.1:1\"\n[render]\nthreads = 3\nqueue = 5\njobs = 7\n")?;
            jail.set_env("SHEARWARP_RENDER__THREADS", "4");
            jail.set_env("SHEARWARP_RENDER__QUEUE", "6");
            let overrides = Overrides { threads: Some(9), ..Overrides::default() };
            let config = Config::load(Some(Path::new("a.toml")), &overrides).expect("sound");
            assert_eq!((config.render.threads, config.render.queue, config.render.jobs.get()), (9, 6, 7));
            assert_eq!(config.listen.port(), 1);
            assert_eq!(config.http.max_body_bytes.get(), 1 << 20);
            Ok(())
        });
    }

    #[test]
    #[expect(clippy::result_large_err, reason = "the type of Jail's closure")]
    fn unknown_keys_are_refused_by_name_wherever_they_stand() {
        Jail::expect_with(|jail| {
            jail.create_file("a.toml", "[render]\nthraeds = 3\n")?;
            let error = Config::load(Some(Path::new("a.toml")), &Overrides::default()).unwrap_err().to_string();
            assert!(error.contains("thraeds") && error.contains("a.toml"), "{error}");
            jail.set_env("SHEARWARP_LISTNE", "127.0.0.1:1");
            let error = Config::load(None, &Overrides::default()).unwrap_err().to_string();
            assert!(error.contains("listne"), "{error}");
            Ok(())
        });
    }

    #[test]
    #[expect(clippy::result_large_err, reason = "the type of Jail's closure")]
    fn values_out_of_range_are_refused() {
        Jail::expect_with(|jail| {
            for bad in ["[render]\ndeadline_seconds = 0", "[render]\njobs = 0", "[http]\nmax_body_bytes = -1"] {
                jail.create_file("a.toml", bad)?;
                assert!(Config::load(Some(Path::new("a.toml")), &Overrides::default()).is_err(), "{bad}");
            }
            assert!(Config::load(Some(Path::new("missing.toml")), &Overrides::default()).is_err());
            Ok(())
        });
    }
}
