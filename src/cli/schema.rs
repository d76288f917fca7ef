//! `lodge schema [pipeline|events]`: the JSON Schema (draft-07) of pipeline files, for editors, or of the lines of `--events`, from
//! the types of `run::event`. Of pipeline files one branch for each operator, from the
//! same declarations that `check` reads; every parameter also accepts a text with `${name}`.

use serde_json::{Map, Value, json};

use super::{Exit, Globals, Outcome};
use crate::graph::port_name;
use crate::op::{Entry, PortDecl, Registry};

#[derive(clap::Args)]
pub struct Args {
    /// Of what
    #[arg(value_enum, default_value = "pipeline")]
    of: Of,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Of {
    /// Pipeline files
    Pipeline,
    /// A line of --events
    Events,
}

impl Args {
    pub fn run(self, _: &Globals) -> Outcome {
        super::say(&match self.of {
            Of::Pipeline => text(&crate::ops::ALL),
            Of::Events => events(),
        });
        Ok(Exit::Done)
    }
}

/// What `schemas/pipeline.schema.json` holds.
pub fn text(registry: &Registry) -> String {
    format!("{:#}\n", schema(registry))
}

/// What `schemas/events.schema.json` holds.
pub fn events() -> String {
    format!("{:#}\n", crate::run::event::schema())
}

const KEBAB: &str = "^[a-z0-9]+(-[a-z0-9]+)*$";
/// No path below the output folder.
pub const OUTSIDE: &str = r"^$|^\.$|^/|(^|/)\.\.(/|$)|\\|[\u0000-\u001f\u007f]";

fn schema(registry: &Registry) -> Value {
    let mut entries: Vec<&Entry> = registry.shown().collect();
    entries.sort_by_key(|e| e.name);
    let mut branches: Vec<Value> = entries.iter().map(|e| operator(e)).collect();
    branches.push(other(&entries));
    // Not an `enum`: editors show those of all branches.
    branches.push(json!({"description": "false removes a node of the file that this one extends",
        "type": "boolean", "not": {"enum": [true]}}));
    json!({
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "lodge pipeline",
        "description": "a graph of operators that makes coarser versions of 3-D models",
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "description": {"type": "string", "description": "what the pipeline is for"},
            "extends": {"type": "string", "description": "another pipeline file: tables merge, this file wins"},
            "params": {
                "type": "object",
                "description": "values that node parameters use as \"${name}\"",
                "propertyNames": {"pattern": KEBAB},
                "additionalProperties": true,
            },
            "node": {
                "type": "object",
                "description": "the nodes by name",
                "propertyNames": {"pattern": KEBAB},
                "additionalProperties": {"oneOf": branches},
            },
        },
    })
}

/// A node without `op`. One that is being written is such a node, too: so the words are here that an editor should offer.
fn other(entries: &[&Entry]) -> Value {
    let mut properties = own_words();
    let names: Vec<&str> = entries.iter().map(|e| e.name).collect();
    properties.insert("op".into(), json!({"enum": names, "description": "the operator: `lodge ops` has its manual"}));
    for (name, shape, doc) in [
        ("in", "object", "the nodes that it takes, by port"),
        ("matrix", "object", "lists of values: a variant for each combination"),
        ("variants", "array", "a variant for each entry"),
    ] {
        let mut any = json!({"type": shape, "description": doc});
        if shape == "object" {
            any["additionalProperties"] = true.into();
        }
        properties.insert(name.into(), any);
    }
    json!({
        "title": "override",
        "description": "changes a node of the file that this one extends",
        "type": "object",
        "not": {"required": ["op"]},
        "additionalProperties": true,
        "properties": properties,
    })
}

