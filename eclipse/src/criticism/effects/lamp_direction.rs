//! Lamps that do not stand where the capture says.

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

/// Two angles of each frame's known lamp. Captures without known lamps have none.
pub struct LampDirection;

impl Effect for LampDirection {
    fn id(&self) -> &'static str {
        "lamp_direction"
    }
    fn describe(&self) -> &'static str {
        "a known lamp stands in another direction than recorded"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["response_curve", "exposure_drift", "normal_error"]
    }
    fn terms(&self, _scene: &Scene<'_>) -> Vec<Term> {
        Vec::new()
    }
}
