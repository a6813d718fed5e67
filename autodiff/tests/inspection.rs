//! What helps to find a mistake: `gradcheck`, strict mode, `explain`.

#[path = "common/operations.rs"]
#[allow(dead_code)]
mod operations;
#[path = "common/steps.rs"]
mod steps;

use autodiff::{GradCheck, Graph, Program, Sizes, Var, Workspace};
use operations::Cube;
use steps::{STEPS, bound};

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
fn a_wrong_slope_is_caught_whatever_the_size_of_the_output() {
    for offset in [0.0, 1.0, 1e3, -1e6] {
        let with = |factor| check(|g, x| g.custom_first_order(Cube { factor }, [x]) + offset);
        let (right, wrong) = (with(1.0), with(1.0001));
        assert!(right.passed(), "{offset}: {right}");
        assert!(!wrong.passed(), "{offset}: {wrong}");
        // The gradient of a small share of a large output, but for what differences of it cannot tell.
        let offset = offset * 1e-3;
        let with = |factor| {
            check(|g, x| {
                x.detach().square() * 0.0
                    + g.custom_first_order(Cube { factor }, [x]) * 1e-3
                    + offset
            })
        };
        let (right, wrong) = (with(1.0), with(1.01));
        assert!(right.passed(), "{offset}: {right}");
        assert!(!wrong.passed(), "{offset}: {wrong}");
    }
    // A wrong second derivative beside a large gradient: of `x y^2`, held still, by `y`.
    let report = check(|_, x| x * 1e4 + x.detach() * x.square());
    assert!(report.params[0].hessian_error > Some(1e-4), "{report}");
    let report = check(|_, x| x * 1e4 + x.square() * x);
    assert!(report.passed(), "{report}");
}

#[test]
fn what_no_output_depends_on_is_not_checked() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (x, _) = (g.param("x", &lane, 1), g.param("unused", &lane, 1));
    let program = g.compile(&[("y", &x.sin())]).unwrap();
    let mut ws = workspace(&program, &[0.3, 0.7]);
    let report = program
        .gradcheck(&mut ws, "y", &GradCheck::default())
        .unwrap();
    assert!(report.passed() && report.params.len() == 1, "{report}");
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

#[test]
fn strict_mode_shows_the_operands_of_the_lane_that_it_names() {
    // The slope of a root is made of its result: operands are not computed again for gradients. Several blocks follow.
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let root = (&x - 1.0).sqrt().label("root");
    let program = g.compile(&[("y", &(root * x.exp()))]).unwrap();
    let mut values = vec![2.0; 5000];
    values[7] = 1.0;
    let mut ws = workspace(&program, &values);
    let found = program.find_singularities(&mut ws, "y").unwrap();
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!((found[0].lane, &found[0].at[..]), (7, &[0.0][..]));
}

#[test]
fn strict_mode_looks_at_products_of_many() {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
    let lane = g.segments("lane", &pixel);
    let index = g.index("index", &lane, &texel);
    let weight = g.param("weight", &g.uniform(), 2);
    let table = g.param("table", &texel, 3);
    let (spoilt, seen) = (g.input("spoilt", &lane, 1), g.mask("seen", &lane));
    let seen_pixel = g.mask("seen pixel", &pixel);
    let layer = spoilt.attach().matmul(&weight, None).label("layer");
    let looked_up = table
        .gather_weighted(&[(&index, &spoilt)])
        .label("looked up");
    let dot = table.gather(&index).segment_dot(&spoilt).label("dot");
    let program = g
        .compile(&[
            ("layer", &seen.select_or_zero(&layer)),
            ("looked up", &seen.select_or_zero(&looked_up)),
            ("dot", &seen_pixel.select_or_zero(&dot)),
        ])
        .unwrap();
    let sizes = Sizes::new()
        .lanes("pixel", 3)
        .lanes("texel", 4)
        .per_parent("lane", 2);
    let mut ws = program.workspace::<f32>(&sizes).unwrap();
    ws.set("weight", &[1.0, 2.0]).unwrap();
    ws.set("table", &[1.0; 12]).unwrap();
    ws.set("spoilt", &[1.0, 1.0, 1.0, f32::NAN, 1.0, 1.0])
        .unwrap();
    ws.set_index("index", &[0, 1, 2, 3, 0, 1]).unwrap();
    for masked in [true, false] {
        ws.set_mask("seen", &[true, true, true, !masked, true, true])
            .unwrap();
        ws.set_mask("seen pixel", &[true, !masked, true]).unwrap();
        for (output, operand) in [("layer", 1), ("looked up", 0), ("dot", 0)] {
            let found = program.find_singularities(&mut ws, output).unwrap();
            assert_eq!(found.len(), 1, "{output}: {found:?}");
            let found = &found[0];
            assert_eq!((found.origin.as_str(), found.lane), (output, 3));
            assert_eq!((found.operand, found.masked), (operand, masked));
            assert!(found.partial.is_nan());
            let name = if output == "layer" { "weight" } else { "table" };
            let finite = ws.gradient(name).unwrap().iter().all(|g| g.is_finite());
            assert_eq!(finite, masked, "{output}");
        }
    }
}

#[test]
fn the_origin_is_followed_through_every_operation() {
    for (name, step) in STEPS {
        let g = Graph::new();
        let pixel = g.domain("pixel");
        let sample = g.segments("sample", &pixel);
        let frame = g.axis("frame");
        let x = g.param_along("x", &sample, 2, &frame);
        let bad = x.sqrt().label("bad");
        let y = step(&g, &bad, &sample);
        let program = g.compile(&[("loss", &y.sum()), ("y", &y)]).unwrap();
        let mut ws = bound(&program, name);
        let mut values = vec![0.25; 60];
        // Channel 1, lane 4, position 2.
        values[(6 + 4) * 5 + 2] = -1.0;
        ws.set("x", &values).unwrap();
        let found = program.find_non_finite(&mut ws).unwrap().expect(name);
        let place = (
            found.origin.as_str(),
            found.channel,
            found.lane,
            found.position,
        );
        assert_eq!(place, ("bad", 1, 4, 2), "{name}");
        assert_eq!(found.operands, [("x".to_string(), -1.0)], "{name}");
    }
}

#[test]
fn what_reaches_no_output_is_not_blamed() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (x, y) = (g.param("x", &lane, 1), g.param("y", &lane, 1));
    let masked = x.gt_scalar(0.0).select_or_zero(&(x.ln() * x.rsqrt()));
    // Infinite, and then of no consequence.
    let tail = (-x.recip()).exp();
    let root = y.sqrt().label("root");
    let program = g
        .compile(&[("loss", &((masked + tail) * root).sum())])
        .unwrap();
    let mut ws = workspace(&program, &[0.0, 1.0, 2.0]);
    ws.set("y", &[1.0, 1.0, 1.0]).unwrap();
    assert_eq!(program.find_non_finite(&mut ws).unwrap(), None);
    ws.set("y", &[1.0, 1.0, -1.0]).unwrap();
    let found = program.find_non_finite(&mut ws).unwrap().unwrap();
    assert_eq!((found.origin.as_str(), found.lane), ("root", 2));
}
