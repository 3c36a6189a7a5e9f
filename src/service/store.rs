//! The volumes that are served, and the classified volumes made from them.
//!
//! A volume is loaded once and stays. What is classified depends on a transfer function that a client
//! may send anew with every request, so it is cached: weighed in bytes, the least recently used go
//! first.
//!
//! A frame needs a classification, which takes milliseconds. Requests that need the same one at the
//! same time share one build, which belongs to none of them: it runs on to its end in a task of its
//! own, on the place in the queue of the request that began it, for a client that leaves would
//! otherwise take the work of all who wait with it.
//!
//! Encodings make frames faster and change no bit, so no frame waits for them ("switch modes", Lacroute
//! and Levoy 1994, section 3.3). They are built behind the frames' backs, one at a time, which bounds
//! the memory of what is in the making; and only for what was asked for again, since whoever
//! drags a control point sends a transfer function for every frame and comes back to none of them.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};

use moka::future::Cache;
use moka::policy::EvictionPolicy;
use tokio::sync::Semaphore;
use xxhash_rust::xxh3::Xxh3;

use super::cache_folder::CacheFolder;
use super::error::Problem;
use super::metrics;
use super::render_pool::{PoolError, Ticket};
use super::request::ResolvedRequest;
use crate::classify::presets::FittedPresets;
use crate::classify::{Classification, Encodings, Purpose, TransferFunction};
use crate::volume::histogram::Histogram;
use crate::volume::{PreparedVolume, Scalars, Volume, pyramid};

/// Where a volume comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// The built-in head.
    Demo,
    File(PathBuf),
}

/// A volume that was configured, loaded or not.
#[derive(Debug)]
pub struct Entry {
    /// What requests call it.
    pub id: String,
    /// What people call it.
    pub name: String,
    pub source: Source,
    /// As the operator wrote it (CT, MR, ...).
    pub modality: Option<String>,
    state: OnceLock<Result<Arc<LoadedVolume>, String>>,
}

/// Whether a volume can be rendered.
#[derive(Clone, Debug)]
pub enum Status {
    Loading,
    Ready(Arc<LoadedVolume>),
    /// With the reason.
    Failed(String),
}

impl Entry {
    /// A volume that is yet to be loaded.
    pub fn new(id: String, name: String, source: Source, modality: Option<String>) -> Self {
        Self { id, name, source, modality, state: OnceLock::new() }
    }

    /// Whether it can be rendered.
    pub fn status(&self) -> Status {
        match self.state.get() {
            None => Status::Loading,
            Some(Ok(loaded)) => Status::Ready(Arc::clone(loaded)),
            Some(Err(reason)) => Status::Failed(reason.clone()),
        }
    }

    /// Ends the loading; only the first end counts.
    pub fn settle(&self, outcome: Result<Arc<LoadedVolume>, String>) {
        let _ = self.state.set(outcome);
    }
}

/// A volume in memory with all that is known about it before anybody asks.
#[derive(Debug)]
pub struct LoadedVolume {
    prepared: PreparedVolume,
    /// Half the size along each axis; built when a draft first asks for it.
    coarse: OnceLock<PreparedVolume>,
    pub histogram: Histogram,
    pub presets: FittedPresets,
    /// Names the content: voxels, rescale and placement.
    pub fingerprint: u128,
}

impl LoadedVolume {
    /// Builds the structures on the current rayon pool.
    pub fn build(volume: Volume, modality: Option<&str>) -> Self {
        let fingerprint = fingerprint(&volume);
        let histogram = Histogram::of(&volume);
        let presets = FittedPresets::of(&volume, modality);
        Self { prepared: PreparedVolume::build(volume), coarse: OnceLock::new(), histogram, presets, fingerprint }
    }

    /// What was measured.
    pub fn volume(&self) -> &Volume {
        self.prepared.volume()
    }

