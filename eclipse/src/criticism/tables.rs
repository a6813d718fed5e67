//! Tables of the page: what was added to the model, all effects, refits, and what occluders swallow.

use super::{
    baselines,
    diagnosis::{Diagnosis, Finding, Judged, Ranked},
    page::escaped,
};

/// Numbers of an effect that are shown at once.
const SHOWN_NUMBERS: usize = 8;
/// A gain of fewer standard errors is not sure.
const SURE: f64 = 3.0;

/// What was added to the model.
pub fn found(d: &Diagnosis) -> String {
    if d.effects.is_empty() {
        return String::new();
    }
    let rows: String = d.effects.iter().map(finding).collect();
    format!(
        "<h2>Added to the model</h2><table><tr><th>effect</th><th>size in the image</th><th>sealed gain</th><th>p (Holm)</th>\
         <th>survival</th><th>minimum detectable</th><th>verdict</th><th>easily confused with</th></tr>{rows}</table>"
    )
}

fn finding(f: &Finding) -> String {
    let mut strongest: Vec<(&String, f64, f64)> = f
        .parameters
        .iter()
        .map(|(n, v)| (n, *v, f.standard_errors.get(n).copied().unwrap_or(f64::NAN)))
        .collect();
    strongest.sort_by(|a, b| (b.1 / b.2).abs().total_cmp(&(a.1 / a.2).abs()));
    let item =
        |(n, v, e): &(&String, f64, f64)| format!("<li>{} = {v:.4} ± {e:.4}</li>", escaped(n));
    let (first, rest) = strongest.split_at(strongest.len().min(SHOWN_NUMBERS));
    let mut numbers: String = first.iter().map(item).collect();
    if !rest.is_empty() {
        let rest: String = rest.iter().map(item).collect();
        numbers += &format!("<details><summary>the others</summary>{rest}</details>");
    }
    let verdict = if f.ambiguous_with.is_empty() {
        "stands".to_owned()
    } else {
        format!("{} would do as well", f.ambiguous_with.join(" or "))
    };
    format!(
        "<tr><td><b>{}</b><ul>{numbers}</ul></td><td>{:.2} ± {:.2} %</td><td>{}</td><td>{:.1e}</td><td>{:.2}</td>\
         <td>{}</td><td>{verdict}</td><td>{}</td></tr>",
        f.id,
        100.0 * f.size,
        100.0 * f.size_se,
        rounded(f.sealed_gain, f.sealed_gain_se),
        f.p_holm,
        f.survival,
        percent(f.minimum_detectable),
        f.confused_with.join(", "),
    )
}

/// All effects.
pub fn ranking(d: &Diagnosis) -> String {
    let rows: String = d
        .ranking
        .iter()
        .map(|r| {
            let of_sealed = sealed(d, r.id);
            let gain = of_sealed.map_or("–".to_owned(), |s| gain(&s));
            format!(
                "<tr{}><td>{}</td><td>{}</td><td>{gain}</td><td>{:.1e}</td><td>{:.2} ± {:.2} %</td><td>{:.2}</td>\
                 <td>{}</td><td>{}</td><td>{}</td></tr>",
                if r.capacity { " class=\"capacity\"" } else { "" },
                r.id,
                rounded(r.gain, r.gain_se),
                r.p,
                100.0 * r.size,
                100.0 * r.size_se,
                r.survival,
                percent(r.minimum_detectable),
                verdict(d, r),
                r.confused_with.join(", "),
            )
        })
        .collect();
    format!(
        "<h2>All effects</h2><p>First those that were refitted in the first round, in the order of their refits' evidence; then the others by \
         what they gain on held-out patches when screened.</p><table><tr><th>effect</th><th>gain</th><th>sealed gain</th><th>p</th>\
         <th>size</th><th>survival</th><th>minimum detectable</th><th>verdict</th><th>easily confused with</th></tr>{rows}</table>\
         <p class=\"capacity\">Grey: not physics, but more freedom for light, albedo or occluders.</p>"
    )
}

/// What sealed data say of an effect, in the first round in which they were asked.
fn sealed(d: &Diagnosis, id: &str) -> Option<Judged> {
    let mut own = d.refits.iter().filter(|r| r.id == id);
    own.find_map(|r| r.sealed)
}

fn gain(judged: &Judged) -> String {
    rounded(judged.gain, judged.gain_se)
}

