//! What a JSON Schema says of a value: the words that ours use, and no other.

use serde_json::Value;

/// Every word that does not hold, with its place; an unknown word is a mistake of the test.
pub fn mistakes(schema: &Value, value: &Value, at: &str, out: &mut Vec<String>) {
    if let Value::Bool(any) = schema {
        if !any {
            out.push(format!("{at}: nothing is allowed here"));
        }
        return;
    }
    let fits = |schema: &Value, value: &Value| {
        let mut bad = Vec::new();
        mistakes(schema, value, at, &mut bad);
        bad.is_empty()
    };
    let number = |what: &Value| what.as_f64().unwrap();
    let length = value.as_str().map(|s| s.chars().count()).or(value.as_array().map(Vec::len)).map(|n| n as f64);
    for (word, what) in schema.as_object().unwrap() {
        let good = match word.as_str() {
            "$schema" | "title" | "description" | "format" | "default" => true,
            "type" => match what {
                Value::Array(all) => all.iter().any(|t| is(t, value)),
                one => is(one, value),
            },
            "minimum" => value.as_f64().is_none_or(|v| v >= number(what)),
            "maximum" => value.as_f64().is_none_or(|v| v <= number(what)),
            "exclusiveMinimum" => value.as_f64().is_none_or(|v| v > number(what)),
            "exclusiveMaximum" => value.as_f64().is_none_or(|v| v < number(what)),
            "minLength" => !value.is_string() || length >= Some(number(what)),
            "maxLength" => !value.is_string() || length <= Some(number(what)),
            "minItems" => !value.is_array() || length >= Some(number(what)),
            "maxItems" => !value.is_array() || length <= Some(number(what)),
            "minProperties" => value.as_object().is_none_or(|v| v.len() as f64 >= number(what)),
            "uniqueItems" => {
                assert_eq!(what, true);
                value.as_array().is_none_or(|all| all.iter().enumerate().all(|(i, v)| !all[..i].contains(v)))
            }
            "const" => value == what,
            "enum" => what.as_array().unwrap().contains(value),
            "pattern" => value.as_str().is_none_or(|text| matches(what.as_str().unwrap(), text)),
            "required" => {
                !value.is_object() || what.as_array().unwrap().iter().all(|k| value.get(k.as_str().unwrap()).is_some())
            }
            "not" => !fits(what, value),
            "propertyNames" => value.as_object().is_none_or(|v| v.keys().all(|k| fits(what, &k.as_str().into()))),
            "properties" => {
                for (name, of) in what.as_object().unwrap() {
                    value.get(name).into_iter().for_each(|v| mistakes(of, v, &format!("{at}/{name}"), out));
                }
                true
            }
            "additionalProperties" => {
                let others = value.as_object().into_iter().flatten();
                for (name, v) in others.filter(|(k, _)| schema["properties"].get(k).is_none()) {
                    mistakes(what, v, &format!("{at}/{name}"), out);
                }
                true
            }
            "items" => {
                for (i, v) in value.as_array().into_iter().flatten().enumerate() {
                    let of = what.as_array().map_or(Some(what), |each| each.get(i));
                    of.into_iter().for_each(|of| mistakes(of, v, &format!("{at}/{i}"), out));
                }
                true
            }
            "oneOf" => what.as_array().unwrap().iter().filter(|s| fits(s, value)).count() == 1,
            "anyOf" => what.as_array().unwrap().iter().any(|s| fits(s, value)),
            other => panic!("`{other}` in the schema"),
        };
        if !good {
            out.push(format!("{at}: {word}: {value}"));
        }
    }
}

fn is(kind: &Value, value: &Value) -> bool {
    match kind.as_str().unwrap() {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.as_f64().is_some_and(|v| v.fract() == 0.0),
        "number" => value.is_number(),
        "null" => value.is_null(),
        other => panic!("type {other}"),
    }
}

/// The patterns that there are.
fn matches(pattern: &str, text: &str) -> bool {
    match pattern {
        "\\$\\{" => text.contains("${"),
        "^[a-z0-9]+(-[a-z0-9]+)*$" => lodge::spec::is_kebab(text),
        lodge::cli::schema::OUTSIDE => {
            ["", "."].contains(&text)
                || text.starts_with('/')
                || text.split('/').any(|part| part == "..")
                || text.contains(|c: char| c == '\\' || c.is_ascii_control())
        }
        other => panic!("pattern {other}"),
    }
}
