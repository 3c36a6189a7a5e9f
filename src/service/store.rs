//! The volumes that are served, and the classified volumes made from them.
//!
//! A volume is loaded once and stays. A classified volume depends on a transfer function that a
//! client may send anew with every request, so these are a cache: weighed in bytes, the least
//! recently used go first. Requests that need the same one at the same time share one build. The
//! build belongs to none of them: it runs on to its end in a task of its own, on the place in the
//! queue of the request that began it, for a client that leaves would otherwise take the work of
//! all who wait with it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use moka::future::Cache;
use moka::policy::EvictionPolicy;
use xxhash_rust::xxh3::Xxh3;

use super::cache_folder::CacheFolder;
use super::error::Problem;
use super::metrics;
use super::render_pool::{PoolError, Ticket};
use super::request::ResolvedRequest;
use crate::classify::presets::FittedPresets;
use crate::classify::{Classification, Encodings, Purpose, TransferFunction};
use crate::volume::histogram::Histogram;
use crate::volume::{PreparedVolume, Scalars, Volume};

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
    pub prepared: PreparedVolume,
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
        Self { prepared: PreparedVolume::build(volume), histogram, presets, fingerprint }
    }

    /// What was measured.
    pub fn volume(&self) -> &Volume {
        self.prepared.volume()
    }

    /// Bytes in memory, by structure.
    pub fn bytes(&self) -> impl Iterator<Item = (&'static str, u64)> {
        self.prepared.bytes().into_iter().chain([("histogram", self.histogram.bytes())])
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
    pub transfer: TransferFunction,
    pub purpose: Purpose,
}

impl ClassifiedKey {
    /// What a frame needs; `None`: nothing classified.
    pub fn of(frame: &ResolvedRequest) -> Option<Self> {
        frame.purpose().map(|purpose| Self { transfer: frame.transfer.clone(), purpose })
    }

    /// The whole content, not a hash of it: hashes can be made to collide by whoever sends transfer
    /// functions, and then one client would get another's picture.
    fn name(&self, volume: &LoadedVolume) -> Arc<str> {
        let transfer = serde_json::to_string(&self.transfer).expect("a transfer function has only string keys");
        format!("{:032x} {:?} {transfer}", volume.fingerprint, self.purpose).into()
    }
}

/// A classification and its encodings.
#[derive(Debug)]
pub struct Classified {
    pub classification: Classification,
    pub encodings: Encodings,
}

/// Volumes by id, classified volumes by what they are made from.
#[derive(Debug)]
pub struct Store {
    entries: BTreeMap<String, Arc<Entry>>,
    classified: Cache<Arc<str>, Arc<Classified>>,
    folder: Option<CacheFolder>,
    retry_after: u64,
}

