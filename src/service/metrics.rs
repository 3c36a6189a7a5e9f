//! What the service counts and times, in the Prometheus text format.
//!
//! Stages have the names that `Server-Timing` gives them. Gauges (queue depth, cache) are not kept
//! up to date but read when somebody asks, from the things themselves: a gauge that is counted up
//! and down drifts with every path that forgets one half.

use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use metrics::{counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram};
use metrics_exporter_prometheus::{PrometheusBuilder, PrometheusHandle};

use super::classified::CacheSize;

/// Upper bounds in seconds: 1 ms, where a cached draft frame is, to the deadline.
const BUCKETS: &[f64] =
    &[0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0];

/// Between two clean-ups of the recorder: a busy service records some ten thousand samples in it.
const UPKEEP: Duration = Duration::from_secs(10);

/// The recorder is the process's, as the metrics crate has it; several services in one process (in
/// tests) share it.
static RECORDER: OnceLock<PrometheusHandle> = OnceLock::new();

/// The recorder, installed with the first call.
pub fn recorder() -> &'static PrometheusHandle {
    RECORDER.get_or_init(|| {
        let builder = PrometheusBuilder::new().set_buckets(BUCKETS).expect("the list of buckets is not empty");
        let recorder = builder.build_recorder();
        let handle = recorder.handle();
        if metrics::set_global_recorder(recorder).is_err() {
            tracing::warn!("another metrics recorder is installed; /metrics stays empty");
        }
        describe();
        handle
    })
}

fn describe() {
    describe_counter!("shearwarp_requests_total", "Answered requests by route, method and status");
    describe_histogram!("shearwarp_request_seconds", "From a request's head to its answer's head, by route");
    describe_histogram!("shearwarp_stage_seconds", "Stages of a frame, named as in Server-Timing");
    describe_counter!("shearwarp_refused_total", "Requests refused with 503 because the queue was full");
    describe_counter!("shearwarp_panics_total", "Panics caught and answered with 500");
    describe_counter!("shearwarp_cancelled_total", "Jobs cancelled because the client left or the deadline passed");
    describe_counter!("shearwarp_deadlines_total", "Requests that ended with 504");
    describe_gauge!("shearwarp_queue_depth", "Requests that wait for their turn");
    describe_gauge!("shearwarp_jobs_running", "Jobs on the render pool");
    describe_gauge!("shearwarp_streams", "WebSocket streams that are open");
    describe_counter!("shearwarp_stream_frames_total", "Frames sent over WebSocket streams");
    describe_gauge!("shearwarp_encodings", "Run-length encodings in memory");
    describe_gauge!("shearwarp_encodings_bytes", "Bytes of run-length encodings in memory");
    describe_gauge!("shearwarp_encodings_building", "Run-length encodings in the making");
    describe_gauge!("shearwarp_encodings_building_bytes", "Bytes that the run-length encodings in the making may take");
    describe_gauge!("shearwarp_classifications_bytes", "Bytes of classification tables in memory");
    describe_gauge!("shearwarp_shadows_bytes", "Bytes of shadows in memory");
    describe_counter!("shearwarp_encodings_hits_total", "Frames whose run-length encodings were in memory");
    describe_counter!("shearwarp_encodings_misses_total", "Frames that went through octree and table instead");
    describe_counter!("shearwarp_encodings_built_total", "Run-length encodings built");
    describe_counter!("shearwarp_encodings_too_large_total", "Frames whose run-length encodings may not fit the cache");
    describe_counter!("shearwarp_cache_folder_total", "Look-ups in the cache folder by outcome: hit, absent, refused");
    describe_gauge!("shearwarp_volumes", "Volumes by status: ready, loading, failed");
    // Counters that stand at 0 are worth seeing: an alert on a missing series never fires.
    for name in ["shearwarp_refused_total", "shearwarp_panics_total", "shearwarp_cancelled_total"] {
        counter!(name).absolute(0);
    }
}

