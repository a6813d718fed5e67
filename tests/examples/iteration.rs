//! Speed of a whole iteration of the `paper` preset: camera rays, paths, loss, gradients and Adam's step, with shadow rays
//! cast and with cached visibility.
//!
//! `cargo run --release -p eclipse-tests --example iteration -- CAPTURE PIXELS RAYS [ITERATIONS]`

use std::{path::PathBuf, sync::Mutex, time::Instant};

use cpu_time::ProcessTime;
use eclipse::{
    capture::{Capture, LoadOptions},
    control::{Control, Progress},
    reconstruct::paper::{plan::Plan, solve_planned},
    settings::{Preset, Settings},
};
use render::bvh::Bvh;

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: iteration CAPTURE PIXELS RAYS [ITERATIONS]";
    let folder = PathBuf::from(arguments.next().ok_or(usage)?);
    let mut number = || arguments.next().map(|n| n.parse::<u64>());
    let (pixels, rays) = (number().ok_or(usage)??, number().ok_or(usage)??);
    let iterations = number().transpose()?.unwrap_or(12);
    let capture = Capture::load(&folder, &LoadOptions::default())?;
    let bvh = Bvh::new(&capture.mesh)?;
    let settings = Settings {
        preset: Preset::Paper,
        time_limit: None,
        iterations: Some(iterations),
        lambertian: true,
        harmonic_degree: 24,
        ..Settings::default()
    };
    for (name, side) in [("cast", 0), ("cached", 1)] {
        let plan = Plan {
            pixels,
            rays,
            cells: 10_000,
            side,
        };
        // Wall and processor seconds at the end of every iteration.
        let (wall, processor) = (Instant::now(), ProcessTime::now());
        let ends = Mutex::new(Vec::new());
        let note = |_: &Progress| {
            let now = [wall.elapsed(), processor.elapsed()].map(|t| t.as_secs_f64());
            ends.lock().expect("no other thread panicked").push(now);
        };
        let control = Control {
            progress: &note,
            ..Control::detached()
        };
        solve_planned(
            &capture,
            &bvh,
            &settings,
            plan,
            &|_, _| true,
            None,
            &control,
        )?;
        let ends = ends.into_inner()?;
        let median = |k: usize| {
            let mut times: Vec<f64> = ends.windows(2).map(|w| w[1][k] - w[0][k]).collect();
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        };
        let samples = (2 * pixels * rays) as f64 / 1e6;
        println!(
            "{name}: {:.2} M samples/s, {:.2} M samples per core-second ({:.1} ms an iteration)",
            samples / median(0),
            samples / median(1),
            1e3 * median(0)
        );
    }
    Ok(())
}
