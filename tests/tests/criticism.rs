//! Effects planted in the model's own images are found, and at their null they change no bit.

use eclipse::criticism::{
    Verdict,
    certainty::standard_errors,
    chain::{Chain, Link},
    compete, confirm,
    diagnose::screen_at,
    diagnosis::Refitted,
    effects::{self, Term},
    fit::Fit,
    locate::Structured,
    refit, told,
    verdict::{self, Grounds},
};
use eclipse_tests::planted::{
    LARGE, LOBE, Planted, SMALL, capture, leads, pattern, plant, plant_all, plant_on, screened,
    study, terms, true_model, truth,
};

#[test]
fn nulls_change_no_bit() {
    let (study, fit) = true_model();
    let plain = Chain::new(&[], study.seen.len()).and_then(|mut chain| {
        chain.bind(&fit.ideal, &[])?;
        chain.values()
    });
    let plain = plain.unwrap();
    for effect in effects::all() {
        let terms = terms(study, fit, effect);
        let betas = vec![0.0; terms.len()];
        let mut chain = Chain::new(&[Link { effect, terms }], study.seen.len()).unwrap();
        chain.bind(&fit.ideal, &[betas]).unwrap();
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(
            bits(&chain.values().unwrap()),
            bits(&plain),
            "{}",
            effect.id()
        );
    }
}

/// The derivative by one sum for all numbers of an effect is that by each of them.
#[test]
fn columns_are_slopes() {
    let (study, fit) = true_model();
    for effect in effects::all() {
        let terms = terms(study, fit, effect);
        let some: Vec<usize> = [0, 1, terms.len() / 2]
            .into_iter()
            .filter(|k| *k < terms.len())
            .collect();
        let beta = |k: usize| 0.1 * terms[k].scale * pattern(k).abs();
        let base: Vec<f64> = (0..terms.len()).map(beta).collect();
        let scales: Vec<f64> = terms.iter().map(|t| t.scale).collect();
        let mut chain = Chain::new(&[Link { effect, terms }], study.seen.len()).unwrap();
        for k in some {
            let mut at = |step: f64| {
                let mut betas = base.clone();
                betas[k] += step * scales[k];
                chain.bind(&fit.ideal, &[betas]).unwrap();
                chain.values().unwrap()
            };
            let (more, less) = (at(0.02), at(-0.02));
            let mut at_base = || {
                chain.bind(&fit.ideal, std::slice::from_ref(&base)).unwrap();
                chain.column(0, k).unwrap()
            };
            let column = at_base();
            let (mut wrong, mut size) = (0.0f64, 0.0f64);
            for ((m, l), c) in more.iter().zip(&less).zip(&column) {
                let slope = f64::from(m - l) / (0.04 * scales[k]);
                wrong += (slope - f64::from(*c)).powi(2);
                size += slope.powi(2);
            }
            assert!(
                wrong.sqrt() <= 0.02 * size.sqrt() + 1e-6,
                "{} {k}: {wrong} of {size}",
                effect.id()
            );
        }
    }
}

