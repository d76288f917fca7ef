//! The command line: the list of commands and what they have in common. One command, one file; in each a struct
//! `Args` (clap) with `run(self, &Globals) -> Outcome`. A new command is three lines here.

mod accept;
mod cache;
mod check;
mod diff;
mod engine;
mod export;
mod graph;
mod ops;
mod pending;
mod plan;
mod progress;
mod reject;
pub mod render;
mod review;
mod run;
mod runs;
pub mod schema;
mod show;
mod test;
mod why;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand, ValueEnum};
use serde_json::json;

use crate::diag::{Diagnostic, Diagnostics};
use crate::graph::Graph;

/// Makes coarser versions of 3-D models that still read as what they are.
#[derive(Parser)]
#[command(name = "lodge", version, max_term_width = 100, disable_help_subcommand = true)]
struct Cli {
    #[command(flatten)]
    globals: Globals,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Pending snapshots become the snapshots
    Accept(accept::Args),
    /// Size and integrity of the cache
    Cache(cache::Args),
    /// Find every mistake that can be known without reading data
    Check(check::Args),
    /// Which nodes' results differ between two runs, and why
    Diff(diff::Args),
    /// Write a node's result in an open format
    Export(export::Args),
    /// The graph as Mermaid, DOT or SVG, with state and time
    Graph(graph::Args),
    /// The manual of the operators, from their own declarations
    Ops(ops::Args),
    /// List pending snapshots, and how they differ
    Pending(pending::Args),
    /// Tell what a run would do, and why
    Plan(plan::Args),
    /// Throw pending snapshots away
    Reject(reject::Args),
    /// Go through pending snapshots at a terminal
    Review(review::Args),
    /// Run what is needed and publish what writers made
    Run(run::Args),
    /// The last runs of a pipeline: when, how long, what ran
    Runs(runs::Args),
    /// The JSON Schema of pipeline files, for editors, or of --events
    Schema(schema::Args),
    /// Show the summary of a node's result
    Show(show::Args),
    /// Compare each stage with its snapshot
    Test(test::Args),
    /// Tell what makes a node run: old and new value
    Why(why::Args),
}

impl Command {
    fn run(self, globals: &Globals) -> Outcome {
        match self {
            Command::Accept(args) => args.run(globals),
            Command::Cache(args) => args.run(globals),
            Command::Check(args) => args.run(globals),
            Command::Diff(args) => args.run(globals),
            Command::Export(args) => args.run(globals),
            Command::Graph(args) => args.run(globals),
            Command::Ops(args) => args.run(globals),
            Command::Pending(args) => args.run(globals),
            Command::Plan(args) => args.run(globals),
            Command::Reject(args) => args.run(globals),
            Command::Review(args) => args.run(globals),
            Command::Run(args) => args.run(globals),
            Command::Runs(args) => args.run(globals),
            Command::Schema(args) => args.run(globals),
            Command::Show(args) => args.run(globals),
            Command::Test(args) => args.run(globals),
            Command::Why(args) => args.run(globals),
        }
    }
}

/// Flags that every command takes.
#[derive(Clone, Debug, Args)]
pub struct Globals {
    /// Cache folder [default: .lodge in the nearest folder above the pipeline that has .lodge or .git]
    #[arg(long, value_name = "DIR", env = "LODGE_CACHE", global = true, help_heading = "Global")]
    pub cache: Option<PathBuf>,
    /// Folder for published files [default: out beside the cache]
    #[arg(long, value_name = "DIR", global = true, help_heading = "Global")]
    pub out: Option<PathBuf>,
    /// Nodes and threads at work at once [default: number of processors]
    #[arg(short, long, value_name = "N", global = true, help_heading = "Global", value_parser = jobs)]
    pub jobs: Option<usize>,
    /// Memory that running nodes may take together; K, M and G are understood
    #[arg(long, value_name = "BYTES", global = true, help_heading = "Global", value_parser = bytes)]
    pub memory: Option<u64>,
    /// Stop at the first failed node; without it independent branches go on
    #[arg(long, global = true, help_heading = "Global")]
    pub fail_fast: bool,
    /// One JSON object on standard output, everything else on standard error
    #[arg(long, global = true, help_heading = "Global")]
    pub json: bool,
    /// Form of the log on standard error
    #[arg(long, value_name = "FORM", global = true, help_heading = "Global", default_value = "text")]
    pub log_format: LogFormat,
    /// Write what happens to a file, one JSON object a line, as `lodge schema events` says
    #[arg(long, value_name = "FILE", global = true, help_heading = "Global")]
    pub events: Option<PathBuf>,
    /// Say only what is wrong
    #[arg(short, long, global = true, help_heading = "Global", conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say more (twice: everything)
    #[arg(short, long, global = true, help_heading = "Global", action = clap::ArgAction::Count)]
    pub verbose: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    Text,
    Json,
}

