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
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Change {
    /// Of a file or input that is gone its old number, else the new one.
    pub name: String,
    pub old: Option<String>,
    pub new: Option<String>,
    /// The file or node that it was before, where that is another one and somebody knows.
    pub was: Option<String>,
}

/// What differs between two lists, in the order of the new one, then what the new one lacks. Files, and the inputs of
/// a port that takes many, are compared as lists: one that comes in between is one change.
pub fn difference(old: &[(String, String)], new: &[(String, String)]) -> Vec<Change> {
    let find =
        |lines: &[(String, String)], name: &str| lines.iter().find(|(n, _)| n == name).map(|(_, value)| value.clone());
    let mut out = Vec::new();
    let mut done: Vec<&str> = Vec::new();
    for (name, value) in new.iter().chain(old.iter().filter(|(name, _)| find(new, name).is_none())) {
        let change = |old, new| Change { name: name.clone(), old, new, was: None };
        match series(name) {
            Some(list) if done.contains(&list) => {}
            Some(list) => {
                done.push(list);
                out.extend(of_lists(list, old, new));
            }
            None => match (find(old, name), find(new, name)) {
                (before, None) => out.push(change(before, None)),
                (before, _) if before.as_ref() == Some(value) => {}
                (before, now) => out.push(change(before, now)),
            },
        }
    }
    out
}

/// `in.values` of `in.values.3`, `file` of `file.3` and `beside.3`.
fn series(name: &str) -> Option<&str> {
    let (list, number) = name.rsplit_once('.')?;
    let is =
        number.bytes().all(|b| b.is_ascii_digit()) && (list.starts_with("in.") || matches!(list, "file" | "beside"));
    is.then_some(if list == "beside" { "file" } else { list })
}

fn of_lists(list: &str, old: &[(String, String)], new: &[(String, String)]) -> Vec<Change> {
    // Of a file its name beside another belongs to it.
    let entries = |lines: &[(String, String)]| -> Vec<(String, Option<String>)> {
        let value = |list: &str, n: usize| {
            lines.iter().find(|(name, _)| *name == format!("{list}.{n}")).map(|(_, value)| value.clone())
        };
        let beside = |n| if list == "file" { value("beside", n) } else { None };
        (0..).map_while(|n| Some((value(list, n)?, beside(n)))).collect()
    };
    let (old, new) = (entries(old), entries(new));
    let mut out = Vec::new();
    for op in similar::capture_diff_slices(similar::Algorithm::Myers, &old, &new) {
        if matches!(op, similar::DiffOp::Equal { .. }) {
            continue;
        }
        let (from, to) = (op.old_range(), op.new_range());
        for k in 0..from.len().max(to.len()) {
            let (before, now) = (from.clone().nth(k), to.clone().nth(k));
            let (is, was) = (now.map(|n| &new[n]), before.map(|n| &old[n]));
            let n = now.or(before).unwrap_or_default();
            let only_name = is.is_some() && is.map(|e| &e.0) == was.map(|e| &e.0);
            out.push(match only_name {
                true => Change {
                    name: format!("beside.{n}"),
                    old: was.and_then(|e| e.1.clone()),
                    new: is.and_then(|e| e.1.clone()),
                    was: None,
                },
                false => Change {
                    name: format!("{list}.{n}"),
                    old: was.map(|e| e.0.clone()),
                    new: is.map(|e| e.0.clone()),
                    was: None,
                },
            });
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

    #[test]
    fn lists_are_compared_as_lists() {
        let lines = |all: &[(&str, &str)]| all.iter().map(|(n, v)| (n.to_string(), v.to_string())).collect::<Lines>();
        let of = |old: &[(&str, &str)], new: &[(&str, &str)]| -> Vec<(String, String, String)> {
            let word = |v: Option<String>| v.unwrap_or("-".into());
            let all = difference(&lines(old), &lines(new));
            all.into_iter().map(|c| (c.name, word(c.old), word(c.new))).collect()
        };
        let is = |n: &str, o: &str, v: &str| (n.to_string(), o.to_string(), v.to_string());
        let two = [("file.0", "a"), ("file.1", "c")];
        let three = [("file.0", "a"), ("file.1", "b"), ("file.2", "c")];
        assert_eq!(of(&two, &three), [is("file.1", "-", "b")]);
        assert_eq!(of(&three, &two), [is("file.1", "b", "-")]);
        assert_eq!(of(&two, &[("file.0", "x"), ("file.1", "c")]), [is("file.0", "a", "x")]);
        let many = [("in.v", "2"), ("in.v.0", "a"), ("in.v.1", "b")];
        let more = [("in.v", "3"), ("in.v.0", "n"), ("in.v.1", "a"), ("in.v.2", "b")];
        assert_eq!(of(&many, &more), [is("in.v", "2", "3"), is("in.v.0", "-", "n")]);
        assert_eq!(
            of(&more, &[]),
            [is("in.v", "3", "-"), is("in.v.0", "n", "-"), is("in.v.1", "a", "-"), is("in.v.2", "b", "-")]
        );
        // A file and its name beside another are one; the name alone is another change.
        let named = [("file.0", "a"), ("beside.1", "m.mtl"), ("file.1", "m")];
        assert_eq!(of(&[("file.0", "a")], &named), [is("file.1", "-", "m")]);
        let renamed = [("file.0", "a"), ("beside.1", "n.mtl"), ("file.1", "m")];
        assert_eq!(of(&named, &renamed), [is("beside.1", "m.mtl", "n.mtl")]);
    }
}
