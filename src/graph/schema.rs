//! One walker over an operator's own JSON Schema: checks a value word by word, names every mistake with its place,
//! and gives the value as JSON. The same schema goes to editors (`lodge schema`), so that both agree.

use serde_json::{Map, Value};

use crate::diag::{Diagnostic, Diagnostics, did_you_mean};
use crate::spec::{Data, Val};

/// The schema of one operator's parameters.
pub struct Walker<'a> {
    pub root: &'a Value,
    pub operator: &'a str,
    pub wrong: &'a mut Diagnostics,
}

impl Walker<'_> {
    /// Checks `value` against `schema`; `name` is what messages call it.
    pub fn check(&mut self, schema: &Value, value: &Val, name: &str) -> Value {
        let schema = resolve(self.root, schema);
        if let Data::Bad = value.data {
            return Value::Null;
        }
        let branches: Vec<_> = branches(schema).iter().map(|b| resolve(self.root, b)).filter(|b| !is_null(b)).collect();
        let allowed = constants(self.root, schema);
        if !allowed.is_empty() {
            return self.check_constant(schema, &allowed, value, name);
        }
        match branches[..] {
            [] => {}
            [one] => return self.check(&with_unit_of(schema, one), value, name),
            _ => return self.check_any(schema, &branches, value, name),
        }
        let parts = schema["allOf"].as_array().map_or(&[][..], Vec::as_slice);
        let given = parts.iter().fold(None, |_, part| Some(self.check(part, value, name)));
        let types = types(schema);
        if types.is_empty() {
            return given.unwrap_or_else(|| value.data.to_json());
        }
        match (&value.data, types.iter().find(|t| fits(t, &value.data))) {
            (Data::Either(inner, _), Some(_)) => {
                let inner = Val { data: (**inner).clone(), ..value.clone() };
                self.check(schema, &inner, name)
            }
            (Data::Either(_, text), None) if types.contains(&"string") => {
                let text = Val { data: Data::Text(text.clone()), ..value.clone() };
                self.check(schema, &text, name)
            }
            (_, None) => {
                let sentence = format!("`{name}` must be {}, got {}", wanted(self.root, schema), value.found());
                let d = mistake("wrong-type", value, sentence);
                self.wrong.push(match unquoted(schema, &types, value) {
                    Some(help) => d.help(help),
                    None => d,
                });
                Value::Null
            }
            (Data::List(list), _) => self.check_list(schema, list, value, name),
            (Data::Table(_), _) => self.check_table(schema, value, name),
            (Data::Text(text), _) => {
                let so_far = self.wrong.len();
                self.check_length(schema, ["minLength", "maxLength"], text.chars().count(), "character", value, name);
                if self.wrong.len() == so_far { value.data.to_json() } else { Value::Null }
            }
            (Data::Int(n), _) => self.check_range(schema, *n as f64, value, name),
            (Data::Float(n), _) => self.check_range(schema, *n, value, name),
            _ => value.data.to_json(),
        }
    }

    fn check_constant(&mut self, schema: &Value, allowed: &[&Value], value: &Val, name: &str) -> Value {
        let data = match &value.data {
            Data::Either(inner, text) if !allowed.contains(&&inner.to_json()) => Data::Text(text.clone()),
            data => data.clone(),
        };
        let json = data.to_json();
        if allowed.contains(&&json) {
            return json;
        }
        let names = allowed.iter().filter_map(|v| v.as_str());
        let near = value.text().and_then(|t| did_you_mean(t, names));
        let sentence = format!("`{name}` must be {}, got {}", wanted(self.root, schema), value.written());
        self.wrong.push(mistake("not-allowed", value, sentence).help_nearest(near));
        Value::Null
    }

    /// Any of several: of no fitting one the mistakes of that with the right type, if there is just one.
    fn check_any(&mut self, schema: &Value, branches: &[&Value], value: &Val, name: &str) -> Value {
        let mut mistakes = Vec::new();
        for branch in branches {
            let mut wrong = Vec::new();
            let inner = Walker { root: self.root, operator: self.operator, wrong: &mut wrong };
            let json = { inner }.check(&with_unit_of(schema, branch), value, name);
            if wrong.is_empty() {
                return json;
            }
            mistakes.push((branch, wrong));
        }
        let fitting = |branch: &Value| {
            let types = types(branch);
            types.is_empty() || types.iter().any(|t| fits(t, &value.data))
        };
        mistakes.retain(|(branch, _)| fitting(branch));
        if mistakes.len() == 1 {
            self.wrong.append(&mut mistakes[0].1);
        } else {
            let wanted = wanted(self.root, schema);
            self.mistake("wrong-type", value, format!("`{name}` must be {wanted}, got {}", value.found()));
        }
        Value::Null
    }

    fn check_list(&mut self, schema: &Value, list: &[Val], value: &Val, name: &str) -> Value {
        self.check_length(schema, ["minItems", "maxItems"], list.len(), "entry", value, name);
        let items = &schema["items"];
        let out = list.iter().enumerate().map(|(i, v)| {
            let one = items.as_array().map_or(Some(items), |each| each.get(i));
            match one {
                Some(one) if !one.is_null() => self.check(one, v, &format!("{name}[{i}]")),
                _ => v.data.to_json(),
            }
        });
        let out: Vec<_> = out.collect();
        if schema["uniqueItems"] == true {
            for (i, v) in list.iter().enumerate().filter(|(i, _)| out[..*i].contains(&out[*i])) {
                self.mistake("not-allowed", v, format!("`{name}[{i}]` says {} twice", v.written()));
            }
        }
        Value::Array(out)
    }

    fn check_table(&mut self, schema: &Value, value: &Val, name: &str) -> Value {
        let table = value.table().expect("only called on tables");
        let none = Map::new();
        let properties = schema["properties"].as_object().unwrap_or(&none);
        let mut out = Map::new();
        for (key, v) in table.iter() {
            let path = format!("{name}.{}", key.name);
            let inner = match (properties.get(&key.name), &schema["additionalProperties"]) {
                (Some(property), _) => property,
                (None, Value::Bool(false)) => {
                    let near = did_you_mean(&key.name, properties.keys().map(String::as_str));
                    let d = Diagnostic::error("unknown-parameter", format!("`{name}` has no `{}`", key.name));
                    self.wrong.push(d.at(key.span.clone()).value(&key.name).help_nearest(near));
                    continue;
                }
                (None, other) => other,
            };
            let json = if inner.is_object() { self.check(inner, v, &path) } else { v.data.to_json() };
            out.insert(key.name.clone(), json);
        }
        for key in required(schema).into_iter().filter(|k| table.get(k).is_none()) {
            self.mistake("missing-parameter", value, format!("`{name}` lacks `{key}`"));
        }
        Value::Object(out)
    }

    fn check_length(&mut self, schema: &Value, words: [&str; 2], n: usize, what: &str, value: &Val, name: &str) {
        let [least, most] = words.map(|w| schema[w].as_u64());
        let many = |n: u64| match (n, what) {
            (1, _) => format!("1 {what}"),
            (_, "entry") => format!("{n} entries"),
            _ => format!("{n} {what}s"),
        };
        let n = n as u64;
        let wanted = match (least, most) {
            (Some(l), Some(m)) if l == m && n != l => many(l),
            (Some(l), _) if n < l => format!("at least {}", many(l)),
            (_, Some(m)) if n > m => format!("at most {}", many(m)),
            _ => return,
        };
        self.mistake("wrong-length", value, format!("`{name}` must have {wanted}, got {n}"));
    }

    fn check_range(&mut self, schema: &Value, n: f64, value: &Val, name: &str) -> Value {
        let unit = schema["x-unit"].as_str().map(|u| format!(" {u}")).unwrap_or_default();
        for (word, sentence, holds) in bounds(schema) {
            if !holds(n) {
                let sentence = format!(
                    "`{name}` must be {sentence} {}{unit}, got {}{unit}",
                    Data::Float(word).label(),
                    value.data.label()
                );
                self.mistake("out-of-range", value, sentence);
                return Value::Null;
            }
        }
        value.data.to_json()
    }

    fn mistake(&mut self, code: &'static str, value: &Val, sentence: String) {
        self.wrong.push(mistake(code, value, sentence));
    }
}

