//! The one bridge from tokio to rayon.
//!
//! Tokio's threads must never compute and rayon's must never wait. A request first takes a
//! [`Ticket`], a place among those that wait or run; where none is left it is refused at once, so
//! that the queue, and with it memory and waiting time, is bounded. With its ticket it hands over
//! jobs. A job waits in tokio for one of few running slots (a frame is parallel inside; many at
//! once would only share the cores), runs on the rayon pool, and sends its result back.
//!
//! - The client leaves or the deadline passes: the awaiting future is dropped, which raises the
//!   job's [`Cancel`] flag. Slot and place come back when the job has really ended.
//! - The job panics: the panic is caught, counted and answered; the worker lives on.
//!
//! What is done behind the frames' backs runs on threads of its own: rayon's workers finish the pieces
//! of a job before they look for another, so that on the frames' threads a frame would wait for
//! nearly all of it. Those threads are nice (on Linux): they take what frames leave of the cores.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::{config, metrics};
use crate::render::Cancel;

/// Why a job gave no result.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PoolError {
    #[error("the queue is full")]
    Full {
        /// Seconds after which to come back.
        retry_after: u64,
    },
    #[error("the job panicked")]
    Panicked,
}

/// Threads that render, and who may use them. Clones share one pool.
#[derive(Clone, Debug)]
pub struct RenderPool {
    workers: Arc<ThreadPool>,
    /// For work that nobody waits for.
    behind: Arc<ThreadPool>,
    /// Places: requests that wait or run.
    places: Arc<Semaphore>,
    place_count: usize,
    /// Slots: jobs that run.
    slots: Arc<Semaphore>,
    slot_count: usize,
    retry_after: u64,
}

impl RenderPool {
    /// Starts the threads.
    ///
    /// # Errors
    /// Where the system gives no threads.
    pub fn new(config: &config::Render) -> Result<Self, ThreadPoolBuildError> {
        let workers = ThreadPoolBuilder::new()
            .num_threads(config.threads)
            .thread_name(|index| format!("render-{index}"))
            .build()?;
        let behind = ThreadPoolBuilder::new()
            .num_threads(config.threads)
            .thread_name(|index| format!("behind-{index}"))
            .start_handler(|_| give_way())
            .build()?;
        let slot_count = config.jobs.get();
        let place_count = slot_count.saturating_add(config.queue).min(Semaphore::MAX_PERMITS);
        Ok(Self {
            workers: Arc::new(workers),
            behind: Arc::new(behind),
            places: Arc::new(Semaphore::new(place_count)),
            place_count,
            slots: Arc::new(Semaphore::new(slot_count)),
            slot_count,
            retry_after: config.retry_after_seconds.get(),
        })
    }

    /// A place for a request.
    ///
    /// # Errors
    /// [`PoolError::Full`] where none is left.
    pub fn admit(&self) -> Result<Ticket, PoolError> {
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| {
            metrics::refused();
            PoolError::Full { retry_after: self.retry_after }
        })?;
        Ok(Ticket { pool: self.clone(), place: Some(Arc::new(place)) })
    }

    /// A place for a client that waits for it; there may be no more of those than are bounded elsewhere.
    ///
    /// # Errors
    /// Never, as long as the pool is there.
    pub async fn place(&self) -> Result<Ticket, PoolError> {
        let place = Arc::clone(&self.places).acquire_owned().await.map_err(|_closed| PoolError::Panicked)?;
        Ok(Ticket { pool: self.clone(), place: Some(Arc::new(place)) })
    }

    /// A ticket for the service's own work at its start, which must not be refused.
    pub fn own_work(&self) -> Ticket {
        Ticket { pool: self.clone(), place: None }
    }

    /// Runs `job` behind the frames' backs: it takes no slot, and of the cores what frames
    /// leave. It runs to its end whether or not the future is dropped.
    ///
    /// # Errors
    /// [`PoolError::Panicked`].
    pub async fn run_behind<T, F>(&self, job: F) -> Result<T, PoolError>
    where
        T: Send + 'static,
        F: FnOnce() -> T + Send + 'static,
    {
        ended(spawn(&self.behind, (), job).await)
    }

    /// Jobs that run.
    pub fn running(&self) -> usize {
        self.slot_count - self.slots.available_permits()
    }

    /// Requests that wait for a slot.
    pub fn waiting(&self) -> usize {
        (self.place_count - self.places.available_permits()).saturating_sub(self.running())
    }
}

/// The right to hand over jobs. Clones share one place, which is given back with the last of them
/// and of the jobs that it started.
#[derive(Clone, Debug)]
pub struct Ticket {
    pool: RenderPool,
    place: Option<Arc<OwnedSemaphorePermit>>,
}

impl Ticket {
    /// The pool that it is for.
    pub fn pool(&self) -> &RenderPool {
        &self.pool
    }

    /// Runs `job` on the pool and gives its result and the time that it waited for its turn.
    /// Dropping the future raises the flag that `job` gets.
    ///
    /// # Errors
    /// [`PoolError::Panicked`].
    pub async fn run<T, F>(&self, job: F) -> Result<(T, Duration), PoolError>
    where
        T: Send + 'static,
        F: FnOnce(&Cancel) -> T + Send + 'static,
    {
        let arrived = Instant::now();
        let slot = Arc::clone(&self.pool.slots).acquire_owned().await.map_err(|_closed| PoolError::Panicked)?;
        let waited = arrived.elapsed();

        let cancel = Cancel::default();
        let mut guard = CancelOnDrop(Some(cancel.clone()));
        let place = self.place.clone();
        let result = spawn(&self.pool.workers, (slot, place), move || job(&cancel)).await;
        guard.0 = None;
        Ok((ended(result)?, waited))
    }
}

