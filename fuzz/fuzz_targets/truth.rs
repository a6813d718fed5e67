//! Any bytes as `truth.json`: a lobe that it names has numbers.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let path = std::path::Path::new("truth.json");
    if let Ok(Some(lobe)) = eclipse::evaluate::parse_specular(bytes, path) {
        assert!(lobe.alpha.is_finite() && lobe.kappa.is_finite());
    }
});
