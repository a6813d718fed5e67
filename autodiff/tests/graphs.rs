//! Random graphs: tangents against differences, transposition, linearity, and bits over threads and blocks.

use std::sync::{Arc, OnceLock};

use autodiff::{
    CustomOp, Detached, Fma, Graph, LinearMap, Program, Real, RunError, Scalar, Sizes, Var,
    Workspace,
};
use proptest::prelude::*;
use proptest::test_runner::FileFailurePersistence;

const TEXELS: usize = 7;
const PARAMS: [&str; 5] = ["pixel", "row", "texel", "scale", "matrix"];
/// Channels of the matrix: what has as many channels as divide it can be multiplied.
const MATRIX: usize = 6;

/// What to record next: an operation, and the operands to take among those recorded.
type Step = (u8, usize, usize);

/// A graph of random steps over three domains and an axis, on values kept near 1 so that nothing overflows.
fn record(steps: &[Step]) -> Program {
    record_with(steps, true, true)
}

/// A user's smooth operation.
struct Ratio;

impl CustomOp<2> for Ratio {
    fn name(&self) -> &'static str {
        "ratio"
    }
    fn eval<R: Real, F: Fma>(&self, [a, b]: [R; 2]) -> R {
        a / (R::from_f64(1.0) + b * b)
    }
}

/// A user's operator on texels.
struct Mix;

impl Mix {
    fn run<S: Scalar>(columns: usize, transpose: bool, input: &[S], output: &mut [S]) {
        output.fill(S::default());
        for to in 0..TEXELS {
            for from in 0..TEXELS {
                let (row, column) = if transpose { (from, to) } else { (to, from) };
                let entry = S::from_f64(((3 * row + column) as f64).sin() * 0.4);
                for c in 0..columns {
                    let sum = output[to * columns + c] + entry * input[from * columns + c];
                    output[to * columns + c] = sum;
                }
            }
        }
    }
}

impl LinearMap for Mix {
    fn shape(&self) -> (usize, usize) {
        (TEXELS, TEXELS)
    }
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        Mix::run(columns, false, input, output);
    }
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        Mix::run(columns, true, input, output);
    }
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        Mix::run(columns, false, input, output);
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        Mix::run(columns, true, input, output);
    }
}