fn operator(entry: &Entry) -> Value {
    let schema = (entry.schema)();
    let none = Map::new();
    let params = schema["properties"].as_object().unwrap_or(&none);
    let params: Map<String, Value> = params.iter().map(|(name, p)| (name.clone(), parameter(p))).collect();
    let lists: Map<String, Value> = params
        .iter()
        .map(|(k, p)| {
            (k.clone(), or_reference(json!({"type": "array", "minItems": 1, "uniqueItems": true, "items": p})))
        })
        .collect();
    let mut properties = own_words();
    let doc = schema["description"].as_str().unwrap_or_default();
    properties.insert("op".into(), json!({"enum": [entry.name], "description": doc}));
    let ports: Map<String, Value> = entry.ports.iter().map(|p| (port_name(p), port(p))).collect();
    properties.insert(
        "in".into(),
        json!({"type": "object", "additionalProperties": false, "properties": ports,
            "description": "the nodes that it takes, by port"}),
    );
    properties.insert(
        "matrix".into(),
        json!({"type": "object", "additionalProperties": false, "properties": lists,
            "description": "lists of values: a variant for each combination"}),
    );
    properties.insert(
        "variants".into(),
        json!({"type": "array", "minItems": 1, "uniqueItems": true, "description": "a variant for each entry",
            "items": {"type": "object", "minProperties": 1, "additionalProperties": false, "properties": params.clone()}}),
    );
    properties.extend(params);
    json!({
        "title": entry.name,
        "description": doc,
        "type": "object",
        "required": ["op"],
        "additionalProperties": false,
        "properties": properties,
    })
}

/// The keys that a node of any operator may have. What is required may come from a file below or from `matrix`, so
/// that nothing but `op` is required here.
fn own_words() -> Map<String, Value> {
    let tolerance = json!({"type": "number", "minimum": 0});
    let words = json!({
        "description": {"type": "string", "description": "what the node is for"},
        "on-error": {"enum": ["report", "fail"], "default": "report", "description": "fail: a rejected feature fails the node"},
        "snapshot": {
            "description": "false: none is kept; or the tolerances that it compares with",
            "anyOf": [
                {"type": "boolean"},
                {"type": "object", "additionalProperties": false, "properties":
                    {"abs": tolerance, "rel": tolerance, "exact": {"type": "boolean"}}},
            ],
        },
    });
    words.as_object().expect("an object").clone()
}

fn port(port: &PortDecl) -> Value {
    let node = json!({"type": "string"});
    let list = json!({"type": "array", "items": node});
    let mut out = match (port.many, port.optional) {
        (true, _) => json!({"anyOf": [node, list]}),
        (false, true) => json!({"anyOf": [node, {"type": "array", "maxItems": 0}]}),
        (false, false) => node,
    };
    out["description"] = format!("{} ({})", port.doc.trim(), crate::graph::kinds(port)).into();
    out
}

/// A parameter's schema in words that editors know; each value may also be a reference.
fn parameter(schema: &Value) -> Value {
    let mut out = or_reference(plain(schema));
    if let Value::Object(map) = &mut out {
        let unit = schema["x-unit"].as_str().map(|u| format!(" [{u}]")).unwrap_or_default();
        let doc = schema["description"].as_str().unwrap_or_default();
        map.insert("description".into(), format!("{doc}{unit}").trim().into());
        if let Some(default) = schema.get("default").filter(|d| !d.is_null()) {
            map.insert("default".into(), default.clone());
        }
    }
    out
}

