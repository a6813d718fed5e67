//! Detached sampling: fixed samples differentiate like plain functions, and their mean is the derivative of the integral.

use autodiff::{Graph, RunError, Sizes, Var};
use proptest::prelude::*;
use proptest::test_runner::FileFailurePersistence;

/// `t x^2` over the density `(t + 1) x^t` of `x`, whose mean is `t / 3`. The parameter has a lane for each sample, so that its
/// gradient is that of each sample by itself.
fn estimator(g: &Graph) -> Var {
    let lane = g.domain("sample");
    let t = g.param("t", &lane, 1);
    let x = g.input("x", &lane, 1);
    let density = g.input("density", &lane, 1);
    t * x.square() / density
}

/// The same with samples and densities that are recorded, and depend on `t`, but are detached.
fn sampled_estimator(g: &Graph) -> Var {
    let lane = g.domain("sample");
    let t = g.param("t", &lane, 1);
    let u = g.input("u", &lane, 1);
    let x = u.pow(&(1.0 / (&t + 1.0))).detach();
    let density = ((&t + 1.0) * x.pow(&t)).detach();
    t * x.square() / density
}

fn uniform(seed: u64, n: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..n)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            ((state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: Some(Box::new(FileFailurePersistence::Direct("tests/detach.regressions"))), ..ProptestConfig::default() })]

    #[test]
    fn the_mean_of_a_detached_estimator_is_the_derivative_of_the_integral(seed in 0u64..1 << 40, t in 0.2..2.0f64) {
        let g = Graph::new();
        let program = g.compile(&[("sum", &estimator(&g).sum())]).unwrap();
        let n = 4000;
        let mut ws = program.workspace::<f64>(&Sizes::new().lanes("sample", n)).unwrap();
        let u = uniform(seed, n);
        let x: Vec<f64> = u.iter().map(|u| u.powf(1.0 / (t + 1.0))).collect();
        let density: Vec<f64> = x.iter().map(|x| (t + 1.0) * x.powf(t)).collect();
        ws.set("x", &x).unwrap();
        ws.set("density", &density).unwrap();
        ws.set("t", &vec![t; n]).unwrap();
        let g = Graph::new();
        let sampled = g.compile(&[("sum", &sampled_estimator(&g).sum())]).unwrap();
        let mut drawn = sampled.workspace::<f64>(&Sizes::new().lanes("sample", n)).unwrap();
        drawn.set("u", &u).unwrap();
        drawn.set("t", &vec![t; n]).unwrap();
        sampled.vjp(&mut drawn, "sum").unwrap();
        let slopes = drawn.gradient("t").unwrap().to_vec();

        let mean = slopes.iter().sum::<f64>() / n as f64;
        let variance = slopes.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
        // Five standard errors: one run in two million fails by chance.
        let z = (mean - 1.0 / 3.0) / (variance / n as f64).sqrt();
        prop_assert!(z.abs() < 5.0, "z = {z}");

        // At fixed samples the estimator is a function of t like any other.
        let mut at = |t: f64| {
            ws.set("t", &vec![t; n]).unwrap();
            program.forward(&mut ws).unwrap();
            ws.output("sum").unwrap()[0]
        };
        let h = 1e-4;
        let difference = (at(t + h) - at(t - h)) / (2.0 * h) / n as f64;
        prop_assert!((difference - mean).abs() <= 1e-8 * mean.abs());
    }
}

#[test]
fn an_index_out_of_range_is_an_error_that_names_the_lane() {
    let g = Graph::new();
    let (lane, table) = (g.domain("lane"), g.domain("table"));
    let values = g.param("values", &table, 1);
    let index = g.index("index", &lane, &table);
    let program = g.compile(&[("y", &values.gather(&index))]).unwrap();
    let sizes = Sizes::new().lanes("lane", 3).lanes("table", 4);
    let mut ws = program.workspace::<f32>(&sizes).unwrap();
    ws.set("values", &[1.0, 2.0, 3.0, 4.0]).unwrap();
    let error = ws.set_index("index", &[0, 4, 1]).unwrap_err();
    assert!(
        matches!(
            error,
            RunError::IndexOutOfRange {
                lane: 1,
                value: 4,
                lanes: 4,
                ..
            }
        ),
        "{error}"
    );
    // The workspace is usable after the error.
    ws.set_index("index", &[0, 3, 3]).unwrap();
    program.vjp(&mut ws, "y").unwrap();
    assert_eq!(ws.output("y").unwrap(), [1.0, 4.0, 4.0]);
    assert_eq!(ws.gradient("values").unwrap(), [1.0, 0.0, 0.0, 2.0]);
}

#[test]
fn the_largest_element_shifts_without_a_gradient() {
    let g = Graph::new();
    let (lane, axis) = (g.domain("lane"), g.axis("axis"));
    let x = g.param_along("x", &lane, 1, &axis);
    let program = g.compile(&[("y", &x.log_sum_exp())]).unwrap();
    let mut ws = program
        .workspace::<f64>(&Sizes::new().lanes("lane", 2).axis("axis", 3))
        .unwrap();
    // Far beyond what an exponential can hold.
    ws.set("x", &[1000.0, 1001.0, 1000.5, -2000.0, -2000.0, -2000.0])
        .unwrap();
    program.vjp(&mut ws, "y").unwrap();
    let total = 1.0 + (-1.0f64).exp() + (-0.5f64).exp();
    let expected = [1001.0 + total.ln(), -2000.0 + 3f64.ln()];
    for (y, expected) in ws.output("y").unwrap().iter().zip(expected) {
        assert!((y - expected).abs() < 1e-12 * expected.abs());
    }
    let softmax = [
        (-1.0f64).exp() / total,
        1.0 / total,
        (-0.5f64).exp() / total,
        1.0 / 3.0,
        1.0 / 3.0,
        1.0 / 3.0,
    ];
    for (g, expected) in ws.gradient("x").unwrap().iter().zip(softmax) {
        assert!((g - expected).abs() < 1e-12);
    }
}
