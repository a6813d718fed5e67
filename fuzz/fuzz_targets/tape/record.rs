//! The graph that a list of steps says.

use std::sync::Arc;

use autodiff::{Domain, Graph, GraphError, Mask, Program, Var};
use libfuzzer_sys::arbitrary::{self, Arbitrary};

#[path = "../../../autodiff/tests/common/operations.rs"]
mod operations;

use operations::{Cube, Mix, Ratio, SumAndShare};

/// Parameters.
pub const PARAMS: [&str; 6] = ["color", "row", "table", "gain", "matrix", "field"];
/// Lanes of the small table, which a linear map takes too.
pub const CELLS: usize = 4;
/// Elements of the axis.
pub const AXIS: usize = 3;
/// Steps of a graph.
const STEPS: usize = 40;
/// Where these are among the values.
const GAIN: usize = 3;
const MATRIX: usize = 4;

/// An operation and the operands to take among those recorded, of any domain, channels and axis.
#[derive(Arbitrary, Debug)]
pub struct Step {
    op: u8,
    a: u8,
    b: u8,
    scalar: i8,
}

/// A compiled graph, and whether it holds an operation whose second derivatives nobody knows.
pub struct Recorded {
    pub program: Program,
    pub first_order: bool,
}

/// With `fitting`, operands are of one domain, so that most graphs compile.
pub fn record(steps: &[Step], fitting: bool) -> Result<Recorded, GraphError> {
    let g = Graph::new();
    let (pixel, texel, cell) = (g.domain("pixel"), g.domain("texel"), g.domain("cell"));
    let sample = g.segments("sample", &pixel);
    let part = g.segments("part", &sample);
    let axis = g.axis("axis");
    let [near, far] = ["near", "far"].map(|name| g.index(name, &sample, &texel));
    let beside = g.index("beside", &sample, &cell);
    let mut values: Vec<Var> = vec![
        g.param("color", &pixel, 3),
        g.param_along("row", &pixel, 1, &axis),
        g.param("table", &texel, 3),
        g.param("gain", &g.uniform(), 1),
        g.param("matrix", &g.uniform(), 6),
        g.param_along("field", &cell, 1, &axis),
        g.input("light", &sample, 1).attach(),
    ];
    let mut mask: Mask = g.mask("mask", &sample);
    let mut first_order = false;
    for step in steps.iter().take(STEPS) {
        let a = values[step.a as usize % values.len()].clone();
        let b = operand(&values, step.b, fitting.then_some(&a));
        if a.channels() > 64 {
            continue;
        }
        let is_on = |domain: &Domain| !fitting || a.domain() == *domain;
        let s = step.scalar as f64 / 16.0;
        let next = match step.op % 56 {
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
            16 if is_on(&pixel) => a.expand(&sample),
            17 if is_on(&sample) || is_on(&part) => a.segment_sum(),
            18 if is_on(&sample) || is_on(&part) => a.segment_mean(),
            19 if is_on(&sample) || is_on(&part) => a.segment_dot(&b),
            20 if is_on(&texel) => a.gather(&near),
            21 if is_on(&texel) => a.gather_weighted(&[(&near, &weight(&values, step.b, &sample))]),
            22 => a.sum_channels(),
            23 => a.sum_axis(),
            24 => a.sum_lanes(),
            25 => a.channel(step.b as usize % if fitting { a.channels().max(1) } else { 4 }),
            26 => Var::stack(&[&a, &b]),
            27 => a.normalize(),
            28 => a.matmul(&b, None),
            29 => a.detach().attach_to(&b),
            30 => {
                let next = a.lt(&b);
                let selected = next.select(&a, &b);
                if !fitting || a.domain() == sample {
                    mask = next;
                }
                selected
            }
            31 if is_on(&sample) => mask.select_or_zero(&a),
            32 => a.cos(),
            33 => a.acos(),
            34 => a.rsqrt(),
            35 => a.recip(),
            36 => a.relu(),
            37 => a.softplus(),
            38 => a.square(),
            39 => a.log_sum_exp(),
            40 => a.max_axis().attach(),
            41 => a.mul_add(&b, &a),
            42 => a.dot(&b),
            43 => {
                let other = a.gt_scalar(s);
                (&(&a.le(&b) & &other) | &!&other).select(&a, &b)
            }
            44 if is_on(&sample) => a.expand(&part),
            45 if is_on(&cell) => a.gather(&beside),
            46 if is_on(&texel) => {
                let share = weight(&values, step.b, &sample);
                a.gather_weighted(&[(&near, &share), (&far, &(1.0 - &share))])
            }
            // Of another domain's size is known when sizes are.
            47 if a.domain() == cell => a.linear_map(&cell, Arc::new(Mix(CELLS))),
            48 => g.custom(Ratio, [&a, &b]),
            49 => {
                let [sum, product] = g.custom_vec(SumAndShare, [&a, &b]);
                values.push(sum);
                product
            }
            50 => {
                first_order = true;
                g.custom_first_order(Cube { factor: 1.0 }, [&a])
            }
            51 => {
                let bias = vec![&values[GAIN]; 6 / a.channels().clamp(1, 6)];
                a.matmul(&values[MATRIX], Some(&Var::stack(&bias)))
            }
            52 => -a,
            53 => a.detach() * b,
            54 => 2.0 / a,
            _ => a,
        };
        values.push(next);
    }
    let last = values[values.len() - 1].clone();
    let program = g.compile(&[("last", &last), ("sum", &last.sum())])?;
    Ok(Recorded {
        program,
        first_order,
    })
}

/// One of the values: of those that fit beside another, if there is one.
fn operand(values: &[Var], at: u8, beside: Option<&Var>) -> Var {
    let fits = |value: &&Var| {
        beside.is_none_or(|a| {
            let channels = [a.channels(), value.channels()];
            a.domain() == value.domain() && (channels[0] == channels[1] || channels.contains(&1))
        })
    };
    let fitting: Vec<&Var> = values.iter().filter(fits).collect();
    fitting[at as usize % fitting.len()].clone()
}

/// A value of one channel on the samples, as the light is; one with an axis is refused as a weight.
fn weight(values: &[Var], at: u8, sample: &Domain) -> Var {
    let fits = |value: &&Var| value.domain() == *sample && value.channels() == 1;
    let fitting: Vec<&Var> = values.iter().filter(fits).collect();
    fitting[at as usize % fitting.len()].clone()
}
