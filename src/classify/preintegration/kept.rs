//! The newest tables, for another frame of the same view or of one whose slabs are as long.
//!
//! A client that turns a volume asks for another length with every frame, and comes back to it: turning by four degrees meets two dozen of them, over
//! and over. One is made without a lock. Two
//! frames that want the same at once both make it, which costs less than a thread of the pool that
//! waits for another, and might wait for itself.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

/// So many values by key.
#[derive(Debug)]
pub struct Kept<K, T, const COUNT: usize> {
    /// The oldest one first.
    newest: Mutex<VecDeque<(K, Arc<T>)>>,
}

impl<K: Copy + PartialEq, T, const COUNT: usize> Kept<K, T, COUNT> {
    /// Nothing yet.
    pub fn new() -> Self {
        Self { newest: Mutex::default() }
    }

    /// The value for `key`, from `make` if it is not there.
    pub fn get(&self, key: K, make: impl FnOnce() -> T) -> Arc<T> {
        let find = |newest: &VecDeque<(K, Arc<T>)>| {
            newest.iter().find(|(kept, _)| *kept == key).map(|(_, value)| Arc::clone(value))
        };
        let there = find(&self.lock());
        there.unwrap_or_else(|| {
            let value = Arc::new(make());
            let mut newest = self.lock();
            find(&newest).unwrap_or_else(|| {
                if newest.len() == COUNT {
                    newest.pop_front();
                }
                newest.push_back((key, Arc::clone(&value)));
                value
            })
        })
    }

    /// Held for look-ups alone, never while a value is made.
    fn lock(&self) -> MutexGuard<'_, VecDeque<(K, Arc<T>)>> {
        self.newest.lock().expect("no panic while it is held")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_are_kept_and_no_more() {
        let kept = Kept::<_, _, 4>::new();
        let made: Vec<_> = (0..10).map(|key| kept.get(key, || key)).collect();
        for key in (0..10).rev().take(4) {
            assert!(Arc::ptr_eq(&made[key], &kept.get(key, || unreachable!("kept"))));
        }
        assert_eq!(kept.lock().len(), 4);
        assert!(!Arc::ptr_eq(&made[0], &kept.get(0, || 0)), "made anew");
    }

    #[test]
    fn a_value_made_meanwhile_by_another_is_shared() {
        let kept = Kept::<_, _, 4>::new();
        let outer = kept.get(1, || {
            kept.get(1, || 7);
            8
        });
        assert_eq!(*outer, 7);
        assert_eq!(kept.lock().len(), 1);
    }
}
