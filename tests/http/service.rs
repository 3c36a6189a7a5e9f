//! A service for one test, on a port of its own, and what tests ask it.

use std::fs;
use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use reqwest::{Client, Method, RequestBuilder, Response};
use serde_json::Value;
use shearwarp::service::Service;
use shearwarp::service::config::{Config, Overrides};
use tempfile::TempDir;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// Nothing in these tests takes as long, except where it hangs.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Voxels along each side of the ball.
const SIDE: usize = 24;

/// A frame that takes minutes: what a test does not wait for.
pub const SLOW: &str = r##"{"algorithm": "raycast", "sample_distance": 0.01, "early_ray_termination": 1,
    "image": {"width": 2048, "height": 2048},
    "transfer_function": {"points": [{"value": 0, "opacity": 0.001, "color": "#ffffff"}]}}"##;

/// A running service with one volume, `ball`.
pub struct Running {
    pub address: SocketAddr,
    pub folder: TempDir,
    client: Client,
    shutdown: oneshot::Sender<()>,
    task: JoinHandle<()>,
}

impl Running {
    /// With the defaults and the keys of `toml`, once it is ready.
    pub async fn start(toml: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_ball(&folder.path().join("ball.nrrd"), 8.0);
        Self::start_in(folder, toml).await
    }

    /// The volumes are those of `folder`.
    pub async fn start_in(folder: TempDir, toml: &str) -> Self {
        let file = folder.path().join("config.toml");
        fs::write(&file, toml).unwrap();
        let overrides = Overrides {
            listen: Some(([127, 0, 0, 1], 0).into()),
            volumes: Some(folder.path().to_owned()),
            threads: Some(2),
        };
        let service = Service::bind(Config::load(Some(&file), &overrides).unwrap()).await.unwrap();
        let address = service.address();
        let (shutdown, stopped) = oneshot::channel();
        let task = tokio::spawn(service.run(async move {
            let _ = stopped.await;
        }));
        let running = Self { address, folder, client: Client::new(), shutdown, task };
        running.eventually("/readyz", |response| response.status() == 200).await;
        running
    }

    pub fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.client.request(method, format!("http://{}{path}", self.address)).timeout(PATIENCE)
    }

    pub async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path).send().await.unwrap()
    }

    pub async fn post(&self, path: &str, json: &str) -> Response {
        let request = self.request(Method::POST, path).header("content-type", "application/json");
        request.body(json.to_owned()).send().await.unwrap()
    }

    pub async fn json(&self, path: &str) -> Value {
        self.get(path).await.json().await.unwrap()
    }

    /// Asks again and again until the answer is as wanted.
    pub async fn eventually(&self, path: &str, wanted: impl Fn(&Response) -> bool) {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            if wanted(&self.get(path).await) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        panic!("{path} never answered as wanted");
    }

    /// Waits until so many jobs run and so many requests wait.
    pub async fn load(&self, running: u32, waiting: u32) {
        let start = Instant::now();
        let wanted = [f64::from(running), f64::from(waiting)];
        let mut got = [0.0; 2];
        while start.elapsed() < PATIENCE {
            got = [self.metric("shearwarp_jobs_running").await, self.metric("shearwarp_queue_depth").await];
            if got == wanted {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        panic!("expected {wanted:?} jobs to run and to wait, got {got:?}");
    }

    /// Waits until a gauge is as wanted.
    pub async fn gauge(&self, name: &str, wanted: impl Fn(f64) -> bool) {
        let start = Instant::now();
        while !wanted(self.metric(name).await) {
            assert!(start.elapsed() < PATIENCE, "{name} never became as wanted");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// A gauge. (Counters are the process's: all tests of this binary share them.)
    pub async fn metric(&self, name: &str) -> f64 {
        let text = self.get("/metrics").await.text().await.unwrap();
        let line = text.lines().find(|line| line.strip_prefix(name).is_some_and(|rest| rest.starts_with(' ')));
        line.unwrap_or_else(|| panic!("no {name} in\n{text}")).rsplit(' ').next().unwrap().parse().unwrap()
    }

    /// Asks for the end and gives how long it took.
    pub async fn stop(self) -> (Duration, TempDir) {
        let start = Instant::now();
        self.shutdown.send(()).unwrap();
        tokio::time::timeout(PATIENCE, self.task).await.expect("the service ends").unwrap();
        (start.elapsed(), self.folder)
    }
}

/// A ball of value 200 in air of value 0, as NRRD.
pub fn write_ball(path: &Path, radius: f64) {
    let mut bytes = format!(
        "NRRD0004\ntype: unsigned char\ndimension: 3\nsizes: {SIDE} {SIDE} {SIDE}\nspacings: 1 1 1\nencoding: raw\n\n"
    )
    .into_bytes();
    let centre = (SIDE - 1) as f64 / 2.0;
    let squared = |n: usize| (n as f64 - centre).powi(2);
    for k in 0..SIDE {
        for j in 0..SIDE {
            let row = (0..SIDE).map(|i| squared(i) + squared(j) + squared(k) < radius * radius);
            bytes.extend(row.map(|inside| if inside { 200 } else { 0 }));
        }
    }
    fs::write(path, bytes).unwrap();
}

/// A header as text; empty where it is not there.
pub fn header<'a>(response: &'a Response, name: &str) -> &'a str {
    response.headers().get(name).map_or("", |value| value.to_str().unwrap())
}

/// The body of a failure, checked for what all of them have in common.
pub async fn problem(response: Response) -> Value {
    let status = response.status().as_u16();
    assert_eq!(header(&response, "content-type"), "application/problem+json");
    assert!(!header(&response, "x-request-id").is_empty());
    assert_eq!(header(&response, "retry-after").is_empty(), status != 503);
    let body: Value = response.json().await.unwrap();
    assert_eq!(body["status"], status);
    for member in ["type", "title", "detail"] {
        assert!(body[member].as_str().is_some_and(|text| !text.is_empty()), "{member} in {body}");
    }
    assert_eq!(body["errors"].is_array(), status == 422, "{body}");
    body
}
