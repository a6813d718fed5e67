//! Words that depend on a number.

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
    fn little_memory_is_not_none() {
        assert_eq!(amount(1), "1 byte");
        assert_eq!(amount((1 << 20) - 1), "1048575 bytes");
        assert_eq!(amount(3 << 19), "1 MiB");
    }
}