impl Store {
    /// A store of these volumes. Classified volumes take `classified_bytes` of memory at most.
    pub fn new(entries: Vec<Entry>, classified_bytes: u64, folder: Option<CacheFolder>, retry_after: u64) -> Self {
        let classified = Cache::builder()
            .weigher(|key: &Arc<str>, classified: &Arc<Classified>| kib(key.len() as u64 + total(classified)))
            .max_capacity(classified_bytes / 1024)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let entries = entries.into_iter().map(|entry| (entry.id.clone(), Arc::new(entry))).collect();
        Self { entries, classified, folder, retry_after }
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

    /// Entries and bytes of the classified volumes in memory.
    pub async fn cache_size(&self) -> (u64, u64) {
        self.classified.run_pending_tasks().await;
        (self.classified.entry_count(), self.classified.weighted_size() * 1024)
    }

    /// The classified volume, from memory, from the cache folder, or built by a job of `ticket`.
    /// `keep` writes a built one to the folder: for those that the service wants again after its
    /// next start, not for whatever a client makes up.
    ///
    /// # Errors
    /// Where the build panicked.
    pub async fn classified(
        &self,
        ticket: &Ticket,
        volume: &Arc<LoadedVolume>,
        made_from: ClassifiedKey,
        keep: bool,
    ) -> Result<Arc<Classified>, PoolError> {
        let key = made_from.name(volume);
        let hit = self.classified.get(&key).await;
        metrics::classified_cache(hit.is_some());
        if let Some(classified) = hit {
            return Ok(classified);
        }
        let (cache, folder, volume, ticket) =
            (self.classified.clone(), self.folder.clone(), Arc::clone(volume), ticket.clone());
        let build = tokio::spawn(async move {
            let name = Arc::clone(&key);
            let job = move || Arc::new(obtain(&name, &volume, &made_from, folder.as_ref(), keep));
            cache.try_get_with(key, async move { ticket.run(move |_| job()).await.map(|(built, _)| built) }).await
        });
        build.await.map_err(|_| PoolError::Panicked)?.map_err(|shared| PoolError::clone(&shared))
    }
}

/// From the folder or built; on the current rayon pool.
fn obtain(
    key: &str,
    volume: &LoadedVolume,
    ClassifiedKey { transfer, purpose }: &ClassifiedKey,
    folder: Option<&CacheFolder>,
    keep: bool,
) -> Classified {
    let classification = Classification::build(&volume.prepared, transfer, *purpose);
    let read = |folder: &CacheFolder| {
        folder.load(key, |mut input| Encodings::read_from(&volume.prepared, transfer, *purpose, &mut input))
    };
    if let Some(encodings) = folder.and_then(read) {
        return Classified { classification, encodings };
    }
    let built = Encodings::build(&volume.prepared, transfer, &classification);
    if let Some(folder) = folder.filter(|_| keep)
        && let Err(error) = folder.save(key, |mut output| built.write_to(&mut output))
    {
        tracing::warn!(%error, "the cache folder cannot be written; the next start builds anew");
    }
    Classified { classification, encodings: built }
}

/// Bytes of a classified volume.
fn total(classified: &Classified) -> u64 {
    classified.classification.bytes() + classified.encodings.bytes()
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
        ClassifiedKey { transfer, purpose: Purpose::Voxels { min_opacity: 0.002 } }
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
            tokio::spawn(async move { store.classified(&ticket, &volume, made_from(0.5), false).await.unwrap() })
        });
        let mut built = vec![];
        for request in requests.collect::<Vec<_>>() {
            built.push(request.await.unwrap());
        }
        assert!(built.iter().all(|one| Arc::ptr_eq(one, &built[0])));
        let other = store.classified(&pool.own_work(), &volume, made_from(0.6), false).await.unwrap();
        assert!(!Arc::ptr_eq(&other, &built[0]));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_build_outlives_the_client_that_began_it() {
        let (store, pool, volume) = (store(1 << 30), pool(), ball(8.0));
        let ticket = pool.own_work();
        let first = store.classified(&ticket, &volume, made_from(0.5), false);
        // Polled once, which hands the build over, and dropped (unless the build was done at once).
        let _ = tokio::time::timeout(Duration::ZERO, first).await;
        while store.cache_size().await.0 == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn the_least_recently_used_go_when_the_bytes_are_used_up() {
        let (pool, volume) = (pool(), ball(8.0));
        let one = {
            let store = store(1 << 30);
            store.classified(&pool.own_work(), &volume, made_from(0.5), false).await.unwrap();
            store.cache_size().await.1
        };
        let store = store(3 * one + one / 2);
        for opacity in [0.50, 0.51, 0.52, 0.53, 0.54, 0.55] {
            store.classified(&pool.own_work(), &volume, made_from(opacity), false).await.unwrap();
            assert!(store.cache_size().await.1 <= 3 * one + one / 2);
        }
        assert_eq!(store.cache_size().await.0, 3);
        let newest = made_from(0.55).name(&volume);
        assert!(store.classified.get(&newest).await.is_some());
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
