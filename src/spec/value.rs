//! TOML values with the place of every key and value.

use std::sync::Arc;

use serde_json::{Number, Value};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::diag::{Diagnostic, Diagnostics, SourceFile, Span};

/// A value, where it stands, and who wrote it.
#[derive(Clone, Debug)]
pub struct Val {
    pub data: Data,
    /// What a caret points at.
    pub span: Span,
    /// The text whose place relative paths start from: that of the value's first character.
    pub origin: Arc<SourceFile>,
}

#[derive(Clone, Debug)]
pub enum Data {
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(String),
    /// From `--set`: a number or a truth value that is its text where text is wanted.
    Either(Box<Data>, String),
    Date(String),
    List(Vec<Val>),
    Table(Table),
    /// Something was wrong with it, and has been said.
    Bad,
}

#[derive(Clone, Debug)]
pub struct Key {
    pub name: String,
    pub span: Span,
}

/// Entries in the order of the file.
#[derive(Clone, Debug, Default)]
pub struct Table(pub Vec<(Key, Val)>);

impl Table {
    pub fn get(&self, name: &str) -> Option<&Val> {
        self.entry(name).map(|(_, v)| v)
    }

    pub fn entry(&self, name: &str) -> Option<&(Key, Val)> {
        self.0.iter().find(|(k, _)| k.name == name)
    }

    pub fn get_mut(&mut self, name: &str) -> Option<&mut Val> {
        self.0.iter_mut().find(|(k, _)| k.name == name).map(|(_, v)| v)
    }

    pub fn remove(&mut self, name: &str) -> Option<(Key, Val)> {
        let at = self.0.iter().position(|(k, _)| k.name == name)?;
        Some(self.0.remove(at))
    }

    pub fn iter(&self) -> impl Iterator<Item = &(Key, Val)> {
        self.0.iter()
    }

    /// What `upper` says wins; tables merge, everything else replaces. Known keys keep their place in the order.
    pub fn merge(&mut self, upper: Table) {
        for (key, value) in upper.0 {
            match self.0.iter_mut().find(|(k, _)| k.name == key.name) {
                Some((old_key, old)) => {
                    *old_key = key;
                    match (&mut old.data, value) {
                        (Data::Table(below), Val { data: Data::Table(above), .. }) => below.merge(above),
                        (_, value) => *old = value,
                    }
                }
                None => self.0.push((key, value)),
            }
        }
    }
}

impl Val {
    pub fn text(&self) -> Option<&str> {
        match &self.data {
            Data::Text(t) | Data::Either(_, t) => Some(t),
            _ => None,
        }
    }

    pub fn table(&self) -> Option<&Table> {
        match &self.data {
            Data::Table(t) => Some(t),
            _ => None,
        }
    }

    pub fn list(&self) -> Option<&[Val]> {
        match &self.data {
            Data::List(l) => Some(l),
            _ => None,
        }
    }

    pub fn is_bad(&self) -> bool {
        match &self.data {
            Data::Bad => true,
            Data::List(all) => all.iter().any(Val::is_bad),
            Data::Table(all) => all.iter().any(|(_, v)| v.is_bad()),
            _ => false,
        }
    }

    /// `a number`, `the text "a"`: what was found, for a message.
    pub fn found(&self) -> String {
        match &self.data {
            Data::Text(t) => format!("the text {:?}", short(t)),
            Data::List(l) if l.is_empty() => "an empty list".into(),
            Data::List(_) => "a list".into(),
            Data::Table(_) => "a table".into(),
            Data::Date(d) => format!("the date {d}"),
            _ => self.data.label(),
        }
    }

    /// The value as the user would write it, shortened.
    pub fn written(&self) -> String {
        match &self.data {
            Data::Text(t) => format!("{:?}", short(t)),
            Data::List(l) => format!("[{}]", l.iter().map(Val::written).collect::<Vec<_>>().join(", ")),
            Data::Table(t) => {
                let inside: Vec<_> = t.iter().map(|(k, v)| format!("{} = {}", k.name, v.written())).collect();
                format!("{{ {} }}", inside.join(", "))
            }
            _ => self.data.label(),
        }
    }
}

