//! What was understood of a capture, before anyone waits for a reconstruction.

mod coverage;
mod exposure;
pub mod limit;
pub mod page;
mod warnings;

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use glam::Vec3;
use rayon::prelude::*;
use render::camera::Projection;
use serde::Serialize;

pub use coverage::CoverageInspection;
pub use exposure::ExposureInspection;
pub use limit::LimitInspection;

use crate::{
    capture::{
        Capture, CaptureError, Frame, Lamps, LoadOptions, Source, UpAxis, formats::read_points,
        mask_overlap,
    },
    mesh_io::looks_of,
    reconstruct::{self, ReconstructError, paper::batch::COVERED},
    settings::Settings,
};

/// Core-seconds that materials, renders and the report take a pixel of the object at the end: about 8 s on two cores for 64
/// photographs of 128 × 128 pixels.
const FINISH_SECONDS: f64 = 4e-5;

/// What was understood of a capture; its JSON is what `--json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// The capture's folder.
    pub capture: PathBuf,
    /// The format of its description.
    pub format: &'static str,
    /// The file that names the photographs.
    pub described_by: PathBuf,
    /// Photographs kept for validation and tests, which a run leaves out.
    pub left_out: usize,
    /// Every photograph.
    pub frames: Vec<FrameInspection>,
    /// The object.
    pub object: ObjectInspection,
    /// How the cameras stand around it.
    pub cameras: CamerasInspection,
    /// The lamps, where the light is known.
    pub lamps: Option<LampsInspection>,
    /// How the mesh's silhouettes and the masks agree.
    pub silhouettes: SilhouettesInspection,
    /// Levels of the photographs on the object.
    pub exposure: ExposureInspection,
    /// How much of the surface is seen.
    pub coverage: CoverageInspection,
    /// What the photographs can tell of the light at best.
    pub limit: Option<LimitInspection>,
    /// Sparse points of COLMAP or nerfstudio, where they are there.
    pub points: Option<PointsInspection>,
    /// What a run with default options takes.
    pub run: RunInspection,
    /// What may spoil a reconstruction.
    pub warnings: Vec<String>,
    /// Why a run would refuse the capture, where it would.
    pub problem: Option<String>,
}

/// One photograph.
#[derive(Clone, Debug, Serialize)]
pub struct FrameInspection {
    /// Its name.
    pub name: String,
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Whether its camera is orthographic.
    pub orthographic: bool,
    /// Focal lengths in pixels; of an orthographic camera the pixels that a unit of length takes.
    pub focal: [f32; 2],
    /// Distance of the camera from the object's middle, in the capture's unit.
    pub distance: f32,
    /// Direction of the camera as seen from the object, from +x towards +y, in degrees.
    pub azimuth: f32,
    /// Its height above the horizon in degrees.
    pub elevation: f32,
    /// The share of the picture that the object fills.
    pub filled: f32,
    /// Intersection over union of the mesh's silhouette with the mask.
    pub overlap: f32,
    /// Median level of the object, linear.
    pub median: f32,
}

/// The object's shape, in the capture's own frame.
#[derive(Clone, Debug, Serialize)]
pub struct ObjectInspection {
    /// The file of the shape; none where it is told in words.
    pub file: Option<PathBuf>,
    /// Other meshes of the capture, which are not used.
    pub passed_over: Vec<PathBuf>,
    /// Triangles.
    pub faces: usize,
    /// Vertices.
    pub vertices: usize,
    /// Whether its vertices have texture coordinates.
    pub textured: bool,
    /// What its file says of its looks, which nothing is made of: `textures`, `vertex colours`, `materials`.
    pub unused: Vec<&'static str>,
    /// The middle of its bounding box.
    pub centre: [f32; 3],
    /// The sides of its bounding box.
    pub size: [f32; 3],
    /// Radius of the sphere around the middle that holds it.
    pub radius: f32,
}

