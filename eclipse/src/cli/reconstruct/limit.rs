//! What the photographs of a run can tell of the light at best, to stand beside how sure its result is.

use serde_json::{Value, json};

use crate::{
    capture::Capture,
    inspect::{
        LimitInspection,
        limit::{Grain, MODEL_ERROR, limits},
    },
    reconstruction::{Ended, Reconstruction},
};

/// How finely it is computed: as finely as an inspection does.
const GRAIN: Grain = Grain {
    rows: 8,
    patches: 120,
};
/// With more pixels of the object it takes longer than the end of a run may: an inspection stops there, too.
const MOST_PIXELS: u64 = 4_000_000;
/// What each of them takes meanwhile, in bytes: where it looks, twice over, and its patch.
const BYTES_PER_PIXEL: u64 = 160;

/// As `metrics.json` has it: the numbers of [`LimitInspection`], or as `left_out` why there are none.
pub(super) fn of(capture: &Capture, solved: &Reconstruction) -> Value {
    match limit(capture, solved) {
        Ok(limit) => json!(limit),
        Err(reason) => json!({ "left_out": reason }),
    }
}

fn limit(capture: &Capture, solved: &Reconstruction) -> Result<LimitInspection, String> {
    if solved.ended == Ended::Interrupted {
        return Err("the run was interrupted".to_owned());
    }
    if capture.lamps.is_some() {
        return Err("the lamps are known: there is no light to be found".to_owned());
    }
    let frames = capture.frames.iter();
    let inside = frames.map(|frame| frame.mask.data.iter().filter(|&&m| m > 0.5).count() as u64);
    let pixels: u64 = inside.sum();
    if pixels > MOST_PIXELS || pixels * BYTES_PER_PIXEL > solved.settings.memory {
        return Err(format!(
            "{pixels} pixels of the object would take too long, or too much memory; eclipse study limit computes it"
        ));
    }
    let limits = limits(capture, GRAIN, MODEL_ERROR, 0).map_err(|error| error.to_string())?;
    let of = |operator: bool| {
        let mut limits = limits.iter();
        limits.find(|limit| limit.known.operator == operator && !limit.known.albedo)
    };
    match (of(true), of(false)) {
        (Some(somebody), Some(nobody)) => Ok(LimitInspection {
            texel: 180.0 / GRAIN.rows as f64,
            with_somebody: somebody.error,
            with_nobody: nobody.error,
        }),
        _ => Err("it was not computed for an unknown albedo".to_owned()),
    }
}
