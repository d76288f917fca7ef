//! What is wrong and where (`Diagnostic`), and what was repaired or left out on the way (`Report`).

use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use serde::{Deserialize, Serialize};
use serde_json::Value;

pub type Result<T, E = Box<Diagnostic>> = std::result::Result<T, E>;

/// All mistakes of a file at once.
#[allow(clippy::vec_box)] // each was made as a box, and goes on alone as one
pub type Diagnostics = Vec<Box<Diagnostic>>;

/// A piece of a text file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Span {
    pub file: Arc<SourceFile>,
    /// Bytes.
    pub range: Range<usize>,
}

/// A text that diagnostics can point into.
#[derive(Debug, PartialEq, Eq)]
pub struct SourceFile {
    /// As the user would write it.
    pub name: String,
    /// Where it was read; empty for text that is no file (`--set`).
    pub path: PathBuf,
    pub text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    Error,
    Warning,
}

/// One mistake: a lowercase sentence, its place, the offending value, a hint.
#[derive(Clone, Debug)]
pub struct Diagnostic {
    /// Stable, kebab-case: `unknown-parameter`, `bad-geojson`, ..
    pub code: &'static str,
    pub severity: Severity,
    pub message: String,
    pub span: Option<Span>,
    /// The node, where one is to blame.
    pub node: Option<String>,
    /// The offending value as the user wrote it.
    pub value: Option<String>,
    /// "did you mean ..", the remedy.
    pub suggestion: Option<String>,
}

impl Diagnostic {
    pub fn error(code: &'static str, message: impl Into<String>) -> Box<Self> {
        Box::new(Self {
            code,
            severity: Severity::Error,
            message: message.into(),
            span: None,
            node: None,
            value: None,
            suggestion: None,
        })
    }

    pub fn at(mut self: Box<Self>, span: Span) -> Box<Self> {
        self.span = Some(span);
        self
    }

    pub fn value(mut self: Box<Self>, value: impl Into<String>) -> Box<Self> {
        self.value = Some(value.into());
        self
    }

    pub fn help(mut self: Box<Self>, suggestion: impl Into<String>) -> Box<Self> {
        self.suggestion = Some(suggestion.into());
        self
    }

    /// "did you mean `x`?", where there is a near name.
    pub fn help_nearest(self: Box<Self>, nearest: Option<String>) -> Box<Self> {
        match nearest {
            Some(name) => self.help(format!("did you mean `{name}`?")),
            None => self,
        }
    }

    pub fn node(mut self: Box<Self>, node: impl Into<String>) -> Box<Self> {
        self.node = Some(node.into());
        self
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(node) = &self.node {
            write!(f, "node `{node}`: ")?;
        }
        write!(f, "{}", self.message)?;
        if let Some(help) = &self.suggestion {
            write!(f, " ({help})")?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostic {}

/// The name nearest to a wrong one, if any is near enough to be meant; of equally near ones the first.
pub fn did_you_mean<'a>(wrong: &str, names: impl IntoIterator<Item = &'a str>) -> Option<String> {
    if wrong.is_empty() || wrong.len() > 200 {
        return None;
    }
    let most = (wrong.chars().count() / 3).max(1);
    let plain = |s: &str| s.to_lowercase().replace('_', "-");
    let plain_wrong = plain(wrong);
    let (letters, length) = letters(wrong);
    // An edit changes the length by one at most and the letters by two: most names need no closer look.
    let may_be = |name: &&str| {
        let (other, count) = self::letters(name);
        count.abs_diff(length) as usize <= most && (letters ^ other).count_ones() as usize <= 2 * most
    };
    let distance = |name: &str| strsim::osa_distance(&plain_wrong, &plain(name));
    let near = names.into_iter().filter(may_be).map(|name| (distance(name), name)).min_by_key(|&(d, _)| d)?;
    (near.0 <= most).then(|| near.1.to_string())
}

/// Which letters a name has, a bit for each, and how many; capitals are small ones, `_` is `-`.
fn letters(name: &str) -> (u64, u32) {
    name.chars().fold((0, 0), |(all, count), c| {
        let c = if c == '_' { '-' } else { c.to_ascii_lowercase() };
        let bit = if c.is_ascii() { u32::from(c) % 63 } else { 63 };
        (all | 1 << bit, count + 1)
    })
}

/// One feature that was repaired or rejected.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Note {
    /// Order in the input (row); notes come out sorted by it.
    pub row: u64,
    pub id: String,
    /// File and line, or whatever finds it in the source.
    pub place: String,
    /// Stable sentence: notes are counted by it.
    pub cause: String,
}

/// What an operator says beside its result. Stored with it, so that a cached node tells the same things.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Findings {
    pub warnings: Vec<String>,
    /// Features left out.
    pub rejects: Vec<Note>,
    /// Features changed by a written rule.
    pub repairs: Vec<Note>,
    /// Further lines of the summary: counts, tables. Keys are stable and documented.
    pub facts: BTreeMap<String, Value>,
}

impl Findings {
    /// What any summary may say beside, and what it means.
    pub const KEYS: &[(&str, &str)] =
        &[("rejects", "features left out, by cause"), ("repairs", "features changed by a written rule, by cause")];
}

/// Collects [`Findings`] from any number of threads; what comes out does not depend on their order.
#[derive(Debug, Default)]
pub struct Report(Mutex<Findings>);

impl Report {
    pub fn warn(&self, sentence: impl Into<String>) {
        self.0.lock().unwrap().warnings.push(sentence.into());
    }

    pub fn reject(&self, note: Note) {
        self.0.lock().unwrap().rejects.push(note);
    }

    pub fn repair(&self, note: Note) {
        self.0.lock().unwrap().repairs.push(note);
    }

    pub fn fact(&self, key: &str, value: impl Into<Value>) {
        self.0.lock().unwrap().facts.insert(key.to_string(), value.into());
    }

    pub fn finish(self) -> Findings {
        let mut all = self.0.into_inner().unwrap();
        all.warnings.sort();
        all.warnings.dedup();
        all.rejects.sort();
        all.repairs.sort();
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quick_look_at_names_loses_none() {
        let words = [
            "keep",
            "Keep",
            "kepe",
            "k_eep",
            "k-eep",
            "keeep",
            "peek",
            "eekp",
            "größe",
            "grösse",
            "a",
            "",
            "oo00",
            "footprint",
            "foot-prints",
        ];
        assert_eq!(did_you_mean("", ["a"]), None);
        for wrong in words.into_iter().filter(|w| !w.is_empty()) {
            for name in words {
                let most = (wrong.chars().count() / 3).max(1);
                let plain = |s: &str| s.to_lowercase().replace('_', "-");
                let near = strsim::osa_distance(&plain(wrong), &plain(name)) <= most;
                assert_eq!(did_you_mean(wrong, [name]).is_some(), near, "{wrong} {name}");
            }
        }
        assert_eq!(did_you_mean("kep", ["kap", "keep", "kept"]).as_deref(), Some("kap"), "of equal ones the first");
    }
}