/// How cameras stand around the object. Angles are in degrees.
#[derive(Clone, Debug, Serialize)]
pub struct CamerasInspection {
    /// Least and greatest distance.
    pub distance: [f32; 2],
    /// Least and greatest elevation.
    pub elevation: [f32; 2],
    /// The widest sector around z that no camera stands in.
    pub widest_gap: f32,
    /// Angle between the photographs' mean upward direction and the world's z.
    pub tilt: f32,
    /// The axis of the capture's own world that is nearest to that direction, as `--up` takes it.
    pub nearest_up: Cow<'static, str>,
    /// That direction itself in the capture's own world, of length 1.
    pub upward: [f32; 3],
}

/// Known lamps, one a photograph.
#[derive(Clone, Debug, Serialize)]
pub struct LampsInspection {
    /// Angle between each lamp and the direction to its camera, degrees.
    pub angles: Vec<f32>,
    /// Strength of each, linear RGB.
    pub strengths: Vec<[f32; 3]>,
    /// The largest angle between two of them, degrees.
    pub spread: f32,
    /// Whether the object is a ball.
    pub ball: bool,
}

/// Overlaps of silhouettes and masks (intersection over union).
#[derive(Clone, Debug, Serialize)]
pub struct SilhouettesInspection {
    /// Of the frame in the middle.
    pub median: f32,
    /// Of the worst frame.
    pub worst: f32,
    /// Its name.
    pub worst_frame: String,
}

/// Sparse points.
#[derive(Clone, Debug, Serialize)]
pub struct PointsInspection {
    /// How many.
    pub count: usize,
    /// How many of them lie in the object's bounding box, a tenth larger.
    pub in_box: usize,
}

/// What a run takes.
#[derive(Clone, Debug, Serialize)]
pub struct RunInspection {
    /// Planned peak of memory in bytes.
    pub memory: u64,
    /// Memory allowed in bytes.
    pub memory_allowed: u64,
    /// Most seconds of solving.
    pub solve_seconds: f64,
    /// About the seconds that pictures and scores take after it.
    pub finish_seconds: f64,
    /// Threads counted on.
    pub threads: usize,
}

/// Reads a capture and says what was understood; with it the capture, for pictures.
///
/// A capture whose mesh and masks disagree, or that needs more memory than the settings allow, is inspected all the same, with that as
/// its problem.
///
/// # Errors
/// A capture that cannot be read.
pub fn inspect(
    path: &Path,
    options: LoadOptions,
    settings: &Settings,
) -> Result<(Inspection, Capture), CaptureError> {
    let (source, up) = (Capture::describe(path, &options)?, options.up);
    let (capture, problem) = match Capture::load(path, &options) {
        Ok(capture) => (capture, None),
        Err(CaptureError::Disagreement(diagnosis)) => {
            let problem = CaptureError::Disagreement(diagnosis);
            let unchecked = LoadOptions {
                min_overlap: 0.0,
                ..options
            };
            // Where even that fails, the disagreement is still what explains it.
            match Capture::load(path, &unchecked) {
                Ok(capture) => (capture, Some(problem.to_string())),
                Err(_) => return Err(problem),
            }
        }
        Err(error) => return Err(error),
    };
    let problem = problem
        .or_else(|| too_large(&capture, settings))
        .or_else(|| nothing_to_fit(&capture));
    let inspection = of_capture(&capture, &source, up, settings, problem);
    Ok((inspection, capture))
}

/// Why a run would refuse the capture for its size, where it would.
fn too_large(capture: &Capture, settings: &Settings) -> Option<String> {
    // Where lamps are known there is no run, and a diagnosis has no such bound.
    let checked = match capture.lamps {
        None => reconstruct::check_memory(capture, settings),
        Some(_) => Ok(()),
    };
    checked.err().map(|error| error.to_string())
}

/// Why a run would find no pixel that it can use, where it would: --max-size may leave none that shows the object alone.
fn nothing_to_fit(capture: &Capture) -> Option<String> {
    let whole = |frame: &Frame| frame.mask.data.iter().any(|&mask| mask > COVERED);
    let error = ReconstructError::NothingToFit;
    (!capture.frames.iter().any(whole)).then(|| error.to_string())
}

