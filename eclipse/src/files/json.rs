//! JSON that a stranger wrote: what is wrong with it, and in which field.

use std::fmt;

use serde::de::DeserializeOwned;
use serde_json::error::Category;

/// What is wrong with a text that should be JSON.
#[derive(Debug)]
pub struct JsonError {
    /// The field at fault, such as `frames[3].transform_matrix[0][3]`; empty where it is the whole text.
    pub field: String,
    /// What is wrong with it, and in which line.
    pub problem: String,
    /// Whether it is no JSON at all.
    pub is_syntax: bool,
}

impl fmt::Display for JsonError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &*self.field {
            "" => write!(formatter, "{}", self.problem),
            field => write!(formatter, "`{field}`: {}", self.problem),
        }
    }
}

impl std::error::Error for JsonError {}

/// Parses a text.
///
/// # Errors
/// [`JsonError`] names the field: a line and a column alone are hard to find in a file without line breaks.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, JsonError> {
    // Editors on Windows mark UTF-8 by it.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut text = serde_json::Deserializer::from_slice(bytes);
    let parsed = serde_path_to_error::deserialize(&mut text);
    let value = parsed.map_err(|error| {
        let field = error.path().to_string();
        of(bytes, &field, error.inner())
    })?;
    text.end().map_err(|error| of(bytes, "", &error))?;
    Ok(value)
}

fn of(bytes: &[u8], field: &str, error: &serde_json::Error) -> JsonError {
    let problem = match no_number(bytes, error) {
        Some(word) => format!(
            "{word} in line {} column {}, but JSON has no NaN and no Infinity: write a finite number",
            error.line(),
            error.column()
        ),
        // The names of types are the program's business.
        None => error
            .to_string()
            .replace("expected f64", "expected a number"),
    };
    JsonError {
        field: match field {
            // The library's word for the whole.
            "." => String::new(),
            field => field.to_owned(),
        },
        problem,
        is_syntax: error.classify() != Category::Data,
    }
}

/// The word at fault where it is what Python and others write for values that are no finite numbers.
fn no_number(bytes: &[u8], error: &serde_json::Error) -> Option<String> {
    if error.classify() != Category::Syntax {
        return None;
    }
    let line = bytes
        .split(|byte| *byte == b'\n')
        .nth(error.line().checked_sub(1)?)?;
    let at = error.column().checked_sub(1)?;
    let is_of_word = |byte: &u8| byte.is_ascii_alphabetic() || matches!(byte, b'-' | b'+');
    let before = line
        .get(..at)?
        .iter()
        .rev()
        .take_while(|b| is_of_word(b))
        .count();
    let after = line[at..].iter().take_while(|b| is_of_word(b)).count();
    let word = String::from_utf8_lossy(&line[at - before..at + after]).into_owned();
    let plain = word.trim_start_matches(['-', '+']).to_ascii_lowercase();
    matches!(&*plain, "nan" | "inf" | "infinity").then_some(word)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    type Table = BTreeMap<String, Vec<Option<f64>>>;

    fn refused(text: &str) -> String {
        parse::<Table>(text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn the_field_is_named() {
        assert!(parse::<Table>(b"{\"a\": [1, null]} \n").is_ok());
        let message = refused("{\"a\": [1,\n \"2\"]}");
        assert!(message.starts_with("`a[1]`: invalid type"), "{message}");
        assert!(message.contains("expected a number at line 2"), "{message}");
        assert!(refused("[]").starts_with("invalid type"));
        assert!(refused("{} {}").starts_with("trailing characters"));
    }

    #[test]
    fn a_mark_of_the_encoding_is_no_part_of_the_text() {
        assert!(parse::<Table>(b"\xef\xbb\xbf{\"a\": [1]}").is_ok());
        assert!(refused("\u{feff}{\"a\": [nan]}").contains("nan in line 1"));
        assert!(parse::<Table>(b"\xef\xbb\xbf\xef\xbb\xbf{}").is_err());
    }

    #[test]
    fn what_is_no_number_is_called_so() {
        for word in ["NaN", "nan", "Infinity", "-Infinity", "inf", "-inf", "-NaN"] {
            let message = refused(&format!("{{\"a\":\n [1, {word}]}}"));
            assert!(
                message.starts_with(&format!("`a[1]`: {word} in line 2"))
                    && message.contains("JSON has no NaN"),
                "{message}"
            );
        }
        assert!(!refused("{\"a\": [nothing]}").contains("NaN"));
        assert!(!refused("{\"a\": [").contains("NaN"));
    }
}
