//! A client's scene: depth buffer and picture come with the request, the frame is merged with them.

use std::io::{Cursor, Write};
use std::net::TcpStream;
use std::time::Duration;

use glam::{DMat4, DVec3};
use reqwest::Method;
use serde_json::{Value, json};

use crate::service::{Running, header, problem};

const FRAME: &str = "/v1/volumes/ball/frame";
const SIZE: (usize, usize) = (40, 30);
const BOUNDARY: &str = "parts-of-a-scene";

/// The ball of radius 8 in the middle of 24 mm, from in front; and the window-space depth of a plane that faces the camera.
fn request() -> (Value, impl Fn(f64) -> f32) {
    let centre = DVec3::splat(11.5);
    let view = glam::dcamera::rh::view::look_at_mat4(centre - DVec3::Y * 60.0, centre, DVec3::Z);
    let projection = glam::dcamera::rh::proj::opengl::perspective(0.5, 40.0 / 30.0, 10.0, 200.0);
    let matrices = json!({"view": view.to_cols_array(), "projection": projection.to_cols_array()});
    let transfer = json!({"points": [{"value": 0, "opacity": 0, "color": "#ff0000"}, {"value": 100, "opacity": 0.05, "color": "#ff0000"}]});
    let request = json!({
        "camera": {"matrices": matrices}, "transfer_function": transfer, "shading": false, "quality": "high",
        "image": {"width": SIZE.0, "height": SIZE.1, "background": "transparent", "format": "png"}
    });
    let depth = move |distance: f64| window(&projection, distance);
    (request, depth)
}

fn window(projection: &DMat4, distance: f64) -> f32 {
    let clip = *projection * DVec3::new(0.0, 0.0, -distance).extend(1.0);
    (clip.z / clip.w * 0.5 + 0.5) as f32
}

type Part<'a> = (&'a str, &'a str, Vec<u8>);

