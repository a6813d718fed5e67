//! Every elementwise operation: its derivative against central differences, and what it does where it is singular.

use autodiff::{Detached, Graph, Program, Sizes, Var, Workspace};
use proptest::prelude::*;
use proptest::test_runner::FileFailurePersistence;

type Record = fn(&Var, &Var) -> Var;
type Range = (f64, f64);

/// Operations on an `x` and a `y` in the given ranges, away from kinks.
const OPS: &[(&str, Record, Range, Range)] = &[
    ("add", |x, y| x + y, (-2.0, 2.0), (-2.0, 2.0)),
    ("sub", |x, y| x - y, (-2.0, 2.0), (-2.0, 2.0)),
    ("mul", |x, y| x * y, (-2.0, 2.0), (-2.0, 2.0)),
    ("div", |x, y| x / y, (-2.0, 2.0), (0.5, 2.0)),
    ("neg", |x, _| -x, (-2.0, 2.0), (0.0, 1.0)),
    ("affine", |x, _| 3.0 - x * 2.0, (-2.0, 2.0), (0.0, 1.0)),
    ("scalar over", |x, _| 2.0 / x, (0.5, 2.0), (0.0, 1.0)),
    ("mul_add", |x, y| x.mul_add(y, x), (-2.0, 2.0), (-2.0, 2.0)),
    ("sqrt", |x, _| x.sqrt(), (0.3, 2.0), (0.0, 1.0)),
    ("rsqrt", |x, _| x.rsqrt(), (0.3, 2.0), (0.0, 1.0)),
    ("recip", |x, _| x.recip(), (0.3, 2.0), (0.0, 1.0)),
    ("exp", |x, _| x.exp(), (-2.0, 2.0), (0.0, 1.0)),
    ("ln", |x, _| x.ln(), (0.3, 2.0), (0.0, 1.0)),
    ("pow", |x, y| x.pow(y), (0.3, 2.0), (-2.0, 2.0)),
    ("square", |x, _| x.square(), (-2.0, 2.0), (0.0, 1.0)),
    ("powi 5", |x, _| x.powi(5), (-2.0, 2.0), (0.0, 1.0)),
    ("powi 7", |x, _| x.powi(7), (-1.5, 1.5), (0.0, 1.0)),
    ("powi -2", |x, _| x.powi(-2), (-2.0, -0.5), (0.0, 1.0)),
    ("powi -3", |x, _| x.powi(-3), (0.5, 2.0), (0.0, 1.0)),
    ("sin", |x, _| x.sin(), (-4.0, 4.0), (0.0, 1.0)),
    ("cos", |x, _| x.cos(), (-4.0, 4.0), (0.0, 1.0)),
    ("acos", |x, _| x.acos(), (-0.9, 0.9), (0.0, 1.0)),
    ("atan2", |x, y| x.atan2(y), (-2.0, 2.0), (0.2, 2.0)),
    ("sigmoid", |x, _| x.sigmoid(), (-9.0, 9.0), (0.0, 1.0)),
    ("softplus", |x, _| x.softplus(), (-9.0, 9.0), (0.0, 1.0)),
    ("abs above", |x, _| x.abs(), (0.1, 2.0), (0.0, 1.0)),
    ("abs below", |x, _| x.abs(), (-2.0, -0.1), (0.0, 1.0)),
    ("relu above", |x, _| x.relu(), (0.1, 2.0), (0.0, 1.0)),
    ("relu below", |x, _| x.relu(), (-2.0, -0.1), (0.0, 1.0)),
    ("min first", |x, y| x.min(y), (0.0, 1.0), (1.1, 2.0)),
    ("min second", |x, y| x.min(y), (1.1, 2.0), (0.0, 1.0)),
    ("max first", |x, y| x.max(y), (1.1, 2.0), (0.0, 1.0)),
    ("max second", |x, y| x.max(y), (0.0, 1.0), (1.1, 2.0)),
    (
        "clamp inside",
        |x, _| x.clamp(0.0, 2.0),
        (0.1, 1.9),
        (0.0, 1.0),
    ),
    (
        "clamp outside",
        |x, _| x.clamp(3.0, 4.0),
        (0.1, 1.9),
        (0.0, 1.0),
    ),
    (
        "select first",
        |x, y| x.lt(y).select(&(x * x), &y.exp()),
        (0.0, 1.0),
        (1.1, 2.0),
    ),
    (
        "select second",
        |x, y| x.lt(y).select(&(x * x), &y.exp()),
        (1.1, 2.0),
        (0.0, 1.0),
    ),
    (
        "stack dot",
        |x, y| Var::stack(&[x, y]).dot(&Var::stack(&[y, &x.square()])),
        (-1.0, 1.0),
        (-1.0, 1.0),
    ),
    (
        "normalize",
        |x, y| Var::stack(&[x, y]).normalize().channel(1),
        (0.2, 1.0),
        (0.2, 1.0),
    ),
];

