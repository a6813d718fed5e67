//! One program that uses every rate change, checked against differences, transposition, threads and blocks.

use std::sync::Arc;

use autodiff::{Graph, LinearMap, Program, Scalar, Sizes, Workspace};

struct Moments;

impl Moments {
    fn entry(out: usize, lane: usize) -> f64 {
        ((out + 1) as f64 * (lane as f64 + 0.5) * 0.7).sin()
    }
    fn run<S: Copy + std::ops::AddAssign + std::ops::Mul<Output = S>>(
        (ins, outs): (usize, usize),
        columns: usize,
        input: &[S],
        output: &mut [S],
        entry: impl Fn(usize, usize) -> S,
        zero: S,
    ) {
        output.fill(zero);
        for o in 0..outs {
            for i in 0..ins {
                for c in 0..columns {
                    output[o * columns + c] += entry(o, i) * input[i * columns + c];
                }
            }
        }
    }
}

const COEFFICIENTS: usize = 5;
const TEXELS: usize = 23;

impl LinearMap for Moments {
    fn shape(&self) -> (usize, usize) {
        (COEFFICIENTS, TEXELS)
    }
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        let shape = (COEFFICIENTS, TEXELS);
        Self::run(
            shape,
            columns,
            input,
            output,
            |o, i| Self::entry(o, i) as f32,
            0.0,
        );
    }
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        let shape = (TEXELS, COEFFICIENTS);
        Self::run(
            shape,
            columns,
            input,
            output,
            |o, i| Self::entry(i, o) as f32,
            0.0,
        );
    }
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        let shape = (COEFFICIENTS, TEXELS);
        Self::run(shape, columns, input, output, Self::entry, 0.0);
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        let shape = (TEXELS, COEFFICIENTS);
        Self::run(shape, columns, input, output, |o, i| Self::entry(i, o), 0.0);
    }
}

const PARAMS: [&str; 6] = ["albedo", "env", "coefficients", "gain", "weights", "bias"];

fn program() -> Program {
    let g = Graph::new();
    let (pixel, texel, coefficient) = (
        g.domain("pixel"),
        g.domain("texel"),
        g.domain("coefficient"),
    );
    let sample = g.segments("sample", &pixel);
    let frame = g.axis("frame");
    let albedo = g.param("albedo", &pixel, 3);
    let env = g.param("env", &texel, 3);
    let coefficients = g.param_along("coefficients", &coefficient, 1, &frame);
    let gain = g.param("gain", &g.uniform(), 1);
    let (weights, bias) = (
        g.param("weights", &g.uniform(), 6),
        g.param("bias", &g.uniform(), 2),
    );
    let near = g.index("near", &sample, &texel);
    let far = g.index("far", &sample, &texel);
    let fraction = g.input("fraction", &sample, 1);
    let cosine = g.input("cosine", &sample, 1);
    let visible = g.mask("visible", &sample);

    let masks = coefficients.linear_map(&texel, Arc::new(Moments)).sigmoid();
    let rows = masks.gather_weighted(&[(&near, &(1.0 - &fraction)), (&far, &fraction)]);
    let light = env.exp().gather(&near) * &cosine;
    let light = visible.select_or_zero(&light);
    let shaded = light.segment_dot(&rows) * &albedo;
    let glossy = (light.dot(&albedo.expand(&sample)) + 1.5).sqrt() * &gain;
    let features = albedo.matmul(&weights, Some(&bias)).relu();
    let residual = shaded + glossy.segment_mean() + features.sum_channels();
    let loss = residual.square().sum() * 0.5;
    g.compile(&[("loss", &loss), ("residual", &residual)])
        .unwrap()
}

