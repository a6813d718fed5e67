//! The two kernels that decide whether the tape is fast enough, each against a hand-written counterpart, interleaved in one
//! run: GGX shading (with its gradient), and the contraction of coefficients with interpolated rows. Then lookups in tables of
//! all sizes, and a network.
//!
//! `cargo bench -p autodiff --bench kernels -- [threads] [shading] [contraction] [tables] [network]`

mod contraction;
mod hand;
mod mlp;
mod shading;
mod tables;
mod timing;

fn main() {
    let threads = std::env::args().skip(1).find_map(|arg| arg.parse().ok());
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(1))
        .build()
        .expect("a thread pool");
    pool.install(|| {
        println!("threads: {}", rayon::current_num_threads());
        // Names of kernels may be given to run only those.
        let wanted = |name: &str| {
            let mut names = std::env::args()
                .skip(1)
                .filter(|arg| {
                    ["shading", "contraction", "tables", "network"].contains(&arg.as_str())
                })
                .peekable();
            names.peek().is_none() || names.any(|arg| arg == name)
        };
        if wanted("shading") {
            shading::run();
        }
        if wanted("contraction") {
            contraction::run();
        }
        if wanted("tables") {
            tables::run();
        }
        if wanted("network") {
            network();
        }
    });
}

/// Prints the time of a network's gradient.
fn network() {
    let program = mlp::record();
    let mut ws = mlp::bind(&program);
    let [gradient] = timing::best([&mut || mlp::step(&program, &mut ws, &[0.0; 3])]);
    println!("network, forward and backward (milliseconds): {gradient:.2}");
}