impl Data {
    /// A scalar as it stands in names and inside texts: 1.0 is `1`, -0.0 is `0`. Lists and tables have none: empty.
    pub fn label(&self) -> String {
        match self {
            Data::Bool(b) => b.to_string(),
            Data::Int(i) => i.to_string(),
            // Not three hundred zeros.
            Data::Float(f) if f.abs() >= 1e16 => format!("{f:e}"),
            Data::Float(f) => (f + 0.0).to_string(),
            Data::Text(t) | Data::Date(t) => t.clone(),
            Data::Either(value, _) => value.label(),
            Data::List(_) | Data::Table(_) | Data::Bad => String::new(),
        }
    }

    /// `1` and `1.0` are the same number: an integral float below 2^53 is an integer. Tables lose their order.
    pub fn to_json(&self) -> Value {
        match self {
            Data::Bool(b) => Value::Bool(*b),
            Data::Int(i) => Value::from(*i),
            Data::Float(f) if f.fract() == 0.0 && f.abs() < 9_007_199_254_740_992.0 => Value::from(*f as i64),
            Data::Float(f) => Number::from_f64(*f).map_or(Value::Null, Value::Number),
            Data::Text(t) | Data::Date(t) => Value::String(t.clone()),
            Data::Either(value, _) => value.to_json(),
            Data::List(l) => l.iter().map(|v| v.data.to_json()).collect(),
            Data::Table(t) => Value::Object(t.iter().map(|(k, v)| (k.name.clone(), v.data.to_json())).collect()),
            Data::Bad => Value::Null,
        }
    }
}

fn short(text: &str) -> String {
    if text.chars().count() <= 60 { text.to_string() } else { text.chars().take(57).chain("...".chars()).collect() }
}

/// Takes parsed TOML over; numbers that are none (NaN, infinities, more than 64 bits) are mistakes.
pub struct Reader<'a> {
    file: &'a Arc<SourceFile>,
    /// Where the parsed text begins within the file.
    offset: usize,
    wrong: &'a mut Diagnostics,
    depth: usize,
}

/// Tables in lists in tables: deeper ones are refused, so that nothing that walks them can overflow.
pub const MOST_DEEP: usize = 100;

impl<'a> Reader<'a> {
    pub fn new(file: &'a Arc<SourceFile>, offset: usize, wrong: &'a mut Diagnostics) -> Self {
        Self { file, offset, wrong, depth: 0 }
    }

    pub fn table(&mut self, table: &DeTable) -> Table {
        let mut entries = Vec::with_capacity(table.len());
        for (key, value) in table.iter() {
            let key = Key { name: key.get_ref().to_string(), span: self.span(key.span()) };
            entries.push((key, self.value(value)));
        }
        Table(entries)
    }

    pub fn value(&mut self, value: &Spanned<DeValue>) -> Val {
        let span = self.span(value.span());
        if self.depth == MOST_DEEP {
            self.wrong.push(Diagnostic::error("too-deep", super::text::TOO_DEEP).at(span.clone()));
            return Val { data: Data::Bad, span, origin: self.file.clone() };
        }
        self.depth += 1;
        let data = match value.get_ref() {
            DeValue::String(s) => Data::Text(s.to_string()),
            DeValue::Boolean(b) => Data::Bool(*b),
            DeValue::Datetime(d) => Data::Date(d.to_string()),
            DeValue::Integer(i) => match i64::from_str_radix(i.as_str(), i.radix()) {
                Ok(n) => Data::Int(n),
                Err(_) => self.bad_number(&span, &i.to_string(), "does not fit in 64 bits"),
            },
            DeValue::Float(f) => match f.as_str().parse::<f64>() {
                Ok(n) if n.is_finite() => Data::Float(n),
                _ => self.bad_number(&span, f.as_str(), "is not a finite number"),
            },
            DeValue::Array(list) => Data::List(list.iter().map(|v| self.value(v)).collect()),
            DeValue::Table(table) => Data::Table(self.table(table)),
        };
        self.depth -= 1;
        Val { data, span, origin: self.file.clone() }
    }

    fn bad_number(&mut self, span: &Span, text: &str, why: &str) -> Data {
        self.wrong.push(Diagnostic::error("bad-number", format!("{text} {why}")).at(span.clone()).value(text));
        Data::Bad
    }

    fn span(&self, range: std::ops::Range<usize>) -> Span {
        Span { file: self.file.clone(), range: range.start + self.offset..range.end + self.offset }
    }
}
