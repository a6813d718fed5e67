//! What a run says at its end.

use std::path::Path;

use serde_json::json;

use crate::{
    layout,
    reconstruction::{Ended, Reconstruction},
    report::text,
    wording::counted,
};

/// What is printed at the end.
pub(super) fn summary(folder: &Path, solved: &Reconstruction, as_json: bool) -> String {
    if as_json {
        let summary = json!({
            "out": folder,
            "ended": solved.ended,
            "metrics": solved.metrics,
            "notes": solved.notes,
        });
        return format!("{summary:#}\n");
    }
    let mut text = String::new();
    let photometric = solved.metrics.photometric;
    let numbers = [
        ("PSNR", photometric.psnr),
        ("PSNR, held out", photometric.psnr_held_out),
    ];
    for (name, value) in numbers {
        text += &value.map_or(String::new(), |value| format!("{name} {value:.2} dB\n"));
    }
    text += &work(solved);
    for note in &solved.notes {
        text += &format!("note: {note}\n");
    }
    if solved.ended == Ended::Interrupted {
        text += "interrupted; continue with --resume\n";
    }
    text + &format!("wrote {}\n", folder.join(layout::REPORT).display())
}

/// How much was done, and why no more.
fn work(solved: &Reconstruction) -> String {
    let iterations = solved.curve.last().map_or(0, |last| last.iteration);
    format!(
        "{} in {}, {}\n",
        counted(iterations as usize, "iteration"),
        text::duration(solved.seconds()),
        text::ended(solved.ended)
    )
}
