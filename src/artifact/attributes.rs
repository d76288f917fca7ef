//! Attribute tables: typed columns with gaps, and packed strings.

use serde::{Deserialize, Serialize};

use super::sections::{Decoder, Encoder, Field, get_json, put_json};
use crate::diag::Result;

/// Strings packed in one buffer.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Strings {
    /// n + 1 byte offsets into `text`.
    starts: Vec<u64>,
    text: String,
}

impl Strings {
    pub fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    pub fn push(&mut self, text: &str) {
        if self.starts.is_empty() {
            self.starts.push(0);
        }
        self.text.push_str(text);
        self.starts.push(self.text.len() as u64);
    }
    pub fn get(&self, i: usize) -> &str {
        &self.text[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &str> {
        (0..self.len()).map(|i| self.get(i))
    }
}

impl<S: AsRef<str>> FromIterator<S> for Strings {
    fn from_iter<I: IntoIterator<Item = S>>(all: I) -> Self {
        let mut out = Self { starts: vec![0], text: String::new() };
        all.into_iter().for_each(|s| out.push(s.as_ref()));
        out
    }
}

impl Field for Strings {
    fn put<'a>(&'a self, name: &str, out: &mut Encoder<'a>) {
        // An empty list has one canonical form.
        if self.starts.is_empty() {
            out.put(format!("{name}.starts"), 8, 0u64.to_le_bytes().to_vec());
        } else {
            self.starts.put(&format!("{name}.starts"), out);
        }
        self.text.put(&format!("{name}.text"), out);
    }
    fn get(name: &str, from: &mut Decoder) -> Result<Self> {
        let starts: Vec<u64> = Field::get(&format!("{name}.starts"), from)?;
        let text: String = Field::get(&format!("{name}.text"), from)?;
        let rising = starts.windows(2).all(|w| w[0] <= w[1]);
        let whole = starts.iter().all(|&s| text.is_char_boundary(s as usize));
        if !rising || !whole || starts.first() != Some(&0) || starts.last() != Some(&(text.len() as u64)) {
            return Err(from.broken(&format!("column `{name}` has wrong offsets")));
        }
        Ok(Self { starts, text })
    }
}

/// The values of one attribute, in the narrowest type that holds them all. A gap holds the type's default.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    U32(Vec<u32>),
    I32(Vec<i32>),
    F64(Vec<f64>),
    Bool(Vec<bool>),
    Text(Strings),
}

impl Values {
    pub fn len(&self) -> usize {
        match self {
            Self::U32(v) => v.len(),
            Self::I32(v) => v.len(),
            Self::F64(v) => v.len(),
            Self::Bool(v) => v.len(),
            Self::Text(v) => v.len(),
        }
    }
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// One attribute of all features.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    pub name: String,
    pub values: Values,
    /// False where the feature lacks the attribute (or it is null).
    pub present: Vec<bool>,
}

/// Attributes of n features, columns sorted by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Attributes {
    pub columns: Vec<Column>,
}

impl Attributes {
    pub fn get(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|c| c.name == name)
    }

    /// The same attributes for features `order[0]`, `order[1]`, ..
    pub fn select(&self, order: &[u32]) -> Self {
        fn pick<T: Copy>(v: &[T], order: &[u32]) -> Vec<T> {
            order.iter().map(|&i| v[i as usize]).collect()
        }
        let columns = self.columns.iter().map(|c| Column {
            name: c.name.clone(),
            present: pick(&c.present, order),
            values: match &c.values {
                Values::U32(v) => Values::U32(pick(v, order)),
                Values::I32(v) => Values::I32(pick(v, order)),
                Values::F64(v) => Values::F64(pick(v, order)),
                Values::Bool(v) => Values::Bool(pick(v, order)),
                Values::Text(v) => Values::Text(order.iter().map(|&i| v.get(i as usize)).collect()),
            },
        });
        Self { columns: columns.collect() }
    }
}

#[derive(Serialize, Deserialize)]
struct Header {
    name: String,
    kind: String,
}

impl Field for Attributes {
    fn put<'a>(&'a self, name: &str, out: &mut Encoder<'a>) {
        let header: Vec<Header> = self
            .columns
            .iter()
            .map(|c| Header {
                name: c.name.clone(),
                kind: match c.values {
                    Values::U32(_) => "u32",
                    Values::I32(_) => "i32",
                    Values::F64(_) => "f64",
                    Values::Bool(_) => "bool",
                    Values::Text(_) => "text",
                }
                .into(),
            })
            .collect();
        put_json(&header, &format!("{name}.columns"), out);
        for (i, c) in self.columns.iter().enumerate() {
            c.present.put(&format!("{name}.{i}.present"), out);
            let name = format!("{name}.{i}");
            match &c.values {
                Values::U32(v) => v.put(&name, out),
                Values::I32(v) => v.put(&name, out),
                Values::F64(v) => v.put(&name, out),
                Values::Bool(v) => v.put(&name, out),
                Values::Text(v) => v.put(&name, out),
            }
        }
    }
    fn get(name: &str, from: &mut Decoder) -> Result<Self> {
        let header: Vec<Header> = get_json(&format!("{name}.columns"), from)?;
        let mut columns = Vec::with_capacity(header.len());
        for (i, h) in header.into_iter().enumerate() {
            let present = Field::get(&format!("{name}.{i}.present"), from)?;
            let cell = format!("{name}.{i}");
            let values = match h.kind.as_str() {
                "u32" => Values::U32(Field::get(&cell, from)?),
                "i32" => Values::I32(Field::get(&cell, from)?),
                "f64" => Values::F64(Field::get(&cell, from)?),
                "bool" => Values::Bool(Field::get(&cell, from)?),
                "text" => Values::Text(Field::get(&cell, from)?),
                other => return Err(from.broken(&format!("attribute type `{other}`"))),
            };
            columns.push(Column { name: h.name, values, present });
        }
        Ok(Self { columns })
    }
}
