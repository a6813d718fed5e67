//! Words and numbers of the report.

use serde_json::Value;

use crate::{
    reconstruction::{Ended, Metrics, UncertaintySummary},
    wording::told_of_light,
};

/// Text made safe inside HTML elements and quoted attributes.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// A number to three significant digits, in scientific notation when far from 1.
pub(crate) fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let magnitude = value.abs().log10().floor();
    if !(-3.0..6.0).contains(&magnitude) {
        return format!("{value:.2e}");
    }
    let decimals = (2.0 - magnitude).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Why a run ended, as the end of a sentence that says how many iterations it had.
pub(crate) fn ended(ended: Ended) -> &'static str {
    match ended {
        Ended::Converged => "until nothing was left to gain",
        Ended::Iterations => "as many as allowed",
        Ended::TimeLimit => "up to the time limit",
        Ended::Interrupted => "until it was interrupted",
    }
}

/// Seconds as people say them.
pub(crate) fn duration(seconds: f64) -> String {
    let whole = seconds.round().max(0.0) as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, _) => format!("{} s", number(seconds)),
        (0, minutes, seconds) => format!("{minutes} min {seconds} s"),
        (hours, minutes, _) => format!("{hours} h {minutes} min"),
    }
}

/// What a short run has to say of its deviations.
pub(crate) fn unfinished(doubt: &UncertaintySummary) -> String {
    // Within a tenth more products change nothing that can be seen.
    if doubt.known_at_most <= 1.1 * doubt.known {
        return String::new();
    }
    format!(
        ", and up to {} may be: there was no time to find the others, which makes deviations too large",
        number(doubt.known_at_most)
    )
}

/// What the photographs can tell of the light at best, whoever solves for it: the `limit` of the metrics in a sentence; nothing
/// where it was not computed.
pub(crate) fn limit(metrics: &Metrics) -> String {
    let number = |name: &str| metrics.extra.get("limit")?.get(name)?.as_f64();
    let numbers = ["texel", "with_somebody", "with_nobody"].map(number);
    let [Some(texel), Some(somebody), Some(nobody)] = numbers else {
        return String::new();
    };
    format!(
        " Were all known but light and albedo, {}.",
        told_of_light(texel, somebody, nobody)
    )
}

/// A two-column table of the leaves of a JSON object, nested names joined by spaces.
pub(crate) fn table(values: &Value) -> String {
    let mut rows = Vec::new();
    leaves("", values, &mut rows);
    rows.sort_by_cached_key(|(name, _)| counted(name));
    let row = |(name, value): &(String, String)| {
        format!(
            "<tr><td>{}</td><td>{}</td></tr>",
            escaped(name),
            escaped(value)
        )
    };
    format!(
        "<table>{}</table>",
        rows.iter().map(row).collect::<String>()
    )
}

/// A name in parts that sort as people count: "2 images" before "16 images".
fn counted(name: &str) -> Vec<(u64, String)> {
    let digit = |c: char| c.is_ascii_digit();
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let words = rest.find(digit).unwrap_or(rest.len());
        let (text, number) = rest.split_at(words);
        let end = number.find(|c| !digit(c) && c != '.');
        let end = end.unwrap_or(number.len());
        let (number, after) = number.split_at(end);
        parts.push((0, text.to_owned()));
        if !number.is_empty() {
            // The bits of floats that are not negative are in their order.
            let value = number.parse::<f64>().unwrap_or(f64::INFINITY);
            parts.push((value.to_bits(), String::new()));
        }
        rest = after;
    }
    parts
}

fn leaves(name: &str, value: &Value, rows: &mut Vec<(String, String)>) {
    if let Value::Object(fields) = value {
        for (field, value) in fields {
            leaves(
                format!("{name} {}", field.replace('_', " ")).trim(),
                value,
                rows,
            );
        }
        return;
    }
    let text = match value {
        Value::Null => "–".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::Number(value) if value.is_f64() => value.as_f64().map_or_else(String::new, number),
        Value::String(text) => text.clone(),
        Value::Array(values) if values.iter().all(|v| v.is_number() || v.is_null()) => {
            let word = |v: &Value| v.as_f64().map_or_else(|| "–".to_owned(), number);
            values.iter().map(word).collect::<Vec<_>>().join(", ")
        }
        other => other.to_string(),
    };
    rows.push((name.to_owned(), text));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_digits() {
        let cases = [
            (0.0, "0"),
            (1.0, "1"),
            (38.249, "38.2"),
            (0.012345, "0.0123"),
            (1234.6, "1235"),
        ];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
        assert_eq!(number(1.25e9), "1.25e9");
        assert_eq!(number(-2e-7), "-2.00e-7");
    }

    #[test]
    fn rows_are_in_the_order_people_count_in() {
        let names = [
            "16 images",
            "1 image",
            "2 images",
            "width 0.15",
            "width 0.02",
            "b",
            "a",
        ];
        let object: serde_json::Map<String, Value> = names
            .iter()
            .map(|n| ((*n).to_owned(), Value::Null))
            .collect();
        let table = table(&Value::Object(object));
        let at = |name: &str| table.find(&format!("<td>{name}</td>")).unwrap();
        for pair in [
            "1 image",
            "2 images",
            "16 images",
            "a",
            "b",
            "width 0.02",
            "width 0.15",
        ]
        .windows(2)
        {
            assert!(at(pair[0]) < at(pair[1]), "{pair:?}");
        }
    }

    #[test]
    fn the_limit_is_told_where_there_is_one() {
        let mut metrics = Metrics::default();
        assert_eq!(limit(&metrics), "");
        let reason = serde_json::json!({"left_out": "the lamps are known"});
        metrics.extra.insert("limit".to_owned(), reason);
        assert_eq!(limit(&metrics), "");
        let numbers =
            serde_json::json!({"texel": 22.5, "with_somebody": 0.414, "with_nobody": 0.93});
        metrics.extra.insert("limit".to_owned(), numbers);
        let text = limit(&metrics);
        assert!(
            text.contains("tells 83 % of the light's variance in parts of 22°"),
            "{text}"
        );
        assert!(text.contains(" 14 % with nobody"), "{text}");
    }

    #[test]
    fn durations_read_as_people_say_them() {
        assert_eq!(duration(3.21), "3.21 s");
        assert_eq!(duration(125.0), "2 min 5 s");
        assert_eq!(duration(7322.0), "2 h 2 min");
    }

    #[test]
    fn tables_escape_flatten_and_mark_what_is_absent() {
        let table = table(&serde_json::json!({"a_b": {"c": null}, "d": "<x>", "e": true}));
        assert!(table.contains("<td>a b c</td><td>–</td>"));
        assert!(table.contains("<td>d</td><td>&lt;x&gt;</td>"));
        assert!(table.contains("<td>e</td><td>yes</td>"));
    }
}
