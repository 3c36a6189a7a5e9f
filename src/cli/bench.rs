//! `shearwarp bench`
//!
//! Every frame is rendered from its view on and encoded, nothing is kept from one to the next but
//! what a service keeps (structures, and the few newest pre-integration tables), and a turn that is
//! not counted comes first, so that caches and clocks are warm.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use glam::Vec4;
use indicatif::ProgressBar;
use serde::{Serialize, Serializer};
use shearwarp::encode::{Format, encode};
use shearwarp::render::factorization::Factorization;
use shearwarp::render::intermediate::IntermediateImage;

use super::Failure;
use super::scene::{Classified, RequestArguments, Stage, VolumeArguments};

/// Threads at most: beyond any machine, below what a typing error asks for.
const MAX_THREADS: i64 = 1024;

#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    volume: VolumeArguments,
    /// Frames in a turn
    #[arg(long, value_name = "N", default_value_t = 90, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Degrees from one frame to the next
    #[arg(long, value_name = "DEGREES", default_value_t = 4.0, allow_negative_numbers = true)]
    step: f64,
    /// Threads for everything [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_THREADS))]
    threads: Option<u32>,
    /// Write the figures to this file
    #[arg(long, value_name = "OUT")]
    json: Option<PathBuf>,
    /// Measure the papers' own tables on all scans of the folder VOLUME, and write them to this file
    #[arg(long, value_name = "OUT", conflicts_with = "json")]
    papers: Option<PathBuf>,
    #[command(flatten)]
    request: RequestArguments,
}

/// Figures by name, in the order in which things happen. Steps that did not run are not there.
type Named<T> = Vec<(&'static str, T)>;

/// The figures of a run.
#[derive(Serialize)]
struct Report {
    volume: String,
    dimensions: [usize; 3],
    algorithm: &'static str,
    quality: &'static str,
    threads: usize,
    frames: u32,
    image: [u32; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    nontransparent_share: Option<f64>,
    #[serde(serialize_with = "as_map")]
    frame_ms: Named<Summary>,
    #[serde(serialize_with = "as_map")]
    prepare_ms: Named<f64>,
    #[serde(serialize_with = "as_map")]
    bytes: Named<u64>,
}

fn as_map<T: Serialize, S: Serializer>(named: &Named<T>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(named.iter().map(|(name, value)| (name, value)))
}

/// Milliseconds.
#[derive(Serialize)]
struct Summary {
    min: f64,
    median: f64,
    mean: f64,
    max: f64,
}

/// Measures on a pool of its own, reports, and writes the JSON.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    if !(arguments.step.is_finite() && arguments.step.abs() <= 360.0) {
        return Err(Failure::Usage(format!("expected a --step of -360 to 360 degrees, got {}", arguments.step)));
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.threads.unwrap_or(0) as usize)
        .build()
        .map_err(|error| Failure::Other(format!("threads: {error}")))?;
    if let Some(out) = &arguments.papers {
        return pool.install(|| super::papers::run(arguments.volume.path(), out));
    }
    let report = pool.install(|| measure(arguments))?;
    if let Some(path) = &arguments.json {
        let json = serde_json::to_vec_pretty(&report).map_err(|error| Failure::Other(error.to_string()))?;
        fs::write(path, json).map_err(|error| Failure::Other(format!("{}: {error}", path.display())))?;
    }
    super::print(&report.text())
}

fn measure(arguments: &Arguments) -> Result<Report, Failure> {
    let request = arguments.request.read()?;
    let loaded = arguments.volume.load()?;
    let (volume, load) = (loaded.name.clone(), loaded.load);
    let stage = Stage::build(loaded, request)?;

    // One turn to warm up, then the one that counts.
    let progress = ProgressBar::new(2 * u64::from(arguments.frames));
    let mut phases = Phases::default();
    for turn in 0..2 {
        phases = Phases { preintegration_table: phases.preintegration_table, ..Phases::default() };
        for frame in 0..arguments.frames {
            phases.add(&stage, f64::from(frame) * arguments.step)?;
            progress.inc(1);
        }
        progress.set_message(if turn == 0 { "measuring" } else { "done" });
    }
    progress.finish_and_clear();

    let settings = &stage.resolved.look.settings;
    let (width, height) = stage.resolved.view.size();
    Ok(Report {
        volume,
        dimensions: stage.volume.dims(),
        algorithm: settings.algorithm.name(),
        quality: settings.quality.name(),
        threads: rayon::current_num_threads(),
        frames: arguments.frames,
        image: [width, height],
        nontransparent_share: stage.classified.as_ref().and_then(Classified::nontransparent_share),
        frame_ms: phases.summaries(),
        prepare_ms: prepare_ms(&stage, load, phases.preintegration_table),
        bytes: bytes(&stage, &phases),
    })
}

/// Durations of every frame, by phase.
#[derive(Default)]
struct Phases {
    /// The longest that a frame had to make one, in both turns.
    preintegration_table: Duration,
    shade: Vec<Duration>,
    composite: Vec<Duration>,
    warp: Vec<Duration>,
    encode: Vec<Duration>,
    render: Vec<Duration>,
    total: Vec<Duration>,
    /// Of the final image.
    image_bytes: u64,
    /// Of the frame whose intermediate images are the largest.
    intermediate_bytes: u64,
}

