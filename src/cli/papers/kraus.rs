//! The experiments of Kraus and Bürger 2008 on volumes whose voxels have colours of their own.

use std::fmt::Write as _;
use std::path::Path;

use glam::{DVec3, Vec4};
use shearwarp::classify::{Color, ControlPoint, TransferFunction};
use shearwarp::raycast::raycast;
use shearwarp::render::{Algorithm, Camera, Cancel, Orbit, Quality, Sampling, Scene, Settings, View};
use shearwarp::volume::pyramid::{BoxFilter, coarser_by};
use shearwarp::volume::{Colors, ImportReport, Placement, PreparedVolume, ScalarType, Volume};

use super::Scan;
use crate::cli::Failure;

/// Pixels across and down.
const SIDE: u32 = 96;

const SAMPLINGS: [(&str, Sampling); 2] = [("opacity", Sampling::Opacity), ("extinction", Sampling::Extinction)];

/// Nothing of the scans: all volumes are made here.
pub fn tables(_: &[Scan], _: &Path) -> Result<String, Failure> {
    let parts = [ray_integral()?, wall()?, scattered()?, downsampling()?];
    Ok(parts.join("\n"))
}

fn volume(dims: [usize; 3], alpha: impl Fn([usize; 3]) -> u8) -> Result<Volume, Failure> {
    let at = |n: usize| [n % dims[0], n / dims[0] % dims[1], n / (dims[0] * dims[1])];
    let voxels = (0..dims.iter().product()).map(|n| [255, 255, 255, alpha(at(n))]).collect();
    let (placement, report) = (Placement::from_spacing(DVec3::ONE), ImportReport::plain("phantom", ScalarType::U8));
    Volume::of_colors(dims, placement, Colors { voxels, has_alpha: true }, report)
        .map_err(|error| Failure::Other(error.to_string()))
}

/// The ray caster's pixels of a picture of `side` x `side`; voxels of alpha 255 have an opacity over a length.
fn rays(
    volume: &PreparedVolume,
    (opaque, length): (f64, f64),
    settings: &Settings,
    camera: Orbit,
    side: u32,
) -> Result<Vec<Vec4>, Failure> {
    let point = |value: f64, opacity: f64| ControlPoint { value, opacity, color: Color([1.0; 3]) };
    let points = vec![point(0.0, 0.0), point(255.0, opaque)];
    let transfer = TransferFunction { points, opacity_distance: Some(length), gradient_opacity: vec![] };
    let failed = |error: &dyn std::error::Error| Failure::Other(error.to_string());
    let (centre, radius) = (volume.volume().centre(), volume.volume().radius());
    let view = View::new(&Camera::Orbit(camera), centre, radius, side, side).map_err(|error| failed(&error))?;
    let scene = Scene {
        prepared: volume,
        transfer: &transfer,
        classification: None,
        encodings: None,
        labels: None,
        shadow: None,
    };
    raycast(&scene, &view, settings, &Cancel::default()).map_err(|error| failed(&error))
}

fn settings(sampling: Sampling, sample_distance: f64) -> Settings {
    let defaults = Settings::new(Algorithm::Raycast, Quality::Standard);
    Settings { sampling, sample_distance, shading: None, early_ray_termination: 1.0, ..defaults }
}

/// Least and largest opacity of a wall, one voxel thick, whose voxels have the extinction `tau`, by the sample
/// distance across the wall, for which opacities are interpolated. Rays enter the volume by other faces than those along the wall,
/// so that samples fall at every distance from it.
fn over_a_wall(tau: f64, sampling: Sampling, distance: f64) -> Result<[f64; 2], Failure> {
    let wall = PreparedVolume::build(volume([64, 48, 64], |[_, j, _]| if j == 24 { 255 } else { 0 })?);
    let (azimuth, elevation) = (35f64, 28f64);
    // So far rays go from voxel to voxel across the wall.
    let across = 1.0 / (azimuth.to_radians().cos() * elevation.to_radians().cos());
    let opaque = (-f64::exp_m1(-tau * distance), distance * across);
    let camera = Orbit { azimuth, elevation, ..Orbit::default() };
    let pixels = rays(&wall, opaque, &settings(sampling, distance * across), camera, SIDE)?;
    let middle = SIDE as usize / 2 - 12..SIDE as usize / 2 + 12;
    let inside = middle.clone().flat_map(|y| middle.clone().map(move |x| y * SIDE as usize + x));
    let alphas = inside.map(|n| f64::from(pixels[n].w));
    Ok(alphas.fold([1.0, 0.0], |[low, high], alpha| [low.min(alpha), high.max(alpha)]))
}

/// Figures 1 and 4.
fn ray_integral() -> Result<String, Failure> {
    const DISTANCES: [f64; 6] = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0];
    let mut table = "A ray through a wall of one voxel (figures 1 and 4): least and largest opacity over all offsets of its samples, by \
                     the sample distance across it in voxels; opacities are for that distance, as in the paper.\n\n| extinction | right | interpolated |"
        .to_owned();
    let separator = "| --- ".repeat(DISTANCES.len() + 3);
    DISTANCES.iter().for_each(|distance| write!(table, " {distance} |").expect("strings take all text"));
    write!(table, "\n{separator}|\n").expect("strings take all text");
    for tau in [1.0, 2.0, 4.0, 8.0] {
        for (name, sampling) in SAMPLINGS {
            write!(table, "| {tau} | {:.3} | {name} |", -f64::exp_m1(-tau)).expect("strings take all text");
            for distance in DISTANCES {
                let [low, high] = over_a_wall(tau, sampling, distance)?;
                write!(table, " {low:.3} to {high:.3} |").expect("strings take all text");
            }
            table.push('\n');
        }
    }
    Ok(table)
}

