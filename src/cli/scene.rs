//! What `render` and `bench` put before the camera: a volume and a request, from their arguments.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::{Arg, ArgMatches, Args, Command};
use indicatif::ProgressBar;
use shearwarp::classify::labels::{LabelTables, Labels};
use shearwarp::classify::presets::FittedPresets;
use shearwarp::classify::{Classification, Encodings};
use shearwarp::mesh::formats::{self, MeshFormat};
use shearwarp::render::raster::Solid;
use shearwarp::render::shadow::Shadow;
use shearwarp::render::{Cancel, Image, Scene, Timings, View};
use shearwarp::service;
use shearwarp::service::request::{
    GeometryRequest, ImageLimits, Kind, Look, OPTIONS, RenderRequest, RequestError, ResolvedRequest,
};
use shearwarp::volume::decode::{self, Limits, RawLayout};
use shearwarp::volume::{PreparedVolume, Volume, phantom, pyramid};

use super::Failure;

/// The name of the built-in volume, where no file has it.
const DEMO: &str = "demo";

/// Larger than the service's: nobody else waits. 16384 is what PNG viewers take.
const LIMITS: ImageLimits = ImageLimits { max_side: 16_384, max_pixels: 1 << 27 };

#[derive(Args, Debug)]
pub struct VolumeArguments {
    /// A file of any supported format, or "demo" for the built-in volume
    volume: PathBuf,
    /// The file is a bare array: NX,NY,NZ,TYPE[,SX,SY,SZ], TYPE like u8, i16 or f32:be
    #[arg(long, value_name = "LAYOUT", value_parser = RawLayout::parse)]
    raw: Option<RawLayout>,
}

/// A volume as it came from its file.
#[derive(Debug)]
pub struct LoadedVolume {
    pub name: String,
    pub volume: Volume,
    pub modality: Option<String>,
    pub load: Duration,
}

impl VolumeArguments {
    /// The file.
    pub fn path(&self) -> &Path {
        &self.volume
    }

    /// Reads the volume, and its modality where a `.json` beside it names one.
    pub fn load(&self) -> Result<LoadedVolume, Failure> {
        let progress = spinner("loading");
        let start = Instant::now();
        let name = self.volume.display().to_string();
        let (volume, modality) = if self.volume == Path::new(DEMO) && !self.volume.exists() {
            (phantom::head(), Some("CT".to_owned()))
        } else {
            let volume = match &self.raw {
                Some(layout) => decode::load_raw(&self.volume, layout, &Limits::default()),
                None => decode::load(&self.volume, &Limits::default()),
            };
            let volume = volume.map_err(|error| Failure::of(&name)(error.to_string()))?;
            (volume, self.modality()?)
        };
        progress.finish_and_clear();
        Ok(LoadedVolume { name, volume, modality, load: start.elapsed() })
    }

    fn modality(&self) -> Result<Option<String>, Failure> {
        let folder = self.volume.parent().unwrap_or(Path::new(""));
        let id = self.volume.file_name().and_then(|name| name.to_str()).and_then(decode::volume_id);
        id.map_or(Ok(None), |id| service::modality(folder, &id)).map_err(|error| Failure::Other(error.to_string()))
    }
}

/// `--request FILE`, and an option for every short name of the API.
#[derive(Debug, Default)]
pub struct RequestArguments {
    request: Option<PathBuf>,
    /// By the API's name.
    options: BTreeMap<&'static str, String>,
}

impl RequestArguments {
    /// The request; options override the fields of the file.
    pub fn read(&self) -> Result<RenderRequest, Failure> {
        let json = match &self.request {
            None => b"{}".to_vec(),
            Some(path) => fs::read(path).map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?,
        };
        let options = self.options.iter().map(|(name, text)| (*name, text.as_str()));
        let request = RenderRequest::from_json_and_options(&json, options).map_err(refused)?;
        request.is_final().map_err(refused)?;
        Ok(request)
    }
}

