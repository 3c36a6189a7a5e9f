//! Scenes that the tests share: small volumes, transfer functions, views.

use glam::{DVec2, DVec3, Vec4};
use shearwarp::classify::{Classification, Color, ControlPoint, Encodings, Purpose, TransferFunction};
use shearwarp::raycast::raycast;
use shearwarp::render::{
    Algorithm, Background, BufferSlice, Camera, Cancel, DepthCueing, Image, Orbit, Preintegration, Projection, Quality,
    Scene, Settings, View, render,
};
use shearwarp::volume::{PreparedVolume, Volume};

/// A volume under a transfer function, ready for any algorithm.
pub struct Prepared {
    pub prepared: PreparedVolume,
    pub transfer: TransferFunction,
    /// For single voxels, and for slabs.
    pub classified: [(Classification, Encodings); 2],
}

impl Prepared {
    pub fn new(volume: Volume, transfer: TransferFunction, min_opacity: f64) -> Self {
        let prepared = PreparedVolume::build(volume);
        let classified = [Purpose::Voxels { min_opacity }, Purpose::Slabs { entries: 256 }].map(|purpose| {
            let classification = Classification::build(&prepared, &transfer, purpose);
            let encodings = Encodings::build(&prepared, &transfer, &classification);
            (classification, encodings)
        });
        Self { prepared, transfer, classified }
    }

    pub fn view(&self, camera: &Camera, width: u32, height: u32) -> View {
        let volume = self.prepared.volume();
        View::new(camera, volume.centre(), volume.radius(), width, height).unwrap()
    }

    pub fn frame(&self, view: &View, settings: &Settings) -> Image {
        render(&self.scene(settings.algorithm, true), view, settings, &Cancel::default()).unwrap().0
    }

    /// The ray caster's pixels before they are rounded to 8 bits.
    pub fn rays(&self, view: &View, settings: &Settings) -> Vec<Vec4> {
        let scene = Scene {
            prepared: &self.prepared,
            transfer: &self.transfer,
            classification: Some(&self.classified[1].0),
            encodings: None,
            labels: None,
            shadow: None,
        };
        raycast(&scene, view, settings, &Cancel::default()).unwrap()
    }

    /// The frame from what is given, whatever the algorithm would take.
    pub fn frame_with(
        &self,
        classification: &Classification,
        encodings: Option<&Encodings>,
        view: &View,
        settings: &Settings,
    ) -> Image {
        let scene = Scene {
            prepared: &self.prepared,
            transfer: &self.transfer,
            classification: Some(classification),
            encodings,
            labels: None,
            shadow: None,
        };
        render(&scene, view, settings, &Cancel::default()).unwrap().0
    }

    /// What an algorithm walks; without encodings if told so.
    pub fn scene(&self, algorithm: Algorithm, encoded: bool) -> Scene<'_> {
        let (classification, encodings) = match algorithm {
            Algorithm::Classified | Algorithm::FastClassification => &self.classified[0],
            Algorithm::Preintegrated | Algorithm::Raycast => &self.classified[1],
        };
        Scene {
            prepared: &self.prepared,
            transfer: &self.transfer,
            classification: Some(classification),
            encodings: (encoded && algorithm != Algorithm::FastClassification).then_some(encodings),
            labels: None,
            shadow: None,
        }
    }
}

/// The frame of `preintegrated` or `classified`, after it was compared with what may change no bit of it: its
/// naive twin, frames without encodings and with the other buffer slice, other numbers of threads.
pub fn same_bits(scene: &Prepared, view: &View, settings: &Settings) -> Image {
    let classification = &scene.classified[usize::from(settings.algorithm == Algorithm::Preintegrated)].0;
    let frame = scene.frame(view, settings);
    let naive = scene.frame(view, &Settings { skipping: false, ..settings.clone() });
    assert!(frame == naive, "differs from its twin: {view:?} {settings:?}");
    let unencoded = scene.frame_with(classification, None, view, settings);
    assert!(frame == unencoded, "encodings change {view:?} {settings:?}");
    let preintegration = Preintegration { buffer: BufferSlice::Image, ..settings.preintegration };
    let image_buffer = scene.frame(view, &Settings { preintegration, ..settings.clone() });
    assert!(frame == image_buffer, "the buffer slice changes {view:?} {settings:?}");
    for threads in [1, 2, 7] {
        let on = on_threads(threads, || scene.frame(view, settings));
        assert!(frame == on, "{threads} threads change {view:?} {settings:?}");
    }
    frame
}

