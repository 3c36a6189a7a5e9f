//! Connections: accepted, timed, and ended in order.
//!
//! `axum::serve` would do but for time: it gives hyper no timer, so that a client which sends its
//! request's head a byte a minute, or never reads its answer, keeps a connection for ever, and a
//! shutdown waits for it. So the loop is our own: every connection has a timeout for the head (and
//! for the rest between two requests) and one for writes that stand still; the shutdown closes idle
//! connections at once, lets answers finish, and ends at a hard deadline whoever is left.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::{GracefulShutdown, Watcher};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_io_timeout::TimeoutStream;

use super::config;

/// How long to wait after `accept` failed, mostly for want of file descriptors: some must be closed
/// before the next attempt can do better.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Serves until `shutdown` is done, then lets answers finish and streams close (which is what `close_streams` does) for at
/// most `config.shutdown`.
pub async fn run(
    listener: TcpListener,
    router: Router,
    config: &config::Http,
    shutdown: impl Future<Output = ()>,
    close_streams: impl Future<Output = ()>,
) {
    let graceful = GracefulShutdown::new();
    let places = Arc::new(Semaphore::new(config.max_connections.get().min(Semaphore::MAX_PERMITS)));
    let timeouts = [config.header_timeout, config.write_timeout];
    let mut shutdown = std::pin::pin!(shutdown);
    loop {
        let (stream, place) = tokio::select! {
            accepted = accept(&listener, &places) => accepted,
            () = &mut shutdown => break,
        };
        tokio::spawn(connection(stream, place, router.clone(), timeouts, graceful.watcher()));
    }
    drop(listener);
    tracing::info!(connections = graceful.count(), "shutting down");
    let ended = async { tokio::join!(graceful.shutdown(), close_streams) };
    match tokio::time::timeout(config.shutdown, ended).await {
        Ok(_) => tracing::info!("every answer is out"),
        Err(_) => tracing::warn!("the deadline for the shutdown has passed; what still ran is dropped"),
    }
}

/// The next connection, once there is a place for it.
async fn accept(listener: &TcpListener, places: &Arc<Semaphore>) -> (TcpStream, OwnedSemaphorePermit) {
    loop {
        let place = Arc::clone(places).acquire_owned().await.expect("the semaphore is never closed");
        match listener.accept().await {
            Ok((stream, _)) => return (stream, place),
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
    }
}

/// One connection to its end, or to where it becomes a stream; `place` is held as long.
async fn connection(
    stream: TcpStream,
    place: OwnedSemaphorePermit,
    router: Router,
    [header_timeout, write_timeout]: [Duration; 2],
    watcher: Watcher,
) {
    // A frame's head and body are small writes that must not wait for each other's acknowledgement.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "no TCP_NODELAY");
    }
    let mut stream = TimeoutStream::new(stream);
    // No timeout for reads: hyper reads while an answer is made, to see whether the client leaves.
    stream.set_write_timeout(Some(write_timeout));
    let mut builder = Builder::new(TokioExecutor::new()).http1_only();
    builder.http1().timer(TokioTimer::new()).header_read_timeout(header_timeout);
    let io = TokioIo::new(Box::pin(stream));
    let connection = builder.serve_connection_with_upgrades(io, TowerToHyperService::new(router));
    if let Err(error) = watcher.watch(connection).await {
        // Clients leave, send no HTTP, or take too long: their affair, not an operator's.
        tracing::debug!(%error, "connection ended");
    }
    drop(place);
}

/// Done when the process is asked to end: SIGTERM or SIGINT.
///
/// # Errors
/// Where the system gives no signal handlers.
pub fn signals() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => tracing::info!("SIGTERM"),
            _ = interrupt.recv() => tracing::info!("SIGINT"),
        }
    })
}