/// Derived options would repeat the API's table of short names.
impl Args for RequestArguments {
    fn augment_args(command: Command) -> Command {
        let request = Arg::new("request")
            .long("request")
            .value_name("FILE")
            .value_parser(clap::value_parser!(PathBuf))
            .help("Render request as JSON, as for POST; further options override its fields");
        let options = OPTIONS.iter().map(|option| {
            let value_name = match option.kind {
                Kind::Number => "NUMBER",
                Kind::Flag => "BOOL",
                Kind::Text => "NAME",
                Kind::Color => "COLOR",
            };
            // Numbers may start with a minus.
            let long = option.name.replace('_', "-");
            Arg::new(option.name).long(long).value_name(value_name).help(option.help).allow_negative_numbers(true)
        });
        command.arg(request).args(options)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl clap::FromArgMatches for RequestArguments {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut arguments = Self::default();
        arguments.update_from_arg_matches(matches)?;
        Ok(arguments)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.request = matches.get_one("request").cloned();
        let given = OPTIONS.iter().filter_map(|option| Some((option.name, matches.get_one::<String>(option.name)?)));
        self.options = given.map(|(name, text)| (name, text.clone())).collect();
        Ok(())
    }
}

/// A volume with its structures under a request: all but the camera's turn.
#[derive(Debug)]
pub struct Stage {
    /// What the camera looks at, whatever level is shown.
    pub volume: Volume,
    /// The level that is shown.
    pub prepared: PreparedVolume,
    /// What the algorithm walks, where it is not the ray caster.
    pub classified: Option<Classified>,
    /// The same for each region that shows something.
    of_regions: Vec<Option<Classified>>,
    /// A segmentation, and its tables for the volume and each region that shows something.
    labels: Option<(Volume, Vec<LabelTables>)>,
    /// Where a light casts one.
    shadow: Option<Shadow>,
    /// Meshes.
    solids: Vec<Solid>,
    pub request: RenderRequest,
    /// The request before any turn.
    pub resolved: ResolvedRequest,
}

/// A classification, and the encodings that a service would have by the second frame.
#[derive(Debug)]
pub struct Classified {
    pub classification: Classification,
    /// With how long they took; `None` for what goes without.
    pub encodings: Option<(Encodings, Duration)>,
}

impl Classified {
    fn build(prepared: &PreparedVolume, look: &Look) -> Option<Self> {
        let transfer = &look.transfer;
        let classification = Classification::build(prepared, transfer, look.purpose()?);
        let start = Instant::now();
        let encodings = look.walks_encodings().then(|| Encodings::build(prepared, transfer, &classification));
        Some(Self { classification, encodings: encodings.map(|encodings| (encodings, start.elapsed())) })
    }

    /// Share of the voxels (or cells) that are not transparent, where there are encodings to tell.
    pub fn nontransparent_share(&self) -> Option<f64> {
        self.encodings.as_ref().map(|(encodings, _)| encodings.nontransparent_share())
    }

