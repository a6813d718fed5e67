//! Everything that can be wrong with a capture, each with what to do.

use std::path::{Path, PathBuf};

use super::{Diagnosis, MAX_SAMPLES};
use crate::{
    image_io::ImageIoError,
    mesh_io::MeshIoError,
    wording::{amount, counted},
};

/// Why a capture could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The fields are what the messages say of them.
pub enum CaptureError {
    /// A file of the capture cannot be read.
    #[error("cannot read {}: {source}; a capture is a folder with transforms.json (or a COLMAP model), images and a mesh", path.display())]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    /// A file in place of the folder.
    #[error("{} is a file, but a capture is a folder; {hint}", path.display())]
    File { path: PathBuf, hint: String },
    /// A folder without anything that describes a capture.
    #[error("{} holds none of the files that describe a capture; expected one of {signs}: put it there, or name another folder", path.display())]
    NoFormat { path: PathBuf, signs: String },
    /// A split names a frame that is not there.
    #[error("{}: `{field}` names {name:?}, which is no frame's `file_path`; correct the name, or remove the split", path.display())]
    Split {
        path: PathBuf,
        field: &'static str,
        name: String,
    },
    /// Splits that leave nothing to reconstruct from.
    #[error("{}: no frame is for training; expected some in `train_filenames`, or outside `val_filenames` and `test_filenames`", path.display())]
    NoTraining { path: PathBuf },
    /// A file of a COLMAP model cannot be read.
    #[error("cannot read {}: {source}; a COLMAP model has cameras, images and points3D, all .bin or all .txt", path.display())]
    ReadModel {
        path: PathBuf,
        source: std::io::Error,
    },
    /// A file of a COLMAP model is not what it should be.
    #[error("{}: {place} {problem}; correct it, or write the model again with COLMAP", path.display())]
    Model {
        path: PathBuf,
        place: String,
        problem: String,
    },
    /// `transforms.json` is not what it should be.
    #[error("{} cannot be understood: {reason}; expected the JSON of Blender/NeRF or nerfstudio, with `frames`", path.display())]
    Json { path: PathBuf, reason: String },
    /// A kind of camera that is not supported.
    #[error(
        "{}: `camera_model` is {model:?}, which is not supported yet; expected a perspective camera (PINHOLE, OPENCV, \
         SIMPLE_RADIAL or RADIAL) or ORTHOGRAPHIC: undistort the images to one of them", path.display()
    )]
    CameraModel { path: PathBuf, model: String },
    /// No photographs.
    #[error("{}: `frames` is empty; expected at least one photograph", path.display())]
    NoFrames { path: PathBuf },
    /// `shape` is no shape.
    #[error("{}: `shape.sphere.{field}` {problem}", path.display())]
    Shape {
        path: PathBuf,
        field: &'static str,
        problem: String,
    },
    /// Lamps in some frames only.
    #[error(
        "{}: frame {frame:?}: `lamp` is missing, but other frames have one; give each frame the lamp it was taken by, or none, where \
         the light is unknown", path.display()
    )]
    LampMissing { path: PathBuf, frame: String },
    /// Parallel views under unknown light.
    #[error(
        "{}: `camera_model` is ORTHOGRAPHIC and the frames have no `lamp`; orthographic cameras are supported where the light is known: \
         give each frame its `lamp` (`direction`, `strength`), or use a perspective camera of a long focal length", path.display()
    )]
    OrthographicLight { path: PathBuf },
    /// A frame that names no file.
    #[error(
        "{}: `frames[{index}].file_path` is {file_path:?}, which names no file; expected the photograph's, relative to the folder",
        path.display()
    )]
    NamelessFrame {
        path: PathBuf,
        index: usize,
        file_path: String,
    },
    /// Two entries for one photograph.
    #[error("{}: `frames` names {file_path:?} twice; remove or rename one of the two", path.display())]
    DuplicateFrame { path: PathBuf, file_path: String },
    /// A field is missing or has no possible value.
    #[error("{}: frame {frame:?}: `{field}` {problem}", path.display())]
    Field {
        path: PathBuf,
        frame: String,
        field: &'static str,
        problem: String,
    },
    /// `transform_matrix` is not rigid.
    #[error(
        "{}: frame {frame:?}: `transform_matrix` {problem}; expected the rotation and position of the camera, camera to world",
        path.display()
    )]
    Pose {
        path: PathBuf,
        frame: String,
        problem: String,
    },
    /// A file that a frame names is not there.
    #[error(
        "{}: frame {frame:?}: `{field}` names {}, which does not exist{hint}; put the file there or correct the path",
        described.display(), path.display()
    )]
    Missing {
        described: PathBuf,
        frame: String,
        field: &'static str,
        path: PathBuf,
        hint: String,
    },
    /// A path that leads out of the capture's folder.
    #[error(
        "{place}: `{field}` names {}, which lies outside the capture's folder; move it inside and correct the path, or give \
         --allow-outside when you trust the capture (in the library: `LoadOptions::allow_outside`)", path.display()
    )]
    Outside {
        place: String,
        field: &'static str,
        path: PathBuf,
    },
    /// What describes a capture, elsewhere.
    #[error(
        "{} leads out of the capture's folder through a link; put the file itself there, or give --allow-outside when you trust the \
         capture (in the library: `LoadOptions::allow_outside`)", path.display()
    )]
    Linked { path: PathBuf },
    /// A COLMAP model without its photographs.
    #[error(
        "{} names photographs, but {} is not there, where they are looked for; put them there, or say where they lie with --images \
         (in the library: `LoadOptions::images`)", path.display(), folder.display()
    )]
    NoImages { path: PathBuf, folder: PathBuf },
    /// What was named for the photographs of a COLMAP model is no folder.
    #[error("--images {}: {problem}; expected the folder in which the photographs lie (in the library: `LoadOptions::images`)", path.display())]
    Images { path: PathBuf, problem: String },
    /// A folder of photographs for a capture that says itself where each lies.
    #[error(
        "{}: says itself in `file_path` where each photograph lies, so that --images {} has no meaning (in the library: \
         `LoadOptions::images`); leave it out, or correct the paths: it is for COLMAP models", path.display(), images.display()
    )]
    ImagesNamed { path: PathBuf, images: PathBuf },
    /// Images that would not fit into memory together.
    #[error(
        "{}: its photographs and masks have {samples} values together (pixels × channels, of a photograph at least 4 a pixel), \
         {:.1} GiB as floats; at most {MAX_SAMPLES} are read: give --max-size (in the library: `LoadOptions::max_size`), \
         scale the images down (with them w, h, the focal lengths and the \
         principal point), or leave photographs out",
        path.display(), *samples as f64 / f64::from(1 << 28)
    )]
    TooManySamples { path: PathBuf, samples: u64 },
    /// Images that alone would take more memory than the user allows.
    #[error(
        "{}: its photographs and masks alone take {} MiB of memory, more than the {} allowed: give --memory several times that (in the \
         library: `LoadOptions::max_memory`), or use fewer or smaller photographs (--max-size)",
        path.display(), samples.div_ceil(1 << 18), amount(*allowed)
    )]
    NotAllowed {
        path: PathBuf,
        samples: u64,
        allowed: u64,
    },
    /// An image that cannot be decoded.
    #[error("frame {frame:?}: {source}")]
    Image { frame: String, source: ImageIoError },
    /// An image of another size than declared, or than the others.
    #[error("frame {frame:?}: {} has {}×{} pixels{note}, but {expected} {}×{}; resize the image, or correct w and h (with COLMAP, take photographs of the size of its cameras, which --max-size reduces)", path.display(), found[0], found[1], wanted[0], wanted[1])]
    Size {
        frame: String,
        path: PathBuf,
        found: [usize; 2],
        note: String,
        expected: &'static str,
        wanted: [usize; 2],
    },
    /// Pixels that are NaN or infinite.
    #[error(
        "frame {frame:?}: {} has {} that are NaN or infinite, the first in column {column} of row {row} (from 0, top left); \
         render or develop the image again, or paint them over", path.display(), counted(*count, "pixel")
    )]
    NotFinite {
        frame: String,
        path: PathBuf,
        count: usize,
        column: usize,
        row: usize,
    },
    /// Nothing says which pixels show the object.
    #[error("frame {frame:?}: {} has no alpha channel and the frame no `mask_path`; give one of them (with COLMAP, masks/NAME.png) to say which pixels show the object", path.display())]
    NoMask { frame: String, path: PathBuf },
    /// No pixel shows the object.
    #[error("frame {frame:?}: the mask in {} is empty; expected values above one half where the object is: correct it, or leave the frame out", path.display())]
    EmptyMask { frame: String, path: PathBuf },
    /// A mask that is not black, but has nothing above one half.
    #[error(
        "frame {frame:?}: the largest value of the mask in {} is {brightest}, and only what is above one half counts as the object; if its \
         values are numbers of labels, paint the object's white and all else black; if it is dim, brighten it; or leave the frame out", path.display()
    )]
    DimMask {
        frame: String,
        path: PathBuf,
        brightest: String,
    },
    /// No pixel is left that shows the object.
    #[error(
        "frame {frame:?}: the object fills {} of the mask in {}, and none of the {} × {} that --max-size {longest} reduces \
         it to; give a larger --max-size (in the library: `LoadOptions::max_size`)", counted(*pixels, "pixel"), path.display(), size[0], size[1]
    )]
    ReducedAway {
        frame: String,
        path: PathBuf,
        pixels: usize,
        longest: usize,
        size: [usize; 2],
    },
    /// Several frames that cannot be used.
    #[error("{}: {}", path.display(), listed(path, told, [*bad, *of]))]
    Frames {
        path: PathBuf,
        told: Vec<CaptureError>,
        bad: usize,
        of: usize,
    },
    /// No mesh was found.
    #[error("{} holds no mesh.glb, .gltf, .obj or .ply; {hint}", path.display())]
    NoMesh { path: PathBuf, hint: String },
    /// nerfstudio's points where the object's shape is looked for.
    #[error(
        "`ply_file_path` names {}, which has {} and no faces, as nerfstudio's sparse points do; put the object's shape \
         beside transforms.json as mesh.glb, .gltf, .obj or .ply, or name it with --mesh", path.display(), counted(*vertices, "point")
    )]
    OnlyPoints { path: PathBuf, vertices: usize },
    /// The mesh cannot be used.
    #[error("{source}")]
    Mesh {
        #[from]
        source: MeshIoError,
    },
    /// A camera within the object's bounding sphere.
    #[error(
        "{}: frame {frame:?}: its camera is {distance:.4} from the middle of the mesh, inside the object's bounding sphere of radius \
         {radius:.4}; check that mesh and cameras use the same unit and origin", path.display()
    )]
    CameraInside {
        path: PathBuf,
        frame: String,
        distance: f32,
        radius: f32,
    },
    /// The mesh, seen through the cameras, is not where the masks are.
    #[error("the mesh and the cameras disagree: {0}")]
    Disagreement(Diagnosis),
    /// A capture cannot be written.
    #[error("cannot write the capture {}: {source}; check that its folder may be written, and that the disk is not full", path.display())]
    Write {
        path: PathBuf,
        source: std::io::Error,
    },
    /// Something is already where a capture is to be written.
    #[error("cannot write the capture {}: the folder exists and is not empty; remove it or choose another", path.display())]
    Occupied { path: PathBuf },
    /// An image of a capture cannot be written.
    #[error("{0}")]
    WriteImage(ImageIoError),
}

