//! What the photographs of a run can tell of the light at best, to stand beside how sure its result is.

use serde_json::{Value, json};

use crate::{
    capture::Capture,
    inspect::{LimitInspection, limit::at_a_glance},
    reconstruction::{Ended, Reconstruction},
};

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
    at_a_glance(capture, solved.settings.memory).map_err(|error| error.to_string())
}
