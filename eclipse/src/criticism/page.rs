//! What a diagnosis leaves: `diagnosis.json`, `diagnosis.html`, and maps of residuals as OpenEXR.

use std::{fs, io, path::Path};

use super::{
    diagnose::Outcome,
    diagnosis::Diagnosis,
    effects, film,
    locate::HotSpot,
    maps,
    plot::{self, picture},
    silhouette, spots, tables,
};
use crate::{
    files::atomic,
    image_io::{ImageIoError, white, write_exr},
    layout,
};

/// Residuals of this many standard deviations are fully coloured.
const RANGE: f32 = 4.0;
/// Frames shown on the page.
const SHOWN: usize = 6;

/// What a frame has maps of.
const KINDS: [&str; 4] = [
    "residual-before",
    "residual-after",
    "significance-before",
    "significance-after",
];

/// Writes everything into a folder, the page last; maps of an earlier diagnosis are removed first.
///
/// # Errors
/// A file that cannot be written.
pub fn write(folder: &Path, outcome: &Outcome<'_>) -> Result<(), PageError> {
    let inner = folder.join(layout::MAPS);
    fs::create_dir_all(&inner)?;
    let frames = maps::frames(outcome);
    remove_maps(&inner)?;
    for (t, frame) in frames.iter().enumerate() {
        let [before, after] = &frame.residual;
        let [unlikely_before, unlikely_after] = &frame.significance;
        for (kind, map) in KINDS
            .iter()
            .zip([before, after, unlikely_before, unlikely_after])
        {
            let path = inner.join(format!("{kind}-{}", layout::numbered(t)));
            let channels: &[&str] = match map.channels {
                1 => &["Y"],
                _ => &["R", "G", "B"],
            };
            write_exr(&path, map, channels)?;
        }
    }
    match &outcome.silhouettes {
        Some(silhouettes) => silhouettes.write(folder)?,
        None => silhouette::remove(folder)?,
    }
    let json = serde_json::to_string_pretty(&outcome.diagnosis)?;
    put(&folder.join("diagnosis.json"), &json)?;
    put(&folder.join("diagnosis.html"), &html(outcome, &frames)?)?;
    Ok(())
}

/// Removes the maps of a diagnosis that was of other frames.
fn remove_maps(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        let ours = stem
            .and_then(|stem| stem.rsplit_once('-'))
            .is_some_and(|(kind, number)| KINDS.contains(&kind) && number.parse::<u32>().is_ok());
        if ours && path.extension().is_some_and(|extension| extension == "exr") {
            fs::remove_file(&path)?;
        }
    }
    Ok(())
}

fn put(path: &Path, text: &str) -> Result<(), io::Error> {
    use io::Write;
    atomic::write(path, |file| file.write_all(text.as_bytes()))
}

fn html(outcome: &Outcome<'_>, frames: &[maps::Maps]) -> Result<String, PageError> {
    let d = &outcome.diagnosis;
    let name = outcome.study.capture.path.file_name();
    let name = name.map_or("capture".into(), |n| n.to_string_lossy());
    let verdict = serde_json::to_value(d.verdict)?;
    let verdict = verdict.as_str().unwrap_or_default().replace('_', " ");
    let photographs = outcome.study.capture.frames.iter();
    let how = plot::Shown {
        white: white(photographs.map(|frame| &frame.image)),
    };
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>Diagnosis of {title}</title>\n<style>{style}</style></head><body>\n<h1>{title}: {verdict}</h1>\n\
         <p class=\"sentence\">{sentence}</p>\n{unnamed}{exponent}{found}{separate}{film}{pictures}{spots}{ranking}{refits}{behind}{axes}{assumed}{others}\
         <footer>Written by eclipse {version}. Gains are reductions of squared error in units of the noise's variance. Sealed data: \
         {sealed}, seen by no fit.</footer></body></html>\n",
        title = escaped(&name),
        style = include_str!("page.css"),
        sentence = escaped(&d.sentence),
        unnamed = unnamed(d),
        separate = separate(d),
        exponent = exponent(d),
        found = tables::found(d),
        film = film::strip(outcome)?,
        pictures = pictures(outcome, frames, &how)?,
        spots = spots::section(outcome, &how)?,
        ranking = tables::ranking(d),
        refits = tables::refits(d),
        behind = tables::behind_occluders(d),
        axes = axes(d),
        assumed = assumed(d),
        others = others(d),
        version = env!("CARGO_PKG_VERSION"),
        sealed = if outcome.study.seals_frames() {
            "one patch of surface and one frame in seven"
        } else {
            "one patch of surface in seven, in all frames"
        },
    ))
}

