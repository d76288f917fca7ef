//! What a kill, a crowd, a disk and a stranger can do to a cache and its outputs, and that none of it matters.
//!
//! `cargo test --test abuse` is the short form; `LODGE_LONG=1 cargo test --release --test abuse -- --nocapture` the long
//! one, ten times as much. `LODGE_SEED=n` takes other random numbers.

#[path = "../support/mod.rs"]
mod support;
#[path = "../toy/mod.rs"]
mod toy;

mod damage;
mod gc;
mod hostile;
mod interrupts;
mod kills;
mod limits;
mod one_damage;
mod runs_at_once;

use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::Value;
use support::{Place, Random, binary, project};

/// `n` in the long form, a tenth of it in the short one.
fn times(n: usize) -> usize {
    if support::is_long() { n } else { n / 10 }
}

/// The town with a plan and a model at so many levels, and a tileset: `p.toml`.
fn town(levels: usize) -> Place {
    let place = Place::new();
    let levels: Vec<String> = (0..levels).map(|i| (20 + 5 * i).to_string()).collect();
    let base = project().join("pipelines/town.toml");
    let text = format!("extends = {base:?}\n[node.districts]\nmatrix.clusters = [{}]\n", levels.join(", "));
    place.write("p.toml", text);
    place
}

/// The binary in a process group of its own, with the cache and outputs of a place.
fn lodge(place: &Place, args: &[&str]) -> Command {
    let mut command = binary();
    command.current_dir(place.dir.path()).env("LODGE_CACHE", place.path("cache")).args(args);
    if !args.contains(&"--out") {
        command.arg("--out").arg(place.path("out"));
    }
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

fn kill_group(child: &mut Child) {
    let group = format!("-{}", child.id());
    assert!(Command::new("kill").args(["-9", "--", &group]).status().unwrap().success());
    child.wait().unwrap();
}

/// Names of the nodes with this status in what `run --json` printed.
fn names<'a>(run: &'a Value, status: &str) -> Vec<&'a str> {
    let nodes = run["nodes"].as_array().unwrap().iter().filter(|n| n["status"] == status);
    nodes.map(|n| n["name"].as_str().unwrap()).collect()
}

fn is_empty(folder: &Path) -> bool {
    std::fs::read_dir(folder).is_ok_and(|mut all| all.next().is_none())
}

/// Puts a folder back as it was in `from`, which is left alone.
fn copy(from: &Path, to: &Path) {
    let _ = std::fs::remove_dir_all(to);
    std::fs::create_dir_all(to.parent().unwrap()).unwrap();
    assert!(Command::new("cp").arg("-a").arg(from).arg(to).status().unwrap().success());
}
