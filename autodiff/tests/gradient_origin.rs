//! Which operation made a gradient that is not finite, of values and adjoints that are.

#[path = "common/steps.rs"]
mod steps;

use std::sync::Arc;

use autodiff::{Fixed, Graph, LinearMap, NonFiniteAdjoint, Program, Sizes, Var, Workspace};
use steps::{STEPS, bound};

/// What is found of a function of `x` at these lanes, whose sum is differentiated.
fn origin(record: impl Fn(&Graph, &Var) -> Var, x: &[f64]) -> Option<NonFiniteAdjoint> {
    let g = Graph::new();
    let y = record(&g, &g.param("x", &g.domain("lane"), 1));
    let program = g.compile(&[("loss", &y.sum())]).unwrap();
    let mut ws = workspace(&program, x);
    program.find_non_finite_gradient(&mut ws, "loss").unwrap()
}

fn workspace(program: &Program, x: &[f64]) -> Workspace<f64> {
    let sizes = Sizes::new().lanes("lane", x.len());
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    ws.set("x", x).unwrap();
    ws
}

#[test]
fn a_root_of_zero_in_a_chain() {
    let chain = |_: &Graph, x: &Var| {
        let squared = x.square().label("squared");
        squared.sqrt().label("root") * 3.0
    };
    let found = origin(chain, &[1.0, 2.0, 0.0, 4.0]).unwrap();
    let expected = NonFiniteAdjoint {
        parameter: "x".into(),
        origin: "root".into(),
        operand: "squared".into(),
        lane: 2,
        channel: 0,
        position: 0,
        adjoint: f64::INFINITY,
        incoming: Some(3.0),
        operands: vec![("squared".into(), 0.0)],
    };
    assert_eq!(found, expected);
    assert_eq!(
        found.to_string(),
        "the gradient of `x` is not finite: `root` makes the adjoint of `squared` inf at lane 2, channel 0, position 0, from its \
         own of 3, where `squared` = 0; select the operand, not only the result, or keep it away from here"
    );
    assert_eq!(origin(chain, &[1.0, 2.0, 3.0]), None);
    assert_eq!(origin(chain, &[]), None);
}

#[test]
fn slopes_that_are_infinite_where_values_are_not() {
    type Record = fn(&Graph, &Var) -> Var;
    let tiny = 1e-310;
    let cases: [(&str, Record, f64); 4] = [
        ("power", |g, x| x.pow(&g.constant::<Fixed>(0.5)), 0.0),
        ("angle", |_, x| x.acos(), 1.0),
        ("logarithm", |_, x| x.ln(), tiny),
        ("quotient", |_, x| x.detach() / x, tiny),
    ];
    for (name, record, at) in cases {
        let labelled = |g: &Graph, x: &Var| record(g, x).label(name);
        let found = origin(labelled, &[0.5, at]).expect(name);
        let names = (found.origin.as_str(), found.operand.as_str());
        assert_eq!((names, found.lane), ((name, "x"), 1));
        assert!(found.adjoint.is_infinite(), "{found}");
        assert_eq!(found.incoming, Some(1.0), "{found}");
        assert!(found.operands.contains(&("x".into(), at)), "{found}");
    }
}

#[test]
fn a_vector_of_no_length() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 3);
    let unit = x.normalize().label("unit");
    let program = g.compile(&[("loss", &unit.square().sum())]).unwrap();
    let mut ws = workspace_of_vectors(&program, &[1.0, 0.0, 2.0, 0.0, 3.0, 0.0]);
    let found = program.find_non_finite_gradient(&mut ws, "loss").unwrap();
    let found = found.unwrap();
    assert_eq!((found.parameter.as_str(), found.lane), ("x", 1), "{found}");
    // The value is not finite either, and is asked for first.
    let value = program.find_non_finite(&mut ws).unwrap().unwrap();
    assert_eq!(value.lane, 1);
}

fn workspace_of_vectors(program: &Program, x: &[f64]) -> Workspace<f64> {
    let sizes = Sizes::new().lanes("lane", x.len() / 3);
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    ws.set("x", x).unwrap();
    ws
}

#[test]
fn zero_times_infinity() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (x, far) = (g.param("x", &lane, 1), g.input("far", &lane, 3));
    let product = (&x * &far).label("product");
    let program = g.compile(&[("loss", &product.sum())]).unwrap();
    let mut ws = workspace(&program, &[0.0, 0.0]);
    // In the last channel of the second lane: what is broadcast over channels has one adjoint for all of them.
    let mut values = [1.0; 6];
    values[5] = f64::INFINITY;
    ws.set("far", &values).unwrap();
    let found = program.find_non_finite_gradient(&mut ws, "loss").unwrap();
    let found = found.unwrap();
    assert_eq!(
        (found.origin.as_str(), found.operand.as_str()),
        ("product", "x")
    );
    assert_eq!((found.lane, found.channel), (1, 0));
    let operands = [("x".to_string(), 0.0), ("far".to_string(), f64::INFINITY)];
    assert_eq!(found.operands, operands);
}

