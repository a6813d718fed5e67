//! Hessian-vector products, and operations that users write.

#[path = "common/operations.rs"]
#[allow(dead_code)]
mod operations;

use autodiff::{
    CustomOp, CustomVecOp, Fma, GradCheck, Graph, GraphError, Program, Real, RunError, Sizes, Var,
    Workspace,
};
use operations::Cube;
use proptest::prelude::*;
use proptest::test_runner::FileFailurePersistence;

/// `a^2 / (1 + b)`, differentiated by running it on dual numbers.
struct Ratio;

impl CustomOp<2> for Ratio {
    fn name(&self) -> &'static str {
        "ratio"
    }
    fn eval<R: Real, F: Fma>(&self, [a, b]: [R; 2]) -> R {
        a * a / (R::from_f64(1.0) + b)
    }
}

const PARAMS: [&str; 3] = ["table", "pixel", "gain"];

fn program() -> Program {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
    let sample = g.segments("sample", &pixel);
    let frame = g.axis("frame");
    let table = g.param_along("table", &texel, 1, &frame);
    let color = g.param("pixel", &pixel, 3);
    let gain = g.param("gain", &g.uniform(), 1);
    let index = g.index("index", &sample, &texel);
    let weight = g.input("weight", &sample, 1);
    let rows = (&table * &gain)
        .sigmoid()
        .gather_weighted(&[(&index, &weight)]);
    let color = color.expand(&sample);
    let shaded = g
        .custom(Ratio, [&color, &weight.exp().attach()])
        .segment_dot(&rows);
    let loss = (shaded.square() + 1.0).sqrt().sum() + (&color * &gain).sin().sum();
    g.compile(&[("loss", &loss)]).unwrap()
}

fn numbers(seed: u64, n: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(2) | 1;
    (0..n)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.4
        })
        .collect()
}

fn workspace(program: &Program, seed: u64) -> Workspace<f64> {
    let sizes = Sizes::new()
        .lanes("pixel", 4)
        .lanes("texel", 5)
        .per_parent("sample", 9)
        .axis("frame", 6);
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    let index: Vec<u32> = (0..36).map(|i| i * 7 % 5).collect();
    ws.set_index("index", &index).unwrap();
    ws.set("weight", &numbers(seed + 9, 36)).unwrap();
    for (k, (name, n)) in PARAMS.iter().zip([30, 12, 1]).enumerate() {
        ws.set(name, &numbers(seed + k as u64, n)).unwrap();
    }
    ws
}

fn direction(seed: u64) -> Vec<Vec<f64>> {
    [30, 12, 1]
        .iter()
        .enumerate()
        .map(|(k, &n)| numbers(seed + k as u64, n))
        .collect()
}

fn named(arrays: &[Vec<f64>]) -> Vec<(&'static str, &[f64])> {
    PARAMS
        .into_iter()
        .zip(arrays.iter().map(|a| &a[..]))
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: Some(Box::new(FileFailurePersistence::Direct("tests/second_order.regressions"))), ..ProptestConfig::default() })]

    #[test]
    fn products_match_differences_of_gradients_and_are_symmetric(seed in 0u64..1_000_000) {
        let program = program();
        let mut ws = workspace(&program, seed);
        let (u, v) = (direction(seed + 50), direction(seed + 60));
        let mut product = |v: &[Vec<f64>]| -> Vec<f64> {
            program.hvp(&mut ws, "loss", &named(v)).unwrap();
            PARAMS.iter().flat_map(|p| ws.hessian_product(p).unwrap().to_vec()).collect()
        };
        let (hu, hv) = (product(&u), product(&v));
        let dot = |a: &[f64], b: &[Vec<f64>]| -> f64 {
            a.iter().zip(b.iter().flatten()).map(|(x, y)| x * y).sum()
        };
        let (uhv, vhu) = (dot(&hv, &u), dot(&hu, &v));
        prop_assert!((uhv - vhu).abs() <= 1e-12 * uhv.abs().max(1.0), "{uhv} {vhu}");

        let h = 1e-5;
        let mut gradient = |step: f64| -> Vec<f64> {
            for (k, (name, v)) in PARAMS.iter().zip(&v).enumerate() {
                let moved: Vec<f64> = numbers(seed + k as u64, v.len()).iter().zip(v).map(|(x, v)| x + step * v).collect();
                ws.set(name, &moved).unwrap();
            }
            program.vjp(&mut ws, "loss").unwrap();
            PARAMS.iter().flat_map(|p| ws.gradient(p).unwrap().to_vec()).collect()
        };
        let (plus, minus) = (gradient(h), gradient(-h));
        for i in 0..hv.len() {
            let difference = (plus[i] - minus[i]) / (2.0 * h);
            prop_assert!((difference - hv[i]).abs() <= 1e-6 * hv[i].abs().max(1.0), "{i}: {difference} {}", hv[i]);
        }
    }
}

