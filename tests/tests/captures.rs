//! Captures: read in every format, checked, refused with reasons, inspected.

mod capture_collections;
mod capture_colmap;
mod capture_disagreement;
mod capture_errors;
mod capture_errors_of_files;
mod capture_formats;
mod capture_frames;
mod capture_gltf;
mod capture_images;
mod capture_load;
mod capture_meshes;
mod capture_photographs;
mod capture_reading;
mod inspect;