impl Phases {
    /// Renders, encodes and measures the frame at `degrees`.
    fn add(&mut self, stage: &Stage, degrees: f64) -> Result<(), Failure> {
        let start = Instant::now();
        let view = stage.view(degrees)?;
        let (image, timings) = stage.frame(&view)?;
        let render = start.elapsed();
        let png = encode(&image, Format::Png).map_err(|error| Failure::Other(error.to_string()))?;
        let total = start.elapsed();
        std::hint::black_box(png);
        self.preintegration_table = self.preintegration_table.max(timings.preintegration_table);
        self.shade.push(timings.shade);
        self.composite.push(timings.composite);
        self.warp.push(timings.warp);
        self.encode.push(total - render);
        self.render.push(render);
        self.total.push(total);
        self.image_bytes = image.pixels.len() as u64;
        if stage.classified.is_some() {
            let parts = Factorization::parts(&view, stage.prepared.volume()).unwrap_or_default();
            let bytes = parts.iter().map(|part| IntermediateImage::new(part.size, Vec4::ZERO).bytes()).sum();
            self.intermediate_bytes = self.intermediate_bytes.max(bytes);
        }
        Ok(())
    }

    fn summaries(&self) -> Named<Summary> {
        let phases = [
            ("shade", &self.shade),
            ("composite", &self.composite),
            ("warp", &self.warp),
            ("encode", &self.encode),
            ("render", &self.render),
            ("total", &self.total),
        ];
        let ran = |durations: &[Duration]| durations.iter().any(|d| *d > Duration::ZERO);
        phases.into_iter().filter(|(_, d)| ran(d)).map(|(phase, d)| (phase, Summary::of(d))).collect()
    }
}

impl Summary {
    /// Of at least one duration.
    fn of(durations: &[Duration]) -> Self {
        let mut ms: Vec<_> = durations.iter().map(|d| d.as_secs_f64() * 1e3).collect();
        ms.sort_by(f64::total_cmp);
        let last = ms.len() - 1;
        Self {
            min: ms[0],
            median: (ms[last / 2] + ms[ms.len() / 2]) / 2.0,
            mean: ms.iter().sum::<f64>() / ms.len() as f64,
            max: ms[last],
        }
    }
}

fn prepare_ms(stage: &Stage, load: Duration, preintegration_table: Duration) -> Named<f64> {
    let ms = |(step, duration): (&'static str, Duration)| (step, duration.as_secs_f64() * 1e3);
    let prepared = stage.prepared.timings();
    let prepared = [("scanlines", prepared.scanlines), ("octree", prepared.octree), ("gradients", prepared.gradients)];
    let mut steps = vec![ms(("load", load))];
    steps.extend(prepared.map(ms));
    if let Some(Classified { classification, encodings }) = &stage.classified {
        steps.push(ms(("summed_area_table", classification.summed_area_table())));
        steps.extend(encodings.as_ref().map(|(_, took)| ms(("run_lengths", *took))));
    }
    if !preintegration_table.is_zero() {
        steps.push(ms(("preintegration_table", preintegration_table)));
    }
    steps
}

/// `images` are the intermediate images, where there are any, and the final one.
fn bytes(stage: &Stage, phases: &Phases) -> Named<u64> {
    let classified = stage.classified.iter().flat_map(|c| c.bytes());
    stage
        .prepared
        .bytes()
        .into_iter()
        .chain(classified)
        .chain([("images", phases.intermediate_bytes + phases.image_bytes)])
        .collect()
}

impl Report {
    fn text(&self) -> String {
        let [nx, ny, nz] = self.dimensions;
        let [width, height] = self.image;
        let mut text = format!(
            "{}: {nx} x {ny} x {nz}, {} {}, {width} x {height}, {} threads, {} frames\n",
            self.volume, self.algorithm, self.quality, self.threads, self.frames
        );
        if let Some(share) = self.nontransparent_share {
            text += &format!("{:.2} % of the voxels are not transparent\n", 100.0 * share);
        }
        text += &format!("{:<20}{:>10}{:>10}{:>10}{:>10}\n", "frame, ms", "min", "median", "mean", "max");
        for (phase, Summary { min, median, mean, max }) in &self.frame_ms {
            text += &format!("{phase:<20}{min:>10.3}{median:>10.3}{mean:>10.3}{max:>10.3}\n");
        }
        text += "once, ms\n";
        for (step, ms) in &self.prepare_ms {
            text += &format!("{step:<20}{ms:>10.1}\n");
        }
        text += "memory, MiB\n";
        for (structure, bytes) in &self.bytes {
            text += &format!("{structure:<20}{:>10.1}\n", *bytes as f64 / f64::from(1 << 20));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_is_of_all_frames() {
        let of = |ms: &[u64]| Summary::of(&ms.iter().map(|ms| Duration::from_millis(*ms)).collect::<Vec<_>>());
        let four = of(&[40, 10, 20, 90]);
        assert_eq!((four.min, four.median, four.mean, four.max), (10.0, 30.0, 40.0, 90.0));
        assert_eq!(of(&[3, 1, 2]).median, 2.0);
    }
}
