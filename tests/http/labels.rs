//! Segmentations: another volume by which voxels look otherwise.

use serde_json::{Value, json};

use crate::service::{Running, header, problem, write_ball};

const FRAME: &str = "/v1/volumes/ball/frame";
/// Voxels along each side of the ball's volume.
const SIDE: usize = 24;

/// The ball, and its halves by number: 1 on the patient's right, 2 on the left.
async fn running() -> Running {
    let folder = tempfile::tempdir().unwrap();
    write_ball(&folder.path().join("ball.nrrd"), 8.0);
    write_ball(&folder.path().join("other.nrrd"), 4.0);
    let header =
        format!("NRRD0004\ntype: ushort\ndimension: 3\nsizes: {SIDE} {SIDE} {SIDE}\nencoding: raw\nendian: little\n");
    let halves: Vec<u8> = (0..SIDE.pow(3)).flat_map(|n| [if n % SIDE < SIDE / 2 { 1 } else { 2 }, 0]).collect();
    for (name, spacings) in [("halves", "1 1 1"), ("elsewhere", "1 1 2")] {
        let file = [format!("{header}spacings: {spacings}\n\n").into_bytes(), halves.clone()].concat();
        std::fs::write(folder.path().join(format!("{name}.nrrd")), file).unwrap();
    }
    // What no segmentation is: fractions.
    let header = header.replace("ushort", "float") + "spacings: 1 1 1\n\n";
    let values = (0..SIDE.pow(3)).flat_map(|n| (n as f32 / 7.0).to_le_bytes()).collect();
    std::fs::write(folder.path().join("measured.nrrd"), [header.into_bytes(), values].concat()).unwrap();
    let small = b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n\n12345678";
    std::fs::write(folder.path().join("small.nrrd"), small).unwrap();
    Running::start_in(folder, "").await
}

