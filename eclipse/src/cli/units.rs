//! Durations and sizes as people write them (`90s`, `10m`, `1h30m`, `512MiB`, `4GB`), and words as a shell takes them.

use std::ffi::OsString;

/// Parses a duration into seconds; a bare number is seconds.
pub(super) fn duration(text: &str) -> Result<f64, String> {
    let wrong =
        || format!("`{text}` is not a duration above zero; write for example 90s, 10m or 1h30m");
    if let Ok(seconds) = text.parse::<f64>() {
        return positive(seconds).ok_or_else(wrong);
    }
    let (mut total, mut rest) = (0.0, text);
    let mut smallest = f64::INFINITY;
    while !rest.is_empty() {
        let (value, after) = split(rest);
        let end = after
            .find(|c: char| !c.is_ascii_alphabetic())
            .unwrap_or(after.len());
        let (unit, next) = after.split_at(end);
        let factor = match unit {
            "s" => 1.0,
            "m" | "min" => 60.0,
            "h" => 3600.0,
            _ => return Err(wrong()),
        };
        // Units go from large to small, each once: 5s3h is more likely a slip than a wish.
        if factor >= smallest {
            return Err(wrong());
        }
        smallest = factor;
        total += factor * value.parse::<f64>().map_err(|_| wrong())?;
        rest = next;
    }
    positive(total).ok_or_else(wrong)
}

/// Parses a size into bytes; a bare number is bytes, `KiB MiB GiB TiB` are powers of 1024, `kB MB GB TB` of 1000.
pub(super) fn size(text: &str) -> Result<u64, String> {
    let wrong = || format!("`{text}` is not a size; write for example 4GiB, 800MB or 4000000000");
    let (value, unit) = split(text);
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" | "g" => 1e9,
        "tb" => 1e12,
        "kib" => 1024.0,
        "mib" => 1024f64.powi(2),
        "gib" => 1024f64.powi(3),
        "tib" => 1024f64.powi(4),
        _ => return Err(wrong()),
    };
    let bytes = value.trim().parse::<f64>().map_err(|_| wrong())? * factor;
    positive(bytes)
        .filter(|&bytes| bytes < u64::MAX as f64)
        .map(|bytes| bytes as u64)
        .ok_or_else(wrong)
}

/// The leading number and what follows it.
fn split(text: &str) -> (&str, &str) {
    text.split_at(
        text.find(|c: char| !c.is_ascii_digit() && c != '.')
            .unwrap_or(text.len()),
    )
}

fn positive(value: f64) -> Option<f64> {
    (value.is_finite() && value > 0.0).then_some(value)
}

/// Bytes as people read them: `512 MiB`, `1.5 GiB`.
pub(super) fn bytes(count: u64) -> String {
    let mib = count as f64 / f64::from(1 << 20);
    if mib < 1000.0 {
        format!("{mib:.0} MiB")
    } else {
        format!("{:.1} GiB", mib / 1024.0)
    }
}

/// A name of a list, without the spaces around it.
pub(super) fn trimmed(text: &str) -> Result<String, std::convert::Infallible> {
    Ok(text.trim().to_owned())
}

/// A whole number from `LEAST`.
pub(super) fn at_least<const LEAST: u64>(text: &str) -> Result<u64, String> {
    let value = text.parse().ok().filter(|value| *value >= LEAST);
    value.ok_or_else(|| {
        format!(
            "`{text}` is not a whole number from {LEAST} to {}",
            u64::MAX
        )
    })
}

/// A number within bounds.
pub(super) fn number(text: &str, least: f32, most: f32) -> Result<f32, String> {
    let value = text
        .parse()
        .ok()
        .filter(|value| (least..=most).contains(value));
    value.ok_or_else(|| format!("`{text}` is not a number between {least} and {most}"))
}

/// A distance from an object's centre, in its bounding radii.
pub(super) fn distance(text: &str) -> Result<f32, String> {
    number(text, 1.2, 1000.0)
}

/// A word as a shell would take it.
pub(super) fn shell_word(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// A command as it was `typed`, as a shell would take it, under the program's plain name.
pub(super) fn shell_words(typed: &[OsString]) -> Vec<String> {
    let typed = typed.iter().skip(1);
    let words = typed.map(|word| shell_word(&word.to_string_lossy()));
    std::iter::once("eclipse".to_owned()).chain(words).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations() {
        let cases = [
            ("90", 90.0),
            ("90s", 90.0),
            ("10m", 600.0),
            ("1h30m", 5400.0),
            ("1.5min", 90.0),
        ];
        for (text, seconds) in cases {
            assert_eq!(duration(text), Ok(seconds), "{text}");
        }
        for text in [
            "", "m", "0s", "-3s", "10 m", "5s3h", "1m2m", "inf", "NaN", "1d", "1..5s",
        ] {
            assert!(duration(text).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes() {
        let cases = [
            ("4GiB", 4 << 30),
            ("512 MiB", 512 << 20),
            ("4GB", 4_000_000_000),
            ("1.5kB", 1500),
            ("7", 7),
        ];
        for (text, bytes) in cases {
            assert_eq!(size(text), Ok(bytes), "{text}");
        }
        for text in ["", "GiB", "0", "-1", "4 lots", "99999999999TiB", "0x10"] {
            assert!(size(text).is_err(), "{text}");
        }
    }
}
