//! Whether the mesh, seen through the cameras, lies where the masks show the object; and if not, why.

mod causes;
mod coverage;

use std::fmt;

use glam::Vec3;
use rayon::prelude::*;
use render::{image::Image, mesh::Mesh};

use super::{Capture, CaptureError, Frame, transforms::Transforms};
use causes::{Cause, candidates, measured};
use coverage::{Coarse, overlap};

/// Longest side of the images in which silhouettes are compared.
const SIDE: usize = 128;
/// The same for the many comparisons that look for a cause, and how many frames they use.
const TRIAL_SIDE: usize = 64;
const TRIAL_FRAMES: usize = 8;
/// A cause must bring the overlap at least here, and gain this much, to be named.
const CONVINCING: f32 = 0.7;
const GAIN: f32 = 0.1;
/// What another change must gain over a simpler explanation.
const SIMPLICITY: f32 = 0.03;

/// Intersection over union of the mesh's silhouette with the frame's mask, at 128 pixels.
pub fn mask_overlap(mesh: &Mesh, frame: &Frame) -> f32 {
    overlap(
        &mesh.positions,
        &mesh.faces,
        &frame.camera,
        &frame.mask,
        false,
        SIDE,
    )
}

impl Capture {
    /// The mesh's silhouette through a frame's camera: one channel, 1 inside, the longer side at most `side` pixels.
    pub fn silhouette(&self, frame: &Frame, side: usize) -> Image {
        let Mesh {
            positions, faces, ..
        } = &self.mesh;
        let full = [frame.camera.width, frame.camera.height];
        let (covered, [width, height]) =
            coverage::silhouette(positions, faces, &frame.camera, full, side);
        Image {
            width,
            height,
            channels: 1,
            data: covered
                .into_iter()
                .map(|inside| f32::from(u8::from(inside)))
                .collect(),
        }
    }
}

/// Refuses a capture whose median overlap is below `expected`, with the likely cause.
pub(super) fn check(
    capture: &Capture,
    transforms: &Transforms,
    expected: f32,
) -> Result<(), CaptureError> {
    if expected <= 0.0 || median_overlap(capture) >= expected {
        return Ok(());
    }
    Err(CaptureError::Disagreement(diagnose(
        capture, transforms, expected,
    )))
}

/// Tries what usually goes wrong, simplest first, and keeps what explains the masks best.
pub(super) fn diagnose(capture: &Capture, transforms: &Transforms, expected: f32) -> Diagnosis {
    let found = median_overlap(capture);
    let filled = median(capture.frames.iter().map(|frame| {
        frame
            .mask
            .data
            .iter()
            .filter(|&&coverage| coverage > 0.5)
            .count() as f32
            / frame.mask.data.len() as f32
    }));
    if filled > 0.99 {
        return Diagnosis {
            found,
            expected,
            cause: Some(Explanation::FullMasks),
        };
    }
    let step = capture.frames.len().div_ceil(TRIAL_FRAMES);
    let frames: Vec<&Frame> = capture.frames.iter().step_by(step).collect();
    let coarse = Coarse::new(&capture.mesh, TRIAL_SIDE);
    let try_on = |cause: &Cause, positions: &[Vec3], faces: &[[u32; 3]], side| {
        let moved: Vec<Vec3> = positions
            .iter()
            .map(|&p| cause.mesh.transform_point3(p + capture.centre))
            .collect();
        median(frames.iter().map(|frame| {
            let camera = cause.camera_from(&frame.camera, capture.centre);
            overlap(
                &moved,
                faces,
                &camera,
                &frame.mask,
                cause.inverted_masks,
                side,
            )
        }))
    };
    let mut causes = candidates(capture.centre, transforms);
    causes.extend(factor_of_size(&frames, &coarse, capture.centre).map(measured));
    let overlaps: Vec<f32> = causes
        .par_iter()
        .map(|cause| try_on(cause, &coarse.positions, &coarse.faces, TRIAL_SIDE))
        .collect();
    let mut best: Option<(&Cause, f32)> = None;
    for (cause, overlap) in causes.iter().zip(overlaps) {
        if best.is_none_or(|(simpler, to_beat)| {
            overlap
                > to_beat
                    + if cause.changes > simpler.changes {
                        SIMPLICITY
                    } else {
                        0.0
                    }
        }) {
            best = Some((cause, overlap));
        }
    }
    let cause = best.map(|(cause, _)| {
        (
            cause,
            try_on(cause, &capture.mesh.positions, &capture.mesh.faces, SIDE),
        )
    });
    let cause = cause.filter(|(_, overlap)| *overlap >= CONVINCING && *overlap >= found + GAIN);
    let cause = cause.map(|(cause, overlap)| Explanation::Change {
        cause: cause.name.clone(),
        remedy: cause.remedy.clone(),
        overlap,
    });
    Diagnosis {
        found,
        expected,
        cause,
    }
}

