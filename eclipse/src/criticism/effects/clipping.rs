//! The upper end of the sensor's range.

use autodiff::Var;

use super::{Effect, Recorded, Stage, Term};
use crate::criticism::scene::Scene;

/// Above a knee only the share 1 − β of a value's excess is recorded; the field holds the knee. Two make a soft one.
pub struct Clipping;

/// Where a soft knee bends, as shares of the largest value. A third at three quarters of it kept refits from converging: of a hard end of
/// the range their evidence fell to a half.
const KNEES: [(&str, f32); 2] = [("at the largest value", 0.99), ("below it", 0.9)];
/// Share of the object's values that must crowd within two per cent below the largest before a knee is suspected there.
const CROWD: f64 = 0.004;

impl Effect for Clipping {
    fn id(&self) -> &'static str {
        "clipping"
    }
    fn describe(&self) -> &'static str {
        "values above the sensor's range are cut off"
    }
    fn stage(&self) -> Stage {
        Stage::Saturation
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["response_curve", "specular_lobe"]
    }
    fn shown_by(&self) -> &'static str {
        "take one view again at a third of the exposure: values that were cut off come back"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let mut values: Vec<f32> = scene
            .capture
            .frames
            .iter()
            .flat_map(|f| {
                let inside = move |p: &usize| f.mask.data[*p] > 0.999;
                (0..f.mask.data.len())
                    .filter(inside)
                    .flat_map(move |p| f.image.data[3 * p..3 * p + 3].to_vec())
            })
            .collect();
        values.sort_unstable_by(f32::total_cmp);
        let Some(&top) = values.get(((values.len() as f64) * 0.9995) as usize) else {
            return Vec::new();
        };
        let crowd = values.iter().filter(|v| **v > 0.98 * top).count() as f64;
        // A histogram that thins out has no upper end: its brightest two per cent hold few values.
        if crowd < CROWD * values.len() as f64 {
            return Vec::new();
        }
        KNEES
            .into_iter()
            .map(|(name, share)| {
                let field = vec![share * top; scene.size()];
                Term::new(format!("share cut off above the knee {name}"), 0.7, field).positive()
            })
            .collect()
    }
    fn is_of_one_sum(&self) -> bool {
        false
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        terms.iter().fold(value.clone(), |out, term| {
            out - &term.beta * (value - &term.field).relu()
        })
    }
}
