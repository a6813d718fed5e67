//! `inspection.html`: what was understood, on one self-contained page with pictures.

use std::{fs, io, io::Write, path::Path};

use glam::Vec3;
use render::image::Image;
use serde_json::json;

use super::{FrameInspection, Inspection};
use crate::{
    capture::{Capture, Frame},
    files::atomic,
    image_io::ImageIoError,
    report::{
        pictures::{data_uri, exposure, reduced, tonemapped},
        text::{escaped, number, table},
    },
    wording::counted,
};

/// The page's name in its folder.
pub const PAGE: &str = "inspection.html";
/// The JSON's name in its folder.
pub const JSON: &str = "inspection.json";
/// Most photographs on the page, evenly spread, and their longest side in pixels.
const SHOWN: usize = 24;
const SIDE: usize = 240;
/// The share of the object that must not clip on the page.
const WHITE: f64 = 0.99;
/// Colours of the plan (sRGB): where mask and silhouette agree the photograph is left as it is.
const MASK_ONLY: [f32; 3] = [0.93, 0.36, 0.05];
const MESH_ONLY: [f32; 3] = [0.10, 0.45, 0.85];

/// Why a page could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// A file cannot be written.
    #[error(
        "cannot write the inspection to {folder}: {source}; check that the folder may be written, and that the disk is not full"
    )]
    Write {
        /// The folder.
        folder: String,
        /// What the system said.
        source: io::Error,
    },
    /// A picture cannot be encoded.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// Numbers that JSON cannot hold.
    #[error("cannot write the inspection: {0}")]
    Json(#[from] serde_json::Error),
}

/// Writes the JSON and then the page into `folder`, which is made where it is missing.
///
/// # Errors
/// A file that cannot be written.
pub fn write(folder: &Path, inspection: &Inspection, capture: &Capture) -> Result<(), PageError> {
    let page = html(inspection, capture)?;
    let json = serde_json::to_string_pretty(inspection)? + "\n";
    let put = |name: &str, text: &str| {
        atomic::write(&folder.join(name), |file| file.write_all(text.as_bytes()))
    };
    let written = fs::create_dir_all(folder)
        .and_then(|()| put(JSON, &json))
        .and_then(|()| put(PAGE, &page));
    written.map_err(|source| PageError::Write {
        folder: folder.display().to_string(),
        source,
    })
}

/// The page, without references to anything outside itself.
///
/// # Errors
/// A picture that PNG cannot hold.
pub fn html(inspection: &Inspection, capture: &Capture) -> Result<String, PageError> {
    let name = capture.path.file_name().unwrap_or(capture.path.as_os_str());
    let title = escaped(&name.to_string_lossy());
    let remarks: String = inspection
        .problem
        .iter()
        .chain(&inspection.warnings)
        .map(|remark| format!("<li>{}</li>", escaped(remark)))
        .collect();
    let remarks = if remarks.is_empty() {
        String::new()
    } else {
        format!("<aside><ul>{remarks}</ul></aside>")
    };
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>Inspection of {title}</title>\n<style>\n{style}</style>\n\
         </head>\n<body>\n<header><p class=\"kicker\">Inspection</p><h1>{title}</h1>\n<p class=\"summary\">{summary}</p></header>\n\
         {remarks}<h2>Photographs and silhouettes</h2>\n<p>Orange is mask without mesh, blue is mesh without mask.</p>\n\
         <div class=\"strip\">{pictures}</div>\n<h2>Cameras</h2>\n<p>From above, z towards the reader; the ring is the object.</p>\n\
         <div class=\"wide\">{plan}</div>\n<h2>Numbers</h2>\n<p>Lengths are in the capture's own unit, angles in degrees.</p>\n{table}\n\
         <footer>Written by eclipse {version}.</footer>\n</body>\n</html>\n",
        style = include_str!("../report/style.css"),
        summary = escaped(&summary(inspection)),
        pictures = pictures(inspection, capture)?,
        plan = plan(inspection, capture),
        table = numbers(inspection),
        version = env!("CARGO_PKG_VERSION"),
    ))
}

fn summary(inspection: &Inspection) -> String {
    let verdict = match inspection.problem {
        Some(_) => " A run would refuse the capture.",
        None => "",
    };
    format!(
        "{} ({}) of an object of {}; silhouettes overlap the masks by {:.3}.{verdict}",
        counted(inspection.frames.len(), "photograph"),
        inspection.format,
        counted(inspection.object.faces, "triangle"),
        inspection.silhouettes.median
    )
}

fn pictures(inspection: &Inspection, capture: &Capture) -> Result<String, PageError> {
    let images: Vec<&Image> = capture.frames.iter().map(|frame| &frame.image).collect();
    let exposure = exposure(&images, WHITE, |frame, index| {
        capture.frames[frame].mask.data[index] > 0.5
    });
    let step = capture.frames.len().div_ceil(SHOWN).max(1);
    let chosen = capture.frames.iter().zip(&inspection.frames).step_by(step);
    chosen
        .map(|(frame, numbers)| picture(capture, frame, numbers, exposure))
        .collect()
}

