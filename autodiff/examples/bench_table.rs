//! The table of this engine's speed against a hand-written adjoint and against other engines, from one interleaved run.
//!
//! `cargo run --release -p autodiff --example bench_table -- [--json] [--peers DIR]`
//!
//! `DIR` holds `kernel.py`, the shading kernel in other engines, which prints `NAME ... grad MILLISECONDS`; the interpreter is
//! that of the environment variable PYTHON, or `python3`. What is not installed there is left out. Times are of one thread and
//! its own processor time, except where threads are compared; trust ratios, not milliseconds.

#[path = "../benches/kernels/hand.rs"]
mod hand;
#[path = "../benches/kernels/mlp.rs"]
mod mlp;
#[path = "../benches/kernels/shading.rs"]
#[allow(dead_code)]
mod shading;
#[path = "../benches/kernels/timing.rs"]
mod timing;

#[path = "gradbench/ba.rs"]
#[allow(dead_code)]
mod ba;
#[path = "gradbench/gmm.rs"]
#[allow(dead_code)]
mod gmm;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use serde_json::{Map, Value, json};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let (mut as_json, mut peers) = (false, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--json" => as_json = true,
            "--peers" => {
                peers = Some(PathBuf::from(
                    arguments.next().ok_or("--peers wants a folder")?,
                ))
            }
            other => return Err(format!("unknown argument `{other}`").into()),
        }
    }
    let mut table = Map::new();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let two = rayon::ThreadPoolBuilder::new().num_threads(2).build()?;
    one.install(|| own(&mut table));
    scaling(&mut table, &one, &two);
    if let Some(peers) = peers {
        one.install(|| against_peers(&mut table, &peers));
    }
    if as_json {
        println!("{}", serde_json::to_string_pretty(&Value::Object(table))?);
    } else {
        for (name, value) in &table {
            println!("{name:<24} {value}");
        }
    }
    Ok(())
}

/// Rounded, so that the table reads well.
fn put(table: &mut Map<String, Value>, name: &str, value: f64) {
    table.insert(name.to_string(), json!((value * 1000.0).round() / 1000.0));
}

/// What one thread does, all in turn.
fn own(table: &mut Map<String, Value>) {
    let data = shading::Data::new();
    let program = shading::record();
    let (mut primal, mut gradient) = (
        shading::bind(&program, &data),
        shading::bind(&program, &data),
    );
    let mut by_hand = hand::Hand::new(&data);
    let mut by_hand_too = by_hand.clone();
    let network = mlp::record();
    let mut network_ws = mlp::bind(&network);
    let mut mixture = gmm::Gmm::new(mixture()).expect("a sound graph");
    let mut bundle = ba::Ba::new(bundle()).expect("a sound graph");
    let [
        hand_primal,
        hand_gradient,
        primal,
        gradient,
        mlp_ms,
        gmm_ms,
        ba_ms,
    ] = timing::best([
        &mut || {
            std::hint::black_box(by_hand.primal(&data));
        },
        &mut || {
            std::hint::black_box(by_hand_too.gradient(&data));
        },
        &mut || program.forward(&mut primal).expect("a bound program"),
        &mut || {
            // What an optimiser does: new parameters, then value and gradient.
            gradient.set("albedo", &data.albedo).expect("a sound array");
            program.vjp(&mut gradient, "loss").expect("a bound program");
        },
        &mut || mlp::step(&network, &mut network_ws, &[0.0; 3]),
        &mut || {
            std::hint::black_box(mixture.gradient().expect("a bound program"));
        },
        &mut || {
            std::hint::black_box(bundle.jacobian().expect("a bound program"));
        },
    ]);
    put(table, "hand_primal_ms", hand_primal);
    put(table, "hand_gradient_ms", hand_gradient);
    put(table, "primal_ms", primal);
    put(table, "gradient_ms", gradient);
    put(table, "gradient_over_primal", gradient / primal);
    put(table, "tape_over_hand", gradient / hand_gradient);
    put(table, "mlp_ms", mlp_ms);
    put(table, "gmm_ms", gmm_ms);
    put(table, "ba_ms", ba_ms);
}