async fn post(service: &Running, parts: &[Part<'_>]) -> reqwest::Response {
    let mut body = vec![];
    for (name, content_type, bytes) in parts {
        let head = format!(
            "--{BOUNDARY}\r\nContent-Disposition: form-data; name=\"{name}\"; filename=\"{name}\"\r\nContent-Type: {content_type}\r\n\r\n"
        );
        body.extend([head.as_bytes(), bytes, b"\r\n"].concat());
    }
    body.extend(format!("--{BOUNDARY}--\r\n").as_bytes());
    let content_type = format!("multipart/form-data; boundary={BOUNDARY}");
    service.request(Method::POST, FRAME).header("content-type", content_type).body(body).send().await.unwrap()
}

fn floats(value: f32) -> Vec<u8> {
    value.to_le_bytes().repeat(SIZE.0 * SIZE.1)
}

fn png(color: png::ColorType, depth: png::BitDepth, pixel: &[u8], (width, height): (usize, usize)) -> Vec<u8> {
    let mut bytes = vec![];
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(&pixel.repeat(width * height)).unwrap();
    bytes
}

/// The pixel in the middle.
async fn middle(response: reqwest::Response) -> Vec<u8> {
    assert_eq!(response.status(), 200, "{}", response.text().await.unwrap());
    let bytes = response.bytes().await.unwrap();
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let channels = info.color_type.samples();
    pixels[(15 * 40 + 20) * channels..][..channels].to_vec()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plane_through_the_middle_hides_the_half_behind_it() {
    let service = Running::start("").await;
    let (request, depth) = request();
    let json = request.to_string().into_bytes();
    let ask = async |part: Part<'static>| post(&service, &[("request", "application/json", json.clone()), part]).await;
    let octets = "application/octet-stream";
    let whole = middle(ask(("depth", octets, floats(1.0))).await).await;
    let half = middle(ask(("depth", octets, floats(depth(60.0)))).await).await;
    let none = middle(ask(("depth", octets, floats(depth(40.0)))).await).await;
    let clear = |pixel: &[u8]| 1.0 - f64::from(pixel[3]) / 255.0;
    assert_eq!(none, [0; 4]);
    assert!(whole[3] > 100, "{whole:?}");
    assert!((clear(&half).powi(2) - clear(&whole)).abs() < 0.01, "{half:?} {whole:?}");

    let gray = (f64::from(depth(60.0)) * 65535.0).round() as u16;
    let picture = png(png::ColorType::Grayscale, png::BitDepth::Sixteen, &gray.to_be_bytes(), SIZE);
    let same = middle(ask(("depth", "image/png", picture)).await).await;
    assert!(same.iter().zip(&half).all(|(a, b)| a.abs_diff(*b) <= 2), "{same:?} {half:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_volume_is_blended_over_the_scenes_picture() {
    let service = Running::start("").await;
    let (request, depth) = request();
    let json = request.to_string().into_bytes();
    let blue = png(png::ColorType::Rgba, png::BitDepth::Eight, &[0, 0, 200, 7], SIZE);
    let parts = |color: bool| {
        let depth = floats(depth(60.0));
        let mut parts =
            vec![("request", "application/json", json.clone()), ("depth", "application/octet-stream", depth)];
        parts.extend(color.then(|| ("color", "image/png", blue.clone())));
        parts
    };
    let (alone, blended) = (post(&service, &parts(false)).await, post(&service, &parts(true)).await);
    assert_ne!(header(&alone, "etag"), header(&blended, "etag"));
    let (alone, blended) = (middle(alone).await, middle(blended).await);
    let alpha = f64::from(alone[3]) / 255.0;
    for (channel, behind) in [0.0, 0.0, 200.0].into_iter().enumerate() {
        let expected = f64::from(alone[channel]) * alpha + behind * (1.0 - alpha);
        assert!((f64::from(blended[channel]) - expected).abs() <= 1.0, "{alone:?} {blended:?}");
    }
    assert_eq!(blended.len(), 3);

    // What is behind the picture's pixels is not to be warped: an intermediate image there is only of the volume alone.
    let mut unwarped = request.clone();
    unwarped["image"]["stage"] = "intermediate".into();
    unwarped["quality"] = "standard".into();
    for (color, expected) in [(false, true), (true, false)] {
        let mut parts = parts(color);
        parts[0].2 = unwarped.to_string().into_bytes();
        let response = post(&service, &parts).await;
        assert_eq!((response.status().as_u16(), response.headers().contains_key("x-image-warp")), (200, expected));
    }
}

/// A square of 12 mm across in front of, in or behind the ball.
#[tokio::test(flavor = "multi_thread")]
async fn of_meshes_and_the_clients_scene_the_nearer_is_seen() {
    let service = Running::start("").await;
    let square = "v 5 0 5\nv 18 0 5\nv 18 0 18\nv 5 0 18\nf 1 2 3 4\n";
    let upload = service.request(Method::POST, "/v1/meshes").header("content-type", "model/obj").body(square);
    let id = upload.send().await.unwrap().json::<Value>().await.unwrap()["id"].clone();
    let (request, depth) = request();
    let blue = png(png::ColorType::Rgb, png::BitDepth::Eight, &[0, 0, 200], SIZE);
    let ask = async |mesh: f64, scene: f64, quality: &str| {
        let mut request = request.clone();
        request["quality"] = quality.into();
        // The eye is at y = 11.5 - 60.
        let pose = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, mesh - 48.5, 0, 1]);
        request["geometry"] = json!([{"mesh": id, "color": "#00ff00", "pose": pose}]);
        let parts = [
            ("request", "application/json", request.to_string().into_bytes()),
            ("depth", "application/octet-stream", floats(depth(scene))),
            ("color", "image/png", blue.clone()),
        ];
        let [red, green, blue] = middle(post(&service, &parts).await).await[..] else { panic!("three channels") };
        [red, green, blue]
    };
    for quality in ["draft", "standard", "high"] {
        // Both in front of the ball.
        assert_eq!(ask(40.0, 45.0, quality).await, [0, 255, 0], "{quality}");
        assert_eq!(ask(45.0, 40.0, quality).await, [0, 0, 200], "{quality}");
        // The nearer one within it: half of the ball is before it, and only that is.
        let [red, green, none] = ask(60.0, 80.0, quality).await;
        assert!(red > 50 && green > 50 && none < 3, "{quality}: {red} {green} {none}");
        let [same, none, blue] = ask(80.0, 60.0, quality).await;
        assert!(same.abs_diff(red) < 3 && blue > 50 && none < 3, "{quality}: {red} {same} {none} {blue}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn parts_that_do_not_fit_are_refused_by_name() {
    let service = Running::start("[http]\nmax_scene_bytes = 20000").await;
    let (request, _) = request();
    let json = request.to_string().into_bytes();
    let depth: Part = ("depth", "application/octet-stream", floats(1.0));
    let orbit = json!({"image": {"width": 40, "height": 30}}).to_string().into_bytes();
    let small = png(png::ColorType::Rgb, png::BitDepth::Eight, &[1, 2, 3], (9, 9));
    let eight = png(png::ColorType::Grayscale, png::BitDepth::Eight, &[9], SIZE);
    let json: Part = ("request", "application/json", json);
    for (parts, pointer) in [
        (vec![json.clone()], "/depth"),
        (vec![json.clone(), depth.clone(), depth.clone()], "/depth"),
        (vec![json.clone(), ("depth", "application/octet-stream", vec![0; 7])], "/depth"),
        (vec![json.clone(), ("depth", "application/octet-stream", floats(f32::NAN))], "/depth"),
        (vec![json.clone(), ("depth", "application/octet-stream", floats(1.5))], "/depth"),
        (vec![json.clone(), ("depth", "text/plain", floats(0.5))], "/depth"),
        (vec![json.clone(), ("depth", "image/png", eight)], "/depth"),
        (vec![json.clone(), ("depth", "image/png", b"no picture".to_vec())], "/depth"),
        (vec![json.clone(), depth.clone(), ("color", "image/png", small)], "/color"),
        (vec![json.clone(), depth.clone(), ("colour", "image/png", vec![])], "/colour"),
        (vec![("request", "application/json", orbit), depth.clone()], "/camera"),
        (
            vec![("request", "application/json", b"{\"camera\": {\"azimut\": 1}}".to_vec()), depth.clone()],
            "/camera/azimut",
        ),
    ] {
        let refused = problem(post(&service, &parts).await).await;
        assert_eq!(refused["status"], 422, "{refused}");
        assert_eq!(refused["errors"][0]["pointer"], pointer, "{refused}");
    }
    let large: Part = ("color", "image/png", vec![0; 30_000]);
    assert_eq!(problem(post(&service, &[json, depth, large]).await).await["status"], 413);
    let garbled = service.request(Method::POST, FRAME).header("content-type", "multipart/form-data").body("x");
    assert_eq!(problem(garbled.send().await.unwrap()).await["status"], 400);
}

#[tokio::test(flavor = "multi_thread")]
async fn more_scenes_at_once_than_there_is_room_for_are_refused_with_503() {
    let service = Running::start("[http]\nmax_scenes = 1").await;
    let head = format!(
        "POST {FRAME} HTTP/1.1\r\nhost: x\r\ncontent-type: multipart/form-data; boundary={BOUNDARY}\r\ncontent-length: 9000\r\n\r\n--"
    );
    let (request, _) = request();
    let json = request.to_string().into_bytes();
    let parts = [("request", "application/json", json), ("depth", "application/octet-stream", floats(1.0))];
    let mut slow = None;
    let mut status = 200;
    for _ in 0..100 {
        // While a scene of ours is being rendered a slow client may itself be the one too many: a new one each time.
        let mut client = TcpStream::connect(service.address).unwrap();
        client.write_all(head.as_bytes()).unwrap();
        slow = Some(client);
        tokio::time::sleep(Duration::from_millis(20)).await;
        status = post(&service, &parts).await.status().as_u16();
        if status != 200 {
            break;
        }
    }
    assert_eq!(status, 503);
    drop(slow);
    for _ in 0..100 {
        status = post(&service, &parts).await.status().as_u16();
        if status == 200 {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{status}: the place never came back");
}
