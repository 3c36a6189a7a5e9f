//! Generated volumes: the built-in head, and analytic phantoms for tests and benches.