/// Without `null`, `const`, marks of ours and words that later drafts or other languages brought.
fn plain(schema: &Value) -> Value {
    let Value::Object(from) = schema else { return schema.clone() };
    let mut out = Map::new();
    for (word, value) in from {
        let value = match (word.as_str(), value) {
            ("x-unit" | "x-file" | "x-required" | "default" | "description" | "title", _) => continue,
            ("x-output", _) => {
                out.insert("not".into(), json!({"pattern": OUTSIDE}));
                continue;
            }
            ("const", one) => {
                out.insert("enum".into(), json!([one]));
                continue;
            }
            ("format", Value::String(format)) => {
                if let Some(most) = largest(format) {
                    out.entry("maximum").or_insert(most.into());
                }
                continue;
            }
            ("type", Value::Array(all)) => match all.iter().filter(|t| *t != "null").collect::<Vec<_>>()[..] {
                [one] => one.clone(),
                ref several => json!(several),
            },
            ("enum", Value::Array(all)) => all.iter().filter(|v| !v.is_null()).cloned().collect(),
            ("anyOf" | "oneOf", Value::Array(all)) => {
                let branches: Vec<_> = all.iter().filter(|b| b["type"] != "null").map(plain).collect();
                match &branches[..] {
                    [Value::Object(only)] => {
                        out.extend(only.clone());
                        continue;
                    }
                    _ if branches.iter().all(|b| b["enum"].is_array()) => {
                        let values = branches.iter().flat_map(|b| b["enum"].as_array().cloned().unwrap_or_default());
                        out.insert("enum".into(), values.collect());
                        continue;
                    }
                    _ => branches.into(),
                }
            }
            ("items" | "additionalProperties", Value::Object(_)) => or_reference(plain(value)),
            ("items", Value::Array(each)) => each.iter().map(|s| or_reference(plain(s))).collect(),
            ("properties", Value::Object(all)) => {
                all.iter().map(|(k, s)| (k.clone(), parameter(s))).collect::<Map<_, _>>().into()
            }
            _ => value.clone(),
        };
        let word = if word == "oneOf" { "anyOf" } else { word };
        out.insert(word.to_string(), value);
    }
    Value::Object(out)
}

fn largest(format: &str) -> Option<u64> {
    match format {
        "uint8" => Some(u8::MAX.into()),
        "uint16" => Some(u16::MAX.into()),
        "uint32" => Some(u32::MAX.into()),
        "int32" => Some(i32::MAX as u64),
        _ => None,
    }
}

/// The schema, or a text that holds `${`. What takes any text takes that already.
fn or_reference(schema: Value) -> Value {
    let any_text = schema["type"] == "string"
        && ["enum", "pattern", "minLength", "maxLength"].iter().all(|w| schema.get(w).is_none());
    let reference = json!({"type": "string", "pattern": "\\$\\{"});
    match schema {
        schema if any_text => schema,
        Value::Object(mut map) if map.len() == 1 && map.get("anyOf").is_some_and(Value::is_array) => {
            if let Some(Value::Array(branches)) = map.get_mut("anyOf") {
                let takes_text =
                    |b: &Value| b["type"] == "string" && b.get("enum").is_none() && b.get("pattern").is_none();
                if !branches.iter().any(takes_text) {
                    branches.push(reference);
                }
            }
            Value::Object(map)
        }
        schema => json!({"anyOf": [schema, reference]}),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_of_parameters() {
        let given = json!({"type": ["integer", "null"], "format": "uint8", "minimum": 3, "default": null, "x-unit": "m", "description": "Few."});
        let wanted = json!({"anyOf": [{"type": "integer", "minimum": 3, "maximum": 255}, {"type": "string", "pattern": "\\$\\{"}], "description": "Few. [m]"});
        assert_eq!(parameter(&given), wanted);
        let given =
            json!({"oneOf": [{"const": "a", "type": "string"}, {"enum": ["b"], "type": "string"}], "default": "a"});
        assert_eq!(parameter(&given)["anyOf"][0], json!({"enum": ["a", "b"]}));
        assert_eq!(parameter(&json!({"type": "string"})), json!({"type": "string", "description": ""}));
    }

    #[test]
    fn the_schema_of_pipeline_files_is_fresh() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/pipeline.schema.json");
        let kept = std::fs::read_to_string(path).unwrap_or_default();
        assert!(kept == text(&crate::ops::ALL), "run `lodge schema > schemas/pipeline.schema.json`");
    }

    #[test]
    fn the_schema_of_events_is_fresh() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/events.schema.json");
        let kept = std::fs::read_to_string(path).unwrap_or_default();
        assert!(kept == events(), "run `lodge schema events > schemas/events.schema.json`");
    }
}