/// A pipeline and its overrides: flattened into the `Args` of every command that takes FILE.
#[derive(Clone, Debug, Args)]
pub struct Target {
    /// Pipeline file
    pub file: PathBuf,
    #[command(flatten)]
    pub set: Set,
}

impl Target {
    pub fn load(&self) -> Result<Graph, Stop> {
        Ok(Graph::load(&self.file, &self.set.sets, &crate::ops::ALL)?)
    }
}

/// `--set`, for commands that take several files.
#[derive(Clone, Debug, Args)]
pub struct Set {
    /// Override a param (`keep=0.5`) or a node's parameter (`node.simple.keep=0.5`)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
}

impl Set {
    /// Settings that came without a pipeline are a mistake.
    pub fn of_no_file(&self) -> Result<(), Stop> {
        let Some(set) = self.sets.first() else { return Ok(()) };
        let error = Diagnostic::error("usage", format!("`--set {set}` of which pipeline?"));
        Err(Stop::usage(error.help("name its file before it")))
    }
}

/// How the program ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    Done = 0,
    /// A node failed.
    Failed = 1,
    /// Bad usage or a broken pipeline.
    Usage = 2,
    /// A snapshot differs or is pending.
    Differs = 3,
    /// The cache is damaged and cannot be repaired.
    Damaged = 4,
    Interrupted = 130,
}

impl Exit {
    /// Of two ends the one that is told: the first of 130, 2, 4, 1, 3, 0.
    pub fn and(self, other: Self) -> Self {
        let rank = |e| match e {
            Exit::Interrupted => 0,
            Exit::Usage => 1,
            Exit::Damaged => 2,
            Exit::Failed => 3,
            Exit::Differs => 4,
            Exit::Done => 5,
        };
        if rank(other) < rank(self) { other } else { self }
    }
}

/// An end with something to say.
#[derive(Debug)]
pub struct Stop {
    pub exit: Exit,
    pub diagnostics: Diagnostics,
}

impl Stop {
    pub fn usage(diagnostic: Box<Diagnostic>) -> Self {
        Self { exit: Exit::Usage, diagnostics: vec![diagnostic] }
    }
}

/// Mistakes of a pipeline.
impl From<Diagnostics> for Stop {
    fn from(diagnostics: Diagnostics) -> Self {
        Self { exit: Exit::Usage, diagnostics }
    }
}

/// Whatever went wrong later.
impl From<Box<Diagnostic>> for Stop {
    fn from(diagnostic: Box<Diagnostic>) -> Self {
        Self { exit: Exit::Failed, diagnostics: vec![diagnostic] }
    }
}

pub type Outcome = Result<Exit, Stop>;

/// The whole program.
pub fn main() -> ExitCode {
    let json = std::env::args_os().any(|a| a == "--json");
    let exit = match Cli::try_parse() {
        Ok(cli) => run(cli).unwrap_or_else(|stop| {
            tell(&stop.diagnostics, json);
            stop.exit
        }),
        Err(error) => {
            if json && error.use_stderr() {
                tell(&[Diagnostic::error("usage", usage_sentence(&error))], json);
            } else {
                let _ = error.print();
            }
            if error.use_stderr() { Exit::Usage } else { Exit::Done }
        }
    };
    let lost = LOST.load(std::sync::atomic::Ordering::Relaxed);
    let exit = if lost { exit.and(Exit::Failed) } else { exit };
    ExitCode::from(exit as u8)
}

