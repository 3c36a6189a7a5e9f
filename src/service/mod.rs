//! HTTP over the library; the only folder that knows tokio.
//!
//! One frame's way: [`router`] -> `frames` (parse the request; refuse here) -> `render_pool` (a
//! place, or 503) -> `classified` (tables; on a miss one job builds them while others wait) -> render and encode on the pool ->
//! headers. A `stream` asks for frames in the same way, over one connection. What can go wrong is in `error`, what an operator
//! may choose in [`config`], what is measured in `metrics`.

mod cache_folder;
mod classified;
pub mod config;
mod error;
mod frames;
mod loading;
mod meshes;
mod metrics;
mod negotiate;
mod observe;
mod operations;
mod presets;
mod render_pool;
pub mod request;
pub mod router;
mod scene;
mod server;
mod store;
mod stream;
mod turntable;
mod viewer;
mod volumes;

use std::io::{self, IsTerminal};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

pub use loading::{ScanError, modality};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tracing_subscriber::EnvFilter;

use cache_folder::CacheFolder;
use classified::ClassifiedCache;
use config::{Config, LogFormat};
use meshes::Meshes;
use render_pool::RenderPool;
use store::Store;
use stream::Streams;

/// Why the service did not start. While it runs, nothing ends it but a signal.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error("configuration: log.filter: {0}")]
    LogFilter(#[from] tracing_subscriber::filter::ParseError),
    #[error("cannot listen on {address}: {error}")]
    Listen { address: SocketAddr, error: io::Error },
    #[error(transparent)]
    Volumes(#[from] loading::ScanError),
    #[error("cache folder {path}: {error}")]
    CacheFolder { path: std::path::PathBuf, error: io::Error },
    #[error("cannot start the render threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    #[error("cannot start the runtime: {0}")]
    Runtime(io::Error),
}

/// What handlers share.
#[derive(Debug)]
pub struct App {
    config: Config,
    pool: RenderPool,
    store: Store,
    streams: Streams,
    /// Room for clients' scenes.
    scenes: Arc<Semaphore>,
    meshes: Meshes,
}

/// A service that has its address and is not yet running.
#[derive(Debug)]
pub struct Service {
    listener: TcpListener,
    address: SocketAddr,
    app: Arc<App>,
}

impl Service {
    /// Checks what can be checked at once, starts the render threads, and binds the address.
    ///
    /// # Errors
    /// See [`ServeError`].
    pub async fn bind(config: Config) -> Result<Self, ServeError> {
        metrics::recorder();
        let entries = loading::scan(config.volumes.as_deref())?;
        let folder = match &config.cache.folder {
            None => None,
            Some(path) => Some(
                CacheFolder::open(path, config.cache.folder_bytes)
                    .map_err(|error| ServeError::CacheFolder { path: path.clone(), error })?,
            ),
        };
        let pool = RenderPool::new(&config.render)?;
        let retry_after = config.render.retry_after_seconds.get();
        let store = Store::new(entries, ClassifiedCache::new(config.cache.classified_bytes, folder), retry_after);
        let failed = |error| ServeError::Listen { address: config.listen, error };
        let listener = TcpListener::bind(config.listen).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let streams = Streams::new(config.stream.max_streams.get());
        let scenes = Arc::new(Semaphore::new(config.http.max_scenes.get().min(Semaphore::MAX_PERMITS)));
        let meshes = Meshes::new(config.meshes.max_bytes);
        Ok(Self { listener, address, app: Arc::new(App { config, pool, store, streams, scenes, meshes }) })
    }

    /// Where it listens; the port is the real one where 0 was asked for.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Loads the volumes and answers requests until `shutdown` is done; then finishes what runs,
    /// within the deadline for that.
    pub async fn run(self, shutdown: impl Future<Output = ()>) {
        let loading = tokio::spawn(loading::load_all(Arc::clone(&self.app)));
        let upkeep = tokio::spawn(metrics::upkeep());
        let router = router::router(Arc::clone(&self.app));
        server::run(self.listener, router, &self.app.config.http, shutdown, self.app.streams.close()).await;
        loading.abort();
        upkeep.abort();
    }
}

/// Runs the service until SIGTERM or SIGINT; blocks. Prints `listening on http://ADDRESS` on
/// stdout, logs on stderr. Must not be called from an async context, as it starts a runtime.
///
/// # Errors
/// Where it cannot start; see [`ServeError`].
pub fn serve(config: Config) -> Result<(), ServeError> {
    start_log(&config.log)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(ServeError::Runtime)?;
    let outcome = runtime.block_on(async {
        let signals = server::signals().map_err(ServeError::Runtime)?;
        let service = Service::bind(config).await?;
        announce(service.address());
        service.run(signals).await;
        Ok(())
    });
    // Frames past the shutdown's deadline are dropped, which cancels them; nobody waits for them.
    runtime.shutdown_timeout(Duration::ZERO);
    outcome
}

/// Says where to go, for people and for scripts that asked for port 0.
fn announce(address: SocketAddr) {
    use std::io::Write;
    tracing::info!(%address, "listening");
    // A closed stdout is no reason not to serve.
    let _ = writeln!(io::stdout(), "listening on http://{address}").and_then(|()| io::stdout().flush());
}

fn start_log(config: &config::Log) -> Result<(), ServeError> {
    let filter = EnvFilter::try_new(&config.filter)?;
    // Colours for a terminal only: a collector would keep their codes.
    let ansi = io::stderr().is_terminal();
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(io::stderr).with_ansi(ansi);
    // A second service in one process (in tests) logs where the first does.
    let _ = match config.format {
        LogFormat::Text => builder.try_init(),
        LogFormat::Json => builder.json().try_init(),
    };
    Ok(())
}
