//! The service over real sockets: one binary, one running service a test.

mod cache_folder;
mod colors;
mod contract;
mod encodings;
mod errors;
mod frames;
mod labels;
mod meshes;
mod overload;
mod scene;
mod service;
mod shadows;
mod shutdown;
mod stream;
mod turntable;
mod viewer;
mod volumes;