fn picture(
    capture: &Capture,
    frame: &Frame,
    numbers: &FrameInspection,
    exposure: f32,
) -> Result<String, PageError> {
    let silhouette = capture.silhouette(frame, SIDE);
    let mut display = tonemapped(&reduced(&frame.image, SIDE), exposure);
    let mask = reduced(&frame.mask, SIDE);
    for y in 0..display.height {
        for x in 0..display.width {
            let at = |size: usize, of: usize, place: usize| {
                (((place as f32 + 0.5) / of as f32 * size as f32) as usize).min(size - 1)
            };
            let inside = silhouette.pixel(
                at(silhouette.width, display.width, x),
                at(silhouette.height, display.height, y),
            )[0] > 0.5;
            let tint = match (mask.pixel(x, y)[0] > 0.5, inside) {
                (true, false) => MASK_ONLY,
                (false, true) => MESH_ONLY,
                _ => continue,
            };
            display.pixel_mut(x, y).copy_from_slice(&tint);
        }
    }
    Ok(format!(
        "<figure><img alt=\"frame {name}\" src=\"{uri}\"><figcaption>{name}: overlap {overlap:.3}</figcaption></figure>",
        name = escaped(&frame.name),
        uri = data_uri(&display)?,
        overlap = numbers.overlap,
    ))
}

/// The cameras from above as SVG: a dot and its view direction each.
fn plan(inspection: &Inspection, capture: &Capture) -> String {
    let farthest = inspection.cameras.distance[1].max(f32::MIN_POSITIVE);
    let place = |point: Vec3| {
        let [x, y] = [point.x, -point.y].map(|v| 180.0 * v / farthest);
        format!("{x:.1},{y:.1}")
    };
    let cameras: String = capture
        .frames
        .iter()
        .map(|frame| {
            let eye = frame.camera.centre();
            let forwards = -frame.camera.world_from_camera.z_axis.truncate();
            let end = eye + 0.12 * farthest * forwards;
            format!(
                "<polyline class=\"curve\" points=\"{} {}\"><title>{}</title></polyline>",
                place(eye),
                place(end),
                escaped(&frame.name)
            )
        })
        .collect();
    let ring = 180.0 * inspection.object.radius / farthest;
    format!(
        "<svg viewBox=\"-200 -200 400 400\" role=\"img\" aria-label=\"cameras from above\">\
         <circle class=\"grid\" fill=\"none\" r=\"{ring:.1}\"/><text x=\"184\" y=\"4\">x</text><text x=\"-4\" y=\"-186\">y</text>{cameras}</svg>"
    )
}

fn numbers(inspection: &Inspection) -> String {
    let Inspection {
        object,
        cameras,
        exposure,
        coverage,
        run,
        ..
    } = inspection;
    let unused = object.unused.join(", ");
    let unused = (!unused.is_empty()).then(|| format!("{unused}: not used"));
    let triple = |v: [f32; 3]| v.map(|v| number(v.into())).join(" × ");
    let points = inspection.points.as_ref().map(|points| {
        let (count, inside) = (points.count, points.in_box);
        format!("{count}, of which {inside} lie in the mesh's box")
    });
    let light = inspection.limit.map(|limit| limit.sentence());
    let range = |[low, high]: [f32; 2]| {
        let [low, high] = [low, high].map(|v| number(v.into()));
        match low == high {
            true => low,
            false => format!("{low} to {high}"),
        }
    };
    let percent = |share: f32| format!("{} %", number(f64::from(100.0 * share)));
    table(&json!({
        "described_by": inspection.described_by,
        "photographs_left_out": inspection.left_out,
        "object_size": triple(object.size),
        "object_centre": object.centre.map(|v| number(v.into())).join(", "),
        "object_radius": object.radius,
        "also_in_the_mesh_file": unused,
        "camera_distance": range(cameras.distance),
        "camera_elevation": range(cameras.elevation),
        "widest_gap_between_cameras": cameras.widest_gap,
        "tilt_of_the_photographs": cameras.tilt,
        "axis_nearest_to_upward": cameras.nearest_up,
        "upward_of_the_photographs": cameras.upward.map(|v| format!("{v:.2}")).join(","),
        "sparse_points": points,
        "light": light,
        "worst_overlap": format!("{:.3} (frame {})", inspection.silhouettes.worst, inspection.silhouettes.worst_frame),
        "median_level": exposure.median,
        "brightest_frame_over_darkest": exposure.spread,
        "pixels_at_the_maximum": percent(exposure.at_maximum),
        "surface_seen": percent(coverage.seen),
        "surface_seen_by_three": percent(coverage.seen_by_three),
        "views_of_a_place": coverage.mean_views,
        "memory_of_a_run_MiB": run.memory >> 20,
        "seconds_of_solving_at_most": run.solve_seconds,
        "seconds_of_finishing_about": run.finish_seconds,
    }))
}
