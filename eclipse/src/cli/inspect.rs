//! `eclipse inspect`.

use std::{io::Write, path::PathBuf};

use clap::Args;

use super::{Failure, Outcome, arguments::ReadingArguments, print, taken, units};
use crate::{
    inspect::{self, Inspection, LampsInspection, ObjectInspection, page},
    settings::Settings,
    wording::counted,
};

/// Degrees of tilt from which the direction of upward is told: less is the way people hold cameras.
const LEANING: f32 = 15.0;

const INSPECT_EXAMPLES: &str = "Examples:
  eclipse inspect my-capture
  eclipse inspect my-capture --mesh scan.ply --out out/inspection
  eclipse inspect my-capture --json
  eclipse inspect my-colmap --up -y   # a COLMAP model whose y points down";

#[derive(Args, Debug)]
#[command(after_help = INSPECT_EXAMPLES)]
pub(super) struct InspectArguments {
    /// Folder with photographs, their cameras and a mesh.
    pub capture: PathBuf,
    /// Mesh to use in place of the capture's own.
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// Folder for a page with pictures (inspection.html) and the JSON.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub reading: ReadingArguments,
}

pub(super) fn run(arguments: &InspectArguments, out: &mut dyn Write) -> Result<Outcome, Failure> {
    let settings = Settings::default();
    let options = arguments.reading.options(arguments.mesh.as_deref());
    let (inspection, capture) =
        inspect::inspect(&arguments.capture, options, &settings).map_err(Failure::bad_input)?;
    // A capture that cannot be read leaves no folder behind.
    let _lock = arguments.out.as_deref().map(taken).transpose()?;
    if let Some(folder) = &arguments.out {
        page::write(folder, &inspection, &capture).map_err(Failure::failed)?;
    }
    let mut shown = if arguments.json {
        serde_json::to_string_pretty(&inspection).map_err(Failure::failed)? + "\n"
    } else {
        text(&inspection)
    };
    if let (Some(folder), false) = (&arguments.out, arguments.json) {
        let (page, json) = (folder.join(page::PAGE), page::JSON);
        shown += &format!("wrote {} and {json}\n", page.display());
    }
    print(out, &shown)?;
    match inspection.problem {
        // What was understood is worth showing, but a script must learn that a run would refuse the capture.
        Some(problem) => Err(Failure::bad_input(problem)),
        None => Ok(Outcome::Done),
    }
}

/// The inspection for people, a line a subject.
fn text(inspection: &Inspection) -> String {
    let Inspection {
        object,
        silhouettes,
        exposure,
        coverage,
        run,
        ..
    } = inspection;
    let [x, y, z] = object.size;
    let [cx, cy, cz] = object.centre;
    let mut lines = vec![
        (
            "capture",
            format!(
                "{}, {}",
                inspection.described_by.display(),
                inspection.format
            ),
        ),
        ("frames", frames(inspection)),
        ("object", self::object(object)),
        (
            "",
            format!(
                "{x:.4} × {y:.4} × {z:.4} large, radius {:.4}, around ({cx:.4}, {cy:.4}, {cz:.4})",
                object.radius
            ),
        ),
        ("cameras", self::cameras(inspection)),
        (
            "silhouettes",
            format!(
                "overlap the masks by {:.3} (median), {:.3} at worst (frame {})",
                silhouettes.median, silhouettes.worst, silhouettes.worst_frame
            ),
        ),
        (
            "exposure",
            format!(
                "object at {:.3} (median), brightest frame {:.2} times the darkest, {:.2} % of pixels at the maximum {:.3}",
                exposure.median,
                exposure.spread,
                100.0 * exposure.at_maximum,
                exposure.maximum
            ),
        ),
        (
            "coverage",
            format!(
                "{:.0} % of the surface seen, {:.0} % by three photographs or more, {:.1} views of a place",
                100.0 * coverage.seen,
                100.0 * coverage.seen_by_three,
                coverage.mean_views
            ),
        ),
    ];
    if let Some(limit) = &inspection.limit {
        let value = format!("{} (eclipse study limit says more)", limit.sentence());
        lines.push(("light", value));
    }
    if let Some(lamps) = &inspection.lamps {
        lines.push(("lamps", self::lamps(lamps)));
    }
    if let Some(points) = &inspection.points {
        let value = format!(
            "{} sparse points, {} in the mesh's box",
            points.count, points.in_box
        );
        lines.push(("points", value));
    }
    lines.push(if inspection.lamps.is_some() {
        let value = format!("eclipse diagnose {}", inspection.capture.display());
        ("compare with", value)
    } else {
        let value = format!(
            "about {} of {} memory, at most {:.0} s of solving by default, then about {:.0} s for pictures ({} threads)",
            units::bytes(run.memory),
            units::bytes(run.memory_allowed),
            run.solve_seconds,
            run.finish_seconds,
            run.threads
        );
        ("a run takes", value)
    });
    lines.extend(
        inspection
            .warnings
            .iter()
            .map(|warning| ("warning", warning.clone())),
    );
    lines
        .into_iter()
        .map(|(name, value)| format!("{name:<12} {value}\n"))
        .collect()
}

fn cameras(inspection: &Inspection) -> String {
    let cameras = &inspection.cameras;
    let scale = inspection.frames.iter().find(|frame| frame.orthographic);
    let how_far = match scale {
        Some(frame) => format!("orthographic, {} pixels a unit", frame.focal[0]),
        None => format!(
            "{:.4} to {:.4} away",
            cameras.distance[0], cameras.distance[1]
        ),
    };
    let upward = match cameras.tilt > LEANING {
        true => {
            let [x, y, z] = cameras.upward;
            format!(" (in the capture's own axes they hold {x:.2},{y:.2},{z:.2} upwards)")
        }
        false => String::new(),
    };
    format!(
        "{how_far}, {:.0}° to {:.0}° high, widest gap around {:.0}°, tilt {:.0}°{upward}",
        cameras.elevation[0], cameras.elevation[1], cameras.widest_gap, cameras.tilt
    )
}

fn object(object: &ObjectInspection) -> String {
    let coordinates = match object.textured {
        true => ", with texture coordinates",
        false => "",
    };
    let unused = match &*object.unused {
        [] => String::new(),
        unused => format!(
            "; only its shape is used, not the {} of its file",
            unused.join(" and ")
        ),
    };
    let file = object
        .file
        .as_deref()
        .map_or(String::new(), |file| format!("{}: ", file.display()));
    format!(
        "{file}{}, {}{coordinates}{unused}",
        counted(object.faces, "triangle"),
        counted(object.vertices, "vertex")
    )
}

fn lamps(lamps: &LampsInspection) -> String {
    let least = lamps.angles.iter().copied().fold(f32::INFINITY, f32::min);
    let most = lamps.angles.iter().copied().fold(0.0, f32::max);
    let shape = if lamps.ball { ", on a ball" } else { "" };
    format!(
        "known, one a photograph: {least:.0}° to {most:.0}° from the camera, up to {:.0}° between two of them{shape}",
        lamps.spread
    )
}

fn frames(inspection: &Inspection) -> String {
    let mut sizes: Vec<[usize; 2]> = inspection
        .frames
        .iter()
        .map(|frame| [frame.width, frame.height])
        .collect();
    sizes.sort_unstable();
    sizes.dedup();
    let size = match &*sizes {
        [[width, height]] => format!("{width} × {height} pixels"),
        several => format!("of {} sizes", several.len()),
    };
    let left_out = match inspection.left_out {
        0 => String::new(),
        count => format!(", {count} of other splits left out"),
    };
    format!("{}, {size}{left_out}", inspection.frames.len())
}
