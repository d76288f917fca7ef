//! What becomes of snapshots that differ: listed, reviewed at a terminal, accepted by us or by insta; and of those
//! whose node is gone.

mod hostile;
mod readme;
#[path = "../support/mod.rs"]
mod support;
#[cfg(unix)]
mod terminal;

use std::collections::BTreeMap;
use std::process::{Command, Output};

use serde_json::{Value, json};
use support::Place;

const PIPELINE: &str = "[node.plan]\nop = \"read-geojson\"\npath = \"four.geojson\"\n\
    [node.tree]\nop = \"cluster\"\nin.footprints = \"plan\"\nmatrix.min-distance = [0.01, 0.1]\n";

/// Four squares in a row, and the stages `plan` and `tree`, the latter in two variants.
fn four() -> Place {
    let place = Place::new();
    place.write("four.geojson", squares(0.0001));
    place.write("four.toml", PIPELINE);
    place
}

fn squares(side: f64) -> String {
    let feature = |k: usize| {
        let [x, y] = [5.7 + 0.001 * k as f64, 53.8];
        let ring = [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side], [0.0, 0.0]].map(|p| [x + p[0], y + p[1]]);
        json!({"type": "Feature", "id": format!("s{k}"), "properties": {"height": 5.0},
            "geometry": {"type": "Polygon", "coordinates": [ring]}})
    };
    json!({"type": "FeatureCollection", "features": (0..4).map(feature).collect::<Vec<_>>()}).to_string()
}