/// The outcome of a job, once it is there.
type Outcome<T> = oneshot::Receiver<std::thread::Result<T>>;

/// Hands `job` to `workers`; `held` is dropped when it has ended, before anybody hears of it.
fn spawn<T: Send + 'static>(
    workers: &ThreadPool,
    held: impl Send + 'static,
    job: impl FnOnce() -> T + Send + 'static,
) -> Outcome<T> {
    let (sender, receiver) = oneshot::channel();
    workers.spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(job));
        drop(held);
        // Nobody receives where the client has left; the result is then of no use.
        let _ = sender.send(result);
    });
    receiver
}

/// The result of a job that has ended; panics are counted.
fn ended<T>(outcome: Result<std::thread::Result<T>, oneshot::error::RecvError>) -> Result<T, PoolError> {
    outcome.ok().and_then(Result::ok).ok_or_else(|| {
        metrics::panicked();
        PoolError::Panicked
    })
}

/// Lets all other threads go first.
#[cfg(target_os = "linux")]
fn give_way() {
    /// A tenth of the share of a thread that is not nice.
    const NICE: i32 = 10;
    // Where it may not be nicer it is as nice as it is.
    let _ = rustix::process::nice(NICE);
}

/// Elsewhere `nice` is for whole processes.
#[cfg(not(target_os = "linux"))]
fn give_way() {}

/// Raises the flag unless it was taken out before.
struct CancelOnDrop(Option<Cancel>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        if let Some(cancel) = &self.0 {
            metrics::cancelled();
            cancel.cancel();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::num::{NonZeroU64, NonZeroUsize};
    use std::sync::mpsc;
    use std::thread;

    use super::*;

    fn pool(jobs: usize, queue: usize) -> RenderPool {
        RenderPool::new(&config::Render {
            threads: 2,
            jobs: NonZeroUsize::new(jobs).unwrap(),
            queue,
            retry_after_seconds: NonZeroU64::new(3).unwrap(),
            deadline: Duration::from_secs(60),
        })
        .unwrap()
    }

    /// Waits until `condition` holds; a defect shows as a hanging test that panics after 10 s.
    async fn eventually(what: &str, condition: impl Fn() -> bool) {
        for _ in 0..2000 {
            if condition() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        panic!("never came: {what}");
    }

    #[tokio::test]
    async fn beyond_slots_and_queue_a_request_is_refused_and_a_place_comes_back() {
        let pool = pool(1, 1);
        let first = pool.admit().unwrap();
        let second = pool.admit().unwrap();
        assert_eq!(pool.admit().unwrap_err(), PoolError::Full { retry_after: 3 });
        drop(second);
        assert!(pool.admit().is_ok());
        drop(first);
        assert_eq!(pool.waiting(), 0);
    }

    #[tokio::test]
    async fn no_more_jobs_run_than_slots() {
        let pool = pool(1, 2);
        let (release, released) = mpsc::channel::<()>();
        let (first, second) = (pool.admit().unwrap(), pool.admit().unwrap());
        let running = tokio::spawn(async move { first.run(move |_| released.recv().is_ok()).await });
        eventually("the first job runs", || pool.running() == 1).await;
        let waiting = tokio::spawn(async move { second.run(|_| 7).await });
        tokio::time::sleep(Duration::from_millis(30)).await;
        assert_eq!((pool.running(), pool.waiting(), waiting.is_finished()), (1, 1, false));
        release.send(()).unwrap();
        assert!(running.await.unwrap().unwrap().0);
        let (value, waited) = waiting.await.unwrap().unwrap();
        assert_eq!(value, 7);
        assert!(waited >= Duration::from_millis(20), "{waited:?}");
    }

    #[tokio::test]
    async fn work_behind_the_frames_takes_neither_their_slots_nor_their_threads() {
        let pool = pool(1, 0);
        let ticket = pool.admit().unwrap();
        let behind = pool.clone();
        let (release, released) = mpsc::channel::<()>();
        // Every thread that is for such work is busy.
        let gates = std::sync::Mutex::new(released);
        let busy = tokio::spawn(async move {
            behind
                .run_behind(move || {
                    rayon::broadcast(|_| gates.lock().unwrap().recv().unwrap());
                })
                .await
        });
        assert_eq!(ticket.run(|_| rayon::current_num_threads()).await.unwrap().0, 2);
        assert!(!busy.is_finished());
        [(), ()].into_iter().for_each(|()| release.send(()).unwrap());
        busy.await.unwrap().unwrap();
        assert_eq!(
            pool.run_behind(|| if true {
                panic!("a defect")
            })
            .await,
            Err(PoolError::Panicked)
        );
    }

    #[tokio::test]
    async fn a_panic_is_an_error_and_the_pool_lives_on() {
        let pool = pool(1, 0);
        let ticket = pool.admit().unwrap();
        let outcome = ticket.run(|_| if true { panic!("a defect") } else { 0 }).await;
        assert_eq!(outcome.unwrap_err(), PoolError::Panicked);
        assert_eq!(ticket.run(|_| 5).await.unwrap().0, 5);
    }

    #[tokio::test]
    async fn a_client_that_leaves_cancels_its_job_and_frees_slot_and_place() {
        let pool = pool(1, 0);
        let ticket = pool.admit().unwrap();
        let client = tokio::spawn(async move {
            ticket
                .run(|cancel| {
                    while !cancel.is_cancelled() {
                        thread::sleep(Duration::from_millis(1));
                    }
                })
                .await
        });
        eventually("the job runs", || pool.running() == 1).await;
        assert!(pool.admit().is_err(), "the only place is taken");
        client.abort();
        eventually("the job ends", || pool.running() == 0).await;
        assert!(pool.admit().is_ok());
    }
}
