//! What lies in the output folder after runs that were killed, or that ran at once.

mod support;

use std::process::Stdio;
use std::time::Duration;

use support::{Place, binary, project};

const TOWN: &str = "pipelines/town.toml";

fn run(place: &Place, most: Option<u32>) -> std::process::Command {
    let mut command = binary();
    command.arg("run").arg(project().join(TOWN)).arg("--cache").arg(place.path("cache"));
    command.arg("--out").arg(place.path("out")).stdout(Stdio::null()).stderr(Stdio::null());
    if let Some(most) = most {
        command.arg("--set").arg(format!("node.tiles.max-triangles={most}"));
    }
    command
}

/// Tiles of other settings have other names: what a killed run had put there must go.
#[test]
fn a_killed_run_leaves_nothing_behind() {
    let place = Place::new();
    assert!(run(&place, None).status().unwrap().success());
    let right = place.published();
    // Cached, so that the killed runs have nothing to do but to publish.
    assert!(run(&place, Some(700)).status().unwrap().success());
    assert!(place.published().len() > right.len() + 20);
    let (mut kills, mut littered) = (0, 0);
    for round in 0..16 {
        assert!(run(&place, None).status().unwrap().success());
        assert_eq!(place.published(), right, "round {round}");
        let mut child = run(&place, Some(700)).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(2 + 3 * round));
        kills += usize::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        littered += usize::from(place.published() != right);
    }
    println!("{kills} killed at work, {littered} with files of theirs");
    assert!(run(&place, None).status().unwrap().success());
    assert_eq!(place.published(), right);
}

#[test]
fn runs_at_once_leave_one_runs_files() {
    let place = Place::new();
    assert!(run(&place, None).status().unwrap().success());
    let right = place.published();
    for round in 0..3 {
        let mut children: Vec<_> = (0..6).map(|i| run(&place, Some(700 + 100 * i)).spawn().unwrap()).collect();
        assert!(children.iter_mut().all(|c| c.wait().unwrap().success()));
        assert!(run(&place, None).status().unwrap().success());
        assert_eq!(place.published(), right, "round {round}");
    }
}
