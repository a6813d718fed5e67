//! What a diagnosis tells of scores and of models.

use std::collections::BTreeMap;

use super::{
    confirm::Step,
    diagnosis::{Finding, Ranked},
    effects,
    fit::Fit,
    light::Light,
    score::{Score, Screen},
    study::Study,
};
use crate::capture::Capture;

/// Of a screening, in its order.
pub fn ranked(screen: &Screen) -> Vec<Ranked> {
    screen
        .scores
        .iter()
        .map(|s| Ranked {
            id: s.id,
            gain: s.gain,
            gain_se: s.gain_se,
            p: s.p,
            size: s.size,
            size_se: s.size_of(&s.beta, &s.standard_error).1,
            survival: s.survival,
            minimum_detectable: s.minimum_detectable,
            capacity: effects::by_id(s.id).is_some_and(|e| e.is_capacity()),
            confused_with: confused_with(s.id),
            evidence: None,
        })
        .collect()
}

/// Puts what was refitted before the rest, in the order of the refits' evidence.
pub fn put_first(ranking: &mut [Ranked], evidence: &[(&'static str, f64)]) {
    let place = |id: &str| evidence.iter().position(|(other, _)| *other == id);
    for ranked in ranking.iter_mut() {
        ranked.evidence = place(ranked.id).map(|k| evidence[k].1);
    }
    ranking.sort_by_key(|r| place(r.id).unwrap_or(evidence.len()));
}

/// Of an effect that stands, in the model `fit`, whose numbers have these standard errors there.
pub fn finding(step: &Step<'_>, fit: &Fit, errors: &BTreeMap<&'static str, Vec<f64>>) -> Finding {
    let (choice, gain) = (step.choice, step.gain);
    let score: &Score = &choice.score;
    // A number that the last model no longer has keeps what screening said of it.
    let own = errors
        .get(score.id)
        .filter(|own| own.len() == score.standard_error.len());
    let error = own.unwrap_or(&score.standard_error);
    let beta = fit
        .active
        .iter()
        .find(|a| a.effect.id() == score.id)
        .map_or(&score.beta, |a| &a.beta);
    let named = |values: &[f64]| -> BTreeMap<String, f64> {
        score
            .names
            .iter()
            .cloned()
            .zip(values.iter().copied())
            .collect()
    };
    let mut place = BTreeMap::new();
    let strongest = (0..beta.len()).max_by(|&a, &b| {
        let z = |k: usize| (beta[k] / error[k].max(1e-12)).abs();
        z(a).total_cmp(&z(b)).then(b.cmp(&a))
    });
    if let Some(k) = strongest {
        place.insert("strongest".to_owned(), score.names[k].clone().into());
        let mut frames: Vec<u32> = (0..beta.len())
            .filter(|&i| (beta[i] / error[i].max(1e-12)).abs() > 4.0)
            .filter_map(|i| score.frames[i])
            .collect();
        frames.dedup();
        if !frames.is_empty() {
            place.insert("frames".to_owned(), frames.into());
        }
    }
    let (size, size_se) = score.size_of(beta, error);
    Finding {
        id: score.id,
        parameters: named(beta),
        standard_errors: named(error),
        sealed_gain: gain.gain,
        sealed_gain_se: gain.error,
        p_holm: choice.p_holm,
        survival: score.survival,
        size,
        size_se,
        minimum_detectable: score.minimum_detectable,
        ambiguous_with: without(&choice.ambiguous_with, &step.refused),
        confused_with: confused_with(score.id),
        place,
    }
}

fn confused_with(id: &str) -> Vec<&'static str> {
    effects::by_id(id).map_or(Vec::new(), |e| e.confused_with().to_vec())
}

/// Those that would do as well, less those that sealed data have refused.
fn without(rivals: &[&'static str], refused: &[&'static str]) -> Vec<&'static str> {
    let stand = rivals.iter().filter(|id| !refused.contains(id));
    stand.copied().collect()
}

/// Effects that one exponent of all values changes together: a response raises light to a power, and with it every gain of a
/// falloff or of an exposure (Litvinov & Schechner, CVPR 2005). The response is never known here, only assumed.
const EXPONENTIAL: [&str; 3] = ["response_curve", "vignetting", "exposure_drift"];

