//! A summary as text that a person can check, and the comparison that knows which words are numbers.

use std::collections::BTreeSet;
use std::fmt::Write;

use serde_json::{Map, Value};

use super::Stage;

/// The text of a stage: its kind, then the lines of its summary; lists of records as tables.
pub fn stage_text(stage: &Stage) -> String {
    let mut out = format!("{}\n", stage.kind);
    map(stage.summary, 0, &mut out);
    if !stage.frame.is_null() {
        entry("frame", stage.frame, 0, &mut out);
    }
    for warning in stage.warnings {
        writeln!(out, "warning: {}", warning.replace('\n', " ")).expect("a string grows");
    }
    out.trim_end().to_string()
}

fn map(map: &Map<String, Value>, depth: usize, out: &mut String) {
    for (key, value) in map {
        entry(key, value, depth, out);
    }
}

fn entry(key: &str, value: &Value, depth: usize, out: &mut String) {
    let indent = "  ".repeat(depth);
    match value {
        Value::Object(inner) if !inner.is_empty() => {
            *out += &format!("{indent}{key}:\n");
            map(inner, depth + 1, out);
        }
        Value::Array(rows) if !rows.is_empty() && rows.iter().all(Value::is_object) => {
            *out += &format!("{indent}{key}:\n");
            table(rows, depth + 1, out);
        }
        Value::Array(rows) if !rows.is_empty() && rows.iter().all(Value::is_array) => {
            *out += &format!("{indent}{key}:\n");
            for row in rows.iter().flat_map(Value::as_array) {
                *out += &format!("{indent}  {}\n", row.iter().map(scalar).collect::<Vec<_>>().join(" "));
            }
        }
        Value::Array(items) if !items.is_empty() => {
            let items: Vec<String> = items.iter().map(scalar).collect();
            *out += &format!("{indent}{key}: {}\n", items.join(" "));
        }
        other => *out += &format!("{indent}{key}: {}\n", scalar(other)),
    }
}

/// Columns in alphabetical order, right-aligned under their names.
fn table(rows: &[Value], depth: usize, out: &mut String) {
    let names: BTreeSet<&String> =
        rows.iter().flat_map(|r| r.as_object().expect("a table of records").keys()).collect();
    let mut lines = vec![names.iter().map(|n| n.to_string()).collect::<Vec<_>>()];
    for row in rows {
        lines.push(names.iter().map(|&n| row.get(n).map_or("-".to_string(), scalar)).collect());
    }
    let width = |column: usize| lines.iter().map(|l| l[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..names.len()).map(width).collect();
    for line in &lines {
        let cells: Vec<String> = line.iter().zip(&widths).map(|(cell, &width)| format!("{cell:>width$}")).collect();
        *out += &format!("{}{}\n", "  ".repeat(depth), cells.join("  "));
    }
}

/// Whole numbers without a point, others always with one, to twelve digits; texts that look otherwise in quotes.
fn scalar(value: &Value) -> String {
    match value {
        Value::Number(n) => match n.as_f64() {
            Some(real) if n.is_f64() => {
                let rounded: f64 = format!("{real:.11e}").parse().unwrap_or(real);
                format!("{:?}", rounded + 0.0)
            }
            _ => n.to_string(),
        },
        Value::String(s) => {
            let plain = !s.is_empty() && !s.contains(|c: char| c.is_whitespace() || c.is_control() || c == '"');
            if plain && Word::of(s) == Word::Text(s) { s.clone() } else { value.to_string() }
        }
        Value::Array(items) if items.is_empty() => "none".to_string(),
        Value::Object(inner) if inner.is_empty() => "none".to_string(),
        Value::Null => "none".to_string(),
        other => other.to_string(),
    }
}

/// A word of a snapshot.
#[derive(Debug, PartialEq)]
enum Word<'a> {
    /// A whole number: compared as it stands.
    Count(&'a str),
    /// A number with a point or an exponent: compared with tolerance.
    Real(f64),
    Text(&'a str),
}

impl<'a> Word<'a> {
    fn of(word: &'a str) -> Self {
        let digits = word.strip_prefix('-').unwrap_or(word);
        match word.parse::<f64>() {
            Ok(real) if digits.starts_with(|c: char| c.is_ascii_digit()) => {
                if digits.bytes().all(|b| b.is_ascii_digit()) { Word::Count(word) } else { Word::Real(real) }
            }
            _ => Word::Text(word),
        }
    }
}

/// Whether two texts say the same: line by line and word by word, white space apart, numbers within the tolerance.
pub fn same(old: &str, new: &str, abs: f64, rel: f64) -> bool {
    let close = |a: f64, b: f64| a == b || (a - b).abs() <= abs.max(rel * a.abs().max(b.abs()));
    let same_word = |(a, b): (&str, &str)| match (Word::of(a), Word::of(b)) {
        (Word::Real(a), Word::Real(b)) => close(a, b),
        (a, b) => a == b,
    };
    let same_line = |(a, b): (&str, &str)| {
        a.split_whitespace().count() == b.split_whitespace().count()
            && a.split_whitespace().zip(b.split_whitespace()).all(same_word)
    };
    let [old, new] = [old.trim_end(), new.trim_end()];
    old.lines().count() == new.lines().count() && old.lines().zip(new.lines()).all(same_line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digest::Digest;
    use serde_json::json;

    fn text(summary: Value) -> String {
        let summary = summary.as_object().unwrap();
        stage_text(&Stage { kind: "Hulls", digest: Digest::of(b""), frame: &Value::Null, summary, warnings: &[] })
    }

    #[test]
    fn a_summary_reads_well() {
        let found = text(json!({
            "clusters": 3,
            "area_m2": 12.0,
            "bounds_m": [-1.5, 2, 1e-9],
            "rejects": {"height is not above 0": 2},
            "levels": [{"depth": 0, "error": 10.25}, {"depth": 11, "error": 0.1 + 0.2, "note": "7"}],
            "nothing": [],
            "corners": [[0.5, 1], [2, 3]],
            "crs": "EPSG:28992",
        }));
        let expected = "\
Hulls
area_m2: 12.0
bounds_m: -1.5 2 1e-9
clusters: 3
corners:
  0.5 1
  2 3
crs: EPSG:28992
levels:
  depth  error  note
      0  10.25     -
     11    0.3   \"7\"
nothing: none
rejects:
  height is not above 0: 2";
        assert_eq!(found, expected);
    }

    #[test]
    fn counts_are_exact_and_measures_are_not() {
        let eq = |a: &str, b: &str| same(a, b, 1e-6, 1e-9);
        assert!(eq("area: 12.0", "area: 12.0000009"));
        assert!(!eq("area: 12.0", "area: 12.000002"));
        assert!(eq("area: 1200000000.0", "area: 1200000001.0"));
        assert!(!eq("area: 1200000000.0", "area: 1200000002.0"));
        assert!(!eq("rings: 1200000000", "rings: 1200000001"));
        assert!(eq("  n   e\n  1  2.0", "n e\n1 2.0000001\n"));
        assert!(!eq("n: 1", "n: 1.0") && !eq("n: 1", "n: 1 2") && !eq("n", "n\nm"));
        assert!(!eq("id: \"1.0\"", "id: \"1.0000001\""));
        assert!(!eq("id: nan", "id: inf") && eq("id: nan", "id: nan"));
        assert!(same("x: 1.0", "x: 1.4", 0.5, 0.0));
    }
}
