//! A graph of random steps.

use std::sync::Arc;

use autodiff::{Detached, Graph, Program, Var};

#[path = "../common/operations.rs"]
#[allow(dead_code)]
mod operations;

use operations::{Mix, Ratio, SumAndShare};

pub const TEXELS: usize = 7;
pub const PARAMS: [&str; 7] = ["pixel", "row", "texel", "scale", "matrix", "place", "field"];
/// Kinds of steps.
const KINDS: u8 = 52;
/// Channels of the matrix: what has as many channels as divide it can be multiplied.
pub const MATRIX: usize = 6;

/// What to record next: an operation, and the operands to take among those recorded.
pub type Step = (u8, usize, usize);

/// A graph of random steps over domains and an axis, on values kept near 1 so that nothing overflows.
pub fn record(steps: &[Step]) -> Program {
    record_with(steps, true, true)
}

/// With `detach`, some values are detached: derivatives are not those of differences then.
pub fn record_with(steps: &[Step], simplify: bool, detach: bool) -> Program {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixels"), g.domain("texels"));
    let sample = g.segments("samples", &pixel);
    let part = g.segments("parts", &sample);
    let frame = g.axis("frames");
    let index = [
        g.index("first", &sample, &texel),
        g.index("second", &sample, &texel),
    ];
    // A table that may be large for its lookups.
    let places = g.domain("places");
    let place = g.param("place", &places, 2);
    // A table with an axis.
    let field = g.param_along("field", &texel, 1, &frame);
    let [near, far] = ["near", "far"].map(|name| g.index(name, &sample, &places));
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
        match kind % KINDS {
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
            21 => texels.push(settle(x.linear_map(&texel, Arc::new(Mix(TEXELS))))),
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
            // A large table, and several results.
            40 => samples.push(place.gather(&near)),
            41 => {
                let share = s.sum_axis().channel(0);
                let rest = 1.5 - &share;
                samples.push(settle(
                    place.gather_weighted(&[(&near, &share), (&far, &rest)]),
                ));
            }
            42 => samples.push((&place * &scale).gather(&far) * s.sum_axis().channel(0)),
            43 if compatible(s, t) => {
                let [sum, share] = g.custom_vec(SumAndShare, [s, t]);
                samples.extend([settle(sum), settle(share)]);
            }
            // Rows along an axis.
            44 => samples.push(field.gather(&index[b % 2])),
            45 => {
                let share = s.sum_axis().channel(0);
                samples.push(settle(field.gather_weighted(&[
                    (&index[0], &share),
                    (&index[1], &(1.3 - &share)),
                ])));
            }
            46 => pixels.push(settle(s.segment_dot(&field.gather(&index[b % 2])) * 0.1)),
            47 => texels.push(settle(
                (&field * &scale).linear_map(&texel, Arc::new(Mix(TEXELS))),
            )),
            48 => samples.push(settle(s.softplus() * (t.channel(0) * 0.5).cos())),
            49 => samples.push(settle(s.powi(3) * 0.2 + t.channel(0).powi(2))),
            50 if s.channels() == t.channels() => samples.push(settle(s.dot(t) * 0.3)),
            // Where two values are as large, there is a kink.
            51 if detach => samples.push(settle(s.max_axis().attach())),
            _ => samples.push(visible.select(s, s) + weight.detach().detach() * 1.0),
        }
    }
    let all = |values: &[Var]| {
        let values = values.iter();
        values.fold(scale.clone(), |sum, value| sum + value.sum())
    };
    let loss = all(&pixels) + all(&samples) + all(&texels) + all(&parts);
    let residual = pixels[pixels.len() - 1].clone();
    let outputs = [("loss", &loss), ("residual", &residual)];
    let program = match simplify {
        true => g.compile(&outputs),
        false => g.compile_as_recorded(&outputs),
    };
    program.unwrap()
}
