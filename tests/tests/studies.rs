//! The paper's experiments, from the command line to the files they leave.

use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    process::{Command, Output},
    sync::atomic::{AtomicBool, Ordering},
};

use eclipse::{
    capture::write,
    studies::{self, Bench, Scale, Verdict},
    synthesize::{self, Occluders, Pattern, Scene, Shooting},
};
use eclipse_tests::{
    lit_ball::{self, lamps},
    program::{run_study, stderr, text},
    scenes,
};
use render::{bsdf::Model, lat_long::LatLong};
use serde_json::Value;

/// Runs a study; its summary and the folder it left.
fn study(name: &str) -> (Value, tempfile::TempDir) {
    study_of(name, &[])
}

/// Runs a study with further arguments.
fn study_of(name: &str, arguments: &[&str]) -> (Value, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let output = run(name, folder.path(), arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let summary = serde_json::from_slice(&output.stdout).unwrap();
    (summary, folder)
}

/// Runs a study into a folder, however it ends.
fn run(name: &str, out: &Path, arguments: &[&str]) -> Output {
    run_study(
        env!("CARGO_BIN_EXE_eclipse-under-test"),
        name,
        out,
        arguments,
    )
}

/// The page says what the summary says, first of all, and every plot has its data.
fn complete(name: &str, summary: &Value, folder: &tempfile::TempDir) {
    complete_with(name, summary, folder, 10);
}

/// The same where a plot may have as few as `rows` rows of data.
fn complete_with(name: &str, summary: &Value, folder: &tempfile::TempDir, rows: usize) {
    let folder = folder.path().join(name);
    let read = |file: &str| fs::read_to_string(folder.join(file)).unwrap();
    let written: Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert_eq!(&written, summary);
    let page = read("study.html");
    let words = match summary["verdict"].as_str().unwrap() {
        "held" => "The claim held here",
        "held_in_part" => "The claim held here in part",
        "not_tested" => "The claim was not tested here",
        _ => "The claim did not hold here",
    };
    assert!(page.contains(&format!("<p class=\"summary\"><b>{words}</b>")));
    assert!(summary["sentence"].as_str().unwrap().starts_with(words));
    let mut plots = 0;
    let drawn = |e: &std::ffi::OsStr| e == "svg" || e == "png";
    for entry in fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(drawn) {
            // Pictures of one figure are numbered and share its data.
            let name = path.file_stem().unwrap().to_string_lossy();
            let name = match path.extension().is_some_and(|e| e == "png") {
                true => name.rsplit_once('-').unwrap().0,
                false => &*name,
            };
            let data = fs::read_to_string(folder.join(format!("{name}.csv"))).unwrap();
            assert!(data.lines().count() > rows, "{}: {data}", path.display());
            plots += 1;
        }
    }
    assert!(plots > 0);
}

#[test]
fn occluders_make_visible_what_a_matt_surface_hides() {
    let (summary, folder) = study("conditioning");
    complete("conditioning", &summary, &folder);
    // By singular values, as in the paper's figure, most is gained at the end; by frequencies it is not, and nothing else fails.
    assert_eq!(summary["verdict"], "held_in_part", "{summary:#}");
    let said = summary["sentence"].as_str().unwrap();
    let (_, failed) = said.split_once(" But ").unwrap();
    assert!(
        failed.starts_with("of frequencies themselves") && !failed.contains(';'),
        "{said}"
    );
    let at = |row: &str, number: &str| summary["numbers"]["blocker"][row][number].as_f64().unwrap();
    // Computed independently with LAPACK's SVD of the same operator.
    let expected = [
        ("no_occlusions", 33.0),
        ("1_observation", 63.0),
        ("2_observations", 98.0),
        ("8_observations", 224.0),
        ("16_observations", 394.0),
        ("32_observations", 512.0),
    ];
    for (row, count) in expected {
        // A value next to the threshold may fall on either side.
        assert!((at(row, "above_1e-3") - count).abs() <= 2.0, "{row}");
    }
    assert!((at("32_observations", "smallest") / 1.3688e-3 - 1.0).abs() < 1e-3);
}

