//! Reconstruction of light, materials and unseen occluders from posed photographs.

pub mod capture;
pub mod checkpoint;
pub mod cli;
pub mod control;
pub mod criticism;
pub mod evaluate;
pub mod files;
pub mod image_io;
pub mod layout;
pub mod mesh_io;
pub mod output;
pub mod progress;
pub mod reconstruct;
pub mod reconstruction;
pub mod report;
pub mod settings;
pub mod synthesize;
