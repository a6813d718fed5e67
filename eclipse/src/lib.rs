//! Reconstruction of light, materials and unseen occluders from posed photographs.
//!
//! Data flow one way: [`capture`] → [`reconstruct`] → [`reconstruction`] → [`criticism`] → [`joint`] → [`report`] and [`output`]; [`cli`] is the
//! program around them. New here? [`guide`] is a short book.
//!
//! # A short tour
//!
//! Make a capture, take it apart, and compare with what it was made of (a few steps on a tiny capture: no more than a
//! demonstration):
//!
//! ```
//! use eclipse::{
//!     control::Control, evaluate::environment, reconstruct, settings::Settings,
//!     synthesize::{Occluders, Pattern, Scene, Shooting, synthesize},
//! };
//! use glam::Vec3;
//! use render::{bsdf::Model, image::Image, mesh::Mesh};
//!
//! let corners = [Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
//! let mesh = Mesh {
//!     positions: corners.to_vec(),
//!     normals: corners.to_vec(),
//!     faces: [0, 1, 2, 3].into_iter().flat_map(|k| [[k, (k + 1) % 4, 4], [(k + 1) % 4, k, 5]]).collect(),
//!     ..Mesh::default()
//! };
//! let mut light = Image::filled(100, 50, 3, 0.3);
//! light.data[3 * 1220..][..60].fill(6.0); // a lamp
//! let scene = Scene {
//!     mesh,
//!     environment: light.clone(),
//!     model: Model::Lambertian,
//!     albedo: Pattern { mean: [0.5; 3], variation: 0.1 },
//!     alpha: 0.5,
//!     kappa: 0.0,
//!     occluders: Occluders::Operator,
//! };
//! let shooting = Shooting { frames: 8, resolution: 24, distance: 4.0, noise: 0.002, seed: 1 };
//! let made = synthesize(&scene, &shooting, |_| true)?;
//!
//! let settings = Settings { lambertian: true, iterations: Some(2), time_limit: None, ..Settings::default() };
//! let found = reconstruct::run(&made.capture, &settings, &Control::detached())?;
//! assert_eq!(found.renders.len(), 8);
//! let score = environment::compare(&found.environment, &light).score;
//! assert!(score.texels.relative_rmse_aligned.unwrap() < 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod capture;
pub mod checkpoint;
pub mod cli;
pub mod control;
pub mod criticism;
pub mod evaluate;
pub mod export;
pub mod files;
pub mod guide;
pub mod image_io;
pub mod inspect;
pub mod joint;
pub mod layout;
pub mod mesh_io;
pub mod output;
pub mod progress;
pub mod reconstruct;
pub mod reconstruction;
pub mod relight;
pub mod report;
pub mod settings;
pub mod studies;
pub mod synthesize;
pub mod wording;