#[test]
fn an_occluder_tells_matt_from_mirror() {
    let (summary, folder) = study("ambiguity");
    complete("ambiguity", &summary, &folder);
    let range = |name: &str| {
        let pair = summary["numbers"][name].as_array().unwrap();
        [0, 1].map(|i| pair[i].as_f64().unwrap())
    };
    let (without, with) = (
        range("difference_without_occluder"),
        range("difference_with_occluder"),
    );
    // Alike but for the rim, and then not.
    assert!(without[1] < 0.03, "{without:?}");
    assert!(with[0] > 5.0 * without[1], "{without:?} {with:?}");
    // The mirror shows more of an occluder than the matt sphere does; what does not hold the page says.
    let change = |of: &str| {
        summary["numbers"]["change_by_occluder"][of][0]
            .as_f64()
            .unwrap()
    };
    assert!(change("mirror") > change("matt"));
    let said = summary["sentence"].as_str().unwrap();
    assert_eq!(
        summary["verdict"] == "held",
        !said.contains("But "),
        "{said}"
    );
}

#[test]
fn masks_are_waves_and_light_is_a_pyramid() {
    let (summary, folder) = study("theory");
    complete("theory", &summary, &folder);
    let numbers = &summary["numbers"];
    for (observations, block) in [(1, 128), (2, 64), (8, 16), (32, 4)] {
        assert_eq!(
            numbers[format!("observations_{observations}")]["block"],
            block
        );
    }
    for contrast in ["low_contrast", "high_contrast"] {
        for exponent in ["a_0.1", "a_1", "a_10"] {
            assert_eq!(numbers[contrast][exponent]["peak_on_diagonal"], true);
        }
    }
    // The exponential of such a light has its energy everywhere, and the page says so in its first line.
    assert!(
        numbers["high_contrast"]["a_0.1"]["within_8_share_most"]
            .as_f64()
            .unwrap()
            < 0.5
    );
    assert_eq!(summary["verdict"], "held_in_part", "{summary:#}");
    let said = summary["sentence"].as_str().unwrap();
    assert!(said.contains("But for a = 0.1 at high contrast"), "{said}");
    assert_eq!(said.matches("for a = ").count(), 1, "{said}");
}

/// A tiny matt capture with its truth, with somebody in the light or nobody.
fn capture(path: &Path, occluders: Occluders) {
    let scene = Scene {
        mesh: scenes::pair().mesh().clone(),
        environment: scenes::interior(LatLong::new(50, 100)).image().clone(),
        model: Model::Lambertian,
        albedo: Pattern {
            mean: [0.6, 0.5, 0.4],
            variation: 0.2,
        },
        alpha: 1.0,
        kappa: 0.0,
        occluders,
    };
    let shooting = Shooting {
        frames: 12,
        resolution: 20,
        distance: 3.0,
        noise: 0.005,
        seed: 0,
    };
    let made = synthesize::synthesize(&scene, &shooting, |_| true).unwrap();
    synthesize::write(path, &scene, &made).unwrap();
}

#[test]
fn somebody_in_the_light_lifts_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pair");
    capture(&path, Occluders::None);
    let (summary, out) = study_of("limit", &[path.to_str().unwrap()]);
    complete("limit", &summary, &out);
    // Read otherwise it tells something else.
    let smaller = [path.to_str().unwrap(), "--max-size", "16", "--up", "z"];
    let (smaller, _) = study_of("limit", &smaller);
    assert_ne!(smaller["numbers"], summary["numbers"]);
    let seeds = |value: &Value| -> Vec<f64> {
        let values = value.as_array().unwrap().iter();
        values.map(|v| v.as_f64().unwrap()).collect()
    };
    let errors = |who: &str, albedo: &str| {
        seeds(&summary["numbers"]["pair"][format!("{who}, albedo {albedo}")]["error"])
    };
    assert_eq!(errors("nobody", "known").len(), 3);
    for seed in 0..3 {
        let error = |who: &str, albedo: &str| errors(who, albedo)[seed];
        // Whoever knows more is not further off, and whoever knows nothing is off by all.
        for who in ["somebody", "nobody"] {
            assert!(error(who, "known") <= error(who, "unknown") && error(who, "unknown") < 1.0);
        }
        for albedo in ["known", "unknown"] {
            let [with, without] = ["somebody", "nobody"].map(|who| error(who, albedo));
            assert!(with < without, "albedo {albedo}: {with}, {without}");
        }
        // Large detail is easier than small.
        let revealed = &summary["numbers"]["pair"]["somebody, albedo known"]["revealed"];
        let shares: Vec<f64> = ["11.2 degrees", "22.5 degrees", "45 degrees", "90 degrees"]
            .iter()
            .map(|size| seeds(&revealed[size])[seed])
            .collect();
        assert!(
            shares.windows(2).all(|pair| pair[0] <= pair[1]),
            "{shares:?}"
        );
    }
    // Whoever plots the data again must know the seeds apart.
    let data = fs::read_to_string(out.path().join("limit/pair-resolved.csv")).unwrap();
    let seeds: BTreeSet<&str> = data
        .lines()
        .skip(1)
        .map(|l| l.rsplit(',').nth(2).unwrap())
        .collect();
    assert_eq!(seeds, ["0", "1", "2"].into());
}

