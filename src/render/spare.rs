//! Memory that frames leave for those that follow.

use std::sync::{Mutex, PoisonError};

/// Memory that is not needed any more, for the next frame. What the system gives anew costs a fault for every
/// page, which together took as long as a warp.
#[derive(Debug)]
pub struct Spare<T>(Mutex<Vec<Vec<T>>>);

impl<T> Spare<T> {
    /// So many are kept at most, of so many bytes.
    const COUNT: usize = 8;
    const BYTES: usize = 8 << 20;

    /// None yet.
    pub const fn none() -> Self {
        Self(Mutex::new(vec![]))
    }

    /// Some of it; what is in it is of another frame.
    pub fn take(&self) -> Vec<T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    /// Memory that is not needed any more.
    pub fn give(&self, pixels: Vec<T>) {
        let mut spare = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if pixels.capacity() * size_of::<T>() <= Self::BYTES && spare.len() < Self::COUNT {
            spare.push(pixels);
        }
    }
}