    /// A level of the pyramid: 0, the volume itself, or 1. Called on the rayon pool.
    pub fn level(&self, level: usize) -> &PreparedVolume {
        match level {
            0 => &self.prepared,
            _ => self.coarse.get_or_init(|| PreparedVolume::build(pyramid::coarser(self.volume()))),
        }
    }

    /// Bytes in memory, by structure.
    pub fn bytes(&self) -> impl Iterator<Item = (&'static str, u64)> {
        let coarse = self.coarse.get().map_or(0, |coarse| coarse.bytes().iter().map(|(_, bytes)| bytes).sum());
        self.prepared.bytes().into_iter().chain([("pyramid", coarse), ("histogram", self.histogram.bytes())])
    }
}

/// Names a volume by content, so that a file replaced under the same name is another volume to
/// every cache: ours, on disk, and the clients'.
fn fingerprint(volume: &Volume) -> u128 {
    let mut hash = Xxh3::new();
    for n in volume.dims() {
        hash.update(&(n as u64).to_le_bytes());
    }
    let placement = volume.placement();
    let (slope, intercept) = volume.rescale();
    let numbers = placement.spacing.to_array().into_iter().chain(placement.direction.to_cols_array());
    for number in numbers.chain(placement.origin.to_array()).chain([slope, intercept]) {
        hash.update(&number.to_le_bytes());
    }
    match volume.scalars() {
        Scalars::U8(codes) => {
            hash.update(&[1]);
            hash.update(codes);
        }
        Scalars::U16(codes) => {
            hash.update(&[2]);
            hash.update(bytemuck::cast_slice(codes));
        }
    }
    hash.digest128()
}

/// What a classified volume is made from, besides the volume.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassifiedKey {
    /// Level of the volume's pyramid.
    pub level: usize,
    pub transfer: TransferFunction,
    pub purpose: Purpose,
}

impl ClassifiedKey {
    /// What a frame needs; `None`: nothing classified.
    pub fn of(frame: &ResolvedRequest) -> Option<Self> {
        frame.purpose().map(|purpose| Self { level: frame.level(), transfer: frame.transfer.clone(), purpose })
    }

    /// The whole content, not a hash of it: hashes can be made to collide by whoever sends transfer
    /// functions, and then one client would get another's picture.
    fn name(&self, volume: &LoadedVolume) -> Arc<str> {
        let transfer = serde_json::to_string(&self.transfer).expect("a transfer function has only string keys");
        format!("{:032x} {} {:?} {transfer}", volume.fingerprint, self.level, self.purpose).into()
    }
}

/// What a frame walks.
#[derive(Clone, Debug)]
pub struct Classified {
    pub classification: Arc<Classification>,
    /// `None`: not there yet.
    pub encodings: Option<Arc<Encodings>>,
}

/// A classification, and how often it was asked for.
#[derive(Debug)]
struct Asked {
    classification: Arc<Classification>,
    times: AtomicU32,
}

/// Volumes by id, and what was classified by what it is made from.
#[derive(Debug)]
pub struct Store {
    entries: BTreeMap<String, Arc<Entry>>,
    classifications: Cache<Arc<str>, Arc<Asked>>,
    encodings: Cache<Arc<str>, Arc<Encodings>>,
    /// Held by the build in flight.
    building: Arc<Semaphore>,
    folder: Option<CacheFolder>,
    retry_after: u64,
}

/// Share of the cache that is for classifications: tables, which are small beside encodings.
const CLASSIFICATIONS_SHARE: u64 = 4;

impl Store {
    /// A store of these volumes. Classified volumes take `classified_bytes` of memory at most.
    pub fn new(entries: Vec<Entry>, classified_bytes: u64, folder: Option<CacheFolder>, retry_after: u64) -> Self {
        let for_classifications = classified_bytes / CLASSIFICATIONS_SHARE;
        let classifications = Cache::builder()
            .weigher(|key: &Arc<str>, asked: &Arc<Asked>| kib(key.len() as u64 + asked.classification.bytes()))
            .max_capacity(for_classifications / 1024)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let encodings = Cache::builder()
            .weigher(|key: &Arc<str>, encodings: &Arc<Encodings>| kib(key.len() as u64 + encodings.bytes()))
            .max_capacity((classified_bytes - for_classifications) / 1024)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let entries = entries.into_iter().map(|entry| (entry.id.clone(), Arc::new(entry))).collect();
        Self { entries, classifications, encodings, building: Arc::new(Semaphore::new(1)), folder, retry_after }
    }

