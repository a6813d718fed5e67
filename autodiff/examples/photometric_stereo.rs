//! Photometric stereo on a sphere: normals and albedo of every pixel from pictures under known lights.
//!
//! `cargo run --release -p autodiff --example photometric_stereo -- [PICTURE.png]`
//!
//! Pictures lie along an inner axis, one element for each light. Shadows that the surface throws on itself are the kink of
//! `max(n . l, 0)`; normals are free vectors that the formula normalises.

mod common;

use autodiff::{Graph, Program, Sizes, Var};
use common::{Adam, Random, save};

const SIZE: usize = 64;
const LIGHTS: usize = 12;

fn record() -> Result<Program, autodiff::GraphError> {
    let g = Graph::new();
    let (pixel, light) = (g.domain("pixel"), g.axis("light"));
    let albedo = g.param("albedo", &pixel, 1);
    let normal = g.param("normal", &pixel, 3);
    let direction = g.input_along("direction", &g.uniform(), 3, &light);
    let pictures = g.input_along("pictures", &pixel, 1, &light);
    let cosine: Var = (normal.normalize() * &direction).sum_channels().relu();
    let residual = cosine * albedo - pictures;
    g.compile(&[("loss", &residual.square().sum())])
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The visible half of a sphere, with stripes.
    let mut seen = Vec::new();
    for y in 0..SIZE {
        for x in 0..SIZE {
            let (u, v) = (
                2.0 * (x as f32 + 0.5) / SIZE as f32 - 1.0,
                1.0 - 2.0 * (y as f32 + 0.5) / SIZE as f32,
            );
            let depth = 1.0 - u * u - v * v;
            if depth > 0.02 {
                let stripe = if ((u + v) * 6.0).sin() > 0.0 {
                    0.9
                } else {
                    0.4
                };
                seen.push((x, y, [u, v, depth.sqrt()], stripe));
            }
        }
    }
    let mut random = Random(3);
    let lights: Vec<[f32; 3]> = (0..LIGHTS)
        .map(|k| {
            let (angle, tilt) = (
                std::f32::consts::TAU * k as f32 / LIGHTS as f32,
                0.3 + 0.6 * random.next(),
            );
            [
                tilt.sin() * angle.cos(),
                tilt.sin() * angle.sin(),
                tilt.cos(),
            ]
        })
        .collect();
    let n = seen.len();
    let mut pictures = vec![0.0; n * LIGHTS];
    for (i, (_, _, normal, albedo)) in seen.iter().enumerate() {
        for (k, light) in lights.iter().enumerate() {
            let cosine: f32 = normal.iter().zip(light).map(|(a, b)| a * b).sum();
            let noise = 0.01 * (random.next() - 0.5);
            pictures[i * LIGHTS + k] = albedo * cosine.max(0.0) + noise;
        }
    }

    let program = record()?;
    let mut ws = program.workspace::<f32>(&Sizes::new().lanes("pixel", n).axis("light", LIGHTS))?;
    let directions: Vec<f32> = (0..3)
        .flat_map(|c| lights.iter().map(move |l| l[c]))
        .collect();
    ws.set("direction", &directions)?;
    ws.set("pictures", &pictures)?;
    let (mut albedo, mut normal) = (vec![0.5; n], [vec![0.0; 2 * n], vec![1.0; n]].concat());
    let (mut of_albedo, mut of_normal) = (Adam::new(n, 0.02), Adam::new(3 * n, 0.03));
    for step in 0..=500 {
        ws.set("albedo", &albedo)?;
        ws.set("normal", &normal)?;
        program.vjp(&mut ws, "loss")?;
        if step % 100 == 0 {
            println!("step {step}: loss {:.3e}", ws.output("loss")?[0]);
        }
        of_albedo.update(&mut albedo, ws.gradient("albedo")?);
        of_normal.update(&mut normal, ws.gradient("normal")?);
        of_albedo.rate *= 0.992;
        of_normal.rate *= 0.992;
    }

    let found = |i: usize| -> [f32; 3] {
        let v = [normal[i], normal[n + i], normal[2 * n + i]];
        let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
        v.map(|x| x / length)
    };
    let mut degrees: Vec<f32> = (0..n)
        .map(|i| {
            let cosine: f32 = found(i).iter().zip(seen[i].2).map(|(a, b)| a * b).sum();
            cosine.clamp(-1.0, 1.0).acos().to_degrees()
        })
        .collect();
    degrees.sort_by(f32::total_cmp);
    println!("normals: half of them within {:.2} degrees", degrees[n / 2]);
    assert!(degrees[n / 2] < 1.0, "the normals were not found");

    let mut at = vec![None; SIZE * SIZE];
    for (i, &(x, y, ..)) in seen.iter().enumerate() {
        at[y * SIZE + x] = Some(i);
    }
    let pixel =
        |x: usize, y: usize, of: &dyn Fn(usize) -> [f32; 3]| at[y * SIZE + x].map_or([0.0; 3], of);
    let path = save(
        "photometric_stereo.png",
        (SIZE, SIZE),
        4,
        &[
            &|x, y| pixel(x, y, &|i| [pictures[i * LIGHTS]; 3]),
            &|x, y| pixel(x, y, &|i| seen[i].2.map(|c| 0.5 + 0.5 * c)),
            &|x, y| pixel(x, y, &|i| found(i).map(|c| 0.5 + 0.5 * c)),
            &|x, y| pixel(x, y, &|i| [albedo[i]; 3]),
        ],
    )?;
    println!(
        "a picture, true normals, found normals, found albedo: {}",
        path.display()
    );
    Ok(())
}

#[test]
fn the_normals_are_found() {
    assert!(main().is_ok());
}