#[test]
fn light_that_is_known_has_no_limit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ball");
    write(
        &path,
        &lit_ball::capture(&lamps(), &lamps(), |_, _, light| light),
    )
    .unwrap();
    let out = folder.path().join("out");
    let output = run("limit", &out, &[text(&path)]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(message.contains("eclipse diagnose"), "{message}");
    assert!(!out.join("limit/study.html").exists());
}

#[test]
fn studies_that_reconstruct_leave_pages() {
    let folder = tempfile::tempdir().unwrap();
    capture(&folder.path().join("pair"), Occluders::Operator);
    capture(&folder.path().join("pair-unoccluded"), Occluders::None);
    let captures = [
        "--glance",
        "--captures",
        folder.path().to_str().unwrap(),
        "--time-limit",
        "1s",
    ];
    for name in ["recovery", "lambertian", "masks", "relighting"] {
        let (summary, out) = study_of(name, &captures);
        // A solve of one second may find little to plot.
        complete_with(name, &summary, &out, 1);
        assert!(
            summary["sentence"].as_str().unwrap().contains("pair"),
            "{name}"
        );
        // The page can be made again from what it says.
        let page = fs::read_to_string(out.path().join(name).join("study.html")).unwrap();
        let command = format!("eclipse study {name} --json --threads 1 --out ");
        assert!(page.contains(&command), "{name}");
        assert!(
            page.contains(" --time-limit 1s</code> makes it again"),
            "{name}"
        );
    }
}

#[test]
fn studies_of_one_capture_or_none_run_at_a_glance() {
    let folder = tempfile::tempdir().unwrap();
    capture(&folder.path().join("pair"), Occluders::Operator);
    let arguments = [
        "--glance",
        "--captures",
        text(folder.path()),
        "--time-limit",
        "1s",
    ];
    // What each says in its sentence, and numbers that must be some.
    let studies = [
        (
            "uncertainty",
            vec!["2 draws of noise", "light: ", "albedo: ", "masks: "],
            vec![
                vec!["light_error_over_predicted"],
                vec!["albedo_error_over_predicted"],
                vec!["masks_error_over_predicted"],
                vec!["masks_rank_correlation_of_error"],
            ],
        ),
        (
            "parametrisation",
            vec![
                "harmonics of masks are better than free values: ",
                "a pyramid of light is better than free values: ",
                "a = 2 is better than a = 1/2: ",
                "degree 4",
                "initial bias 100",
            ],
            vec![
                vec!["balls", "full model", "environment_relative_rmse"],
                vec!["balls", "a = 0.5", "environment_relative_rmse"],
                vec!["figure", "free light", "misfit"],
                vec!["wreath", "free masks", "mask_error"],
            ],
        ),
        (
            "shiny",
            vec!["α 0.2: found α"],
            vec![vec!["alpha 0.2", "environment_relative_rmse"]],
        ),
        (
            "sweeps",
            vec![
                "Larger occluders lower the error",
                "over secondary rays of the paper's algorithm",
            ],
            vec![
                vec!["person", "1.6", "somebody"],
                vec!["rays", "4", "nobody"],
                vec!["rays", "misfit"],
            ],
        ),
        (
            "time",
            vec!["pair: after a quarter of 1 s"],
            vec![vec!["pair", "seed 0", "paper", "environment_relative_rmse"]],
        ),
    ];
    for (name, said, paths) in studies {
        let (summary, out) = study_of(name, &arguments);
        complete_with(name, &summary, &out, 1);
        let sentence = summary["sentence"].as_str().unwrap();
        let details = summary["details"].as_array().unwrap().iter();
        let all: Vec<&str> = details
            .filter_map(Value::as_str)
            .chain([sentence])
            .collect();
        for said in said {
            assert!(
                all.iter().any(|words| words.contains(said)),
                "{said}: {all:?}"
            );
        }
        assert!(
            sentence.contains(|c: char| c.is_ascii_digit()),
            "{sentence}"
        );
        // A glance settles nothing, and says so; nor does what was cut short.
        assert_eq!(summary["verdict"], "not_tested", "{name}");
        let why = match name {
            "parametrisation" => "not tested: harmonics of masks",
            _ => "at a glance",
        };
        assert!(sentence.contains(why), "{sentence}");
        for path in paths {
            let mut found = &summary["numbers"];
            for key in &path {
                found = &found[key];
            }
            let found = found.as_array().map_or(found, |seeds| &seeds[0]);
            assert!(
                found.as_f64().is_some_and(f64::is_finite),
                "{name}, {path:?}: {summary:#}"
            );
        }
    }
}

