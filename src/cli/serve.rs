//! `shearwarp serve`

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use shearwarp::service;
use shearwarp::service::config::{Config, Overrides};

use super::Failure;

#[derive(Args, Debug)]
pub struct Arguments {
    /// Configuration; keys that it does not name keep their defaults
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Address and port; port 0 takes a free one [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDR")]
    listen: Option<SocketAddr>,
    /// Folder of volumes [default: the built-in demo volume]
    #[arg(long, value_name = "DIR")]
    volumes: Option<PathBuf>,
    /// Threads that render [default: all cores]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
}

/// Serves until told to stop.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let overrides =
        Overrides { listen: arguments.listen, volumes: arguments.volumes.clone(), threads: arguments.threads };
    let config =
        Config::load(arguments.config.as_deref(), &overrides).map_err(|error| Failure::Usage(error.to_string()))?;
    service::serve(config).map_err(|error| Failure::Other(error.to_string()))
}