    /// Bytes in memory, by structure: `run_lengths`, `tables`.
    pub fn bytes(&self) -> impl Iterator<Item = (&'static str, u64)> {
        let run_lengths = self.encodings.iter().map(|(encodings, _)| ("run_lengths", encodings.bytes()));
        run_lengths.chain([("tables", self.classification.bytes())])
    }
}

impl Stage {
    /// Builds what the request needs. A refused request costs no structures.
    pub fn build(loaded: LoadedVolume, request: RenderRequest) -> Result<Self, Failure> {
        let volume = loaded.volume;
        let presets = FittedPresets::of(&volume, loaded.modality.as_deref());
        let resolved = request.resolve(&volume, &presets, &LIMITS).map_err(refused)?;
        let segmentation = segmentation(&volume, &resolved)?;
        let solids = resolved.geometry.iter().map(solid).collect::<Result<_, _>>()?;
        let progress = spinner("octree");
        let level = (0..resolved.level()).fold(volume.clone(), |finer, _| pyramid::coarser(&finer));
        let prepared = PreparedVolume::build(level);
        let told = resolved.looks().filter_map(|look| look.labels.as_ref());
        let labels = segmentation.map(|labels| {
            let tables = told.map(|told| told.tables(prepared.volume(), &labels)).collect();
            (labels, tables)
        });
        progress.set_message("run-length encodings");
        let mut looks = resolved.looks().map(|look| Classified::build(&prepared, look));
        let classified = looks.next().flatten();
        let of_regions = looks.collect();
        let shadow = resolved.shadows.as_ref().map(|told| {
            told.cast(&prepared, &resolved.look.transfer, labels.as_ref().map(|labels| by_label(labels, 0)))
        });
        progress.finish_and_clear();
        Ok(Self { volume, prepared, classified, of_regions, labels, shadow, solids, request, resolved })
    }

    /// The view with the camera turned by `degrees` about the vertical axis.
    pub fn view(&self, degrees: f64) -> Result<View, Failure> {
        let turned = if degrees == 0.0 { Ok(self.request.clone()) } else { self.request.turned(degrees) };
        turned.and_then(|request| request.view(&self.volume)).map_err(refused)
    }

    /// The frame of a view.
    pub fn frame(&self, view: &View) -> Result<(Image, Timings), Failure> {
        let scenes: Vec<_> = self
            .resolved
            .looks()
            .zip([&self.classified].into_iter().chain(&self.of_regions))
            .enumerate()
            .map(|(nth, (look, classified))| Scene {
                prepared: &self.prepared,
                transfer: &look.transfer,
                classification: classified.as_ref().map(|c| &c.classification),
                encodings: classified.as_ref().and_then(|c| c.encodings.as_ref()).map(|(encodings, _)| encodings),
                labels: self.labels.as_ref().map(|labels| by_label(labels, nth)),
                shadow: self.shadow.as_ref().filter(|_| nth == 0),
            })
            .collect();
        self.resolved
            .render(view, &scenes, &self.solids, &Cancel::default())
            .map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// The segmentation with the tables of the `nth` look.
fn by_label((labels, tables): &(Volume, Vec<LabelTables>), nth: usize) -> Labels<'_> {
    tables[nth].of(labels)
}

/// The labels that a request names by their file.
fn segmentation(volume: &Volume, resolved: &ResolvedRequest) -> Result<Option<Volume>, Failure> {
    let Some(told) = &resolved.look.labels else { return Ok(None) };
    let labels = decode::load(Path::new(&told.volume), &Limits::default())
        .map_err(|error| Failure::of(&told.volume)(error.to_string()))?;
    told.suit(volume, &labels).map_err(refused)?;
    Ok(Some(labels))
}

/// A mesh that a request names by its file, of a format that the file's name ends with.
fn solid(told: &GeometryRequest) -> Result<Solid, Failure> {
    let named = |format: &MeshFormat| told.mesh.to_ascii_lowercase().ends_with(&format!(".{}", format.name()));
    let format = MeshFormat::ALL.into_iter().find(named).ok_or_else(|| {
        Failure::of(&told.mesh)("expected a mesh whose name ends with .stl, .obj, .ply or .glb".into())
    })?;
    let bytes = fs::read(&told.mesh).map_err(|error| Failure::of(&told.mesh)(error.to_string()))?;
    let mesh = formats::read(format, &bytes).map_err(|error| Failure::of(&told.mesh)(error.to_string()))?;
    Ok(told.solid(&Arc::new(mesh)))
}

/// A request that cannot be met was a wrong usage.
pub fn refused(error: RequestError) -> Failure {
    Failure::Usage(format!("request: {error}"))
}

/// A sign of life on a terminal while something takes its time.
pub fn spinner(message: &'static str) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(message);
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}