#[test]
fn the_gradient_of_a_hessian_product_is_the_gradient() {
    let program = program();
    let mut ws = workspace(&program, 5);
    program.vjp(&mut ws, "loss").unwrap();
    let gradient = ws.gradient("pixel").unwrap().to_vec();
    program.hvp(&mut ws, "loss", &named(&direction(8))).unwrap();
    for (a, b) in ws.gradient("pixel").unwrap().iter().zip(&gradient) {
        assert!((a - b).abs() <= 1e-13 * b.abs().max(1.0));
    }
}

#[test]
fn second_derivatives_of_a_first_order_operation_are_refused() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let program = g
        .compile(&[("y", &g.custom_first_order(Cube { factor: 1.0 }, [&x]))])
        .unwrap();
    let mut ws = program
        .workspace::<f32>(&Sizes::new().lanes("lane", 2))
        .unwrap();
    ws.set("x", &[2.0, -1.0]).unwrap();
    program.vjp(&mut ws, "y").unwrap();
    assert_eq!(ws.output("y").unwrap(), [8.0, -1.0]);
    assert_eq!(ws.gradient("x").unwrap(), [12.0, 3.0]);
    let error = program
        .hvp(&mut ws, "y", &[("x", &[1.0, 1.0])])
        .unwrap_err();
    assert_eq!(
        error,
        RunError::FirstOrderOnly {
            op: "cube".to_string()
        }
    );
}

#[test]
fn a_first_order_operation_that_no_gradient_passes_is_no_obstacle() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let cube = g.custom_first_order(Cube { factor: 1.0 }, [&x]);
    let held = cube.detach() * x.square();
    let apart = x.exp();
    let program = g
        .compile(&[("cube", &cube), ("held", &held), ("apart", &apart)])
        .unwrap();
    let mut ws = program
        .workspace::<f64>(&Sizes::new().lanes("lane", 2))
        .unwrap();
    ws.set("x", &[2.0, -1.0]).unwrap();
    let ones: [(&str, &[f64]); 1] = [("x", &[1.0, 1.0])];
    for _ in 0..2 {
        // What is detached is held still, as samples are.
        program.hvp(&mut ws, "held", &ones).unwrap();
        assert_eq!(ws.gradient("x").unwrap(), [32.0, 2.0]);
        assert_eq!(ws.hessian_product("x").unwrap(), [16.0, -2.0]);
        program.hvp(&mut ws, "apart", &ones).unwrap();
        let e = [2f64.exp(), (-1f64).exp()];
        assert_eq!(ws.hessian_product("x").unwrap(), e);
        assert!(matches!(
            program.hvp(&mut ws, "cube", &ones),
            Err(RunError::FirstOrderOnly { .. })
        ));
    }
}

/// The product and the quotient of two numbers, and the sine of the first.
struct Three;