#[test]
fn a_pair_of_captures_is_made_where_none_were_asked_for() {
    // Nothing of the project's is here, as for whoever has installed the program alone.
    let here = tempfile::tempdir().unwrap();
    let out = here.path().join("out");
    let study = |name: &str, more: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_eclipse-under-test"))
            .current_dir(here.path())
            .args(["study", name, "--glance", "--threads", "1", "--out"])
            .arg(&out)
            .args(more)
            .output();
        output.unwrap().status.code()
    };
    assert_eq!(study("lambertian", &[]), Some(0));
    assert!(out.join("lambertian/study.html").exists());
    // Of others, and of a folder that was asked for, it is an error.
    assert_eq!(study("recovery", &[]), Some(3));
    assert_eq!(study("lambertian", &["--captures", "elsewhere"]), Some(3));
}

#[test]
fn without_a_pair_of_captures_one_is_made() {
    let folder = tempfile::tempdir().unwrap();
    capture(&folder.path().join("alone"), Occluders::Operator);
    let (summary, out) = study_of(
        "lambertian",
        &["--glance", "--captures", text(folder.path())],
    );
    complete_with("lambertian", &summary, &out, 1);
    let sentence = summary["sentence"].as_str().unwrap();
    assert!(sentence.contains("balls: relative RMSE"), "{sentence}");
    let page = fs::read_to_string(out.path().join("lambertian/study.html")).unwrap();
    assert!(page.contains("were made for it"));
}

#[test]
fn a_capture_that_cannot_be_read_is_left_out_and_decides_the_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    capture(&folder.path().join("pair"), Occluders::Operator);
    let broken = folder.path().join("broken/truth");
    fs::create_dir_all(&broken).unwrap();
    fs::write(broken.join("environment.exr"), "no image").unwrap();
    let out = folder.path().join("out");
    let captures = [
        "--glance",
        "--captures",
        text(folder.path()),
        "--time-limit",
        "1s",
    ];
    let output = run("masks", &out, &captures);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(
        message.contains("broken, which cannot be used"),
        "{message}"
    );
    // What was found is printed and written all the same, and says what is missing.
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let sentence = summary["sentence"].as_str().unwrap();
    assert!(
        sentence.contains("pair") && sentence.contains("Left out: broken"),
        "{sentence}"
    );
    assert!(out.join("masks/study.html").is_file());
}

#[test]
fn what_was_found_before_a_stop_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["first", "second"] {
        capture(&folder.path().join(name), Occluders::Operator);
    }
    let stop = AtomicBool::new(false);
    // Somebody presses Ctrl-C after the first solve.
    let tell = |message: &str| {
        if message.contains("environment") {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let mut bench = Bench::new(Scale::Glance, folder.path(), &stop, &tell);
    bench.time_limit = Some(1.0);
    let evidence = studies::run(studies::by_name("masks").unwrap(), &bench).unwrap();
    let sentence = evidence.first_line();
    assert!(
        sentence.contains("first") && !sentence.contains("second"),
        "{sentence}"
    );
    assert!(sentence.contains("Interrupted"), "{sentence}");
    assert_eq!(evidence.verdict, Verdict::NotTested);
}
