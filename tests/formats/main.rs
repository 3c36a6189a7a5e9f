//! Volume files of every format, written here byte by byte, and what becomes of them.

mod files;
mod hostile;
mod meshes;
mod metaimage;
mod nifti;
mod nrrd;
mod raw;
mod scans;
