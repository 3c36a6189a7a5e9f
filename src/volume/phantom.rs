//! Generated volumes: the built-in head, and analytic phantoms for tests and benches.

mod analytic;
mod head;
mod random;
mod shape;

pub use analytic::{ball, cube, from_fn, noise, ramp, uniform};
pub use head::head;
