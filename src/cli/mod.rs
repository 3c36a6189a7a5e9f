//! What can be asked for on the command line, and how it fails.

mod bench;
mod info;
mod papers;
mod render;
mod scene;
mod serve;

use std::fmt::Display;
use std::io::{self, Write};

use clap::{Parser, Subcommand};

/// Multithreaded volume rendering by the shear-warp factorization. Without a command: serve.
#[derive(Debug, Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: serve::Arguments,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the service.
    Serve(serve::Arguments),
    /// Render one frame, or a turntable, without a server.
    Render(render::Arguments),
    /// Say what a volume is and what it takes in memory.
    Info(info::Arguments),
    /// Time frames around the vertical axis.
    Bench(bench::Arguments),
}

/// Why a command did not succeed, in one line.
#[derive(Debug)]
pub enum Failure {
    /// The command cannot be meant so: exit status 2.
    Usage(String),
    /// The command was fine, the world was not: exit status 1.
    Other(String),
}

impl Failure {
    /// A failure of the world, with what was attempted.
    fn of(what: impl Display) -> impl Fn(String) -> Self {
        move |reason| Self::Other(format!("{what}: {reason}"))
    }
}

impl Cli {
    /// Does what was asked for.
    ///
    /// # Errors
    /// See [`Failure`].
    pub fn run(self) -> Result<(), Failure> {
        match self.command {
            None => serve::run(&self.serve),
            Some(Command::Serve(arguments)) => serve::run(&arguments),
            Some(Command::Render(arguments)) => render::run(&arguments),
            Some(Command::Info(arguments)) => info::run(&arguments),
            Some(Command::Bench(arguments)) => bench::run(&arguments),
        }
    }
}

/// The parser's complaint without its heading, usage and tips.
pub fn complaint(message: &str) -> String {
    let lines: Vec<_> = message.lines().take_while(|line| !line.trim().is_empty()).collect();
    let paragraph = lines.join("\n");
    paragraph.strip_prefix("error: ").unwrap_or(&paragraph).to_owned()
}

/// A message that others wrote over several lines, on one.
pub fn one_line(message: &str) -> String {
    message.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ")
}

/// Writes to stdout. A reader who has seen enough (`| head`) is no failure.
fn print(text: &str) -> Result<(), Failure> {
    match io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Other(format!("stdout: {error}"))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_arguments_do_not_contradict_each_other() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_complaint_of_the_parser_is_one_line() {
        let message = Cli::try_parse_from(["shearwarp", "render"]).unwrap_err().to_string();
        let line = one_line(&complaint(&message));
        assert!(line.contains("VOLUME") && !line.contains('\n') && !line.starts_with("error"), "{line}");
    }
}