/// Frames of which it is said what is wrong with them, where it is many.
const TOLD: usize = 20;

/// What each frame of the capture that `path` describes gave. What is wrong with several is one error, so that whoever corrects them
/// need not come back for each.
pub(super) fn all_good<T>(
    path: &Path,
    frames: impl IntoIterator<Item = Result<T, CaptureError>>,
) -> Result<Vec<T>, CaptureError> {
    let (mut good, mut told) = (Vec::new(), Vec::new());
    let (mut bad, mut of) = (0, 0);
    for frame in frames {
        of += 1;
        match frame {
            Ok(frame) if bad == 0 => good.push(frame),
            Ok(_) => {}
            Err(error) => {
                bad += 1;
                // Nothing comes of the others any more, and photographs take memory.
                good = Vec::new();
                told.extend((told.len() < TOLD).then_some(error));
            }
        }
    }
    match bad {
        0 => Ok(good),
        1 => Err(told.remove(0)),
        _ => Err(CaptureError::Frames {
            path: path.into(),
            told,
            bad,
            of,
        }),
    }
}

/// Errors of frames one below the other, without the file `path` that the list is of, and how many of `bad` are not among them. What
/// is wrong with several in the same way is told once.
fn listed(path: &Path, told: &[CaptureError], [bad, of]: [usize; 2]) -> String {
    let mut alike: Vec<(String, String, usize)> = Vec::new();
    for error in told {
        let (frame, problem) = parted(path, &error.to_string());
        match alike.iter_mut().find(|(_, known, _)| *known == problem) {
            Some((.., count)) => *count += 1,
            None => alike.push((frame, problem, 1)),
        }
    }
    let line = |(frame, problem, count): &(String, String, usize)| match count {
        1 => format!("{frame}{problem}"),
        _ => format!("{frame} and {} more{problem}", count - 1),
    };
    match &*alike {
        [all] if told.len() == bad => line(all),
        _ => {
            let mut text = format!("{bad} of {of} frames cannot be used:");
            alike
                .iter()
                .for_each(|alike| text += &format!("\n  {}", line(alike)));
            if bad > told.len() {
                text += &format!("\n  and {} more", bad - told.len());
            }
            text
        }
    }
}