/// A gain with its standard error, never as a zero of either sign.
fn rounded(gain: f64, error: f64) -> String {
    format!("{:.0} ± {error:.0}", gain.round() + 0.0)
}

/// A share in percent; a dash where no size would be found.
fn percent(share: f64) -> String {
    match share.is_finite() {
        true => format!("{:.2} %", 100.0 * share),
        false => "–".to_owned(),
    }
}

/// What became of an effect.
fn verdict(d: &Diagnosis, r: &Ranked) -> &'static str {
    let added = d.effects.iter().any(|f| f.id == r.id);
    let stand_in = d.looks_like == Some(r.id);
    match sealed(d, r.id) {
        _ if added => "added to the model",
        _ if stand_in => "the mismatch looks like it",
        _ if d.finer.contains(&r.id) => "added before effects were compared anew",
        Some(judged) if judged.confirmed => "stands, but explains too little",
        Some(_) => "refused by sealed data",
        None => match r.evidence {
            Some(evidence) if evidence > 0.0 => "refitted, not the best",
            Some(_) => "no better when refitted",
            None if r.gain <= SURE * r.gain_se => "no sure gain",
            None if r.size < r.minimum_detectable => "smaller than what would be found",
            None => "not refitted",
        },
    }
}

/// Refits: who was tried in the full model, and what became of it.
pub fn refits(d: &Diagnosis) -> String {
    if d.refits.is_empty() {
        return String::new();
    }
    let rows: String = d
        .refits
        .iter()
        .map(|r| {
            let sealed = r.sealed.map_or(String::new(), |s| {
                let outcome = if s.confirmed { "stands" } else { "refused" };
                format!("{}: {outcome}", gain(&s))
            });
            format!(
                "<tr><td>{}</td><td>{}</td><td>{:.0}</td><td>{sealed}</td></tr>",
                r.after + 1,
                r.id,
                r.evidence
            )
        })
        .collect();
    format!(
        "<h2>Refits</h2><table><tr><th>round</th><th>effect</th><th>evidence (χ²)</th><th>gain on sealed data</th></tr>{rows}</table>"
    )
}

/// Effects that stand up in the first screening or, where the simulation has occluders, without these, and what they gain behind
/// occluders.
pub fn behind_occluders(d: &Diagnosis) -> String {
    let [none, sparse, full] =
        [baselines::NONE, baselines::SPARSE, baselines::FULL].map(|name| d.baselines.get(name));
    if none.or(sparse.and(full)).is_none() {
        return String::new();
    }
    let sure = |r: &Ranked| r.gain > SURE * r.gain_se;
    let of = |all: Option<&'_ Vec<Ranked>>, id: &str| -> Option<Ranked> {
        all?.iter().find(|other| other.id == id).cloned()
    };
    let rows: String = d
        .ranking
        .iter()
        .filter(|r| !r.capacity)
        .map(|r| (r, of(none, r.id)))
        .filter(|(r, bare)| sure(r) || bare.as_ref().is_some_and(sure))
        .map(|(r, bare)| {
            let [sparse, full] = [sparse, full].map(|all| of(all, r.id));
            let told = match [&sparse, &full].map(|r| r.as_ref().is_some_and(sure)) {
                _ if !sure(r) => "the simulation's occluders do it too",
                _ if sparse.is_none() => "is the occluder itself",
                [true, true] => "no occluder does it",
                [true, false] => "only light taken away anywhere, anew in every frame, does it",
                [false, _] => "somebody who moves with the camera does it too",
            };
            let bare = none.map(|_| cells(bare.as_ref())).unwrap_or_default();
            let behind = [Some(r), sparse.as_ref(), full.as_ref()]
                .map(cells)
                .concat();
            format!("<tr><td>{}</td>{bare}{behind}<td>{told}</td></tr>", r.id)
        })
        .collect();
    let (as_is, bare, also) = match none {
        None => ("no occluders", "", ""),
        Some(_) => (
            "the simulation's occluders",
            "<th colspan=\"2\">none</th>",
            "none, ",
        ),
    };
    format!(
        "<h2>Behind occluders</h2><p>What effects gain on held-out patches, and the share of their signal that survives, where the model has \
         {also}{as_is}, besides somebody who moves with the camera, and light taken away from any part of the sky in any frame: such \
         freedom swallows much, so that an effect that vanishes there is not refuted.</p><table><tr><th>effect</th>{bare}\
         <th colspan=\"2\">{as_is}</th><th colspan=\"2\">sparse</th><th colspan=\"2\">full</th><th></th></tr>{rows}</table>"
    )
}

