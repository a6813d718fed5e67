//! A tiny Monte Carlo volume: what smoke dims these rays? Tomography by gradients through random samples.
//!
//! `cargo run --release -p autodiff --example volume -- [PICTURE.png]`
//!
//! Rays cross a square of smoke from many sides. The optical depth of a ray is estimated at a few random points on it, new ones
//! in each step: the points are detached, the density is looked up between four grid points, and the gradient of the estimate
//! is an unbiased estimate of the gradient. Two independent estimates in the loss keep their product unbiased, too.

mod common;

use autodiff::{Graph, Program, Sizes, Var, Workspace};
use common::{Adam, Random, save};

const GRID: usize = 24;
const VIEWS: usize = 24;
const RAYS: usize = 36;
const SAMPLES: usize = 12;

fn record() -> Result<Program, autodiff::GraphError> {
    let g = Graph::new();
    let (ray, cell) = (g.domain("ray"), g.domain("cell"));
    let sample = g.segments("sample", &ray);
    let density = g.param("density", &cell, 1);
    let measured = g.input("measured", &ray, 1);
    // Positive whatever the optimiser does.
    let positive = density.softplus();
    let depth = |which: &str| -> Var {
        let corner: Vec<_> = (0..4)
            .map(|k| g.index(&format!("{which} corner {k}"), &sample, &cell))
            .collect();
        let weight: Vec<_> = (0..4)
            .map(|k| g.input(&format!("{which} weight {k}"), &sample, 1))
            .collect();
        let corners: Vec<_> = corner.iter().zip(&weight).collect();
        positive.gather_weighted(&corners).segment_mean() * 2.0
    };
    let (first, second) = (depth("first"), depth("second"));
    let loss = ((first - &measured) * (second - &measured)).sum();
    g.compile(&[("loss", &loss)])
}

/// The smoke that is to be found: two puffs.
fn truth(x: f32, y: f32) -> f32 {
    let puff = |a: f32, b: f32, r: f32| (-((x - a).powi(2) + (y - b).powi(2)) / (r * r)).exp();
    1.5 * puff(-0.3, 0.25, 0.25) + puff(0.35, -0.3, 0.35)
}

/// A point on a ray, `t` in [-1, 1].
fn point(ray: usize, t: f32) -> (f32, f32) {
    let angle = std::f32::consts::PI * (ray / RAYS) as f32 / VIEWS as f32;
    let aside = 1.8 * ((ray % RAYS) as f32 + 0.5) / RAYS as f32 - 0.9;
    let (s, c) = angle.sin_cos();
    (aside * c - t * s, aside * s + t * c)
}

/// New random points on all rays, and their places in the grid.
fn sample(
    ws: &mut Workspace<f32>,
    which: &str,
    random: &mut Random,
) -> Result<(), autodiff::RunError> {
    let (mut corners, mut weights) = (vec![Vec::new(); 4], vec![Vec::new(); 4]);
    for ray in 0..VIEWS * RAYS {
        for s in 0..SAMPLES {
            let (x, y) = point(ray, 2.0 * (s as f32 + random.next()) / SAMPLES as f32 - 1.0);
            let place =
                |x: f32| ((x + 1.0) * 0.5 * (GRID - 1) as f32).clamp(0.0, GRID as f32 - 1.001);
            let (u, v) = (place(x), place(y));
            let outside = x.abs() > 1.0 || y.abs() > 1.0;
            for k in 0..4 {
                let (dx, dy) = (k % 2, k / 2);
                corners[k].push(((v as usize + dy) * GRID + u as usize + dx) as u32);
                let along = |at: f32, d: usize| if d == 1 { at.fract() } else { 1.0 - at.fract() };
                weights[k].push(if outside {
                    0.0
                } else {
                    along(u, dx) * along(v, dy)
                });
            }
        }
    }
    for k in 0..4 {
        ws.set_index(&format!("{which} corner {k}"), &corners[k])?;
        ws.set(&format!("{which} weight {k}"), &weights[k])?;
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let program = record()?;
    let sizes = Sizes::new()
        .lanes("ray", VIEWS * RAYS)
        .lanes("cell", GRID * GRID)
        .per_parent("sample", SAMPLES);
    let mut ws = program.workspace::<f32>(&sizes)?;
    let measured: Vec<f32> = (0..VIEWS * RAYS)
        .map(|ray| {
            let steps = 400;
            let at = |k: usize| point(ray, 2.0 * (k as f32 + 0.5) / steps as f32 - 1.0);
            let inside = |(x, y): (f32, f32)| {
                if x.abs() > 1.0 || y.abs() > 1.0 {
                    0.0
                } else {
                    truth(x, y)
                }
            };
            (0..steps).map(|k| inside(at(k))).sum::<f32>() * 2.0 / steps as f32
        })
        .collect();
    ws.set("measured", &measured)?;
    let mut density = vec![-3.0; GRID * GRID];
    let steps = 600;
    let mut adam = Adam::new(density.len(), 0.05);
    let mut random = Random(11);
    for step in 0..=steps {
        sample(&mut ws, "first", &mut random)?;
        sample(&mut ws, "second", &mut random)?;
        ws.set("density", &density)?;
        program.vjp(&mut ws, "loss")?;
        if step % 100 == 0 {
            println!("step {step}: loss {:.3}", ws.output("loss")?[0]);
        }
        adam.update(&mut density, ws.gradient("density")?);
        adam.rate *= 0.995;
    }

    let found: Vec<f32> = density.iter().map(|x| x.exp().ln_1p()).collect();
    let place = |i: usize| 2.0 * i as f32 / (GRID - 1) as f32 - 1.0;
    let (mut error, mut norm) = (0.0, 0.0);
    for y in 0..GRID {
        for x in 0..GRID {
            let wanted = truth(place(x), place(y));
            // Corners of the square that no ray crosses are not known.
            if place(x).hypot(place(y)) < 0.85 {
                error += (found[y * GRID + x] - wanted).powi(2);
                norm += wanted * wanted;
            }
        }
    }
    println!("relative error of the smoke: {:.3}", (error / norm).sqrt());
    assert!((error / norm).sqrt() < 0.25, "the smoke was not found");
    let path = save(
        "volume.png",
        (GRID, GRID),
        10,
        &[
            &|x, y| [0.6 * truth(place(x), place(GRID - 1 - y)); 3],
            &|x, y| [0.6 * found[(GRID - 1 - y) * GRID + x]; 3],
        ],
    )?;
    println!("true and found smoke: {}", path.display());
    Ok(())
}

#[test]
fn the_smoke_is_found() {
    assert!(main().is_ok());
}
