//! The outline of who stood in the light, by a reconstruction with what was found.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use super::{Job, found};
use crate::{
    capture::Capture,
    cli::Failure,
    criticism::{self, silhouette::Silhouettes},
    settings::Settings,
};

/// Seconds that the reconstruction takes: with fewer left there is none, and more are not taken.
const SECONDS: (f64, f64) = (40.0, 120.0);
/// The share of the time limit that it may take beyond that.
const SHARE: f64 = 0.125;

/// Draws the outline finer than the diagnosis did, where somebody was found and time is left. The diagnosis is done by now: when
/// this fails or is interrupted, which `report` hears, it stands as it is.
pub(super) fn draw(
    job: &Job<'_>,
    capture: &Capture,
    outcome: &mut criticism::Outcome<'_>,
    (began, pool, stop): (Instant, &rayon::ThreadPool, &AtomicBool),
    report: &dyn Fn(&str),
) {
    let before = began.elapsed().as_secs_f64();
    let left = (job.time_limit - before).max(SHARE * job.time_limit);
    let left = left.min(SECONDS.1);
    let interrupted = stop.load(Ordering::Relaxed);
    if !found::somebody_found(&outcome.diagnosis) || left <= SECONDS.0 || interrupted {
        return;
    }
    report("reconstructing with what was found, for the occluder's outline");
    match reconstructed(job, capture, outcome, (left, pool, stop)) {
        Ok(Some(silhouettes)) => {
            outcome.diagnosis.occluders = Some(silhouettes.told.clone());
            outcome.silhouettes = Some(silhouettes);
        }
        Ok(None) => {}
        Err(failure) => report(&format!(
            "no finer outline: {}; the diagnosis keeps its own",
            failure.message
        )),
    }
    let took = began.elapsed().as_secs_f64() - before;
    let seconds = &mut outcome.diagnosis.seconds;
    seconds.insert("outline".to_owned(), took);
}

/// Silhouettes of a reconstruction of `seconds`; `None` when interrupted or where nobody is in it.
fn reconstructed(
    job: &Job<'_>,
    capture: &Capture,
    outcome: &criticism::Outcome<'_>,
    (seconds, pool, stop): (f64, &rayon::ThreadPool, &AtomicBool),
) -> Result<Option<Silhouettes>, Failure> {
    let settings = Settings {
        time_limit: Some(seconds),
        with: found::of_the_camera(&outcome.diagnosis),
        lambertian: found::is_lambertian(outcome),
        ..job.settings()
    };
    let solved = job.solve(capture, &settings, pool, stop)?;
    Ok(solved.and_then(|solved| Silhouettes::reconstructed(capture, &solved)))
}