fn of_capture(
    capture: &Capture,
    source: &Source,
    up: UpAxis,
    settings: &Settings,
    problem: Option<String>,
) -> Inspection {
    let frames: Vec<FrameInspection> = capture
        .frames
        .par_iter()
        .map(|frame| of_frame(capture, frame))
        .collect();
    // A run does without them.
    let points = source.points.as_deref().map(read_points).transpose();
    let (points, unread) = match points {
        Ok(points) => (points.flatten(), None),
        Err(error) => (
            None,
            Some(format!("the sparse points say nothing: {error}")),
        ),
    };
    // Where lamps are known there is no environment to be found.
    let glance = capture.lamps.is_none();
    let glance = glance.then(|| limit::at_a_glance(capture, u64::MAX));
    let (limit, untold) = match glance.transpose() {
        Ok(limit) => (limit, None),
        Err(error) => (
            None,
            Some(format!(
                "what can be told of the light was left out: {error}"
            )),
        ),
    };
    let mut inspection = Inspection {
        capture: capture.path.clone(),
        format: source.format,
        described_by: source.path.clone(),
        left_out: source.left_out,
        object: object(capture, source),
        cameras: cameras(capture, up, &frames),
        lamps: capture.lamps.as_ref().map(|known| lamps(capture, known)),
        silhouettes: silhouettes(&frames),
        exposure: exposure::inspect(capture, &frames),
        coverage: coverage::inspect(capture),
        limit,
        points: points.map(|points| of_points(capture, up, &points)),
        run: run(capture, settings),
        frames,
        warnings: Vec::new(),
        problem,
    };
    inspection.warnings = warnings::all(&inspection);
    inspection.warnings.extend(source.notes.iter().cloned());
    inspection.warnings.extend(unread);
    inspection.warnings.extend(untold);
    inspection
}

/// What there is to say of the cameras of a capture before it is reconstructed: of frames whose silhouettes do not overlap their masks
/// as they should, and, where `upright` occluders are looked for, of a world that is not z up, `turned` being what was said of it.
pub fn of_cameras(capture: &Capture, turned: UpAxis, upright: bool) -> Vec<String> {
    let frames = capture.frames.par_iter();
    let overlaps: Vec<(&str, f32)> = frames
        .map(|frame| (&*frame.name, mask_overlap(&capture.mesh, frame)))
        .collect();
    let (tilt, nearest_up, _) = upward(capture, turned);
    warnings::of_overlaps(&overlaps)
        .into_iter()
        .chain(warnings::of_tilt(tilt, &nearest_up).filter(|_| upright))
        .collect()
}

fn of_frame(capture: &Capture, frame: &Frame) -> FrameInspection {
    let camera = &frame.camera;
    let centre = camera.centre();
    FrameInspection {
        name: frame.name.clone(),
        width: camera.width,
        height: camera.height,
        orthographic: camera.projection == Projection::Orthographic,
        focal: camera.focal,
        distance: camera.distance(),
        azimuth: centre.y.atan2(centre.x).to_degrees(),
        elevation: centre.z.atan2(centre.truncate().length()).to_degrees(),
        filled: covered(frame) as f32 / frame.mask.data.len() as f32,
        overlap: mask_overlap(&capture.mesh, frame),
        median: exposure::median_level(frame),
    }
}

/// Pixels that show the object.
fn covered(frame: &Frame) -> usize {
    frame.mask.data.iter().filter(|&&m| m > 0.5).count()
}

fn object(capture: &Capture, source: &Source) -> ObjectInspection {
    let mesh = &capture.mesh;
    let [low, high] = mesh.bounds();
    ObjectInspection {
        file: source.mesh.clone(),
        passed_over: source.other_meshes.clone(),
        faces: mesh.faces.len(),
        vertices: mesh.positions.len(),
        textured: !mesh.uvs.is_empty(),
        unused: source.mesh.as_deref().map_or(Vec::new(), looks_of),
        centre: capture.centre.to_array(),
        size: (high - low).to_array(),
        radius: mesh.bounding_radius(),
    }
}

