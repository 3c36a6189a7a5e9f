//! `shearwarp bench FOLDER --papers OUT.md`: the papers' own tables, measured anew.
//!
//! Every table says what it repeats. Figures are milliseconds a frame of 512 x 512 pixels on one
//! thread unless the table says otherwise, from the view to the pixels in memory.

mod kraus;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use plotters::prelude::*;
use shearwarp::classify::preintegration::{Form, SlabTables};
use shearwarp::render::{Preintegration, Timings};
use shearwarp::service::request::RenderRequest;
use shearwarp::volume::decode::{self, Limits};
use shearwarp::volume::{Volume, phantom};

use super::Failure;
use super::scene::{LoadedVolume, Stage, refused};

/// Degrees between two frames of a full turn.
const STEP: u32 = 1;

/// A scan of the folder.
struct Scan {
    name: String,
    volume: Volume,
}

/// Measures and writes `out`, with its plots beside it.
pub fn run(folder: &Path, out: &Path) -> Result<(), Failure> {
    let scans = scans(folder)?;
    let progress = ProgressBar::new_spinner();
    progress.enable_steady_tick(Duration::from_millis(200));
    let mut text = format!(
        "# The papers' tables, measured anew\n\nWritten by `shearwarp bench FOLDER --papers {}`, version {}, {} thread(s).\n",
        out.file_name().unwrap_or_default().display(),
        env!("CARGO_PKG_VERSION"),
        rayon::current_num_threads(),
    );
    let plots = out.parent().unwrap_or(Path::new("."));
    for (name, table) in [
        ("Lacroute and Levoy 1994, Table 1", lacroute as fn(&[Scan], &Path) -> Result<String, Failure>),
        ("Schulze et al. 2003, Table 1", schulze),
        ("Kye et al. 2005, Table 1", kye),
        ("Kraus and Bürger 2008", kraus::tables),
        ("Growth with size", growth),
    ] {
        progress.set_message(name);
        write!(text, "\n## {name}\n\n{}", table(&scans, plots)?).expect("strings take all text");
    }
    progress.finish_and_clear();
    fs::write(out, text).map_err(|error| Failure::Other(format!("{}: {error}", out.display())))
}

/// Every volume of the folder, by name.
fn scans(folder: &Path) -> Result<Vec<Scan>, Failure> {
    let failed = |error: std::io::Error| Failure::Other(format!("{}: {error}", folder.display()));
    let mut paths: Vec<_> =
        fs::read_dir(folder).map_err(failed)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    let mut scans = vec![];
    for path in paths {
        let Some(name) = path.file_name().and_then(|name| name.to_str()).and_then(decode::volume_id) else { continue };
        let volume = decode::load(&path, &Limits::default())
            .map_err(|error| Failure::Other(format!("{}: {error}", path.display())))?;
        scans.push(Scan { name, volume });
    }
    if scans.is_empty() {
        return Err(Failure::Usage(format!("{}: expected a folder of volumes", folder.display())));
    }
    Ok(scans)
}

/// A scan under a request, written as JSON.
fn stage(volume: &Volume, json: &str) -> Result<Stage, Failure> {
    let request = RenderRequest::from_json(json.as_bytes()).map_err(refused)?;
    let loaded = LoadedVolume { name: String::new(), volume: volume.clone(), modality: None, load: Duration::ZERO };
    Stage::build(loaded, request)
}

