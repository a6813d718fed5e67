//! A diagnosis in a terminal.

use std::path::Path;

use crate::criticism::{Diagnosis, diagnosis::Finding};

/// Effects of the ranking that are shown.
const SHOWN_EFFECTS: usize = 8;

/// The sentence, the ranking and the numbers of what was found.
pub(super) fn summary(d: &Diagnosis, folder: &Path) -> String {
    let mut text = format!("{}\n\n", d.sentence);
    text += &format!(
        "{:18} {:>10} {:>9} {:>9} {:>8} {:>9}\n",
        "effect", "gain", "± s.e.", "p", "size", "survival"
    );
    for r in d.ranking.iter().take(SHOWN_EFFECTS) {
        text += &format!(
            "{:18} {:>10.0} {:>9.0} {:>9.1e} {:>7.2}% {:>9.2}{}\n",
            r.id,
            r.gain,
            r.gain_se,
            r.p,
            100.0 * r.size,
            r.survival,
            if r.capacity { "  (capacity)" } else { "" }
        );
    }
    let refitted = d.ranking.iter().filter(|r| r.evidence.is_some()).count();
    if refitted > 0 {
        text += &format!(
            "(the first {refitted} by the evidence of their refits, the others by gain)\n"
        );
    }
    for finding in &d.effects {
        text += &numbers(finding);
    }
    if let Some(command) = &d.command {
        text += &format!("reconstruct with it: {command}\n");
    }
    text + &format!("wrote {}\n", folder.join("diagnosis.html").display())
}

/// The numbers of an effect that stand out of their errors, strongest first, a few of them.
fn numbers(finding: &Finding) -> String {
    const SHOWN: usize = 12;
    let error = |name: &str| {
        finding
            .standard_errors
            .get(name)
            .copied()
            .unwrap_or(f64::NAN)
    };
    let mut all: Vec<(&String, f64, f64)> = finding
        .parameters
        .iter()
        .map(|(name, value)| (name, *value, error(name)))
        .filter(|(_, value, error)| value.abs() > 2.0 * error)
        .collect();
    all.sort_by(|a, b| (b.1 / b.2).abs().total_cmp(&(a.1 / a.2).abs()));
    let lines: String = all
        .iter()
        .take(SHOWN)
        .map(|(name, value, error)| format!("  {name} = {value:.4} ± {error:.4}\n"))
        .collect();
    let more = all.len().saturating_sub(SHOWN);
    let rest = if more > 0 {
        format!("  and {more} more, in diagnosis.json\n")
    } else {
        String::new()
    };
    format!(
        "{}: sealed gain {:.0} ± {:.0}\n{lines}{rest}",
        finding.id, finding.sealed_gain, finding.sealed_gain_se
    )
}
