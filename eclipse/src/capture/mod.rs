//! What a user hands in: posed photographs and the object's shape.
//!
//! A capture is a folder with images, masks where they have no alpha, a mesh, and what says how the images were taken, in
//! one of several [`formats`]. It is checked as a whole when it is loaded: what is wrong with it comes out as one [`CaptureError`].

mod cameras;
mod error;
pub mod formats;
mod frames;
mod lamps;
mod paths;
mod pose;
mod silhouette;
pub mod transforms;
mod up;
mod write;

use std::path::{Path, PathBuf};

use glam::Vec3;
use render::{camera::Camera, image::Image, mesh::Mesh};

pub use cameras::{MAX_PICTURE_SIDE, read_cameras, read_described};
pub use error::CaptureError;
pub use formats::Source;
pub use lamps::{Lamp, Lamps};
pub use silhouette::{Diagnosis, mask_overlap};
pub use transforms::parse_transforms;
pub use up::UpAxis;
pub(crate) use write::vacant;
pub use write::{write, write_with};

use crate::{
    capture::{error::At, frames::Reading, paths::Folder, transforms::Transforms},
    image_io::ColorEncoding,
    mesh_io::{MeshIoError, MeshParseError, read_mesh},
};

/// Most samples (pixels × channels) of all photographs and masks of a capture together: 8 GiB as floats.
///
/// A photograph counts with the four values a pixel that are kept of it, or with the channels of its file where those are more.
/// A run with the memory that it has by default holds a seventh of this.
pub const MAX_SAMPLES: u64 = 1 << 31;
/// Radii of the object that a camera may be away: further out, a pixel is wider than the object in any photograph, and single
/// precision cannot tell its near side from its far side.
const MAX_DISTANCE: f64 = 1e6;

/// A capture, read and checked, in the recentred frame (the middle of the mesh's bounding box is the origin), whose z points up.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The folder it was read from.
    pub path: PathBuf,
    /// Photographs, in the order of what describes them.
    pub frames: Vec<Frame>,
    /// The object.
    pub mesh: Mesh,
    /// Where the recentred frame's origin lies in the capture's own frame, turned so that z points up: own = recentred + centre.
    pub centre: Vec3,
    /// The lamps, where the light is known.
    pub lamps: Option<Lamps>,
}

/// One photograph with its camera.
#[derive(Clone, Debug)]
pub struct Frame {
    /// File name without folder and extension, such as `007`.
    pub name: String,
    /// Where and how it was taken, in the recentred frame.
    pub camera: Camera,
    /// Linear RGB, three channels.
    pub image: Image,
    /// Coverage of each pixel by the object, one channel in [0, 1].
    pub mask: Image,
}

/// How a capture is read.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// The mesh to use in place of the capture's own.
    pub mesh: Option<PathBuf>,
    /// Whether files outside of the folder may be read: those that it names, and itself where it is a link.
    pub allow_outside: bool,
    /// How colours are stored, in place of what `transforms.json` or the file types say.
    pub color_encoding: Option<ColorEncoding>,
    /// Which axis of the capture's own world points up; in what is read it is z.
    pub up: UpAxis,
    /// Longest side of photographs and masks, in pixels: larger ones are reduced, one batch after the other, as they are read.
    pub max_size: Option<usize>,
    /// Where the photographs of a COLMAP model lie, in place of its own `images`: in the folder of the capture, or anywhere else.
    pub images: Option<PathBuf>,
    /// Bytes that photographs and masks may take together as floats, counted as [`MAX_SAMPLES`] are, which they never exceed; about as
    /// many are decoded at once.
    pub max_memory: u64,
    /// Least median overlap (intersection over union) of the mesh's silhouettes with the masks; 0 switches the check off.
    pub min_overlap: f32,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            mesh: None,
            allow_outside: false,
            color_encoding: None,
            up: UpAxis::Z,
            max_size: None,
            images: None,
            max_memory: 4 * MAX_SAMPLES,
            min_overlap: 0.8,
        }
    }
}

/// The photographs that the capture in the folder `path` names, in the order of its frames; `None` for one that is not there, or
/// lies outside.
///
/// # Errors
/// [`CaptureError`] where what describes the capture cannot be read.
pub fn photographs(path: &Path) -> Result<Vec<Option<PathBuf>>, CaptureError> {
    let folder = Folder::new(path, false)?;
    let source = formats::read(&folder)?;
    let photograph = |name: &String| {
        let at = At {
            path: &source.path,
            frame: name,
        };
        folder.image(at, "file_path", name).ok()
    };
    let names = source
        .transforms
        .frames
        .iter()
        .map(|frame| &frame.file_path);
    Ok(names.map(photograph).collect())
}

/// The mesh that is `asked` for, else the capture's own.
fn own_mesh(
    folder: &Folder,
    asked: Option<&Path>,
    described: &Path,
    transforms: &Transforms,
) -> Result<Mesh, CaptureError> {
    let path = folder.mesh(asked, described, transforms)?;
    let is_named = |path: &Path| {
        let named = transforms.ply_file_path.as_deref();
        named.is_some_and(|name| folder.ply(described, name).is_ok_and(|named| named == path))
    };
    read_mesh(&path).map_err(|error| match error {
        MeshIoError::Parse {
            source: MeshParseError::NoFaces { vertices },
            path,
        } if asked.is_none() && is_named(&path) => CaptureError::OnlyPoints { path, vertices },
        error => error.into(),
    })
}

