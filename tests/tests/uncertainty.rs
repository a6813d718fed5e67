//! Predicted standard deviations against the spread of solutions over draws of the noise.

use std::{fs, sync::OnceLock};

use eclipse::{
    capture::Capture,
    image_io::read_exr,
    output,
    reconstruct::{
        detail::Data,
        fast::{self, Prepared, Problem, Stage, Start},
        laplace::{Effort, Part},
        least_squares::Linearisation,
        model::Shared,
        noise,
        patches::Observations,
        surface::Surface,
        uncertainty::{Deviations, Posterior},
    },
    reconstruction::{Uncertainty, UncertaintySummary},
    report::{ReportOptions, html},
    settings::OccluderPrior,
};
use eclipse_tests::perfect;
use render::{bvh::Bvh, lat_long::LatLong, sampler::SampleKey};

/// Relative noise of every view.
const NOISE: f32 = 0.02;
const DRAWS: u64 = 24;
const STAGE: Stage = Stage {
    rows: 8,
    patches: 60,
    members: 4,
    steps: 5,
    products: 40,
};
const ALL: Effort = Effort {
    products: 160,
    probes: 8,
};

/// A small problem whose truth the model can represent.
struct Small {
    observations: Observations,
    shared: Shared,
    truth: Vec<f32>,
    clean: Vec<[f32; 3]>,
}

impl Small {
    fn new(capture: &Capture, occluders: Option<OccluderPrior>) -> Self {
        let bvh = Bvh::new(&capture.mesh).unwrap();
        let noise = noise::estimate(&capture.frames);
        let problem = Problem {
            bvh: &bvh,
            frames: &capture.frames,
            noise: &noise,
            occluders,
            harmonic_degree: 4,
            seed: 0,
            threads: 1,
        };
        let grid = LatLong::new(STAGE.rows, 2 * STAGE.rows);
        let surface = Surface::new(&bvh, &capture.frames, &noise, grid, 400, 0, &|_, _| true);
        let Prepared {
            observations,
            shared,
            ..
        } = fast::prepare(&problem, &surface, &STAGE, &|_, _| true).unwrap();
        let mut stream = SampleKey::default().stream();
        let truth: Vec<f32> = (0..shared.parameters())
            .map(|_| 0.4 * stream.normal())
            .collect();
        let (at, _) = shared.linearise(&truth).unwrap();
        let clean = at.predicted(&observations).unwrap();
        drop(at);
        Self {
            observations,
            shared,
            truth,
            clean,
        }
    }

    /// Photographs with another draw of noise.
    fn draw(&mut self, seed: u64) {
        self.shared.fit_to(&self.observations, &self.drawn(seed));
    }

    fn drawn(&self, seed: u64) -> Data {
        let key = SampleKey {
            seed,
            frame: 7,
            ..SampleKey::default()
        };
        let mut stream = key.stream();
        Data {
            value: self
                .clean
                .iter()
                .map(|v| v.map(|v| v * (1.0 + NOISE * stream.normal())))
                .collect(),
            weight: self
                .clean
                .iter()
                .map(|v| v.map(|v| 1.0 / (NOISE * v).powi(2).max(1e-12)))
                .collect(),
            excess: 1.0,
        }
    }

    fn solve(&self) -> Vec<f32> {
        let start = Start {
            z: self.truth.clone(),
            damping: 0.1,
            step: 0,
        };
        fast::solve(&self.shared, &STAGE, start, &mut |_| true)
            .unwrap()
            .z
    }

    fn deviations(&self, z: &[f32], effort: Effort, part: Part) -> Deviations {
        let mut posterior = Posterior::new(&self.shared, z, effort, 1, &mut || true).unwrap();
        posterior.deviations(part)
    }
}

/// The problem without occluders with its first draw of noise, and its solution, made once.
fn drawn() -> &'static (Small, Vec<f32>) {
    static DRAWN: OnceLock<(Small, Vec<f32>)> = OnceLock::new();
    DRAWN.get_or_init(|| {
        let mut small = Small::new(&perfect::capture(), None);
        small.draw(0);
        let z = small.solve();
        (small, z)
    })
}

