//! What the header of a Radiance HDR file says was done to its values: light is what they were before.

use render::image::Image;

/// The first bytes of a Radiance file.
const MAGIC: &[u8] = b"#?RADIANCE";
/// What some programs begin it with instead.
const OTHER_MAGIC: &[u8] = b"#?RGBE";

/// Whether bytes are the first ones of a Radiance file.
pub(super) fn begins(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC) || is_other(bytes)
}

/// Whether they are of one whose first line the decoder does not know.
pub(super) fn is_other(bytes: &[u8]) -> bool {
    bytes.starts_with(OTHER_MAGIC)
}

/// Divides by all that the header of the file `bytes` says its values were multiplied with: `EXPOSURE` and `COLORCORR`, each as often
/// as it is there.
///
/// # Errors
/// A factor that cannot have been.
pub(super) fn undo(image: &mut Image, bytes: &[u8]) -> Result<(), String> {
    let factors = factors(bytes)?;
    if factors != [1.0; 3] {
        for pixel in image.data.chunks_exact_mut(image.channels) {
            for (value, factor) in pixel.iter_mut().zip(factors) {
                *value = (f64::from(*value) / factor) as f32;
            }
        }
    }
    Ok(())
}

/// The product of all factors, by colour.
fn factors(bytes: &[u8]) -> Result<[f64; 3], String> {
    let mut product = [1.0; 3];
    // An empty line ends the header.
    let lines = bytes.split(|&byte| byte == b'\n');
    for line in lines.take_while(|line| !line.trim_ascii().is_empty()) {
        let line = String::from_utf8_lossy(line);
        let Some((name, value)) = line.split_once('=') else {
            continue;
        };
        let numbers: Vec<f64> = value
            .split_whitespace()
            .map_while(|word| word.parse().ok())
            .collect();
        let own = match (name.trim(), &*numbers) {
            ("EXPOSURE", &[all, ..]) => [all; 3],
            ("COLORCORR", &[red, green, blue, ..]) => [red, green, blue],
            ("EXPOSURE" | "COLORCORR", _) => [0.0; 3],
            _ => continue,
        };
        for (product, own) in product.iter_mut().zip(own) {
            *product *= own;
        }
        let possible = product.iter().all(|p| p.is_finite() && *p > 0.0);
        if !possible {
            return Err(format!(
                "its header says {:?}, by which no light can have been multiplied",
                line.trim()
            ));
        }
    }
    Ok(product)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(lines: &str) -> Result<[f64; 3], String> {
        factors(format!("#?RADIANCE\n{lines}\n-Y 1 +X 1\nEXPOSURE=9\n").as_bytes())
    }

    #[test]
    fn all_factors_of_the_header_count_and_nothing_behind_it() {
        assert_eq!(of("FORMAT=32-bit_rle_rgbe\n").unwrap(), [1.0; 3]);
        let twice = "EXPOSURE= 2\n# EXPOSURE=5\nCOLORCORR=1 2 0.5\r\nEXPOSURE=0.25\n";
        assert_eq!(of(twice).unwrap(), [0.5, 1.0, 0.25]);
        assert_eq!(of("pfilt -e 4\n").unwrap(), [1.0; 3]);
    }

    #[test]
    fn what_no_light_was_multiplied_with_is_told() {
        for line in [
            "EXPOSURE=0",
            "EXPOSURE=-1",
            "EXPOSURE=bright",
            "COLORCORR=1 2",
            "EXPOSURE=nan",
        ] {
            let message = of(&format!("{line}\n")).unwrap_err();
            assert!(message.contains(line), "{message}");
        }
    }
}
