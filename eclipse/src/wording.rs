//! Words that depend on a number.

/// Where no more than this share of the variance can be told, nothing worth a run can.
const HARDLY: f64 = 0.1;

/// So many of something: `1 picture`, `2 pictures`; `one` is its name in the singular.
pub fn counted(number: usize, one: &str) -> String {
    match (number, one.strip_suffix("ex")) {
        (1, _) => format!("1 {one}"),
        // Vertices and indices.
        (_, Some(stem)) => format!("{number} {stem}ices"),
        (_, None) => format!("{number} {one}s"),
    }
}

/// Memory in whole MiB, or what is less than one as it is.
pub fn amount(bytes: u64) -> String {
    match bytes >> 20 {
        0 => counted(bytes as usize, "byte"),
        mib => format!("{mib} MiB"),
    }
}

/// What photographs can tell of the light, and what follows, from the RMS errors that the best linear estimate leaves of light that varies
/// by 1 between parts of `texel` degrees, with somebody behind each camera and with nobody there. Told in shares of its variance.
pub fn told_of_light(texel: f64, with_somebody: f64, with_nobody: f64) -> String {
    let [somebody, nobody] = [with_somebody, with_nobody].map(|error| 1.0 - error * error);
    let follows = if somebody < HARDLY {
        "hardly anything can be found of it"
    } else if nobody < somebody / 2.0 {
        "it is the shadows of whoever takes the photographs that tell it"
    } else {
        "much of it shows without anybody's shadow"
    };
    format!(
        "the best linear estimate, which assumes nothing of the light, tells {:.0} % of the light's variance in parts of {texel:.0}° with \
         somebody behind each camera, {:.0} % with nobody there: {follows}",
        100.0 * somebody,
        100.0 * nobody
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_no_plural() {
        assert_eq!(counted(0, "picture"), "0 pictures");
        assert_eq!(counted(1, "picture"), "1 picture");
        assert_eq!(counted(1, "vertex"), "1 vertex");
        assert_eq!(counted(2, "vertex"), "2 vertices");
    }

    #[test]
    fn what_follows_for_the_light_is_said() {
        let follows = |somebody, nobody| told_of_light(22.5, somebody, nobody);
        assert!(follows(0.5, 0.99).ends_with("that tell it"));
        assert!(follows(0.5, 0.6).ends_with("without anybody's shadow"));
        assert!(follows(0.99, 0.99).contains("hardly anything"));
        assert!(follows(0.5, 0.99).contains("tells 75 % of the light's variance in parts of 22°"));
    }

    #[test]
    fn little_memory_is_not_none() {
        assert_eq!(amount(1), "1 byte");
        assert_eq!(amount((1 << 20) - 1), "1048575 bytes");
        assert_eq!(amount(3 << 19), "1 MiB");
    }
}
