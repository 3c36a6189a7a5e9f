//! Frames against closed forms, against slow twins bit for bit, and against each other.

mod clip;
mod closed_form;
mod colors;
mod depth;
mod draft;
mod equivalence;
mod golden;
mod invariance;
mod labels;
mod layering;
mod meshes;
mod perspective;
mod projections;
mod ramp;
mod regions;
mod scenes;
mod shadows;
mod shear_image;
mod slabs;
mod unwarped;
