//! Captures made from a mesh, a material, an environment and occluders, with their truth beside them.
//!
//! Rendered by the reference renderer, 16 rays a pixel as the paper's S3; occluders are masks on a sphere through the
//! camera, as the model of Eq. 4–6 has them, people's on one that is a little larger.

mod albedo;
mod person;
mod seen;

use std::path::Path;

use glam::Vec3;
use render::{
    bsdf::{Material, Model},
    bvh::{Bvh, SurfacePoint},
    camera::Camera,
    environment::{EnvironmentError, EnvironmentMap},
    image::Image,
    lat_long::LatLong,
    mesh::{Mesh, MeshError},
    reference::{Mask, Reference},
    sampler::SampleKey,
};
use serde_json::json;

use crate::{
    capture::{self, Capture, CaptureError, Frame},
    files::atomic,
    image_io::{ExrOptions, ImageIoError, write_exr, write_exr_with},
    layout::{CONVENTION, numbered},
};

pub use albedo::Pattern;
pub use seen::Seen;

/// Rays a pixel are the square of this.
const ANTIALIASING: usize = 4;
/// Rows of the grid on which light is integrated: each of its texels is met in 16 places a pixel.
const QUADRATURE_ROWS: usize = 25;
/// Rows of the masks.
const MASK_ROWS: usize = 50;
/// Where a person's mask lies, in distances of the camera: half a metre behind one that is held at 2.5 m.
pub(crate) const BEHIND: f32 = 1.2;
/// Margin around the object in the picture.
const MARGIN: f32 = 1.1;

/// What is photographed.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The object, in its own frame.
    pub mesh: Mesh,
    /// Radiance, RGB, in the convention of [`LatLong`].
    pub environment: Image,
    /// Reflectance model.
    pub model: Model,
    /// Albedo over the object.
    pub albedo: Pattern,
    /// Width of the specular lobe.
    pub alpha: f32,
    /// Specular reflectance at normal incidence.
    pub kappa: f32,
    /// What stands in the light.
    pub occluders: Occluders,
}

/// What stands between object and light while a photograph is taken.
#[derive(Clone, Debug, PartialEq)]
pub enum Occluders {
    /// Nothing.
    None,
    /// A person behind each camera.
    Operator,
    /// The same, so many times as tall and as wide.
    Person(f32),
    /// A transmittance map a frame.
    Masks(Vec<Image>),
}

/// How it is photographed.
#[derive(Clone, Debug, PartialEq)]
pub struct Shooting {
    /// Photographs, on a spiral around the object.
    pub frames: usize,
    /// Pixels across and down.
    pub resolution: usize,
    /// Distance of the cameras from the object's centre, in its bounding radii; more than 1.2.
    pub distance: f32,
    /// Sensor noise: its variance is noise² · (I + ¼), photon noise above a floor.
    pub noise: f32,
    /// Seed of the noise.
    pub seed: u64,
}

/// A capture with its truth.
#[derive(Clone, Debug)]
pub struct Synthesized {
    /// The photographs, in the recentred frame.
    pub capture: Capture,
    /// True masks, none when nothing stood in the light.
    pub occluders: Vec<Image>,
    /// True albedo through each camera.
    pub albedo: Vec<Image>,
}

/// Renders `scene`; `progress` hears of each frame and says whether to go on.
///
/// # Errors
/// A scene that cannot be rendered, or [`SynthesizeError::Stopped`].
pub fn synthesize(
    scene: &Scene,
    shooting: &Shooting,
    progress: impl Fn(usize) -> bool,
) -> Result<Synthesized, SynthesizeError> {
    synthesize_seen(scene, shooting, None, progress)
}

/// The same, with what an object's cameras have `seen` of it for the captures before this one, which spares most of the work; what
/// is missing is added.
///
/// # Errors
/// As [`synthesize`].
pub fn synthesize_seen(
    scene: &Scene,
    shooting: &Shooting,
    mut seen: Option<&mut Seen>,
    progress: impl Fn(usize) -> bool,
) -> Result<Synthesized, SynthesizeError> {
    if let Occluders::Masks(masks) = &scene.occluders
        && masks.len() != shooting.frames
    {
        return Err(SynthesizeError::Masks {
            found: masks.len(),
            frames: shooting.frames,
        });
    }
    let mut mesh = scene.mesh.clone();
    mesh.ensure_normals();
    mesh.validate()?;
    let [low, high] = mesh.bounds();
    let centre = 0.5 * low + 0.5 * high;
    mesh.positions
        .iter_mut()
        .for_each(|position| *position -= centre);
    let radius = mesh.bounding_radius();
    let bvh = Bvh::new(&mesh)?;
    let environment = EnvironmentMap::new(scene.environment.clone())?;
    let grid = LatLong::new(QUADRATURE_ROWS, 2 * QUADRATURE_ROWS);
    let reference = Reference::with_radiance(
        &bvh,
        grid,
        |d| environment.radiance(d),
        scene.model,
        ANTIALIASING,
    );
    let masks = LatLong::new(MASK_ROWS, 2 * MASK_ROWS);
    let albedo = |position: Vec3| scene.albedo.at(position / radius);
    if let Some(seen) = &mut seen {
        seen.forget_others(&mesh, shooting);
    }

    let (mut frames, mut occluders, mut albedos) = (Vec::new(), Vec::new(), Vec::new());
    for index in 0..shooting.frames {
        if !progress(index) {
            return Err(SynthesizeError::Stopped);
        }
        let camera = camera(shooting, index, radius);
        let behind = match &scene.occluders {
            Occluders::Operator | Occluders::Person(_) => BEHIND,
            Occluders::None | Occluders::Masks(_) => 1.0,
        };
        let mask = match &scene.occluders {
            Occluders::None => None,
            Occluders::Operator => Some(person::mask(camera.centre(), masks, 1.0)),
            Occluders::Person(size) => Some(person::mask(camera.centre(), masks, *size)),
            Occluders::Masks(masks) => Some(masks[index].clone()),
        };
        let shell = mask.as_ref().map(|transmittance| Mask {
            transmittance,
            radius: behind * camera.distance(),
        });
        let material = |point: &SurfacePoint| Material {
            albedo: albedo(point.position),
            alpha: scene.alpha,
            kappa: scene.kappa,
        };
        let rendered = match &mut seen {
            None => reference.frame(&camera, shell, material),
            Some(seen) => {
                let looks = seen.of(index, || reference.look(&camera));
                reference.frame_of(looks, shell, material)
            }
        };
        frames.push(photograph(&rendered, camera.clone(), shooting, index));
        albedos.push(albedo::through(&bvh, &camera, ANTIALIASING, albedo));
        occluders.extend(mask);
    }
    let capture = Capture {
        lamps: None,
        path: Default::default(),
        frames,
        mesh,
        centre,
    };
    Ok(Synthesized {
        capture,
        occluders,
        albedo: albedos,
    })
}

