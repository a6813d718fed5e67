//! What a run says at its end.

use std::path::Path;

use serde_json::json;

use crate::{
    checkpoint::Checkpoint,
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

/// What to say where no step was taken, in all or since `begun`: what is written looks like a result all the same.
pub(super) fn no_step(solved: &Reconstruction, begun: Option<&Checkpoint>) -> Option<String> {
    let done = iterations(solved);
    if solved.ended == Ended::Interrupted || begun.map_or(0, |begun| begun.iteration) != done {
        return None;
    }
    let Some(begun) = begun else {
        return Some(
            "no step was taken, the time was over before: this is what a run begins with and no result; start again with a longer --time-limit"
                .to_owned(),
        );
    };
    let (had, more) = match solved.ended {
        Ended::TimeLimit => (
            format!(
                "another step does not fit into the time, of which the run had {}",
                text::duration(begun.seconds)
            ),
            "a longer --time-limit, which is of the run as a whole",
        ),
        Ended::Iterations => (
            format!(
                "the run had its {} before",
                counted(done as usize, "iteration")
            ),
            "more --iterations, which are of the run as a whole",
        ),
        Ended::Converged | Ended::Interrupted => return None,
    };
    Some(format!(
        "no further step was taken: {had}; it goes on with {more}"
    ))
}

fn iterations(solved: &Reconstruction) -> u64 {
    solved.curve.last().map_or(0, |last| last.iteration)
}

/// How much was done, and why no more.
fn work(solved: &Reconstruction) -> String {
    format!(
        "{} in {}, {}\n",
        counted(iterations(solved) as usize, "iteration"),
        text::duration(solved.seconds()),
        text::ended(solved.ended)
    )
}