fn cameras(capture: &Capture, turned: UpAxis, frames: &[FrameInspection]) -> CamerasInspection {
    let range = |of: fn(&FrameInspection) -> f32| {
        let values = frames.iter().map(of);
        [
            values.clone().fold(f32::INFINITY, f32::min),
            values.fold(f32::NEG_INFINITY, f32::max),
        ]
    };
    let mut azimuths: Vec<f32> = frames.iter().map(|frame| frame.azimuth).collect();
    azimuths.sort_by(f32::total_cmp);
    let around = azimuths.first().map(|first| first + 360.0);
    let next = azimuths.iter().skip(1).copied().chain(around);
    let gaps = azimuths.iter().zip(next).map(|(from, to)| to - from);
    let (tilt, nearest_up, in_files) = upward(capture, turned);
    CamerasInspection {
        distance: range(|frame| frame.distance),
        elevation: range(|frame| frame.elevation),
        widest_gap: gaps.fold(0.0, f32::max),
        tilt,
        nearest_up,
        upward: in_files.to_array(),
    }
}

/// By how many degrees the photographs' upward direction is off z; among the axes of the files, in which `--up` is said, the nearest one
/// to it, and the direction itself.
fn upward(capture: &Capture, turned: UpAxis) -> (f32, Cow<'static, str>, Vec3) {
    let upward: Vec3 = capture
        .frames
        .iter()
        .map(|frame| frame.camera.world_from_camera.y_axis.truncate())
        .sum();
    let in_files = (turned.turn().transpose() * upward).normalize_or(Vec3::Z);
    let tilt = upward.normalize_or(Vec3::Z).angle_between(Vec3::Z);
    (
        tilt.to_degrees(),
        UpAxis::nearest(in_files).name(),
        in_files,
    )
}

fn lamps(capture: &Capture, known: &Lamps) -> LampsInspection {
    let directions: Vec<Vec3> = known.lamps.iter().map(|lamp| lamp.direction).collect();
    let angle = |a: Vec3, b: Vec3| a.angle_between(b).to_degrees();
    let frames = capture.frames.iter().zip(&directions);
    let pairs = directions
        .iter()
        .flat_map(|&a| directions.iter().map(move |&b| angle(a, b)));
    LampsInspection {
        angles: frames
            .map(|(frame, &lamp)| angle(frame.camera.direction_from(Vec3::ZERO), lamp))
            .collect(),
        strengths: known.lamps.iter().map(|lamp| lamp.strength).collect(),
        spread: pairs.fold(0.0, f32::max),
        ball: known.ball,
    }
}

fn silhouettes(frames: &[FrameInspection]) -> SilhouettesInspection {
    let mut sorted: Vec<&FrameInspection> = frames.iter().collect();
    sorted.sort_by(|a, b| a.overlap.total_cmp(&b.overlap));
    SilhouettesInspection {
        median: sorted.get(sorted.len() / 2).map_or(0.0, |f| f.overlap),
        worst: sorted.first().map_or(0.0, |f| f.overlap),
        worst_frame: sorted.first().map_or(String::new(), |f| f.name.clone()),
    }
}

/// `points` in the axes of the files, the capture being turned so that their `up` is z.
fn of_points(capture: &Capture, up: UpAxis, points: &[Vec3]) -> PointsInspection {
    let [low, high] = capture.mesh.bounds();
    let (margin, turn) = (0.05 * (high - low), up.turn());
    let inside = |point: &&Vec3| {
        let point = turn * **point - capture.centre;
        point.cmpge(low - margin).all() && point.cmple(high + margin).all()
    };
    PointsInspection {
        count: points.len(),
        in_box: points.iter().filter(inside).count(),
    }
}

fn run(capture: &Capture, settings: &Settings) -> RunInspection {
    let pixels: usize = capture.frames.iter().map(covered).sum();
    RunInspection {
        memory: reconstruct::memory(capture, settings),
        memory_allowed: settings.memory,
        solve_seconds: settings.time_limit.unwrap_or(f64::INFINITY),
        finish_seconds: FINISH_SECONDS * pixels as f64 / settings.threads as f64,
        threads: settings.threads,
    }
}
