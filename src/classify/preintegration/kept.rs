//! Tables made so far: the most recently used ones, as many as a number of bytes allows.
//!
//! A turn-around asks for slabs of many lengths and for each of them again in the next turn. A table is
//! made without a lock: two frames that want the same one at once make it twice, which costs less than
//! a thread of the pool that waits for the other, and might wait for itself.

use std::sync::{Arc, Mutex, MutexGuard};

/// Values by key.
#[derive(Debug)]
pub struct Kept<K, T> {
    /// The least recently used one first.
    entries: Mutex<Vec<(K, Arc<T>)>>,
    /// Bytes of a value.
    size: fn(&T) -> u64,
    /// Bytes of all values at most, as long as there is more than one.
    limit: u64,
}

impl<K: Copy + PartialEq, T> Kept<K, T> {
    /// Nothing yet.
    pub fn new(limit: u64, size: fn(&T) -> u64) -> Self {
        Self { entries: Mutex::default(), size, limit }
    }

    /// The value for `key`, from `make` if it is not there.
    pub fn get(&self, key: K, make: impl FnOnce() -> T) -> Arc<T> {
        if let Some(value) = self.touch(key) {
            return value;
        }
        let value = Arc::new(make());
        let mut entries = self.lock();
        if let Some((_, other)) = entries.iter().find(|(other, _)| *other == key) {
            return Arc::clone(other);
        }
        entries.push((key, Arc::clone(&value)));
        let mut bytes: u64 = entries.iter().map(|(_, value)| (self.size)(value)).sum();
        while bytes > self.limit && entries.len() > 1 {
            bytes -= (self.size)(&entries.remove(0).1);
        }
        value
    }

    /// The value for `key`, which is now the most recently used.
    fn touch(&self, key: K) -> Option<Arc<T>> {
        let mut entries = self.lock();
        let at = entries.iter().position(|(other, _)| *other == key)?;
        entries[at..].rotate_left(1);
        entries.last().map(|(_, value)| Arc::clone(value))
    }

    /// Bytes of all values.
    pub fn bytes(&self) -> u64 {
        self.lock().iter().map(|(_, value)| (self.size)(value)).sum()
    }

    fn lock(&self) -> MutexGuard<'_, Vec<(K, Arc<T>)>> {
        self.entries.lock().expect("nothing panics while it is held")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_recently_used_goes_first_and_the_bytes_stay_below_the_limit() {
        let kept = Kept::new(30, |_: &u32| 10);
        for key in [1, 2, 3, 1, 4] {
            kept.get(key, || key);
            assert!(kept.bytes() <= 30);
        }
        let made = |key| {
            let mut made = false;
            kept.get(key, || {
                made = true;
                key
            });
            made
        };
        assert!([1, 3, 4].into_iter().all(|key| !made(key)));
        assert!(made(2));
    }

    #[test]
    fn one_value_is_kept_however_large() {
        let kept = Kept::new(30, |_: &u32| 100);
        let first = kept.get(1, || 1);
        assert!(Arc::ptr_eq(&first, &kept.get(1, || 1)));
    }

    #[test]
    fn a_value_made_meanwhile_by_another_is_shared() {
        let kept = Kept::new(30, |_: &u32| 10);
        let outer = kept.get(1, || {
            kept.get(1, || 7);
            8
        });
        assert_eq!(*outer, 7);
        assert_eq!(kept.bytes(), 10);
    }
}
