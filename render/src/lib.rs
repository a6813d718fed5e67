//! Differentiable rendering of one object of known shape under distant light and unseen occluders.

pub mod camera;
pub mod image;
pub mod mesh;
