//! [`Image`](crate::render::Image) -> bytes of a file format.
