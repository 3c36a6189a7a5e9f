//! One connection: requests in, frames out.

use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async, connect_async_with_config};

use crate::service::{PATIENCE, Running, SLOW, problem};

/// Longer than a stream waits for rest and a small frame takes.
const QUIET: Duration = Duration::from_millis(600);

struct Client(WebSocketStream<MaybeTlsStream<TcpStream>>);

/// What a stream sends.
#[derive(Debug)]
enum Got {
    Frame(Value, Vec<u8>),
    Refusal(Value),
    Closed(CloseCode),
}

impl Client {
    async fn open(service: &Running) -> Self {
        let url = format!("ws://{}/v1/volumes/ball/stream", service.address);
        // Small messages go out at once, as browsers send them; else each second one waits 40 ms for an acknowledgement.
        Self(connect_async_with_config(url, None, true).await.unwrap().0)
    }

    async fn send(&mut self, message: Value) {
        self.0.send(Message::text(message.to_string())).await.unwrap();
    }

    async fn next(&mut self) -> Got {
        match timeout(PATIENCE, self.0.next()).await.expect("a message").unwrap().unwrap() {
            Message::Text(text) => Got::Refusal(serde_json::from_str(&text).unwrap()),
            Message::Binary(bytes) => {
                let length = u32::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
                let (header, frame) = bytes[4..].split_at(length);
                Got::Frame(serde_json::from_slice(header).unwrap(), frame.to_vec())
            }
            Message::Close(frame) => Got::Closed(frame.unwrap().code),
            other => panic!("{other:?}"),
        }
    }

    /// The next frame, acknowledged.
    async fn frame(&mut self) -> (Value, Vec<u8>) {
        match self.next().await {
            Got::Frame(header, bytes) => {
                self.send(json!({"ack": header["sequence"]})).await;
                (header, bytes)
            }
            other => panic!("{other:?}"),
        }
    }

    async fn refusal(&mut self) -> Value {
        match self.next().await {
            Got::Refusal(refusal) => refusal,
            other => panic!("{other:?}"),
        }
    }

    /// True where nothing comes for a while.
    async fn is_quiet(&mut self) -> bool {
        timeout(QUIET, self.0.next()).await.is_err()
    }
}

fn small(azimuth: f64) -> Value {
    json!({"camera": {"azimuth": azimuth}, "image": {"width": 40, "height": 30}})
}

