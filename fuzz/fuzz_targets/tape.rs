//! Any bytes as a graph: what compiles runs in all modes, with forward and reverse transposed; what does not says why.

#![no_main]

use autodiff::{Graph, Mask, Sizes, Var};
use libfuzzer_sys::arbitrary::{self, Arbitrary};
use libfuzzer_sys::fuzz_target;

/// An operation and the operands to take among those recorded, of any domain, channels and axis.
#[derive(Arbitrary, Debug)]
struct Step {
    op: u8,
    a: u8,
    b: u8,
    scalar: i8,
}

#[derive(Arbitrary, Debug)]
struct Input {
    steps: Vec<Step>,
    pixels: u8,
    counts: Vec<u8>,
    block: u16,
}

fuzz_target!(|input: Input| {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
    let sample = g.segments("sample", &pixel);
    let axis = g.axis("axis");
    let index = g.index("index", &sample, &texel);
    let mut values: Vec<Var> = vec![
        g.param("color", &pixel, 3),
        g.param_along("row", &pixel, 1, &axis),
        g.param("table", &texel, 3),
        g.param("gain", &g.uniform(), 1),
        g.param("matrix", &g.uniform(), 6),
        g.input("light", &sample, 1).attach(),
    ];
    let params = ["color", "row", "table", "gain", "matrix"];
    let mut mask: Mask = g.mask("mask", &sample);
    for step in input.steps.iter().take(40) {
        let at = |k: u8| values[k as usize % values.len()].clone();
        let (a, b) = (at(step.a), at(step.b));
        if a.channels() > 64 {
            continue;
        }
        let s = step.scalar as f64 / 16.0;
        values.push(match step.op % 32 {
            0 => a + b,
            1 => a - b,
            2 => a * b,
            3 => a / b,
            4 => a.min(&b),
            5 => a.max(&b),
            6 => a.atan2(&b),
            7 => a.abs().pow(&b),
            8 => a.affine(s, 1.0 - s),
            9 => a.sqrt(),
            10 => a.exp(),
            11 => a.ln(),
            12 => a.sin(),
            13 => a.sigmoid(),
            14 => a.clamp(-1.0, 1.0),
            15 => a.powi(step.scalar as i32 % 8),
            16 => a.expand(&sample),
            17 => a.segment_sum(),
            18 => a.segment_mean(),
            19 => a.segment_dot(&b),
            20 => a.gather(&index),
            21 => a.gather_weighted(&[(&index, &b)]),
            22 => a.sum_channels(),
            23 => a.sum_axis(),
            24 => a.sum_lanes(),
            25 => a.channel(step.b as usize % 4),
            26 => Var::stack(&[&a, &b]),
            27 => a.normalize(),
            28 => a.matmul(&b, None),
            29 => a.detach().attach_to(&b),
            30 => {
                mask = a.lt(&b);
                mask.select(&a, &b)
            }
            _ => mask.select_or_zero(&a),
        });
    }
    let last = values[values.len() - 1].clone();
    let Ok(program) = g.compile(&[("last", &last), ("sum", &last.sum())]) else {
        return;
    };
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
        .offsets("sample", offsets)
        .axis("axis", 3)
        .block(input.block as usize);
    let mut ws = program.workspace::<f64>(&sizes).expect("sound sizes");
    let number = |i: usize| ((i * 7919 + 13) % 101) as f64 / 50.0 - 1.0;
    let lens = [3 * pixels, 3 * pixels, 3 * texels, 1, 6];
    let arrays = lens.map(|n| (0..n).map(number).collect::<Vec<f64>>());
    for (name, array) in params.iter().zip(&arrays) {
        ws.set(name, array).expect("the right length");
    }
    let indices: Vec<u32> = (0..samples as u32).map(|i| i * 3 % texels as u32).collect();
    ws.set_index("index", &indices).expect("in range");
    ws.set("light", &(0..samples).map(number).collect::<Vec<_>>()).expect("the right length");
    let bits: Vec<bool> = (0..samples).map(|i| i % 3 != 0).collect();
    ws.set_mask("mask", &bits).expect("the right length");

    let direction: Vec<(&str, &[f64])> = params.iter().zip(&arrays).map(|(n, a)| (*n, &a[..])).collect();
    // From fresh inputs a gradient runs forward and back in one go; below, from values that a tangent has left.
    program.vjp(&mut ws, "last").expect("a bound program");
    let gradient = |name: &str| ws.gradient(name).expect("a gradient").to_vec();
    let fresh: Vec<Vec<f64>> = params.iter().map(|name| gradient(name)).collect();
    program.jvp(&mut ws, &direction).expect("a bound program");
    let tangent = ws.tangent("sum").expect("an output")[0];
    program.vjp(&mut ws, "last").expect("a bound program");
    let (mut reverse, mut size) = (0.0, 0.0f64);
    for ((name, array), fresh) in direction.iter().zip(&fresh) {
        let separate = ws.gradient(name).expect("a gradient");
        let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan());
        assert!(separate.iter().zip(fresh).all(same), "fused and separate passes differ in {name}");
        for (g, v) in separate.iter().zip(*array) {
            reverse += g * v;
            size += (g * v).abs();
        }
    }
    // Infinities meet zeros in another order in each direction.
    if tangent.is_finite() && size.is_finite() && size < 1e100 && tangent.abs() < 1e100 {
        // Where a derivative is nothing, as that of a direction by its length, what is left is rounding of values as large as the output.
        let output = ws.output("last").expect("an output").iter().fold(1.0f64, |most, v| most.max(v.abs()));
        let apart = (tangent - reverse).abs();
        let rounding = 1e-6 * size.max(tangent.abs()) + 1e-12 * output;
        assert!(apart <= rounding, "{tangent} forward, {reverse} in reverse");
    }
    let memory = program.memory::<f64>(&sizes).expect("sound sizes");
    assert!(ws.bytes() <= memory.total());
    program.hvp(&mut ws, "sum", &direction).expect("a bound program");
});
