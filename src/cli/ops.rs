//! `lodge ops [NAME]`: the manual of the operators, from their own declarations.

use super::{Exit, Globals, Outcome};

#[derive(clap::Args)]
pub struct Args {
    /// Operator; without it the list
    name: Option<String>,
}

impl Args {
    pub fn run(self, _globals: &Globals) -> Outcome {
        for entry in crate::ops::ALL.0 {
            if self.name.as_deref().is_none_or(|n| n == entry.name) {
                super::say(&format!("{}\n", entry.name));
            }
        }
        Ok(Exit::Done)
    }
}