fn mistake(code: &'static str, value: &Val, sentence: String) -> Box<Diagnostic> {
    Diagnostic::error(code, sentence).at(value.span.clone()).value(value.written())
}

/// Of a text where a number or a truth value is wanted: how to write what it seems to say.
fn unquoted(schema: &Value, types: &[&str], value: &Val) -> Option<String> {
    let text = value.text()?.trim();
    if types.contains(&"boolean") && (text == "true" || text == "false") {
        return Some(format!("write {text} without quotes"));
    }
    if !types.contains(&"number") && !types.contains(&"integer") {
        return None;
    }
    let end = text.find(|c: char| !c.is_ascii_digit() && !"+-._".contains(c)).unwrap_or(text.len());
    let number: f64 = text[..end].replace('_', "").parse().ok()?;
    let (digits, rest) = (&text[..end], text[end..].trim());
    match (rest, schema["x-unit"].as_str()) {
        ("", _) => Some(format!("write {digits} without quotes")),
        ("%", _) => Some(format!("write {}", number / 100.0)),
        (rest, Some(unit)) if rest == unit => Some(format!("write {digits}: it is in {unit}")),
        (_, Some(unit)) => Some(format!("write a number without quotes: it is in {unit}")),
        _ => Some("write a number without quotes".into()),
    }
}

