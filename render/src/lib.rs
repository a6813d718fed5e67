//! Differentiable rendering of one object of known shape under distant light and unseen occluders.

pub mod bsdf;
pub mod bvh;
pub mod camera;
pub mod convention;
pub mod environment;
pub mod estimator;
pub mod harmonics;
pub mod image;
pub mod lat_long;
pub mod loss;
pub mod maps;
pub mod materials;
pub mod math;
pub mod mesh;
pub mod occluder;
pub mod path;
pub mod pyramid;
pub mod radiance;
pub mod reference;
pub mod sampler;
pub mod transport;
pub mod visibility;
pub mod warp;
