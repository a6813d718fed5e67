//! Random graphs: tangents against differences, transposition, linearity, and bits over threads and blocks.

mod data;
mod kept;
mod record;

use std::sync::OnceLock;

use autodiff::{Program, RunError, Scalar, Workspace};
use proptest::prelude::*;
use proptest::test_runner::FileFailurePersistence;

use data::{Data, data, few, many};
use kept::KEPT;
use record::{PARAMS, Step, record, record_with};

/// Random ones, and now and then some that failed before.
fn steps() -> impl Strategy<Value = Vec<Step>> {
    let random = prop::collection::vec((any::<u8>(), 0usize..8, 0usize..8), 3..24);
    let kept = prop::sample::select(&KEPT[..]).prop_map(<[Step]>::to_vec);
    prop_oneof![5 => random, 1 => kept]
}

fn named<S>(arrays: &[Vec<S>]) -> Vec<(&'static str, &[S])> {
    PARAMS
        .into_iter()
        .zip(arrays.iter().map(|a| &a[..]))
        .collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Failing seeds are kept beside the tests.
fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        max_shrink_iters: 4000,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(
            "tests/graphs.regressions",
        ))),
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(config(48))]

    #[test]
    fn reverse_is_the_transpose_of_forward(steps in steps(), data in data()) {
        let program = record(&steps);
        let mut ws = data.workspace::<f64>(&program, 64);
        let direction = data.direction::<f64>();
        program.jvp(&mut ws, &named(&direction)).unwrap();
        let (residual, loss) = (ws.tangent("residual").unwrap().to_vec(), ws.tangent("loss").unwrap()[0]);
        let w = data.array::<f64>(30, residual.len(), -0.5);
        program.vjp_with(&mut ws, &[("residual", &w), ("loss", &[2.0])]).unwrap();
        let left = dot(&w, &residual) + 2.0 * loss;
        let terms = PARAMS.iter().zip(&direction).map(|(p, v)| dot(ws.gradient(p).unwrap(), v));
        let (right, scale) = terms.fold((0.0, 1.0f64), |(sum, scale), x| (sum + x, scale + x.abs()));
        prop_assert!((left - right).abs() <= 1e-12 * scale, "{left} forward, {right} in reverse");
    }

    #[test]
    fn simplification_changes_nothing_but_rounding(steps in steps(), data in data()) {
        let results = [true, false].map(|simplify| {
            let program = record_with(&steps, simplify, true);
            let mut ws = data.workspace::<f64>(&program, 256);
            program.jvp(&mut ws, &named(&data.direction::<f64>())).unwrap();
            program.vjp(&mut ws, "loss").unwrap();
            let mut all = vec![ws.output("loss").unwrap().to_vec(), ws.tangent("loss").unwrap().to_vec()];
            all.extend(PARAMS.iter().map(|p| ws.gradient(p).unwrap().to_vec()));
            all
        });
        for (on, off) in results[0].iter().zip(&results[1]) {
            let norm = off.iter().fold(1.0f64, |norm, x| norm.max(x.abs()));
            for (a, b) in on.iter().zip(off) {
                prop_assert!((a - b).abs() <= 1e-9 * norm, "{a} simplified, {b} as recorded");
            }
        }
    }

    #[test]
    fn tangents_match_central_differences(steps in steps(), data in few()) {
        let program = record_with(&steps, true, false);
        let mut ws = data.workspace::<f64>(&program, 512);
        let (params, direction) = (data.params::<f64>(), data.direction::<f64>());
        program.jvp(&mut ws, &named(&direction)).unwrap();
        let tangent = ws.tangent("loss").unwrap()[0];
        let mut at = |step: f64| {
            for ((name, x), v) in PARAMS.iter().zip(&params).zip(&direction) {
                let moved: Vec<f64> = x.iter().zip(v).map(|(x, v)| x + step * v).collect();
                ws.set(name, &moved).unwrap();
            }
            program.forward(&mut ws).unwrap();
            ws.output("loss").unwrap()[0]
        };
        let mut slope = |h: f64| (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
        // How far differences themselves are off, where a graph bends sharply: a wrong tangent is off from both alike.
        let (difference, finer) = (slope(1e-4), slope(5e-5));
        let unsure = (difference - finer).abs();
        let scale = tangent.abs().max(at(0.0).abs()).max(1.0);
        prop_assert!(unsure <= 1e-3 * scale, "{difference} and {finer} by differences");
        prop_assert!((finer - tangent).abs() <= 1e-6 * scale + unsure, "{finer} by differences, {tangent}");
    }

    #[test]
    fn reverse_is_linear_in_its_cotangent(steps in steps(), data in data()) {
        let program = record(&steps);
        let mut ws = data.workspace::<f64>(&program, 128);
        program.forward(&mut ws).unwrap();
        let n = ws.output("residual").unwrap().len();
        let (u, v) = (data.array::<f64>(31, n, -0.5), data.array::<f64>(32, n, -0.5));
        let both: Vec<f64> = u.iter().zip(&v).map(|(u, v)| 2.0 * u - 3.0 * v).collect();
        let mut pull = |w: &[f64]| -> Vec<f64> {
            program.vjp_with(&mut ws, &[("residual", w)]).unwrap();
            PARAMS.iter().flat_map(|p| ws.gradient(p).unwrap().to_vec()).collect()
        };
        let (of_u, of_v, of_both) = (pull(&u), pull(&v), pull(&both));
        // Cotangents are near 1: where a gradient is exactly 0, the direction of a single number for one, rounding of them is left.
        let norm = of_u.iter().chain(&of_v).fold(1e-3f64, |norm, x| norm.max(x.abs()));
        for ((u, v), both) in of_u.iter().zip(&of_v).zip(&of_both) {
            let sum = 2.0 * u - 3.0 * v;
            prop_assert!((sum - both).abs() <= 1e-11 * norm, "{sum} and {both} of {norm}");
        }
    }

    #[test]
    fn hessian_products_are_symmetric_and_match_differences(steps in steps(), data in few()) {
        let program = record_with(&steps, true, false);
        let mut ws = data.workspace::<f64>(&program, 64);
        let (params, v) = (data.params::<f64>(), data.direction::<f64>());
        let lens = data.lens().into_iter().enumerate();
        let u: Vec<Vec<f64>> = lens.map(|(k, n)| data.array(40 + k as u64, n, -0.5)).collect();
        let inner = |a: &[Vec<f64>], b: &[Vec<f64>]| -> (f64, f64) {
            let terms = a.iter().flatten().zip(b.iter().flatten()).map(|(x, y)| x * y);
            terms.fold((0.0, 1.0), |(sum, size), x| (sum + x, size + x.abs()))
        };
        let both = |program: &Program, ws: &mut Workspace<f64>| {
            let mut product = |v: &[Vec<f64>]| -> Vec<Vec<f64>> {
                program.hvp(ws, "loss", &named(v)).unwrap();
                PARAMS.iter().map(|p| ws.hessian_product(p).unwrap().to_vec()).collect()
            };
            let (hu, hv) = (product(&u), product(&v));
            let ((uhv, size), (vhu, other)) = (inner(&u, &hv), inner(&v, &hu));
            (uhv, vhu, size.max(other))
        };
        // What is detached is held still: symmetric as well.
        let detached = record(&steps);
        let (uhv, vhu, size) = both(&detached, &mut data.workspace(&detached, 64));
        prop_assert!((uhv - vhu).abs() <= 1e-10 * size, "{uhv} and {vhu}, detached");
        let (uhv, vhu, size) = both(&program, &mut ws);
        prop_assert!((uhv - vhu).abs() <= 1e-10 * size, "{uhv} and {vhu}");

        let mut slope = |step: f64| -> f64 {
            for ((name, x), v) in PARAMS.iter().zip(&params).zip(&v) {
                let moved: Vec<f64> = x.iter().zip(v).map(|(x, v)| x + step * v).collect();
                ws.set(name, &moved).unwrap();
            }
            program.vjp(&mut ws, "loss").unwrap();
            PARAMS.iter().zip(&u).map(|(p, u)| dot(ws.gradient(p).unwrap(), u)).sum()
        };
        let h = 1e-4;
        let sides = [slope(h), slope(-h), slope(2.0 * h), slope(-2.0 * h)];
        let difference = (8.0 * (sides[0] - sides[1]) - (sides[2] - sides[3])) / (12.0 * h);
        let size = size.max(sides[0].abs());
        prop_assert!((difference - uhv).abs() <= 1e-5 * size, "{difference} by differences, {uhv}");
    }

    #[test]
    fn single_precision_is_close_to_double(steps in steps(), data in data()) {
        let program = record(&steps);
        let (mut single, mut double) = (data.workspace::<f32>(&program, 256), data.workspace::<f64>(&program, 256));
        program.vjp(&mut single, "loss").unwrap();
        program.vjp(&mut double, "loss").unwrap();
        let (a, b) = (single.output("loss").unwrap()[0] as f64, double.output("loss").unwrap()[0]);
        prop_assert!((a - b).abs() <= 1e-3 * b.abs().max(1.0), "{a} in single, {b} in double precision");
        for name in PARAMS {
            let (a, b) = (single.gradient(name).unwrap(), double.gradient(name).unwrap());
            let norm = b.iter().fold(1.0f64, |norm, x| norm.max(x.abs()));
            for (a, b) in a.iter().zip(b) {
                prop_assert!((*a as f64 - b).abs() <= 2e-2 * norm, "{name}: {a} in single, {b} in double precision");
            }
        }
    }

    #[test]
    fn memory_is_within_its_prediction_and_later_runs_allocate_nothing(steps in steps(), data in data()) {
        let program = record(&steps);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        pool.install(|| {
            let mut ws = data.workspace::<f32>(&program, 256);
            let direction = data.direction::<f32>();
            let direction = named(&direction);
            let mut run = || {
                program.gauss_newton(&mut ws, "residual", &direction, None).unwrap();
                program.vjp(&mut ws, "loss").unwrap();
                ws.bytes()
            };
            let held = run();
            let predicted = program.memory::<f32>(&data.sizes(256)).unwrap();
            let total = predicted.total();
            prop_assert!(held <= total, "{held} bytes held, {total} predicted");
            let mut second = data.workspace::<f32>(&program, 256);
            program.hvp(&mut second, "loss", &direction).unwrap();
            let (held, total) = (second.bytes(), predicted.values + predicted.hessian);
            prop_assert!(held <= total, "{held} bytes held for a Hessian product, {total} predicted");
            let steady = allocation_counter::measure(|| {
                run();
            });
            prop_assert_eq!(steady.count_total, 0);
            Ok(())
        })?;
    }

    #[test]
    fn one_pass_gives_the_bits_of_two(steps in steps(), data in data()) {
        // A gradient without values runs phases forward and back in one go where it can; one with values never does.
        let program = record(&steps);
        for (block, output) in [(64, "loss"), (1024, "loss"), (1024, "residual")] {
            let bits = [false, true].map(|before| {
                let mut ws = data.workspace::<f32>(&program, block);
                if before {
                    program.forward(&mut ws).unwrap();
                }
                program.vjp(&mut ws, output).unwrap();
                let arrays = [ws.output("loss"), ws.output("residual")];
                let gradients = PARAMS.iter().map(|p| ws.gradient(p));
                let arrays = arrays.into_iter().chain(gradients).map(|array| array.unwrap().to_vec());
                arrays.flatten().map(f32::to_bits).collect::<Vec<_>>()
            });
            prop_assert!(bits[0] == bits[1], "{output}, blocks of {block}");
        }
    }

    #[test]
    fn a_resized_workspace_gives_the_bits_of_a_new_one(steps in steps(), one in data(), other in data()) {
        let program = record(&steps);
        let bits = |ws: &mut Workspace<f32>, data: &Data| {
            let direction = data.direction::<f32>();
            program.gauss_newton(ws, "residual", &named(&direction), None).unwrap();
            let mut all: Vec<Vec<f32>> = PARAMS.iter().map(|p| ws.gradient(p).unwrap().to_vec()).collect();
            program.vjp(ws, "loss").unwrap();
            all.extend(PARAMS.iter().map(|p| ws.gradient(p).unwrap().to_vec()));
            all.extend(["loss", "residual"].map(|output| ws.output(output).unwrap().to_vec()));
            all.into_iter().flatten().map(f32::to_bits).collect::<Vec<_>>()
        };
        let mut ws = one.workspace::<f32>(&program, 256);
        let expected = [bits(&mut ws, &one), bits(&mut other.workspace(&program, 256), &other)];
        for (data, expected) in [&other, &one].into_iter().zip(expected.iter().rev()) {
            program.resize(&mut ws, &data.sizes(256)).unwrap();
            data.bind(&mut ws);
            prop_assert!(&bits(&mut ws, data) == expected);
        }
    }

    #[test]
    fn a_reused_workspace_gives_the_same_bits(steps in steps(), data in data()) {
        let program = record(&steps);
        let mut ws = data.workspace::<f64>(&program, 512);
        program.vjp(&mut ws, "loss").unwrap();
        let first: Vec<Vec<f64>> = PARAMS.iter().map(|p| ws.gradient(p).unwrap().to_vec()).collect();
        let held = ws.bytes();
        // A failed call, another output, another mode, and other parameters, then the same again.
        prop_assert!(program.vjp(&mut ws, "nothing").is_err());
        prop_assert!(ws.set("scale", &[1.0, 2.0]).is_err());
        program.vjp(&mut ws, "residual").unwrap();
        ws.set("scale", &[0.3]).unwrap();
        program.vjp(&mut ws, "loss").unwrap();
        ws.set("scale", &data.params::<f64>()[3]).unwrap();
        program.vjp(&mut ws, "loss").unwrap();
        prop_assert!(ws.bytes() >= held);
        for (name, first) in PARAMS.iter().zip(&first) {
            prop_assert_eq!(ws.gradient(name).unwrap(), &first[..]);
        }
    }
}

