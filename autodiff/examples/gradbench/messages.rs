//! Messages of the suite's protocol and what is answered.

use std::time::Instant;

use autodiff::{Graph, Sizes};
use serde_json::{Map, Value, json};

use crate::{ba, gmm};

type Failure = Box<dyn std::error::Error>;

/// The response to a message.
pub fn answer(message: &Value) -> Value {
    let mut response = match message["kind"].as_str() {
        Some("start") => json!({ "tool": "autodiff" }),
        Some("define") => {
            let known = ["hello", "gmm", "ba"]
                .iter()
                .any(|m| message["module"] == *m);
            json!({ "success": known })
        }
        Some("evaluate") => evaluate(message)
            .unwrap_or_else(|error| json!({ "success": false, "error": error.to_string() })),
        _ => json!({}),
    };
    response["id"] = message["id"].clone();
    response
}

fn evaluate(message: &Value) -> Result<Value, Failure> {
    let input = &message["input"];
    let function = message["function"].as_str().unwrap_or_default();
    match (message["module"].as_str().unwrap_or_default(), function) {
        ("hello", "square") => hello(input, false),
        ("hello", "double") => hello(input, true),
        ("gmm", "objective") => {
            let mut gmm = gmm::Gmm::new(gmm_input(input)?)?;
            timed(input, || Ok(gmm.objective()?), |value| json!(value))
        }
        ("gmm", "jacobian") => {
            let mut gmm = gmm::Gmm::new(gmm_input(input)?)?;
            timed(
                input,
                || Ok(gmm.gradient()?),
                |g| json!({ "alpha": g.alpha, "mu": g.mu, "q": g.q, "l": g.l }),
            )
        }
        ("ba", "objective") => {
            let mut ba = ba::Ba::new(ba_input(input)?)?;
            timed(
                input,
                || Ok(ba.objective()?),
                |(residual, weight)| {
                    json!({
                        "reproj_error": { "elements": residual[0], "repeated": residual.len() },
                        "w_err": { "element": weight[0], "repeated": weight.len() },
                    })
                },
            )
        }
        ("ba", "jacobian") => {
            let given = ba_input(input)?;
            let sizes = (given.cameras.len(), given.points.len());
            let seen = given.seen.clone();
            let mut ba = ba::Ba::new(given)?;
            timed(
                input,
                || Ok(ba.jacobian()?),
                |blocks| sparse(blocks, &seen, sizes),
            )
        }
        (module, function) => Err(format!("`{function}` of `{module}` is not known").into()),
    }
}

/// Runs as often and as long as asked, with one timing each.
fn timed<T>(
    input: &Value,
    mut run: impl FnMut() -> Result<T, Failure>,
    show: impl Fn(&T) -> Value,
) -> Result<Value, Failure> {
    let number = |name: &str, otherwise: f64| input[name].as_f64().unwrap_or(otherwise);
    let (runs, seconds) = (
        number("min_runs", number("runs", 1.0)),
        number("min_seconds", 0.0),
    );
    let (mut timings, mut spent) = (Vec::new(), 0.0);
    loop {
        let start = Instant::now();
        let result = run()?;
        let elapsed = start.elapsed();
        spent += elapsed.as_secs_f64();
        timings.push(json!({ "name": "evaluate", "nanoseconds": elapsed.as_nanos() as u64 }));
        if timings.len() as f64 >= runs && spent >= seconds {
            let output = show(&result);
            return Ok(json!({ "success": true, "output": output, "timings": timings }));
        }
    }
}

/// The square of a number, or its derivative.
fn hello(input: &Value, derivative: bool) -> Result<Value, Failure> {
    let x = input.as_f64().ok_or("a number is wanted")?;
    let g = Graph::new();
    let program = g.compile(&[("y", &g.param("x", &g.uniform(), 1).square())])?;
    let mut ws = program.workspace::<f64>(&Sizes::new())?;
    let nothing = Value::Object(Map::new());
    let run = || {
        ws.set("x", &[x])?;
        program.vjp(&mut ws, "y")?;
        Ok(match derivative {
            true => ws.gradient("x")?[0],
            false => ws.output("y")?[0],
        })
    };
    timed(&nothing, run, |y| json!(y))
}

fn gmm_input(input: &Value) -> Result<gmm::Input, Failure> {
    Ok(gmm::Input {
        alpha: vector(input, "alpha")?,
        mu: matrix(input, "mu")?,
        q: matrix(input, "q")?,
        l: matrix(input, "l")?,
        x: matrix(input, "x")?,
        gamma: input["gamma"].as_f64().ok_or("`gamma` is missing")?,
        m: input["m"].as_u64().ok_or("`m` is missing")? as usize,
    })
}

/// One camera, point, weight and feature, repeated; observations go round both.
fn ba_input(input: &Value) -> Result<ba::Input, Failure> {
    let count = |name: &str| match input[name].as_u64() {
        Some(n) if n > 0 => Ok(n as usize),
        _ => Err(format!("`{name}` must be a positive number")),
    };
    let (n, m, p) = (count("n")?, count("m")?, count("p")?);
    let wrong = |_| "an array of the wrong length";
    let camera: [f64; ba::CAMERA] = vector(input, "cam")?.try_into().map_err(wrong)?;
    let point: [f64; 3] = vector(input, "x")?.try_into().map_err(wrong)?;
    let feature: [f64; 2] = vector(input, "feat")?.try_into().map_err(wrong)?;
    Ok(ba::Input {
        cameras: vec![camera; n],
        points: vec![point; m],
        weights: vec![input["w"].as_f64().ok_or("`w` is missing")?; p],
        features: vec![feature; p],
        seen: (0..p).map(|i| (i % n, i % m)).collect(),
    })
}

/// The Jacobian in compressed rows, shortened as the suite wants it: the first observation's entries, and the last entry.
fn sparse(blocks: &[ba::Block], seen: &[(usize, usize)], (n, m): (usize, usize)) -> Value {
    let (mut rows, mut cols, mut vals) = (vec![0usize], Vec::new(), Vec::new());
    let (points, weights) = (ba::CAMERA * n, ba::CAMERA * n + 3 * m);
    for (i, (block, &(camera, point))) in blocks.iter().zip(seen).enumerate() {
        for row in &block.rows {
            rows.push(rows[rows.len() - 1] + row.len());
            cols.extend((0..ba::CAMERA).map(|c| ba::CAMERA * camera + c));
            cols.extend((0..3).map(|c| points + 3 * point + c));
            cols.push(weights + i);
            vals.extend_from_slice(row);
        }
    }
    for (i, block) in blocks.iter().enumerate() {
        rows.push(rows[rows.len() - 1] + 1);
        cols.push(weights + i);
        vals.push(block.weight);
    }
    json!({ "rows": shortened(&rows), "cols": shortened(&cols), "vals": shortened(&vals) })
}

fn shortened<T: Copy>(all: &[T]) -> Vec<T> {
    let first = 2 * (ba::CAMERA + 4);
    all.iter().take(first).chain(all.last()).copied().collect()
}

fn vector(input: &Value, name: &str) -> Result<Vec<f64>, Failure> {
    numbers(&input[name]).ok_or_else(|| format!("`{name}` must be an array of numbers").into())
}

fn matrix(input: &Value, name: &str) -> Result<Vec<Vec<f64>>, Failure> {
    let rows = input[name]
        .as_array()
        .map(|rows| rows.iter().map(numbers).collect());
    rows.flatten()
        .ok_or_else(|| format!("`{name}` must be an array of rows").into())
}

fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}