/// The frames at these angles, after some that do not count.
fn turn(stage: &Stage, degrees: impl Iterator<Item = u32> + Clone) -> Result<Vec<Timings>, Failure> {
    let frame = |degrees: u32| Ok(stage.frame(&stage.view(f64::from(degrees))?)?.1);
    for warm_up in degrees.clone().step_by(9) {
        frame(warm_up)?;
    }
    degrees.map(frame).collect()
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Mean, least and largest milliseconds.
fn summary(timings: &[Timings]) -> [f64; 3] {
    let renders: Vec<f64> = timings.iter().map(|t| ms(t.render)).collect();
    let mean = renders.iter().sum::<f64>() / renders.len() as f64;
    [mean, renders.iter().fold(f64::INFINITY, |a, b| a.min(*b)), renders.iter().fold(0.0, |a, b| a.max(*b))]
}

/// Table 1, the breakdown of figure 12 and the curve of figure 11.
fn lacroute(scans: &[Scan], plots: &Path) -> Result<String, Failure> {
    let algorithms = [
        ("parallel, run lengths", "classified", "parallel"),
        ("parallel, fast classification", "fast-classification", "parallel"),
        ("perspective, run lengths", "classified", "perspective"),
        ("parallel, pre-integrated", "preintegrated", "parallel"),
        ("perspective, pre-integrated", "preintegrated", "perspective"),
    ];
    let mut table = "360 frames one degree apart, shaded, each scan with the transfer function that is chosen for it: mean, least and \
                     largest.\n\n| scan | voxels | algorithm | mean | min | max | memory, MB |\n| --- | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    let mut breakdown = "\nWhere the time goes (figure 12), share of the frame:\n\n| scan | algorithm | tables | composite | warp |\n| --- | --- | --- | --- | --- |\n".to_owned();
    let mut curves = vec![];
    for scan in scans {
        let [nx, ny, nz] = scan.volume.dims();
        for (name, algorithm, projection) in algorithms {
            let request = format!(r#"{{"algorithm": "{algorithm}", "camera": {{"projection": "{projection}"}}}}"#);
            let stage = stage(&scan.volume, &request)?;
            let timings = turn(&stage, (0..360).step_by(STEP as usize))?;
            let [mean, min, max] = summary(&timings);
            let bytes: u64 = stage.classified.iter().flat_map(|c| c.bytes()).map(|(_, bytes)| bytes).sum();
            let memory = bytes as f64 / 1e6;
            writeln!(
                table,
                "| {} | {nx} x {ny} x {nz} | {name} | {mean:.2} | {min:.2} | {max:.2} | {memory:.1} |",
                scan.name
            )
            .expect("strings take all text");
            let share = |of: fn(&Timings) -> Duration| {
                timings.iter().map(|t| ms(of(t))).sum::<f64>() / timings.iter().map(|t| ms(t.render)).sum::<f64>()
            };
            let tables = share(|t| t.shade + t.preintegration_table);
            let shares = [tables, share(|t| t.composite), share(|t| t.warp)].map(|s| 100.0 * s);
            writeln!(
                breakdown,
                "| {} | {name} | {:.0} % | {:.0} % | {:.0} % |",
                scan.name, shares[0], shares[1], shares[2]
            )
            .expect("strings take all text");
            if algorithm == "classified" && projection == "parallel" {
                let curve = timings.iter().enumerate().map(|(at, t)| (at as f64 * f64::from(STEP), ms(t.render)));
                curves.push((scan.name.clone(), curve.collect()));
            }
        }
    }
    plot(&plots.join("results-angle.svg"), "ms a frame by azimuth, run lengths, parallel", &curves, false)?;
    Ok(format!("{table}{breakdown}\nTime by angle (figure 11):\n\n![Time by angle](results-angle.svg)\n"))
}

/// Standard compositing against the ways to pre-integrate.
fn schulze(scans: &[Scan], _: &Path) -> Result<String, Failure> {
    let mut text = "512 x 512, 180 degrees in steps of 2, opacity a linear ramp, without shading: mean. SB and IB: buffer slice of a slice's and of the \
                    intermediate image's size; NC and OC: without and with opacity correction.\n\n| scan | standard | SB NC nearest | SB OC nearest | SB OC \
                    bilinear | IB NC nearest | IB OC nearest | IB OC bilinear |\n| --- | --- | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for scan in scans {
        let (low, high) = scan.volume.value_range();
        let ramp = format!(
            r##""transfer_function": {{"points": [{{"value": {low}, "opacity": 0, "color": "#000000"}}, {{"value": {high}, "opacity": 1, "color": "#ffffff"}}]}}, "shading": false"##
        );
        let mut row = format!("| {} |", scan.name);
        let mut add = |request: String| -> Result<(), Failure> {
            let [mean, _, _] = summary(&turn(&stage(&scan.volume, &request)?, (0..180).step_by(2))?);
            write!(row, " {mean:.2} |").expect("strings take all text");
            Ok(())
        };
        add(format!(r#"{{{ramp}, "algorithm": "classified"}}"#))?;
        for buffer in ["slice", "image"] {
            for (correction, lookup) in [("off", "nearest"), ("lookup", "nearest"), ("lookup", "bilinear")] {
                add(format!(
                    r#"{{{ramp}, "algorithm": "preintegrated", "preintegration": {{"buffer": "{buffer}", "opacity_correction": "{correction}", "lookup": "{lookup}"}}}}"#
                ))?;
            }
        }
        writeln!(text, "{row}").expect("strings take all text");
    }
    Ok(text)
}

/// Empty-space skipping, and how long a table takes after a change.
fn kye(scans: &[Scan], _: &Path) -> Result<String, Failure> {
    let mut text = "Pre-integrated frames, 36 around the axis, with and without empty space to skip: without, what is transparent has an opacity of \
                    one millionth, which looks the same. And the update of the slab table after a change of the transfer function: the 2D table of \
                    256 entries along an axis, and the 1D table.\n\n| scan | skipping | without | ratio | \
                    update, 2D | update, 1D |\n| --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for scan in scans {
        let usual = stage(&scan.volume, r#"{"algorithm": "preintegrated"}"#)?;
        let transfer = &usual.resolved.look.transfer;
        let mut nowhere_empty = transfer.clone();
        nowhere_empty.points.iter_mut().for_each(|point| point.opacity = point.opacity.max(1e-6));
        let request = format!(
            r#"{{"algorithm": "preintegrated", "shading": {}, "transfer_function": {}}}"#,
            usual.resolved.look.settings.shading.is_some(),
            serde_json::to_string(&nowhere_empty).expect("numbers and strings")
        );
        let angles = (0..360).step_by(10);
        let [with, _, _] = summary(&turn(&usual, angles.clone())?);
        let [without, _, _] = summary(&turn(&stage(&scan.volume, &request)?, angles)?);
        let update = |make: fn(&SlabTables)| {
            let times = (0..5).map(|_| {
                let start = Instant::now();
                make(&SlabTables::new(&scan.volume, transfer, Preintegration::ENTRIES));
                ms(start.elapsed())
            });
            times.fold(f64::INFINITY, f64::min)
        };
        let two = update(|tables| drop(tables.table(Form::Opacity, 1.0)));
        let one = update(|tables| drop(tables.running_sums(Form::Opacity, 1.0)));
        writeln!(text, "| {} | {with:.2} | {without:.2} | {:.1} | {two:.2} | {one:.2} |", scan.name, without / with)
            .expect("strings take all text");
    }
    Ok(text)
}

/// The same opaque surfaces at four sizes.
fn growth(_: &[Scan], plots: &Path) -> Result<String, Failure> {
    const SIZES: [usize; 4] = [128, 203, 323, 512];
    let mut text =
        "Opaque surfaces (balls within a ball), the same at every size; the exponent is of the voxels along a side, from the smallest to the \
         largest.\n\n| algorithm | 128 | 203 | 323 | 512 | exponent |\n| --- | --- | --- | --- | --- | --- |\n"
            .to_owned();
    let volumes = SIZES.map(|n| {
        phantom::from_fn([n; 3], [1.0; 3], |x, y, z| {
            let at = |i: usize| i as f64 / n as f64 * 2.0 - 1.0;
            let p = [at(x), at(y), at(z)];
            let wave = p.iter().map(|c| (c * 11.0).sin()).product::<f64>();
            let shell = 0.75 - p.iter().map(|c| c * c).sum::<f64>().sqrt();
            (128.0 + 40.0 * n as f64 * (shell + 0.1 * wave) / 8.0).clamp(0.0, 255.0)
        })
    });
    let mut curves = vec![];
    for algorithm in ["classified", "preintegrated"] {
        let mut means = vec![];
        for (n, volume) in SIZES.into_iter().zip(&volumes) {
            let request = format!(
                r##"{{"algorithm": "{algorithm}", "transfer_function": {{"opacity_distance": 1.0, "points": [{{"value": 100, "opacity": 0, "color": "#d0c0a0"}}, {{"value": 150, "opacity": 0.9, "color": "#ffffff"}}]}}}}"##
            );
            let [mean, _, _] = summary(&turn(&stage(volume, &request)?, (0..360).step_by(20))?);
            means.push((n as f64, mean));
        }
        let [(first, least), (last, most)] = [means[0], means[SIZES.len() - 1]];
        let exponent = (most / least).ln() / (last / first).ln();
        let row: String = means.iter().map(|(_, mean)| format!(" {mean:.2} |")).collect();
        writeln!(text, "| {algorithm} |{row} {exponent:.2} |").expect("strings take all text");
        curves.push((algorithm.to_owned(), means));
    }
    plot(&plots.join("results-growth.svg"), "ms a frame by voxels along a side", &curves, true)?;
    Ok(format!("{text}\n![Growth](results-growth.svg)\n"))
}

/// Named curves as an SVG.
fn plot(path: &Path, title: &str, curves: &[(String, Vec<(f64, f64)>)], logarithmic: bool) -> Result<(), Failure> {
    let draw = || -> Result<(), Box<dyn std::error::Error>> {
        let points = || curves.iter().flat_map(|(_, points)| points);
        let across = points().fold((f64::INFINITY, 0f64), |(low, high), (x, _)| (low.min(*x), high.max(*x)));
        let up = points().fold((f64::INFINITY, 0f64), |(low, high), (_, y)| (low.min(*y), high.max(*y)));
        let root = SVGBackend::new(path, (800, 480)).into_drawing_area();
        root.fill(&WHITE)?;
        let mut builder = ChartBuilder::on(&root);
        builder
            .caption(title, ("sans-serif", 18))
            .margin(12)
            .margin_right(24)
            .x_label_area_size(32)
            .y_label_area_size(48);
        // The axes' types differ, the drawing does not.
        macro_rules! draw {
            ($chart:expr) => {{
                let mut chart = $chart;
                let plain = |number: &f64| ((number * 1000.0).round() / 1000.0).to_string();
                let mut mesh = chart.configure_mesh();
                mesh.light_line_style(WHITE).x_label_formatter(&plain).y_label_formatter(&plain).draw()?;
                for (at, (name, points)) in curves.iter().enumerate() {
                    let style = Palette99::pick(at).stroke_width(2);
                    chart
                        .draw_series(LineSeries::new(points.iter().copied(), style))?
                        .label(name)
                        .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], style));
                }
                let mut labels = chart.configure_series_labels();
                let labels = labels.position(SeriesLabelPosition::UpperLeft).background_style(WHITE);
                labels.border_style(BLACK).draw()?;
            }};
        }
        if logarithmic {
            // Ticks where there are points: powers of ten may lie outside.
            let mut ticks: Vec<_> = points().map(|(x, _)| *x).collect();
            ticks.sort_by(f64::total_cmp);
            ticks.dedup();
            let across = (across.0..across.1).log_scale().with_key_points(ticks);
            draw!(builder.build_cartesian_2d(across, (up.0 * 0.8..up.1 * 1.2).log_scale())?);
        } else {
            // With room for their names.
            draw!(builder.build_cartesian_2d(across.0..across.1, 0.0..up.1 * 1.7)?);
        }
        root.present()?;
        Ok(())
    };
    draw().map_err(|error| Failure::Other(format!("{}: {error}", path.display())))
}