/// By how much a component of a premultiplied pixel differs at most, of 255, if the frame has floats: depth cueing of no density fades nothing, but asks
/// for them.
pub fn floats_differ_by(scene: &Prepared, view: &View, settings: &Settings) -> f64 {
    let clear = Some(DepthCueing { front: 1.0, density: 0.0 });
    let frames = [settings.clone(), Settings { depth_cueing: clear, ..settings.clone() }];
    let [frame, floats] = frames.map(|settings| scene.frame(view, &settings));
    let off = premultiplied(&frame).flatten().zip(premultiplied(&floats).flatten());
    off.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Settings without shading over a transparent background, so that alpha can be read.
pub fn plain(algorithm: Algorithm) -> Settings {
    Settings {
        background: Background::Transparent,
        shading: None,
        early_ray_termination: 1.0,
        ..Settings::new(algorithm, Quality::Standard)
    }
}

/// The same with `high`'s quality.
pub fn high() -> Settings {
    Settings {
        quality: Quality::High,
        preintegration: Preintegration::of(Quality::High),
        ..plain(Algorithm::Preintegrated)
    }
}

/// Around the volume's centre.
pub fn orbit(projection: Projection, azimuth: f64, elevation: f64) -> Camera {
    Camera::Orbit(Orbit { projection, azimuth, elevation, ..Orbit::default() })
}

/// Colours times alpha, and alpha, 0 to 255: straight colours of pixels that are all but transparent are rounded from next to
/// nothing.
pub fn premultiplied(image: &Image) -> impl Iterator<Item = [f64; 4]> {
    image.pixels.chunks_exact(4).map(|pixel| {
        let [r, g, b, alpha] = [0, 1, 2, 3].map(|n| f64::from(pixel[n]));
        [r * alpha / 255.0, g * alpha / 255.0, b * alpha / 255.0, alpha]
    })
}

/// dB, of premultiplied components.
pub fn psnr(a: &Image, b: &Image) -> f64 {
    let squares: Vec<f64> =
        premultiplied(a).zip(premultiplied(b)).flat_map(|(a, b)| [0, 1, 2, 3].map(|n| (a[n] - b[n]).powi(2))).collect();
    10.0 * (255.0 * 255.0 * squares.len() as f64 / squares.iter().sum::<f64>().max(1e-9)).log10()
}

/// Control points of (value, opacity), coloured along a fixed rainbow.
pub fn transfer(points: &[(f64, f64)]) -> TransferFunction {
    let colors = [[1.0, 0.9, 0.8], [0.9, 0.3, 0.2], [0.2, 0.8, 0.4], [0.3, 0.4, 1.0], [1.0, 1.0, 1.0]];
    let points = points.iter().enumerate().map(|(at, &(value, opacity))| ControlPoint {
        value,
        opacity,
        color: Color(colors[at % colors.len()]),
    });
    TransferFunction { points: points.collect(), opacity_distance: None, gradient_opacity: vec![] }
}

/// The same colour and extinction everywhere.
pub fn medium(opacity: f64, opacity_distance: f64) -> TransferFunction {
    TransferFunction { opacity_distance: Some(opacity_distance), ..transfer(&[(0.0, opacity)]) }
}

/// What of a ray lies inside the box of voxel centres.
pub struct Chord {
    /// Index coordinates where the ray enters and leaves.
    pub ends: [DVec3; 2],
    /// mm; 0 where the ray misses.
    pub length: f64,
    /// Direction of the ray, world, unit.
    pub direction: DVec3,
}

/// The chord of the ray through pixel coordinates `at`.
pub fn chord(view: &View, volume: &Volume, at: DVec2) -> Chord {
    let ray = view.ray(at);
    let index_from_world = volume.world_from_index().inverse();
    let (start, along) =
        (index_from_world.transform_point3(ray.origin), index_from_world.transform_vector3(ray.direction));
    let first = if view.projection() == Projection::Parallel { f64::NEG_INFINITY } else { 0.0 };
    let (mut enter, mut leave) = (first, f64::INFINITY);
    for axis in 0..3 {
        let ends = [-start[axis], (volume.dims()[axis] - 1) as f64 - start[axis]].map(|d| d / along[axis]);
        enter = enter.max(ends[0].min(ends[1]));
        leave = leave.min(ends[0].max(ends[1]));
    }
    Chord {
        ends: [enter, leave].map(|t| start + along * t),
        length: (leave - enter).max(0.0),
        direction: ray.direction,
    }
}

/// Runs on a pool of so many threads.
pub fn on_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// Directions that look along every axis from both sides, oblique ones included: (azimuth, elevation).
pub const ANGLES: [(f64, f64); 10] = [
    (0.0, 0.0),
    (180.0, 0.0),
    (90.0, 0.0),
    (270.0, 0.0),
    (0.0, 90.0),
    (0.0, -90.0),
    (25.0, 10.0),
    (205.0, -20.0),
    (100.0, 30.0),
    (290.0, -65.0),
];
