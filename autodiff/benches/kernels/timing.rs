//! Interleaved timing, and reproducible numbers.

/// Best milliseconds of each of several functions, called in turn.
pub fn best<const N: usize>(mut functions: [&mut dyn FnMut(); N]) -> [f64; N] {
    let mut best = [f64::INFINITY; N];
    for round in 0..7 {
        for (function, best) in functions.iter_mut().zip(&mut best) {
            // The clock ticks every four milliseconds.
            let (start, calls) = (clock(), 6);
            for _ in 0..calls {
                function();
            }
            if round > 0 {
                *best = best.min((clock() - start) * 1e3 / calls as f64);
            }
        }
    }
    best
}

/// Seconds of this thread's own CPU time with one thread, so that other work on the machine does not count; else wall time.
fn clock() -> f64 {
    let own = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = own.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    match nanoseconds {
        Some(nanoseconds) if rayon::current_num_threads() == 1 => nanoseconds * 1e-9,
        _ => {
            static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
            START
                .get_or_init(std::time::Instant::now)
                .elapsed()
                .as_secs_f64()
        }
    }
}

/// Reproducible numbers in `[low, high)`.
pub fn numbers(seed: u64, n: usize, low: f32, high: f32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..n)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * ((state >> 40) as f32 / (1u64 << 24) as f32)
        })
        .collect()
}
