//! The paper's estimator on the tape: unbiased against quadrature, where the square of one render is not.

use autodiff::{Graph, Sizes, Var};
use eclipse_tests::scenes;
use eclipse_tests::statistics::mean_and_error;
use glam::Vec3;
use render::bsdf::Model;
use render::bvh::Bvh;
use render::estimator::{Estimator, EstimatorOptions, RenderSample, Unknowns};
use render::lat_long::LatLong;
use render::loss::{LossForm, one_sample};
use render::materials::Network;
use render::path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint};
use render::pyramid::Pyramid;
use render::radiance::{
    batch_sizes, bind_batch, bind_values, record_environment, record_masks, record_radiance,
    table_sizes,
};
use render::visibility::Visibility;

const GRID: LatLong = LatLong::new(8, 16);
const RADII: [f32; 2] = [3.0, 3.2];
const REPEATS: u32 = 300;

/// A small problem: a dozen pixels of two frames, unknowns away from any special point.
struct Problem {
    bvh: Bvh,
    options: EstimatorOptions,
    unknowns: Unknowns,
    points: Vec<ShadingPoint>,
    photographs: Vec<f32>,
}

impl Problem {
    fn new(model: Model, form: LossForm, lookup: Lookup) -> Self {
        let bvh = scenes::pair();
        let camera = scenes::camera(16);
        let mut points = Vec::new();
        for pixel in (0..256_u32).step_by(11) {
            let seen = bvh.seen(
                &camera,
                (pixel % 16) as f32 + 0.5,
                (pixel / 16) as f32 + 0.5,
            );
            if let Some((surface, outgoing)) = seen.filter(|(s, o)| s.normal.dot(*o) > 0.3) {
                points.push(ShadingPoint {
                    surface,
                    outgoing,
                    frame: pixel % 2,
                    pixel,
                    cached: 0,
                    alpha: 0.5,
                });
            }
        }
        points.truncate(6);
        assert_eq!(points.len(), 6);
        let options = EstimatorOptions {
            model,
            pyramid: Pyramid::new(GRID, 3),
            mask_grid: GRID,
            degree: 3,
            frames: 2,
            lookup,
            form,
        };
        let mut unknowns = options.start(1.0, 7, 1.0);
        for (i, v) in unknowns.environment.iter_mut().enumerate() {
            *v = 0.25 * (1.7 * i as f32).sin();
        }
        for (i, v) in unknowns.occluders.iter_mut().enumerate() {
            *v += 0.8 * (2.3 * i as f32).cos();
        }
        for v in unknowns
            .network
            .weights
            .last_mut()
            .expect("the network has layers")
        {
            *v *= 20.0;
        }
        // Photographs of something else, so that deviations are neither small nor of one sign.
        let photographs = (0..18)
            .map(|i| 0.5 + 0.4 * (0.9 * i as f32).sin())
            .collect();
        Self {
            bvh,
            options,
            unknowns,
            points,
            photographs,
        }
    }

    /// The paths' scene, with light samples drawn from the present environment's brightness.
    fn with_scene<T>(&self, run: impl FnOnce(&PathScene) -> T) -> T {
        let mut brightness = vec![0.0; GRID.len()];
        for levels in self
            .unknowns
            .environment
            .chunks_exact(self.options.pyramid.len())
        {
            let mut finest = vec![0.0; GRID.len()];
            self.options.pyramid.apply(levels, &mut finest, 1);
            brightness
                .iter_mut()
                .zip(finest)
                .for_each(|(b, f)| *b += f32::exp(f));
        }
        let lights = render::environment::LightDistribution::new(GRID, &brightness);
        run(&PathScene {
            bvh: &self.bvh,
            visibility: Visibility::Rays,
            model: self.options.model,
            lights: &lights,
            environment_grid: GRID,
            mask_grid: GRID,
            radii: &RADII,
        })
    }

    fn positions(&self) -> Vec<Vec3> {
        self.points.iter().map(|p| p.surface.position).collect()
    }

    fn paths(&self, iteration: u32, render: u32) -> PathBatch {
        let settings = PathSettings {
            light_samples: 4,
            material_samples: 4,
            seed: 11,
            iteration,
            lookup: self.options.lookup,
            render,
        };
        self.with_scene(|scene| PathBatch::sample(scene, &self.points, &settings))
    }

    /// Loss and gradient by quadrature: both renders are the expected image.
    fn expected(&self) -> (f64, Unknowns) {
        let estimator = self.estimator(LossForm::Product, Lookup::Bilinear);
        let batch = self.with_scene(|scene| PathBatch::quadrature(scene, &self.points, 12));
        let render = RenderSample {
            positions: &self.positions(),
            batch: &batch,
        };
        estimator
            .gradients(&self.unknowns, [render, render], &self.photographs)
            .expect("sizes agree")
    }