impl Capture {
    /// What describes the capture in the folder `path`, without its images; in the axes of its files.
    ///
    /// # Errors
    /// [`CaptureError`] names the file, the field, what was expected and what to do.
    pub fn describe(path: &Path, options: &LoadOptions) -> Result<Source, CaptureError> {
        let folder = Folder::new(path, options.allow_outside)?.with_images(options)?;
        let source = formats::read(&folder)?;
        let asked = options.mesh.as_deref();
        let in_words = source.transforms.shape.is_some() && asked.is_none();
        // What is amiss with it is told where it is read.
        let mesh = folder.mesh(asked, &source.path, &source.transforms).ok();
        // With the user's choice, or a shape in words, none of them is taken for another.
        let others = match asked.is_none() && !in_words {
            true => folder.own_meshes().into_iter().skip(1).collect(),
            false => Vec::new(),
        };
        Ok(Source {
            mesh: mesh.filter(|_| !in_words),
            other_meshes: others,
            ..source
        })
    }

    /// Reads and checks the capture in the folder `path`.
    ///
    /// Images are decoded in parallel; where several frames cannot be used, the error tells what is wrong with each, in their order.
    ///
    /// # Errors
    /// [`CaptureError`] names the file, the field, what was expected and what to do.
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Self, CaptureError> {
        let folder = Folder::new(path, options.allow_outside)?.with_images(options)?;
        let Source {
            path: described,
            transforms,
            ..
        } = formats::read(&folder)?;
        // A shape that is told in words of its own is what is meant, unless the user names a mesh.
        let shape = transforms.shape.as_ref().filter(|_| options.mesh.is_none());
        let mut mesh = match shape {
            Some(shape) => lamps::mesh_of(shape, &described)?,
            None => own_mesh(&folder, options.mesh.as_deref(), &described, &transforms)?,
        };
        let encoding = options.color_encoding.or(transforms.color_encoding);
        let reading = Reading {
            encoding,
            max_size: options.max_size,
            max_memory: options.max_memory,
        };
        let mut frames = frames::load(&folder, &described, &transforms, reading)?;

        let names = frames.iter().map(|frame| &*frame.name);
        let lamps = lamps::lamps(&described, &transforms, names)?.map(|lamps| Lamps {
            lamps,
            ball: shape.is_some(),
        });

        let centre = options.up.middle(&mesh);
        for position in &mut mesh.positions {
            *position -= centre;
        }
        for frame in &mut frames {
            frame.camera.world_from_camera.w_axis -= centre.extend(0.0);
        }
        let mut capture = Self {
            path: path.into(),
            frames,
            mesh,
            centre,
            lamps,
        };
        // Before anything is computed with what overflows.
        capture.check_far(&described)?;
        capture.stand_off();
        capture.check_distances(&described, &transforms, options)?;
        silhouette::check(&capture, &transforms, options.min_overlap)?;
        // Last, so that whatever is amiss is told in the axes of the files.
        capture.turn(options.up);
        Ok(capture)
    }

    /// Refuses cameras so far away that nothing can be computed with where they stand.
    fn check_far(&self, described: &Path) -> Result<(), CaptureError> {
        let radius = f64::from(self.mesh.bounding_radius());
        for frame in &self.frames {
            // In double precision: squares of what is so far away are no single ones.
            let distance = frame.camera.centre().as_dvec3().length();
            // What is no number is not near either.
            let near = distance <= MAX_DISTANCE * radius;
            if !near {
                let at = At {
                    path: described,
                    frame: &frame.name,
                };
                let problem = format!(
                    "puts the camera {distance:.3e} from the middle of the mesh, whose radius is {radius:.4}; at most {MAX_DISTANCE:e} \
                     times that is possible: correct the position, or bring mesh and cameras to one unit"
                );
                return Err(at.field("transform_matrix", problem));
            }
        }
        Ok(())
    }

    /// Refuses cameras within the object's bounding sphere, with the likely cause when one can be named.
    fn check_distances(
        &self,
        described: &Path,
        transforms: &Transforms,
        options: &LoadOptions,
    ) -> Result<(), CaptureError> {
        let radius = self.mesh.bounding_radius();
        let Some(frame) = self
            .frames
            .iter()
            .find(|frame| frame.camera.distance() <= radius)
        else {
            return Ok(());
        };
        if options.min_overlap > 0.0 {
            let diagnosis = silhouette::diagnose(self, transforms, options.min_overlap);
            if diagnosis.is_explained() {
                return Err(CaptureError::Disagreement(diagnosis));
            }
        }
        Err(CaptureError::CameraInside {
            path: described.into(),
            frame: frame.name.clone(),
            distance: frame.camera.distance(),
            radius,
        })
    }
}
