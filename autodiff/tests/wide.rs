//! Layers of many channels on thousands of lanes, beside sums over segments: the same bits whatever threads and blocks.

use autodiff::{Detached, Graph, Program, Scalar, Sizes, Workspace};

const PIXELS: usize = 2300;
const TEXELS: usize = 50;
const WIDTHS: [usize; 5] = [33, 128, 200, 7, 3];

fn number(array: u64, i: usize) -> f64 {
    let mut x = (array << 40) ^ (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for _ in 0..2 {
        x ^= x >> 31;
        x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    (x >> 11) as f64 / (1u64 << 53) as f64 - 0.5
}

fn numbers<S: Scalar>(array: u64, n: usize, size: f64) -> Vec<S> {
    let numbers = (0..n).map(|i| S::from_f64(2.0 * size * number(array, i)));
    numbers.collect()
}

/// A colour of every pixel by a network, times the mean light of the pixel's samples.
fn record() -> Program {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
    let sample = g.segments("sample", &pixel);
    let mut x = g.input("place", &pixel, WIDTHS[0]).attach();
    for (k, w) in WIDTHS.windows(2).enumerate() {
        let weight = g.param(&format!("weight {k}"), &g.uniform(), w[0] * w[1]);
        let bias = g.param(&format!("bias {k}"), &g.uniform(), w[1]);
        x = x.matmul(&weight, Some(&bias));
        if k + 2 < WIDTHS.len() {
            x = x.relu();
        }
    }
    let index = g.index("index", &sample, &texel);
    let cosine: Detached = g.input("cosine", &sample, 1);
    let light = g.param("light", &texel, 3).exp().gather(&index);
    let image = x.sigmoid() * (light * cosine).segment_mean();
    let loss = (&image - 0.3).square().sum();
    g.compile(&[("loss", &loss), ("image", &image)]).unwrap()
}

fn params() -> Vec<(String, usize)> {
    let layers = WIDTHS.windows(2).enumerate();
    let layers = layers.flat_map(|(k, w)| {
        let weight = (format!("weight {k}"), w[0] * w[1]);
        [weight, (format!("bias {k}"), w[1])]
    });
    layers.chain([("light".to_string(), 3 * TEXELS)]).collect()
}

fn workspace<S: Scalar>(program: &Program, block: usize) -> Workspace<S> {
    let mut offsets = vec![0];
    for i in 0..PIXELS {
        let count = ((number(1, i) + 0.5) * 6.0) as u32;
        offsets.push(offsets[i] + count);
    }
    let samples = offsets[PIXELS] as usize;
    let sizes = Sizes::new()
        .lanes("pixel", PIXELS)
        .lanes("texel", TEXELS)
        .offsets("sample", offsets)
        .block(block);
    let mut ws = program.workspace::<S>(&sizes).unwrap();
    let place = numbers::<S>(2, WIDTHS[0] * PIXELS, 1.0);
    ws.set("place", &place).unwrap();
    ws.set("cosine", &numbers::<S>(3, samples, 1.0)).unwrap();
    let index: Vec<u32> = (0..samples)
        .map(|i| ((number(4, i) + 0.5) * TEXELS as f64) as u32)
        .collect();
    ws.set_index("index", &index).unwrap();
    for (k, (name, len)) in params().into_iter().enumerate() {
        ws.set(&name, &numbers::<S>(10 + k as u64, len, 0.2))
            .unwrap();
    }
    ws
}

/// Loss, image and all gradients; with values computed before or not.
fn results<S: Scalar>(program: &Program, block: usize, before: bool) -> Vec<Vec<f64>> {
    let mut ws = workspace::<S>(program, block);
    if before {
        program.forward(&mut ws).unwrap();
    }
    program.vjp(&mut ws, "loss").unwrap();
    let outputs = ["loss", "image"].map(|name| ws.output(name).unwrap());
    let gradients = params().into_iter().map(|(name, _)| name);
    let gradients: Vec<_> = gradients.map(|name| ws.gradient(&name).unwrap()).collect();
    let all = outputs.into_iter().chain(gradients);
    all.map(|array| array.iter().map(|x| x.to_f64()).collect())
        .collect()
}

#[test]
fn bits_are_the_same_for_any_threads_and_blocks() {
    let program = record();
    let expected = results::<f32>(&program, 512, true);
    for threads in [1, 2, 3, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| {
            for (block, before) in [(64, false), (208, true), (1024, false), (4096, true)] {
                let found = results::<f32>(&program, block, before);
                assert!(found == expected, "{threads} threads, blocks of {block}");
            }
        });
    }
}

#[test]
fn single_precision_is_close_to_double() {
    let program = record();
    let single = results::<f32>(&program, 512, false);
    let double = results::<f64>(&program, 512, false);
    for (k, (single, double)) in single.iter().zip(&double).enumerate() {
        let norm = double.iter().fold(0.0f64, |norm, x| norm.max(x.abs()));
        assert!(norm > 1e-3, "array {k} is all zero");
        for (a, b) in single.iter().zip(double) {
            assert!((a - b).abs() <= 1e-4 * norm, "array {k}: {a} for {b}");
        }
    }
}
