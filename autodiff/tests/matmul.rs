//! Dense layers of many shapes against loops written out: value, tangent, and all adjoints.

use autodiff::{Graph, Scalar, Sizes};
use proptest::prelude::*;
use proptest::test_runner::FileFailurePersistence;

const SIDES: [usize; 6] = [1, 7, 16, 33, 129, 200];

fn numbers<S: Scalar>(seed: u64, n: usize) -> Vec<S> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        // Few bits, so that single precision is exact as far as it goes.
        (state >> 56) as f64 / 128.0 - 1.0
    };
    (0..n).map(|_| S::from_f64(next())).collect()
}

/// `out[r][lane] = sum_c w[r][c] x[c][lane] + b[r]`
fn layer(
    w: &[f64],
    x: &[f64],
    b: &[f64],
    (outer, inner, lanes): (usize, usize, usize),
) -> Vec<f64> {
    let mut out = vec![0.0; outer * lanes];
    for r in 0..outer {
        for lane in 0..lanes {
            let products = (0..inner).map(|c| w[r * inner + c] * x[c * lanes + lane]);
            out[r * lanes + lane] = products.sum::<f64>() + b[r];
        }
    }
    out
}

fn close<S: Scalar>(what: &str, found: &[S], expected: &[f64]) -> Result<(), TestCaseError> {
    prop_assert_eq!(found.len(), expected.len());
    let tolerance = if size_of::<S>() == 4 { 1e-5 } else { 1e-13 };
    let size = expected.iter().fold(1.0f64, |size, x| size.max(x.abs()));
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        let error = (a.to_f64() - b).abs();
        prop_assert!(
            error <= tolerance * size,
            "{what} {i}: {}, expected {b}",
            a.to_f64()
        );
    }
    Ok(())
}

fn check<S: Scalar>(
    (outer, inner, lanes): (usize, usize, usize),
    block: usize,
    biased: bool,
    seed: u64,
) -> Result<(), TestCaseError> {
    let shape = (outer, inner, lanes);
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, inner);
    let w = g.param("w", &g.uniform(), outer * inner);
    let b = g.param("b", &g.uniform(), outer);
    // Once of a parameter, once of a result in the arena.
    let program = g
        .compile(&[
            ("bound", &x.matmul(&w, biased.then_some(&b))),
            ("computed", &(&x * 2.0).matmul(&w, biased.then_some(&b))),
        ])
        .unwrap();
    let sizes = Sizes::new().lanes("lane", lanes).block(block);
    let mut ws = program.workspace::<S>(&sizes).unwrap();
    let lens = [("x", inner * lanes), ("w", outer * inner), ("b", outer)];
    let fill = |seed: u64| -> Vec<Vec<S>> {
        let lens = lens.iter().zip(seed..);
        lens.map(|((_, n), seed)| numbers(seed, *n)).collect()
    };
    let (at, along) = (fill(seed), fill(seed + 10));
    for ((name, _), values) in lens.iter().zip(&at) {
        ws.set(name, values).unwrap();
    }
    let direction: Vec<(&str, &[S])> = lens
        .iter()
        .zip(&along)
        .map(|((name, _), v)| (*name, &v[..]))
        .collect();
    program.jvp(&mut ws, &direction).unwrap();
    let wide = |v: &[S]| -> Vec<f64> { v.iter().map(|x| x.to_f64()).collect() };
    let share =
        |v: &[f64]| -> Vec<f64> { v.iter().map(|x| if biased { *x } else { 0.0 }).collect() };
    let [x, w, b] = [0, 1, 2].map(|k| wide(&at[k]));
    let [dx, dw, db] = [0, 1, 2].map(|k| wide(&along[k]));
    let (b, db) = (share(&b), share(&db));
    let none = vec![0.0; outer];
    let cotangent = numbers::<S>(seed + 20, outer * lanes);
    let c = wide(&cotangent);
    for (output, factor) in [("bound", 1.0), ("computed", 2.0)] {
        let x: Vec<f64> = x.iter().map(|x| factor * x).collect();
        let dx: Vec<f64> = dx.iter().map(|x| factor * x).collect();
        close(
            output,
            ws.output(output).unwrap(),
            &layer(&w, &x, &b, shape),
        )?;
        let (by_w, by_x) = (layer(&dw, &x, &db, shape), layer(&w, &dx, &none, shape));
        let tangent: Vec<f64> = by_w.iter().zip(&by_x).map(|(a, b)| a + b).collect();
        close("tangent", ws.tangent(output).unwrap(), &tangent)?;

        program.vjp_with(&mut ws, &[(output, &cotangent)]).unwrap();
        let mut to_x = vec![0.0; inner * lanes];
        let mut to_w = vec![0.0; outer * inner];
        for r in 0..outer {
            for k in 0..inner {
                for lane in 0..lanes {
                    to_x[k * lanes + lane] += factor * w[r * inner + k] * c[r * lanes + lane];
                    to_w[r * inner + k] += c[r * lanes + lane] * x[k * lanes + lane];
                }
            }
        }
        let rows = (0..outer).map(|r| c[r * lanes..(r + 1) * lanes].iter().sum());
        let to_b = share(&rows.collect::<Vec<f64>>());
        close("adjoint of x", ws.gradient("x").unwrap(), &to_x)?;
        close("adjoint of w", ws.gradient("w").unwrap(), &to_w)?;
        close("adjoint of b", ws.gradient("b").unwrap(), &to_b)?;
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 48,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct("tests/matmul.regressions"))),
        ..ProptestConfig::default()
    })]

    #[test]
    fn layers_are_those_of_loops(
        outer in prop::sample::select(&SIDES[..]),
        inner in prop::sample::select(&SIDES[..]),
        lanes in 0usize..150,
        block in prop::sample::select(&[16usize, 64, 100, 1024][..]),
        biased in any::<bool>(),
        seed in 0u64..1 << 40,
    ) {
        check::<f64>((outer, inner, lanes), block, biased, seed)?;
        check::<f32>((outer, inner, lanes), block, biased, seed)?;
    }
}

#[test]
fn every_pair_of_sides_is_right() {
    for outer in SIDES {
        for inner in SIDES {
            check::<f64>((outer, inner, 45), 32, true, 7).unwrap();
            check::<f32>((outer, inner, 45), 32, false, 8).unwrap();
        }
    }
}
