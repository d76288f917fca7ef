//! `lodge ops [NAME]`: the manual of the operators, from their own declarations.

use serde_json::{Map, Value, json};

use super::{Exit, Globals, Outcome, Stop};
use crate::diag::{Diagnostic, Findings, did_you_mean};
use crate::graph::{kinds, port_name, required, wanted};
use crate::op::Entry;

#[derive(clap::Args)]
pub struct Args {
    /// Operator; without it the list
    name: Option<String>,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let mut all: Vec<&Entry> = crate::ops::ALL.shown().collect();
        all.sort_by_key(|e| e.name);
        if let Some(name) = &self.name {
            let Some(entry) = all.iter().find(|e| e.name == *name) else {
                let d = Diagnostic::error("unknown-operator", format!("there is no operator `{name}`")).value(name);
                return Err(Stop::usage(d.help_nearest(did_you_mean(name, all.iter().map(|e| e.name)))));
            };
            if globals.json { super::print(&data(entry)) } else { super::say(&page(entry)) }
        } else if globals.json {
            super::print(&json!({"operators": all.iter().map(|e| data(e)).collect::<Vec<_>>()}));
        } else {
            let wide = all.iter().map(|e| e.name.len()).max().unwrap_or(0);
            let kind = all.iter().map(|e| e.output.name.len()).max().unwrap_or(0);
            for e in all {
                super::say(&format!(
                    "{:wide$}  {:kind$}  {}\n",
                    e.name,
                    e.output.name,
                    first_sentence(&doc(&(e.schema)()))
                ));
            }
        }
        Ok(Exit::Done)
    }
}

/// The manual page of one operator.
pub fn page(entry: &Entry) -> String {
    let schema = (entry.schema)();
    let mut out = format!(
        "{} (version {}) gives {}: {}\n\n{}\n",
        entry.name,
        entry.version,
        entry.output.name,
        entry.output.doc,
        filled(&doc(&schema), 0)
    );
    if !entry.ports.is_empty() {
        out += "\nPorts\n";
        for port in entry.ports {
            let note = match (port.many, port.optional) {
                (true, _) => ", any number",
                (false, true) => ", may be left out",
                _ => "",
            };
            out += &format!("  in.{}  {}{note}\n{}\n", port_name(port), kinds(port), filled(port.doc.trim(), 6));
        }
    }
    let none = Map::new();
    let params = schema["properties"].as_object().unwrap_or(&none);
    let needed = required(&schema);
    if !params.is_empty() {
        out += "\nParameters\n";
    }
    for (name, p) in params {
        let unit = p["x-unit"].as_str().map(|u| format!(" {u}")).unwrap_or_default();
        let mut facts = vec![wanted(&schema, p)];
        facts.extend(limits(p, &unit));
        if needed.contains(name) {
            facts.push("required".into());
        } else {
            match &p["default"] {
                Value::Null => facts.push("default: none".into()),
                v => facts.push(format!("default {}{}", as_toml(v), if v.is_number() { &unit } else { "" })),
            }
        }
        if limits(p, &unit).is_none() && !p["default"].is_number() && !unit.is_empty() {
            facts.push(format!("in{unit}"));
        }
        out += &format!("  {name}  {}\n", facts.join("; "));
        if let Some(text) = p["description"].as_str() {
            out += &format!("{}\n", filled(text, 6));
        }
        out += &choices(p);
    }
    let keys: Vec<_> = keys(entry).collect();
    if !keys.is_empty() {
        out += "\nSummary\n";
        let wide = keys.iter().map(|k| k.0.len()).max().unwrap_or(0);
        for (key, meaning) in keys {
            out += &format!("  {key:wide$}  {meaning}\n");
        }
    }
    out
}

/// The keys of its summaries: of the result, of the run, of any.
fn keys(entry: &Entry) -> impl Iterator<Item = &(&str, &str)> {
    entry.output.keys.iter().chain(entry.facts).chain(Findings::KEYS)
}

