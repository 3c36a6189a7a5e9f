//! # shearwarp: volume rendering by the shear-warp factorization
//!
//! The algorithm on one page. A viewing transformation is factored into a shear of the volume's
//! slices, a projection along the slices' normal, and a two-dimensional warp
//! (Lacroute and Levoy 1994, section 2):
//!
//! ```text
//! image_from_object = image_from_sheared (warp) * sheared_from_object (shear) * P (permutation)
//! ```
//!
//! 1. [`volume`]: bytes become a [`volume::Volume`], and once per volume its scanlines, min-max octree
//!    and histogram.
//! 2. [`classify`]: a volume and a [`classify::TransferFunction`] become run-length encoded
//!    scanlines, independent of the view.
//! 3. [`render`]: the encoded scanlines and a [`render::View`] become an [`render::Image`]:
//!    factorization, shading table, compositing of sheared slices into the intermediate image,
//!    warp.
//!    [`mesh`]es that stand in the volume end its rays (`render/raster.rs`).
//! 4. [`raycast`]: the same picture by the slow and plain way, the reference for the fast one.
//! 5. [`encode`]: an image becomes PNG, JPEG, WebP or raw bytes.
//! 6. `service` (feature `service`): HTTP over the above.
//!
//! ## Glossary
//! - *object space*: voxel indices. *Permuted*: `i, j, k` with `k` the principal viewing axis.
//! - *sheared space*: permuted object space in which every viewing ray is parallel to `k`.
//! - *intermediate image*: the projection of sheared space along `k`; pixels `u, v`.
//! - *final image*: what the client sees; pixels `x, y`.
//! - *extinction*: absorption per millimetre; *opacity*: `1 - exp(-extinction * length)`.
//! - transforms are named `destination_from_source`.
//!
//! ## Bibliography
//! - P. Lacroute, M. Levoy: Fast Volume Rendering Using a Shear-Warp Factorization of the Viewing
//!   Transformation. SIGGRAPH 1994.
//! - J. P. Schulze, M. Kraus, U. Lang, T. Ertl: Integrating Pre-Integration into the Shear-Warp
//!   Algorithm. Volume Graphics 2003.
//! - H. Kye, H. Hong, Y. G. Shin: Efficient Interactive Pre-integrated Volume Rendering. ICCS 2005.
//! - S. Bruckner, D. Schmalstieg, H. Hauser, M. E. Gröller: The Inverse Warp: Non-invasive
//!   Integration of Shear-Warp Volume Rendering into Polygon Rendering Pipelines. VMV 2003.
//! - M. Kraus, K. Bürger: Interpolating and Downsampling RGBA Volume Data. VMV 2008.

pub mod classify;
pub mod encode;
pub mod mesh;
pub mod raycast;
pub mod render;
#[cfg(feature = "service")]
pub mod service;
mod simd;
pub mod volume;