/// What the last model holds besides what is named.
fn unnamed(d: &Diagnosis) -> String {
    let mut said = String::new();
    if d.unnamed > 0 {
        said += &format!(
            "<p>Sealed data let {} stand, but most of the mismatch remains, so that no name is given. What is said of \
             <i>after</i> on this page, and χ² after, is of the model that includes what was tried.</p>\n",
            match d.unnamed {
                1 => "one effect".to_owned(),
                many => format!("{many} effects"),
            }
        );
    }
    if let Some(stand_in) = d.looks_like.and_then(effects::by_id) {
        let than = if d.effects.is_empty() {
            "all that has one"
        } else {
            "all that could be added to what was found"
        };
        said += &format!(
            "<p>Something that has no name here does better than {than}: {} (<code>{}</code>). It is not in the model.</p>\n",
            escaped(stand_in.describe()),
            stand_in.id()
        );
    }
    said
}

/// Which photographs would tell apart what explains these equally well.
fn separate(d: &Diagnosis) -> String {
    if d.separate_by.is_empty() {
        return String::new();
    }
    let lines = d.separate_by.iter();
    let lines: String = lines
        .map(|line| format!("<li>{}</li>", escaped(line)))
        .collect();
    format!(
        "<p>Further photographs that would tell apart what explains these equally well:</p><ul>{lines}</ul>\n"
    )
}

fn exponent(d: &Diagnosis) -> String {
    let said = d.shared_exponent.as_ref();
    said.map_or(String::new(), |said| format!("<p>{}</p>\n", escaped(said)))
}

fn pictures(
    outcome: &Outcome<'_>,
    frames: &[maps::Maps],
    how: &plot::Shown,
) -> Result<String, PageError> {
    // The frames with the largest hot spots, then evenly spread ones.
    let spots = outcome.diagnosis.hot_spots.iter();
    let mut order: Vec<usize> = spots.map(|s| s.frame).collect();
    let step = frames.len().div_ceil(SHOWN).max(1);
    order.extend((0..frames.len()).step_by(step));
    let mut shown: Vec<usize> = Vec::new();
    for t in order {
        if !shown.contains(&t) && shown.len() < SHOWN {
            shown.push(t);
        }
    }
    let d = &outcome.diagnosis;
    let mut rows = String::new();
    for t in shown {
        let maps = &frames[t];
        let photograph = &outcome.study.capture.frames[t].image;
        let boxed = |picture: &str, spots: &[HotSpot]| {
            let own = spots.iter().filter(|spot| spot.frame == t);
            let boxes: Vec<[f32; 4]> = own.map(|spot| spot.pixels).collect();
            plot::boxed(picture, [photograph.width, photograph.height], &boxes)
        };
        let significance = |k: usize| picture(&maps.significance[k], |p| diverging(p[0] / RANGE));
        let cells = [
            picture(photograph, |p| how.photograph(p))?,
            picture(&maps.model, |p| how.photograph(p))?,
            boxed(&significance(0)?, &d.hot_spots),
            boxed(&significance(1)?, &d.hot_spots_after),
        ];
        let unknown = !outcome.after.is_shared() && outcome.study.frame_is_sealed(t as u32);
        let remark = if unknown {
            "<br><small>sealed: what the effects do in this frame alone was not fitted</small>"
        } else {
            ""
        };
        rows += &format!(
            "<tr><td>{t}{remark}</td>{}</tr>",
            cells.map(|c| format!("<td>{c}</td>")).concat()
        );
    }
    Ok(format!(
        "<h2>Photograph, model, residual in σ before and after</h2><p>Red: the photograph is brighter; blue: darker; full colour at ±{RANGE} σ, \
         one scale for both. Boxes: hot spots.</p><table class=\"pictures\"><tr><th>frame</th><th>photograph</th><th>model</th><th>before</th><th>after</th></tr>{rows}</table>"
    ))
}

