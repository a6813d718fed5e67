//! Which file of a run's folder holds what.

/// The environment map.
pub const ENVIRONMENT: &str = "environment.exr";
/// The same for viewers of Radiance files.
pub const RADIANCE: &str = "environment.hdr";
/// The material network that a run of the paper preset leaves.
pub const NETWORK: &str = "materials.safetensors";
/// The folder of the occluders' masks, one image a frame.
pub const OCCLUDERS: &str = "occluders";
/// Standard deviations of the environment map.
pub const ENVIRONMENT_SD: &str = "environment_sd.exr";
/// The folder of standard deviations of the masks.
pub const OCCLUDERS_SD: &str = "occluders_sd";
/// The folder of standard deviations of the albedo, one image a camera.
pub const ALBEDO_SD: &str = "albedo_sd";
/// The folder of material images, one a camera.
pub const MATERIALS: &str = "materials";
/// The folder of rendered photographs.
pub const RENDERS: &str = "renders";
/// The folder of a diagnosis's residuals.
pub const MAPS: &str = "maps";
/// Numbers of the run.
pub const METRICS: &str = "metrics.json";
/// Options of the run.
pub const SETTINGS: &str = "settings.json";
/// The page to look at.
pub const REPORT: &str = "report.html";
/// The object with baked materials.
pub const MESH: &str = "mesh.glb";
/// Channels of a material image, in the order of [`crate::reconstruction::Reconstruction::materials`].
pub const MATERIAL_CHANNELS: [&str; 5] = ["R", "G", "B", "alpha", "kappa"];
/// The text attribute of a map that names its [`render::convention::Convention`].
pub const CONVENTION: &str = "eclipse.convention";

/// The name of the image of frame `index`.
pub fn numbered(index: usize) -> String {
    format!("{index:03}.exr")
}
