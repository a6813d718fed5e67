//! Any bytes as a graph: what compiles runs in all modes, with forward and reverse transposed and the same bits for any block size
//! and number of threads; what does not says why.

#![no_main]

#[path = "tape/record.rs"]
mod record;

use std::sync::OnceLock;

use autodiff::{Program, Scalar, Sizes, Workspace};
use libfuzzer_sys::arbitrary::{self, Arbitrary};
use libfuzzer_sys::fuzz_target;
use record::{AXIS, CELLS, PARAMS, Recorded, Step, record};

#[derive(Arbitrary, Debug)]
struct Input {
    fitting: bool,
    steps: Vec<Step>,
    pixels: u8,
    counts: Vec<u8>,
    block: u16,
}

fuzz_target!(|input: Input| {
    let Ok(Recorded {
        program,
        first_order,
    }) = record(&input.steps, input.fitting)
    else {
        return;
    };
    let data = Data::of(&input);
    let sizes = data.sizes.clone().block(input.block as usize);
    let mut ws = data.bind::<f64>(&program, &sizes);
    let arrays: Vec<(&str, Vec<f64>)> = data.params().collect();
    let direction: Vec<(&str, &[f64])> = arrays
        .iter()
        .map(|(name, array)| (*name, &array[..]))
        .collect();
    // From fresh inputs a gradient runs forward and back in one go; below, from values that a tangent has left.
    let fresh = gradients(&program, &mut ws);
    let output: Vec<f64> = ws.output("last").expect("an output").to_vec();
    program.jvp(&mut ws, &direction).expect("a bound program");
    let tangent = ws.tangent("sum").expect("an output")[0];
    let separate = gradients(&program, &mut ws);
    assert!(same(&separate, &fresh), "fused and separate passes differ");
    let (mut reverse, mut size) = (0.0, 0.0f64);
    let gradient = separate.iter().flatten();
    for (g, v) in gradient.zip(direction.iter().flat_map(|(_, array)| *array)) {
        reverse += g * v;
        size += (g * v).abs();
    }
    // Infinities meet zeros in another order in each direction.
    if tangent.is_finite() && size.is_finite() && size < 1e100 && tangent.abs() < 1e100 {
        // Where a derivative is nothing, as that of a direction by its length, what is left is rounding of values as large as the output.
        let output = output.iter().fold(1.0f64, |most, v| most.max(v.abs()));
        let apart = (tangent - reverse).abs();
        let rounding = 1e-6 * size.max(tangent.abs()) + 1e-12 * output;
        assert!(apart <= rounding, "{tangent} forward, {reverse} in reverse");
    }
    let memory = program.memory::<f64>(&sizes).expect("sound sizes");
    assert!(ws.bytes() <= memory.total());
    let product = program.hvp(&mut ws, "sum", &direction);
    assert!(
        product.is_ok() || first_order,
        "second derivatives are known"
    );
    program
        .gauss_newton(&mut ws, "last", &direction, None)
        .expect("a bound program");

    let other = data.sizes.clone().block(64);
    let (again, other_output) = pool().install(|| {
        let mut ws = data.bind::<f64>(&program, &other);
        let again = gradients(&program, &mut ws);
        (again, ws.output("last").expect("an output").to_vec())
    });
    assert!(
        same(&again, &fresh),
        "gradients depend on blocks or threads"
    );
    assert!(
        same(&[other_output], &[output]),
        "values depend on blocks or threads"
    );
    gradients(&program, &mut data.bind::<f32>(&program, &sizes));
});

/// Two threads.
fn pool() -> &'static rayon::ThreadPool {
    static POOL: OnceLock<rayon::ThreadPool> = OnceLock::new();
    POOL.get_or_init(|| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(2)
            .build()
            .expect("threads")
    })
}

/// Bits are the same; any NaN is as good as another.
fn same(a: &[Vec<f64>], b: &[Vec<f64>]) -> bool {
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    let alike = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan());
    a.len() == b.len() && pairs.into_iter().all(alike)
}

/// The gradient of all of the last value, parameter by parameter.
fn gradients<S: Scalar>(program: &Program, ws: &mut Workspace<S>) -> Vec<Vec<S>> {
    program.vjp(ws, "last").expect("a bound program");
    PARAMS
        .map(|name| ws.gradient(name).expect("a gradient").to_vec())
        .into()
}

/// What a workspace is bound to.
struct Data {
    sizes: Sizes,
    pixels: usize,
    samples: usize,
    texels: usize,
}

impl Data {
    fn of(input: &Input) -> Self {
        let pixels = input.pixels as usize % 9;
        let mut offsets = vec![0u32];
        for p in 0..pixels {
            let count = input.counts.get(p).copied().unwrap_or(3) as u32;
            offsets.push(offsets[p] + count);
        }
        let samples = offsets[pixels] as usize;
        // Small, or large for its lookups.
        let texels = if input.block % 2 == 0 { 5 } else { 700 };
        let sizes = Sizes::new()
            .lanes("pixel", pixels)
            .lanes("texel", texels)
            .lanes("cell", CELLS)
            .offsets("sample", offsets)
            .per_parent("part", 2)
            .axis("axis", AXIS);
        Data {
            sizes,
            pixels,
            samples,
            texels,
        }
    }

    fn params(&self) -> impl Iterator<Item = (&'static str, Vec<f64>)> {
        let lens = [
            3 * self.pixels,
            AXIS * self.pixels,
            3 * self.texels,
            1,
            6,
            AXIS * CELLS,
        ];
        PARAMS
            .into_iter()
            .zip(lens.map(|len| numbers(len).collect()))
    }

    fn bind<S: Scalar>(&self, program: &Program, sizes: &Sizes) -> Workspace<S> {
        let mut ws = program.workspace::<S>(sizes).expect("sound sizes");
        let cast =
            |array: &mut dyn Iterator<Item = f64>| array.map(S::from_f64).collect::<Vec<S>>();
        for (name, array) in self.params() {
            ws.set(name, &cast(&mut array.into_iter()))
                .expect("the right length");
        }
        for (name, step, lanes) in [
            ("near", 3, self.texels),
            ("far", 5, self.texels),
            ("beside", 1, CELLS),
        ] {
            let index: Vec<u32> = (0..self.samples)
                .map(|i| (i * step % lanes) as u32)
                .collect();
            ws.set_index(name, &index).expect("in range");
        }
        ws.set("light", &cast(&mut numbers(self.samples)))
            .expect("the right length");
        let bits: Vec<bool> = (0..self.samples).map(|i| i % 3 != 0).collect();
        ws.set_mask("mask", &bits).expect("the right length");
        ws
    }
}

/// Numbers between -1 and 1, some of them 0.
fn numbers(count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(|i| ((i * 7919 + 13) % 101) as f64 / 50.0 - 1.0)
}