/// Follows `$ref` within the schema.
pub fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    let mut at = schema;
    for _ in 0..16 {
        match at["$ref"].as_str().and_then(|r| r.strip_prefix('#')).and_then(|p| root.pointer(p)) {
            Some(next) => at = next,
            None => break,
        }
    }
    at
}

fn branches(schema: &Value) -> &[Value] {
    ["anyOf", "oneOf"].iter().find_map(|w| schema[*w].as_array()).map_or(&[], Vec::as_slice)
}

/// A branch says its bounds itself, but unit and bounds may stand beside `anyOf`.
fn with_unit_of(schema: &Value, branch: &Value) -> Value {
    let mut out = branch.clone();
    if let Value::Object(map) = &mut out {
        for word in ["x-unit", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"] {
            if let (None, Some(v)) = (map.get(word), schema.get(word)) {
                map.insert(word.into(), v.clone());
            }
        }
    }
    out
}

fn is_null(schema: &Value) -> bool {
    schema["type"] == "null"
}

/// The values that an enumeration allows; empty where it is none.
fn constants<'a>(root: &'a Value, schema: &'a Value) -> Vec<&'a Value> {
    if let Some(all) = schema["enum"].as_array() {
        return all.iter().filter(|v| !v.is_null()).collect();
    }
    if let Some(one) = schema.get("const") {
        return vec![one];
    }
    let mut out = Vec::new();
    for branch in branches(schema).iter().map(|b| resolve(root, b)).filter(|b| !is_null(b)) {
        let inner = constants(root, branch);
        if inner.is_empty() {
            return Vec::new();
        }
        out.extend(inner);
    }
    out
}

fn types(schema: &Value) -> Vec<&str> {
    match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(all) => all.iter().filter_map(Value::as_str).filter(|t| *t != "null").collect(),
        _ => Vec::new(),
    }
}

fn fits(kind: &str, data: &Data) -> bool {
    match data {
        Data::Bool(_) => kind == "boolean",
        Data::Int(_) => kind == "integer" || kind == "number",
        Data::Float(f) => kind == "number" || (kind == "integer" && f.fract() == 0.0 && f.abs() < 9e15),
        Data::Text(_) => kind == "string",
        Data::List(_) => kind == "array",
        Data::Table(_) => kind == "object",
        Data::Either(inner, _) => fits(kind, inner),
        Data::Date(_) | Data::Bad => false,
    }
}

