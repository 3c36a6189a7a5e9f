//! HTTP over the library; the only folder that knows tokio.

pub mod request;
