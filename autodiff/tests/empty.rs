//! Domains of no lanes or one, and segments of none, in every mode.

mod common;

use std::sync::Arc;

use autodiff::{Graph, Program, Scalar, Sizes, Var};
use common::Identity;

/// Every operation that knows of lanes.
fn program(texels: usize) -> Program {
    let g = Graph::new();
    let (pixel, texel, mapped) = (g.domain("pixel"), g.domain("texel"), g.domain("mapped"));
    let sample = g.segments("sample", &pixel);
    let part = g.segments("part", &sample);
    let frame = g.axis("frame");
    let color = g.param("color", &pixel, 3);
    let rows = g.param_along("rows", &texel, 1, &frame);
    let weight = g.param("weight", &g.uniform(), 6);
    let light = g.input("light", &sample, 1);
    let index = g.index("index", &sample, &mapped);
    let rows = rows.linear_map(&mapped, Arc::new(Identity(texels)));
    let found = rows.gather(&index) + rows.gather_weighted(&[(&index, &light)]);
    let shaded = (color.expand(&sample) * &light).segment_dot(&found);
    let layer = color.matmul(&weight, None).sum_channels();
    let parts = found
        .log_sum_exp()
        .expand(&part)
        .sin()
        .segment_mean()
        .segment_sum();
    let result = shaded.sum_axis() + layer + parts + rows.exp().sum_lanes().sum_axis();
    let spread = Var::stack(&[&result, &color.normalize()]);
    let loss = spread.square().sum() + rows.square().sum();
    g.compile(&[("loss", &loss), ("result", &result), ("rows", &rows)])
        .unwrap()
}

fn run<S: Scalar>(pixels: usize, each: usize, texels: usize, frames: usize) {
    let program = program(texels);
    let sizes = Sizes::new()
        .lanes("pixel", pixels)
        .lanes("texel", texels)
        .lanes("mapped", texels)
        .per_parent("sample", each)
        .per_parent("part", each)
        .axis("frame", frames);
    let one = |n: usize| vec![S::from_f64(0.5); n];
    let mut ws = program.workspace::<S>(&sizes).unwrap();
    let predicted = program.memory::<S>(&sizes).unwrap();
    let samples = pixels * each;
    ws.set("color", &one(3 * pixels)).unwrap();
    ws.set("rows", &one(texels * frames)).unwrap();
    ws.set("weight", &one(6)).unwrap();
    ws.set("light", &one(samples)).unwrap();
    ws.set_index("index", &vec![0; samples]).unwrap();
    let (color, rows) = (one(3 * pixels), one(texels * frames));
    let direction: [(&str, &[S]); 2] = [("color", &color), ("rows", &rows)];
    for _ in 0..2 {
        program.vjp(&mut ws, "loss").unwrap();
        program.jvp(&mut ws, &direction).unwrap();
        program
            .gauss_newton(&mut ws, "result", &direction, None)
            .unwrap();
        program.hvp(&mut ws, "loss", &direction).unwrap();
        program.forward(&mut ws).unwrap();
        assert_eq!(program.find_non_finite(&mut ws).unwrap(), None);
        assert_eq!(
            program.find_non_finite_gradient(&mut ws, "loss").unwrap(),
            None
        );
        assert!(
            program
                .find_singularities(&mut ws, "loss")
                .unwrap()
                .is_empty()
        );
        program.explain(&mut ws, "loss").unwrap();
        assert!(ws.bytes() <= predicted.total() + predicted.hessian);
        ws.set_index("index", &vec![0; samples]).unwrap();
    }
    program.vjp(&mut ws, "loss").unwrap();
    assert!(ws.output("loss").unwrap()[0].is_finite());
    assert_eq!(ws.output("result").unwrap().len(), 3 * pixels);
    assert_eq!(ws.gradient("color").unwrap().len(), 3 * pixels);
    assert_eq!(ws.gradient("rows").unwrap().len(), texels * frames);
}

#[test]
fn nothing_and_one_of_everything_run_in_every_mode() {
    for pixels in [0, 1, 3] {
        for each in [0, 1, 2] {
            for texels in [0, 1, 2] {
                if texels == 0 && pixels * each > 0 {
                    continue;
                }
                for frames in [1, 5] {
                    run::<f32>(pixels, each, texels, frames);
                    run::<f64>(pixels, each, texels, frames);
                }
            }
        }
    }
}
