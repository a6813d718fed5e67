//! The zero rule: a derivative of exactly 0 contributes exactly 0, whatever it is multiplied with, forward and in reverse. What a
//! mask hides may hold NaNs; every result is then that of finite numbers in their place, to the bit.

use autodiff::{Detached, Domain, Graph, Index, Mask, Program, Scalar, Sizes, Var, Workspace};

const PIXELS: usize = 23;
const TEXELS: usize = 9;

/// What the operations that multiply may be given.
struct Inputs {
    sample: Domain,
    /// Not finite where hidden.
    spoilt: Detached,
    seen: Mask,
    /// The same per pixel.
    seen_pixel: Mask,
    rows: Var,
    texel: Var,
    color: Var,
    weight: Var,
    bias: Var,
    second: Var,
    /// Looks at the last texel, which is spoilt, where hidden.
    index: Index,
    other: Index,
}

type Record = fn(&Inputs) -> Var;

/// Parameters, and how many elements each has for an axis of some length.
fn params(axis: usize) -> [(&'static str, usize); 6] {
    [
        ("rows", TEXELS * axis),
        ("texel", 3 * TEXELS),
        ("color", 3 * PIXELS),
        ("weight", 5 * 37),
        ("bias", 37),
        ("second", 37 * 2),
    ]
}

fn network(i: &Inputs, x: &Var) -> Var {
    let hidden = x.matmul(&i.weight, Some(&i.bias)).sin();
    hidden.matmul(&i.second, None)
}

const CASES: &[(&str, Record)] = &[
    ("matmul", |i| {
        let x = Var::stack(&[
            &i.color.expand(&i.sample),
            &i.spoilt.attach(),
            &i.texel.gather(&i.index).channel(0),
        ]);
        i.seen.select_or_zero(&network(i, &x))
    }),
    ("matmul of an input", |i| {
        let x = Var::stack(&[&i.spoilt.attach(); 5]);
        i.seen.select_or_zero(&network(i, &x))
    }),
    ("gather_weighted, spoilt weights", |i| {
        let two = [(&i.index, &i.spoilt), (&i.other, &i.spoilt)];
        let found = i.rows.gather_weighted(&two).sum_axis();
        i.seen
            .select_or_zero(&(found * i.texel.gather_weighted(&two)))
    }),
    ("gather_weighted, many corners", |i| {
        let five = [(&i.index, &i.spoilt); 5];
        i.seen
            .select_or_zero(&i.rows.gather_weighted(&five).sum_axis())
    }),
    ("gather_weighted, spoilt table", |i| {
        let weight = i.texel.gather(&i.other).channel(1) * 0.5;
        let rows = i.rows.gather_weighted(&[(&i.index, &weight)]);
        let colors = i
            .texel
            .gather_weighted(&[(&i.index, &weight), (&i.other, &weight)]);
        i.seen.select_or_zero(&(rows.sum_axis() * colors))
    }),
    ("segment_dot, spoilt rows", |i| {
        let rows = i.rows.gather(&i.index) * &i.spoilt;
        let light = i.texel.gather(&i.other);
        i.seen_pixel
            .select_or_zero(&light.segment_dot(&rows).sum_axis())
    }),
    ("segment_dot, one channel", |i| {
        let rows = i.rows.gather(&i.index) * &i.spoilt;
        let light = i.texel.gather(&i.other).channel(2);
        i.seen_pixel
            .select_or_zero(&light.segment_dot(&rows).sum_axis())
    }),
    ("segment_dot, spoilt coefficients", |i| {
        let light = i.color.expand(&i.sample) * &i.spoilt;
        let dot = light.segment_dot(&i.rows.gather(&i.index));
        i.seen_pixel.select_or_zero(&dot.sum_axis())
    }),
    ("segment_dot, equal shapes", |i| {
        let light = i.color.expand(&i.sample) * &i.spoilt;
        i.seen_pixel
            .select_or_zero(&light.segment_dot(&i.texel.gather(&i.other)))
    }),
    ("segment_dot, rows of both", |i| {
        let rows = i.rows.gather(&i.index) * &i.spoilt;
        let dot = rows.segment_dot(&i.rows.gather(&i.other));
        i.seen_pixel.select_or_zero(&dot.sum_axis())
    }),
    ("a choice", |i| {
        // Tangents of what is not chosen are NaN.
        let x = (i.texel.gather(&i.index).channel(0) * &i.spoilt).sqrt();
        let y = i.texel.gather(&i.other).channel(0);
        let kept = y.lt(&(&y + 1.0)).select(&y, &x);
        i.seen.select(&x, &y) * kept
    }),
];

fn record(record: Record) -> Program {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
    let sample = g.segments("sample", &pixel);
    let frame = g.axis("frame");
    let inputs = Inputs {
        spoilt: g.input("spoilt", &sample, 1),
        seen: g.mask("seen", &sample),
        seen_pixel: g.mask("seen_pixel", &pixel),
        rows: g.param_along("rows", &texel, 1, &frame),
        texel: g.param("texel", &texel, 3),
        color: g.param("color", &pixel, 3),
        weight: g.param("weight", &g.uniform(), 5 * 37),
        bias: g.param("bias", &g.uniform(), 37),
        second: g.param("second", &g.uniform(), 37 * 2),
        index: g.index("index", &sample, &texel),
        other: g.index("other", &sample, &texel),
        sample,
    };
    let result = record(&inputs);
    let loss = (result.square() * 0.5).sum();
    g.compile(&[("loss", &loss), ("result", &result)]).unwrap()
}

fn number(i: usize, seed: usize) -> f64 {
    let mut x = ((seed as u64) << 32 | i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x ^= x >> 29;
    x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    0.1 + (x >> 11) as f64 / (1u64 << 53) as f64
}

fn array<S: Scalar>(seed: usize, n: usize) -> Vec<S> {
    (0..n).map(|i| S::from_f64(number(i, seed))).collect()
}

fn workspace<S: Scalar>(
    program: &Program,
    axis: usize,
    block: usize,
    bad: Option<f64>,
) -> Workspace<S> {
    let hidden = |pixel: usize| pixel % 3 == 1;
    let mut offsets = vec![0u32];
    let mut of_sample = Vec::new();
    for pixel in 0..PIXELS {
        let count = pixel * 11 % 71;
        offsets.push(offsets[pixel] + count as u32);
        of_sample.extend(vec![pixel; count]);
    }
    let sizes = Sizes::new()
        .lanes("pixel", PIXELS)
        .lanes("texel", TEXELS)
        .offsets("sample", offsets)
        .axis("frame", axis)
        .block(block);
    let mut ws = program.workspace::<S>(&sizes).unwrap();
    let n = of_sample.len();
    let is_hidden: Vec<bool> = of_sample.iter().map(|&pixel| hidden(pixel)).collect();
    let seen: Vec<bool> = is_hidden.iter().map(|hidden| !hidden).collect();
    ws.set_mask("seen", &seen).unwrap();
    let seen_pixel: Vec<bool> = (0..PIXELS).map(|pixel| !hidden(pixel)).collect();
    ws.set_mask("seen_pixel", &seen_pixel).unwrap();
    let last = TEXELS as u32 - 1;
    let index = |seed: usize| (0..n).map(move |i| (number(i, seed) * 1e6) as u32 % last);
    let at: Vec<u32> = index(1)
        .zip(&is_hidden)
        .map(|(i, &hidden)| if hidden { last } else { i })
        .collect();
    ws.set_index("index", &at).unwrap();
    ws.set_index("other", &index(2).collect::<Vec<_>>())
        .unwrap();
    let mut spoilt = array::<S>(3, n);
    for (x, _) in spoilt
        .iter_mut()
        .zip(&is_hidden)
        .filter(|(_, hidden)| **hidden)
    {
        *x = bad.map_or(*x, S::from_f64);
    }
    ws.set("spoilt", &spoilt).unwrap();
    for (k, (name, len)) in params(axis).into_iter().enumerate() {
        let mut values = array::<S>(10 + k, len);
        let rows = match name {
            "rows" => axis,
            "texel" => 1,
            _ => 0,
        };
        // The last texel: of its only channel, or of each.
        let channels = len / (TEXELS * rows).max(1);
        for c in 0..if rows == 0 { 0 } else { channels } {
            let end = (c + 1) * TEXELS * rows;
            for x in &mut values[end - rows..end] {
                *x = bad.map_or(*x, S::from_f64);
            }
        }
        ws.set(name, &values).unwrap();
    }
    ws
}

/// All results of all modes.
fn results<S: Scalar>(program: &Program, ws: &mut Workspace<S>, axis: usize) -> Vec<Vec<S>> {
    let lens = params(axis);
    let direction: Vec<_> = lens
        .iter()
        .enumerate()
        .map(|(k, (_, n))| array::<S>(20 + k, *n))
        .collect();
    let named: Vec<(&str, &[S])> = lens
        .iter()
        .zip(&direction)
        .map(|((name, _), v)| (*name, &v[..]))
        .collect();
    let mut all = Vec::new();
    let gradients = |ws: &Workspace<S>, all: &mut Vec<Vec<S>>| {
        all.extend(
            lens.iter()
                .map(|(name, _)| ws.gradient(name).unwrap().to_vec()),
        );
    };
    program.vjp(ws, "loss").unwrap();
    all.push(ws.output("result").unwrap().to_vec());
    gradients(ws, &mut all);
    // All parameters along a direction, and each by itself.
    for alone in std::iter::once(&named[..]).chain(named.chunks(1)) {
        program.jvp(ws, alone).unwrap();
        all.push(ws.tangent("result").unwrap().to_vec());
    }
    program.gauss_newton(ws, "result", &named, None).unwrap();
    gradients(ws, &mut all);
    program.hvp(ws, "loss", &named).unwrap();
    gradients(ws, &mut all);
    all.extend(
        lens.iter()
            .map(|(name, _)| ws.hessian_product(name).unwrap().to_vec()),
    );
    all
}

fn check<S: Scalar>() {
    for (name, record_case) in CASES {
        let program = record(*record_case);
        for (axis, block) in [(1, 64), (19, 1024), (48, 128)] {
            let mut finite = workspace::<S>(&program, axis, block, None);
            let expected = results(&program, &mut finite, axis);
            assert!(expected.iter().flatten().all(|x| x.is_finite()));
            for bad in [f64::NAN, f64::INFINITY] {
                let mut spoilt = workspace::<S>(&program, axis, block, Some(bad));
                let found = results(&program, &mut spoilt, axis);
                assert!(
                    found == expected,
                    "{name}, axis {axis}, blocks of {block}, {bad}"
                );
            }
        }
    }
}

#[test]
fn what_a_mask_hides_changes_nothing_in_single_precision() {
    check::<f32>();
}

#[test]
fn what_a_mask_hides_changes_nothing_in_double_precision() {
    check::<f64>();
}
