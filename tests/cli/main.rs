//! The program as a person or a script meets it: arguments in, files and exit status out.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

/// 20 x 24 x 28 voxels: a bright ball in the dark.
const RAW: &str = "20,24,28,u8,1,1,0.5";

fn shearwarp(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_shearwarp")).args(arguments).output().expect("the program starts")
}

/// A folder with `ball.raw` of the layout [`RAW`].
fn folder() -> TempDir {
    let folder = TempDir::new().unwrap();
    let centre = [9.5, 11.5, 13.5];
    let voxel = |i: usize, j: usize, k: usize| {
        let distance: f64 = [i, j, k].iter().zip(centre).map(|(x, c)| (*x as f64 - c).powi(2)).sum::<f64>().sqrt();
        (250.0 - 20.0 * distance).clamp(0.0, 200.0) as u8
    };
    let rows = (0..28).flat_map(|k| (0..24).flat_map(move |j| (0..20).map(move |i| voxel(i, j, k))));
    fs::write(folder.path().join("ball.raw"), rows.collect::<Vec<u8>>()).unwrap();
    folder
}

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

/// Runs `command` on the ball with further arguments and expects success.
fn run(folder: &TempDir, command: &str, arguments: &[&str]) -> Output {
    let volume = path(folder, "ball.raw");
    let output = shearwarp(&[&[command, &volume, "--raw", RAW], arguments].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

/// The line on stderr of a failure with exit status `status`.
fn failure(status: i32, arguments: &[&str]) -> String {
    let output = shearwarp(arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(status), "{arguments:?}: {stderr}");
    assert!(stderr.starts_with("error: ") && stderr.lines().count() == 1, "{arguments:?}: {stderr}");
    stderr
}

/// Width, height and pixels of every frame of a PNG.
fn frames(path: impl AsRef<Path>) -> (u32, u32, Vec<Vec<u8>>) {
    let mut reader = png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap())).read_info().unwrap();
    let count = reader.info().animation_control().map_or(1, |animation| animation.num_frames);
    let (width, height) = reader.info().size();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let frames = (0..count).map(|_| {
        reader.next_frame(&mut pixels).unwrap();
        pixels.clone()
    });
    (width, height, frames.collect())
}

#[test]
fn render_writes_the_frame_that_was_asked_for() {
    let folder = folder();
    let out = path(&folder, "out.png");
    run(
        &folder,
        "render",
        &["-o", &out, "--width", "40", "--height", "30", "--azimuth", "-30", "--preset", "gray-ramp"],
    );
    let (width, height, pixels) = frames(&out);
    assert_eq!((width, height), (40, 30));
    let red = |x: usize, y: usize| pixels[0][(y * 40 + x) * 3];
    assert!(red(20, 15) > 20, "the ball is in the middle, got {}", red(20, 15));
    assert_eq!(red(0, 0), 0, "the corner is background");
}