/// Pools of 1, 2, 3 and 8 threads.
fn pools() -> &'static [rayon::ThreadPool; 4] {
    static POOLS: OnceLock<[rayon::ThreadPool; 4]> = OnceLock::new();
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    POOLS.get_or_init(|| [1, 2, 3, 8].map(|threads| pool(threads).unwrap()))
}

/// All results of all modes; bits, since every number is finite or compares as itself.
fn results<S: Scalar>(program: &Program, data: &Data, block: usize) -> Result<Vec<S>, RunError> {
    let direction = data.direction::<S>();
    let mut ws = data.workspace::<S>(program, block);
    let mut all: Vec<S> = Vec::new();
    let gradients = |ws: &Workspace<S>, all: &mut Vec<S>| -> Result<(), RunError> {
        for name in PARAMS {
            all.extend_from_slice(ws.gradient(name)?);
        }
        Ok(())
    };
    program.vjp(&mut ws, "loss")?;
    all.extend_from_slice(ws.output("loss")?);
    all.extend_from_slice(ws.output("residual")?);
    gradients(&ws, &mut all)?;
    program.jvp(&mut ws, &named(&direction))?;
    all.extend_from_slice(ws.tangent("loss")?);
    all.extend_from_slice(ws.tangent("residual")?);
    program.gauss_newton(&mut ws, "residual", &named(&direction), None)?;
    gradients(&ws, &mut all)?;
    program.hvp(&mut ws, "loss", &named(&direction))?;
    gradients(&ws, &mut all)?;
    for name in PARAMS {
        all.extend_from_slice(ws.hessian_product(name)?);
    }
    Ok(all)
}

