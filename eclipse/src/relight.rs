//! A recovered object in other light: stills and turntables.
//!
//! What a run left (`mesh.glb` with its materials) is rendered under any distant light by the paths that the paper's
//! estimator draws: from the light and from the material, weighted against each other (S8–S12). Unlike the quadrature that
//! captures are synthesised with, this meets lamps of any size, and the price does not grow with the map.

mod cameras;
mod light;
mod object;
mod picture;
mod views;
mod write;

use std::path::{Path, PathBuf};

use glam::Vec3;
use render::{bvh::Bvh, camera::Camera, environment::EnvironmentMap, mesh::MeshError};

use crate::{
    capture::CaptureError,
    files::lock::LockError,
    image_io::{Clamped, EnvironmentIoError, ImageIoError},
    mesh_io::MeshIoError,
};

pub use cameras::{Orbit, evenly};
pub use light::{Axes, Lights};
pub use object::{Object, reading};
pub use picture::{ANTIALIASING, Quality, picture};
pub use views::{View, frame_names, number};
pub use write::{Folder, Record};

/// Everything a picture needs: the object, and the light around it.
pub struct Stage {
    object: Object,
    bvh: Bvh,
    environment: EnvironmentMap,
    /// Stops by which light is brighter than its map.
    exposure: f32,
}

impl Stage {
    /// Sets `object` into the light of `environment`, `exposure` stops brighter.
    ///
    /// # Errors
    /// A mesh that cannot be rendered.
    pub fn new(
        object: Object,
        environment: EnvironmentMap,
        exposure: f32,
    ) -> Result<Self, RelightError> {
        let bvh = Bvh::new(&object.mesh)?;
        Ok(Self {
            object,
            bvh,
            environment: exposed(&environment, exposure)?,
            exposure,
        })
    }

    /// Sets the object into other light, as many stops brighter.
    ///
    /// # Errors
    /// [`RelightError::Exposure`]; the light is what it was then.
    pub fn set_light(&mut self, environment: &EnvironmentMap) -> Result<(), RelightError> {
        self.environment = exposed(environment, self.exposure)?;
        Ok(())
    }

    /// The object.
    pub fn object(&self) -> &Object {
        &self.object
    }
}

/// `environment`, `exposure` stops brighter.
fn exposed(environment: &EnvironmentMap, exposure: f32) -> Result<EnvironmentMap, RelightError> {
    let mut image = environment.image().clone();
    let factor = exposure.exp2();
    image.data.iter_mut().for_each(|value| *value *= factor);
    // Finite light that overflows when it is exposed is refused as any other.
    EnvironmentMap::new(image).map_err(RelightError::Exposure)
}

/// Cameras of the object's own frame, as its capture has them, moved to the frame whose origin is its centre.
///
/// # Errors
/// [`RelightError::CameraInside`].
pub fn recentred(object: &Object, mut cameras: Vec<Camera>) -> Result<Vec<Camera>, RelightError> {
    let radius = object.mesh.bounding_radius();
    for (index, camera) in cameras.iter_mut().enumerate() {
        camera.world_from_camera.w_axis -= object.centre.extend(0.0);
        let distance = camera.distance();
        if distance <= radius {
            return Err(RelightError::CameraInside {
                camera: index,
                distance,
                radius,
            });
        }
    }
    Ok(cameras)
}

/// Camera to world of `camera` in the object's own frame, by rows.
pub fn pose_rows(camera: &Camera, centre: Vec3) -> [[f32; 4]; 4] {
    let mut pose = camera.world_from_camera;
    pose.w_axis += centre.extend(0.0);
    pose.transpose().to_cols_array_2d()
}

/// Renders every view and writes it to `folder` when it is done; under the stage's light, or its own of `lights`.
///
/// `progress` hears of the share of the work done, and says whether to go on. Results do not depend on the number of threads. Returned
/// is what was changed of maps to make light of them, once for each.
///
/// # Errors
/// A light that cannot be read, a folder that cannot be written, or [`RelightError::Stopped`]; pictures finished before are kept.
pub fn relight(
    stage: &mut Stage,
    views: &[View],
    lights: Option<&Lights>,
    quality: &Quality,
    folder: &Folder,
    progress: &(dyn Fn(usize, f32) -> bool + Sync),
) -> Result<Vec<Clamped>, RelightError> {
    let mut clamped: Vec<Clamped> = Vec::new();
    for (index, view) in views.iter().enumerate() {
        if let Some(lights) = lights {
            let (light, changed) = lights.read(index, &view.camera)?;
            clamped.extend(changed.filter(|changed| !clamped.contains(changed)));
            stage.set_light(&light)?;
        }
        let picture = picture(stage, &view.camera, index as u32, quality, &|share| {
            progress(index, share)
        });
        folder.picture(&view.name, &picture.ok_or(RelightError::Stopped)?)?;
    }
    Ok(clamped)
}

/// Why an object could not be relit.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RelightError {
    /// There is no object to relight.
    #[error(transparent)]
    Object {
        /// What is wrong with its mesh.
        source: MeshIoError,
    },
    /// A file of the run cannot be read.
    #[error("cannot read {}: {source}; check that it may be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The run's settings cannot be understood.
    #[error("{} is not as expected: {source}; it should be the settings.json of a run, with `lambertian`, or be absent", path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// What is wrong where.
        source: serde_json::Error,
    },
    /// The mesh cannot be rendered.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Too bright to be represented.
    #[error("the exposure makes the light too bright: {0}")]
    Exposure(render::environment::EnvironmentError),
    /// The cameras cannot be read.
    #[error(transparent)]
    Cameras(#[from] CaptureError),
    /// A frame that cannot give its picture a name.
    #[error(
        "{}: frame {frame}: `{field}` {name:?} {problem}; expected names of pictures within one folder, each another, such as \
         test/0003: correct it, or leave the pictures numbered", path.display()
    )]
    Name {
        /// The cameras file.
        path: PathBuf,
        /// Which frame, from 0.
        frame: usize,
        /// The field.
        field: &'static str,
        /// What it says.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A view without a map of its light.
    #[error(
        "view {view:?} has no map: none of {places} is there, with .exr, .hdr, .png or .jpg added; put it there, or name another folder"
    )]
    NoLight {
        /// The view.
        view: String,
        /// Where it was looked for.
        places: String,
    },
    /// A map cannot be read.
    #[error(transparent)]
    Light(#[from] EnvironmentIoError),
    /// A camera within the object.
    #[error(
        "camera {camera} is {distance:.4} from the object's centre, within its bounding sphere of radius {radius:.4}; \
         move it away, or check that cameras and mesh are in one frame"
    )]
    CameraInside {
        /// Which, from 0.
        camera: usize,
        /// Its distance.
        distance: f32,
        /// The sphere's radius.
        radius: f32,
    },
    /// The folder holds something else.
    #[error("{} holds other files: name a new folder with --out", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
    /// Another run writes to the folder.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// A picture could not be written.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// The file system refused.
    #[error("cannot write {}: {source}; check that the folder may be written and that the disk is not full", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The caller asked for the end.
    #[error("interrupted; the pictures finished so far are kept")]
    Stopped,
}

impl RelightError {
    fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write {
            path: path.to_owned(),
            source,
        }
    }
}
