//! Threads that wait for a frame's next stage without going to sleep.
//!
//! A worker of rayon that finds nothing to do sleeps after some ten microseconds, and to wake it takes up to a tenth of a millisecond:
//! a tenth of a short frame, at each of its stages. So a frame asks the pool's other threads to look for work a little longer.

use std::cell::Cell;
use std::hint;
use std::time::{Duration, Instant};

use rayon::Yield;

/// How long a thread without work goes on looking: longer than what a short frame does by one thread alone between two stages.
const PATIENCE: Duration = Duration::from_micros(150);

thread_local! {
    /// Whether this thread makes a frame, or looks for work already: it has something to go back to.
    static BUSY: Cell<bool> = const { Cell::new(false) };
}

/// While there is one, its thread makes a frame.
pub struct Frame {
    was_busy: bool,
}

impl Frame {
    /// Wakes the other threads of the current rayon pool. They do whatever jobs there are, as ever, and go to sleep some time after the last.
    pub fn begin() -> Self {
        let frame = Self { was_busy: BUSY.replace(true) };
        if let (Some(own), 2..) = (rayon::current_thread_index(), rayon::current_num_threads()) {
            rayon::spawn_broadcast(move |thread| {
                if thread.index() != own {
                    look_for_work();
                }
            });
        }
        frame
    }
}

impl Drop for Frame {
    fn drop(&mut self) {
        BUSY.set(self.was_busy);
    }
}

/// Does what there is to do until for a while there is nothing; at once where this thread waits for something.
fn look_for_work() {
    if BUSY.replace(true) {
        return;
    }
    let mut worked = Instant::now();
    while worked.elapsed() < PATIENCE {
        if rayon::yield_now() == Some(Yield::Executed) {
            worked = Instant::now();
        } else {
            hint::spin_loop();
        }
    }
    BUSY.set(false);
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn frames_on_all_threads_of_a_pool_wait_for_none_of_the_others() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let frame = || {
            let _frame = Frame::begin();
            (0..2000u64).into_par_iter().map(|n| n % 7).sum::<u64>()
        };
        let sums = pool.broadcast(|_| {
            let before = BUSY.get();
            let sums: Vec<_> = (0..100).map(|_| frame()).collect();
            assert_eq!(BUSY.get(), before, "a frame's thread is what it was, once the frame is made");
            sums
        });
        let sum: u64 = (0..2000).map(|n| n % 7).sum();
        assert_eq!(sums, vec![vec![sum; 100]; 3]);
    }
}
