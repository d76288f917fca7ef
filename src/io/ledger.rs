//! What became of every feature of an input: read = accepted + rejected + filtered, with causes.

use std::collections::BTreeMap;

use serde_json::json;

use crate::diag::{Diagnostic, Note, Report, Result};

/// Counts for one reader. Its facts: `read`, `accepted`, `rejected`, `filtered`; where not zero also
/// `filtered_by_where`, `filtered_by_type`, `rejected_by_cause`, `repaired_by_cause`.
pub struct Ledger<'r> {
    report: &'r Report,
    pub read: u64,
    by_where: u64,
    by_type: BTreeMap<String, u64>,
    rejected: BTreeMap<String, u64>,
    repaired: BTreeMap<String, u64>,
    first: Option<Note>,
}

/// How much of an input must be left, and the largest share of it that may be rejected.
#[derive(Clone, Copy, Debug)]
pub enum Needed {
    One { max_rejected: f64 },
    None { max_rejected: f64 },
}

/// Own keys of readers that filter.
pub const BY_WHERE: (&str, &str) = ("filtered_by_where", "filtered features, by `where`");
pub const BY_TYPE: (&str, &str) = ("filtered_by_type", "filtered features of each type of geometry or object");

/// What the counts mean, and a reader's own keys: M is 6 more than N.
pub const fn facts<const N: usize, const M: usize>(
    own: [(&'static str, &'static str); N],
) -> [(&'static str, &'static str); M] {
    let all = [
        ("read", "features in the input: accepted + rejected + filtered"),
        ("accepted", "features in the result"),
        ("rejected", "features left out because something is wrong with them; listed with id, place and cause"),
        ("filtered", "features not asked for"),
        ("rejected_by_cause", "rejected features of each cause"),
        ("repaired_by_cause", "features changed by a written rule, of each rule"),
    ];
    let mut out = [("", ""); M];
    let mut i = 0;
    while i < M {
        out[i] = if i < all.len() { all[i] } else { own[i - all.len()] };
        i += 1;
    }
    out
}

impl<'r> Ledger<'r> {
    pub fn new(report: &'r Report) -> Self {
        let none = BTreeMap::new;
        Self { report, read: 0, by_where: 0, by_type: none(), rejected: none(), repaired: none(), first: None }
    }

    pub fn filter_where(&mut self) {
        self.by_where += 1;
    }

    pub fn filter_type(&mut self, name: &str) {
        *self.by_type.entry(name.to_string()).or_default() += 1;
    }

    pub fn reject(&mut self, note: Note) {
        *self.rejected.entry(note.cause.clone()).or_default() += 1;
        if self.first.as_ref().is_none_or(|f| note < *f) {
            self.first = Some(note.clone());
        }
        self.report.reject(note);
    }

    /// The same, counted but not listed: for inputs of millions of nameless parts.
    pub fn reject_unlisted(&mut self, cause: &str) {
        *self.rejected.entry(cause.to_string()).or_default() += 1;
    }

    /// How many were rejected so far.
    pub fn rejected(&self) -> u64 {
        self.rejected.values().sum()
    }

    pub fn repair(&mut self, note: Note) {
        *self.repaired.entry(note.cause.clone()).or_default() += 1;
        self.report.repair(note);
    }

    /// The facts, and an error where too few of `what` are left.
    pub fn finish(self, what: &str, needed: Needed) -> Result<()> {
        let (Needed::One { max_rejected } | Needed::None { max_rejected }) = needed;
        let rejected: u64 = self.rejected.values().sum();
        let filtered = self.by_where + self.by_type.values().sum::<u64>();
        let wanted = self.read - filtered;
        let accepted = wanted - rejected;
        let fact = |key: &str, value: serde_json::Value| self.report.fact(key, value);
        fact("read", json!(self.read));
        fact("accepted", json!(accepted));
        fact("rejected", json!(rejected));
        fact("filtered", json!(filtered));
        if self.by_where > 0 {
            fact("filtered_by_where", json!(self.by_where));
        }
        for (key, counts) in [
            ("filtered_by_type", &self.by_type),
            ("rejected_by_cause", &self.rejected),
            ("repaired_by_cause", &self.repaired),
        ] {
            if !counts.is_empty() {
                fact(key, json!(counts));
            }
        }
        let example = self
            .first
            .as_ref()
            .map_or(String::new(), |n| format!("; the first: `{}` ({}): {}", n.id, n.place, n.cause));
        if accepted == 0 && matches!(needed, Needed::One { .. }) {
            let counts = format!("{} read, {filtered} filtered, {rejected} rejected{example}", self.read);
            return Err(Diagnostic::error("no-features", format!("no {what} in the input: {counts}")));
        }
        if rejected as f64 > max_rejected * wanted as f64 {
            let message =
                format!("{rejected} of {wanted} {what} were rejected, more than `max-rejected` allows{example}");
            return Err(Diagnostic::error("too-many-rejects", message).value(max_rejected.to_string()));
        }
        Ok(())
    }
}
