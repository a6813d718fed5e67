//! `transforms.json`, as Blender/NeRF and nerfstudio write it.
//!
//! Poses are camera-to-world with OpenGL axes. `applied_transform` and `applied_scale` say what was done to the poses
//! already; they are read only to explain a mesh that was left behind.

use std::{fmt, marker::PhantomData, path::Path};

use render::camera::Projection;
use serde::{
    Deserialize, Deserializer,
    de::{Error, IgnoredAny, SeqAccess, Visitor},
};

use super::{CaptureError, error::At};
use crate::{
    files::{
        json::{self, JsonError},
        read_limited,
    },
    image_io::ColorEncoding,
};

/// The camera model without perspective.
const ORTHOGRAPHIC: &str = "ORTHOGRAPHIC";
/// Those of perspective whose distortion is OpenCV's `k1 k2 p1 p2`.
const PERSPECTIVE: [&str; 6] = [
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "OPENCV",
    "SIMPLE_RADIAL",
    "RADIAL",
    "PERSPECTIVE",
];
/// Largest `transforms.json` that is read, in bytes.
pub const MAX_TRANSFORMS: u64 = 1 << 27;
/// Most frames of a file that are read.
pub const MAX_FRAMES: usize = 100_000;

/// The fields of `transforms.json` that are used. Others are passed over.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(expecting = "an object with `frames`")]
#[non_exhaustive]
pub struct Transforms {
    /// Kind of camera: perspective ones with OpenCV distortion, or `ORTHOGRAPHIC`.
    pub camera_model: Option<String>,
    /// Intrinsics shared by the frames that do not have their own.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    /// The mask of the frames that do not have their own, as of an object on a turntable that fills the same pixels.
    pub mask_path: Option<String>,
    /// How colours are stored, where it differs from the file type's habit. A field of ours.
    pub color_encoding: Option<ColorEncoding>,
    /// Rows of the camera-to-world matrix of the frames that do not have their own.
    #[serde(default)]
    pub transform_matrix: Vec<Vec<f64>>,
    /// The object where it is no mesh. A field of ours.
    pub shape: Option<Shape>,
    /// The object, relative to the capture's folder. nerfstudio keeps its sparse points here.
    pub ply_file_path: Option<String>,
    /// Rows of the 3 × 4 or 4 × 4 transform that nerfstudio applied to the original poses.
    pub applied_transform: Option<Vec<Vec<f64>>>,
    /// The factor by which it scaled them afterwards.
    pub applied_scale: Option<f64>,
    /// Which frames nerfstudio trains with, by `file_path`.
    pub train_filenames: Option<Vec<String>>,
    /// Which it keeps for validation.
    pub val_filenames: Option<Vec<String>>,
    /// Which it keeps for tests.
    pub test_filenames: Option<Vec<String>>,
    /// The photographs.
    #[serde(deserialize_with = "no_more_than_are_read")]
    pub frames: Vec<TransformsFrame>,
}

/// One entry of `frames`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(expecting = "an object with `file_path` and `transform_matrix`")]
#[non_exhaustive]
pub struct TransformsFrame {
    /// The photograph, relative to the capture's folder, with or without extension.
    pub file_path: String,
    /// Its mask, if it is a file of its own: bright is the object.
    pub mask_path: Option<String>,
    /// The scene that it belongs to, where one file lists several (Stanford-ORB's `transforms_novel.json`).
    pub scene_name: Option<String>,
    /// Kind of this frame's camera: it must project as those of the file do.
    pub camera_model: Option<String>,
    /// Rows of the camera-to-world matrix, 4 × 4 or 3 × 4.
    #[serde(default)]
    pub transform_matrix: Vec<Vec<f64>>,
    /// The only lamp that was on, where the light is known. A field of ours.
    pub lamp: Option<TransformsLamp>,
    /// Intrinsics of this frame alone.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
}

/// The object as a formula.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// A ball.
    pub sphere: SphereShape,
}

/// A ball.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SphereShape {
    /// Its middle.
    pub centre: Vec<f64>,
    /// Its radius.
    pub radius: f64,
}

/// A lamp so far away that its light is the same everywhere.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransformsLamp {
    /// Unit vector from the object to the lamp.
    pub direction: Vec<f64>,
    /// What a white surface that faces it reflects, linear RGB; 1 where it is not given.
    pub strength: Option<Vec<f64>>,
}

