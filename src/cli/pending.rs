//! `lodge pending [FILE [NODE..]]`: the snapshots that wait for a word, and how each differs from what it would replace.

use std::io;

use serde_json::{Value, json};
use similar::{DiffOp, TextDiff};

use super::accept::{Which, unreadable};
use super::{Exit, Globals, Outcome, Stop, render};
use crate::diag::{Diagnostic, Diagnostics};
use crate::run::snapshot::{Pending, Snap};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    which: Which,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let (all, wrong) = self.which.waiting()?;
        let told: Vec<Value> = all.iter().map(Waiting::to_json).collect();
        if !wrong.is_empty() {
            if !globals.json {
                super::say(&all.iter().map(Waiting::to_text).collect::<String>());
            }
            return with_trouble(globals, json!({"ok": false, "pending": told}), &wrong);
        }
        if globals.json {
            super::print(&json!({"ok": all.is_empty(), "pending": told}));
        } else if !all.is_empty() {
            let many = format!("{} waiting; `lodge review`, `lodge accept` and `lodge reject` decide\n", all.len());
            super::say(&(all.iter().map(Waiting::to_text).collect::<String>() + &many));
        } else if !globals.quiet {
            super::say("nothing is pending\n");
        }
        Ok(if all.is_empty() { Exit::Done } else { Exit::Differs })
    }
}

/// What was done to the others, and which could not be read.
pub fn with_trouble(globals: &Globals, mut told: Value, wrong: &[Box<Diagnostic>]) -> Outcome {
    if globals.json {
        told["diagnostics"] = render::all_json(wrong);
        super::print(&told);
    } else {
        super::say_aside(&render::text(wrong, render::Style::for_stderr()));
    }
    Ok(Exit::Failed)
}

impl Which {
    /// The pending snapshots, read; and those that cannot be.
    pub fn waiting(&self) -> Result<(Vec<Waiting>, Diagnostics), Stop> {
        let (mut all, mut wrong) = (Vec::new(), Vec::new());
        for pending in self.pending()? {
            let trouble = pending.trouble.clone().map_or(Ok(()), |t| Err(io::Error::other(t)));
            match trouble.and_then(|()| Ok((pending.proposed()?, pending.old()?))) {
                Ok((new, old)) => all.push(Waiting { pending, old, new }),
                Err(e) => wrong.push(unreadable(&pending, &e.to_string())),
            }
        }
        Ok((all, wrong))
    }
}

/// A pending snapshot beside what it would replace.
pub struct Waiting {
    pub pending: Pending,
    pub old: Option<Snap>,
    pub new: Snap,
}

impl Waiting {
    /// Neither the file nor what it would replace is another one by now.
    pub fn is_as_shown(&self) -> bool {
        let is_link = self.pending.path.symlink_metadata().is_ok_and(|m| m.is_symlink());
        let now = self.pending.proposed().and_then(|new| Ok((new, self.pending.old()?)));
        !is_link && now.is_ok_and(|(new, old)| new == self.new && old == self.old)
    }

    pub fn verdict(&self) -> &'static str {
        if self.old.is_some() { "differs" } else { "new" }
    }

    /// Whose it is; where the operator is of another version, that as well.
    pub fn heading(&self) -> String {
        let mut out = format!("{}: {} ({})", self.verdict(), self.pending.node, self.pending.pipeline);
        let version = |snap: &Snap| Some(format!("{} {}", snap.info("op")?, snap.info("version")?));
        if let (Some(old), Some(new)) = (self.old.as_ref().and_then(version), version(&self.new))
            && old != new
        {
            out += &format!(", by {new}; was by {old}");
        }
        printable(&out)
    }

    /// Lines with `-` and `+`, or the text of what is new.
    pub fn difference(&self) -> String {
        printable(&match &self.old {
            Some(old) => difference(&old.contents, &self.new.contents),
            None => self.new.contents.lines().map(|l| format!("+{l}\n")).collect(),
        })
    }

    fn to_text(&self) -> String {
        let file = self.pending.path.display();
        format!("{}\n{}\n{file}\n\n", self.heading(), indented(&self.difference()))
    }

    fn to_json(&self) -> Value {
        let old = self.old.as_ref();
        json!({
            "pipeline": self.pending.pipeline,
            "node": self.pending.node,
            "verdict": self.verdict(),
            "snapshot": self.pending.path.with_extension(""),
            "file": self.pending.path,
            "old-digest": old.and_then(|s| s.info("digest")),
            "new-digest": self.new.info("digest"),
            "changes": changes(old.map_or("", |s| &s.contents), &self.new.contents),
            "diff": old.map(|s| difference(&s.contents, &self.new.contents)),
        })
    }
}

/// The changed lines of a snapshot with two around them.
pub fn difference(old: &str, new: &str) -> String {
    if old == new {
        return "the bytes differ, the summary does not".to_string();
    }
    TextDiff::from_lines(old, new).unified_diff().context_radius(2).missing_newline_hint(false).to_string()
}

/// Old line and new line; null where one is missing.
fn changes(old: &str, new: &str) -> Vec<Value> {
    let [old, new] = [old, new].map(|text| text.lines().collect::<Vec<_>>());
    let mut out = Vec::new();
    for op in TextDiff::from_slices(&old, &new).ops() {
        let ([old, new], same) = ([&old[op.old_range()], &new[op.new_range()]], matches!(op, DiffOp::Equal { .. }));
        for k in 0..if same { 0 } else { old.len().max(new.len()) } {
            out.push(json!({"old": old.get(k).map(|l| l.trim()), "new": new.get(k).map(|l| l.trim())}));
        }
    }
    out
}

pub fn indented(text: &str) -> String {
    text.lines().map(|l| format!("    {l}")).collect::<Vec<_>>().join("\n")
}

/// A file may come from anyone: nothing in it moves the cursor.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() && c != '\n' && c != '\t' { '\u{fffd}' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_pairs_of_lines() {
        let found = changes("Hulls\nedges: 4\n  n: 1\nstate: raw", "Hulls\nedges: 5\n  n: 1\n  m: 2\nstate: raw");
        assert_eq!(json!(found), json!([{"old": "edges: 4", "new": "edges: 5"}, {"old": null, "new": "m: 2"}]));
        assert_eq!(changes("a", "a"), [] as [Value; 0]);
    }

    #[test]
    fn nothing_in_a_file_moves_the_cursor() {
        assert_eq!(printable("a\x1b[2Jb\u{9b}c\r\n\td"), "a\u{fffd}[2Jb\u{fffd}c\u{fffd}\n\td");
    }
}
