//! `--set KEY=VALUE`: a param, or a node's parameter, as a layer above the file.

use std::path::PathBuf;
use std::sync::Arc;

use toml::de::DeValue;

use super::value::{Data, Key, MOST_DEEP, Reader, Table, Val};
use crate::diag::{Diagnostic, Diagnostics, SourceFile, Span};

/// One override: where it goes, and what.
pub struct Override {
    /// `keep`, or `node`, `simple`, `keep`.
    pub path: Vec<Key>,
    pub value: Val,
}

impl Override {
    /// Reads `node.simple.keep=0.5`.
    pub fn read(text: &str, wrong: &mut Diagnostics) -> Option<Self> {
        let file = Arc::new(SourceFile { name: "--set".into(), path: PathBuf::new(), text: text.into() });
        let span = |range| Span { file: file.clone(), range };
        let bad = |range, message: &str| {
            Diagnostic::error("bad-set", message)
                .at(span(range))
                .value(text)
                .help("write `--set name=value`, or `--set node.name.parameter=value`")
        };
        let Some(equals) = text.find('=') else {
            wrong.push(bad(0..text.len(), "an override has no `=`"));
            return None;
        };
        let mut path = Vec::new();
        let mut at = 0;
        for part in text[..equals].split('.') {
            let name = part.trim();
            let from = at + (part.len() - part.trim_start().len());
            path.push(Key { name: name.to_string(), span: span(from..from + name.len()) });
            at += part.len() + 1;
        }
        let whole = path[0].name == "node";
        if path.iter().any(|k| k.name.is_empty()) || (whole && path.len() < 2) || (!whole && path.len() > 1) {
            wrong.push(bad(0..equals, "an override names a param, or `node.`, a node and its parameter"));
            return None;
        }
        if path.len() > MOST_DEEP {
            wrong.push(Diagnostic::error("too-deep", super::text::TOO_DEEP).at(span(0..equals)));
            return None;
        }
        Some(Self { path, value: value(&file, equals + 1, wrong) })
    }

    /// The override as nested tables, from the key after `skip` keys on.
    pub fn into_table(self, skip: usize) -> Table {
        let mut keys = self.path.into_iter().skip(skip).rev();
        let last = keys.next().expect("an override names something");
        keys.fold(Table(vec![(last, self.value)]), |inner, key| {
            let (span, origin) = (key.span.clone(), key.span.file.clone());
            Table(vec![(key, Val { data: Data::Table(inner), span, origin })])
        })
    }
}

/// A TOML value, or the text itself where that does not parse.
fn value(file: &Arc<SourceFile>, offset: usize, wrong: &mut Diagnostics) -> Val {
    let text = &file.text[offset..];
    let (parsed, errors) = DeValue::parse_recoverable(text);
    let mut trouble = Vec::new();
    let read = Reader::new(file, offset, &mut trouble).value(&parsed);
    let span = Span { file: file.clone(), range: offset..file.text.len() };
    let data = match read.data {
        _ if !errors.is_empty() || text.trim().is_empty() => Data::Text(text.to_string()),
        Data::Text(inside) => Data::Text(inside),
        Data::Date(_) | Data::Bad => Data::Text(text.to_string()),
        list @ (Data::List(_) | Data::Table(_)) => {
            wrong.append(&mut trouble);
            list
        }
        scalar => Data::Either(Box::new(scalar), text.to_string()),
    };
    Val { data, span, origin: file.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<(Vec<String>, String), String> {
        let mut wrong = Vec::new();
        match Override::read(text, &mut wrong) {
            Some(o) if wrong.is_empty() => {
                Ok((o.path.into_iter().map(|k| k.name).collect(), format!("{:?}", o.value.data.to_json())))
            }
            _ => Err(wrong[0].message.clone()),
        }
    }

    #[test]
    fn values_are_toml_or_text() {
        let value = |text: &str| read(&format!("k={text}")).unwrap().1;
        assert_eq!(value("0.5"), "Number(0.5)");
        assert_eq!(value("\"a b\""), "String(\"a b\")");
        assert_eq!(value("a b"), "String(\"a b\")");
        assert_eq!(value("../x=1.geojson"), "String(\"../x=1.geojson\")");
        assert_eq!(value("[1, 2"), "String(\"[1, 2\")");
        assert_eq!(value("[1, 2.0]"), "Array [Number(1), Number(2)]");
        assert_eq!(value(""), "String(\"\")");
        assert_eq!(value("2024-01-01"), "String(\"2024-01-01\")");
        assert_eq!(value("nan"), "String(\"nan\")");
    }

    #[test]
    fn keys_name_a_param_or_a_nodes_parameter() {
        assert_eq!(read("node.a.b=1").unwrap().0, ["node", "a", "b"]);
        assert_eq!(read(" keep =1").unwrap().0, ["keep"]);
        for bad in ["", "keep", "=1", "node=1", "a.b=1", "node..b=1", "node.=1"] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
