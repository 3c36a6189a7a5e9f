//! Generated volumes: the built-in head, and analytic phantoms for tests and benches.

mod analytic;
mod random;

pub use analytic::{ball, cube, from_fn, noise, ramp, uniform};
mod head;
mod shape;
pub use head::head;
