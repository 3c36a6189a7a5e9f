//! `shearwarp render`

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use shearwarp::encode::animation::{Animation, MAX_FRAMES};
use shearwarp::encode::{Format, encode};
use shearwarp::service::request::RenderRequest;

use super::Failure;
use super::scene::{RequestArguments, Stage, VolumeArguments, refused};

/// Seconds that a frame of a turntable is shown: numerator and denominator.
const FRAME_DELAY: (u16, u16) = (1, 25);

#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    volume: VolumeArguments,
    /// The picture; with --turntable an .apng file or a folder
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Render N frames around the vertical axis
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_FRAMES)))]
    turntable: Option<u32>,
    /// png, jpeg, webp or raw [default: by the output's name]
    #[arg(long, value_name = "NAME", value_parser = format)]
    format: Option<Format>,
    #[command(flatten)]
    request: RequestArguments,
}

/// Where the pictures go.
enum Output {
    Picture(Format),
    /// Of so many frames.
    Animation(u32),
    Folder(u32, Format),
}

/// Renders and writes.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let request = arguments.request.read()?;
    let output = arguments.output(&request)?;
    let format = match output {
        Output::Picture(format) | Output::Folder(_, format) => format,
        Output::Animation(_) => Format::Png,
    };
    let request = request.with_format(format).map_err(refused)?;
    let stage = Stage::build(arguments.volume.load()?, request)?;
    match output {
        Output::Picture(_) => {
            let (image, _) = stage.frame(&stage.view(0.0)?)?;
            let bytes = encode(&image, format).map_err(|error| Failure::Other(error.to_string()))?;
            fs::write(&arguments.output, bytes).map_err(|error| arguments.failed(&error))
        }
        Output::Animation(frames) => arguments.animate(&stage, frames),
        Output::Folder(frames, _) => arguments.fill_folder(&stage, frames, format),
    }
}

impl Arguments {
    fn output(&self, request: &RenderRequest) -> Result<Output, Failure> {
        let extension = self.output.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let named = self.format.or(request.format());
        let Some(frames) = self.turntable else {
            let format = named.or(Format::from_extension(extension)).ok_or_else(|| {
                let path = self.output.display();
                Failure::Usage(format!("expected --format or a file ending in png, jpg, webp or raw, got {path}"))
            })?;
            return Ok(Output::Picture(format));
        };
        let animation = ["apng", "png"].iter().any(|e| extension.eq_ignore_ascii_case(e)) && !self.output.is_dir();
        match named {
            Some(format) if animation && format != Format::Png => {
                Err(Failure::Usage(format!("an animation is a png, got the format {}", format.name())))
            }
            _ if animation => Ok(Output::Animation(frames)),
            None if !extension.is_empty() && !self.output.is_dir() => {
                Err(Failure::Usage(format!("expected an .apng file or a folder, got {}", self.output.display())))
            }
            format => Ok(Output::Folder(frames, format.unwrap_or(Format::Png))),
        }
    }

    fn animate(&self, stage: &Stage, frames: u32) -> Result<(), Failure> {
        let mut file = BufWriter::new(File::create(&self.output).map_err(|error| self.failed(&error))?);
        let channels = stage.resolved.look.settings.background.channels() as u8;
        let mut animation = Animation::start(&mut file, stage.resolved.view.size(), channels, frames, FRAME_DELAY)
            .map_err(|error| self.failed(&error))?;
        for (_, degrees) in turns(frames) {
            let (image, _) = stage.frame(&stage.view(degrees)?)?;
            animation.push(&image).map_err(|error| self.failed(&error))?;
        }
        animation.finish().map_err(|error| self.failed(&error))?;
        file.into_inner().map(drop).map_err(|error| self.failed(error.error()))
    }

    fn fill_folder(&self, stage: &Stage, frames: u32, format: Format) -> Result<(), Failure> {
        fs::create_dir_all(&self.output).map_err(|error| self.failed(&error))?;
        for (frame, degrees) in turns(frames) {
            let (image, _) = stage.frame(&stage.view(degrees)?)?;
            let bytes = encode(&image, format).map_err(|error| self.failed(&error))?;
            let path = self.output.join(Path::new(&format!("{frame:04}.{}", format.extension())));
            fs::write(path, bytes).map_err(|error| self.failed(&error))?;
        }
        Ok(())
    }

    fn failed(&self, error: &dyn std::error::Error) -> Failure {
        Failure::Other(format!("{}: {error}", self.output.display()))
    }
}

/// Each frame's number and how far it is turned, in degrees; a progress bar goes along.
fn turns(frames: u32) -> impl Iterator<Item = (u32, f64)> {
    let progress = ProgressBar::new(u64::from(frames));
    progress.wrap_iter(0..frames).map(move |frame| (frame, 360.0 * f64::from(frame) / f64::from(frames)))
}

fn format(name: &str) -> Result<Format, String> {
    Format::from_name(name).ok_or_else(|| format!("expected one of {}", Format::ALL.map(Format::name).join(", ")))
}
