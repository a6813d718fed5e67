//! Reconstruction of light, materials and unseen occluders from posed photographs.

pub mod capture;