/// The same as data.
fn data(entry: &Entry) -> Value {
    let schema = (entry.schema)();
    let port = |p: &crate::op::PortDecl| {
        json!({"name": port_name(p), "doc": p.doc.trim(), "kinds": p.kinds.iter().map(|k| k.name).collect::<Vec<_>>(),
            "optional": p.optional, "many": p.many})
    };
    let keys = keys(entry).map(|(k, v)| (k.to_string(), Value::from(*v)));
    json!({
        "name": entry.name,
        "version": entry.version,
        "doc": doc(&schema),
        "ports": entry.ports.iter().map(port).collect::<Vec<_>>(),
        "result": entry.output.name,
        "params": schema["properties"],
        "required": required(&schema),
        "summary": keys.collect::<Map<_, _>>(),
    })
}

fn doc(schema: &Value) -> String {
    schema["description"].as_str().unwrap_or_default().to_string()
}

fn first_sentence(text: &str) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    text.split_once(". ").map_or(text.trim_end_matches('.').to_string(), |(first, _)| first.to_string())
}

/// `0.01 to 1`, `at least 0 m`, `more than 0`.
fn limits(p: &Value, unit: &str) -> Option<String> {
    let number = |w: &str| p[w].as_f64().map(|n| format!("{n}{unit}"));
    let low = number("minimum").map(|n| ("at least", n)).or(number("exclusiveMinimum").map(|n| ("more than", n)));
    let high = number("maximum").map(|n| ("at most", n)).or(number("exclusiveMaximum").map(|n| ("less than", n)));
    match (low, high) {
        (Some(("at least", l)), Some(("at most", h))) => Some(format!("{} to {h}", l.trim_end_matches(unit))),
        (Some((a, l)), Some((b, h))) => Some(format!("{a} {l}, {b} {h}")),
        (Some((a, n)), None) | (None, Some((a, n))) => Some(format!("{a} {n}")),
        (None, None) => None,
    }
}

/// What each value of an enumeration means, where that is written.
fn choices(p: &Value) -> String {
    let branches = ["oneOf", "anyOf"].iter().find_map(|w| p[*w].as_array()).map_or(&[][..], Vec::as_slice);
    let line = |b: &Value| {
        Some(format!("{}\n", filled(&format!("{}: {}", b["const"].as_str()?, b["description"].as_str()?), 8)))
    };
    branches.iter().filter_map(line).collect()
}

fn as_toml(v: &Value) -> String {
    match v {
        Value::Object(map) if map.is_empty() => "{}".into(),
        Value::Object(map) => {
            format!("{{ {} }}", map.iter().map(|(k, v)| format!("{k} = {}", as_toml(v))).collect::<Vec<_>>().join(", "))
        }
        Value::Array(list) => format!("[{}]", list.iter().map(as_toml).collect::<Vec<_>>().join(", ")),
        Value::Number(n) => n.as_f64().unwrap_or_default().to_string(), // 3 rather than 3.0
        v => v.to_string(),
    }
}

/// Lines of at most 100 characters, indented.
fn filled(text: &str, indent: usize) -> String {
    let mut lines = vec![" ".repeat(indent)];
    for word in text.split_whitespace() {
        let line = lines.last_mut().expect("never empty");
        if line.len() > indent && line.len() + word.len() >= 100 {
            lines.push(format!("{}{word}", " ".repeat(indent)));
        } else {
            if line.len() > indent {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operator_has_a_page() {
        for entry in crate::ops::ALL.shown() {
            let page = page(entry);
            assert!(!doc(&(entry.schema)()).is_empty(), "{} has no doc comment", entry.name);
            for port in entry.ports {
                assert!(page.contains(&format!("in.{}", port_name(port))), "{page}");
            }
            for name in (entry.schema)()["properties"].as_object().into_iter().flatten().map(|(k, _)| k) {
                assert!(page.contains(&format!("  {name}  ")), "{page}");
            }
            assert!(page.lines().all(|l| l.chars().count() < 200), "{page}");
        }
    }

    #[test]
    fn limits_in_words() {
        assert_eq!(limits(&json!({"minimum": 0.01, "maximum": 1}), " m").as_deref(), Some("0.01 to 1 m"));
        assert_eq!(limits(&json!({"exclusiveMinimum": 0}), "").as_deref(), Some("more than 0"));
        assert_eq!(limits(&json!({}), ""), None);
    }
}
