//! The image-order renderer: the reference, slow and plain.
