//! The table of this engine's speed against a hand-written adjoint and against other engines, from one interleaved run.
//!
//! `cargo run --release -p autodiff --example bench_table -- [--json] [--peers DIR]`
//!
//! `DIR` holds `kernel.py`, the shading kernel in other engines, which prints `NAME ... grad MILLISECONDS`; the interpreter is
//! that of the environment variable PYTHON, or `python3`. What is not installed there is left out. Times are processor time of all
//! threads together, as those of the scripts are, except where threads are compared; trust ratios, not milliseconds.
//!
//! JSON: what has one thread has the plain name, what has two ends in `_2`, before the unit if there is one. `peer_over_tape` and
//! `peer_over_tape_2` hold a ratio for each engine: a gradient of it over one of ours. The run ends with a message, and without a
//! table, if the tape and the hand-written adjoint do not agree.

#[path = "../benches/kernels/hand.rs"]
mod hand;
#[path = "../benches/kernels/mlp.rs"]
mod mlp;
#[path = "../benches/kernels/shading.rs"]
#[allow(dead_code)]
mod shading;
#[path = "../benches/kernels/timing.rs"]
#[allow(dead_code)]
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
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pools = [pool(1)?, pool(2)?];
    for (pool, suffix) in pools.iter().zip(["", "_2"]) {
        pool.install(|| own(&mut table, suffix));
    }
    scaling(&mut table, &pools);
    if let Some(peers) = peers {
        for (pool, suffix) in pools.iter().zip(["", "_2"]) {
            pool.install(|| against_peers(&mut table, &peers, suffix));
        }
    }
    if as_json {
        println!("{}", serde_json::to_string_pretty(&Value::Object(table))?);
    } else {
        print_table(&table);
        for (name, value) in &table {
            println!("{name:<28} {value}");
        }
    }
    Ok(())
}

/// The table of engines, with one thread and two.
fn print_table(table: &Map<String, Value>) {
    for (threads, suffix) in [("one thread", ""), ("two threads", "_2")] {
        println!("{threads}, milliseconds of all threads' processor time together");
        println!(
            "{:<28} {:>9} {:>9} {:>14}",
            "engine", "primal", "gradient", "over this one"
        );
        let number = |name: String| table.get(&name).and_then(Value::as_f64);
        let own = number(format!("gradient{suffix}_ms"));
        for (engine, key) in [
            ("by hand, one thread", "hand_"),
            ("this engine", ""),
            ("Dr.Jit, LLVM", "drjit_"),
            ("PyTorch, its fastest form", "torch_"),
            ("PyTorch, eager", "torch_eager_"),
            ("JAX, jit", "jax_"),
        ] {
            // The hand-written adjoint has one thread in either case.
            let suffix = if key == "hand_" { "" } else { suffix };
            let Some(gradient) = number(format!("{key}gradient{suffix}_ms")) else {
                continue;
            };
            let primal = number(format!("{key}primal{suffix}_ms"));
            let primal = primal.map_or("-".to_string(), |ms| format!("{ms:.2}"));
            // Another engine was measured between two runs of our own, later than the rest.
            let beside = number(format!(
                "peer_over_tape{suffix}_{}",
                key.trim_end_matches('_')
            ));
            let over = beside.or(own.map(|own| gradient / own));
            let over = over.map_or("-".to_string(), |over| format!("{over:.2}"));
            println!("{engine:<28} {primal:>9} {gradient:>9.2} {over:>14}");
        }
        println!();
    }
}

/// Rounded, so that the table reads well.
fn put(table: &mut Map<String, Value>, name: &str, value: f64) {
    table.insert(name.to_string(), json!((value * 1000.0).round() / 1000.0));
}

/// What the threads of a pool do, all in turn.
fn own(table: &mut Map<String, Value>, suffix: &str) {
    let data = shading::Data::new();
    let program = shading::record();
    let (mut primal, mut gradient) = (
        shading::bind(&program, &data),
        shading::bind(&program, &data),
    );
    let mut by_hand = hand::Hand::new(&data);
    let mut by_hand_too = by_hand.clone();
    shading::agree(&program, &mut gradient, &mut by_hand, &data);
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
    ] = processor_time([
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
    if suffix.is_empty() {
        put(table, "hand_primal_ms", hand_primal);
        put(table, "hand_gradient_ms", hand_gradient);
    }
    let mut put = |name: &str, value| put(table, name, value);
    put(&format!("primal{suffix}_ms"), primal);
    put(&format!("gradient{suffix}_ms"), gradient);
    put(&format!("gradient_over_primal{suffix}"), gradient / primal);
    put(&format!("tape_over_hand{suffix}"), gradient / hand_gradient);
    put(&format!("mlp{suffix}_ms"), mlp_ms);
    put(&format!("gmm{suffix}_ms"), gmm_ms);
    put(&format!("ba{suffix}_ms"), ba_ms);
}

/// Best milliseconds of each of several functions, called in turn, by the processor time of all threads.
fn processor_time<const N: usize>(mut functions: [&mut dyn FnMut(); N]) -> [f64; N] {
    let mut best = [f64::INFINITY; N];
    for round in 0..7 {
        for (function, best) in functions.iter_mut().zip(&mut best) {
            let (start, calls) = (processor_seconds(), 6);
            for _ in 0..calls {
                function();
            }
            let spent = (processor_seconds() - start) * 1e3 / calls as f64;
            if round > 0 {
                *best = best.min(spent);
            }
        }
    }
    best
}

/// Processor time of all threads so far; wall time where the system does not tell.
fn processor_seconds() -> f64 {
    let spent = |task: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse().ok()
    };
    let tasks = std::fs::read_dir("/proc/self/task").ok();
    let nanoseconds: Option<f64> = tasks.and_then(|tasks| tasks.flatten().map(spent).sum());
    let wall = || {
        static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
        START.get_or_init(Instant::now).elapsed().as_secs_f64()
    };
    nanoseconds.map_or_else(wall, |nanoseconds| nanoseconds * 1e-9)
}