fn program(record: Record) -> Program {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (x, y) = (g.param("x", &lane, 1), g.param("y", &lane, 1));
    g.compile(&[("z", &record(&x, &y))]).unwrap()
}

fn workspace(program: &Program, x: &[f64], y: &[f64]) -> Workspace<f64> {
    let sizes = Sizes::new().lanes("lane", x.len());
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    ws.set("x", x).unwrap();
    ws.set("y", y).unwrap();
    ws
}

fn value(program: &Program, x: f64, y: f64) -> f64 {
    let mut ws = workspace(program, &[x], &[y]);
    program.forward(&mut ws).unwrap();
    ws.output("z").unwrap()[0]
}

/// Failing seeds are kept beside the tests.
fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(
            "tests/ops.regressions",
        ))),
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(config(24))]

    #[test]
    fn derivatives_match_central_differences(u in 0.0..1.0f64, v in 0.0..1.0f64) {
        for (name, record, xs, ys) in OPS {
            let program = program(*record);
            let (x, y) = (xs.0 + u * (xs.1 - xs.0), ys.0 + v * (ys.1 - ys.0));
            let mut ws = workspace(&program, &[x], &[y]);
            program.vjp(&mut ws, "z").unwrap();
            for (param, (dx, dy)) in [("x", (1.0, 0.0)), ("y", (0.0, 1.0))] {
                let reverse = ws.gradient(param).unwrap()[0];
                let h = 1e-4;
                let at = |step: f64| value(&program, x + step * h * dx, y + step * h * dy);
                // Fourth order, so that rounding rather than truncation limits it.
                let difference = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * h);
                let scale = reverse.abs().max(at(0.0).abs()).max(1e-3);
                prop_assert!(
                    (difference - reverse).abs() <= 1e-6 * scale,
                    "{name}: d/d{param} at ({x}, {y}): {difference} by differences, {reverse} in reverse"
                );
            }
            for (param, i) in [("x", 0), ("y", 1)] {
                let reverse = workspace_gradient(&program, x, y)[i];
                let mut ws = workspace(&program, &[x], &[y]);
                program.jvp(&mut ws, &[(param, &[1.0])]).unwrap();
                let forward = ws.tangent("z").unwrap()[0];
                prop_assert!((forward - reverse).abs() <= 1e-13 * reverse.abs().max(1e-300), "{name}: {forward} forward, {reverse} in reverse");
            }
        }
    }

    #[test]
    fn single_precision_is_close_to_double(u in 0.0..1.0f64, v in 0.0..1.0f64) {
        for (name, record, xs, ys) in OPS {
            let program = program(*record);
            let (x, y) = (xs.0 + u * (xs.1 - xs.0), ys.0 + v * (ys.1 - ys.0));
            let (x, y) = (x as f32, y as f32);
            let mut single = program.workspace::<f32>(&Sizes::new().lanes("lane", 1)).unwrap();
            single.set("x", &[x]).unwrap();
            single.set("y", &[y]).unwrap();
            program.vjp(&mut single, "z").unwrap();
            let mut double = workspace(&program, &[x as f64], &[y as f64]);
            program.vjp(&mut double, "z").unwrap();
            for (a, b) in [
                (single.output("z").unwrap(), double.output("z").unwrap()),
                (single.gradient("x").unwrap(), double.gradient("x").unwrap()),
                (single.gradient("y").unwrap(), double.gradient("y").unwrap()),
            ] {
                let error = (a[0] as f64 - b[0]).abs();
                prop_assert!(error <= 2e-5 * b[0].abs().max(0.1), "{name}: {} and {}", a[0], b[0]);
            }
        }
    }
}