/// With `detach`, some values are detached: derivatives are not those of differences then.
fn record_with(steps: &[Step], simplify: bool, detach: bool) -> Program {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixels"), g.domain("texels"));
    let sample = g.segments("samples", &pixel);
    let part = g.segments("parts", &sample);
    let frame = g.axis("frames");
    let index = [
        g.index("first", &sample, &texel),
        g.index("second", &sample, &texel),
    ];
    let weight: Detached = g.input("weight", &sample, 1);
    let visible = g.mask("visible", &sample);
    // Keeps values away from kinks, on either side.
    let aside: Detached = visible.to_array() * 4.0 - 2.0;
    let share: Detached = g.input("share", &part, 1);
    let mut pixels: Vec<Var> = vec![
        g.param("pixel", &pixel, 3),
        g.param_along("row", &pixel, 1, &frame),
    ];
    let mut samples: Vec<Var> = vec![weight.attach()];
    let mut texels: Vec<Var> = vec![g.param("texel", &texel, 2)];
    let mut parts: Vec<Var> = vec![share.attach()];
    let scale = g.param("scale", &g.uniform(), 1);
    let matrix = g.param("matrix", &g.uniform(), MATRIX);
    let settle = |x: Var| (x * 0.7).sin() * 0.5 + 1.0;
    for &(kind, a, b) in steps {
        let (p, q) = (&pixels[a % pixels.len()], &pixels[b % pixels.len()]);
        let (s, t) = (&samples[a % samples.len()], &samples[b % samples.len()]);
        let x = &texels[a % texels.len()];
        let (u, v) = (&parts[a % parts.len()], &parts[b % parts.len()]);
        let compatible = |u: &Var, v: &Var| {
            u.channels() == v.channels() || u.channels() == 1 || v.channels() == 1
        };
        match kind % 40 {
            0 => samples.push(p.expand(&sample)),
            1 => samples.push(x.gather(&index[b % 2])),
            2 => samples
                .push(x.gather_weighted(&[(&index[0], &weight), (&index[1], &(1.0 - &weight))])),
            3 if s.channels() == 1 => {
                let share = s.sum_axis() * &weight;
                samples.push(x.sum_channels().gather_weighted(&[(&index[0], &share)]));
            }
            4 => pixels.push(settle(s.segment_mean())),
            5 if compatible(s, t) => pixels.push(settle(s.segment_dot(t) * 0.1)),
            6 if compatible(s, t) => samples.push(settle(s * t)),
            7 if compatible(s, t) => samples.push(settle(s.square().mul_add(t, &(&scale * 0.3)))),
            8 if compatible(s, t) => samples.push(visible.select(&settle(s + t), s)),
            9 if compatible(p, q) => pixels.push(settle(p / (q.square() + 1.0))),
            10 => pixels.push(p.sum_axis().sum_channels().sigmoid() * &scale),
            11 => texels.push(settle(x.exp() * &scale + p.sum() * 0.01)),
            // Never of length 0.
            12 => samples.push(Var::stack(&[s, &settle(t.channel(0))]).normalize()),
            13 => samples.push(settle(s.segment_sum() * 0.1).expand(&sample)),
            // What is simplified.
            14 if compatible(s, t) => samples.push(settle(s.square() - t * s)),
            15 if compatible(s, t) => samples.push(settle(settle(s * t - s.channel(0)) - s * t)),
            16 => pixels.push(settle(
                (p + p) * (q.channel(0).square() + 1.0).sqrt().recip(),
            )),
            17 => samples
                .push(settle(-(s * s * 2.0 + 1.0) + 0.5) * (1.0 / (t.channel(0).square() + 2.0))),
            18 => pixels.push(settle(p * p.channel(0) + 3.0)),
            // Layers, with and without a bias.
            19 | 20 => {
                let (on_pixels, flat) = match b % 2 {
                    0 => (true, p.sum_axis()),
                    _ => (false, s.sum_axis()),
                };
                if MATRIX.is_multiple_of(flat.channels()) {
                    let out = MATRIX / flat.channels();
                    let bias = Var::stack(&vec![&scale; out]);
                    let bias = (kind % 2 == 0).then_some(&bias);
                    let layer = settle(settle(flat).matmul(&matrix, bias) * 0.3);
                    let few = if out > 3 {
                        layer.channel(out - 1)
                    } else {
                        layer
                    };
                    if on_pixels {
                        pixels.push(few);
                    } else {
                        samples.push(few);
                    }
                }
            }
            21 => texels.push(settle(x.linear_map(&texel, Arc::new(Mix)))),
            22 if compatible(s, t) => samples.push(settle(g.custom(Ratio, [s, t]))),
            23 => pixels.push(settle(p.log_sum_exp() * q.channel(0))),
            24 => samples.push(settle(s.log_sum_exp())),
            25 if compatible(s, t) => {
                samples.push((s.square() + 0.5).pow(&(settle(t.clone()) - 1.2)))
            }
            26 => pixels.push(settle((p.square() + 0.3).ln() + (p.sin() * 0.9).acos())),
            27 if compatible(s, t) => samples.push(settle(s.atan2(&(t.square() + 0.5)))),
            // Kinks, which values keep away from on both sides.
            28 if compatible(s, t) => {
                let (near, far) = (settle(s.clone()), settle(t.clone()) + &aside);
                samples.push(near.min(&far) * 0.5);
                samples.push(near.max(&far) * 0.5);
            }
            29 => samples.push((settle(s.clone()) + &aside).clamp(0.0, 9.0) * 0.4),
            30 => samples.push((settle(s.clone()) + &aside).relu() * 0.4),
            31 => samples.push((settle(s.clone()) + &aside).abs() * 0.5),
            32 if compatible(s, t) => {
                let (near, far) = (settle(s.clone()), settle(t.clone()) + &aside);
                let (below, above) = (near.lt(&far), far.le(&near));
                let mask = &(&below & &visible) | &(!&above);
                samples.push(mask.select(&near, &(far * 0.4)));
            }
            // A detached result: a weight, a shift, another's gradient.
            33 if compatible(s, t) && detach => {
                samples.push(settle(s.detach() * t + s.exp().detach().attach_to(t)));
            }
            34 if detach => pixels.push(settle(p.sum_axis().channel(0).detach() * q)),
            // Segments of segments.
            35 => parts.push(s.expand(&part) * &share),
            36 => samples.push(settle(u.segment_mean())),
            37 if compatible(u, v) => samples.push(settle(u.segment_dot(v) * 0.3)),
            38 if compatible(u, v) => parts.push(settle(u * v + u.square())),
            39 => parts.push(settle(p.sum_axis().expand(&sample).expand(&part))),
            _ => samples.push(visible.select(s, s) + weight.detach().detach() * 1.0),
        }
    }
    let last = |values: &[Var]| {
        let recent = values.iter().rev().take(3);
        recent.fold(scale.clone(), |sum, value| sum + value.sum())
    };
    let loss = last(&pixels) + last(&samples) + last(&texels) + last(&parts);
    let residual = pixels[pixels.len() - 1].clone();
    let outputs = [("loss", &loss), ("residual", &residual)];
    let program = match simplify {
        true => g.compile(&outputs),
        false => g.compile_as_recorded(&outputs),
    };
    program.unwrap()
}

