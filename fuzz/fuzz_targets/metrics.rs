//! Any bytes as `metrics.json`: numbers that parse come out the same when they are written and parsed again.

#![no_main]

use std::path::Path;

use eclipse::evaluate::parse_metrics;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let path = Path::new("metrics.json");
    if let Ok(metrics) = parse_metrics(bytes, path) {
        let written = serde_json::to_vec(&metrics).expect("metrics are JSON");
        let again = parse_metrics(&written, path).expect("what was written parses");
        assert_eq!(again, metrics);
    }
});