/// Names that must be there: JSON Schema's own word, and `x-required` beside a container's default.
pub fn required(schema: &Value) -> Vec<String> {
    let own = schema["required"].as_array().into_iter().flatten().filter_map(|v| v.as_str().map(String::from));
    let marked = schema["properties"].as_object().into_iter().flatten();
    let marked = marked.filter(|(_, p)| p["x-required"] == true).map(|(k, _)| k.clone());
    let mut out: Vec<_> = own.chain(marked).collect();
    out.sort();
    out.dedup();
    out
}

type Holds = Box<dyn Fn(f64) -> bool>;

/// Bounds of a number: the schema's, and those of integer formats (which have no `maximum` of their own).
fn bounds(schema: &Value) -> Vec<(f64, &'static str, Holds)> {
    let mut out: Vec<(f64, &'static str, Holds)> = Vec::new();
    let word = |w: &str| schema[w].as_f64();
    if let Some(b) = word("minimum") {
        out.push((b, "at least", Box::new(move |n| n >= b)));
    }
    if let Some(b) = word("exclusiveMinimum") {
        out.push((b, "more than", Box::new(move |n| n > b)));
    }
    if let Some(b) = word("maximum") {
        out.push((b, "at most", Box::new(move |n| n <= b)));
    }
    if let Some(b) = word("exclusiveMaximum") {
        out.push((b, "less than", Box::new(move |n| n < b)));
    }
    let (low, high) = match schema["format"].as_str() {
        Some("uint8") => (0.0, f64::from(u8::MAX)),
        Some("uint16") => (0.0, f64::from(u16::MAX)),
        Some("uint32") => (0.0, f64::from(u32::MAX)),
        Some("uint" | "uint64" | "uint128") => (0.0, f64::INFINITY),
        Some("int8") => (f64::from(i8::MIN), f64::from(i8::MAX)),
        Some("int16") => (f64::from(i16::MIN), f64::from(i16::MAX)),
        Some("int32") => (f64::from(i32::MIN), f64::from(i32::MAX)),
        Some("float") => (f64::from(f32::MIN), f64::from(f32::MAX)),
        _ => return out,
    };
    out.push((low, "at least", Box::new(move |n| n >= low)));
    out.push((high, "at most", Box::new(move |n| n <= high)));
    out
}

/// What a schema asks for, in words: `a number`, `one of "mean", "median"`, `a text or a list of texts`.
pub fn wanted(root: &Value, schema: &Value) -> String {
    let schema = resolve(root, schema);
    let constants = constants(root, schema);
    match constants[..] {
        [] => {}
        [one] => return one.to_string(),
        _ => {
            let names: Vec<_> = constants.iter().map(ToString::to_string).collect();
            return format!("one of {}", names.join(", "));
        }
    }
    let branches: Vec<_> = branches(schema).iter().map(|b| resolve(root, b)).filter(|b| !is_null(b)).collect();
    let mut words: Vec<String> = if branches.is_empty() {
        types(schema).iter().map(|t| type_in_words(root, schema, t)).collect()
    } else {
        branches.iter().map(|b| wanted(root, b)).collect()
    };
    words.dedup();
    match words.pop() {
        None => "a value".into(),
        Some(last) if words.is_empty() => last,
        Some(last) => format!("{} or {last}", words.join(", ")),
    }
}

fn type_in_words(root: &Value, schema: &Value, kind: &str) -> String {
    match kind {
        "integer" => "a whole number".into(),
        "number" => "a number".into(),
        "string" => "a text".into(),
        "boolean" => "true or false".into(),
        "object" => "a table".into(),
        "array" => match &schema["items"] {
            Value::Object(_) => {
                let inside = wanted(root, &schema["items"]);
                match inside.strip_prefix("a ") {
                    Some(noun) if !noun.contains(' ') || noun == "whole number" => format!("a list of {noun}s"),
                    _ => format!("a list, each {inside}"),
                }
            }
            Value::Array(each) => format!("a list of {} values", each.len()),
            _ => "a list".into(),
        },
        other => other.into(),
    }
}