/// Lanes of every pixel, and numbers to fill arrays with.
#[derive(Clone, Debug)]
struct Data {
    counts: Vec<u32>,
    frames: usize,
    seed: u64,
}

/// A few segments, or now and then thousands of them, which make many chunks.
fn data() -> impl Strategy<Value = Data> {
    prop_oneof![15 => few(), 1 => many()]
}

fn many() -> impl Strategy<Value = Data> {
    (2000usize..2600, 3usize..16, any::<u64>()).prop_map(|(pixels, frames, seed)| {
        let mut data = Data {
            counts: Vec::new(),
            frames,
            seed,
        };
        let count = |i| match data.number(50, i) {
            x if x > 0.999 => 90,
            x => (x * 6.0) as u32,
        };
        data.counts = (0..pixels).map(count).collect();
        data
    })
}

fn few() -> impl Strategy<Value = Data> {
    let count = prop_oneof![4 => 0u32..6, 1 => 60u32..130];
    (
        prop::collection::vec(count, 0..12),
        1usize..20,
        any::<u64>(),
    )
        .prop_map(|(counts, frames, seed)| Data {
            counts,
            frames,
            seed,
        })
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    prop::collection::vec((any::<u8>(), 0usize..8, 0usize..8), 3..24)
}

impl Data {
    fn number(&self, array: u64, i: usize) -> f64 {
        let mut x = self.seed ^ (array << 40) ^ (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        for _ in 0..2 {
            x ^= x >> 31;
            x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        }
        (x >> 11) as f64 / (1u64 << 53) as f64
    }

    fn array<S: Scalar>(&self, array: u64, n: usize, low: f64) -> Vec<S> {
        (0..n)
            .map(|i| S::from_f64(low + self.number(array, i)))
            .collect()
    }

    fn lens(&self) -> [usize; 5] {
        let pixels = self.counts.len();
        [3 * pixels, pixels * self.frames, 2 * TEXELS, 1, MATRIX]
    }

    fn params<S: Scalar>(&self) -> Vec<Vec<S>> {
        let lens = self.lens().into_iter().enumerate();
        lens.map(|(k, n)| self.array(k as u64, n, 0.5)).collect()
    }

    fn direction<S: Scalar>(&self) -> Vec<Vec<S>> {
        let lens = self.lens().into_iter().enumerate();
        lens.map(|(k, n)| self.array(10 + k as u64, n, -0.5))
            .collect()
    }

    /// Lanes of each sample.
    fn parts(&self) -> Vec<u32> {
        let n = self.counts.iter().sum::<u32>() as usize;
        (0..n).map(|i| (self.number(24, i) * 4.0) as u32).collect()
    }

    fn sizes(&self, block: usize) -> Sizes {
        let offsets = |counts: &[u32]| {
            let mut offsets = vec![0];
            for count in counts {
                offsets.push(offsets[offsets.len() - 1] + count);
            }
            offsets
        };
        Sizes::new()
            .lanes("pixels", self.counts.len())
            .lanes("texels", TEXELS)
            .offsets("samples", offsets(&self.counts))
            .offsets("parts", offsets(&self.parts()))
            .axis("frames", self.frames)
            .block(block)
    }

    fn workspace<S: Scalar>(&self, program: &Program, block: usize) -> Workspace<S> {
        let n = self.counts.iter().sum::<u32>() as usize;
        let mut ws = program.workspace::<S>(&self.sizes(block)).unwrap();
        let index = |array| -> Vec<u32> {
            (0..n)
                .map(|i| (self.number(array, i) * TEXELS as f64) as u32)
                .collect()
        };
        // An index that always names the same row, on some seeds.
        let same = vec![3; n];
        let first = if self.seed.is_multiple_of(4) {
            same
        } else {
            index(20)
        };
        ws.set_index("first", &first).unwrap();
        ws.set_index("second", &index(21)).unwrap();
        ws.set("weight", &self.array::<S>(22, n, 0.0)).unwrap();
        let parts = self.parts().iter().sum::<u32>() as usize;
        ws.set("share", &self.array::<S>(25, parts, 0.0)).unwrap();
        let visible: Vec<bool> = (0..n).map(|i| self.number(23, i) < 0.6).collect();
        ws.set_mask("visible", &visible).unwrap();
        for (name, values) in PARAMS.iter().zip(self.params::<S>()) {
            ws.set(name, &values).unwrap();
        }
        ws
    }
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
