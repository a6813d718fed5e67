//! 1,048,576 GGX samples of 16,384 pixels, an environment table of 8,192 x 3, squared loss.

use std::f32::consts::PI;
use std::sync::Arc;

use autodiff::{Graph, Program, Sizes, Workspace};

use crate::{best, numbers};

const PIXELS: usize = 16_384;
const PER_PIXEL: usize = 64;
const SAMPLES: usize = PIXELS * PER_PIXEL;
const TEXELS: usize = 8_192;

struct Data {
    nl: Vec<f32>,
    nh: Vec<f32>,
    vh5: Vec<f32>,
    weight: Vec<f32>,
    nv: Vec<f32>,
    texel: Vec<u32>,
    albedo: Vec<f32>,
    roughness: Vec<f32>,
    environment: Vec<f32>,
    target: Vec<f32>,
}

impl Data {
    fn new() -> Self {
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

fn record() -> Program {
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

fn bind(program: &Program, data: &Data) -> Workspace<f32> {
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

/// Loss and gradients by hand: one pass over the samples of a pixel computes the image, another the adjoints. Tables are
/// interleaved and padded to four channels, loops over the samples of a pixel are straight-line and vectorise.
struct Hand {
    environment: Vec<[f32; 4]>,
    adjoint: Vec<[f32; 4]>,
    albedo: Vec<f32>,
    roughness: Vec<f32>,
}

#[derive(Clone, Copy)]
struct Pixel {
    a2: f32,
    m: f32,
    scale: f32,
}

impl Hand {
    fn pixel(data: &Data, p: usize) -> (Pixel, f32, f32) {
        let r = data.roughness[p];
        let a2 = r * r * r * r;
        let m = a2 - 1.0;
        let nv = data.nv[p];
        let root = (a2 - m * nv * nv).sqrt();
        let view = nv + root;
        let scale = a2 / (view * PI);
        // d scale / d a2, and d a2 / d r.
        let slope = 1.0 / (view * PI) - scale / view * (1.0 - nv * nv) / (2.0 * root);
        (Pixel { a2, m, scale }, slope, 4.0 * r * r * r)
    }

    #[inline(always)]
    fn image(
        &self,
        data: &Data,
        p: usize,
        pixel: Pixel,
        specular: &mut [f32; PER_PIXEL],
        radiance: &mut [[f32; PER_PIXEL]; 3],
    ) -> [f32; 3] {
        let at = p * PER_PIXEL..(p + 1) * PER_PIXEL;
        let (nl, nh) = (&data.nl[at.clone()], &data.nh[at.clone()]);
        let (vh5, weight) = (&data.vh5[at.clone()], &data.weight[at.clone()]);
        for (s, &t) in data.texel[at].iter().enumerate() {
            let texel = self.environment[t as usize];
            for c in 0..3 {
                radiance[c][s] = texel[c];
            }
        }
        let mut sums = [[0.0f32; 16]; 3];
        for s in 0..PER_PIXEL {
            let d = nh[s] * nh[s] * pixel.m + 1.0;
            let light = nl[s] + (pixel.a2 - pixel.m * nl[s] * nl[s]).sqrt();
            specular[s] = pixel.scale / (light * d * d) * (vh5[s] * 0.96 + 0.04);
        }
        for c in 0..3 {
            let diffuse = data.albedo[c * PIXELS + p] * (1.0 / PI);
            for s in 0..PER_PIXEL {
                radiance[c][s] *= nl[s] * weight[s];
                sums[c][s % 16] += (diffuse + specular[s]) * radiance[c][s];
            }
        }
        std::array::from_fn(|c| {
            let mean = sums[c].iter().sum::<f32>() / PER_PIXEL as f32;
            mean - data.target[c * PIXELS + p]
        })
    }

    #[inline(always)]
    fn primal(&self, data: &Data) -> f32 {
        let (mut specular, mut radiance) = ([0.0; PER_PIXEL], [[0.0; PER_PIXEL]; 3]);
        (0..PIXELS)
            .map(|p| {
                let (pixel, _, _) = Self::pixel(data, p);
                let e = self.image(data, p, pixel, &mut specular, &mut radiance);
                e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
            })
            .sum()
    }

    #[inline(always)]
    fn gradient(&mut self, data: &Data) -> f32 {
        self.adjoint.fill([0.0; 4]);
        let (mut specular, mut radiance) = ([0.0; PER_PIXEL], [[0.0; PER_PIXEL]; 3]);
        let mut to_table = [[0.0f32; 4]; PER_PIXEL];
        let mut loss = 0.0;
        for p in 0..PIXELS {
            let (pixel, slope, to_roughness) = Self::pixel(data, p);
            let e = self.image(data, p, pixel, &mut specular, &mut radiance);
            loss += e[0] * e[0] + e[1] * e[1] + e[2] * e[2];
            let g: [f32; 3] = e.map(|e| 2.0 * e / PER_PIXEL as f32);
            let at = p * PER_PIXEL..(p + 1) * PER_PIXEL;
            let (nl, nh) = (&data.nl[at.clone()], &data.nh[at.clone()]);
            let weight = &data.weight[at.clone()];
            let diffuse: [f32; 3] =
                std::array::from_fn(|c| data.albedo[c * PIXELS + p] * (1.0 / PI));
            let (mut to_a2, mut to_scale) = ([0.0f32; 16], [0.0f32; 16]);
            let mut to_diffuse = [[0.0f32; 16]; 3];
            for s in 0..PER_PIXEL {
                let l: [f32; 3] = std::array::from_fn(|c| radiance[c][s]);
                let k = nl[s] * weight[s];
                let mut to_specular = 0.0;
                for c in 0..3 {
                    to_diffuse[c][s % 16] += g[c] * l[c];
                    to_specular += g[c] * l[c];
                    to_table[s][c] = g[c] * (diffuse[c] + specular[s]) * k;
                }
                let d = nh[s] * nh[s] * pixel.m + 1.0;
                let root = (pixel.a2 - pixel.m * nl[s] * nl[s]).sqrt();
                let both = to_specular * specular[s];
                to_scale[s % 16] += both;
                let to_light = -both / (nl[s] + root);
                let to_d = -2.0 * both / d;
                to_a2[s % 16] +=
                    to_d * nh[s] * nh[s] + to_light * (1.0 - nl[s] * nl[s]) / (2.0 * root);
            }
            for (s, &t) in data.texel[at].iter().enumerate() {
                let adjoint = &mut self.adjoint[t as usize];
                for c in 0..4 {
                    adjoint[c] += to_table[s][c];
                }
            }
            let to_scale = to_scale.iter().sum::<f32>() / pixel.scale;
            let to_a2 = to_a2.iter().sum::<f32>() + to_scale * slope;
            self.roughness[p] = to_a2 * to_roughness;
            for c in 0..3 {
                self.albedo[c * PIXELS + p] = to_diffuse[c].iter().sum::<f32>() * (1.0 / PI);
            }
        }
        loss
    }
}

pub fn run() {
    let data = Data::new();
    let program = record();
    let mut ws = bind(&program, &data);
    let mut hand = Hand {
        environment: (0..TEXELS)
            .map(|t| {
                let channel = |c: usize| data.environment[c * TEXELS + t];
                [channel(0), channel(1), channel(2), 0.0]
            })
            .collect(),
        adjoint: vec![[0.0; 4]; TEXELS],
        albedo: vec![0.0; 3 * PIXELS],
        roughness: vec![0.0; PIXELS],
    };
    let arch = pulp::Arch::new();
    let loss = arch.dispatch(|| hand.gradient(&data));
    program.vjp(&mut ws, "loss").expect("a bound program");
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

    let mut second = Hand {
        environment: hand.environment.clone(),
        adjoint: Vec::new(),
        albedo: Vec::new(),
        roughness: Vec::new(),
    };
    second.adjoint.clear();
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
            std::hint::black_box(arch.dispatch(|| second.primal(&data)));
        },
        &mut || {
            std::hint::black_box(arch.dispatch(|| hand.gradient(&data)));
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

fn check(name: &str, got: &[f32], want: &[f32]) {
    let norm = want.iter().map(|x| x * x).sum::<f32>().sqrt();
    let error = got
        .iter()
        .zip(want)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f32>()
        .sqrt();
    assert!(
        error <= 1e-4 * norm,
        "{name}: differs from the hand-written one by {error} of {norm}"
    );
}
