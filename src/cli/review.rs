//! `lodge review [FILE [NODE..]]`: one pending snapshot after another, at a terminal, with the keys of `cargo insta review`.

use std::io::IsTerminal;

use console::{Key, Term, style};

use super::accept::Which;
use super::pending::Waiting;
use super::{Exit, Globals, Outcome, Stop, render};
use crate::diag::Diagnostic;

#[derive(clap::Args)]
#[command(after_help = KEYS)]
pub struct Args {
    #[command(flatten)]
    which: Which,
}

const KEYS: &str = "a accept, r reject, s skip; A, R, S: this one and all that follow; q quit";

/// What to do with one of them.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Word {
    Accept,
    Reject,
    Skip,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        if globals.json || !(std::io::stdin().is_terminal() && std::io::stdout().is_terminal()) {
            let message = "review asks at a terminal, and there is none";
            let help = "`lodge pending` lists what waits; `lodge accept` and `lodge reject` decide";
            return Err(Stop::usage(Diagnostic::error("no-terminal", message).help(help)));
        }
        let (all, wrong) = self.which.waiting()?;
        if !wrong.is_empty() {
            super::say(&render::text(&wrong, render::Style::for_stderr()));
        }
        if all.is_empty() && wrong.is_empty() {
            super::say("nothing is pending\n");
            return Ok(Exit::Done);
        }
        let [mut accepted, mut rejected] = [0, 0];
        let mut rest = None;
        for (k, one) in all.iter().enumerate() {
            let word = match rest {
                Some(word) => word,
                None => {
                    show(one, k + 1, all.len());
                    match ask()? {
                        Answer::One(word) => word,
                        Answer::All(word) => *rest.insert(word),
                        Answer::Quit => break,
                    }
                }
            };
            if word != Word::Skip && !one.is_as_shown() {
                let file = one.pending.path.display();
                super::say(&format!("{file} is another one since it was shown: left as it is; review it again\n"));
                continue;
            }
            let done = match word {
                Word::Accept => one.pending.accept().map(|()| accepted += 1),
                Word::Reject => one.pending.reject().map(|()| rejected += 1),
                Word::Skip => Ok(()),
            };
            done.map_err(|e| Diagnostic::error("snapshot", format!("{}: {e}", one.pending.path.display())))?;
        }
        let left = all.len() - accepted - rejected;
        super::say(&format!("{accepted} accepted, {rejected} rejected, {left} left\n"));
        let exit = if left == 0 { Exit::Done } else { Exit::Differs };
        Ok(if wrong.is_empty() { exit } else { exit.and(Exit::Failed) })
    }
}

fn show(one: &Waiting, number: usize, of: usize) {
    let mut out = format!("\n[{number}/{of}] {}\n", style(one.heading()).bold());
    for line in one.difference().lines() {
        let line = match line.as_bytes().first() {
            Some(b'-') => style(line).red(),
            Some(b'+') => style(line).green(),
            _ => style(line),
        };
        out += &format!("    {line}\n");
    }
    super::say(&out);
}

enum Answer {
    One(Word),
    All(Word),
    Quit,
}

/// Waits for a key that is one of [`KEYS`]. Ctrl-C ends the program as anywhere.
fn ask() -> Result<Answer, Stop> {
    loop {
        super::say(&format!("{KEYS}: "));
        let key = Term::stdout().read_key().map_err(|e| Diagnostic::error("no-terminal", format!("no key: {e}")))?;
        super::say("\n");
        if let Some(answer) = answer(&key) {
            return Ok(answer);
        }
    }
}

fn answer(key: &Key) -> Option<Answer> {
    Some(match key {
        Key::Char('a') | Key::Enter => Answer::One(Word::Accept),
        Key::Char('r') | Key::Escape => Answer::One(Word::Reject),
        Key::Char('s' | ' ') => Answer::One(Word::Skip),
        Key::Char('A') => Answer::All(Word::Accept),
        Key::Char('R') => Answer::All(Word::Reject),
        Key::Char('S') => Answer::All(Word::Skip),
        Key::Char('q') => Answer::Quit,
        _ => return None,
    })
}