    fn estimator(&self, form: LossForm, lookup: Lookup) -> Estimator {
        Estimator::new(EstimatorOptions {
            form,
            lookup,
            ..self.options.clone()
        })
        .expect("the formulas fit")
    }
}

/// Gradients as a few numbers: fixed random directions within each kind of unknown.
fn project(gradient: &Unknowns) -> Vec<f64> {
    let last = gradient
        .network
        .weights
        .last()
        .expect("the network has layers");
    let parts = [
        &gradient.environment,
        &gradient.occluders,
        &gradient.network.weights[1],
        last,
    ];
    let mut values = Vec::new();
    for part in parts {
        for direction in 0..4_u32 {
            let sign = |i: usize| {
                if direction == 0
                    || (i as u32).wrapping_mul(2_654_435_761) >> (8 + direction) & 1 == 0
                {
                    1.0
                } else {
                    -1.0
                }
            };
            values.push(
                part.iter()
                    .enumerate()
                    .map(|(i, g)| sign(i) * f64::from(*g))
                    .sum(),
            );
        }
    }
    values
}

#[test]
fn the_tape_renders_what_plain_numbers_do() {
    for model in [Model::Lambertian, Model::Microfacet] {
        let problem = Problem::new(model, LossForm::Product, Lookup::Bilinear);
        let batch = problem.paths(0, 0);
        let g = Graph::new();
        let pixel = g.domain("pixel");
        let environment = record_environment(&g, &problem.options.pyramid);
        let masks = record_masks(&g, 3, GRID, 2);
        let shading = Network::record(&g).evaluate(&g, "first", &pixel);
        let image = record_radiance(
            &g,
            "first",
            &pixel,
            model,
            Lookup::Bilinear,
            &environment,
            Some(&masks),
            &shading,
        );
        let outputs = [
            ("image", &image),
            ("light", &environment.value),
            ("masks", &masks.value),
        ];
        let program = g.compile(&outputs).expect("the formulas fit");
        let sizes =
            table_sizes(Sizes::new(), &problem.options.pyramid, 3, GRID, 2).lanes("pixel", 6);
        let mut ws = program
            .workspace::<f64>(&batch_sizes(sizes, "first", &batch))
            .expect("sizes agree");
        bind_values(&mut ws, "environment", &problem.unknowns.environment).expect("bound");
        bind_values(&mut ws, "occluders", &problem.unknowns.occluders).expect("bound");
        problem.unknowns.network.bind(&mut ws).expect("bound");
        let encoding = problem.unknowns.network.encode(&problem.positions());
        bind_values(&mut ws, "first encoding", &encoding).expect("bound");
        bind_batch(&mut ws, "first", model, true, &batch).expect("bound");
        program.forward(&mut ws).expect("everything is bound");
        let light = ws.output("light").expect("an output");
        let table: Vec<f32> = (0..GRID.len())
            .flat_map(|t| [0, 1, 2].map(|c| light[c * GRID.len() + t] as f32))
            .collect();
        let masks: Vec<f32> = ws
            .output("masks")
            .expect("an output")
            .iter()
            .map(|m| *m as f32)
            .collect();
        for (p, position) in problem.positions().into_iter().enumerate() {
            let material = problem.unknowns.network.evaluate(position);
            let plain = batch.radiance(p, model, &material, &table, &masks);
            for c in 0..3 {
                let taped = ws.output("image").expect("an output")[c * 6 + p];
                assert!(
                    (taped / plain[c] - 1.0).abs() < 1e-4,
                    "{model:?} {p} {c}: {taped} {}",
                    plain[c]
                );
            }
        }
    }
}

#[test]
fn the_expected_gradient_is_that_of_finite_differences() {
    for model in [Model::Lambertian, Model::Microfacet] {
        let mut problem = Problem::new(model, LossForm::Product, Lookup::Bilinear);
        let (_, gradient) = problem.expected();
        for (i, step) in [(0_usize, 2e-2_f32), (9, 2e-2), (40, 2e-2)] {
            for kind in 0..2 {
                let analytic = if kind == 0 {
                    gradient.environment[i]
                } else {
                    gradient.occluders[i % 32]
                };
                let mut loss_at = |delta: f32| {
                    let value = if kind == 0 {
                        &mut problem.unknowns.environment[i]
                    } else {
                        &mut problem.unknowns.occluders[i % 32]
                    };
                    let kept = *value;
                    *value += delta;
                    let loss = problem.expected().0;
                    if kind == 0 {
                        problem.unknowns.environment[i] = kept
                    } else {
                        problem.unknowns.occluders[i % 32] = kept
                    }
                    loss
                };
                let numeric = (loss_at(step) - loss_at(-step)) / f64::from(2.0 * step);
                assert!(
                    (numeric - f64::from(analytic)).abs() < 2e-3 + 0.01 * numeric.abs(),
                    "{model:?} {kind} {i}: {numeric} {analytic}"
                );
            }
        }
    }
}

