//! What may spoil a reconstruction: one sentence each, with what to do.

use std::path::Path;

use super::{Inspection, ObjectInspection};
use crate::wording::counted;

/// Overlaps below this are poor.
const POOR_OVERLAP: f32 = 0.8;
/// A sector without cameras that is wider than this leaves the far side's light untold.
const WIDE_GAP: f32 = 120.0;
/// A tilt beyond this is a world that is not z up: people hold cameras at an angle, but not on their side.
const TILTED: f32 = 60.0;
/// Medians further apart than this are no longer the shading alone: in a room with a window the lit side of an object is some
/// five times as bright as the other.
const UNEVEN: f32 = 10.0;
/// A share of pixels at the maximum that is no accident.
const CLIPPED: f32 = 0.005;
/// Fewer photographs than this hardly tell occluders from light.
const FEW: usize = 12;

pub(super) fn all(inspection: &Inspection) -> Vec<String> {
    let always = [
        meshes(inspection),
        poor_overlap(inspection),
        clipped(inspection),
        black(inspection),
        points(inspection),
    ];
    // Known light asks for no walk around the object, and lamps need not be alike.
    let unknown_light = [few, gap, tilt, uneven];
    let of_light = unknown_light
        .into_iter()
        .filter(|_| inspection.lamps.is_none());
    of_light
        .filter_map(|warning| warning(inspection))
        .chain(always.into_iter().flatten())
        .collect()
}

fn meshes(inspection: &Inspection) -> Option<String> {
    let ObjectInspection {
        file, passed_over, ..
    } = &inspection.object;
    let others: Vec<String> = passed_over.iter().map(|path| name(path)).collect();
    (!others.is_empty()).then(|| {
        format!(
            "{} is there too and not used, the mesh being {}: remove what is not meant, or name the mesh with --mesh",
            others.join(", "),
            file.as_deref().map_or("another".to_owned(), name)
        )
    })
}

fn name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

fn few(inspection: &Inspection) -> Option<String> {
    let count = inspection.frames.len();
    (count < FEW).then(|| {
        format!(
            "only {}: occluders are told from light by many; take a few dozen",
            counted(count, "photograph")
        )
    })
}

fn poor_overlap(inspection: &Inspection) -> Option<String> {
    let poor: Vec<&str> = inspection
        .frames
        .iter()
        .filter(|frame| frame.overlap < POOR_OVERLAP)
        .map(|frame| &*frame.name)
        .collect();
    let first = poor.iter().take(5).copied().collect::<Vec<_>>().join(", ");
    let more = if poor.len() > 5 { ", …" } else { "" };
    (!poor.is_empty()).then(|| {
        format!(
            "{} of {} silhouettes overlap their masks by less than {POOR_OVERLAP} ({first}{more}): check their masks and poses",
            poor.len(),
            inspection.frames.len()
        )
    })
}

fn gap(inspection: &Inspection) -> Option<String> {
    let gap = inspection.cameras.widest_gap;
    (gap > WIDE_GAP).then(|| {
        format!("no camera stands in a sector of {gap:.0}° around the object: walk all the way around it")
    })
}

fn tilt(inspection: &Inspection) -> Option<String> {
    let tilt = inspection.cameras.tilt;
    (tilt > TILTED).then(|| {
        format!(
            "the photographs' upward direction is {tilt:.0}° off the world's z axis, which an operator is taken to stand along: say \
             which axis points up, probably with --up {}, or use --occluder-prior none",
            inspection.cameras.nearest_up
        )
    })
}

fn uneven(inspection: &Inspection) -> Option<String> {
    let spread = inspection.exposure.spread;
    (spread > UNEVEN).then(|| {
        format!("the brightest photograph shows the object {spread:.1} times as bright as the darkest: all must share one exposure")
    })
}

fn clipped(inspection: &Inspection) -> Option<String> {
    let share = inspection.exposure.at_maximum;
    (share > CLIPPED).then(|| {
        format!(
            "{:.1} % of the object's pixels stand at the greatest value, {}: highlights are clipped; expose less, or use raw or HDR photographs",
            100.0 * share,
            inspection.exposure.maximum
        )
    })
}

fn black(inspection: &Inspection) -> Option<String> {
    let frame = inspection.frames.iter().find(|frame| frame.median <= 0.0)?;
    Some(format!(
        "frame {:?} shows the object black: leave it out, or correct its mask",
        frame.name
    ))
}

fn points(inspection: &Inspection) -> Option<String> {
    let points = inspection.points.as_ref()?;
    (points.count > 0 && points.in_box == 0).then(|| {
        format!(
            "none of the {} sparse points lies in the mesh's box: bring the mesh into the frame of points and cameras",
            points.count
        )
    })
}