#[test]
fn what_reaches_no_gradient_is_not_named() {
    // The root's adjoint is infinite on the lanes that the selection stops, below it.
    let stopped = |_: &Graph, x: &Var| {
        let safe = x.gt_scalar(0.0).select_or_zero(x);
        safe.sqrt().label("stopped") + x
    };
    assert_eq!(origin(stopped, &[1.0, 0.0]), None);
    let beside = |g: &Graph, x: &Var| stopped(g, x) + (x - 2.0).abs().sqrt().label("reached");
    let found = origin(beside, &[1.0, 0.0, 2.0]).unwrap();
    assert_eq!((found.origin.as_str(), found.lane), ("reached", 2));
    // A cotangent of exactly 0 passes nothing on, whatever the slope.
    let masked = |_: &Graph, x: &Var| x.gt_scalar(0.0).select_or_zero(&x.sqrt());
    assert_eq!(origin(masked, &[1.0, 0.0]), None);
}

#[test]
fn the_way_back_leads_through_every_operation() {
    for (name, step) in STEPS {
        let g = Graph::new();
        let pixel = g.domain("pixel");
        let sample = g.segments("sample", &pixel);
        let frame = g.axis("frame");
        let x = g.param_along("x", &sample, 2, &frame);
        let y = step(&g, &x, &sample).label("stepped");
        // 0 everywhere, and steep.
        let root = (&y - y.detach()).sqrt().label("root");
        let program = g.compile(&[("loss", &root.sum())]).unwrap();
        let mut ws = bound(&program, name);
        ws.set("x", &[0.25; 60]).unwrap();
        let found = program.find_non_finite_gradient(&mut ws, "loss").unwrap();
        let found = found.expect(name);
        assert_eq!(found.origin, "root", "{name}: {found}");
        assert_eq!(found.incoming, Some(1.0), "{name}: {found}");
        assert_eq!(program.find_non_finite(&mut ws).unwrap(), None, "{name}");
    }
}

/// A map whose transpose is wrong.
struct Wrong;

impl LinearMap for Wrong {
    fn shape(&self) -> (usize, usize) {
        (3, 3)
    }
    fn apply_f32(&self, _: usize, _: &[f32], _: &mut [f32]) {}
    fn apply_transpose_f32(&self, _: usize, _: &[f32], _: &mut [f32]) {}
    fn apply_f64(&self, _: usize, input: &[f64], output: &mut [f64]) {
        output.copy_from_slice(input);
    }
    fn apply_transpose_f64(&self, _: usize, _: &[f64], output: &mut [f64]) {
        output.copy_from_slice(&[0.0, f64::NAN, 0.0]);
    }
}

#[test]
fn linear_maps_and_sums_over_lanes_are_named_where_nothing_before_them_is_to_blame() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let y = x.exp().label("grown").linear_map(&lane, Arc::new(Wrong));
    let program = g.compile(&[("loss", &y.label("mapped").sum())]).unwrap();
    let mut ws = workspace(&program, &[1.0, 2.0, 3.0]);
    let found = program.find_non_finite_gradient(&mut ws, "loss").unwrap();
    let found = found.unwrap();
    let names = (found.origin.as_str(), found.operand.as_str(), found.lane);
    assert_eq!(names, ("mapped", "grown", 1));
    assert_eq!(found.incoming, None);

    // Finite shares of many blocks, whose sum is not.
    let g = Graph::new();
    let lane = g.domain("lane");
    let (scale, x) = (g.param("scale", &g.uniform(), 1), g.param("x", &lane, 1));
    let program = g
        .compile(&[("loss", &(&scale * &x).label("scaled").sum())])
        .unwrap();
    let mut ws = program
        .workspace::<f32>(&Sizes::new().lanes("lane", 100_000))
        .unwrap();
    ws.set("scale", &[0.0]).unwrap();
    ws.set("x", &[1e35; 100_000]).unwrap();
    let found = program.find_non_finite_gradient(&mut ws, "loss").unwrap();
    let found = found.unwrap();
    assert_eq!(
        (found.parameter.as_str(), found.operand.as_str()),
        ("scale", "scale")
    );
    assert!(found.adjoint.is_infinite());
}