/// Figures 5 and 6.
fn wall() -> Result<String, Failure> {
    /// Opacity 1 but for 10^-7, over any distance.
    const OPAQUE: f64 = f64::INFINITY;
    let mut text = "The wall of figures 5 and 6, opaque: the first sample distance across it (in steps of 0.1 voxels) at which its opacity differs by more \
                    than 1/255 from one pixel to another. (The paper's are where its authors saw something.)\n\n| interpolated | the paper | here |\n| --- | --- | --- |\n"
        .to_owned();
    for ((name, sampling), paper) in SAMPLINGS.into_iter().zip([0.6, 1.6]) {
        let mut first = None;
        for tenths in 1..=30 {
            let distance = f64::from(tenths) / 10.0;
            let [least, largest] = over_a_wall(OPAQUE, sampling, distance)?;
            if largest - least > 1.0 / 255.0 {
                first = Some(distance);
                break;
            }
        }
        let first = first.map_or("none up to 3".into(), |first| format!("{first}"));
        writeln!(text, "| {name} | {paper} | {first} |").expect("strings take all text");
    }
    Ok(text)
}

/// Figure 7.
fn scattered() -> Result<String, Failure> {
    let alone = PreparedVolume::build(volume([24, 25, 26], |at| if at == [11, 9, 13] { 255 } else { 0 })?);
    let mut text = "An opaque voxel among clear ones (figure 7): the opacity of the ray through its centre, over 360 views, sample distance one \
                    voxel.\n\n| interpolated | mean | least to largest |\n| --- | --- | --- |\n"
        .to_owned();
    for (name, sampling) in SAMPLINGS {
        let mut opacities = vec![];
        for view in 0..360 {
            let target = Some(DVec3::new(11.0, 9.0, 13.0));
            let (azimuth, elevation) = (f64::from(view), 40.0 * (f64::from(view) * 0.7).sin());
            let camera = Orbit { azimuth, elevation, target, ..Orbit::default() };
            let pixels = rays(&alone, (1.0, 1.0), &settings(sampling, 1.0), camera, 1)?;
            opacities.push(f64::from(pixels[0].w));
        }
        let mean = opacities.iter().sum::<f64>() / opacities.len() as f64;
        let extreme = |of: fn(f64, f64) -> f64| opacities.iter().copied().reduce(of).unwrap_or(mean);
        writeln!(text, "| {name} | {mean:.3} | {:.3} to {:.3} |", extreme(f64::min), extreme(f64::max))
            .expect("strings take all text");
    }
    Ok(text)
}

/// Figures 2 and 3, and the filters of section 4.2.
fn downsampling() -> Result<String, Failure> {
    let alpha = (255.0 * -f64::exp_m1(-4.0)).round();
    let fine = volume([16; 3], |[i, ..]| if i % 2 == 0 { alpha as u8 } else { 0 })?;
    let twice = |opacity: f64| 1.0 - (1.0 - opacity).powi(2);
    let mut text = format!(
        "Half of the voxels of extinction 4, half of 0, made one of twice the size (figures 2 and 3): opacity {:.2} by averaging opacities (the \
         paper: 0.74); by averaging extinctions (0.98)",
        twice(alpha / 255.0 / 2.0)
    );
    for (name, filter) in [("two", BoxFilter::Two), ("four", BoxFilter::Four)] {
        let level = coarser_by(&fine, filter);
        let middle = level.scalars().code((4 * 8 + 4) * 8 + 4);
        write!(text, " {:.2} with a box of {name} voxels,", twice(f64::from(middle) / 255.0))
            .expect("strings take all text");
    }
    text.pop();
    text += ".\n\nHow much a wall's profile on the next level depends on where it stands between that level's voxels (root mean square of what \
             two neighbouring places differ by, as a share of the profile's own; the paper's errors of the filters are 0.34 and 0.057):\n\n\
             | box | difference |\n| --- | --- |\n";
    for (name, filter) in [("two voxels", BoxFilter::Two), ("four voxels", BoxFilter::Four)] {
        writeln!(text, "| {name} | {:.3} |", shift_variance(filter)?).expect("strings take all text");
    }
    Ok(text)
}

/// Of the extinction that is interpolated on the next level, a wall moved by a voxel.
fn shift_variance(filter: BoxFilter) -> Result<f64, Failure> {
    // Even places on the next level's voxels: 65 voxels become 33, just twice as far apart.
    const LENGTH: usize = 65;
    let profile = |place: usize| {
        let level = coarser_by(&volume([4, 4, LENGTH], |[_, _, k]| if k == place { 200 } else { 0 })?, filter);
        let [nx, ny, nz] = level.dims();
        let extinction = |k: usize| {
            let alpha = f64::from(level.scalars().code((k * ny + ny / 2) * nx + nx / 2)) / 255.0;
            -(-alpha).ln_1p()
        };
        // At the fine voxels' halves, from the wall's own place on.
        let at = |offset: f64| {
            let along = (place as f64 + offset) * (nz - 1) as f64 / (LENGTH - 1) as f64;
            let (low, part) = (along.floor(), along.fract());
            extinction(low as usize) * (1.0 - part) + extinction((low as usize + 1).min(nz - 1)) * part
        };
        Ok::<_, Failure>((-24..=24).map(|half| at(f64::from(half) / 2.0)).collect::<Vec<_>>())
    };
    let (a, b) = (profile(32)?, profile(33)?);
    let square = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>();
    let (between, own) =
        (square(&mut a.iter().zip(&b).map(|(a, b)| a - b)), square(&mut a.iter().zip(&b).map(|(a, b)| (a + b) / 2.0)));
    Ok((between / own).sqrt())
}