/// Standard deviation over draws, value by value.
fn spread(draws: &[Vec<f32>]) -> Vec<f64> {
    let n = draws.len() as f64;
    (0..draws[0].len())
        .map(|i| {
            let values = || draws.iter().map(|draw| f64::from(draw[i]));
            let mean = values().sum::<f64>() / n;
            (values().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
        })
        .collect()
}

/// The ratio of root mean squares, and the correlation of logarithms.
fn agreement(found: &[f64], predicted: &[f32]) -> [f64; 2] {
    let predicted: Vec<f64> = predicted.iter().map(|&v| v.into()).collect();
    let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>();
    let ratio = (square(found) / square(&predicted)).sqrt();
    let log = |values: &[f64]| -> Vec<f64> {
        let logs: Vec<f64> = values.iter().map(|v| (v + 1e-12).ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        logs.iter().map(|v| v - mean).collect()
    };
    let (a, b) = (log(found), log(&predicted));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    [
        ratio,
        product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt(),
    ]
}

#[test]
fn noise_spreads_light_and_masks_as_much_as_predicted_and_albedo_by_no_more() {
    let mut small = Small::new(&perfect::capture(), Some(OccluderPrior::Operator));
    let mut found: [Vec<Vec<f32>>; 3] = Default::default();
    for seed in 0..DRAWS {
        small.draw(seed);
        let z = small.solve();
        let (at, albedo) = small.shared.linearise(&z).unwrap();
        found[0].push(at.radiance().unwrap());
        found[1].push(albedo);
        drop(at);
        found[2].push(small.shared.masks(&z).unwrap());
    }
    let z = small.solve();
    let deviations = small.deviations(&z, ALL, Part::Noise);
    let albedo = found[1].last().unwrap().iter().zip(&deviations.albedo);
    let albedo = albedo.map(|(albedo, relative)| albedo * relative).collect();
    let predicted = [deviations.radiance, albedo, deviations.masks];
    for ((what, found), predicted) in ["light", "albedo", "masks"]
        .iter()
        .zip(&found)
        .zip(&predicted)
    {
        let [ratio, correlation] = agreement(&spread(found), predicted);
        // How dark all of the albedo is, its own prior tells and not the noise; as data it is counted as noise all the same.
        let least = if *what == "albedo" { 0.3 } else { 0.75 };
        assert!((least..1.3).contains(&ratio), "{what}: {ratio}");
        assert!(correlation > 0.8, "{what}: {correlation}");
    }
}

#[test]
fn misfits_are_told_as_they_were_before_weights_were_lowered() {
    let mut small = Small::new(&perfect::capture(), None);
    small.draw(0);
    let z = small.solve();
    let mut misfit = |excess: f32| {
        let mut data = small.drawn(0);
        // Expected to be a sixth of what noise is; an excess is what weights were lowered for, by its square.
        for weight in data.weight.iter_mut().flatten() {
            *weight *= (6.0 / excess).powi(2);
        }
        data.excess = f64::from(excess);
        small.shared.fit_to(&small.observations, &data);
        let few = Effort {
            products: 5,
            probes: 1,
        };
        Posterior::new(&small.shared, &z, few, 1, &mut || true)
            .unwrap()
            .misfit
    };
    let [plain, lowered] = [misfit(1.0), misfit(4.0)];
    assert!((4.0..6.5).contains(&plain), "{plain}");
    assert!((lowered / plain - 1.0).abs() < 0.05, "{lowered} {plain}");
}

#[test]
fn more_products_only_make_surer_and_all_is_more_than_noise() {
    let (small, z) = drawn();
    let of = |products: usize, part: Part| {
        let effort = Effort {
            products,
            probes: 4,
        };
        small.deviations(z, effort, part).radiance
    };
    let mean = |values: &[f32]| values.iter().map(|v| f64::from(*v)).sum::<f64>();
    let all: Vec<Vec<f32>> = [0, 10, 40, 160, 320]
        .iter()
        .map(|&p| of(p, Part::All))
        .collect();
    let (at, _) = small.shared.linearise(z).unwrap();
    let radiance = at.radiance().unwrap();
    drop(at);
    // Without a look at the data there is the prior, of the logarithm: half the width of e^±σ.
    for ((deviation, radiance), prior) in all[0]
        .iter()
        .zip(&radiance)
        .zip(small.shared.prior_variances(z))
    {
        let expected = radiance * prior.sqrt().sinh() as f32;
        assert!((deviation - expected).abs() <= 1e-4 * expected);
    }
    for pair in all.windows(2) {
        for (less, more) in pair[0].iter().zip(&pair[1]) {
            assert!(*more <= 1.02 * less, "{less} {more}");
        }
    }
    assert!(mean(&all[3]) < 0.7 * mean(&all[0]));
    assert!(mean(&of(160, Part::Noise)) < mean(&all[3]));
}

#[test]
fn what_is_missed_bounds_what_more_products_find() {
    let (small, z) = drawn();
    let bounds: Vec<[f64; 2]> = [5, 20, 80, 320]
        .iter()
        .map(|&products| {
            let effort = Effort {
                products,
                probes: 64,
            };
            let posterior = Posterior::new(&small.shared, z, effort, 1, &mut || true).unwrap();
            [posterior.known(), posterior.known_at_most()]
        })
        .collect();
    let [all, at_most] = bounds[3];
    assert!(at_most < 1.1 * all, "{bounds:?}");
    assert!(bounds[0][1] > 2.0 * bounds[0][0], "{bounds:?}");
    // Sixty-four probes estimate a trace to within a fifth.
    for pair in bounds.windows(2) {
        assert!(pair[0][0] <= pair[1][0], "{bounds:?}");
        assert!(1.2 * pair[0][1] > all, "{bounds:?}");
    }
}

#[test]
fn deviations_are_written_and_shown_and_do_not_outlive_their_run() {
    let capture = perfect::capture();
    let mut found = perfect::reconstruction(&capture);
    let mut environment = found.environment.clone();
    environment.data.iter_mut().for_each(|v| *v *= 0.25);
    found.uncertainty = Some(Uncertainty {
        environment,
        occluders: found.occluders.clone(),
        albedo: found.renders.clone(),
        vertex_albedo: vec![[0.1; 3]; capture.mesh.positions.len()],
        summary: UncertaintySummary {
            environment: 0.25,
            albedo: 0.125,
            occluders: (0..found.occluders.len())
                .map(|t| (t > 0).then_some(0.5))
                .collect(),
            ..Default::default()
        },
    });
    let folder = tempfile::tempdir().unwrap();
    let options = ReportOptions::default();
    output::write(folder.path(), &capture, &found, &options).unwrap();
    let deviation = read_exr(&folder.path().join("environment_sd.exr")).unwrap();
    assert_eq!(
        deviation.data,
        found.uncertainty.as_ref().unwrap().environment.data
    );
    for name in ["occluders_sd", "albedo_sd"] {
        let count = fs::read_dir(folder.path().join(name)).unwrap().count();
        assert_eq!(count, capture.frames.len(), "{name}");
    }
    let page = html(&capture, &found, &options).unwrap();
    assert!(page.contains("off by 0.25 of its RMS and albedo by 0.125"));
    assert!(page.contains("id=\"environment-sd\"") && page.contains("id=\"frame-albedo-sd\""));
    assert_eq!(
        page.matches(" ± 0.5</figcaption>").count(),
        found.occluders.len() - 1
    );
    found.uncertainty = None;
    output::write(folder.path(), &capture, &found, &options).unwrap();
    assert!(!folder.path().join("environment_sd.exr").exists());
    assert_eq!(
        fs::read_dir(folder.path().join("albedo_sd"))
            .unwrap()
            .count(),
        0
    );
    assert!(
        !html(&capture, &found, &options)
            .unwrap()
            .contains("environment-sd\" src")
    );
}

#[test]
fn the_rest_is_orthogonal_to_what_was_found() {
    let (small, _) = drawn();
    let (mut at, _) = small.shared.linearise(&small.truth).unwrap();
    let n = small.truth.len();
    let projector = eclipse::reconstruct::least_squares::Projector::new(
        &at,
        small.shared.albedos(),
        small.shared.albedo_precision,
    );
    let mut stream = SampleKey::default().stream();
    let found = eclipse::reconstruct::laplace::Laplace::new(
        &mut at,
        n,
        &projector,
        1.0,
        Effort {
            products: 30,
            probes: 2,
        },
        &mut || stream.normal(),
        &|_, _| Vec::new(),
        &mut || true,
    );
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(x * y)).sum::<f64>();
    for (i, v) in found.vectors.iter().enumerate() {
        for (j, w) in found.vectors.iter().enumerate() {
            assert!((dot(v, w) - f64::from(u8::from(i == j))).abs() < 1e-4);
        }
        for (rest, _) in &found.rest {
            assert!(dot(v, rest).abs() < 1e-3);
        }
    }
    assert!(found.missed > 0.0 && found.known_at_most() > found.known());
    assert!(found.missed <= (n - found.vectors.len()) as f64);
    // The largest eigenvalue is the largest stretch: none of the others' directions is stretched more.
    assert!(found.values.windows(2).all(|pair| pair[0] >= pair[1]));
    let mut u = at.jvp(&found.vectors[0]);
    projector.project(&at, &mut u);
    let stretch = dot(&u, &at.jvp(&found.vectors[0]));
    assert!((stretch / found.values[0] - 1.0).abs() < 1e-2);
}
