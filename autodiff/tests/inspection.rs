//! What helps to find a mistake: `gradcheck`, strict mode, `explain`.

use autodiff::{FirstOrderOnly, GradCheck, Graph, Program, Sizes, Var, Workspace};

fn check(record: impl Fn(&Graph, &Var) -> Var) -> autodiff::GradReport {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let program = g.compile(&[("y", &record(&g, &x))]).unwrap();
    let mut ws = workspace(&program, &[0.3, 0.7, 1.9]);
    let report = program
        .gradcheck(&mut ws, "y", &GradCheck::default())
        .unwrap();
    assert_eq!(ws.value("x").unwrap(), [0.3, 0.7, 1.9]);
    report
}

fn workspace(program: &Program, x: &[f64]) -> Workspace<f64> {
    let sizes = Sizes::new().lanes("lane", x.len());
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    ws.set("x", x).unwrap();
    ws
}

/// A cube; `factor` times its slope.
struct Cube {
    factor: f64,
}

impl FirstOrderOnly<1> for Cube {
    fn name(&self) -> &'static str {
        "cube"
    }
    fn eval(&self, [x]: [f64; 1]) -> f64 {
        x * x * x
    }
    fn partials(&self, [x]: [f64; 1], _: f64) -> [f64; 1] {
        [self.factor * 3.0 * x * x]
    }
}

#[test]
fn sound_derivatives_pass() {
    let report = check(|_, x| (x.exp() * x.sin()).sqrt() / (x + 1.0));
    assert!(report.passed(), "{report}");
    assert!(report.params[0].hessian_error.is_some());
    let report = check(|g, x| g.custom_first_order(Cube { factor: 1.0 }, [x]));
    assert!(report.passed(), "{report}");
    assert_eq!(report.params[0].hessian_error, None);
}

#[test]
fn a_wrong_slope_is_caught() {
    let report = check(|g, x| g.custom_first_order(Cube { factor: 1.001 }, [x]));
    assert!(!report.passed());
    assert!(report.params[0].difference_error > 1e-4);
    assert!(report.to_string().contains("WRONG"));
}

#[test]
fn a_forgotten_path_is_caught() {
    // `detach` hides a path from both modes, so that they agree with each other and not with differences.
    let report = check(|_, x| x * x.detach());
    assert!(!report.passed());
    assert!(report.params[0].transpose_error < 1e-12);
}

#[test]
fn strict_mode_tells_masked_from_unmasked() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let ratio = (1.0 / &x).label("ratio");
    let root = x.sqrt().label("root");
    let safe = x.gt_scalar(0.0).select_or_zero(&ratio);
    let program = g.compile(&[("safe", &safe), ("root", &root)]).unwrap();
    let mut ws = workspace(&program, &[1.0, 0.0, 2.0, 0.0]);

    let masked = program.find_singularities(&mut ws, "safe").unwrap();
    assert_eq!(masked.len(), 1, "{masked:?}");
    // The ratio is an affine function of the reciprocal, which is what is singular.
    assert!(masked[0].masked && masked[0].count == 2 && masked[0].lane == 1);
    assert_eq!(masked[0].at, [0.0]);
    assert!(ws.gradient("x").unwrap().iter().all(|g| g.is_finite()));

    let reached = program.find_singularities(&mut ws, "root").unwrap();
    assert_eq!((reached.len(), reached[0].masked), (1, false));
    assert_eq!((reached[0].origin.as_str(), reached[0].lane), ("root", 1));
    assert!(reached[0].to_string().contains("NOT masked"));
    assert!(ws.gradient("x").unwrap()[1].is_infinite());

    ws.set("x", &[1.0, 3.0, 2.0, 4.0]).unwrap();
    assert!(
        program
            .find_singularities(&mut ws, "root")
            .unwrap()
            .is_empty()
    );
}

#[test]
fn explain_lists_every_node_and_changes_nothing() {
    let g = Graph::new();
    let pixel = g.domain("pixel");
    let sample = g.segments("sample", &pixel);
    let albedo = g.param("albedo", &pixel, 3);
    let light = g.input("light", &sample, 1);
    let shaded = (albedo.expand(&sample) * &light).exp().label("shaded");
    let loss = shaded.segment_mean().square().sum();
    let program = g.compile(&[("loss", &loss)]).unwrap();
    let sizes = Sizes::new().lanes("pixel", 700).per_parent("sample", 9);
    let mut ws = program.workspace::<f32>(&sizes).unwrap();
    ws.set("albedo", &[0.4; 2100]).unwrap();
    ws.set("light", &[0.7; 6300]).unwrap();
    program.vjp(&mut ws, "loss").unwrap();
    let before = (
        ws.output("loss").unwrap()[0],
        ws.gradient("albedo").unwrap().to_vec(),
    );
    let explained = program.explain(&mut ws, "loss").unwrap();
    let again = (
        ws.output("loss").unwrap()[0],
        ws.gradient("albedo").unwrap().to_vec(),
    );
    assert_eq!(before, again);
    program.vjp(&mut ws, "loss").unwrap();
    assert_eq!(before.1, ws.gradient("albedo").unwrap());

    let node = |name: &str| {
        explained
            .nodes
            .iter()
            .find(|node| node.name == name)
            .unwrap()
    };
    assert_eq!(node("albedo").whole_bytes, 2100 * 4);
    let shaded = node("shaded");
    assert_eq!((shaded.op, shaded.shape.as_str()), ("exp", "sample x 3"));
    assert!(shaded.forward.as_nanos() > 0 && shaded.reverse.as_nanos() > 0);
    assert!(shaded.whole_bytes == 0 && shaded.arena_bytes > 0);
    assert!(explained.to_string().contains("shaded (sample x 3)"));
}
