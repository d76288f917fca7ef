//! `lodge reject [FILE [NODE..]]`: pending snapshots are thrown away.

use super::accept::Which;
use super::{Globals, Outcome};
use crate::run::snapshot::Pending;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    which: Which,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        self.which.each(globals, "rejected", Pending::reject)
    }
}