/// A request was answered.
pub fn answered(route: String, method: &'static str, status: u16, duration: Duration) {
    counter!("shearwarp_requests_total", "route" => route.clone(), "method" => method, "status" => status.to_string())
        .increment(1);
    histogram!("shearwarp_request_seconds", "route" => route).record(duration);
}

/// A stage of a frame took so long.
pub fn stage(stage: &'static str, duration: Duration) {
    histogram!("shearwarp_stage_seconds", "stage" => stage).record(duration);
}

/// A request found the queue full.
pub fn refused() {
    counter!("shearwarp_refused_total").increment(1);
}

/// A frame goes out over a stream.
pub fn streamed() {
    counter!("shearwarp_stream_frames_total").increment(1);
}

/// A panic was caught.
pub fn panicked() {
    counter!("shearwarp_panics_total").increment(1);
}

/// A job was cancelled.
pub fn cancelled() {
    counter!("shearwarp_cancelled_total").increment(1);
}

/// A request ran into its deadline.
pub fn past_deadline() {
    counter!("shearwarp_deadlines_total").increment(1);
}

/// A frame asked for encodings.
pub fn encodings(hit: bool) {
    let name = if hit { "shearwarp_encodings_hits_total" } else { "shearwarp_encodings_misses_total" };
    counter!(name).increment(1);
}

/// Encodings were built.
pub fn encoded() {
    counter!("shearwarp_encodings_built_total").increment(1);
}

/// Encodings were not built because they may not fit.
pub fn encodings_too_large() {
    counter!("shearwarp_encodings_too_large_total").increment(1);
}

/// The cache folder was asked for an encoding.
pub fn cache_folder(outcome: &'static str) {
    counter!("shearwarp_cache_folder_total", "outcome" => outcome).increment(1);
}

/// What is read from the service when metrics are asked for.
#[derive(Clone, Copy, Debug)]
pub struct Gauges {
    pub waiting: usize,
    pub running: usize,
    pub streams: usize,
    pub cache: CacheSize,
    /// How many, and their bytes.
    pub meshes: (usize, u64),
    /// (ready, loading, failed)
    pub volumes: (usize, usize, usize),
}

/// All metrics as text.
pub fn render(gauges: Gauges) -> String {
    /// Gauges are set and read in one go, whoever else asks.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let handle = recorder();
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    gauge!("shearwarp_queue_depth").set(gauges.waiting as f64);
    gauge!("shearwarp_jobs_running").set(gauges.running as f64);
    gauge!("shearwarp_streams").set(gauges.streams as f64);
    gauge!("shearwarp_encodings").set(gauges.cache.encodings as f64);
    gauge!("shearwarp_encodings_bytes").set(gauges.cache.encoding_bytes as f64);
    gauge!("shearwarp_encodings_building").set(gauges.cache.building as f64);
    gauge!("shearwarp_encodings_building_bytes").set(gauges.cache.building_bytes as f64);
    gauge!("shearwarp_classifications_bytes").set(gauges.cache.classification_bytes as f64);
    gauge!("shearwarp_shadows_bytes").set(gauges.cache.shadow_bytes as f64);
    let (meshes, mesh_bytes) = gauges.meshes;
    gauge!("shearwarp_meshes").set(meshes as f64);
    gauge!("shearwarp_meshes_bytes").set(mesh_bytes as f64);
    let (ready, loading, failed) = gauges.volumes;
    for (status, count) in [("ready", ready), ("loading", loading), ("failed", failed)] {
        gauge!("shearwarp_volumes", "status" => status).set(count as f64);
    }
    handle.render()
}

/// Moves what was recorded into its buckets now and then, so that a service which nobody asks for
/// metrics does not keep every sample.
pub async fn upkeep() {
    let mut interval = tokio::time::interval(UPKEEP);
    loop {
        interval.tick().await;
        recorder().run_upkeep();
    }
}
