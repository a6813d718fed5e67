//! Words that depend on a number.

/// Where more than this is left unknown, nothing worth a run is known.
const HARDLY: f64 = 0.95;

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

/// What photographs can tell of the light at best, and what follows, from the shares of the variation between parts of `texel` degrees
/// that are left unknown with somebody behind each camera and with nobody there.
pub fn told_of_light(texel: f64, with_somebody: f64, with_nobody: f64) -> String {
    let follows = if with_somebody > HARDLY {
        "hardly anything can be found of it"
    } else if 1.0 - with_nobody < (1.0 - with_somebody) / 2.0 {
        "it is the shadows of whoever takes the photographs that tell it"
    } else {
        "much of it shows without anybody's shadow"
    };
    format!(
        "at best {:.0} % of what sets parts of {texel:.0}° apart can be told with somebody behind each camera, {:.0} % with nobody there: \
         {follows}",
        100.0 * (1.0 - with_somebody),
        100.0 * (1.0 - with_nobody)
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
        assert!(follows(0.5, 0.99).starts_with("at best 50 % of what sets parts of 22° apart"));
    }

    #[test]
    fn little_memory_is_not_none() {
        assert_eq!(amount(1), "1 byte");
        assert_eq!(amount((1 << 20) - 1), "1048575 bytes");
        assert_eq!(amount(3 << 19), "1 MiB");
    }
}