fn bits<S: Scalar>(x: &[S]) -> Vec<u64> {
    x.iter().map(|x| x.to_f64().to_bits()).collect()
}

fn same_bits<S: Scalar>(program: &Program, data: &Data) -> Result<(), TestCaseError> {
    let run = |pool: &rayon::ThreadPool, block: usize| {
        bits(&pool.install(|| results::<S>(program, data, block)).unwrap())
    };
    let reference = run(&pools()[0], 512);
    for pool in pools() {
        for block in [64, 100, 256, 1024, 2048, 4096] {
            let threads = pool.current_num_threads();
            prop_assert!(
                run(pool, block) == reference,
                "{threads} threads, blocks of {block}"
            );
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(config(16))]

    #[test]
    fn bits_do_not_depend_on_threads_or_blocks(steps in steps(), data in few()) {
        let program = record(&steps);
        same_bits::<f32>(&program, &data)?;
        same_bits::<f64>(&program, &data)?;
    }

    #[test]
    fn gauss_newton_products_are_those_of_dense_jacobians(steps in steps(), data in few()) {
        let program = record(&steps);
        let mut ws = data.workspace::<f64>(&program, 128);
        let lens = data.lens();
        // Column by column; of parameters the first few elements only, to which the product is restricted.
        let most = 12;
        let mut columns: Vec<(usize, usize, Vec<f64>)> = Vec::new();
        for (k, name) in PARAMS.iter().enumerate() {
            for i in 0..lens[k].min(most) {
                let mut unit = vec![0.0; lens[k]];
                unit[i] = 1.0;
                program.jvp(&mut ws, &[(name, &unit)]).unwrap();
                columns.push((k, i, ws.tangent("residual").unwrap().to_vec()));
            }
        }
        program.forward(&mut ws).unwrap();
        let rows = ws.output("residual").unwrap().len();
        let weights = data.array::<f64>(60, rows, 0.2);
        let mut direction = data.direction::<f64>();
        for v in &mut direction {
            v.iter_mut().skip(most).for_each(|v| *v = 0.0);
        }
        let mut moved = vec![0.0; rows];
        for (k, i, column) in &columns {
            moved.iter_mut().zip(column).for_each(|(m, x)| *m += x * direction[*k][*i]);
        }
        let weighted: Vec<f64> = moved.iter().zip(&weights).map(|(m, w)| m * w).collect();
        program.gauss_newton(&mut ws, "residual", &named(&direction), Some(&weights)).unwrap();
        for (k, i, column) in &columns {
            let found = ws.gradient(PARAMS[*k]).unwrap()[*i];
            let expected = dot(column, &weighted);
            let size: f64 = 1.0 + column.iter().zip(&weighted).map(|(x, y)| (x * y).abs()).sum::<f64>();
            prop_assert!((found - expected).abs() <= 1e-11 * size, "{}: {found}, {expected}", PARAMS[*k]);
        }
    }
}

proptest! {
    #![proptest_config(config(3))]

    #[test]
    fn bits_of_many_chunks_do_not_depend_on_threads_or_blocks(steps in steps(), data in many()) {
        let program = record(&steps);
        same_bits::<f32>(&program, &data)?;
        same_bits::<f64>(&program, &data)?;
    }
}