/// Wall time of gradients on one thread, on two, and of two threads with work of their own each, in turn. The last says what
/// the machine has to give: cores of a shared host may be two halves of one.
fn scaling(table: &mut Map<String, Value>, [one, two]: &[rayon::ThreadPool; 2]) {
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

/// Each peer between two measurements of our own, with as many threads as the pool has.
fn against_peers(table: &mut Map<String, Value>, folder: &Path, suffix: &str) {
    let data = shading::Data::new();
    let program = shading::record();
    let mut ws = shading::bind(&program, &data);
    let network = mlp::record();
    let mut network_ws = mlp::bind(&network);
    let mut tape = || {
        let [gradient, mlp] = processor_time([
            &mut || {
                ws.set("albedo", &data.albedo).expect("a sound array");
                program.vjp(&mut ws, "loss").expect("a bound program");
            },
            &mut || mlp::step(&network, &mut network_ws, &[0.0; 3]),
        ]);
        (gradient, mlp)
    };
    let mlp_script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/kernels/mlp.py");
    let texels = shading::TEXELS.to_string();
    let threads = rayon::current_num_threads().to_string();
    let mut ratios = Map::new();
    let mut before = tape();
    for peer in ["drjit", "jax", "torch"] {
        let found = python(&folder.join("kernel.py"), &[peer, &texels, &threads]);
        let after = tape();
        let found = found.unwrap_or_default();
        let eager = found.lines().filter(|line| line.contains("eager"));
        let forms = [
            (peer.to_string(), Times::of(found.lines())),
            (format!("{peer}_eager"), Times::of(eager)),
        ];
        for (name, times) in forms {
            let Some(Times { primal, gradient }) = times else {
                continue;
            };
            let ratio = gradient / before.0.min(after.0);
            put(table, &format!("{name}_gradient{suffix}_ms"), gradient);
            if let Some(primal) = primal {
                put(table, &format!("{name}_primal{suffix}_ms"), primal);
            }
            put(table, &format!("peer_over_tape{suffix}_{name}"), ratio);
            put(&mut ratios, &name, ratio);
        }
        before = after;
    }
    let found = python(&mlp_script, &[&threads]).unwrap_or_default();
    let after = tape();
    if let Some(Times { gradient, .. }) = Times::of(found.lines()) {
        let ratio = gradient / before.1.min(after.1);
        put(table, &format!("torch_mlp{suffix}_ms"), gradient);
        put(table, &format!("peer_over_tape{suffix}_mlp"), ratio);
        put(&mut ratios, "mlp", ratio);
    }
    table.insert(format!("peer_over_tape{suffix}"), Value::Object(ratios));
}

/// What a script prints: its best times, in milliseconds.
struct Times {
    primal: Option<f64>,
    gradient: f64,
}

impl Times {
    /// The smallest numbers after `primal` and `grad`, or nothing if there is no gradient's.
    fn of<'a>(lines: impl Iterator<Item = &'a str> + Clone) -> Option<Self> {
        let smallest = |word: &str| {
            let numbers = lines.clone().filter_map(|line| {
                let (_, rest) = line.split_once(word)?;
                rest.split_whitespace().next()?.parse::<f64>().ok()
            });
            let smallest = numbers.fold(f64::INFINITY, f64::min);
            smallest.is_finite().then_some(smallest)
        };
        let primal = smallest("primal ");
        smallest("grad ").map(|gradient| Times { primal, gradient })
    }
}

/// What a script prints; nothing, with a message, if it cannot run.
fn python(script: &Path, arguments: &[&str]) -> Option<String> {
    let interpreter = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_string());
    let output = Command::new(interpreter)
        .arg(script)
        .args(arguments)
        .output();
    let text = output.map(|output| String::from_utf8_lossy(&output.stdout).into_owned());
    let text = text.ok().filter(|text| text.contains("grad "));
    if text.is_none() {
        eprintln!("{} {}: not measured", script.display(), arguments.join(" "));
    }
    text
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