    /// Every volume, by id.
    pub fn entries(&self) -> impl Iterator<Item = &Arc<Entry>> {
        self.entries.values()
    }

    /// The volume of this id.
    ///
    /// # Errors
    /// 404 where there is none.
    pub fn entry(&self, id: &str) -> Result<&Arc<Entry>, Problem> {
        self.entries.get(id).ok_or_else(|| Problem::NoSuchVolume(id.to_owned()))
    }

    /// The volume of this id, in memory.
    ///
    /// # Errors
    /// 404 where there is none, 503 while it is loaded, 409 where it could not be.
    pub fn loaded(&self, id: &str) -> Result<Arc<LoadedVolume>, Problem> {
        match self.entry(id)?.status() {
            Status::Ready(volume) => Ok(volume),
            Status::Loading => Err(Problem::Loading { id: id.to_owned(), retry_after: self.retry_after }),
            Status::Failed(detail) => Err(Problem::VolumeFailed { id: id.to_owned(), detail }),
        }
    }

    /// Volumes (ready, loading, failed).
    pub fn counts(&self) -> (usize, usize, usize) {
        self.entries().fold((0, 0, 0), |(ready, loading, failed), entry| match entry.status() {
            Status::Ready(_) => (ready + 1, loading, failed),
            Status::Loading => (ready, loading + 1, failed),
            Status::Failed(_) => (ready, loading, failed + 1),
        })
    }

    /// Entries and bytes of the encodings in memory, and bytes of classifications.
    pub async fn cache_size(&self) -> CacheSize {
        self.encodings.run_pending_tasks().await;
        self.classifications.run_pending_tasks().await;
        CacheSize {
            encodings: self.encodings.entry_count(),
            encoding_bytes: self.encodings.weighted_size() * 1024,
            classification_bytes: self.classifications.weighted_size() * 1024,
            building: 1 - self.building.available_permits().min(1),
        }
    }

    /// What a frame walks: the classification, from memory or built by a job of `ticket`; and the
    /// encodings, where they are in memory. Where they are not, and the same is asked for again, they
    /// are built behind the frame's back.
    ///
    /// # Errors
    /// Where the build panicked.
    pub async fn classified(
        &self,
        ticket: &Ticket,
        volume: &Arc<LoadedVolume>,
        made_from: ClassifiedKey,
    ) -> Result<Classified, PoolError> {
        let key = made_from.name(volume);
        let asked = self.classification(ticket, volume, &made_from, &key).await?;
        let encodings = self.encodings.get(&key).await;
        metrics::encodings(encodings.is_some());
        let again = asked.times.fetch_add(1, Ordering::Relaxed) > 0;
        let classification = Arc::clone(&asked.classification);
        if encodings.is_none()
            && again
            && let Ok(permit) = Arc::clone(&self.building).try_acquire_owned()
        {
            let job = self.encode(&key, volume, made_from, &classification, false);
            let (cache, ticket) = (self.encodings.clone(), ticket.without_place());
            tokio::spawn(async move {
                // A panic was counted; the next frame that asks tries again.
                if let Ok((encodings, _)) = ticket.run(move |_| job()).await {
                    cache.insert(key, encodings).await;
                }
                drop(permit);
            });
        }
        Ok(Classified { classification, encodings })
    }

