//! How parameters pick features and attributes: names, lists of names, numbers, conditions.

use std::borrow::Cow;
use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::json::Scalar;
use crate::artifact::{Cell, Table};
use crate::diag::{Diagnostic, Result, did_you_mean};

/// An attribute, or several of which the first present counts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Names {
    One(String),
    Several(Vec<String>),
}

impl Names {
    pub fn of(names: &[&str]) -> Self {
        Self::Several(names.iter().map(|n| n.to_string()).collect())
    }
    pub fn list(&self) -> &[String] {
        match self {
            Self::One(name) => std::slice::from_ref(name),
            Self::Several(names) => names,
        }
    }
    /// The first that the feature has.
    pub fn find<'f, 'a>(&self, properties: &'f [(Cow<'a, str>, Scalar<'a>)]) -> Option<&'f Scalar<'a>> {
        self.list().iter().find_map(|name| get(properties, name))
    }
}

/// A length in metres, or the attribute (of a list the first present) that holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Metres {
    Value(f64),
    One(String),
    Several(Vec<String>),
}

impl Metres {
    pub fn of(names: &[&str]) -> Self {
        Self::Several(names.iter().map(|n| n.to_string()).collect())
    }
    pub fn names(&self) -> &[String] {
        match self {
            Self::Value(_) => &[],
            Self::One(name) => std::slice::from_ref(name),
            Self::Several(names) => names,
        }
    }
    /// The first that the feature has and that can be read; true where one cannot.
    pub fn find(&self, properties: &[(Cow<str>, Scalar)]) -> (Option<f64>, bool) {
        if let Self::Value(v) = self {
            return (Some(*v), false);
        }
        let mut unreadable = false;
        for value in self.names().iter().filter_map(|n| get(properties, n)) {
            match metres(value) {
                Some(v) => return (Some(v), unreadable),
                None => unreadable = true,
            }
        }
        (None, unreadable)
    }
}

/// A number, or a text that holds one in plain decimals, with or without the unit `m` ("12.5", "12 m").
pub fn metres(value: &Scalar) -> Option<f64> {
    match value {
        Scalar::Number(v, _) => Some(*v),
        Scalar::Text(text) => {
            let text = text.trim();
            let text = text.strip_suffix('m').unwrap_or(text).trim_end();
            let plain = text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'.' | b'-' | b'+'));
            text.parse().ok().filter(|_| plain)
        }
        _ => None,
    }
    .filter(|v: &f64| v.is_finite())
}

/// Conditions that a feature must all fulfil: attribute = value, or one of a list.
pub type Where = BTreeMap<String, OneOf>;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum OneOf {
    One(Wanted),
    Several(Vec<Wanted>),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Wanted {
    Bool(bool),
    Number(f64),
    Text(String),
}

pub fn holds(conditions: &Where, properties: &[(Cow<str>, Scalar)]) -> bool {
    conditions.iter().all(|(name, wanted)| {
        let Some(value) = get(properties, name) else { return false };
        let wanted = match wanted {
            OneOf::One(w) => std::slice::from_ref(w),
            OneOf::Several(w) => w,
        };
        wanted.iter().any(|w| match (w, value) {
            (Wanted::Bool(a), Scalar::Bool(b)) => a == b,
            (Wanted::Number(a), Scalar::Number(b, _)) => a == b,
            (Wanted::Text(a), Scalar::Text(b)) => a == b,
            _ => false,
        })
    })
}

/// The feature's value of that name; null is none.
pub fn get<'f, 'a>(properties: &'f [(Cow<'a, str>, Scalar<'a>)], name: &str) -> Option<&'f Scalar<'a>> {
    properties.iter().find(|(k, _)| k == name).map(|(_, v)| v).filter(|v| **v != Scalar::Null)
}

/// An id as text: numbers as they are written.
pub fn id_text<'f>(value: &'f Scalar) -> Option<&'f str> {
    match value {
        Scalar::Text(t) if !t.is_empty() => Some(t),
        Scalar::Number(_, written) => Some(written),
        _ => None,
    }
}

/// What a feature is called: by the attributes `names`; where none are wanted, by its own id or the attribute `id`.
pub fn id_of<'f>(own: &'f Scalar, properties: &'f [(Cow<str>, Scalar)], names: &Names) -> Option<&'f str> {
    if names.list().is_empty() {
        return id_text(own).or_else(|| id_text(get(properties, "id")?));
    }
    names.list().iter().find_map(|name| id_text(get(properties, name)?))
}

/// Puts a feature's properties into the table: lists and objects as JSON text; whole numbers that no `f64` holds as
/// text, because they are names.
pub fn store(table: &mut Table, row: usize, properties: &[(Cow<str>, Scalar)]) {
    for (name, value) in properties {
        let cell = match value {
            Scalar::Bool(b) => Cell::Bool(*b),
            Scalar::Number(v, written) => {
                let exact = v.abs() <= 9_007_199_254_740_992.0 || written.contains(['.', 'e', 'E']);
                if !v.is_finite() {
                    continue;
                }
                if exact { Cell::Number(*v) } else { Cell::Text(written) }
            }
            Scalar::Text(t) => Cell::Text(t),
            Scalar::Nested(t) => Cell::Text(t),
            Scalar::Null => continue,
        };
        let column = table.column(name);
        table.set(row, column, cell);
    }
}

/// Single names must exist somewhere: which of the wanted attributes was ever seen, in any feature.
pub struct Seen {
    wanted: Vec<(&'static str, String, bool)>,
    missing: usize,
}

impl Seen {
    /// Pairs of a parameter and a name of which it is the only one.
    pub fn new(wanted: impl IntoIterator<Item = (&'static str, String)>) -> Self {
        let wanted: Vec<_> = wanted.into_iter().map(|(p, n)| (p, n, false)).collect();
        Self { missing: wanted.len(), wanted }
    }

    #[inline]
    pub fn look(&mut self, properties: &[(Cow<str>, Scalar)]) {
        if self.missing > 0 {
            for (_, name, seen) in self.wanted.iter_mut().filter(|w| !w.2) {
                *seen = get(properties, name).is_some();
                self.missing -= usize::from(*seen);
            }
        }
    }

    /// An error for the first that no feature had, with the nearest name of those that there are.
    pub fn finish<'n>(&self, names: impl Iterator<Item = &'n str>) -> Result<()> {
        let Some((param, name, _)) = self.wanted.iter().find(|w| !w.2) else { return Ok(()) };
        let message = format!("no feature has the attribute `{name}` that `{param}` names");
        let e = Diagnostic::error("unknown-attribute", message).value(name.clone());
        Err(e.help_nearest(did_you_mean(name, names)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_in_texts() {
        let read = |t: &str| metres(&Scalar::Text(t.into()));
        assert_eq!(["12.5", " 12 m ", "7m", "-3"].map(read), [Some(12.5), Some(12.0), Some(7.0), Some(-3.0)]);
        assert_eq!(["tall", "", "12 ft", "1e3", "nan", "inf", "1,5", "m"].map(read), [None; 8]);
        assert_eq!(metres(&Scalar::Number(f64::NAN, "NaN")), None);
    }

    #[test]
    fn conditions() {
        let p = vec![(Cow::from("layer"), Scalar::Text("road".into())), ("n".into(), Scalar::Number(3.0, "3"))];
        let when = |toml: &str| holds(&toml::from_str(toml).unwrap(), &p);
        assert!(when("") && when("layer = 'road'") && when("layer = ['rail', 'road']\nn = 3") && when("n = 3.0"));
        assert!(!when("layer = 'rail'") && !when("other = 1") && !when("n = '3'") && !when("layer = []"));
    }
}
