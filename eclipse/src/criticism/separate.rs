//! What would tell apart effects that explain a capture equally well: further photographs, by what each effect shows in.

use super::{diagnosis::Finding, effects};

/// For every effect that was found and has rivals: what would show whether it or one of them is there, a line each.
pub fn separate_by(found: &[Finding]) -> Vec<String> {
    let mut names: Vec<&str> = Vec::new();
    for finding in found.iter().filter(|f| !f.ambiguous_with.is_empty()) {
        for id in std::iter::once(&finding.id).chain(&finding.ambiguous_with) {
            if !names.contains(id) {
                names.push(*id);
            }
        }
    }
    lines(&names)
}

/// Of these effects.
fn lines(names: &[&str]) -> Vec<String> {
    let known = names.iter().filter_map(|id| effects::by_id(id));
    known
        .filter(|effect| !effect.shown_by().is_empty())
        .map(|effect| format!("{}: {}", effect.id(), effect.shown_by()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whoever is confused with whom, as `design/mismatch.md` has it; its words for albedo, light and texture are capacity here.
    const CONFUSED: [[&str; 2]; 24] = [
        ["moving_occluder", "exposure_drift"],
        ["occluder_bounce", "exposure_drift"],
        ["response_curve", "finer_albedo"],
        ["response_curve", "specular_lobe"],
        ["vignetting", "medium"],
        ["black_level", "veiling_glare"],
        ["clipping", "response_curve"],
        ["interreflection", "finer_albedo"],
        ["ground_bounce", "finer_environment"],
        ["near_field_light", "finer_albedo"],
        ["moving_light", "moving_occluder"],
        ["emission", "finer_albedo"],
        ["specular_lobe", "finer_environment"],
        ["translucency", "finer_albedo"],
        ["pose_error", "finer_albedo"],
        ["defocus", "finer_albedo"],
        ["normal_error", "finer_albedo"],
        ["lamp_direction", "response_curve"],
        ["response_curve", "vignetting"],
        ["response_curve", "exposure_drift"],
        ["vignetting", "exposure_drift"],
        ["lamp_direction", "finer_lamps"],
        ["exposure_drift", "finer_occluders"],
        ["ambient_light", "emission"],
    ];

    #[test]
    fn whatever_is_confused_has_an_answer() {
        let told = effects::all().into_iter().flat_map(|effect| {
            let others = effect.confused_with().iter();
            others.map(move |other| [effect.id(), *other])
        });
        let named = |id: &str| effects::by_id(id).is_some_and(|e| !e.stands_for_unknown());
        let pairs = told.filter(|pair| pair.iter().all(|id| named(id)));
        for pair in pairs.chain(CONFUSED) {
            let answer = lines(&pair);
            assert_eq!(answer.len(), 2, "{pair:?}");
            let texts = answer.iter().zip(pair);
            let texts: Vec<&str> = texts.map(|(line, id)| &line[id.len() + 2..]).collect();
            assert!(
                texts[0] != texts[1] && texts.iter().all(|text| text.len() > 20),
                "{pair:?}: {texts:?}"
            );
        }
    }

    #[test]
    fn only_what_is_ambiguous_asks_for_photographs() {
        let sure = Finding::example("exposure_drift", Vec::new());
        assert!(separate_by(std::slice::from_ref(&sure)).is_empty());
        let unsure = Finding::example("vignetting", vec!["medium", "near_field_light"]);
        let other = Finding::example("black_level", vec!["medium"]);
        let lines = separate_by(&[sure, unsure, other]);
        let names: Vec<&str> = lines.iter().filter_map(|l| l.split(':').next()).collect();
        let expected = ["vignetting", "medium", "near_field_light", "black_level"];
        assert_eq!(names, expected);
    }
}