    /// Builds what a frame would walk, encodings included, or reads these from the cache folder, and
    /// keeps them there: for what the service wants again after its next start.
    ///
    /// # Errors
    /// Where a build panicked.
    pub async fn warm_up(
        &self,
        ticket: &Ticket,
        volume: &Arc<LoadedVolume>,
        made_from: ClassifiedKey,
    ) -> Result<(), PoolError> {
        let key = made_from.name(volume);
        let asked = self.classification(ticket, volume, &made_from, &key).await?;
        let job = self.encode(&key, volume, made_from, &asked.classification, true);
        let (encodings, _) = ticket.run(move |_| job()).await?;
        self.encodings.insert(key, encodings).await;
        Ok(())
    }

    async fn classification(
        &self,
        ticket: &Ticket,
        volume: &Arc<LoadedVolume>,
        made_from: &ClassifiedKey,
        key: &Arc<str>,
    ) -> Result<Arc<Asked>, PoolError> {
        if let Some(asked) = self.classifications.get(key).await {
            return Ok(asked);
        }
        let (cache, volume, made_from, ticket, key) =
            (self.classifications.clone(), Arc::clone(volume), made_from.clone(), ticket.clone(), Arc::clone(key));
        let build = tokio::spawn(async move {
            let job = move || {
                let ClassifiedKey { level, transfer, purpose } = &made_from;
                let classification = Classification::build(volume.level(*level), transfer, *purpose);
                Arc::new(Asked { classification: Arc::new(classification), times: AtomicU32::new(0) })
            };
            cache.try_get_with(key, async move { ticket.run(move |_| job()).await.map(|(built, _)| built) }).await
        });
        build.await.map_err(|_| PoolError::Panicked)?.map_err(|shared| PoolError::clone(&shared))
    }

    /// A job that gives encodings: from the folder or built, on the current rayon pool.
    fn encode(
        &self,
        key: &Arc<str>,
        volume: &Arc<LoadedVolume>,
        made_from: ClassifiedKey,
        classification: &Arc<Classification>,
        keep: bool,
    ) -> impl FnOnce() -> Arc<Encodings> + use<> {
        let (key, volume, classification, folder) =
            (Arc::clone(key), Arc::clone(volume), Arc::clone(classification), self.folder.clone());
        move || {
            let ClassifiedKey { level, transfer, purpose } = &made_from;
            let prepared = volume.level(*level);
            let read = |folder: &CacheFolder| {
                folder.load(&key, |mut input| Encodings::read_from(prepared, transfer, *purpose, &mut input))
            };
            if let Some(kept) = folder.as_ref().and_then(read) {
                return Arc::new(kept);
            }
            let built = Encodings::build(prepared, transfer, &classification);
            metrics::encoded();
            if let Some(folder) = folder.filter(|_| keep)
                && let Err(error) = folder.save(&key, |mut output| built.write_to(&mut output))
            {
                tracing::warn!(%error, "the cache folder cannot be written; the next start builds anew");
            }
            Arc::new(built)
        }
    }
}

/// What the caches hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CacheSize {
    /// Encodings.
    pub encodings: u64,
    pub encoding_bytes: u64,
    pub classification_bytes: u64,
    /// Encodings in the making.
    pub building: usize,
}

