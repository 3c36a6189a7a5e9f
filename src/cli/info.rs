//! `shearwarp info`

use std::collections::BTreeMap;
use std::fmt::Write;

use clap::Args;
use serde::Serialize;
use shearwarp::volume::histogram::Histogram;
use shearwarp::volume::{Volume, pyramid};

use super::Failure;
use super::scene::{Classified, RequestArguments, Stage, VolumeArguments};

/// Bins of the histogram in JSON; the picture in text takes fewer.
const BINS: usize = 256;
const TEXT_BINS: usize = 16;
/// Characters of the longest bar.
const BAR: usize = 40;

#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    volume: VolumeArguments,
    /// As JSON, with the names of the API
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    request: RequestArguments,
}

/// What is known about a volume; names and units as in the API.
#[derive(Serialize)]
struct Info {
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    modality: Option<String>,
    dimensions: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    /// Row-major.
    direction: [f64; 9],
    scalar_type: &'static str,
    components: u8,
    /// Of the pyramid.
    levels: usize,
    value_range: [f64; 2],
    import: Import,
    histogram: Bins,
    /// Of the voxels, or of the cells that slabs go through, under the request; absent where it has no
    /// encodings.
    #[serde(skip_serializing_if = "Option::is_none")]
    nontransparent_share: Option<f64>,
    /// Of the level that the request shows, and of what it needs classified.
    bytes: BTreeMap<&'static str, u64>,
}

#[derive(Serialize)]
struct Import {
    format: &'static str,
    non_finite: u64,
    quantized: bool,
    volumes_left_out: u64,
}

#[derive(Serialize)]
struct Bins {
    bins: usize,
    min: f64,
    max: f64,
    counts: Vec<u64>,
}

/// Loads, builds, and says what came of it.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let request = arguments.request.read()?;
    let loaded = arguments.volume.load()?;
    let (name, modality) = (loaded.name.clone(), loaded.modality.clone());
    let stage = Stage::build(loaded, request)?;
    let info = Info::of(name, modality, &stage);
    if arguments.json {
        let json = serde_json::to_string_pretty(&info).map_err(|error| Failure::Other(error.to_string()))?;
        return super::print(&format!("{json}\n"));
    }
    super::print(&info.text(&stage.volume))
}

impl Info {
    fn of(name: String, modality: Option<String>, stage: &Stage) -> Self {
        let volume = &stage.volume;
        let placement = volume.placement();
        let report = volume.report();
        let (low, high) = volume.value_range();
        let classified = stage.classified.as_ref();
        Self {
            name,
            modality,
            dimensions: volume.dims(),
            spacing: placement.spacing.to_array(),
            origin: placement.origin.to_array(),
            direction: placement.direction.transpose().to_cols_array(),
            scalar_type: report.scalar_type.name(),
            components: volume.components(),
            levels: pyramid::levels(volume.dims()),
            value_range: [low, high],
            import: Import {
                format: report.format,
                non_finite: report.non_finite,
                quantized: report.quantized,
                volumes_left_out: report.volumes_left_out,
            },
            histogram: bins(volume, BINS),
            nontransparent_share: classified.and_then(Classified::nontransparent_share),
            bytes: stage.prepared.bytes().into_iter().chain(classified.into_iter().flat_map(|c| c.bytes())).collect(),
        }
    }

    fn text(&self, volume: &Volume) -> String {
        let triple = |[x, y, z]: [f64; 3]| format!("{x} {y} {z}");
        let [nx, ny, nz] = self.dimensions;
        let [low, high] = self.value_range;
        let d = self.direction;
        let mut text = format!("{}: {}, {nx} x {ny} x {nz} voxels\n", self.name, self.import.format);
        let mut line = |label: &str, value: String| text.push_str(&format!("{label:<14}{value}\n"));
        if let Some(modality) = &self.modality {
            line("modality", modality.clone());
        }
        line("spacing", format!("{} mm", triple(self.spacing)));
        line("origin", format!("{} mm (LPS)", triple(self.origin)));
        for (axis, name) in ["i", "j", "k"].into_iter().enumerate() {
            line(
                if axis == 0 { "direction" } else { "" },
                format!("{name} {}", triple([d[axis], d[axis + 3], d[axis + 6]])),
            );
        }
        line("type", self.scalar_type.into());
        line("values", format!("{low} to {high}"));
        for remark in self.import.remarks() {
            line("import", remark);
        }
        for (structure, bytes) in &self.bytes {
            line("memory", format!("{structure:<12} {:>10.1} MiB", *bytes as f64 / f64::from(1 << 20)));
        }
        if let Some(share) = self.nontransparent_share {
            line("visible", format!("{:.2} % of the volume", 100.0 * share));
        }
        text + &bars(&bins(volume, TEXT_BINS))
    }
}

impl Import {
    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if self.non_finite > 0 {
            remarks.push(format!("{} NaN or infinite scalars became the smallest finite one", self.non_finite));
        }
        if self.quantized {
            remarks.push("mapped to 16 bits, rounded".into());
        }
        if self.volumes_left_out > 0 {
            remarks.push(format!("{} further volumes of the file left out", self.volumes_left_out));
        }
        remarks
    }
}

fn bins(volume: &Volume, bins: usize) -> Bins {
    let counted = Histogram::of(volume).bins(volume, bins);
    Bins { bins: counted.counts.len(), min: counted.min, max: counted.max, counts: counted.counts }
}

/// The histogram as bars, by the logarithm of the counts: most scans are mostly air.
fn bars(histogram: &Bins) -> String {
    let height = |count: u64| ((count + 1) as f64).ln();
    let highest = histogram.counts.iter().map(|count| height(*count)).fold(1.0, f64::max);
    let width = (histogram.max - histogram.min) / histogram.bins as f64;
    let mut text = String::from("histogram     (bars by the logarithm of the counts)\n");
    for (bin, count) in histogram.counts.iter().enumerate() {
        let bar = "#".repeat((height(*count) / highest * BAR as f64).round() as usize);
        let from = histogram.min + bin as f64 * width;
        writeln!(text, "{from:>12.1}  {bar:<BAR$} {count}").expect("a string takes any text");
    }
    text
}