/// Exit code, and both outputs.
fn told(done: &Output) -> (i32, String) {
    let text = [&done.stdout, &done.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
    (done.status.code().expect("it ends by itself"), text)
}

fn say(place: &Place, args: &[&str]) -> (i32, String) {
    told(&place.lodge(args))
}

/// Every file among the snapshots, with its text.
fn files(place: &Place) -> BTreeMap<String, String> {
    let entries = std::fs::read_dir(place.path("snapshots")).unwrap().map(|e| e.unwrap().path());
    entries.map(|p| (p.file_name().unwrap().to_str().unwrap().into(), std::fs::read_to_string(p).unwrap())).collect()
}

#[test]
fn what_waits_is_listed_with_what_changed() {
    let place = four();
    let pending = |args: &[&str]| -> (i32, Value) {
        let done = place.lodge(&[&["--json", "pending"], args].concat());
        (done.status.code().unwrap(), serde_json::from_slice(&done.stdout).unwrap())
    };
    assert_eq!(pending(&[]), (0, json!({"ok": true, "pending": []})));
    assert_eq!(say(&place, &["pending"]), (0, "nothing is pending\n".into()));

    say(&place, &["test", "four.toml"]);
    let (code, new) = pending(&[]);
    let nodes: Vec<&Value> = new["pending"].as_array().unwrap().iter().map(|p| &p["node"]).collect();
    assert_eq!(
        (code, nodes),
        (3, vec![&json!("plan"), &json!("tree[min-distance=0.01]"), &json!("tree[min-distance=0.1]")])
    );
    assert_eq!((&new["pending"][0]["verdict"], &new["pending"][0]["old-digest"]), (&json!("new"), &Value::Null));
    assert_eq!(new["pending"][0]["changes"][0], json!({"old": null, "new": "Footprints"}));

    say(&place, &["accept"]);
    let old = place.lodge_json(&["show", "four.toml", "plan"]);
    place.write("four.geojson", squares(0.0001001));
    assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    let (code, all) = pending(&["four.toml", "plan"]);
    assert_eq!((code, &all["ok"], all["pending"].as_array().unwrap().len()), (3, &json!(false), 1));
    let plan = &all["pending"][0];
    let new = place.lodge_json(&["show", "four.toml", "plan"]);
    assert_ne!(old["digest"], new["digest"]);
    assert_eq!((&plan["old-digest"], &plan["new-digest"]), (&old["digest"], &new["digest"]));
    assert_eq!(
        (&plan["pipeline"], &plan["node"], &plan["verdict"]),
        (&json!("four"), &json!("plan"), &json!("differs"))
    );
    let ends = |key: &str, end: &str| plan[key].as_str().unwrap().ends_with(end);
    assert!(ends("snapshot", "/four__plan.snap") && ends("file", "/four__plan.snap.new"), "{plan}");
    let changed = plan["changes"].as_array().unwrap();
    assert!(changed.iter().any(|c| c["old"] != c["new"] && c["old"].is_string() && c["new"].is_string()), "{plan}");
    for change in changed {
        for (key, sign) in [("old", '-'), ("new", '+')] {
            let Some(line) = change[key].as_str() else { continue };
            let diff = plan["diff"].as_str().unwrap();
            assert!(diff.lines().any(|l| l.starts_with(sign) && l.ends_with(line)), "{line} is not in {diff}");
        }
    }
    let (code, text) = say(&place, &["pending"]);
    assert!(code == 3 && text.contains("differs: plan (four)\n") && text.contains("\n    -"), "{text}");
    assert!(text.contains("four__plan.snap.new\n"), "{text}");
    assert_eq!(say(&place, &["pending", "four.toml", "roof"]).0, 2);
    assert_eq!(say(&place, &["pending", "none.toml"]).0, 2);
}

/// With other settings, the variants that there are then.
#[test]
fn settings_say_which_variants_are_meant() {
    let place = four();
    say(&place, &["test", "four.toml"]);
    let set = ["--set", "node.tree.matrix.min-distance=[0.1, 0.3]"];
    let waiting = |args: &[&str]| -> Vec<String> {
        let done = place.lodge(&[&["--json", "pending", "four.toml"], args].concat());
        let all: Value = serde_json::from_slice(&done.stdout).unwrap();
        all["pending"].as_array().unwrap().iter().map(|p| p["node"].as_str().unwrap().into()).collect()
    };
    assert_eq!(waiting(&set), ["plan", "tree[min-distance=0.1]"]);
    assert_eq!(say(&place, &["pending", "--set", "a=1"]).0, 2);
    assert_eq!(say(&place, &[&["accept", "four.toml"][..], &set].concat()).0, 0);
    assert_eq!(waiting(&[]), ["tree[min-distance=0.01]"]);
    assert_eq!(say(&place, &["reject", "four.toml", "--set", "nothing=1"]).0, 2);
    assert_eq!(waiting(&[]).len(), 1);
}

#[test]
fn snapshots_without_a_stage_are_told_and_fail_in_ci_and_stay() {
    let place = four();
    say(&place, &["test", "four.toml"]);
    say(&place, &["accept"]);
    // Of another pipeline, though its name begins alike.
    let other = files(&place)["four__plan.snap"].replace("source: four.toml", "source: four__b.toml");
    place.write("snapshots/four__b__plan.snap", other);
    let in_ci = |args: &[&str]| {
        let mut command = support::binary();
        command.current_dir(place.dir.path()).env("CI", "true").env("LODGE_CACHE", place.path("cache"));
        told(&command.arg("test").args(args).output().unwrap())
    };
    assert_eq!((say(&place, &["test", "four.toml"]).0, in_ci(&["four.toml"]).0), (0, 0));
    let before = files(&place);

    // Fewer variants by `--set` are a part of the pipeline: nothing is said of the others, and nothing is lost.
    let part = ["test", "four.toml", "--set", "node.tree.matrix.min-distance=[0.01]"];
    let (code, text) = say(&place, &part);
    assert!(code == 0 && text.contains("2 stages, 2 as they were\n") && !text.contains("any more"), "{code} {text}");
    assert_eq!(in_ci(&part[1..]).0, 0);
    assert_eq!(files(&place), before);

    // Fewer variants in the file.
    place.write("four.toml", PIPELINE.replace("[0.01, 0.1]", "[0.01]"));
    let gone = "four__tree-min-distance-0.1.snap";
    let (code, text) = say(&place, &["test", "four.toml"]);
    assert!(code == 0 && text.matches("no such stage any more: ").count() == 1 && text.contains(gone), "{code} {text}");
    for args in [&["four.toml"][..], &["-q", "four.toml"]] {
        let (code, text) = in_ci(args);
        assert!(code == 3 && text.contains(gone), "{code} {text}");
    }
    let json = place.lodge_json(&["test", "four.toml"]);
    assert_eq!(json["pipelines"][0]["orphans"].as_array().unwrap().len(), 1, "{json}");
    assert_eq!(files(&place), before);
}

#[test]
fn numbers_within_the_tolerance_keep_the_old_text_beside_the_new_digest() {
    let place = four();
    say(&place, &["test", "four.toml"]);
    say(&place, &["accept"]);
    let right = files(&place)["four__plan.snap"].clone();
    let digest = right.lines().find(|l| l.starts_with("  digest: ")).unwrap();
    // The first measure of the summary, a little or much larger, and another digest.
    let (line, area) = right
        .lines()
        .rev()
        .find_map(|l| Some((l, l.split_once(": ")?.1.parse::<f64>().ok().filter(|_| l.contains('.'))?)))
        .unwrap();
    let with = |factor: f64| {
        let (name, _) = line.split_once(": ").unwrap();
        right.replace(line, &format!("{name}: {}", area * factor)).replace(digest, "  digest: aa")
    };
    let test = |text: &str, more: &str, args: &[&str]| {
        place.write("four.toml", PIPELINE.replace("[node.tree]", &format!("{more}[node.tree]")));
        place.write("snapshots/four__plan.snap", text);
        let _ = std::fs::remove_file(place.path("snapshots/four__plan.snap.new"));
        let (code, text) = say(&place, &[&["test", "four.toml"], args].concat());
        assert_eq!(text.contains("differs: plan\n"), code == 3, "{text}");
        (code, files(&place))
    };
    let near = with(1.0 + 5e-10);
    assert!(near != right && !near.contains(digest));
    let (code, after) = test(&near, "", &[]);
    assert_eq!((code, &after["four__plan.snap"]), (0, &near.replace("  digest: aa", digest)));
    assert!(!after.contains_key("four__plan.snap.new"));
    // Else all stays, and what is new waits.
    let far = with(1.001);
    for (text, more, args, code) in [
        (&far, "", &[][..], 3),
        (&near, "snapshot.exact = true\n", &[], 3),
        (&near, "", &["--exact"], 3),
        (&near, "snapshot.rel = 0\nsnapshot.abs = 0\n", &[], 3),
        (&far, "snapshot.rel = 0.01\n", &[], 0),
        (&far, "snapshot.abs = 1\n", &[], 0),
        (&far, "snapshot.rel = 0\nsnapshot.abs = 1\n", &[], 0),
        (&far, "snapshot.abs = 0.0001\n", &[], 3),
    ] {
        let (found, after) = test(text, more, args);
        assert_eq!((found, after.contains_key("four__plan.snap.new")), (code, code == 3), "{more} {args:?}");
        assert_eq!(after["four__plan.snap"] == *text, code == 3, "{more} {args:?}");
    }
}

#[test]
fn a_node_without_snapshot_has_none_and_nothing_to_compare() {
    let place = four();
    let without = PIPELINE.replace("[node.tree]", "snapshot = false\n[node.tree]");
    place.write("four.toml", &without);
    let (code, text) = say(&place, &["test", "four.toml"]);
    assert!(code == 3 && text.contains("2 stages, 0 as they were, 2 new") && !text.contains("new: plan"), "{text}");
    say(&place, &["accept"]);
    let trees: Vec<String> = files(&place).into_keys().collect();
    assert_eq!(trees, ["four__tree-min-distance-0.01.snap", "four__tree-min-distance-0.1.snap"]);
    // One from before is no stage's, and another result is as good.
    place.write("four.toml", PIPELINE);
    say(&place, &["test", "four.toml"]);
    say(&place, &["accept"]);
    let right = files(&place)["four__plan.snap"].clone();
    let wrong = right.replace("Footprints\n", "Footprints\nforged: 1\n");
    assert_ne!(wrong, right);
    place.write("snapshots/four__plan.snap", &wrong);
    assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    std::fs::remove_file(place.path("snapshots/four__plan.snap.new")).unwrap();
    place.write("four.toml", &without);
    let (code, text) = say(&place, &["test", "four.toml"]);
    assert!(code == 0 && text.contains("2 stages, 2 as they were"), "{code} {text}");
    assert_eq!((files(&place).len(), &files(&place)["four__plan.snap"]), (3, &wrong));
}

#[test]
fn in_ci_no_snapshot_is_touched() {
    let place = four();
    let in_ci = |value: &str| {
        let mut command = support::binary();
        command.current_dir(place.dir.path()).env("CI", value).env("LODGE_CACHE", place.path("cache"));
        told(&command.args(["test", "four.toml"]).output().unwrap())
    };
    // New ones: not even the folder.
    assert_eq!(in_ci("true").0, 3);
    assert!(!place.path("snapshots").exists());
    say(&place, &["test", "four.toml"]);
    say(&place, &["accept", "four.toml", "tree"]);
    // One that waits although all is as it was, one with another digest beside the same text, one that differs.
    let mut texts = files(&place);
    let [small, large] = ["0.01", "0.1"].map(|d| format!("four__tree-min-distance-{d}.snap"));
    texts.insert(format!("{small}.new"), texts[&small].clone());
    let digest = texts[&small].lines().find(|l| l.starts_with("  digest: ")).unwrap().to_string();
    texts.insert(small.clone(), texts[&small].replace(&digest, "  digest: aa"));
    texts.insert(large.clone(), texts[&large].replace("leaves: 4", "leaves: 5"));
    for (name, text) in &texts {
        place.write(&format!("snapshots/{name}"), text);
    }
    let (code, text) = in_ci("1");
    assert!(code == 3 && text.contains("3 stages, 1 as they were, 1 differ, 1 new\n"), "{code} {text}");
    assert_eq!(files(&place), texts);
    // Elsewhere each of them is written.
    for none in ["", "0", "false"] {
        assert_eq!(in_ci(none).0, 3);
    }
    let after = files(&place);
    assert!(after[&small].contains(&digest) && !after.contains_key(&format!("{small}.new")), "{after:?}");
    assert!(after.contains_key(&format!("{large}.new")) && after[&large] == texts[&large], "{after:?}");
}

/// The Cargo project of README's lines in `place`, and how insta's own tool is called there. None where there is no tool.
fn cargo_project(place: &Place) -> Option<impl Fn() -> Command> {
    let folder = place.dir.path().to_path_buf();
    let insta = move || {
        let mut command = Command::new("cargo-insta");
        command.current_dir(&folder).env_remove("CI");
        command
    };
    if insta().arg("--version").output().is_err() {
        println!("skipped: no cargo-insta");
        return None;
    }
    let readme = std::fs::read_to_string(support::project().join("README.md")).unwrap();
    let stub = readme.split("```toml\n").find(|t| t.starts_with("[package]")).unwrap().split("```").next().unwrap();
    place.write("Cargo.toml", stub);
    Some(insta)
}

/// In a Cargo project (README: a few lines make one) insta's own tool lists and accepts our files.
#[test]
fn cargo_insta_lists_and_accepts_ours() {
    let place = four();
    let Some(insta) = cargo_project(&place) else { return };
    say(&place, &["test", "four.toml"]);
    let listed = told(&insta().arg("pending-snapshots").output().unwrap()).1;
    assert_eq!(listed.matches("\n  snapshots/four__").count(), 3, "{listed}");
    let ours: Vec<String> = files(&place).into_values().collect();
    assert_eq!(told(&insta().arg("accept").output().unwrap()).0, 0);
    assert_eq!(files(&place).into_values().collect::<Vec<_>>(), ours, "by its bytes what `lodge accept` makes");
    assert_eq!(say(&place, &["test", "--exact", "four.toml"]).0, 0);
}
