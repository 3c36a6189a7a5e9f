//! What is classified, in memory.
//!
//! It depends on a transfer function that a client may send anew with every request, so it is cached:
//! weighed in bytes, the least recently used go first.
//!
//! A frame needs a classification, which takes milliseconds. Requests that need the same one at the
//! same time share one build, which belongs to none of them: it runs on to its end in a task of its
//! own, on the place in the queue of the request that began it, for a client that leaves would
//! otherwise take the work of all who wait with it.
//!
//! Encodings make frames faster and change no bit, so no frame waits for them ("switch modes", Lacroute
//! and Levoy 1994, section 3.3). They are built behind the frames' backs:
//!
//! - only for what was asked for again, since whoever drags a control point sends a transfer function
//!   for every frame and comes back to none of them;
//! - one at a time, and only if they would fit into the cache, which bounds the memory of what is in
//!   the making. How much it may come to is known beforehand, from the leaves of the octree.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use moka::future::Cache;
use moka::policy::EvictionPolicy;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::cache_folder::CacheFolder;
use super::metrics;
use super::render_pool::{PoolError, RenderPool, Ticket};
use super::request::{Look, ResolvedLabels, ResolvedShadows};
use super::store::LoadedVolume;
use crate::classify::labels::LabelTables;
use crate::classify::{Classification, Encodings, Purpose, TransferFunction};
use crate::render::Cancel;
use crate::render::shadow::Shadow;

/// Share of the cache that is for labels' tables.
const LABELS_SHARE: u64 = 16;
/// For classifications in sixteenths: two bits for each voxel.
const CLASSIFICATIONS_SIXTEENTHS: u64 = 5;
/// And for shadows, a byte for each voxel.
const SHADOWS_SHARE: u64 = 8;

/// What a classified volume is made from, besides the volume.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassifiedKey {
    /// Level of the volume's pyramid.
    pub level: usize,
    pub transfer: TransferFunction,
    pub purpose: Purpose,
}

impl ClassifiedKey {
    /// What a look needs; `None`: nothing classified.
    pub fn of(look: &Look) -> Option<Self> {
        look.purpose().map(|purpose| Self { level: look.level, transfer: look.transfer.clone(), purpose })
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

/// A classification, and what decides whether it gets encodings.
#[derive(Debug)]
struct Asked {
    classification: Arc<Classification>,
    /// What they may take in memory.
    encoding_bytes: u64,
    times: AtomicU32,
}

/// What was classified, by what it is made from. Clones share it.
#[derive(Clone, Debug)]
pub struct ClassifiedCache {
    classifications: Cache<Arc<str>, Arc<Asked>>,
    labels: Cache<Arc<str>, Arc<LabelTables>>,
    encodings: Cache<Arc<str>, Arc<Encodings>>,
    shadows: Cache<Arc<str>, Arc<Shadow>>,
    /// Bytes of all encodings at most, and of all shadows.
    room: u64,
    shadows_room: u64,
    /// Held by the build in flight.
    turn: Arc<Semaphore>,
    /// What the build in flight may take in memory.
    building_bytes: Arc<AtomicU64>,
    folder: Option<CacheFolder>,
}

/// What the caches hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CacheSize {
    /// Encodings.
    pub encodings: u64,
    pub encoding_bytes: u64,
    /// Of labels' tables too.
    pub classification_bytes: u64,
    pub shadow_bytes: u64,
    /// Encodings in the making: 0 or 1, and what they may come to.
    pub building: usize,
    pub building_bytes: u64,
}

impl ClassifiedCache {
    /// An empty cache for `bytes` of classifications and encodings at most; encodings may be kept in
    /// `folder` too.
    pub fn new(bytes: u64, folder: Option<CacheFolder>) -> Self {
        let for_labels = bytes / LABELS_SHARE;
        let for_classifications = bytes / 16 * CLASSIFICATIONS_SIXTEENTHS;
        let shadows_room = bytes / SHADOWS_SHARE;
        let room = bytes - for_labels - for_classifications - shadows_room;
        let classifications = Cache::builder()
            .weigher(|key: &Arc<str>, asked: &Arc<Asked>| kib(key.len() as u64 + asked.classification.bytes()))
            .max_capacity(for_classifications / 1024)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let labels = Cache::builder()
            .weigher(|key: &Arc<str>, tables: &Arc<LabelTables>| kib(key.len() as u64 + tables.bytes()))
            .max_capacity(for_labels / 1024)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let encodings = Cache::builder()
            .weigher(|key: &Arc<str>, encodings: &Arc<Encodings>| kib(key.len() as u64 + encodings.bytes()))
            .max_capacity(room / 1024)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let shadows = Cache::builder()
            .weigher(|key: &Arc<str>, shadow: &Arc<Shadow>| kib((key.len() + shadow.lacking().len()) as u64))
            .max_capacity(shadows_room / 1024)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let (turn, building_bytes) = (Arc::new(Semaphore::new(1)), Arc::default());
        Self { classifications, labels, encodings, shadows, room, shadows_room, turn, building_bytes, folder }
    }

