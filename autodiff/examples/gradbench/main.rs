//! Speaks the protocol of the public gradbench suite on standard input and output, one JSON message a line, so that its
//! harness can judge this engine on its `hello`, `gmm` and `ba` evaluations:
//!
//! `gradbench run --eval "gradbench repo eval gmm" --tool target/release/examples/gradbench`

mod ba;
mod gmm;
mod messages;

use std::io::{BufRead, Write};

use serde_json::Value;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut out = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        if line.trim().is_empty() {
            continue;
        }
        let message: Value = serde_json::from_str(&line)?;
        let answer = messages::answer(&message);
        let written = writeln!(out, "{answer}").and_then(|()| out.flush());
        // A harness that has ended may not be there to hear so.
        if message["kind"] == "end" {
            return Ok(());
        }
        written?;
    }
    Ok(())
}