/// Camera intrinsics in pixels (pixel corners at integers) or as angles of view in radians.
#[derive(Clone, Debug, Default, Deserialize)]
#[allow(missing_docs)] // The names are those of the format and of OpenCV.
pub struct Intrinsics {
    pub camera_angle_x: Option<f64>,
    pub camera_angle_y: Option<f64>,
    pub fl_x: Option<f64>,
    pub fl_y: Option<f64>,
    pub cx: Option<f64>,
    pub cy: Option<f64>,
    pub w: Option<f64>,
    pub h: Option<f64>,
    /// What a unit of length takes in the image of an orthographic camera.
    pub pixels_per_unit: Option<f64>,
    pub k1: Option<f64>,
    pub k2: Option<f64>,
    pub k3: Option<f64>,
    pub k4: Option<f64>,
    pub p1: Option<f64>,
    pub p2: Option<f64>,
    /// instant-ngp's word for OpenCV's fisheye lens, which is not supported; nor are the two that follow.
    pub is_fisheye: Option<bool>,
    /// Its word for equirectangular pictures.
    pub latlong: Option<bool>,
    /// The first coefficient of its f-theta lens.
    pub ftheta_p0: Option<f64>,
}

/// Reads and parses the file `path`.
///
/// # Errors
/// [`CaptureError`] names the file, and the field where one is at fault.
pub fn read_transforms(path: &Path) -> Result<Transforms, CaptureError> {
    parse_transforms(&read(path)?, path)
}

/// How many frames the file `path` lists, whatever they and their cameras are; none where it is empty.
pub(super) fn count_frames(path: &Path) -> Result<usize, CaptureError> {
    #[derive(Deserialize)]
    struct Frames {
        #[serde(default)]
        frames: Vec<IgnoredAny>,
    }
    let bytes = read(path)?;
    if bytes.trim_ascii().is_empty() {
        return Ok(0);
    }
    let counted = json::parse::<Frames>(&bytes).map_err(|error| not_json(path, &error))?;
    Ok(counted.frames.len())
}

fn read(path: &Path) -> Result<Vec<u8>, CaptureError> {
    read_limited(path, MAX_TRANSFORMS).map_err(|source| CaptureError::Read {
        path: path.into(),
        source,
    })
}

/// Parses `transforms.json` and checks what needs no other file; `path` only names it in errors.
pub fn parse_transforms(bytes: &[u8], path: &Path) -> Result<Transforms, CaptureError> {
    let parsed = json::parse(bytes).map_err(|error| placed(bytes, error));
    let transforms: Transforms = parsed.map_err(|error| not_json(path, &error))?;
    let own = transforms.camera_model.as_deref();
    if let Some(model) = own.filter(|model| projection_of(model).is_none()) {
        return Err(CaptureError::CameraModel {
            path: path.into(),
            model: model.to_owned(),
        });
    }
    transforms.check_names(path)?;
    transforms.check_frames(path)?;
    if transforms.frames.is_empty() {
        return Err(CaptureError::NoFrames { path: path.into() });
    }
    Ok(transforms)
}

/// The error with its field, also where that is an intrinsic.
///
/// Those are shared by two structs and flattened into them, which loses their place: read alone they have it.
fn placed(bytes: &[u8], error: JsonError) -> JsonError {
    #[derive(Deserialize)]
    struct OfFrames {
        #[serde(rename = "frames", deserialize_with = "no_more_than_are_read")]
        _frames: Vec<Intrinsics>,
    }
    if error.is_syntax {
        return error;
    }
    let shared = json::parse::<Intrinsics>(bytes).err();
    let own = || json::parse::<OfFrames>(bytes).err();
    shared
        .into_iter()
        .chain(own())
        .find(|alone| alone.field.len() > error.field.len())
        .unwrap_or(error)
}

/// An error in one line, whatever the names in the text are made of.
fn not_json(path: &Path, error: &JsonError) -> CaptureError {
    CaptureError::Json {
        path: path.into(),
        reason: error.to_string().replace(char::is_control, "\u{fffd}"),
    }
}