/// By what the mesh would have to be scaled about the origin of its own frame for its silhouettes to be as large as the masks.
fn factor_of_size(frames: &[&Frame], mesh: &Coarse, centre: Vec3) -> Option<f32> {
    /// Perspective bends what areas say of a mesh that is far too large.
    const ROUNDS: usize = 6;
    let mut factor = 1.0f32;
    for _ in 0..ROUNDS {
        let moved = mesh
            .positions
            .iter()
            .map(|&p| (p + centre) * factor - centre);
        let moved: Vec<Vec3> = moved.collect();
        let ratios = frames.iter().filter_map(|frame| {
            let full = [frame.mask.width, frame.mask.height];
            let (covered, _) =
                coverage::silhouette(&moved, &mesh.faces, &frame.camera, full, TRIAL_SIDE);
            let seen = covered.iter().filter(|&&inside| inside).count() as f32;
            let shown = frame.mask.data.iter().filter(|&&mask| mask > 0.5).count() as f32;
            let shares = [
                seen / covered.len() as f32,
                shown / frame.mask.data.len() as f32,
            ];
            (shares.iter().all(|&share| share > 0.0)).then(|| (shares[1] / shares[0]).sqrt())
        });
        factor *= median(ratios);
    }
    (factor.is_finite() && factor > 0.0).then_some(factor)
}

fn median_overlap(capture: &Capture) -> f32 {
    let overlaps: Vec<f32> = capture
        .frames
        .par_iter()
        .map(|frame| mask_overlap(&capture.mesh, frame))
        .collect();
    median(overlaps.into_iter())
}

fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// How far mesh and masks disagree, and what would reconcile them.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    found: f32,
    expected: f32,
    cause: Option<Explanation>,
}

#[derive(Clone, Debug)]
enum Explanation {
    FullMasks,
    Change {
        cause: String,
        remedy: String,
        overlap: f32,
    },
}

impl Diagnosis {
    /// Whether a likely cause was found.
    pub fn is_explained(&self) -> bool {
        self.cause.is_some()
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self {
            found,
            expected,
            cause,
        } = self;
        write!(
            f,
            "the mesh's silhouettes overlap the masks by {found:.2} (median intersection over union; at least {expected:.2} is \
             expected). "
        )?;
        match cause {
            Some(Explanation::FullMasks) => {
                write!(
                    f,
                    "The masks cover whole images: give masks, or an alpha channel, that cover the object only"
                )
            }
            Some(Explanation::Change {
                cause,
                remedy,
                overlap,
            }) => {
                write!(
                    f,
                    "Likely cause: {cause} (the overlap would be {overlap:.2}); {remedy}"
                )
            }
            None => write!(
                f,
                "No common cause (up axis, mirroring, unit, camera axes, inverted masks) explains it: check that the mesh, the \
                 poses and the focal length belong together, and that masks are bright where the object is"
            ),
        }
    }
}
