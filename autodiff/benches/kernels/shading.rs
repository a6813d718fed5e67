//! 1,048,576 GGX samples of 16,384 pixels, an environment table of 8,192 x 3, squared loss.

use std::sync::Arc;

use autodiff::{Graph, Program, Sizes, Workspace};

use super::hand::Hand;
use super::timing::{best, numbers};

pub const PIXELS: usize = 16_384;
pub const PER_PIXEL: usize = 64;
pub const SAMPLES: usize = PIXELS * PER_PIXEL;
pub const TEXELS: usize = 8_192;

pub struct Data {
    pub nl: Vec<f32>,
    pub nh: Vec<f32>,
    pub vh5: Vec<f32>,
    pub weight: Vec<f32>,
    pub nv: Vec<f32>,
    pub texel: Vec<u32>,
    pub albedo: Vec<f32>,
    pub roughness: Vec<f32>,
    pub environment: Vec<f32>,
    pub target: Vec<f32>,
}

impl Data {
    pub fn new() -> Self {
        let weight = numbers(4, SAMPLES, 0.0, 1.0);
        let texel = numbers(6, SAMPLES, 0.0, TEXELS as f32);
        Data {
            nl: numbers(1, SAMPLES, 0.05, 1.0),
            nh: numbers(2, SAMPLES, 0.5, 1.0),
            vh5: numbers(3, SAMPLES, 0.0, 0.3),
            weight: weight
                .iter()
                .map(|&w| if w < 0.3 { 0.0 } else { 1.0 + w })
                .collect(),
            nv: numbers(5, PIXELS, 0.2, 1.0),
            texel: texel
                .iter()
                .map(|&t| (t as u32).min(TEXELS as u32 - 1))
                .collect(),
            albedo: numbers(7, 3 * PIXELS, 0.1, 0.9),
            roughness: numbers(8, PIXELS, 0.2, 0.9),
            environment: numbers(9, 3 * TEXELS, 0.0, 2.0),
            target: numbers(10, 3 * PIXELS, 0.0, 1.0),
        }
    }
}

pub fn record() -> Program {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
    let sample = g.segments("sample", &pixel);
    let albedo = g.param("albedo", &pixel, 3);
    let roughness = g.param("roughness", &pixel, 1);
    let environment = g.param("environment", &texel, 3);
    let nv = g.input("nv", &pixel, 1);
    let target = g.input("target", &pixel, 3);
    let (nl, nh) = (g.input("nl", &sample, 1), g.input("nh", &sample, 1));
    let (vh5, weight) = (g.input("vh5", &sample, 1), g.input("weight", &sample, 1));
    let index = g.index("texel", &sample, &texel);

    // Per pixel: what does not depend on the sample.
    let a2 = roughness.square().square();
    let m = &a2 - 1.0;
    let view = &nv + (&a2 - &m * nv.square()).sqrt();
    let scale = &a2 / (view * std::f64::consts::PI);
    let diffuse = albedo * std::f64::consts::FRAC_1_PI;
    // Per sample.
    let (a2, m) = (a2.expand(&sample), m.expand(&sample));
    let d = nh.square() * &m + 1.0;
    let light = &nl + (&a2 - &m * nl.square()).sqrt();
    let specular = scale.expand(&sample) / (light * d.square()) * (vh5 * 0.96 + 0.04);
    let radiance = environment.gather(&index) * (nl * weight);
    let shaded = (diffuse.expand(&sample) + specular) * radiance;
    let loss = (shaded.segment_mean() - target).square().sum();
    g.compile(&[("loss", &loss)]).expect("a sound graph")
}

pub fn bind(program: &Program, data: &Data) -> Workspace<f32> {
    let sizes = Sizes::new()
        .lanes("pixel", PIXELS)
        .lanes("texel", TEXELS)
        .per_parent("sample", PER_PIXEL);
    let sizes = match std::env::var("BLOCK").ok().and_then(|b| b.parse().ok()) {
        Some(block) => sizes.block(block),
        None => sizes,
    };
    let mut ws = program.workspace::<f32>(&sizes).expect("sound sizes");
    let arrays = [
        ("nl", &data.nl),
        ("nh", &data.nh),
        ("vh5", &data.vh5),
        ("weight", &data.weight),
        ("nv", &data.nv),
        ("albedo", &data.albedo),
        ("roughness", &data.roughness),
        ("environment", &data.environment),
        ("target", &data.target),
    ];
    for (name, array) in arrays {
        ws.bind(name, Arc::from(&array[..])).expect("a sound array");
    }
    ws.set_index("texel", &data.texel).expect("a sound index");
    ws
}

pub fn run() {
    let data = Data::new();
    let program = record();
    let mut ws = bind(&program, &data);
    let mut hand = Hand::new(&data);
    agree(&program, &mut ws, &mut hand, &data);

    let mut second = hand.clone();
    let mut other = bind(&program, &data);
    let albedo = data.albedo.clone();
    let direction: [(&str, &[f32]); 3] = [
        ("albedo", &albedo),
        ("roughness", &data.roughness),
        ("environment", &data.environment),
    ];
    let mut third = bind(&program, &data);
    let [hand_primal, hand_gradient, primal, gradient, tangent] = best([
        &mut || {
            std::hint::black_box(second.primal(&data));
        },
        &mut || {
            std::hint::black_box(hand.gradient(&data));
        },
        &mut || program.forward(&mut ws).expect("a bound program"),
        &mut || {
            // What an optimiser does: new parameters, then value and gradient.
            other.set("albedo", &albedo).expect("a sound array");
            program.vjp(&mut other, "loss").expect("a bound program");
        },
        &mut || {
            program
                .jvp(&mut third, &direction)
                .expect("a bound program")
        },
    ]);
    println!("shading, {SAMPLES} samples (milliseconds; the hand-written one uses one thread)");
    println!("  hand: primal {hand_primal:.2}, gradient {hand_gradient:.2}");
    println!("  tape: primal {primal:.2}, gradient {gradient:.2}, tangent {tangent:.2}");
    println!(
        "  gradient/primal {:.2}, tape/hand gradient {:.2}, tape/hand primal {:.2}, tangent/primal {:.2}",
        gradient / primal,
        gradient / hand_gradient,
        primal / hand_primal,
        tangent / primal
    );
}

/// Panics unless the tape gives the loss and the gradients of the hand-written adjoint.
pub fn agree(program: &Program, ws: &mut Workspace<f32>, hand: &mut Hand, data: &Data) {
    let loss = hand.gradient(data);
    program.vjp(ws, "loss").expect("a bound program");
    check("loss", ws.output("loss").expect("an output"), &[loss]);
    check(
        "albedo",
        ws.gradient("albedo").expect("a gradient"),
        &hand.albedo,
    );
    check(
        "roughness",
        ws.gradient("roughness").expect("a gradient"),
        &hand.roughness,
    );
    let adjoint: Vec<f32> = (0..3)
        .flat_map(|c| hand.adjoint.iter().map(move |t| t[c]))
        .collect();
    check(
        "environment",
        ws.gradient("environment").expect("a gradient"),
        &adjoint,
    );
}

pub fn check(name: &str, got: &[f32], want: &[f32]) {
    let norm = want.iter().map(|x| x * x).sum::<f32>().sqrt();
    let error = got
        .iter()
        .zip(want)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f32>()
        .sqrt();
    assert!(
        error <= 3e-4 * norm,
        "{name}: differs from the hand-written one by {error} of {norm}"
    );
}
