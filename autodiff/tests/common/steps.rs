//! Every operation that knows of lanes, channels or positions, and what it takes to run it on six samples of two pixels.

use std::sync::Arc;

use autodiff::{Graph, LinearMap, Program, Sizes, Var, Workspace};

/// Records an operation on a value of samples.
pub type Step = fn(&Graph, &Var, &autodiff::Domain) -> Var;
/// One operation after another, of a value with two channels and an axis, per sample.
pub const STEPS: [(&str, Step); 14] = [
    ("nothing", |_, x, _| x.clone()),
    ("elementwise", |_, x, _| (x * 2.0 - x.square()).exp()),
    ("min", |_, x, _| x.min(&(x + 1.0)).max(x)),
    ("channels", |_, x, _| {
        Var::stack(&[&x.channel(0), x, &x.channel(1)])
    }),
    ("axis", |_, x, _| x.sum_axis() * x.sum_channels()),
    ("max", |_, x, _| x.log_sum_exp()),
    ("segments", |_, x, _| {
        x.segment_sum().square() + x.segment_mean()
    }),
    ("dot", |_, x, _| x.segment_dot(&x.sum_axis())),
    ("lanes", |_, x, _| x.sum_lanes() * x),
    ("expand", |_, x, sample| x.segment_mean().expand(sample)),
    ("gather", |g, x, sample| {
        x.gather(&g.index("i", sample, sample))
    }),
    ("interpolate", |g, x, sample| {
        let (i, j) = (g.index("i", sample, sample), g.index("j", sample, sample));
        let half: autodiff::Detached = g.constant(0.5);
        x.gather_weighted(&[(&i, &half), (&j, &half)])
    }),
    ("layer", |g, x, _| {
        let weight = g.param("weight", &g.uniform(), 6);
        x.sum_axis().matmul(&weight, None)
    }),
    ("map", |g, x, _| {
        x.linear_map(&g.domain("one"), Arc::new(Sum))
    }),
];

/// A workspace of a program with one of these operations, all but `x` bound.
pub fn bound(program: &Program, name: &str) -> Workspace<f64> {
    let mut sizes = Sizes::new()
        .lanes("pixel", 2)
        .per_parent("sample", 3)
        .axis("frame", 5);
    if name == "map" {
        sizes = sizes.lanes("one", 1);
    }
    let mut ws = program.workspace::<f64>(&sizes).unwrap();
    if ["gather", "interpolate"].contains(&name) {
        ws.set_index("i", &[5, 4, 3, 2, 1, 0]).unwrap();
    }
    if name == "interpolate" {
        ws.set_index("j", &[0; 6]).unwrap();
    }
    if name == "layer" {
        ws.set("weight", &[0.5; 6]).unwrap();
    }
    ws
}

struct Sum;

impl LinearMap for Sum {
    fn shape(&self) -> (usize, usize) {
        (6, 1)
    }
    fn apply_f32(&self, _: usize, _: &[f32], _: &mut [f32]) {}
    fn apply_transpose_f32(&self, _: usize, _: &[f32], _: &mut [f32]) {}
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        output.fill(0.0);
        for row in input.chunks_exact(columns) {
            output.iter_mut().zip(row).for_each(|(o, x)| *o += x);
        }
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        output
            .chunks_exact_mut(columns)
            .for_each(|row| row.copy_from_slice(input));
    }
}
