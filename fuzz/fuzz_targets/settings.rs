//! Any bytes as `settings.json`: options that parse come out the same when they are written and parsed again.

#![no_main]

use eclipse::settings::Settings;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(settings) = serde_json::from_slice::<Settings>(bytes) {
        let written = serde_json::to_vec(&settings).expect("settings are JSON");
        let again: Settings = serde_json::from_slice(&written).expect("what was written parses");
        assert_eq!(again, settings);
    }
});