/// Wall time of gradients on one thread, on two, and of two threads with work of their own each, in turn. The last says what
/// the machine has to give: cores of a shared host may be two halves of one.
fn scaling(table: &mut Map<String, Value>, one: &rayon::ThreadPool, two: &rayon::ThreadPool) {
    let data = shading::Data::new();
    let program = shading::record();
    let bind = |pool: &rayon::ThreadPool| pool.install(|| shading::bind(&program, &data));
    let run = |pool: &rayon::ThreadPool, ws: &mut autodiff::Workspace<f32>| {
        pool.install(|| {
            for _ in 0..4 {
                ws.set("albedo", &data.albedo).expect("a sound array");
                program.vjp(ws, "loss").expect("a bound program");
            }
        })
    };
    let another = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let another = another.expect("a thread");
    let (mut alone, mut both, mut beside) = (bind(one), bind(two), bind(&another));
    let mut best = [f64::INFINITY; 3];
    for _ in 0..25 {
        let mut time = |at: usize, work: &mut dyn FnMut()| {
            let start = Instant::now();
            work();
            best[at] = best[at].min(start.elapsed().as_secs_f64());
        };
        time(0, &mut || run(one, &mut alone));
        time(1, &mut || run(two, &mut both));
        time(2, &mut || {
            std::thread::scope(|scope| {
                scope.spawn(|| run(&another, &mut beside));
                run(one, &mut alone);
            })
        });
    }
    put(table, "threads_2_over_1", best[0] / best[1]);
    put(table, "threads_2_over_1_apart", 2.0 * best[0] / best[2]);
}

/// Each peer between two measurements of our own.
fn against_peers(table: &mut Map<String, Value>, folder: &Path) {
    let data = shading::Data::new();
    let program = shading::record();
    let mut ws = shading::bind(&program, &data);
    let network = mlp::record();
    let mut network_ws = mlp::bind(&network);
    let mut tape = || {
        let [gradient, mlp] = timing::best([
            &mut || {
                ws.set("albedo", &data.albedo).expect("a sound array");
                program.vjp(&mut ws, "loss").expect("a bound program");
            },
            &mut || mlp::step(&network, &mut network_ws, &[0.0; 3]),
        ]);
        (gradient, mlp)
    };
    let mlp_script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/kernels/mlp.py");
    let (texels, threads) = (shading::TEXELS.to_string(), "1".to_string());
    let mut before = tape();
    for peer in ["drjit", "jax", "torch"] {
        let found = python(&folder.join("kernel.py"), &[peer, &texels, &threads]);
        let after = tape();
        if let Some(ms) = found {
            put(table, &format!("{peer}_gradient_ms"), ms);
            put(
                table,
                &format!("peer_over_tape_{peer}"),
                ms / before.0.min(after.0),
            );
        }
        before = after;
    }
    let found = python(&mlp_script, &[&threads]);
    let after = tape();
    if let Some(ms) = found {
        put(table, "torch_mlp_ms", ms);
        put(table, "peer_over_tape_mlp", ms / before.1.min(after.1));
    }
}

/// The smallest number after `grad` that a script prints, or nothing if it cannot run.
fn python(script: &Path, arguments: &[&str]) -> Option<f64> {
    let interpreter = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_string());
    let output = Command::new(interpreter)
        .arg(script)
        .args(arguments)
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let numbers = text.lines().filter_map(|line| {
        let (_, rest) = line.split_once("grad ")?;
        rest.split_whitespace().next()?.parse::<f64>().ok()
    });
    let best = numbers.fold(f64::INFINITY, f64::min);
    if best.is_finite() {
        Some(best)
    } else {
        eprintln!("{} {}: not measured", script.display(), arguments.join(" "));
        None
    }
}

/// A mixture of 25 components in 10 dimensions, 1,000 points.
fn mixture() -> gmm::Input {
    let (d, k, n) = (10, 25, 1000);
    let matrix = |seed: u64, rows: usize, columns: usize| -> Vec<Vec<f64>> {
        let all = timing::numbers(seed, rows * columns, -1.0, 1.0);
        all.chunks(columns.max(1))
            .map(|row| row.iter().map(|&x| x as f64).collect())
            .collect()
    };
    gmm::Input {
        alpha: matrix(1, 1, k).concat(),
        mu: matrix(2, k, d),
        q: matrix(3, k, d),
        l: matrix(4, k, d * (d - 1) / 2),
        x: matrix(5, n, d),
        gamma: 1.0,
        m: 0,
    }
}

/// 10,000 observations of 500 points by 20 cameras.
fn bundle() -> ba::Input {
    let (n, m, p) = (20, 500, 10_000);
    ba::Input {
        cameras: vec![
            [
                0.1, -0.2, 0.3, 0.5, -0.1, -4.0, 800.0, 320.0, 240.0, 0.01, -0.002
            ];
            n
        ],
        points: vec![[0.3, -0.2, 1.5]; m],
        weights: vec![0.9; p],
        features: vec![[300.0, 250.0]; p],
        seen: (0..p).map(|i| (i % n, i % m)).collect(),
    }
}