fn value(seed: u64, i: usize) -> f64 {
    let mut x = (seed << 32 | i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x ^= x >> 29;
    x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x ^= x >> 32;
    x as f64 / u64::MAX as f64 - 0.5
}

struct Scene {
    pixels: usize,
    frames: usize,
    offsets: Vec<u32>,
}

impl Scene {
    fn new(pixels: usize, frames: usize) -> Self {
        let mut offsets = vec![0u32];
        for p in 0..pixels {
            // Empty segments, and one longer than a block.
            let count = if p == 3 { 700 } else { (p * 7) % 40 };
            offsets.push(offsets[p] + count as u32);
        }
        Scene {
            pixels,
            frames,
            offsets,
        }
    }
    fn workspace<S: Scalar>(&self, program: &Program, block: usize) -> Workspace<S> {
        let sizes = Sizes::new()
            .lanes("pixel", self.pixels)
            .lanes("texel", TEXELS)
            .lanes("coefficient", COEFFICIENTS)
            .offsets("sample", self.offsets.clone())
            .axis("frame", self.frames)
            .block(block);
        let mut ws = program.workspace::<S>(&sizes).unwrap();
        let n = self.offsets[self.pixels] as usize;
        let indices = |seed| -> Vec<u32> {
            (0..n)
                .map(|i| ((value(seed, i) + 0.5) * 22.99) as u32)
                .collect()
        };
        ws.set_index("near", &indices(1)).unwrap();
        ws.set_index("far", &indices(2)).unwrap();
        ws.set("fraction", &array::<S>(3, n, 0.5)).unwrap();
        ws.set("cosine", &array::<S>(4, n, 0.6)).unwrap();
        let visible: Vec<bool> = (0..n).map(|i| value(5, i) > -0.2).collect();
        ws.set_mask("visible", &visible).unwrap();
        for (k, name) in PARAMS.iter().enumerate() {
            let len = self.len(name);
            ws.set(name, &array::<S>(10 + k as u64, len, 0.1)).unwrap();
        }
        ws
    }
    fn len(&self, name: &str) -> usize {
        match name {
            "albedo" => 3 * self.pixels,
            "env" => 3 * TEXELS,
            "coefficients" => COEFFICIENTS * self.frames,
            "weights" => 6,
            "bias" => 2,
            _ => 1,
        }
    }
    fn direction<S: Scalar>(&self, seed: u64) -> Vec<(&'static str, Vec<S>)> {
        let arrays = PARAMS.iter().enumerate();
        arrays
            .map(|(k, name)| (*name, array(seed + k as u64, self.len(name), 0.0)))
            .collect()
    }
}

fn array<S: Scalar>(seed: u64, n: usize, offset: f64) -> Vec<S> {
    (0..n)
        .map(|i| S::from_f64(value(seed, i) + offset))
        .collect()
}

fn borrow<S>(direction: &[(&'static str, Vec<S>)]) -> Vec<(&'static str, &'static [S])>
where
    S: Clone + 'static,
{
    direction
        .iter()
        .map(|(name, array)| (*name, &*array.clone().leak()))
        .collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[test]
fn tangents_match_central_differences() {
    let (program, scene) = (program(), Scene::new(29, 19));
    let mut ws = scene.workspace::<f64>(&program, 512);
    let direction = borrow(&scene.direction::<f64>(40));
    program.jvp(&mut ws, &direction).unwrap();
    let tangent = ws.tangent("residual").unwrap().to_vec();
    let h = 1e-6;
    let mut moved = |sign: f64| {
        for (k, (name, v)) in direction.iter().enumerate() {
            let mut x = array::<f64>(10 + k as u64, scene.len(name), 0.1);
            x.iter_mut().zip(*v).for_each(|(x, v)| *x += sign * h * v);
            ws.set(name, &x).unwrap();
        }
        program.forward(&mut ws).unwrap();
        ws.output("residual").unwrap().to_vec()
    };
    let (plus, minus) = (moved(1.0), moved(-1.0));
    for i in 0..tangent.len() {
        let difference = (plus[i] - minus[i]) / (2.0 * h);
        let scale = tangent[i].abs().max(1.0);
        assert!(
            (difference - tangent[i]).abs() < 1e-6 * scale,
            "{i}: {difference} {}",
            tangent[i]
        );
    }
}

#[test]
fn reverse_is_the_transpose_of_forward() {
    let (program, scene) = (program(), Scene::new(31, 48));
    let mut ws = scene.workspace::<f64>(&program, 256);
    let direction = borrow(&scene.direction::<f64>(40));
    program.jvp(&mut ws, &direction).unwrap();
    let tangent = ws.tangent("residual").unwrap().to_vec();
    let cotangent = array::<f64>(77, tangent.len(), 0.0);
    program
        .vjp_with(&mut ws, &[("residual", &cotangent)])
        .unwrap();
    let left = dot(&cotangent, &tangent);
    let right: f64 = direction
        .iter()
        .map(|(name, v)| dot(ws.gradient(name).unwrap(), v))
        .sum();
    assert!(
        (left - right).abs() < 1e-12 * left.abs().max(1.0),
        "{left} {right}"
    );
}

#[test]
fn the_gauss_newton_product_is_forward_then_weighted_reverse() {
    let (program, scene) = (program(), Scene::new(12, 5));
    let mut ws = scene.workspace::<f64>(&program, 64);
    let direction = borrow(&scene.direction::<f64>(40));
    program.jvp(&mut ws, &direction).unwrap();
    let weights = array::<f64>(78, ws.tangent("residual").unwrap().len(), 1.0);
    let weighted: Vec<f64> = ws
        .tangent("residual")
        .unwrap()
        .iter()
        .zip(&weights)
        .map(|(t, w)| t * w)
        .collect();
    program
        .vjp_with(&mut ws, &[("residual", &weighted)])
        .unwrap();
    let expected: Vec<Vec<f64>> = PARAMS
        .iter()
        .map(|p| ws.gradient(p).unwrap().to_vec())
        .collect();
    program
        .gauss_newton(&mut ws, "residual", &direction, Some(&weights))
        .unwrap();
    for (name, expected) in PARAMS.iter().zip(&expected) {
        assert_eq!(ws.gradient(name).unwrap(), expected);
    }
}

#[test]
fn results_do_not_depend_on_threads_or_blocks() {
    let (program, scene) = (program(), Scene::new(400, 19));
    let run = |threads: usize, block: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut ws = scene.workspace::<f32>(&program, block);
            let direction = borrow(&scene.direction::<f32>(40));
            program.jvp(&mut ws, &direction).unwrap();
            let mut bits: Vec<u32> = Vec::new();
            let mut keep = |array: &[f32]| bits.extend(array.iter().map(|x| x.to_bits()));
            keep(ws.tangent("loss").unwrap());
            keep(ws.output("residual").unwrap());
            program.vjp(&mut ws, "loss").unwrap();
            for name in PARAMS {
                keep(ws.gradient(name).unwrap());
            }
            bits
        })
    };
    let reference = run(1, 512);
    for (threads, block) in [(2, 64), (3, 512), (8, 4096), (1, 1024), (2, 100)] {
        assert!(
            run(threads, block) == reference,
            "{threads} threads, blocks of {block}"
        );
    }
}

#[test]
fn a_domain_may_be_empty() {
    let (program, scene) = (program(), Scene::new(0, 3));
    let mut ws = scene.workspace::<f64>(&program, 512);
    program.vjp(&mut ws, "loss").unwrap();
    assert_eq!(ws.output("loss").unwrap(), [0.0]);
    assert!(ws.gradient("env").unwrap().iter().all(|&x| x == 0.0));
    assert_eq!(ws.gradient("albedo").unwrap(), [] as [f64; 0]);
}
