//! What may spoil a reconstruction: one sentence each, with what to do.

use std::path::Path;

use super::{Inspection, ObjectInspection};
use crate::wording::counted;

/// Overlaps below this are poor.
const POOR_OVERLAP: f32 = 0.8;
/// Overlaps that are this far below the median are poor as well: outlines of one mesh are about as good from everywhere.
const FAR_BELOW: f32 = 0.1;
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
    let frames = inspection.frames.iter();
    let overlaps: Vec<(&str, f32)> = frames.map(|frame| (&*frame.name, frame.overlap)).collect();
    // Why a run would refuse them says more.
    of_overlaps(&overlaps).filter(|_| inspection.problem.is_none())
}

/// What there is to say of frames, by name and how far the mesh's silhouette overlaps the mask, whose pose or mask is wrong: those
/// that overlap poorly, and those that do so far less than most.
pub(super) fn of_overlaps(frames: &[(&str, f32)]) -> Option<String> {
    let mut sorted: Vec<f32> = frames.iter().map(|(_, overlap)| *overlap).collect();
    sorted.sort_by(f32::total_cmp);
    let median = *sorted.get(sorted.len() / 2)?;
    let least = POOR_OVERLAP.max(median - FAR_BELOW);
    let poor = frames.iter().filter(|(_, overlap)| *overlap < least);
    let names: Vec<&str> = poor.map(|(name, _)| *name).collect();
    let first = names.iter().take(5).copied().collect::<Vec<_>>().join(", ");
    let more = if names.len() > 5 { ", …" } else { "" };
    (!names.is_empty()).then(|| {
        format!(
            "{} of {} silhouettes overlap their masks by less than {least:.2}, where the median is {median:.2} ({first}{more}): check \
             their masks and poses",
            names.len(),
            frames.len()
        )
    })
}

/// Whether most silhouettes overlap their masks well: where they do not, poses tell nothing of how the cameras stand.
fn poses_are_good(inspection: &Inspection) -> bool {
    inspection.silhouettes.median >= POOR_OVERLAP
}

fn gap(inspection: &Inspection) -> Option<String> {
    let gap = inspection.cameras.widest_gap;
    (gap > WIDE_GAP && poses_are_good(inspection)).then(|| {
        format!("no camera stands in a sector of {gap:.0}° around the object: walk all the way around it")
    })
}

fn tilt(inspection: &Inspection) -> Option<String> {
    let cameras = &inspection.cameras;
    of_tilt(cameras.tilt, &cameras.nearest_up).filter(|_| poses_are_good(inspection))
}

/// What there is to say of photographs whose upward direction is `tilt` degrees off z and nearest to another axis.
pub(super) fn of_tilt(tilt: f32, nearest_up: &str) -> Option<String> {
    (tilt > TILTED).then(|| {
        format!(
            "the photographs' upward direction is {tilt:.0}° off the world's z axis, which an operator is taken to stand along: say \
             which axis points up, probably with --up {nearest_up}, or use --occluder-prior none"
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_wrong_pose_among_good_ones_is_told() {
        let good = [("a", 0.97), ("b", 0.95), ("c", 0.91), ("d", 0.98)];
        assert_eq!(of_overlaps(&good), None);
        assert_eq!(of_overlaps(&[]), None);
        let one = [good.as_slice(), &[("e", 0.84)]].concat();
        let told = of_overlaps(&one).unwrap();
        assert!(told.starts_with("1 of 5") && told.contains("(e)"), "{told}");
        // Where the mesh is rough all around, no pose is worse than others.
        let rough = [("a", 0.84), ("b", 0.85), ("c", 0.81)];
        assert_eq!(of_overlaps(&rough), None);
    }
}
