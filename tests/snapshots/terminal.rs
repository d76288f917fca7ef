//! Reviews at a terminal: keys are pressed through a pseudo-terminal.

use std::io::{Read, Write};
use std::process::Command;

use super::support::{self, Place};
use super::{cargo_project, files, four, say, squares};

/// Only what was shown is accepted.
#[test]
fn a_snapshot_that_changes_during_its_review_stays() {
    let place = four();
    say(&place, &["test", "four.toml"]);
    let file = place.path("snapshots/four__plan.snap.new");
    let mut change = |n: usize| {
        if n == 0 {
            let text = std::fs::read_to_string(&file).unwrap();
            std::fs::write(&file, text.replace("Footprints\n", "Footprints\nforged: 1\n")).unwrap();
        }
    };
    let Some((code, text)) = at_a_terminal_with(&place, &["review"], "aaa", &mut change) else { return };
    assert!(code == 3 && text.contains("four__plan.snap.new is another one since it was shown"), "{code} {text}");
    assert!(text.contains("2 accepted, 0 rejected, 1 left"), "{text}");
    assert!(!place.path("snapshots/four__plan.snap").exists());
    let mut gone = |n: usize| drop((n == 0).then(|| std::fs::remove_file(&file)));
    let (code, text) = at_a_terminal_with(&place, &["review"], "a", &mut gone).unwrap();
    assert!(code == 3 && text.contains("another one") && text.contains("0 accepted"), "{code} {text}");
}

/// `lodge` at a terminal: what it asks ends with its last choice. None where there is no pseudo-terminal.
fn at_a_terminal(place: &Place, args: &[&str], keys: &str) -> Option<(i32, String)> {
    at_a_terminal_with(place, args, keys, &mut |_| ())
}

/// And something happens before the n-th key.
fn at_a_terminal_with(
    place: &Place,
    args: &[&str],
    keys: &str,
    before: &mut dyn FnMut(usize),
) -> Option<(i32, String)> {
    let mut command = support::binary();
    command.current_dir(place.dir.path()).args(args);
    press(command, "q quit: ", keys, before)
}

/// Runs a command with a pseudo-terminal: each key is pressed once it is asked for. None where there is no such thing.
fn press(mut command: Command, asks: &str, keys: &str, before: &mut dyn FnMut(usize)) -> Option<(i32, String)> {
    let Ok(pty) = nix::pty::openpty(None, None) else {
        println!("skipped: no pseudo-terminal");
        return None;
    };
    let side = || pty.slave.try_clone().unwrap();
    let mut child = command.stdin(side()).stdout(side()).stderr(side()).spawn().unwrap();
    drop((command, pty.slave));
    let mut terminal = std::fs::File::from(pty.master);
    let (mut text, mut keys, mut seen) = (String::new(), keys.chars().enumerate(), 0);
    let mut bytes = [0; 4096];
    // The end of a terminal without another side is an error.
    while let Ok(n @ 1..) = terminal.read(&mut bytes) {
        text += &String::from_utf8_lossy(&bytes[..n]);
        while let Some(asked) = text[seen..].find(asks) {
            seen += asked + 1;
            match keys.next() {
                Some((n, key)) => {
                    before(n);
                    write!(terminal, "{key}").unwrap();
                }
                None => child.kill().unwrap(),
            }
        }
    }
    let code = child.wait().unwrap().code();
    assert!(keys.next().is_none(), "it did not ask: {text}");
    Some((code.unwrap_or_else(|| panic!("it asked for more: {text}")), text))
}

