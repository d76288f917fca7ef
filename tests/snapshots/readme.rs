//! What README shows is what is printed.

use super::support::{self, Place};
use super::told;

/// README shows a difference as `lodge test` prints it.
#[test]
fn the_difference_of_readme_is_what_is_printed() {
    let readme = std::fs::read_to_string(support::project().join("README.md")).unwrap();
    let shown = readme.split("```diff\n").nth(1).expect("README shows a difference").split("```").next().unwrap();
    let home = Place::new();
    let town = support::project().join("pipelines/town.toml");
    let mut command = support::binary();
    command.current_dir(home.dir.path()).env("CI", "true").arg("--cache").arg(home.path("cache"));
    let (code, text) = told(&command.arg("test").arg(town).args(["--set", "node.hulls.keep=0.5"]).output().unwrap());
    assert_eq!(code, 3);
    assert!(shown.starts_with("differs: hulls\n") && shown.lines().count() > 15, "{shown}");
    let (_, text) = text.split_once("differs: hulls\n").expect("the hulls differ");
    let lines: Vec<&str> = text.lines().take_while(|l| l.starts_with("    ")).map(|l| &l[4..]).collect();
    assert_eq!(lines, shown.lines().skip(1).collect::<Vec<_>>());
}

/// README shows a first run, one with nothing to do, and why another would run: as they are printed, but for the times.
#[test]
fn the_runs_of_readme_are_what_is_printed() {
    let readme = std::fs::read_to_string(support::project().join("README.md")).unwrap();
    let shown = readme.split("```console\n").nth(1).expect("README shows runs").split("```").next().unwrap();
    let home = Place::new();
    // Times in the place of which stands `T`, white space by one space.
    let plain = |line: &str| {
        let mut words: Vec<&str> = line.split_whitespace().collect();
        for i in 1..words.len() {
            if ["ms", "s"].contains(&words[i]) && words[i - 1].parse::<f64>().is_ok() {
                (words[i - 1], words[i]) = ("T", "");
            }
        }
        words.retain(|w| !w.is_empty());
        words.join(" ")
    };
    let (mut printed, mut commands): (Vec<String>, usize) = (Vec::new(), 0);
    for line in shown.lines() {
        if let Some(command) = line.strip_prefix("$ lodge ") {
            assert!(printed.is_empty(), "not shown, and no `..` says so: {printed:?}");
            let mut lodge = support::binary();
            lodge
                .current_dir(support::project())
                .arg("--cache")
                .arg(home.path("cache"))
                .arg("--out")
                .arg(home.path("out"));
            let done = lodge.args(command.split(' ')).output().unwrap();
            assert!(done.status.success(), "{command}: {}", told(&done).1);
            printed = String::from_utf8(done.stdout).unwrap().lines().map(plain).collect();
            commands += 1;
        } else if line == ".." {
            // Whatever stands between, up to the last line.
            printed.drain(..printed.len() - 1);
        } else {
            assert!(!printed.is_empty(), "{line} is not printed");
            assert_eq!(printed.remove(0), plain(line));
        }
    }
    assert!(commands == 3 && printed.is_empty(), "{printed:?}");
}