#[test]
fn both_forms_of_the_two_sample_loss_are_unbiased() {
    for model in [Model::Lambertian, Model::Microfacet] {
        let cases = [
            (LossForm::Product, Lookup::Bilinear),
            (LossForm::HalfBackward, Lookup::Bilinear),
            (LossForm::HalfBackward, Lookup::Stochastic),
        ];
        for (form, lookup) in cases {
            let problem = Problem::new(model, form, lookup);
            let expected = project(&problem.expected().1);
            let estimator = problem.estimator(form, lookup);
            let positions = problem.positions();
            let samples: Vec<Vec<f64>> = (0..REPEATS)
                .map(|iteration| {
                    let (first, second) =
                        (problem.paths(iteration, 0), problem.paths(iteration, 1));
                    let renders = [&first, &second].map(|batch| RenderSample {
                        positions: &positions,
                        batch,
                    });
                    let (_, gradient) = estimator
                        .gradients(&problem.unknowns, renders, &problem.photographs)
                        .expect("sizes agree");
                    project(&gradient)
                })
                .collect();
            let mut worst: f64 = 0.0;
            for (k, expected) in expected.iter().enumerate() {
                let values: Vec<f64> = samples.iter().map(|s| s[k]).collect();
                let (mean, error) = mean_and_error(&values);
                worst = worst.max(((mean - expected) / error).abs());
            }
            println!(
                "{model:?} {form:?} {lookup:?}: largest of {} z values: {worst:.2}",
                expected.len()
            );
            assert!(
                worst < 4.0,
                "{model:?} {form:?} {lookup:?}: {worst} standard errors"
            );
        }
    }
}

#[test]
fn the_square_of_one_render_is_biased() {
    let model = Model::Lambertian;
    let problem = Problem::new(model, LossForm::Product, Lookup::Bilinear);
    let expected: f64 = problem
        .expected()
        .1
        .environment
        .iter()
        .map(|g| f64::from(*g))
        .sum();
    let g = Graph::new();
    let pixel = g.domain("pixel");
    let environment = record_environment(&g, &problem.options.pyramid);
    let masks = record_masks(&g, 3, GRID, 2);
    let shading = Network::record(&g).evaluate(&g, "first", &pixel);
    let image: Var = record_radiance(
        &g,
        "first",
        &pixel,
        model,
        Lookup::Bilinear,
        &environment,
        Some(&masks),
        &shading,
    );
    let loss = one_sample(&image, &g.input("photograph", &pixel, 3));
    let program = g.compile(&[("loss", &loss)]).expect("the formulas fit");
    let values: Vec<f64> = (0..REPEATS)
        .map(|iteration| {
            let batch = problem.paths(iteration, 0);
            let sizes =
                table_sizes(Sizes::new(), &problem.options.pyramid, 3, GRID, 2).lanes("pixel", 6);
            let mut ws = program
                .workspace::<f32>(&batch_sizes(sizes, "first", &batch))
                .expect("sizes agree");
            ws.set("environment", &problem.unknowns.environment)
                .expect("bound");
            ws.set("occluders", &problem.unknowns.occluders)
                .expect("bound");
            problem.unknowns.network.bind(&mut ws).expect("bound");
            ws.set(
                "first encoding",
                &problem.unknowns.network.encode(&problem.positions()),
            )
            .expect("bound");
            ws.set("photograph", &problem.photographs).expect("bound");
            bind_batch(&mut ws, "first", model, true, &batch).expect("bound");
            program.vjp(&mut ws, "loss").expect("everything is bound");
            ws.gradient("environment")
                .expect("a parameter")
                .iter()
                .map(|g| f64::from(*g))
                .sum()
        })
        .collect();
    let (mean, error) = mean_and_error(&values);
    let z = (mean - expected) / error;
    println!("one-sample square: {z:.1} standard errors from the truth");
    // Brighter light makes a noisier render, so the square asks for less light than it should.
    assert!(z > 6.0, "{z}");
}
