//! Differentiable rendering of one object of known shape under distant light and unseen occluders.
//!
//! The physics is in [`bsdf`], [`environment`], [`occluder`]; the object in [`mesh`] and [`bvh`]; light is found by sampling
//! ([`path`], [`estimator`], [`loss`]: the paper's Eqs. 3–9 on the tape) or by quadrature ([`transport`], [`reference`](mod@reference)).
//!
//! # A short tour
//!
//! A matt tetrahedron in a white furnace reflects what falls on it, times its albedo:
//!
//! ```
//! use glam::Vec3;
//! use render::{
//!     bsdf::{Material, Model}, bvh::Bvh, camera::Camera, environment::EnvironmentMap, image::Image,
//!     mesh::Mesh, reference::Reference,
//! };
//!
//! let corners = [Vec3::ONE, Vec3::new(1.0, -1.0, -1.0), Vec3::new(-1.0, 1.0, -1.0), Vec3::new(-1.0, -1.0, 1.0)];
//! let mut mesh = Mesh::default();
//! for face in [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]] {
//!     let corners = face.map(|i| corners[i]);
//!     let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
//!     let first = mesh.positions.len() as u32;
//!     mesh.positions.extend(corners);
//!     mesh.normals.extend([normal; 3]);
//!     mesh.faces.push([first, first + 1, first + 2]);
//! }
//! let bvh = Bvh::new(&mesh)?;
//! let white = EnvironmentMap::new(Image::filled(64, 32, 3, 1.0))?;
//! let camera = Camera::look_at(9, 9, 0.6, Vec3::new(2.0, -5.0, 1.0), Vec3::ZERO);
//! let matt = Material { albedo: [0.6, 0.4, 0.2], alpha: 0.5, kappa: 0.0 };
//!
//! let middle = Reference::new(&bvh, &white, Model::Lambertian, 2).pixel(&camera, [4, 4], None, |_| matt);
//! assert_eq!(middle[3], 1.0); // the object covers the pixel
//! for (found, albedo) in middle.iter().zip(matt.albedo) {
//!     assert!((found - albedo).abs() < 0.02, "{found} {albedo}");
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # How fast it is
//!
//! `cargo run --release -p render --example rates` measures it. On an Ice Lake at 2.8 GHz, each core, a bumpy ball of 160,000
//! triangles, 1024 rays a render of a pixel, half of them towards the light: an iteration (paths, loss, gradients of all unknowns)
//! draws 4.1 million samples a second where shadows are cast and 10 million where they are looked up, of a matt surface; 3.7 and
//! 8.6 million of a glossy one. With two threads each does .9 of that. Shadow rays of one point, seventh by seventh texel of a grid:
//! 3.5 million a second in packets ([`bvh::Bvh::close_blocked`]), 2.0 million one by one.

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