fn workspace_gradient(program: &Program, x: f64, y: f64) -> [f64; 2] {
    let mut ws = workspace(program, &[x], &[y]);
    program.vjp(&mut ws, "z").unwrap();
    [ws.gradient("x").unwrap()[0], ws.gradient("y").unwrap()[0]]
}

fn at(record: Record, x: f64, y: f64) -> (f64, [f64; 2]) {
    let program = program(record);
    (value(&program, x, y), workspace_gradient(&program, x, y))
}

#[test]
fn a_masked_singularity_contributes_nothing() {
    // Division by zero, and roots of zero, in the branch that is not taken.
    let (value, gradient) = at(|x, y| x.le(y).select(y, &(y / x).sqrt()), 0.0, 3.0);
    assert_eq!((value, gradient), (3.0, [0.0, 1.0]));
    let (value, gradient) = at(
        |x, _| {
            let positive = x.gt_scalar(0.0);
            positive.select_or_zero(&(x.ln() * x.rsqrt()))
        },
        0.0,
        0.0,
    );
    assert_eq!((value, gradient), (0.0, [0.0, 0.0]));
    // Not masked, it is seen.
    let (value, gradient) = at(|x, y| y / x * x, 0.0, 3.0);
    assert!(value.is_nan() && gradient[0].is_infinite());
}

#[test]
fn detached_values_carry_no_gradient() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let detached: Detached = x.square().detach();
    // One path of two; a value with another's gradient; detached arithmetic stays detached.
    let one_path = &detached * &x;
    let replaced = (&detached * 2.0).attach_to(&x);
    let stays = (&detached + 1.0).sqrt().attach();
    let program = g
        .compile(&[
            ("one", &one_path),
            ("replaced", &replaced),
            ("stays", &stays),
        ])
        .unwrap();
    let mut ws = program
        .workspace::<f64>(&Sizes::new().lanes("lane", 2))
        .unwrap();
    ws.set("x", &[2.0, 3.0]).unwrap();
    let mut gradient = |output: &str| {
        program.vjp(&mut ws, output).unwrap();
        (
            ws.output(output).unwrap().to_vec(),
            ws.gradient("x").unwrap().to_vec(),
        )
    };
    assert_eq!(gradient("one"), (vec![8.0, 27.0], vec![4.0, 9.0]));
    assert_eq!(gradient("replaced"), (vec![8.0, 18.0], vec![1.0, 1.0]));
    let (_, none) = gradient("stays");
    assert!(none.iter().all(|x| x.to_bits() == 0));
}

#[test]
fn the_origin_of_a_nan_is_found() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (x, y) = (g.param("x", &lane, 1), g.param("y", &lane, 1));
    let ratio = (&x / &y).label("ratio");
    let program = g.compile(&[("loss", &(ratio * 2.0).exp().sum())]).unwrap();
    let mut ws = workspace(&program, &[1.0, 0.0, 2.0], &[1.0, 0.0, 4.0]);
    let found = program.find_non_finite(&mut ws).unwrap().unwrap();
    assert_eq!((found.origin.as_str(), found.lane), ("ratio", 1));
    assert!(found.value.is_nan());
    assert_eq!(
        found.operands,
        [("x".to_string(), 0.0), ("y".to_string(), 0.0)]
    );
    assert!(found.to_string().contains("`ratio` is NaN at lane 1"));
    ws.set("y", &[1.0, 1.0, 4.0]).unwrap();
    assert_eq!(program.find_non_finite(&mut ws).unwrap(), None);
    ws.set("x", &[f64::INFINITY, 0.0, 2.0]).unwrap();
    assert_eq!(
        program.find_non_finite(&mut ws).unwrap().unwrap().origin,
        "x"
    );
}
