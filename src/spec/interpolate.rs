//! `${name}` in node parameters. A value that is only `${name}` keeps its type; `$${` is a literal `${`.

use std::collections::BTreeSet;

use super::{Data, Table, Val};
use crate::diag::{Diagnostic, Diagnostics, Span, did_you_mean};

/// What `${..}` may name in one node: the params, and the axes that reach it.
pub struct Scope<'a> {
    pub params: &'a Table,
    pub axes: &'a [(String, Val)],
    /// The axes are not all known: an unknown name is no mistake of this node's.
    pub vague: bool,
}

impl Scope<'_> {
    /// The value with every `${name}` filled in; what cannot be is `Data::Bad`, and in `wrong`.
    pub fn fill(&self, value: &Val, wrong: &mut Diagnostics) -> Val {
        let data = match &value.data {
            Data::Text(text) if text.contains("${") => return self.fill_text(value, text, wrong),
            Data::List(list) => Data::List(list.iter().map(|v| self.fill(v, wrong)).collect()),
            Data::Table(table) => {
                Data::Table(Table(table.iter().map(|(k, v)| (k.clone(), self.fill(v, wrong))).collect()))
            }
            _ => return value.clone(),
        };
        Val { data, ..value.clone() }
    }

    fn fill_text(&self, value: &Val, text: &str, wrong: &mut Diagnostics) -> Val {
        let bad = Val { data: Data::Bad, ..value.clone() };
        let pieces = match pieces(text) {
            Ok(pieces) => pieces,
            Err(rest) => {
                let d = Diagnostic::error("bad-reference", format!("`{rest}` has no closing `}}`"));
                wrong.push(d.at(value.span.clone()).value(text).help("write `${name}`; `$${` is a literal `${`"));
                return bad;
            }
        };
        if let [Piece::Name(name)] = pieces[..] {
            return self.get(name, value, wrong).unwrap_or(bad);
        }
        let mut out = Val { data: Data::Text(String::new()), ..value.clone() };
        let mut all = String::new();
        let mut broken = false;
        for (i, piece) in pieces.iter().enumerate() {
            match piece {
                Piece::Text(t) => all.push_str(t),
                Piece::Name(name) => match self.get(name, value, wrong) {
                    None => broken = true,
                    Some(Val { data: Data::List(_) | Data::Table(_), .. }) => {
                        let sentence = format!("`${{{name}}}` is a list or a table and cannot stand inside a text");
                        wrong.push(Diagnostic::error("bad-reference", sentence).at(value.span.clone()).value(text));
                        broken = true;
                    }
                    Some(inner) => {
                        if i == 0 {
                            out.origin = inner.origin.clone();
                        }
                        match &inner.data {
                            Data::Bad => broken = true,
                            Data::Either(_, raw) => all.push_str(raw),
                            data => all.push_str(&data.label()),
                        }
                    }
                },
            }
        }
        if broken {
            return bad;
        }
        out.data = Data::Text(all);
        out
    }

    fn get(&self, name: &str, at: &Val, wrong: &mut Diagnostics) -> Option<Val> {
        if let Some((_, value)) = self.axes.iter().find(|(n, _)| n == name) {
            return Some(value.clone());
        }
        if let Some(value) = self.params.get(name) {
            return Some(value.clone());
        }
        if self.vague {
            return None;
        }
        let names = self.params.iter().map(|(k, _)| k.name.as_str()).chain(self.axes.iter().map(|(n, _)| n.as_str()));
        let nearest = did_you_mean(name, names);
        let d = Diagnostic::error(
            "unknown-param",
            format!("`${{{name}}}` names no param and no axis that reaches this node"),
        );
        wrong.push(d.at(at.span.clone()).value(format!("${{{name}}}")).help_nearest(nearest));
        None
    }
}

#[derive(Debug, PartialEq)]
enum Piece<'a> {
    Text(&'a str),
    Name(&'a str),
}

/// The text in pieces; the rest from an unclosed `${` on as an error.
fn pieces(text: &str) -> Result<Vec<Piece<'_>>, &str> {
    let mut out = Vec::new();
    let mut rest = text;
    while let Some(at) = rest.find("${") {
        let (before, from) = rest.split_at(at);
        if let Some(before) = before.strip_suffix('$') {
            out.extend([Piece::Text(before), Piece::Text("${")]);
            rest = &from[2..];
            continue;
        }
        let end = from.find('}').ok_or(from)?;
        out.extend([Piece::Text(before), Piece::Name(&from[2..end])]);
        rest = &from[end + 1..];
    }
    out.push(Piece::Text(rest));
    out.retain(|p| *p != Piece::Text(""));
    Ok(out)
}

/// Adds the names that `${..}` mentions anywhere in a value.
pub fn mentions(value: &Val, names: &mut BTreeSet<String>) {
    match &value.data {
        Data::Text(text) => {
            for piece in pieces(text).unwrap_or_default() {
                if let Piece::Name(name) = piece {
                    names.insert(name.to_string());
                }
            }
        }
        Data::List(list) => list.iter().for_each(|v| mentions(v, names)),
        Data::Table(table) => table.iter().for_each(|(_, v)| mentions(v, names)),
        _ => {}
    }
}

/// In a param: `$${` becomes `${`, and a `${` is reported.
pub fn literal(value: &mut Val, report: &mut impl FnMut(Span, &str)) {
    match &mut value.data {
        Data::Text(text) if text.contains("${") => {
            if text.replace("$${", "").contains("${") {
                report(value.span.clone(), text);
                value.data = Data::Bad;
            } else {
                *text = text.replace("$${", "${");
            }
        }
        Data::List(list) => list.iter_mut().for_each(|v| literal(v, report)),
        Data::Table(table) => table.0.iter_mut().for_each(|(_, v)| literal(v, report)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_a_text() {
        use Piece::*;
        assert_eq!(pieces("a-${b}.c"), Ok(vec![Text("a-"), Name("b"), Text(".c")]));
        assert_eq!(pieces("${b}"), Ok(vec![Name("b")]));
        assert_eq!(pieces("$${b}"), Ok(vec![Text("${"), Text("b}")]));
        assert_eq!(pieces("$$${b}"), Ok(vec![Text("$"), Text("${"), Text("b}")]));
        assert_eq!(pieces("a$b"), Ok(vec![Text("a$b")]));
        assert_eq!(pieces("a ${b"), Err("${b"));
        assert_eq!(pieces("${a}${b}"), Ok(vec![Name("a"), Name("b")]));
        assert_eq!(pieces("${}"), Ok(vec![Name("")]));
    }
}