/// White at zero, red above, blue below.
fn diverging(x: f32) -> [f32; 3] {
    let s = x.clamp(-1.0, 1.0).abs();
    if x.is_nan() {
        [0.9, 0.9, 0.9]
    } else if x > 0.0 {
        [1.0 - 0.2 * s, 1.0 - 0.9 * s, 1.0 - 0.85 * s]
    } else {
        [1.0 - 0.85 * s, 1.0 - 0.65 * s, 1.0 - 0.2 * s]
    }
}

fn axes(d: &Diagnosis) -> String {
    let plots: String = d.axes.iter().map(plot::axis).collect();
    format!(
        "<h2>Along axes that physics acts by</h2>{}{plots}",
        plot::legend()
    )
}

fn assumed(d: &Diagnosis) -> String {
    let all: String = d
        .assumptions
        .iter()
        .map(|text| format!("<li>{}</li>", escaped(text)))
        .collect();
    if all.is_empty() {
        return all;
    }
    format!("<h2>Taken for granted</h2><ul>{all}</ul>")
}

fn others(d: &Diagnosis) -> String {
    let list = |map: &std::collections::BTreeMap<String, f64>, unit: &str| -> String {
        map.iter()
            .map(|(n, v)| format!("<li>{}: {v:.3}{unit}</li>", escaped(n)))
            .collect()
    };
    let command = d.command.as_ref().map_or(String::new(), |c| {
        format!("<p>To reconstruct with it: <code>{}</code></p>", escaped(c))
    });
    format!(
        "<h2>Numbers</h2>{command}<p>χ² a sealed value {:.3} → {:.3}; RMS difference {:.5} → {:.5}; structured mismatch {:.3} → {:.3} of the noise's variance{}.</p>\
         <p>How far the refit moved what was fitted before (relative RMS):</p><ul>{}</ul><p>Seconds:</p><ul>{}</ul>",
        d.sealed.chi2_before,
        d.sealed.chi2_after,
        d.sealed.rmse_before,
        d.sealed.rmse_after,
        d.structured[0],
        d.structured[1],
        d.structured_sealed
            .map_or(String::new(), |[before, after]| format!(
                ", in frames that no fit has seen {before:.3} → {after:.3}"
            )),
        list(&d.moved, ""),
        list(&d.seconds, " s")
    )
}

/// Text as HTML holds it.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Why the results could not be written.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// A file.
    #[error(
        "cannot write the diagnosis: {0}; check that the folder may be written and the disk is not full"
    )]
    Io(#[from] io::Error),
    /// An image.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// A number that JSON cannot hold.
    #[error("cannot write diagnosis.json: {0}")]
    Json(#[from] serde_json::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_name_is_told() {
        use super::super::{Verdict, diagnosis::Finding};
        let mut d = Diagnosis::example(Verdict::Unexplained, Vec::new());
        assert_eq!(unnamed(&d), "");
        d.unnamed = 1;
        assert!(unnamed(&d).contains("let one effect stand"));
        d.effects = vec![Finding::example("vignetting", Vec::new())];
        d.looks_like = Some("image_warp");
        let told = unnamed(&d);
        assert!(
            told.contains("added to what was found") && told.contains("image_warp"),
            "{told}"
        );
    }

    #[test]
    fn maps_of_an_earlier_diagnosis_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let ours = ["residual-before-000.exr", "significance-after-1000.exr"];
        let others = ["residual-before-mine.exr", "000.exr", "notes-000.txt"];
        for name in ours.iter().chain(&others) {
            fs::write(path(name), "x").unwrap();
        }
        remove_maps(folder.path()).unwrap();
        assert!(!ours.iter().any(|name| path(name).exists()));
        assert!(others.iter().all(|name| path(name).exists()));
    }
}