#[tokio::test(flavor = "multi_thread")]
async fn a_view_comes_as_a_draft_and_is_refined_into_the_frames_of_the_route() {
    let service = Running::start("").await;
    let mut client = Client::open(&service).await;
    client.send(json!({"request": small(20.0)})).await;
    for (sequence, quality) in [(1, "draft"), (2, "standard"), (3, "high")] {
        let (header, bytes) = client.frame().await;
        assert_eq!(header["sequence"], sequence);
        assert_eq!(header["request"], 1);
        assert_eq!(header["quality"], quality);
        assert_eq!(header["last"], quality == "high");
        assert_eq!((&header["width"], &header["height"], &header["channels"]), (&json!(40), &json!(30), &json!(3)));
        for stage in ["queue", "prepare", "shade", "composite", "warp", "encode", "total"] {
            assert!(header["timing"][stage].as_f64().is_some_and(|ms| ms >= 0.0), "{header}");
        }
        let mut request = small(20.0);
        request["quality"] = quality.into();
        let frame = service.post("/v1/volumes/ball/frame", &request.to_string()).await.bytes().await.unwrap();
        assert!(bytes == frame, "{quality} is another picture");
    }
    assert!(client.is_quiet().await, "the best frame was there");
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_come_with_their_warps_to_whoever_warps_them_himself() {
    let service = Running::start("").await;
    let mut client = Client::open(&service).await;
    let mut request = small(20.0);
    request["image"]["stage"] = "intermediate".into();
    client.send(json!({"request": request})).await;
    for quality in ["draft", "standard", "high"] {
        let (header, bytes) = client.frame().await;
        request["quality"] = quality.into();
        let frame = service.post("/v1/volumes/ball/frame", &request.to_string()).await;
        let told = frame.headers().get("x-image-warp").map(|warp| format!("[{}]", warp.to_str().unwrap()));
        assert_eq!(told.is_some(), quality != "high");
        let warp = told.map(|warp| serde_json::from_str::<Value>(&warp).unwrap());
        assert_eq!(header.get("warp").map(numbers), warp.as_ref().map(numbers), "{quality}");
        assert_eq!(header["width"] == 40, warp.is_none(), "{header}");
        assert!(bytes == frame.bytes().await.unwrap(), "{quality} is another picture");
    }
}

fn numbers(list: &Value) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_patch_changes_what_it_names_and_takes_away_what_is_null() {
    let service = Running::start("").await;
    let mut client = Client::open(&service).await;
    let mut request = small(20.0);
    request["quality"] = "draft".into();
    request["shading"] = false.into();
    client.send(json!({"request": request})).await;
    client.frame().await;
    client.send(json!({"patch": {"camera": {"azimuth": 75}, "shading": null, "image": {"format": "raw"}}})).await;
    let (header, bytes) = client.frame().await;
    assert_eq!((&header["request"], &header["format"]), (&json!(2), &json!("raw")));
    let whole =
        json!({"camera": {"azimuth": 75}, "quality": "draft", "image": {"width": 40, "height": 30, "format": "raw"}});
    let frame = service.post("/v1/volumes/ball/frame", &whole.to_string()).await.bytes().await.unwrap();
    assert!(bytes == frame);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_acknowledgements_two_frames_are_on_their_way_and_no_more() {
    let service = Running::start("").await;
    let mut client = Client::open(&service).await;
    for azimuth in 0..20 {
        client.send(json!({"request": small(f64::from(azimuth)), "moving": "standard"})).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let mut sequences = vec![];
    for _ in 0..2 {
        let Got::Frame(header, _) = client.next().await else { panic!("no frame") };
        sequences.push(header["sequence"].as_u64().unwrap());
    }
    assert_eq!(sequences, [1, 2]);
    assert!(client.is_quiet().await);
    client.send(json!({"ack": 2})).await;
    let Got::Frame(header, _) = client.next().await else { panic!("no frame") };
    assert_eq!((&header["sequence"], &header["request"]), (&json!(3), &json!(20)), "the newest, not one in between");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_newest_request_ends_a_slow_one_in_the_middle_of_its_work() {
    let service = Running::start("[render]\njobs = 1").await;
    let mut client = Client::open(&service).await;
    let mut slow: Value = serde_json::from_str(SLOW).unwrap();
    slow["quality"] = "high".into();
    client.send(json!({"request": slow, "moving": "high"})).await;
    service.load(1, 0).await;
    tokio::time::sleep(Duration::from_millis(150)).await;
    let start = Instant::now();
    client.send(json!({"request": small(0.0)})).await;
    let (header, _) = client.frame().await;
    assert_eq!(header["request"], 2);
    assert!(start.elapsed() < PATIENCE / 4, "the slow frame takes minutes");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_served_is_refused_with_its_field_and_the_stream_goes_on() {
    let service = Running::start("").await;
    let mut client = Client::open(&service).await;
    client.send(json!({"request": small(0.0), "moving": "high"})).await;
    client.frame().await;
    for (message, status, pointer) in [
        (json!({"request": {"camera": {"azimut": 1}}}), 422, "/camera/azimut"),
        (json!({"patch": {"image": {"width": 100_000}}}), 422, "/image/width"),
        (json!({"patch": {"quality": "best"}}), 422, "/quality"),
        (json!({"request": {}, "patch": {}}), 422, "/patch"),
        (json!({"moving": "fast"}), 422, "/moving"),
        (json!({"requests": {}}), 422, "/requests"),
        (json!([1]), 400, ""),
    ] {
        client.send(message.clone()).await;
        let refusal = client.refusal().await;
        assert_eq!(refusal["request"], 1, "{message}");
        assert_eq!(refusal["error"]["status"], status, "{message}: {refusal}");
        if status == 422 {
            assert_eq!(refusal["error"]["errors"][0]["pointer"], pointer, "{refusal}");
        }
    }
    client.0.send(Message::text("{\"request\": ")).await.unwrap();
    assert_eq!(client.refusal().await["error"]["status"], 400);
    client.send(json!({"patch": {"camera": {"azimuth": 9}}})).await;
    assert_eq!(client.frame().await.0["request"], 2, "the last good request is still there");
    client.0.send(Message::binary(vec![1])).await.unwrap();
    assert!(matches!(client.next().await, Got::Closed(CloseCode::Unsupported)));
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_take_turns() {
    let service = Running::start("[render]\njobs = 1").await;
    let mut clients = vec![];
    for _ in 0..3 {
        clients.push(Client::open(&service).await);
    }
    let dragging = clients.into_iter().map(|mut client| {
        tokio::spawn(async move {
            let start = Instant::now();
            let mut frames = 0;
            client.send(json!({"request": small(0.0)})).await;
            while start.elapsed() < Duration::from_secs(2) {
                client.frame().await;
                frames += 1;
                client.send(json!({"patch": {"camera": {"azimuth": frames}}})).await;
            }
            frames
        })
    });
    let mut counts = vec![];
    for client in dragging.collect::<Vec<_>>() {
        counts.push(client.await.unwrap());
    }
    let (least, most) = (counts.iter().min().unwrap(), counts.iter().max().unwrap());
    assert!(*least > 0 && least * 2 > *most, "{counts:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_says_goodbye_to_every_stream() {
    let service = Running::start("[http]\nshutdown_seconds = 30").await;
    let mut idle = Client::open(&service).await;
    let mut busy = Client::open(&service).await;
    busy.send(json!({"request": serde_json::from_str::<Value>(SLOW).unwrap(), "moving": "high"})).await;
    service.load(1, 0).await;
    assert_eq!(service.metric("shearwarp_streams").await, 2.0);
    let (took, _) = service.stop().await;
    assert!(took < Duration::from_secs(10), "{took:?}");
    for client in [&mut idle, &mut busy] {
        assert!(matches!(client.next().await, Got::Closed(CloseCode::Away)));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_websocket_of_this_origin_or_one_too_many_is_refused() {
    let service = Running::start("[stream]\nmax_streams = 1").await;
    let response = service.get("/v1/volumes/ball/stream").await;
    assert_eq!(response.headers()["upgrade"], "websocket");
    assert_eq!(problem(response).await["status"], 426);
    let status = async |path: &str, origin: Option<String>| {
        let mut request = format!("ws://{}/v1/volumes/{path}/stream", service.address).into_client_request().unwrap();
        origin.map(|origin| request.headers_mut().insert("origin", origin.parse().unwrap()));
        match connect_async(request).await {
            Ok((stream, response)) => (response.status().as_u16(), Some(stream)),
            Err(Error::Http(response)) => (response.status().as_u16(), None),
            Err(other) => panic!("{other}"),
        }
    };
    assert_eq!(status("none", None).await.0, 404);
    assert_eq!(status("ball", Some("http://evil.example".into())).await.0, 403);
    let (accepted, open) = status("ball", Some(format!("http://{}", service.address))).await;
    assert_eq!(accepted, 101);
    assert_eq!(status("ball", None).await.0, 503);
    drop(open);
    service.gauge("shearwarp_streams", |open| open == 0.0).await;
    assert_eq!(status("ball", None).await.0, 101);
}