/// An effect's gain and survival.
fn cells(r: Option<&Ranked>) -> String {
    match r {
        None => "<td>–</td><td>–</td>".to_owned(),
        Some(r) => format!(
            "<td>{}</td><td>{:.2}</td>",
            rounded(r.gain, r.gain_se),
            r.survival
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Verdict, diagnosis::Refitted};
    use super::*;

    #[test]
    fn no_gain_is_a_zero_and_no_size_a_dash() {
        assert_eq!(rounded(-0.3, 0.0), "0 ± 0");
        assert_eq!(rounded(-1.6, 2.4), "-2 ± 2");
        assert_eq!(percent(f64::INFINITY), "–");
        assert_eq!(percent(0.0123), "1.23 %");
    }

    #[test]
    fn what_occluders_swallow_is_told() {
        let mut d = Diagnosis::example(Verdict::Explained, Vec::new());
        assert_eq!(behind_occluders(&d), "");
        let of = |id, gain| Ranked {
            gain,
            ..Ranked::example(id)
        };
        let all = ["exposure_drift", "vignetting", "moving_occluder"];
        d.ranking = all.map(|id| of(id, 100.0)).into();
        let behind = |gains: [f64; 2]| {
            let of = |(id, gain)| of(id, gain);
            all.into_iter().zip(gains).map(of).collect::<Vec<_>>()
        };
        d.baselines = [
            (baselines::SPARSE.to_owned(), behind([100.0, 1.0])),
            (baselines::FULL.to_owned(), behind([2.0, 1.0])),
        ]
        .into();
        let page = behind_occluders(&d);
        let row = |id: &str| page.split("<tr>").find(|row| row.contains(id)).unwrap();
        assert!(row("exposure_drift").contains("only light taken away"));
        assert!(row("vignetting").contains("does it too"));
        assert!(row("moving_occluder").contains("itself"));
        assert!(!page.contains("none"), "{page}");
    }

    #[test]
    fn what_the_simulations_occluders_swallow_is_told() {
        let of = |gain| Ranked {
            gain,
            ..Ranked::example("exposure_drift")
        };
        let mut d = Diagnosis::example(Verdict::NothingMissing, Vec::new());
        d.ranking = vec![of(1.0)];
        let named = |gain| (baselines::NONE.to_owned(), vec![of(gain)]);
        d.baselines = [named(1.0)].into();
        assert!(!behind_occluders(&d).contains("exposure_drift"));
        d.baselines = [named(100.0)].into();
        let page = behind_occluders(&d);
        assert!(
            page.contains("the simulation's occluders do it too"),
            "{page}"
        );
        assert!(page.contains("none"), "{page}");
    }

    #[test]
    fn what_became_of_every_effect_is_told() {
        let found = Finding {
            confused_with: vec!["near_field_light"],
            ..Finding::example("vignetting", vec!["medium"])
        };
        let mut d = Diagnosis::example(Verdict::Ambiguous, vec![found]);
        let refit = |id, evidence, confirmed: Option<bool>| Refitted {
            after: 0,
            id,
            evidence,
            sealed: confirmed.map(|confirmed| Judged {
                gain: 40.0,
                gain_se: 10.0,
                p: 0.1,
                confirmed,
            }),
        };
        d.refits = vec![
            refit("vignetting", 90.0, Some(true)),
            refit("medium", 80.0, Some(false)),
            refit("clipping", -3.0, None),
        ];
        let ranked = |id, evidence| Ranked {
            evidence,
            ..Ranked::example(id)
        };
        d.ranking = vec![
            ranked("vignetting", Some(90.0)),
            ranked("medium", Some(80.0)),
            ranked("clipping", Some(-3.0)),
            ranked("defocus", None),
            Ranked {
                gain_se: 40.0,
                ..Ranked::example("emission")
            },
        ];
        let told: Vec<&str> = d.ranking.iter().map(|r| verdict(&d, r)).collect();
        let expected = [
            "added to the model",
            "refused by sealed data",
            "no better when refitted",
            "not refitted",
            "no sure gain",
        ];
        assert_eq!(told, expected);
        assert!(ranking(&d).contains("<td>40 ± 10</td>"));
        let table = super::found(&d);
        for part in [
            "2.00 ± 0.10 %",
            "100 ± 10",
            "medium would do as well",
            "near_field_light",
        ] {
            assert!(table.contains(part), "{part} in {table}");
        }
    }
}