/// The frame that a message begins with, and the rest of it; the file `path` is left out.
fn parted(path: &Path, text: &str) -> (String, String) {
    let place = format!("{}: ", path.display());
    let text = text.strip_prefix(&place).unwrap_or(text);
    match text.find("\": ").filter(|_| text.starts_with("frame \"")) {
        Some(end) => {
            let (frame, problem) = text.split_at(end + 1);
            (frame.to_owned(), problem.to_owned())
        }
        None => (String::new(), text.to_owned()),
    }
}

/// A frame of the file that describes a capture: what is at fault.
#[derive(Clone, Copy)]
pub(super) struct At<'a> {
    pub path: &'a Path,
    pub frame: &'a str,
}

impl At<'_> {
    /// A field of it is missing or has no possible value.
    pub fn field(self, field: &'static str, problem: String) -> CaptureError {
        CaptureError::Field {
            path: self.path.into(),
            frame: self.frame.into(),
            field,
            problem,
        }
    }

    /// Its pose is none.
    pub fn pose(self, problem: String) -> CaptureError {
        CaptureError::Pose {
            path: self.path.into(),
            frame: self.frame.into(),
            problem,
        }
    }

    /// As messages begin.
    pub fn place(self) -> String {
        format!("{}: frame {:?}", self.path.display(), self.frame)
    }
}
