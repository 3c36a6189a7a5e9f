//! The command line: `serve`, `render`, `info`, `bench`.
//!
//! Arguments are read here; what a command does is in its module, and all of it by the library.
//! Exit status 0 on success, 2 on wrong usage (a refused request included), 1 otherwise, with one
//! line on stderr.

mod cli;

use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

use cli::{Cli, Failure};

fn main() -> ExitCode {
    let outcome = match Cli::try_parse() {
        Ok(cli) => cli.run(),
        Err(error) if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => error.exit(),
        Err(error) => Err(Failure::Usage(cli::complaint(&error.to_string()))),
    };
    let (message, status) = match outcome {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Usage(message)) => (message, 2),
        Err(Failure::Other(message)) => (message, 1),
    };
    eprintln!("error: {}", cli::one_line(&message));
    ExitCode::from(status)
}
