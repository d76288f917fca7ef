//! What a result depends on, as lines. Hashed they are the key, kept they explain it: `why` is the difference of
//! two lists.

use serde_json::Value;

use crate::digest::Digest;
use crate::graph::Node;

/// Takes the lines of [`walk`].
pub trait Sink {
    fn put(&mut self, name: &str, value: &str);
}

/// The key.
pub struct Hash(blake3::Hasher);

/// The lines themselves.
pub type Lines = Vec<(String, String)>;

impl Hash {
    pub fn new() -> Self {
        let mut hash = Self(blake3::Hasher::new());
        hash.put("lodge-key", "1");
        hash
    }

    pub fn finish(self) -> Digest {
        Digest(*self.0.finalize().as_bytes())
    }
}

impl Default for Hash {
    fn default() -> Self {
        Self::new()
    }
}

impl Sink for Hash {
    fn put(&mut self, name: &str, value: &str) {
        for text in [name, value] {
            self.0.update(&(text.len() as u64).to_le_bytes());
            self.0.update(text.as_bytes());
        }
    }
}

impl Sink for Lines {
    fn put(&mut self, name: &str, value: &str) {
        self.push((name.to_string(), value.to_string()));
    }
}

/// Every fact that the bytes may depend on, in a fixed order: no path, no time, no machine. An input that is not
/// known yet is none, and then the lines are no key.
pub fn walk(node: &Node, inputs: &[Vec<Option<Digest>>], files: &[Digest], sink: &mut impl Sink) {
    sink.put("op", node.entry.name);
    sink.put("op-version", &node.entry.version.to_string());
    if let Value::Object(params) = &node.params {
        for (name, value) in params {
            if !node.file_params.contains(name) {
                parameter(name, value, sink);
            }
        }
    }
    for (port, digests) in node.entry.ports.iter().zip(inputs) {
        let port_name = port.name.replace('_', "-");
        if port.many {
            sink.put(&format!("in.{port_name}"), &digests.len().to_string());
        }
        for (i, digest) in digests.iter().enumerate() {
            let digest = digest.map_or("?".to_string(), |d| d.to_string());
            match port.many {
                true => sink.put(&format!("in.{port_name}.{i}"), &digest),
                false => sink.put(&format!("in.{port_name}"), &digest),
            }
        }
    }
    for (i, (digest, beside)) in files.iter().zip(&node.beside).enumerate() {
        // Which of the names a file stands for: others may be missing.
        if let Some(name) = beside {
            sink.put(&format!("beside.{i}"), name);
        }
        sink.put(&format!("file.{i}"), &digest.to_string());
    }
}

/// The key of a node whose inputs and files are known.
pub fn key(node: &Node, inputs: &[Vec<Option<Digest>>], files: &[Digest]) -> Digest {
    let mut hash = Hash::new();
    walk(node, inputs, files, &mut hash);
    hash.finish()
}

/// Tables give a line for each of their keys, anything else one line.
fn parameter(name: &str, value: &Value, sink: &mut impl Sink) {
    match value {
        Value::Object(table) if !table.is_empty() => {
            for (key, value) in table {
                let key = if key.contains(['.', '"']) { Value::from(key.as_str()).to_string() } else { key.clone() };
                parameter(&format!("{name}.{key}"), value, sink);
            }
        }
        _ => sink.put(name, &canonical(value)),
    }
}

/// One text for equal values: keys sorted (serde_json's maps are), 1.0 is 1, -0 is 0, other numbers as Rust's standard
/// library prints them (the shortest text that reads back the same).
pub fn canonical(value: &Value) -> String {
    match value {
        Value::Number(n) => match n.as_f64() {
            Some(v) if n.is_f64() => format!("{}", v + 0.0),
            _ => n.to_string(),
        },
        Value::Array(all) => format!("[{}]", all.iter().map(canonical).collect::<Vec<_>>().join(",")),
        Value::Object(all) => {
            let pairs: Vec<_> = all.iter().map(|(k, v)| format!("{}:{}", Value::from(&**k), canonical(v))).collect();
            format!("{{{}}}", pairs.join(","))
        }
        _ => value.to_string(),
    }
}

/// A line that differs: its name, the old value, the new one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    pub name: String,
    pub old: Option<String>,
    pub new: Option<String>,
}

/// What differs between two lists, in the order of the new one, then what the new one lacks.
pub fn difference(old: &[(String, String)], new: &[(String, String)]) -> Vec<Change> {
    let find =
        |lines: &[(String, String)], name: &str| lines.iter().find(|(n, _)| n == name).map(|(_, value)| value.clone());
    let mut out = Vec::new();
    for (name, value) in new {
        let before = find(old, name);
        if before.as_ref() != Some(value) {
            out.push(Change { name: name.clone(), old: before, new: Some(value.clone()) });
        }
    }
    for (name, value) in old {
        if find(new, name).is_none() {
            out.push(Change { name: name.clone(), old: Some(value.clone()), new: None });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn equal_numbers_have_one_form() {
        let equal = [json!(1.0), json!(1)].map(|v| canonical(&v));
        assert_eq!(equal, ["1", "1"]);
        assert_eq!(canonical(&json!(-0.0)), "0");
        assert_eq!(canonical(&json!(0.5)), "0.5");
        assert_eq!(canonical(&json!(1e20)), "100000000000000000000");
        assert_eq!(canonical(&json!(u64::MAX)), "18446744073709551615");
        assert_eq!(canonical(&json!({"b": [2.0], "a": null})), r#"{"a":null,"b":[2]}"#);
    }

    #[test]
    fn lines_do_not_run_together() {
        let of = |lines: &[(&str, &str)]| {
            let mut hash = Hash::new();
            lines.iter().for_each(|(n, v)| hash.put(n, v));
            hash.finish()
        };
        assert_ne!(of(&[("a", "bc")]), of(&[("ab", "c")]));
        assert_ne!(of(&[("a", ""), ("b", "")]), of(&[("a", "b")]));
    }

    #[test]
    fn differences_by_name() {
        let line = |n: &str, v: &str| (n.to_string(), v.to_string());
        let old = [line("keep", "0.5"), line("gone", "1")];
        let new = [line("keep", "0.6"), line("more", "2")];
        let names: Vec<_> = difference(&old, &new).into_iter().map(|c| (c.name, c.old, c.new)).collect();
        let some = |t: &str| Some(t.to_string());
        assert_eq!(
            names,
            [
                ("keep".into(), some("0.5"), some("0.6")),
                ("more".into(), None, some("2")),
                ("gone".into(), some("1"), None)
            ]
        );
        assert!(difference(&old, &old).is_empty());
    }
}
