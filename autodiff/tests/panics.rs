//! An operation of the user's that panics leaves a workspace that can be used again.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use autodiff::{CustomOp, Fma, Graph, LinearMap, Program, Real, Sizes, Workspace};

/// A cube that cannot stand what is negative.
struct Fragile;

impl CustomOp<1> for Fragile {
    fn name(&self) -> &'static str {
        "fragile"
    }
    fn eval<R: Real, F: Fma>(&self, [x]: [R; 1]) -> R {
        assert!(x.to_f64() >= 0.0, "negative");
        x * x * x
    }
}

/// Twice its operand, unless that is negative.
struct Twice(usize);

impl Twice {
    fn run(input: &[f64], output: &mut [f64]) {
        assert!(input.iter().all(|x| *x >= 0.0), "negative");
        output.iter_mut().zip(input).for_each(|(y, x)| *y = 2.0 * x);
    }
}

impl LinearMap for Twice {
    fn shape(&self) -> (usize, usize) {
        (self.0, self.0)
    }
    fn apply_f32(&self, _: usize, _: &[f32], _: &mut [f32]) {}
    fn apply_transpose_f32(&self, _: usize, _: &[f32], _: &mut [f32]) {}
    fn apply_f64(&self, _: usize, input: &[f64], output: &mut [f64]) {
        Twice::run(input, output);
    }
    fn apply_transpose_f64(&self, _: usize, input: &[f64], output: &mut [f64]) {
        Twice::run(input, output);
    }
}

const PIXELS: usize = 900;
const EACH: usize = 30;

fn program(mapped: bool) -> Program {
    let g = Graph::new();
    let (pixel, other) = (g.domain("pixel"), g.domain("other"));
    let sample = g.segments("sample", &pixel);
    let x = g.param("x", &pixel, 1);
    let light = g.input("light", &sample, 1);
    let y = match mapped {
        true => x.linear_map(&other, Arc::new(Twice(PIXELS))).square(),
        false => g
            .custom(Fragile, [&(x.expand(&sample) * light)])
            .segment_mean()
            .square(),
    };
    g.compile(&[("loss", &y.sum()), ("y", &y)]).unwrap()
}

fn workspace(program: &Program) -> Workspace<f64> {
    let sizes = Sizes::new()
        .lanes("pixel", PIXELS)
        .lanes("other", PIXELS)
        .per_parent("sample", EACH)
        .block(256);
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    ws.set("x", &[0.5; PIXELS]).unwrap();
    ws.set("light", &vec![0.5; PIXELS * EACH]).unwrap();
    ws
}

fn results(program: &Program, ws: &mut Workspace<f64>) -> Vec<Vec<f64>> {
    let direction: [(&str, &[f64]); 1] = [("x", &[1.0; PIXELS])];
    program.vjp(ws, "loss").unwrap();
    let mut all = vec![
        ws.output("y").unwrap().to_vec(),
        ws.gradient("x").unwrap().to_vec(),
    ];
    program.gauss_newton(ws, "y", &direction, None).unwrap();
    all.push(ws.tangent("y").unwrap().to_vec());
    all.push(ws.gradient("x").unwrap().to_vec());
    program.hvp(ws, "loss", &direction).unwrap();
    all.push(ws.hessian_product("x").unwrap().to_vec());
    all
}

#[test]
fn a_workspace_survives_a_panic_of_an_operation() {
    for (threads, mapped) in [(1, false), (2, false), (1, true)] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let program = program(mapped);
            let expected = results(&program, &mut workspace(&program));
            let mut ws = workspace(&program);
            let mut bad = vec![0.5; PIXELS];
            bad[PIXELS / 2] = -1.0;
            let ones: [(&str, &[f64]); 1] = [("x", &[1.0; PIXELS])];
            type Run<'a> = &'a dyn Fn(&Program, &mut Workspace<f64>);
            let runs: [Run; 5] = [
                &|program, ws| program.forward(ws).unwrap(),
                &|program, ws| program.vjp(ws, "loss").unwrap(),
                &|program, ws| program.jvp(ws, &ones).unwrap(),
                &|program, ws| program.hvp(ws, "loss", &ones).unwrap(),
                &|program, ws| drop(program.find_singularities(ws, "loss")),
            ];
            for run in runs {
                ws.set("x", &bad).unwrap();
                let outcome = catch_unwind(AssertUnwindSafe(|| run(&program, &mut ws)));
                assert!(outcome.is_err());
                assert!(ws.output("y").is_err());
                ws.set("x", &[0.5; PIXELS]).unwrap();
                assert!(results(&program, &mut ws) == expected);
            }
        });
    }
}
