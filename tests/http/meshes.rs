//! Meshes: uploaded, named, drawn in volumes, deleted.

use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::service::{Running, header, problem};

const FRAME: &str = "/v1/volumes/ball/frame";

/// A square of 8 mm across the patient's front, at y = 0, as OBJ; it is in the middle of what the ball's volume shows.
const SQUARE: &str = "v 7.5 0 7.5\nv 15.5 0 7.5\nv 15.5 0 15.5\nv 7.5 0 15.5\nf 1 2 3 4\n";

async fn upload(service: &Running, media_type: &str, bytes: impl Into<Vec<u8>>) -> Response {
    let request = service.request(Method::POST, "/v1/meshes").header("content-type", media_type);
    request.body(bytes.into()).send().await.unwrap()
}

async fn delete(service: &Running, id: &str) -> u16 {
    service.request(Method::DELETE, &format!("/v1/meshes/{id}")).send().await.unwrap().status().as_u16()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mesh_is_kept_until_it_is_deleted() {
    let service = Running::start("").await;
    assert_eq!(service.json("/v1/meshes").await, json!({"meshes": []}));
    let created = upload(&service, "model/obj", SQUARE).await;
    assert_eq!(created.status(), 201);
    let location = header(&created, "location").to_owned();
    let body: Value = created.json().await.unwrap();
    assert_eq!((&body["triangles"], &body["vertices"], &body["format"]), (&2.into(), &4.into(), &"obj".into()));
    assert_eq!(body["bounds"], json!([[7.5, 0.0, 7.5], [15.5, 0.0, 15.5]]));
    let id = body["id"].as_str().unwrap();
    assert_eq!(location, format!("/v1/meshes/{id}"));
    // The same again, its format found out.
    let again = upload(&service, "application/octet-stream", SQUARE).await;
    assert_eq!(again.status(), 200);
    assert_eq!(service.json(&location).await, body);
    assert_eq!(service.json("/v1/meshes").await["meshes"], json!([body]));
    assert_eq!(service.metric("shearwarp_meshes").await, 1.0);
    assert_eq!(delete(&service, id).await, 204);
    assert_eq!(delete(&service, id).await, 404);
    let gone = problem(service.get(&location).await).await;
    assert_eq!(gone["type"], "urn:shearwarp:problem:no-such-mesh");
}

#[tokio::test(flavor = "multi_thread")]
async fn uploads_that_cannot_be_are_refused() {
    let service = Running::start("[meshes]\nmax_upload_bytes = 1000\nmax_bytes = 300").await;
    for (media_type, bytes, status) in [
        ("text/plain", SQUARE.as_bytes().to_vec(), 415),
        ("model/stl", SQUARE.as_bytes().to_vec(), 422),
        ("model/gltf-binary", vec![], 422),
        ("application/octet-stream", vec![0; 500], 422),
        ("model/obj", vec![b'#'; 1001], 413),
        ("model/obj; charset=utf-8", SQUARE.as_bytes().to_vec(), 201),
        // 2 triangles and 4 vertices take 120 bytes; of these there is room for two.
        ("model/obj", [SQUARE.as_bytes(), b"# two"].concat(), 201),
        ("model/obj", [SQUARE.as_bytes(), b"# three"].concat(), 507),
    ] {
        let response = upload(&service, media_type, bytes).await;
        assert_eq!(response.status(), status, "{media_type}");
        if status != 201 {
            assert_eq!(problem(response).await["status"], status);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn meshes_stand_in_the_volume() {
    let service = Running::start("").await;
    let body: Value = upload(&service, "model/obj", SQUARE).await.json().await.unwrap();
    let id = body["id"].as_str().unwrap();
    // Seen from in front: the middle of the picture, and where the ball is but not the square.
    let ask = async |geometry: Value, more: Value| {
        let mut request = json!({
            "image": {"width": 40, "height": 40, "format": "raw"}, "shading": false, "geometry": geometry,
            "transfer_function": {"points": [
                {"value": 50, "opacity": 0, "color": "#ff0000"}, {"value": 150, "opacity": 0.9, "color": "#ff0000"}
            ]}
        });
        json_patch::merge(&mut request, &more);
        let response = service.post(FRAME, &request.to_string()).await;
        assert_eq!(response.status(), 200, "{request}");
        let etag = header(&response, "etag").to_owned();
        let channels = header(&response, "x-image-channels").parse::<usize>().unwrap();
        let pixels = response.bytes().await.unwrap();
        let at = |x: usize, y: usize| pixels[channels * (40 * y + x)..][..channels].to_vec();
        ([at(20, 20), at(12, 20), at(1, 1)], etag)
    };
    let at = |y: f64| json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, y, 0, 1]);
    let ([middle, ..], without) = ask(json!([]), json!({})).await;
    assert!(middle[0] > 250 && middle[1] < 5 && middle[2] < 5, "{middle:?}");
    for more in [
        json!({}),
        json!({"quality": "high"}),
        json!({"quality": "draft"}),
        json!({"algorithm": "classified"}),
        json!({"algorithm": "raycast"}),
        json!({"camera": {"projection": "perspective"}}),
    ] {
        // In front of the ball, which is in the middle of the volume, and behind it.
        let ([middle, beside, corner], etag) = ask(json!([{"mesh": id, "color": "#0000ff"}]), more.clone()).await;
        assert_eq!((middle, corner), (vec![0, 0, 255], vec![0, 0, 0]), "{more}");
        assert!(beside[0] > 220 && beside[2] < 5, "{more}: {beside:?}");
        assert_ne!(etag, without);
        let ([middle, ..], moved) =
            ask(json!([{"mesh": id, "color": "#0000ff", "pose": at(22.0)}]), more.clone()).await;
        assert!(middle[0] > 220 && middle[2] < 5, "{more}: {middle:?}");
        assert_ne!(etag, moved);
    }
    let ground = json!({"image": {"background": "transparent"}});
    let ([middle, beside, corner], _) = ask(json!([{"mesh": id, "color": "#0000ff"}]), ground).await;
    assert_eq!((middle, corner), (vec![0, 0, 255, 255], vec![0; 4]));
    assert!(beside[0] == 255 && beside[3] > 250, "{beside:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn geometry_that_cannot_be_is_refused() {
    let service = Running::start("").await;
    let body: Value = upload(&service, "model/obj", SQUARE).await.json().await.unwrap();
    let id = body["id"].as_str().unwrap();
    for (geometry, pointer) in [
        (json!([{"mesh": "none"}]), "/geometry/0/mesh"),
        (json!([{}]), "/geometry/0"),
        (json!([{"mesh": id}, {"mesh": id, "opacity": 0.5}]), "/geometry/1/opacity"),
        (json!([{"mesh": id, "color": "#0000ff80"}]), "/geometry/0/color"),
        (json!([{"mesh": id, "pose": [1, 2, 3]}]), "/geometry/0/pose"),
        (json!([{"mesh": id, "pose": vec![0; 16]}]), "/geometry/0/pose"),
        (json!([{"mesh": id, "pose": [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}]), "/geometry/0/pose"),
        (json!([{"mesh": id, "size": 3}]), "/geometry/0/size"),
        (json!(vec![json!({"mesh": id}); 33]), "/geometry"),
    ] {
        let problem = problem(service.post(FRAME, &json!({"geometry": geometry}).to_string()).await).await;
        assert_eq!(
            (&problem["status"], &problem["errors"][0]["pointer"]),
            (&422.into(), &pointer.into()),
            "{geometry}"
        );
    }
    // A mesh has room in a frame, and so many of it have not.
    let many = SQUARE.to_owned() + &"f 1 2 3\n".repeat(40_000);
    let body: Value = upload(&service, "model/obj", many).await.json().await.unwrap();
    let mesh = json!({"mesh": body["id"]});
    assert_eq!(service.post(FRAME, &json!({"geometry": [mesh]}).to_string()).await.status(), 200);
    let problem = problem(service.post(FRAME, &json!({"geometry": vec![mesh; 32]}).to_string()).await).await;
    assert_eq!((&problem["status"], &problem["errors"][0]["pointer"]), (&422.into(), &"/geometry".into()), "{problem}");
}