/// At most [`MAX_FRAMES`] frames, each of which takes up to a hundred times the memory of its text.
fn no_more_than_are_read<'de, D, T>(list: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Frames<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Frames<T> {
        type Value = Vec<T>;

        fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            formatter.write_str("a sequence")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<T>, A::Error> {
            let mut frames = Vec::new();
            while let Some(frame) = list.next_element()? {
                if frames.len() == MAX_FRAMES {
                    return Err(A::Error::custom(format!(
                        "more than {MAX_FRAMES} frames, the most that are read: leave some out"
                    )));
                }
                frames.push(frame);
            }
            Ok(frames)
        }
    }

    list.deserialize_seq(Frames(PhantomData))
}

/// How cameras of this `camera_model` project; `None` for those that are not supported.
fn projection_of(model: &str) -> Option<Projection> {
    match model {
        ORTHOGRAPHIC => Some(Projection::Orthographic),
        model if PERSPECTIVE.contains(&model) => Some(Projection::Perspective),
        _ => None,
    }
}

impl Transforms {
    /// How its cameras project.
    pub fn projection(&self) -> Projection {
        let own = self.camera_model.as_deref().and_then(projection_of);
        own.unwrap_or(Projection::Perspective)
    }

    /// Refuses names with characters that steer a terminal, or begin a line that looks like a message.
    fn check_names(&self, path: &Path) -> Result<(), CaptureError> {
        let problem = "has control characters; rename the file, and correct the name";
        let bad =
            |name: &Option<String>| name.as_ref().is_some_and(|n| n.contains(char::is_control));
        for frame in &self.frames {
            let names = [
                ("file_path", frame.file_path.contains(char::is_control)),
                ("mask_path", bad(&frame.mask_path)),
                ("scene_name", bad(&frame.scene_name)),
            ];
            if let Some((field, _)) = names.into_iter().find(|(_, bad)| *bad) {
                let at = At {
                    path,
                    frame: &frame.file_path,
                };
                return Err(at.field(field, problem.to_owned()));
            }
        }
        let shared = [
            ("mask_path", &self.mask_path),
            ("ply_file_path", &self.ply_file_path),
        ];
        match shared.into_iter().find(|(_, name)| bad(name)) {
            Some((field, _)) => Err(CaptureError::Json {
                path: path.into(),
                reason: format!("`{field}` {problem}"),
            }),
            None => Ok(()),
        }
    }

    /// Refuses frames that say another kind of camera than the file.
    fn check_frames(&self, path: &Path) -> Result<(), CaptureError> {
        for frame in &self.frames {
            let Some(model) = &frame.camera_model else {
                continue;
            };
            let problem = match projection_of(model) {
                Some(projection) if projection == self.projection() => continue,
                Some(_) => {
                    "but the file's cameras project in another way; say it once, for the file"
                }
                None => {
                    "which is not supported yet; expected a perspective camera (PINHOLE, OPENCV, SIMPLE_RADIAL or RADIAL): \
                     undistort the image to one of them"
                }
            };
            let at = At {
                path,
                frame: &frame.file_path,
            };
            return Err(at.field("camera_model", format!("is {model:?}, {problem}")));
        }
        Ok(())
    }

    /// The rows of a frame's camera-to-world matrix: its own, or those that all share.
    pub fn pose_of<'a>(&'a self, frame: &'a TransformsFrame) -> &'a [Vec<f64>] {
        if frame.transform_matrix.is_empty() {
            &self.transform_matrix
        } else {
            &frame.transform_matrix
        }
    }
}

impl Intrinsics {
    /// These where they are given, else those of `shared`.
    ///
    /// A frame that gives a focal length in either form overrides both shared forms.
    pub fn or(&self, shared: &Self) -> Self {
        let own_focal = self.fl_x.is_some() || self.camera_angle_x.is_some();
        let shared_focal = |value: Option<f64>| value.filter(|_| !own_focal);
        Self {
            camera_angle_x: self.camera_angle_x.or(shared_focal(shared.camera_angle_x)),
            camera_angle_y: self.camera_angle_y.or(shared_focal(shared.camera_angle_y)),
            fl_x: self.fl_x.or(shared_focal(shared.fl_x)),
            fl_y: self.fl_y.or(shared_focal(shared.fl_y)),
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            pixels_per_unit: self.pixels_per_unit.or(shared.pixels_per_unit),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            k4: self.k4.or(shared.k4),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
            latlong: self.latlong.or(shared.latlong),
            ftheta_p0: self.ftheta_p0.or(shared.ftheta_p0),
        }
    }
}
