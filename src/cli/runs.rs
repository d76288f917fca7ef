//! `lodge runs FILE`: the last runs of a pipeline: when, how long, what ran. What had nothing to do is not among them.

use serde_json::{Value, json};

use super::engine::{self, Place};
use super::run::time;
use super::{Exit, Globals, Outcome, Target};
use crate::run::event::Status;
use crate::run::history::{self, Run};

#[derive(clap::Args)]
pub struct Args {
    /// With --set: only runs with exactly these overrides
    #[command(flatten)]
    target: Target,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        self.target.load()?;
        let place = Place::of(globals, &self.target.file);
        let store = engine::look(&place)?;
        let mine = |name: &String| name.rsplit_once('-').is_some_and(|(pipeline, _)| pipeline == place.name);
        let (mut runs, mut damaged) = (Vec::new(), Vec::new());
        for name in history::names(&store).into_iter().rev().filter(mine) {
            match history::load(&store, &name) {
                Some(run) if run.file != place.file.to_string_lossy() => {}
                Some(run) if self.target.set.sets.is_empty() || run.sets == self.target.set.sets => runs.push(run),
                Some(_) => {}
                None => damaged.push(name),
            }
        }
        for name in &damaged {
            super::warn(&format!("the record of `{name}` is damaged; `lodge cache verify` removes it"));
        }
        if globals.json {
            let all: Vec<Value> = runs.iter().map(to_json).collect();
            super::print(&json!({"pipeline": place.name, "runs": all, "damaged": damaged}));
        } else if runs.is_empty() {
            super::say(&format!("{}: no runs in `{}`\n", place.name, place.cache.display()));
        } else {
            super::say(&table(&runs));
        }
        Ok(Exit::Done)
    }
}

/// The newest first.
fn table(runs: &[Run]) -> String {
    let width = runs.iter().map(|r| r.name.chars().count()).max().unwrap_or(0);
    let mut out = String::new();
    for run in runs {
        let parts: Vec<_> = Status::ALL.iter().map(|&s| (run.count(s), s.name())).filter(|p| p.0 > 0).collect();
        let mut words: Vec<String> = parts.iter().map(|(n, s)| format!("{n} {s}")).collect();
        if run.files > 0 {
            words.push(format!("{} of {} files written", run.written, run.files));
        }
        if run.interrupted {
            words.push("interrupted".to_string());
        }
        let sets: String = run.sets.iter().map(|s| format!("  --set {s}")).collect();
        out +=
            &format!("{:width$}  {}  {:>9}  {}{sets}\n", run.name, date(run.at), time(run.seconds), words.join(", "));
    }
    out
}

/// A run without its nodes.
pub fn to_json(run: &Run) -> Value {
    let mut out = json!({"name": run.name, "file": run.file, "set": run.sets, "at": run.at, "when": date(run.at),
        "seconds": run.seconds, "ok": run.ok, "interrupted": run.interrupted, "files": run.files,
        "written": run.written, "nodes": run.nodes.len()});
    Status::ALL.iter().for_each(|&s| out[s.name()] = run.count(s).into());
    out
}

/// `2026-11-23 16:54:11Z`, from seconds since 1970.
fn date(seconds: f64) -> String {
    let seconds = seconds.max(0.0) as u64;
    let (mut days, clock) = (seconds / 86_400, seconds % 86_400);
    let leap = |y: u64| y.is_multiple_of(4) && !y.is_multiple_of(100) || y.is_multiple_of(400);
    let mut year = 1970;
    while year < 9999 && days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let february = 28 + u64::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    let (h, m, s) = (clock / 3600, clock / 60 % 60, clock % 60);
    format!("{year:04}-{month:02}-{:02} {h:02}:{m:02}:{s:02}Z", days + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates() {
        assert_eq!(date(0.0), "1970-01-01 00:00:00Z");
        assert_eq!(date(951_782_400.5), "2000-02-29 00:00:00Z");
        assert_eq!(date(1_735_689_599.0), "2024-12-31 23:59:59Z");
        assert_eq!(date(4_107_542_400.0), "2100-03-01 00:00:00Z");
    }
}