#[test]
fn a_review_at_a_terminal() {
    let place = four();
    let fresh = || {
        let _ = std::fs::remove_dir_all(place.path("snapshots"));
        assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    };
    let all = ["four__plan.snap", "four__tree-min-distance-0.01.snap", "four__tree-min-distance-0.1.snap"];
    let left = |names: &[&str]| assert_eq!(files(&place).into_keys().collect::<Vec<_>>(), names);
    let new = all.map(|n| format!("{n}.new"));

    fresh();
    let Some((code, text)) = at_a_terminal(&place, &["review"], "arxs") else { return };
    assert!(code == 3 && text.contains("1 accepted, 1 rejected, 1 left"), "{code} {text}");
    assert!(text.contains("[1/3]") && text.contains("new: plan (four)") && text.contains("+Footprints"), "{text}");
    assert!(text.contains("[3/3]") && text.contains("new: tree[min-distance=0.1] (four)"), "{text}");
    left(&[all[0], &new[2]]);
    for (keys, code, names) in [
        ("q", 3, [&new[0], &new[1], &new[2]].map(|n| &n[..]).to_vec()),
        ("rA", 0, vec![all[1], all[2]]),
        ("\rR", 0, vec![all[0]]),
        (" \x1bS", 3, vec![&new[0], &new[2]]),
    ] {
        fresh();
        let (found, text) = at_a_terminal(&place, &["review", "four.toml"], keys).unwrap();
        assert_eq!(found, code, "{keys:?}: {text}");
        left(&names);
    }
    fresh();
    assert_eq!(at_a_terminal(&place, &["review", "four.toml", "tree"], "aa").unwrap().0, 0);
    left(&[&new[0], all[1], all[2]]);
    assert_eq!(at_a_terminal(&place, &["accept"], "").unwrap().0, 0);

    // With its diff, against what was.
    place.write("four.geojson", squares(0.0001001));
    assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    let (code, text) = at_a_terminal(&place, &["review", "four.toml", "plan"], "a").unwrap();
    assert!(code == 0 && text.contains("differs: plan (four)"), "{text}");
    assert!(text.contains("    \x1b[31m-") || text.contains("    -"), "{text}");
    assert!(text.contains("    \x1b[32m+") || text.contains("    +"), "{text}");
    assert_eq!(at_a_terminal(&place, &["review", "four.toml"], "").unwrap().1.trim(), "nothing is pending");
}

#[test]
fn a_review_without_a_terminal_says_what_to_do_instead() {
    let place = four();
    say(&place, &["test", "four.toml"]);
    let before = files(&place);
    let (code, text) = say(&place, &["review"]);
    assert_eq!(code, 2, "{text}");
    for word in ["terminal", "`lodge pending`", "`lodge accept`", "`lodge reject`"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let (code, text) = say(&place, &["--json", "review"]);
    assert!(code == 2 && text.contains("\"no-terminal\""), "{text}");
    assert_eq!(files(&place), before);
}

/// insta's own tool, in a Cargo project of README's lines: it shows each of ours with its text and takes its key.
#[test]
fn cargo_insta_reviews_ours() {
    let place = four();
    let Some(insta) = cargo_project(&place) else { return };
    let review = |keys: &str| {
        let mut command = insta();
        command.arg("review").env("TERM", "xterm").env("NO_COLOR", "1");
        press(command, "toggle snapshot diff", keys, &mut |_| ())
    };
    assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    let ours: Vec<String> = files(&place).into_values().collect();
    let Some((code, text)) = review("asr") else { return };
    assert_eq!(code, 0, "{text}");
    for word in ["[1/3]", "snapshots/four__plan.snap", "+Footprints", "[3/3]", "four__tree-min-distance-0.1.snap"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let tree = "four__tree-min-distance-0.01.snap.new";
    assert_eq!(files(&place).into_keys().collect::<Vec<_>>(), ["four__plan.snap", tree], "{text}");
    assert_eq!(review("a").unwrap().0, 0);
    assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    assert_eq!(review("a").unwrap().0, 0);
    assert_eq!(files(&place).into_values().collect::<Vec<_>>(), ours, "by its bytes what `lodge accept` makes");
    let (code, text) = say(&place, &["test", "--exact", "four.toml"]);
    assert!(code == 0 && text.contains("3 stages, 3 as they were"), "{code} {text}");

    // With its difference from what was.
    place.write("four.geojson", squares(0.0001001));
    assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    let waiting = files(&place).into_keys().filter(|name| name.ends_with(".new")).count();
    let (code, text) = review(&"a".repeat(waiting)).unwrap();
    let (old, new) = (text.matches("│-").count(), text.matches("│+").count());
    assert!(code == 0 && old > 0 && new > 0, "{text}");
    assert_eq!(say(&place, &["test", "--exact", "four.toml"]).0, 0);
}