/// Says of effects that share the exponential ambiguity what of their sizes is known, where one of them was found and another was
/// found with it or would do as well.
pub fn shared_exponent(found: &[Finding]) -> Option<String> {
    let own = || found.iter().filter(|f| EXPONENTIAL.contains(&f.id));
    let mentioned = |id: &&str| own().any(|f| f.id == *id || f.ambiguous_with.contains(id));
    let joint: Vec<&str> = EXPONENTIAL.into_iter().filter(mentioned).collect();
    let (last, others) = joint.split_last()?;
    if others.is_empty() {
        return None;
    }
    let list = format!("{} and {last}", others.join(", "));
    Some(format!(
        "Read {list} together: raising all values to one power changes each of them alike, so that their sizes are known only up to a \
         common exponent."
    ))
}

/// What was taken for granted.
pub fn assumptions(
    capture: &Capture,
    light: Light,
    study: &Study<'_>,
    ended_by_time: bool,
    trifle: Option<&str>,
) -> Vec<String> {
    let mut all = Vec::new();
    if ended_by_time {
        all.push(
            "The time limit ended the search while effects were left to compare: more may be missing than what is said; give a longer \
             --time-limit.".into(),
        );
    }
    if let Some(id) = trifle {
        all.push(format!(
            "{id} would explain a little more, but no more than what the effects before it may have left, whose models are never quite \
             true: it is not named."
        ));
    }
    if light == Light::Lamps {
        all.push("One distant lamp a frame, with the direction and the strength that the capture says, and no other light.".into());
        let ball = capture.lamps.as_ref().is_some_and(|lamps| lamps.ball);
        all.push(format!(
            "A Lambertian surface of the given shape{}. Its albedo is free in every place, smooth but for what the places' scatter \
             says; one scale, by colour, is free for all lamps together.",
            if ball {
                ", a ball, dark where it turns away from the lamp"
            } else {
                ", which casts shadows on itself"
            }
        ));
    }
    if study.seen.eight_bits {
        all.push(
            "The photographs hold 256 levels at most: rounding to them counts as noise. PNG and JPEG files are read as sRGB unless \
             the capture's `color_encoding` says otherwise; where that is wrong, response_curve tells.".into(),
        );
    }
    all
}

/// Relative change of light and albedo, RMS.
pub fn moved(before: &Fit, after: &Fit) -> BTreeMap<String, f64> {
    let change = |a: &[f32], b: &[f32]| {
        let square = |x: f32| f64::from(x).powi(2);
        let top: f64 = a.iter().zip(b).map(|(a, b)| square(a - b)).sum();
        let bottom: f64 = a.iter().map(|a| square(*a)).sum();
        (top / bottom.max(1e-300)).sqrt()
    };
    BTreeMap::from([
        (
            "environment".to_owned(),
            change(&before.radiance, &after.radiance),
        ),
        ("albedo".to_owned(), change(&before.albedo, &after.albedo)),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refits_lead_the_ranking_and_gains_order_the_rest() {
        let ranked = |id, gain| Ranked {
            gain,
            ..Ranked::example(id)
        };
        let mut ranking = [
            ranked("medium", 90.0),
            ranked("vignetting", 80.0),
            ranked("clipping", 70.0),
            ranked("defocus", 60.0),
        ];
        put_first(&mut ranking, &[("clipping", 40.0), ("medium", 10.0)]);
        let order = ranking.each_ref().map(|r| (r.id, r.evidence));
        let expected = [
            ("clipping", Some(40.0)),
            ("medium", Some(10.0)),
            ("vignetting", None),
            ("defocus", None),
        ];
        assert_eq!(order, expected);
    }

    #[test]
    fn what_sealed_data_refuse_would_not_do_as_well() {
        let rivals = ["medium", "near_field_light"];
        assert_eq!(without(&rivals, &["medium"]), ["near_field_light"]);
        assert_eq!(without(&rivals, &["clipping"]), rivals);
    }

    #[test]
    fn a_common_exponent_is_told_where_two_share_it() {
        let told = |found: &[Finding]| shared_exponent(found);
        assert!(told(&[]).is_none());
        assert!(told(&[Finding::example("vignetting", vec!["medium"])]).is_none());
        // Rivals of something else are no reason.
        let other = Finding::example("moving_occluder", vec!["exposure_drift", "response_curve"]);
        assert!(told(&[other]).is_none());
        let rival = told(&[Finding::example(
            "vignetting",
            vec!["medium", "response_curve"],
        )])
        .unwrap();
        assert!(
            rival.starts_with("Read response_curve and vignetting together"),
            "{rival}"
        );
        let all = [
            Finding::example("exposure_drift", Vec::new()),
            Finding::example("response_curve", vec!["vignetting"]),
        ];
        let all = told(&all).unwrap();
        assert!(
            all.starts_with("Read response_curve, vignetting and exposure_drift together"),
            "{all}"
        );
    }
}