    /// What is in memory, and in the making.
    pub async fn size(&self) -> CacheSize {
        self.encodings.run_pending_tasks().await;
        self.classifications.run_pending_tasks().await;
        self.labels.run_pending_tasks().await;
        self.shadows.run_pending_tasks().await;
        CacheSize {
            encodings: self.encodings.entry_count(),
            encoding_bytes: self.encodings.weighted_size() * 1024,
            classification_bytes: (self.classifications.weighted_size() + self.labels.weighted_size()) * 1024,
            shadow_bytes: self.shadows.weighted_size() * 1024,
            building: 1 - self.turn.available_permits().min(1),
            building_bytes: self.building_bytes.load(Ordering::Relaxed),
        }
    }

    /// What a frame walks: the classification, from memory or built by a job of `ticket`; and, if
    /// `encoded`, the encodings, where they are in memory. Where they are not, and the same is asked for
    /// again, they are built behind the frame's back.
    ///
    /// # Errors
    /// Where the classification's build panicked.
    pub async fn get(
        &self,
        ticket: &Ticket,
        volume: &Arc<LoadedVolume>,
        made_from: ClassifiedKey,
        encoded: bool,
    ) -> Result<Classified, PoolError> {
        let key = made_from.name(volume);
        let asked = self.classification(ticket, volume, &made_from, &key).await?;
        if !encoded {
            return Ok(Classified { classification: Arc::clone(&asked.classification), encodings: None });
        }
        let encodings = self.encodings.get(&key).await;
        metrics::encodings(encodings.is_some());
        let again = asked.times.fetch_add(1, Ordering::Relaxed) > 0;
        if encodings.is_none()
            && again
            && let Some(building) = self.begin(asked.encoding_bytes)
        {
            self.build_behind(ticket.pool().clone(), volume, made_from, key, &asked, building);
        }
        Ok(Classified { classification: Arc::clone(&asked.classification), encodings })
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
        if asked.encoding_bytes > self.room {
            tracing::warn!(
                bytes = asked.encoding_bytes,
                "no encodings: the cache may not hold them; frames are slower"
            );
            return Ok(());
        }
        let job = self.encode(volume, made_from, &key, &asked, true);
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
                let prepared = volume.level(*level);
                let classification = Classification::build(prepared, transfer, *purpose);
                let encoding_bytes = Encodings::bytes_at_most(prepared, &classification);
                let times = AtomicU32::new(0);
                Arc::new(Asked { classification: Arc::new(classification), encoding_bytes, times })
            };
            cache.try_get_with(key, async move { ticket.run(move |_| job()).await.map(|(built, _)| built) }).await
        });
        build.await.map_err(|_| PoolError::Panicked)?.map_err(|shared| PoolError::clone(&shared))
    }

    /// The tables of the voxels of a `level` of `volume` by the labels that another one holds, from memory or made by a job of `ticket`.
    ///
    /// # Errors
    /// Where making them panicked.
    pub async fn labels(
        &self,
        ticket: &Ticket,
        volume: &Arc<LoadedVolume>,
        level: usize,
        labels: &Arc<LoadedVolume>,
        told: &ResolvedLabels,
    ) -> Result<Arc<LabelTables>, PoolError> {
        let key = format!("{:032x} {level} {:032x} {told:?}", volume.fingerprint, labels.fingerprint).into();
        let (volume, labels, told) = (Arc::clone(volume), Arc::clone(labels), told.clone());
        let job = move |_: &Cancel| Arc::new(told.tables(volume.level(level).volume(), labels.volume()));
        let made = self.labels.try_get_with(key, async move { ticket.run(job).await.map(|(tables, _)| tables) }).await;
        made.map_err(|shared| PoolError::clone(&shared))
    }

    /// Bytes that the shadows on a volume may take.
    pub fn shadows_room(&self) -> u64 {
        self.shadows_room
    }

    /// The shadows that what a look shows of a volume casts on itself, from memory or made by a job of `ticket`. `labels` are
    /// those by which it looks otherwise.
    ///
    /// # Errors
    /// Where making them panicked.
    pub async fn shadows(
        &self,
        ticket: &Ticket,
        volume: &Arc<LoadedVolume>,
        look: &Look,
        labels: Option<(&Arc<LoadedVolume>, &ResolvedLabels, &Arc<LabelTables>)>,
        told: &ResolvedShadows,
    ) -> Result<Arc<Shadow>, PoolError> {
        // The same for all algorithms.
        let purpose = Purpose::Voxels { min_opacity: 0.0 };
        let made_from = ClassifiedKey { level: look.level, transfer: look.transfer.clone(), purpose };
        let by_label = labels.map(|(labels, told, _)| (labels.fingerprint, told));
        let key = format!("{} {by_label:?} {told:?}", made_from.name(volume)).into();
        let (volume, told) = (Arc::clone(volume), told.clone());
        let labels = labels.map(|(labels, _, tables)| (Arc::clone(labels), Arc::clone(tables)));
        let job = move |_: &Cancel| {
            let labels = labels.as_ref().map(|(labels, tables)| tables.of(labels.volume()));
            told.cast(volume.level(made_from.level), &made_from.transfer, labels)
        };
        let made =
            self.shadows.try_get_with(key, async move { ticket.run(job).await.map(|(shadow, _)| Arc::new(shadow)) });
        made.await.map_err(|shared| PoolError::clone(&shared))
    }

    /// The turn to build encodings of so many bytes; `None` where another build has it, or where they
    /// may not fit.
    fn begin(&self, bytes: u64) -> Option<Building> {
        if bytes > self.room {
            metrics::encodings_too_large();
            return None;
        }
        let turn = Arc::clone(&self.turn).try_acquire_owned().ok()?;
        self.building_bytes.store(bytes, Ordering::Relaxed);
        Some(Building { bytes: Arc::clone(&self.building_bytes), _turn: turn })
    }

    fn build_behind(
        &self,
        pool: RenderPool,
        volume: &Arc<LoadedVolume>,
        made_from: ClassifiedKey,
        key: Arc<str>,
        asked: &Asked,
        building: Building,
    ) {
        let job = self.encode(volume, made_from, &key, asked, false);
        let cache = self.encodings.clone();
        tokio::spawn(async move {
            // A panic was counted; the next frame that asks tries again.
            if let Ok(encodings) = pool.run_behind(job).await {
                cache.insert(key, encodings).await;
            }
            drop(building);
        });
    }

    /// A job that gives encodings: from the folder or built, on the current rayon pool. `keep` writes
    /// built ones to the folder.
    fn encode(
        &self,
        volume: &Arc<LoadedVolume>,
        made_from: ClassifiedKey,
        key: &Arc<str>,
        asked: &Asked,
        keep: bool,
    ) -> impl FnOnce() -> Arc<Encodings> + use<> {
        let (key, volume, classification, folder) =
            (Arc::clone(key), Arc::clone(volume), Arc::clone(&asked.classification), self.folder.clone());
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

/// The turn of the build in flight; with it goes what it was counted for.
struct Building {
    bytes: Arc<AtomicU64>,
    _turn: OwnedSemaphorePermit,
}

impl Drop for Building {
    fn drop(&mut self) {
        self.bytes.store(0, Ordering::Relaxed);
    }
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

    fn cache(bytes: u64) -> ClassifiedCache {
        ClassifiedCache::new(bytes, None)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn requests_at_the_same_time_share_one_build() {
        let (cache, pool, volume) = (cache(1 << 30), pool(), ball(8.0));
        let requests = (0..20).map(|_| {
            let (cache, volume, ticket) = (cache.clone(), Arc::clone(&volume), pool.admit().unwrap());
            tokio::spawn(async move { cache.get(&ticket, &volume, made_from(0.5), true).await.unwrap() })
        });
        let mut built = vec![];
        for request in requests.collect::<Vec<_>>() {
            built.push(request.await.unwrap());
        }
        assert!(built.iter().all(|one| Arc::ptr_eq(&one.classification, &built[0].classification)));
        let other = cache.get(&pool.own_work(), &volume, made_from(0.6), true).await.unwrap();
        assert!(!Arc::ptr_eq(&other.classification, &built[0].classification));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_build_outlives_the_client_that_began_it() {
        let (cache, pool, volume) = (cache(1 << 30), pool(), ball(8.0));
        let ticket = pool.own_work();
        let first = cache.get(&ticket, &volume, made_from(0.5), true);
        // Polled once, which hands the build over, and dropped (unless the build was done at once).
        let _ = tokio::time::timeout(Duration::ZERO, first).await;
        while cache.size().await.classification_bytes == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn encodings_come_for_what_is_asked_for_again_and_nobody_waits_for_them() {
        let (cache, pool, volume) = (cache(1 << 30), pool(), ball(8.0));
        let ticket = pool.own_work();
        let ask = || cache.get(&ticket, &volume, made_from(0.5), true);
        assert!(ask().await.unwrap().encodings.is_none());
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert_eq!(cache.size().await.encodings, 0, "asked for once");
        assert!(ask().await.unwrap().encodings.is_none());
        while cache.size().await.encodings == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert!(ask().await.unwrap().encodings.is_some());
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn the_least_recently_used_go_when_the_bytes_are_used_up() {
        // Nearly filled, so that its encodings take nearly what they may take.
        let (pool, volume) = (pool(), ball(14.0));
        let warm = async |cache: &ClassifiedCache, opacity| {
            cache.warm_up(&pool.own_work(), &volume, made_from(opacity)).await.unwrap();
            cache.size().await
        };
        let one = warm(&cache(1 << 30), 0.5).await.encoding_bytes;
        // Half of the bytes are for encodings: room for twelve, and for what one may take at most.
        let room = 12 * one + one / 2;
        let cache = cache(room * 2);
        for step in 0..=15 {
            assert!(warm(&cache, 0.55 - f64::from(15 - step) / 300.0).await.encoding_bytes <= room);
        }
        assert_eq!(cache.size().await.encodings, 12);
        assert!(cache.encodings.get(&made_from(0.55).name(&volume)).await.is_some());
        assert!(cache.encodings.get(&made_from(0.50).name(&volume)).await.is_none());
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn what_may_not_fit_is_not_built() {
        let (pool, volume) = (pool(), ball(8.0));
        let ticket = pool.own_work();
        let cache = cache(1 << 15);
        cache.warm_up(&ticket, &volume, made_from(0.5)).await.unwrap();
        for _ in 0..3 {
            cache.get(&ticket, &volume, made_from(0.5), true).await.unwrap();
            assert_eq!(cache.size().await.building, 0);
        }
        assert_eq!(cache.size().await.encodings, 0);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn one_build_is_in_flight_and_its_bytes_are_counted() {
        let (cache, pool, volume) = (cache(1 << 30), pool(), ball(8.0));
        let ticket = pool.own_work();
        let building = cache.begin(12_345).unwrap();
        assert_eq!((cache.size().await.building, cache.size().await.building_bytes), (1, 12_345));
        for _ in 0..3 {
            assert!(
                cache.get(&ticket, &volume, made_from(0.5), true).await.unwrap().encodings.is_none(),
                "and nobody waits"
            );
        }
        drop(building);
        assert_eq!((cache.size().await.building, cache.size().await.building_bytes), (0, 0));
        cache.get(&ticket, &volume, made_from(0.5), true).await.unwrap();
        while cache.size().await.encodings == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    #[test]
    fn what_is_classified_is_named_by_all_that_it_is_made_from() {
        let volume = ball(8.0);
        let name = |made_from: ClassifiedKey| made_from.name(&volume);
        let slabs = ClassifiedKey { purpose: Purpose::Slabs { entries: 256 }, ..made_from(0.5) };
        assert_eq!(name(made_from(0.5)), name(made_from(0.5)));
        for other in [made_from(0.6), ClassifiedKey { level: 1, ..made_from(0.5) }, slabs] {
            assert_ne!(name(other), name(made_from(0.5)));
        }
        assert_ne!(made_from(0.5).name(&ball(7.0)), name(made_from(0.5)));
    }
}