/// What an effect of the camera does to whole photographs is what it does on the tape, and can be taken back.
#[test]
fn the_camera_is_undone_as_it_is_recorded() {
    let (study, fit) = true_model();
    let mut checked = 0;
    for effect in effects::all().into_iter().filter(|e| e.is_of_the_camera()) {
        let terms = terms(study, fit, effect);
        let beta = |(k, term): (usize, &Term)| {
            let part = term.scale * pattern(k);
            if term.least == 0.0 { part.abs() } else { part }
        };
        let betas: Vec<f64> = terms.iter().enumerate().map(beta).collect();
        let numbers = effect.camera_numbers(&terms, &betas);
        let map = effect.camera_map(study.capture, &numbers).unwrap();
        assert!(effect.camera_map(study.capture, &numbers[1..]).is_none());
        let mut chain = Chain::new(&[Link { effect, terms }], study.seen.len()).unwrap();
        chain.bind(&fit.ideal, &[betas]).unwrap();
        let recorded = chain.values().unwrap();
        for i in (0..study.seen.views.len()).step_by(97) {
            let view = &study.seen.views[i];
            let frame = view.frame as usize;
            let mut image = study.capture.frames[frame].image.clone();
            for pixel in image.data.chunks_exact_mut(3) {
                pixel.copy_from_slice(&fit.ideal[3 * i..3 * i + 3]);
            }
            (map.apply)(frame, &mut image);
            let found = effects::support::sample(&image, view.at);
            for c in 0..3 {
                let expected = recorded[3 * i + c];
                assert!(
                    (found[c] - expected).abs() < 2e-3 * expected.abs() + 1e-5,
                    "{}: {} for {expected}",
                    effect.id(),
                    found[c]
                );
            }
        }
        for (t, frame) in study.capture.frames.iter().enumerate() {
            let mut image = frame.image.clone();
            (map.apply)(t, &mut image);
            assert_ne!(image.data, frame.image.data, "{}", effect.id());
            (map.undo)(t, &mut image);
            for (a, b) in image.data.iter().zip(&frame.image.data) {
                assert!((a - b).abs() < 1e-4, "{}: {a} for {b}", effect.id());
            }
        }
        checked += 1;
    }
    assert!(checked >= 5);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_true_null_has_nothing_to_tell() {
    let capture = capture(1.0, &LARGE);
    let mut study = study(&capture, LOBE, &LARGE);
    plant(&mut study, None);
    let screen = screened(&study);
    assert!(
        compete::contenders(&screen).is_empty(),
        "{:?}",
        screen.scores[0]
    );
    let chi2 = screen.before / screen.count as f64;
    assert!((0.7..1.4).contains(&chi2), "{chi2}");
}

/// What is left in frames that no fit has seen tells a mismatch as frames of development do.
#[test]
fn sealed_frames_share_what_was_planted_and_nothing_else() {
    let capture = capture(1.0, &SMALL);
    let mut study = study(&capture, LOBE, &SMALL);
    let fit = truth(&study);
    plant_on(&mut study, &fit, None);
    let null = Structured::in_sealed_frames(&study, &fit).unwrap();
    assert!(null < 0.2, "{null}");
    let effect = effects::by_id("vignetting").unwrap();
    plant_on(&mut study, &fit, Some((effect, &|k, _| [-0.3, -0.1][k])));
    let planted = Structured::in_sealed_frames(&study, &fit).unwrap();
    assert!(planted > 0.5, "{planted}");
}

/// Texture finer than the model's outweighs a falloff, which is found once the model has room for the texture.
#[test]
fn the_search_goes_on_behind_finer_texture() {
    let capture = capture(1.0, &SMALL);
    let mut study = study(&capture, LOBE, &SMALL);
    let fit = truth(&study);
    let [texture, falloff] = ["finer_albedo", "vignetting"].map(|id| effects::by_id(id).unwrap());
    let both: [Planted<'_>; 2] = [
        (texture, &|k, _| 0.5 * pattern(k)),
        (falloff, &|k, _| [-0.2, -0.07][k]),
    ];
    plant_all(&mut study, &fit, &both);
    let mut first = Fit::start(&study).unwrap();
    first.refine(&study, 6).unwrap();

    let names = ["vignetting", "finer_albedo"];
    let search = |fit: &Fit| {
        let inside = |id: &str| fit.active.iter().any(|a| a.effect.id() == id);
        let left = names.into_iter().filter(|id| !inside(id));
        let screen = screen_at(&study, fit, left.filter_map(effects::by_id)).unwrap();
        let contenders = compete::contenders(&screen);
        refit::round(&study, fit, &screen.nuisance, contenders, &|_| Ok(())).unwrap()
    };
    let coarse = search(&first);
    let finer = coarse.finer.as_ref().map(|(id, _)| *id);
    assert_eq!(finer, Some("finer_albedo"), "{:?}", coarse.evidence);
    let fine = search(coarse.best().unwrap());
    assert_eq!(fine.evidence[0].0, "vignetting");

    let rounds = [coarse, fine];
    let opened = confirm::open(&study, &rounds, &mut []).unwrap();
    assert_eq!(opened.finer, ["finer_albedo"]);
    let path: Vec<&str> = opened.path.iter().map(|s| s.choice.score.id).collect();
    assert_eq!(path, ["vignetting"]);
}

/// From the photographs to the verdict: what the ignored tests below ask of screening alone, on a capture small enough for every day.
#[test]
fn what_was_planted_is_found_refitted_confirmed_and_told() {
    let capture = capture(1.0, &SMALL);
    let mut study = study(&capture, LOBE, &SMALL);
    let planted = |k: usize| {
        if k.is_multiple_of(3) {
            0.08 * pattern(k)
        } else {
            0.0
        }
    };
    let effect = effects::by_id("exposure_drift").unwrap();
    plant(&mut study, Some((effect, &|k, _| planted(k))));
    let mut first = Fit::start(&study).unwrap();
    first.refine(&study, 6).unwrap();
    let among = ["exposure_drift", "vignetting", "black_level"];
    let among = among.into_iter().filter_map(effects::by_id);
    let screen = screen_at(&study, &first, among).unwrap();
    leads(&screen, "exposure_drift", 1);

    let contenders = compete::contenders(&screen);
    let round = refit::round(&study, &first, &screen.nuisance, contenders, &|_| Ok(())).unwrap();
    assert_eq!(round.evidence[0].0, "exposure_drift");
    let evidence = round.evidence.iter();
    let mut refits: Vec<Refitted> = evidence
        .map(|&(id, evidence)| Refitted {
            after: 0,
            id,
            evidence,
            sealed: None,
        })
        .collect();
    let rounds = [round];
    let opened = confirm::open(&study, &rounds, &mut refits).unwrap();
    let step = &opened.path[0];
    assert!(refits[0].sealed.unwrap().confirmed);
    assert!(step.gain.gain > 3.0 * step.gain.error, "{:?}", step.gain);

    let errors = standard_errors(&study, step.fit).unwrap();
    let finding = told::finding(step, step.fit, &errors);
    assert_eq!(finding.id, "exposure_drift");
    // What all frames share is light and albedo as well.
    let seen = |t: &usize| !study.frame_is_sealed(*t as u32);
    let numbers = (0..SMALL.frames).filter(seen).map(|t| {
        let name = format!("gain of frame {t} (log)");
        (finding.parameters[&name], planted(3 * t))
    });
    let numbers: Vec<(f64, f64)> = numbers.collect();
    let count = numbers.len() as f64;
    let shared = numbers.iter().map(|(own, truth)| own - truth).sum::<f64>() / count;
    for (own, truth) in &numbers {
        assert!((own - truth - shared).abs() < 0.03, "{numbers:?}");
    }
    let structured = [&rounds[0].null, step.fit].map(|fit| Structured::of(&study, fit));
    let ranking = told::ranked(&screen);
    let grounds = Grounds {
        found: std::slice::from_ref(&finding),
        unknown: opened.unknown,
        refused: opened.refused,
        ranking: &ranking,
        structured: verdict::judged(structured),
    };
    assert_eq!(
        verdict::verdict(&grounds),
        Verdict::Explained,
        "{structured:?}"
    );
}