impl CustomVecOp<2, 3> for Three {
    fn name(&self) -> &'static str {
        "three"
    }
    fn eval<R: Real, F: Fma>(&self, [a, b]: [R; 2]) -> [R; 3] {
        [a * b, a / b, a.sin::<F>()]
    }
}

#[test]
fn an_operation_of_several_results_is_that_of_primitives() {
    type Record = fn(&Graph, &Var, &Var) -> [Var; 3];
    let records: [Record; 2] = [
        |g, a, b| g.custom_vec(Three, [a, b]),
        |_, a, b| [a * b, a / b, a.sin()],
    ];
    let run = |record: Record| {
        let g = Graph::new();
        let lane = g.domain("lane");
        // Broadcast over channels.
        let (a, b) = (g.param("a", &lane, 3), g.param("b", &lane, 1));
        let [product, quotient, sine] = record(&g, &a, &b);
        let loss = (product.exp() * sine + quotient.square()).sum();
        let program = g.compile(&[("loss", &loss)]).unwrap();
        let sizes = Sizes::new().lanes("lane", 700);
        let mut ws = program.workspace::<f64>(&sizes).unwrap();
        ws.set("a", &numbers(3, 2100)).unwrap();
        let b: Vec<f64> = numbers(4, 700).iter().map(|b| b + 1.0).collect();
        ws.set("b", &b).unwrap();
        let report = program
            .gradcheck(&mut ws, "loss", &GradCheck::default())
            .unwrap();
        assert!(report.passed(), "{report}");
        let direction = (numbers(5, 2100), numbers(6, 700));
        let direction: [(&str, &[f64]); 2] = [("a", &direction.0), ("b", &direction.1)];
        program.jvp(&mut ws, &direction).unwrap();
        let mut all = ws.tangent("loss").unwrap().to_vec();
        program.hvp(&mut ws, "loss", &direction).unwrap();
        for name in ["a", "b"] {
            all.extend_from_slice(ws.gradient(name).unwrap());
            all.extend_from_slice(ws.hessian_product(name).unwrap());
        }
        program.forward(&mut ws).unwrap();
        all.extend_from_slice(ws.output("loss").unwrap());
        all
    };
    for (own, primitive) in run(records[0]).iter().zip(run(records[1])) {
        let scale = primitive.abs().max(1.0);
        assert!(
            (own - primitive).abs() <= 1e-11 * scale,
            "{own} for {primitive}"
        );
    }
}

#[test]
fn results_that_nothing_needs_are_not_computed() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (a, b) = (g.param("a", &lane, 1), g.param("b", &lane, 1));
    let [_, quotient, _] = g.custom_vec(Three, [&a, &b]);
    let program = g.compile(&[("y", &quotient.label("quotient"))]).unwrap();
    let sizes = Sizes::new().lanes("lane", 2);
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    ws.set("a", &[1.0, 2.0]).unwrap();
    ws.set("b", &[2.0, 2.0]).unwrap();
    let explained = program.explain(&mut ws, "y").unwrap();
    let custom = explained.nodes.iter().filter(|node| node.op == "three");
    assert_eq!(custom.count(), 1, "{explained}");
    assert_eq!(ws.output("y").unwrap(), [0.5, 1.0]);
}

#[test]
fn operands_of_several_results_are_checked_as_those_of_one() {
    let g = Graph::new();
    let (a, b) = (
        g.param("a", &g.domain("lane"), 1),
        g.param("b", &g.domain("other"), 1),
    );
    let [product, ..] = g.custom_vec(Three, [&a, &b]);
    let error = g.compile(&[("y", &product)]).err().expect("a mistake");
    assert!(matches!(error, GraphError::ShapeMismatch { .. }), "{error}");
    let text = error.to_string();
    for word in [
        "`three`",
        "`a` (lane)",
        "`b` (other)",
        "tests/second_order.rs:",
    ] {
        assert!(text.contains(word), "`{word}` is missing: {text}");
    }
}