#[test]
fn options_override_the_fields_of_the_request() {
    let folder = folder();
    let request = path(&folder, "request.json");
    fs::write(&request, r#"{"image": {"width": 10, "height": 20}, "camera": {"azimuth": 40}}"#).unwrap();
    let [both, options] = ["both.png", "options.png"].map(|name| path(&folder, name));
    run(&folder, "render", &["-o", &both, "--request", &request, "--width", "30"]);
    run(&folder, "render", &["-o", &options, "--azimuth", "40", "--width", "30", "--height", "20"]);
    assert_eq!(frames(&both).0, 30);
    assert_eq!(fs::read(both).unwrap(), fs::read(options).unwrap());
}

#[test]
fn a_turntable_is_an_animation_or_a_folder_of_the_same_frames() {
    let folder = folder();
    let [animation, pictures, single] = ["turn.apng", "turn", "single.png"].map(|name| path(&folder, name));
    let size = ["--width", "24", "--height", "24", "--elevation", "20"];
    run(&folder, "render", &[&["-o", &animation, "--turntable", "4"], &size[..]].concat());
    run(&folder, "render", &[&["-o", &pictures, "--turntable", "4"], &size[..]].concat());
    run(&folder, "render", &[&["-o", &single, "--azimuth", "90"], &size[..]].concat());
    let (_, _, animated) = frames(&animation);
    assert_eq!(animated.len(), 4);
    for (index, frame) in animated.iter().enumerate() {
        assert_eq!(*frame, frames(Path::new(&pictures).join(format!("{index:04}.png"))).2[0]);
    }
    assert_eq!(animated[1], frames(&single).2[0]);
    assert_ne!(animated[0], animated[1], "the voxels are not cubes, so sides differ");
}

#[test]
fn the_output_s_name_chooses_the_format_unless_told() {
    let folder = folder();
    for (name, format, start) in
        [("a.jpg", None, &b"\xff\xd8\xff"[..]), ("a.webp", None, b"RIFF"), ("a.bin", Some("png"), b"\x89PNG")]
    {
        let out = path(&folder, name);
        let mut arguments = vec!["-o", &out, "--width", "8", "--height", "8"];
        arguments.extend(format.into_iter().flat_map(|format| ["--format", format]));
        run(&folder, "render", &arguments);
        assert!(fs::read(out).unwrap().starts_with(start), "{name}");
    }
}

#[test]
fn info_says_what_the_volume_is() {
    let folder = folder();
    let info: Value = serde_json::from_slice(&run(&folder, "info", &["--json"]).stdout).unwrap();
    assert_eq!(info["dimensions"], serde_json::json!([20, 24, 28]));
    assert_eq!(info["spacing"], serde_json::json!([1.0, 1.0, 0.5]));
    assert_eq!(info["scalar_type"], "u8");
    assert_eq!(info["value_range"], serde_json::json!([0.0, 200.0]));
    let counts = info["histogram"]["counts"].as_array().unwrap();
    assert_eq!(counts.iter().filter_map(Value::as_u64).sum::<u64>(), 20 * 24 * 28);
    for structure in ["volume", "octree", "run_lengths", "tables"] {
        assert!(info["bytes"][structure].as_u64().unwrap() > 0, "{structure}");
    }
    let text = String::from_utf8(run(&folder, "info", &[]).stdout).unwrap();
    assert!(text.contains("20 x 24 x 28") && text.contains("0 to 200"), "{text}");
}

#[test]
fn bench_reports_every_phase_that_ran() {
    let folder = folder();
    let out = path(&folder, "bench.json");
    let few = [
        "--frames",
        "3",
        "--threads",
        "2",
        "--width",
        "32",
        "--height",
        "16",
        "--json",
        &out,
        "--algorithm",
        "classified",
    ];
    run(&folder, "bench", &few);
    let report: Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
    assert_eq!(report["algorithm"], "classified");
    assert_eq!((report["threads"].as_u64(), report["frames"].as_u64()), (Some(2), Some(3)));
    assert_eq!(report["image"], serde_json::json!([32, 16]));
    let share = report["nontransparent_share"].as_f64().unwrap();
    assert!(share > 0.0 && share < 1.0, "{share}");
    for phase in ["shade", "composite", "warp", "encode", "render", "total"] {
        let of = |statistic: &str| report["frame_ms"][phase][statistic].as_f64().unwrap();
        assert!(0.0 <= of("min") && of("min") <= of("median") && of("median") <= of("max"), "{report}");
        assert!(of("min") <= of("mean") && of("mean") <= of("max"), "{report}");
    }
    for step in ["load", "scanlines", "octree", "gradients", "summed_area_table", "run_lengths"] {
        assert!(report["prepare_ms"][step].as_f64().unwrap() >= 0.0, "{step}");
    }
    for structure in ["volume", "octree", "run_lengths", "tables", "images"] {
        assert!(report["bytes"][structure].as_u64().unwrap() > 0, "{structure}");
    }
}

#[test]
fn bench_leaves_out_steps_that_did_not_run() {
    let folder = folder();
    let out = path(&folder, "bench.json");
    let few = ["--frames", "1", "--algorithm", "raycast", "--width", "8", "--height", "8", "--json", &out];
    run(&folder, "bench", &few);
    let report: Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
    let keys = |map: &str| report[map].as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(keys("frame_ms"), ["composite", "encode", "render", "total"]);
    assert_eq!(keys("prepare_ms"), ["gradients", "load", "octree", "scanlines"]);
    assert!(!keys("bytes").contains(&"run_lengths".to_owned()));
}

#[test]
fn bench_times_the_pre_integration_tables_that_frames_make() {
    let folder = folder();
    let out = path(&folder, "bench.json");
    let few = ["--frames", "2", "--width", "16", "--height", "16", "--json", &out];
    run(&folder, "bench", &few);
    let report: Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
    assert_eq!(report["algorithm"], "preintegrated");
    assert!(report["prepare_ms"]["preintegration_table"].as_f64().unwrap() > 0.0, "{report}");
    assert!(report["bytes"]["run_lengths"].as_u64().unwrap() > 0, "{report}");
}

#[test]
fn info_shows_what_a_request_would_take() {
    let folder = folder();
    let bytes = |arguments: &[&str]| {
        let info: Value =
            serde_json::from_slice(&run(&folder, "info", &[&["--json"], arguments].concat()).stdout).unwrap();
        info["bytes"]["run_lengths"].as_u64().unwrap()
    };
    assert!(bytes(&["--algorithm", "classified"]) > bytes(&[]), "voxels take more than bits");
}

#[test]
fn every_option_of_the_api_has_a_flag() {
    let folder = folder();
    let out = path(&folder, "out.png");
    let small = ["-o", &out, "--width", "8", "--height", "8"];
    run(
        &folder,
        "render",
        &[&small[..], &["--blend", "average", "--window-center", "-20", "--window-width", "9"]].concat(),
    );
    run(&folder, "render", &[&small[..], &["--quality", "draft", "--algorithm", "classified"]].concat());
    let wrong = failure(2, &["render", &path(&folder, "ball.raw"), "--raw", RAW, "-o", &out, "--window-width", "9"]);
    assert!(wrong.contains("/window"), "{wrong}");
}

#[test]
fn wrong_usage_ends_with_2_and_one_line() {
    let folder = folder();
    let volume = path(&folder, "ball.raw");
    let out = path(&folder, "out.png");
    let [broken, odd, unwarped] = [
        ("broken.json", "{"),
        ("odd.json", r#"{"camera": {"zoom": 0}}"#),
        ("unwarped.json", r#"{"image": {"stage": "intermediate"}}"#),
    ]
    .map(|(name, text)| {
        fs::write(folder.path().join(name), text).unwrap();
        path(&folder, name)
    });
    failure(2, &["--no-such-flag"]);
    failure(2, &["no-such-command"]);
    failure(2, &["render", &volume, "--raw", RAW]);
    failure(2, &["bench", &volume, "--raw", RAW, "--frames", "0"]);
    assert!(failure(2, &["serve", "--config", &broken]).contains("configuration"));
    let render = |further: &[&str]| failure(2, &[&["render", &volume, "-o", &out, "--raw", RAW], further].concat());
    assert!(render(&["--azimuth", "east"]).contains("/azimuth"));
    assert!(render(&["--preset", "no-such"]).contains("gray-ramp"));
    assert!(render(&["--request", &broken]).contains("JSON"));
    assert!(render(&["--request", &odd]).contains("/camera/zoom"));
    assert!(render(&["--request", &unwarped]).contains("/image/stage"));
    assert!(render(&["--request", "missing.json"]).contains("missing.json"));
    assert!(render(&["--background", "transparent", "--format", "jpeg"]).contains("transparency"));
    assert!(!Path::new(&out).exists(), "a refused request writes nothing");
}

#[test]
fn what_the_world_refuses_ends_with_1_and_one_line() {
    let folder = folder();
    let volume = path(&folder, "ball.raw");
    let out = path(&folder, "no-such-folder/out.png");
    assert!(failure(1, &["info", "no-such-file.nii"]).contains("no-such-file.nii"));
    assert!(failure(1, &["info", &volume]).contains("format"));
    assert!(failure(1, &["info", &volume, "--raw", "20,24,29,u8"]).contains("ball.raw"));
    assert!(failure(1, &["render", &volume, "--raw", RAW, "-o", &out]).contains("no-such-folder"));
}