/// Camera `index` of a spiral over the upper half, around an object of this bounding radius at the origin: golden angles
/// around, from low to high.
fn camera(shooting: &Shooting, index: usize, radius: f32) -> Camera {
    let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
    let height = (index as f32 + 0.5) / shooting.frames as f32;
    let (elevation, azimuth) = (0.1 + 0.7 * height, golden * index as f32);
    let direction = Vec3::new(
        elevation.cos() * azimuth.cos(),
        elevation.cos() * azimuth.sin(),
        elevation.sin(),
    );
    let angle = 2.0 * (MARGIN / shooting.distance).min(0.95).asin();
    let eye = shooting.distance * radius * direction;
    Camera::look_at(
        shooting.resolution,
        shooting.resolution,
        angle,
        eye,
        Vec3::ZERO,
    )
}

/// A rendered frame as the sensor sees it.
fn photograph(rendered: &Image, camera: Camera, shooting: &Shooting, frame: usize) -> Frame {
    let (width, height) = (rendered.width, rendered.height);
    let mut image = Image::filled(width, height, 3, 0.0);
    let mut mask = Image::filled(width, height, 1, 0.0);
    for (index, pixel) in rendered.data.chunks_exact(4).enumerate() {
        mask.data[index] = pixel[3];
        let key = SampleKey {
            seed: shooting.seed,
            frame: frame as u32,
            pixel: index as u32,
            ..Default::default()
        };
        let mut stream = key.stream();
        for channel in 0..3 {
            let value = pixel[channel];
            image.data[3 * index + channel] =
                value + shooting.noise * (value + 0.25).sqrt() * stream.normal();
        }
    }
    Frame {
        name: format!("{frame:03}"),
        camera,
        image,
        mask,
    }
}

/// Writes the capture to the new folder `path`, its truth in `truth/`, whole or not at all.
///
/// # Errors
/// A folder that holds something already, or that cannot be written.
pub fn write(path: &Path, scene: &Scene, made: &Synthesized) -> Result<(), SynthesizeError> {
    capture::write_with(path, &made.capture, |folder| {
        let truth = folder.join("truth");
        let failed = |source| CaptureError::Write {
            path: path.to_owned(),
            source,
        };
        std::fs::create_dir(&truth).map_err(failed)?;
        let rgb = ["R", "G", "B"];
        let mut options = ExrOptions::default();
        options
            .metadata
            .insert(CONVENTION.to_owned(), "blender".to_owned());
        write_exr_with(
            &truth.join("environment.exr"),
            &scene.environment,
            &rgb,
            &options,
        )?;
        for (index, albedo) in made.albedo.iter().enumerate() {
            write_exr(
                &truth.join(format!("albedo_{}", numbered(index))),
                albedo,
                &rgb,
            )?;
        }
        if let Some(first) = made.occluders.first() {
            let stack = Image {
                height: first.height * made.occluders.len(),
                data: made
                    .occluders
                    .iter()
                    .flat_map(|mask| mask.data.iter().copied())
                    .collect(),
                ..*first
            };
            write_exr_with(&truth.join("occluders.exr"), &stack, &["Y"], &options)?;
        }
        let lambertian = scene.model == Model::Lambertian;
        let scalars = json!({
            "bsdf": if lambertian { "lambert" } else { "ggx" },
            "alpha": scene.alpha,
            "kappa": scene.kappa,
            "operator": scene.occluders != Occluders::None,
            "radius": made.capture.frames.first().map(|frame| frame.camera.distance()),
        });
        atomic::write(&truth.join("truth.json"), |file| {
            std::io::Write::write_all(file, format!("{scalars:#}\n").as_bytes())
        })
        .map_err(failed)?;
        Ok(())
    })
}

/// Why a capture could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SynthesizeError {
    /// The mesh cannot be rendered.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The environment cannot light a scene.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// An image could not be read or written.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// The capture could not be written.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Masks and frames do not match.
    #[error(
        "there are {found} masks for {frames} frames: give one map a frame, stacked one below the other"
    )]
    Masks {
        /// Masks given.
        found: usize,
        /// Frames asked for.
        frames: usize,
    },
    /// The caller asked for the end.
    #[error("interrupted; nothing was written")]
    Stopped,
}