fn run(cli: Cli) -> Outcome {
    progress::log(&cli.globals);
    cli.command.run(&cli.globals)
}

/// Diagnostics to standard error, or as the one JSON object to standard output.
fn tell(diagnostics: &[Box<Diagnostic>], json: bool) {
    if json {
        print(&json!({"ok": false, "diagnostics": render::all_json(diagnostics)}));
    } else {
        say_aside(&render::text(diagnostics, render::Style::for_stderr()));
    }
}

/// One JSON object on standard output. A reader that has gone away is no error.
pub fn print(object: &serde_json::Value) {
    say(&format!("{object:#}\n"));
}

/// Text on standard output. A reader that has gone away is no error; where it cannot be written otherwise (a full
/// disk), the end is that of a failure.
pub fn say(text: &str) {
    let mut out = std::io::stdout().lock();
    if let Err(error) = out.write_all(text.as_bytes()).and_then(|()| out.flush())
        && error.kind() != std::io::ErrorKind::BrokenPipe
    {
        say_aside(&format!("error: cannot write to standard output: {error}\n"));
        LOST.store(true, std::sync::atomic::Ordering::Relaxed);
    }
}

/// Text on standard error. Nobody is told where it cannot be written, and the work goes on: `eprintln!` would panic.
pub fn say_aside(text: &str) {
    let _ = std::io::stderr().lock().write_all(text.as_bytes());
}

pub fn warn(sentence: &str) {
    say_aside(&format!("warning: {sentence}\n"));
}

/// True once standard output could not be written.
static LOST: std::sync::atomic::AtomicBool = std::sync::atomic::AtomicBool::new(false);

fn usage_sentence(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let first = text.lines().next().unwrap_or_default();
    first.strip_prefix("error: ").unwrap_or(first).to_string()
}

fn jobs(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| (1..=1024).contains(n)).ok_or_else(|| "expected a number from 1 to 1024".to_string())
}

/// `1500000`, `64K`, `512M`, `1.5G` (powers of 1024).
fn bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = match text.to_ascii_uppercase().trim_end_matches('B').trim_end_matches('I') {
        t if t.ends_with('K') => (t[..t.len() - 1].to_string(), 1u64 << 10),
        t if t.ends_with('M') => (t[..t.len() - 1].to_string(), 1 << 20),
        t if t.ends_with('G') => (t[..t.len() - 1].to_string(), 1 << 30),
        t if t.ends_with('T') => (t[..t.len() - 1].to_string(), 1 << 40),
        t => (t.to_string(), 1),
    };
    let number: f64 = number.trim().parse().map_err(|_| "expected a number of bytes, as 512M".to_string())?;
    let bytes = number * unit as f64;
    if (1.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err("expected a number of bytes, as 512M".to_string()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_holds_together() {
        Cli::command().debug_assert();
    }

    #[test]
    fn the_gravest_end_is_told() {
        use Exit::*;
        let order = [Interrupted, Usage, Damaged, Failed, Differs, Done];
        for (i, a) in order.iter().enumerate() {
            for (j, b) in order.iter().enumerate() {
                assert_eq!(a.and(*b), order[i.min(j)]);
            }
        }
    }

    #[test]
    fn bytes_have_units() {
        assert_eq!(bytes("1500000"), Ok(1_500_000));
        assert_eq!(bytes("64k"), Ok(65_536));
        assert_eq!(bytes("1.5GiB"), Ok(3 << 29));
        for bad in ["", "G", "-1", "1e99", "nan", "ä"] {
            assert!(bytes(bad).is_err(), "{bad}");
        }
    }
}