#[tokio::test(flavor = "multi_thread")]
async fn labels_are_hidden_coloured_and_shown_by_other_transfer_functions() {
    let service = running().await;
    let points = |color: &str| {
        format!(
            r#"{{"points": [{{"value": 50, "opacity": 0, "color": "{color}"}}, {{"value": 150, "opacity": 0.9, "color": "{color}"}}]}}"#
        )
    };
    let red = points("#ff0000");
    for (looks, algorithm, left, right) in [
        (String::new(), "", [255, 0, 0], [255, 0, 0]),
        (r#"{"label": 2, "visible": false}"#.into(), "", [255, 0, 0], [0, 0, 0]),
        (r##"{"label": 1, "color": "#0000ff"}"##.into(), "", [0, 0, 255], [255, 0, 0]),
        (
            r##"{"label": 1, "color": "#0000ff"}"##.into(),
            r#", "algorithm": "fast-classification""#,
            [0, 0, 255],
            [255, 0, 0],
        ),
        (r##"{"label": 1, "color": "#0000ff"}"##.into(), r#", "quality": "high""#, [0, 0, 255], [255, 0, 0]),
        (r##"{"label": 1, "color": "#0000ff"}"##.into(), r#", "quality": "draft""#, [0, 0, 255], [255, 0, 0]),
        (
            format!(r#"{{"label": 1, "visible": false}}, {{"label": 2, "transfer_function": {}}}"#, points("#00ff00")),
            "",
            [0, 0, 0],
            [0, 255, 0],
        ),
    ] {
        let body = format!(
            r#"{{"image": {{"width": 32, "height": 32, "format": "raw"}}, "shading": false, "transfer_function": {red},
            "labels": {{"volume": "halves", "looks": [{looks}]}}{algorithm}}}"#
        );
        let response = service.post(FRAME, &body).await;
        assert_eq!(response.status(), 200, "{body}");
        let pixels = response.bytes().await.unwrap();
        let at = |x: usize| <[u8; 3]>::try_from(&pixels[3 * (32 * 16 + x)..][..3]).unwrap();
        let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 4);
        assert!(near(at(12), left) && near(at(19), right), "{body}: {:?} {:?}", at(12), at(19));
    }
    let etag = async |looks: &str| {
        let body = format!(
            r#"{{"image": {{"width": 8, "height": 8}}, "labels": {{"volume": "halves", "looks": [{looks}]}}}}"#
        );
        header(&service.post(FRAME, &body).await, "etag").to_owned()
    };
    assert_ne!(etag("").await, etag(r#"{"label": 1, "opacity": 0.5}"#).await);
    assert_eq!(etag(r#"{"label": 1, "visible": false}"#).await, etag(r#"{"label": 1, "opacity": 0}"#).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn in_regions_labels_look_as_they_say_and_other_voxels_as_the_region() {
    let service = running().await;
    let points = |color: &str, opacity: f64| {
        json!({"points": [
            {"value": 50, "opacity": 0, "color": color}, {"value": 150, "opacity": opacity, "color": color}
        ]})
    };
    // The upper half of the ball; label 1 is on the left of the picture.
    let region = |more: Value| {
        let mut region = json!({"plane": {"point": [11.5, 11.5, 11.5], "normal": [0, 0, 1]}});
        json_patch::merge(&mut region, &more);
        region
    };
    for algorithm in ["classified", "fast-classification", "preintegrated", "raycast"] {
        let ask = async |looks: Value, region: Value| {
            let request = json!({
                "image": {"width": 32, "height": 32, "format": "raw"}, "shading": false, "algorithm": algorithm,
                "transfer_function": points("#ff0000", 0.9), "labels": {"volume": "halves", "looks": looks},
                "regions": [region],
            });
            let response = service.post(FRAME, &request.to_string()).await;
            assert_eq!(response.status(), 200, "{request}");
            let pixels = response.bytes().await.unwrap();
            let at = |x: usize, y: usize| <[u8; 3]>::try_from(&pixels[3 * (32 * y + x)..][..3]).unwrap();
            // Left and right, above and below.
            [at(12, 12), at(19, 12), at(12, 19), at(19, 19)].map(|pixel| pixel.map(|channel| channel / 128 * 255))
        };
        let [red, green, blue, nothing] = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [0; 3]];
        let in_green = region(json!({"transfer_function": points("#00ff00", 0.9)}));
        let none = json!([]);
        assert_eq!(ask(none, in_green.clone()).await, [green, green, red, red], "{algorithm}");
        let in_blue = json!([{"label": 1, "transfer_function": points("#0000ff", 0.9)}]);
        assert_eq!(ask(in_blue.clone(), in_green.clone()).await, [blue, green, blue, red], "{algorithm}");
        let hidden = json!([{"label": 1, "visible": false}]);
        assert_eq!(ask(hidden, in_green).await, [nothing, green, nothing, red], "{algorithm}");
        let clear = region(json!({"opacity": 0}));
        assert_eq!(ask(in_blue, clear).await, [nothing, nothing, blue, red], "{algorithm}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn labels_go_with_projections_gradient_opacity_and_levels() {
    let service = running().await;
    let points = |opacity: f64| json!([{"value": 50, "opacity": 0, "color": "#ffffff"}, {"value": 150, "opacity": opacity, "color": "#ffffff"}]);
    let hidden = json!({"points": [{"value": 0, "opacity": 0, "color": "#ffffff"}]});
    // Within the ball nothing changes; what its rim has is far beyond.
    let flat = json!([{"value": 1, "opacity": 1}, {"value": 2, "opacity": 0}]);
    for (fields, shown) in [
        (json!({"blend": "maximum", "window": {"center": 100, "width": 200}}), [true, true]),
        (
            json!({"blend": "maximum", "labels": {"volume": "halves", "looks": [{"label": 2, "visible": false}]}}),
            [true, false],
        ),
        (
            json!({"blend": "average", "transfer_function": hidden, "labels": {
                "volume": "halves", "looks": [{"label": 2, "transfer_function": {"points": points(0.9)}}]}}),
            [false, true],
        ),
        (json!({"level": 1, "labels": {"volume": "halves", "looks": [{"label": 2, "visible": false}]}}), [true, false]),
        (
            json!({"level": 1, "algorithm": "raycast", "labels": {"volume": "halves", "looks": [{"label": 1, "visible": false}]}}),
            [false, true],
        ),
        (
            json!({"algorithm": "raycast", "blend": "maximum", "labels": {"volume": "halves", "looks": [{"label": 2, "visible": false}]}}),
            [true, false],
        ),
        (
            json!({"transfer_function": {"points": points(0.9), "gradient_opacity": flat}, "labels": {
                "volume": "halves", "looks": [{"label": 1, "visible": false}]}}),
            [false, true],
        ),
        (
            json!({"transfer_function": {"points": points(0.9), "gradient_opacity": [{"value": 1000, "opacity": 0}]}, "labels": {
                "volume": "halves", "looks": [{"label": 2, "transfer_function": {"points": points(0.9)}}]}}),
            [false, true],
        ),
    ] {
        let mut request = json!({
            "image": {"width": 32, "height": 32, "format": "raw", "background": "transparent"}, "shading": false,
            "transfer_function": {"points": points(0.9)}, "labels": {"volume": "halves"},
        });
        json_patch::merge(&mut request, &fields);
        let response = service.post(FRAME, &request.to_string()).await;
        assert_eq!(response.status(), 200, "{request}");
        let pixels = response.bytes().await.unwrap();
        let alpha = |x: usize| pixels[4 * (32 * 16 + x) + 3] > 20;
        assert_eq!([alpha(12), alpha(19)], shown, "{request}");
    }
    let preset = r#"{"labels": {"volume": "halves", "looks": [{"label": 1, "transfer_function": "ct-vessels"}]}}"#;
    assert_eq!(service.post(FRAME, preset).await.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn labels_that_do_not_fit_are_refused() {
    let service = running().await;
    let (look, region) = (r#"{"label": 1}"#, r#"{"sphere": {"center": [0, 0, 0], "radius": 1}}"#);
    let (looks, regions) = ([look; 63].join(", "), [region; 4].join(", "));
    let many = format!(r#""labels": {{"volume": "halves", "looks": [{looks}]}}, "regions": [{regions}]"#);
    // Gradient opacities with points at 1200 magnitudes in all.
    let looks = [0, 1].map(|label| {
        let points: Vec<_> = (0..600).map(|n| json!({"value": 2 * n + label, "opacity": 0.5})).collect();
        let transfer = json!({"points": [{"value": 0, "opacity": 1, "color": "#ffffff"}], "gradient_opacity": points});
        json!({"label": label, "transfer_function": transfer})
    });
    let steep = format!(r#""labels": {{"volume": "halves", "looks": {}}}"#, json!(looks));
    for (fields, pointer) in [
        (r#""labels": {"volume": "none"}"#, "/labels/volume"),
        (r#""labels": {"volume": "small"}"#, "/labels/volume"),
        (r#""labels": {"volume": "elsewhere"}"#, "/labels/volume"),
        (r#""labels": {}"#, "/labels"),
        (r#""labels": {"volume": "halves", "looks": [{}]}"#, "/labels/looks/0"),
        (r#""labels": {"volume": "halves", "looks": [{"label": -1}]}"#, "/labels/looks/0/label"),
        (r#""labels": {"volume": "halves", "looks": [{"label": 1, "color": "red"}]}"#, "/labels/looks/0/color"),
        (r#""labels": {"volume": "halves", "looks": [{"label": 1, "opacity": 2}]}"#, "/labels/looks/0/opacity"),
        (
            r#""labels": {"volume": "halves", "looks": [{"label": 1, "transfer_function": "none"}]}"#,
            "/labels/looks/0/transfer_function",
        ),
        (&steep, "/labels/looks"),
        (r#""labels": {"volume": "measured"}"#, "/labels/volume"),
        (r#""labels": {"volume": "halves"}, "level": 7"#, "/level"),
        (
            r#""labels": {"volume": "halves"}, "algorithm": "classified", "regions": [{"sphere": {"center": [0, 0, 0], "radius": 1}, "blend": "maximum"}]"#,
            "/regions/0/blend",
        ),
        (&many, "/labels/looks"),
    ] {
        let problem = problem(service.post(FRAME, &format!("{{{fields}}}")).await).await;
        let told = (&problem["status"], &problem["errors"][0]["pointer"]);
        assert_eq!(told, (&422.into(), &pointer.into()), "{fields:.200}");
    }
}
