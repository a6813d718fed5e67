//! A soft shadow in two dimensions: where is the disc, and how large, that throws this shadow on the floor?
//!
//! `cargo run --release -p autodiff --example soft_shadow -- [PICTURE.png]`
//!
//! A floor is lit by a line of light above it. Visibility jumps where the disc begins to hide the light, and a jump has no
//! derivative to sample: the disc's edge is softened by a twentieth of its size instead, which biases the shadow a little and
//! lets the gradient through. Positions on the light are samples: detached.

mod common;

use autodiff::{Graph, Program, Sizes, Workspace};
use common::{Adam, Random, save};

const PIXELS: usize = 160;
const SAMPLES: usize = 64;

/// Centre and radius.
type Disc = [f32; 3];

fn record() -> Result<Program, autodiff::GraphError> {
    let g = Graph::new();
    let pixel = g.domain("pixel");
    let sample = g.segments("sample", &pixel);
    let disc = g.param("disc", &g.uniform(), 3);
    let floor = g.input("floor", &pixel, 1);
    let light = g.input("light", &sample, 1);
    let target = g.input("target", &pixel, 1);
    // The ray from (floor, 0) to (light, 2), and the disc's distance from its line.
    let across = light - floor.expand(&sample);
    let length = (across.square() + 4.0).sqrt();
    let aside = disc.channel(0) - floor.expand(&sample);
    let distance = (aside * 2.0 - disc.channel(1) * &across).abs() / &length;
    let visible = ((distance - disc.channel(2)) * 40.0).sigmoid();
    // Light falls off with the angle at both ends and the square of the distance.
    let falloff = 16.0 / length.square().square();
    let lit = (visible * falloff).segment_mean().label("lit");
    let loss = (&lit - target).square().sum();
    g.compile(&[("loss", &loss), ("lit", &lit)])
}

fn bind(program: &Program) -> Result<Workspace<f32>, autodiff::RunError> {
    let sizes = Sizes::new()
        .lanes("pixel", PIXELS)
        .per_parent("sample", SAMPLES);
    let mut ws = program.workspace::<f32>(&sizes)?;
    let floor: Vec<f32> = (0..PIXELS)
        .map(|i| 4.0 * (i as f32 + 0.5) / PIXELS as f32 - 2.0)
        .collect();
    ws.set("floor", &floor)?;
    let mut random = Random(7);
    let light = (0..PIXELS * SAMPLES).map(|i| {
        // One in each stratum of the light, which reaches from -0.5 to 0.5.
        ((i % SAMPLES) as f32 + random.next()) / SAMPLES as f32 - 0.5
    });
    ws.set("light", &light.collect::<Vec<_>>())?;
    ws.set("target", &[0.0; PIXELS])?;
    Ok(ws)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let program = record()?;
    let mut ws = bind(&program)?;
    let lit = |ws: &mut Workspace<f32>, disc: &Disc| -> Result<Vec<f32>, autodiff::RunError> {
        ws.set("disc", disc)?;
        program.forward(ws)?;
        Ok(ws.output("lit")?.to_vec())
    };
    let truth: Disc = [0.4, 1.1, 0.3];
    let target = lit(&mut ws, &truth)?;
    let mut disc: Disc = [0.1, 0.9, 0.2];
    let start = lit(&mut ws, &disc)?;
    ws.set("target", &target)?;
    let mut adam = Adam::new(3, 0.01);
    for step in 0..=1600 {
        ws.set("disc", &disc)?;
        program.vjp(&mut ws, "loss")?;
        if step % 400 == 0 {
            println!(
                "step {step}: loss {:.2e}, disc {disc:?}",
                ws.output("loss")?[0]
            );
        }
        adam.update(&mut disc, ws.gradient("disc")?);
        adam.rate *= 0.998;
    }
    let fit = lit(&mut ws, &disc)?;
    let error = disc
        .iter()
        .zip(truth)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    println!("the disc {disc:?} is within {error:.4} of {truth:?}");
    assert!(error < 0.02, "the disc was not found");

    // Above the floor's light: the scene itself.
    let scene = |disc: Disc, lit: &[f32], x: usize, y: usize| {
        let (height, middle) = (80 - y as i32, x as f32 / PIXELS as f32 * 4.0 - 2.0);
        if height <= 8 {
            return [lit[x]; 3];
        }
        let up = height as f32 * 4.0 / PIXELS as f32;
        let inside = (middle - disc[0]).hypot(up - disc[1]) < disc[2];
        let light = middle.abs() < 0.5 && (up - 1.95).abs() < 0.04;
        match (light, inside) {
            (true, _) => [1.0, 0.9, 0.5],
            (_, true) => [0.6, 0.2, 0.1],
            _ => [0.02, 0.02, 0.03],
        }
    };
    let path = save(
        "soft_shadow.png",
        (PIXELS, 80),
        3,
        &[
            &|x, y| scene([0.1, 0.9, 0.2], &start, x, y),
            &|x, y| scene(disc, &fit, x, y),
            &|x, y| scene(truth, &target, x, y),
        ],
    )?;
    println!("start, fit and truth: {}", path.display());
    Ok(())
}

#[test]
fn the_disc_is_found() {
    assert!(main().is_ok());
}