/// Weights are 32 bits wide, hence KiB: up to 4 TiB.
fn kib(bytes: u64) -> u32 {
    u32::try_from(bytes.div_ceil(1024)).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use std::num::{NonZeroU64, NonZeroUsize};
    use std::time::Duration;

    use super::*;
    use crate::classify::{Color, ControlPoint};
    use crate::service::config;
    use crate::service::render_pool::RenderPool;
    use crate::volume::phantom;

    fn pool() -> RenderPool {
        RenderPool::new(&config::Render {
            threads: 2,
            jobs: NonZeroUsize::MIN,
            queue: 100,
            retry_after_seconds: NonZeroU64::MIN,
            deadline: Duration::from_secs(60),
        })
        .unwrap()
    }

    fn made_from(opacity: f64) -> ClassifiedKey {
        let point = |value, opacity| ControlPoint { value, opacity, color: Color([1.0; 3]) };
        let transfer = TransferFunction {
            points: vec![point(0.0, 0.0), point(200.0, opacity)],
            opacity_distance: Some(1.0),
            gradient_opacity: vec![],
        };
        ClassifiedKey { level: 0, transfer, purpose: Purpose::Voxels { min_opacity: 0.002 } }
    }

    fn ball(radius: f64) -> Arc<LoadedVolume> {
        Arc::new(LoadedVolume::build(phantom::ball(24, radius, 200.0, 1.0), None))
    }

    fn store(bytes: u64) -> Arc<Store> {
        Arc::new(Store::new(vec![], bytes, None, 1))
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn requests_at_the_same_time_share_one_build() {
        let (store, pool, volume) = (store(1 << 30), pool(), ball(8.0));
        let requests = (0..20).map(|_| {
            let (store, volume, ticket) = (Arc::clone(&store), Arc::clone(&volume), pool.admit().unwrap());
            tokio::spawn(async move { store.classified(&ticket, &volume, made_from(0.5)).await.unwrap() })
        });
        let mut built = vec![];
        for request in requests.collect::<Vec<_>>() {
            built.push(request.await.unwrap());
        }
        assert!(built.iter().all(|one| Arc::ptr_eq(&one.classification, &built[0].classification)));
        let other = store.classified(&pool.own_work(), &volume, made_from(0.6)).await.unwrap();
        assert!(!Arc::ptr_eq(&other.classification, &built[0].classification));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_build_outlives_the_client_that_began_it() {
        let (store, pool, volume) = (store(1 << 30), pool(), ball(8.0));
        let ticket = pool.own_work();
        let first = store.classified(&ticket, &volume, made_from(0.5));
        // Polled once, which hands the build over, and dropped (unless the build was done at once).
        let _ = tokio::time::timeout(Duration::ZERO, first).await;
        while store.cache_size().await.classification_bytes == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn encodings_come_for_what_is_asked_for_again_and_nobody_waits_for_them() {
        let (store, pool, volume) = (store(1 << 30), pool(), ball(8.0));
        let ticket = pool.own_work();
        let ask = || store.classified(&ticket, &volume, made_from(0.5));
        assert!(ask().await.unwrap().encodings.is_none());
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert_eq!(store.cache_size().await.encodings, 0, "asked for once");
        assert!(ask().await.unwrap().encodings.is_none());
        while store.cache_size().await.encodings == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert!(ask().await.unwrap().encodings.is_some());
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn the_least_recently_used_go_when_the_bytes_are_used_up() {
        let (pool, volume) = (pool(), ball(8.0));
        let warm = async |store: &Store, opacity| {
            store.warm_up(&pool.own_work(), &volume, made_from(opacity)).await.unwrap();
            store.cache_size().await
        };
        let one = warm(&store(1 << 30), 0.5).await.encoding_bytes;
        // Three quarters of the bytes are for encodings.
        let store = store((3 * one + one / 2) * 4 / 3);
        for opacity in [0.50, 0.51, 0.52, 0.53, 0.54, 0.55] {
            assert!(warm(&store, opacity).await.encoding_bytes <= 3 * one + one / 2);
        }
        assert_eq!(store.cache_size().await.encodings, 3);
        assert!(store.encodings.get(&made_from(0.55).name(&volume)).await.is_some());
        assert!(store.encodings.get(&made_from(0.50).name(&volume)).await.is_none());
    }

    #[test]
    fn a_volume_is_named_by_its_content() {
        assert_eq!(ball(8.0).fingerprint, ball(8.0).fingerprint);
        assert_ne!(ball(8.0).fingerprint, ball(7.0).fingerprint);
        let softer = LoadedVolume::build(phantom::ball(24, 8.0, 200.0, 2.0), None);
        assert_ne!(ball(8.0).fingerprint, softer.fingerprint);
        assert_ne!(made_from(0.5).name(&ball(8.0)), made_from(0.6).name(&ball(8.0)));
    }
}
