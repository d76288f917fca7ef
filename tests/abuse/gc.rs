//! `lodge cache gc`: what it takes, and what it never takes.

use std::process::Stdio;
use std::time::Duration;

use serde_json::json;

use super::limits::SQUARES;
use super::support::Place;
use super::toy::tree;
use super::{Random, copy, kill_group, lodge, names, times, town};

fn ran(place: &Place, args: &[&str]) -> usize {
    names(&place.lodge_json(&[&["run", "p.toml"], args].concat()), "ran").len()
}

fn results(place: &Place) -> u64 {
    place.lodge_json(&["cache", "stat"])["results"].as_u64().unwrap()
}

#[test]
fn what_no_last_run_needs_goes_and_nothing_else() {
    let place = town(3);
    for keep in ["0.5", "0.6", "0.7"] {
        assert!(ran(&place, &["--set", &format!("node.hulls.keep={keep}")]) > 5);
    }
    let right = tree(&place.path("out"));
    let before = results(&place);
    let dry = place.lodge_json(&["cache", "gc", "--dry-run"]);
    assert_eq!(results(&place), before);
    let gone = place.lodge_json(&["cache", "gc"]);
    for key in ["removed_results", "removed_objects", "removed_plans", "removed_stamps", "bytes_before", "needed_bytes"]
    {
        assert_eq!(dry[key], gone[key], "{key}");
    }
    assert!(dry["bytes"].as_u64().unwrap().abs_diff(gone["bytes"].as_u64().unwrap()) < 4096, "{dry} {gone}");
    assert_eq!((&gone["dry_run"], &gone["removed_plans"]), (&json!(false), &json!(2)));
    assert_eq!(results(&place), before - gone["removed_results"].as_u64().unwrap());
    // Nothing to do, by the plan and the slow way, and also where the outputs come from the cache.
    let last = ["--set", "node.hulls.keep=0.7"];
    assert_eq!(ran(&place, &last), 0);
    std::fs::remove_dir_all(place.path("out")).unwrap();
    assert_eq!(ran(&place, &last), 0);
    assert!(tree(&place.path("out")) == right);
    assert_eq!(place.lodge_json(&["cache", "gc"])["removed_results"], 0);
    let verify = place.lodge_json(&["cache", "verify"]);
    for list in ["repaired", "evicted", "missing", "foreign", "changed", "unrepaired"] {
        assert_eq!(verify[list], json!([]), "{list}");
    }
    // The older values are gone, without a word of damage.
    let old = place.lodge_json(&["run", "p.toml", "--set", "node.hulls.keep=0.6"]);
    assert!(names(&old, "ran").len() > 5);
    assert_eq!(old["warnings"], json!([]));
}

#[test]
fn what_a_pipeline_needs_with_other_settings_stays_when_they_are_named() {
    let place = town(1);
    let set = |keep: &str| format!("node.hulls.keep={keep}");
    for keep in ["0.5", "0.6", "0.7"] {
        assert!(ran(&place, &["--set", &set(keep)]) > 5);
    }
    // A mistake in them, or no pipeline that they are of: nothing goes.
    let before = results(&place);
    for what in ["gc", "stat", "verify"] {
        for args in [&["--set", "a=1"][..], &["--set", "a=1", "."], &["p.toml", "--set", "node.hulls.kep=0.5"]] {
            let done = place.lodge(&[&["cache", what], args].concat());
            assert_eq!(done.status.code(), Some(2), "{what} {args:?}: {done:?}");
        }
    }
    for what in ["stat", "verify"] {
        place.lodge_json(&["cache", what, "p.toml", "--set", &set("0.6")]);
    }
    assert_eq!(results(&place), before);
    let gc = |args: &[&str]| place.lodge_json(&[&["cache", "gc", "p.toml", "--set", &set("0.6")], args].concat());
    let (dry, gone) = (gc(&["--dry-run"]), gc(&[]));
    assert_eq!((&dry["removed_results"], &dry["removed_plans"]), (&gone["removed_results"], &json!(1)));
    assert_eq!(results(&place), before - gone["removed_results"].as_u64().unwrap());
    for (keep, most) in [("0.7", 0), ("0.6", 0), ("0.7", 0)] {
        std::fs::remove_dir_all(place.path("out")).unwrap();
        assert_eq!(ran(&place, &["--set", &set(keep)]), most, "{keep}");
    }
    assert!(ran(&place, &["--set", &set("0.5")]) > 5);
}

/// A pipeline without writers has nothing in its outputs that tells which of two settings ran last.
#[test]
fn the_last_run_is_the_last_one_also_where_it_had_nothing_to_do() {
    let place = town(1);
    let file = std::fs::read_to_string(place.path("p.toml")).unwrap();
    place.write("p.toml", file + "[node]\nplan = false\nmodel = false\ntileset = false\n");
    for keep in ["0.5", "0.6", "0.5"] {
        place.lodge_json(&["run", "p.toml", "--set", &format!("node.hulls.keep={keep}")]);
    }
    place.lodge_json(&["cache", "gc"]);
    assert_eq!(ran(&place, &["--set", "node.hulls.keep=0.5"]), 0);
    assert!(ran(&place, &["--set", "node.hulls.keep=0.6"]) > 0);
}

#[test]
fn age_and_size_keep_more() {
    let place = town(1);
    for keep in ["0.5", "0.6", "0.7"] {
        ran(&place, &["--set", &format!("node.hulls.keep={keep}")]);
    }
    let gc = |args: &[&str]| place.lodge_json(&[&["cache", "gc"], args].concat());
    assert_eq!(gc(&["--max-age", "1h"])["removed_results"], 0);
    assert_eq!(gc(&["--max-size", "1G"])["removed_results"], 0);
    let dry = gc(&["--dry-run"]);
    let [all, need] = ["bytes_before", "needed_bytes"].map(|k| dry[k].as_u64().unwrap());
    assert!(need < all);
    // Room for some of the rest: the newest stays.
    let most = need + (all - need) / 4 * 3;
    let some = gc(&["--max-size", &most.to_string()]);
    assert!(some["removed_results"].as_u64().unwrap() > 0 && some["bytes"].as_u64().unwrap() <= most, "{some}");
    assert_eq!(ran(&place, &["--set", "node.hulls.keep=0.6"]), 0);
    assert!(gc(&["--max-age", "0s", "--max-size", "1G"])["removed_results"].as_u64().unwrap() > 0);
    assert_eq!(ran(&place, &["--set", "node.hulls.keep=0.6"]), 0);
    assert!(ran(&place, &["--set", "node.hulls.keep=0.7"]) > 0);
}

/// Of the files that results were read from which are still here, as long as they are as they were.
#[test]
fn stamps_that_tell_nothing_any_more_go() {
    use lodge::run::{stamp::Stamps, store::Store};
    let place = Place::new();
    place.write(
        "p.toml",
        "[params]\nfile = \"a\"\n[node.read]\nop = \"read-geojson\"\npath = \"${file}\"\n\
        [node.lines]\nop = \"read-lines\"\npath = \"common\"\n",
    );
    for (i, name) in ["a", "b", "c", "common"].iter().enumerate() {
        place.write(name, SQUARES.replace("\"id\": \"", &format!("\"id\": \"{i}")));
    }
    // Older than the margin.
    std::thread::sleep(Duration::from_millis(50));
    for (name, nodes) in [("a", 2), ("b", 1), ("c", 1)] {
        assert_eq!(ran(&place, &["--set", &format!("file={name}")]), nodes);
    }
    let known = || {
        let mut stamps = Stamps::load(&Store::look(&place.path("cache")).unwrap());
        ["a", "b", "c", "common"].map(|name| stamps.known(&place.path(name).canonicalize().unwrap()).is_some())
    };
    let gc = |args: &[&str]| place.lodge_json(&[&["cache", "gc"], args].concat())["removed_stamps"].as_u64().unwrap();
    assert_eq!(known(), [true; 4]);
    // The results of others stay, and so do their stamps.
    assert_eq!(gc(&["--max-age", "1h"]), 0);
    assert_eq!((gc(&["--dry-run"]), known()), (2, [true; 4]));
    assert_eq!((gc(&[]), known()), (2, [false, false, true, true]));
    assert_eq!(gc(&[]), 0);
    // Another file by now, or none.
    place.write("common", SQUARES);
    std::fs::remove_file(place.path("c")).unwrap();
    assert_eq!((gc(&[]), gc(&[])), (2, 0));
    assert_eq!(ran(&place, &[]), 2);
}

#[test]
fn a_pipeline_whose_file_is_gone_needs_nothing() {
    let place = town(1);
    place.lodge_json(&["run", "p.toml"]);
    std::fs::copy(place.path("p.toml"), place.path("q.toml")).unwrap();
    let other = ["--set", "node.hulls.keep=0.5"];
    place.lodge_json(&[&["run", "q.toml"], &other[..]].concat());
    std::fs::remove_file(place.path("q.toml")).unwrap();
    let q = tree(&place.path("out/q"));
    let gone = place.lodge_json(&["cache", "gc"]);
    assert!(gone["gone"][0].as_str().unwrap().ends_with("/q.toml"), "{gone}");
    assert_eq!(results(&place), names(&place.lodge_json(&["run", "p.toml"]), "cached").len() as u64);
    // Its files stay where they are.
    assert!(tree(&place.path("out/q")) == q && !q.is_empty());
    assert_eq!(place.lodge_json(&["cache", "gc"])["gone"], json!([]));
    assert!(ran(&place, &other) > 0);
}

/// gc waits for runs, runs wait for gc, both say on whom; and whoever comes when, all is sound.
#[test]
fn beside_runs_at_work() {
    let place = town(8);
    let right = {
        place.lodge_json(&["run", "p.toml"]);
        tree(&place.path("out"))
    };
    let mut random = Random::new("gc beside runs");
    let (mut gc_waited, mut run_waited) = (0, 0);
    for round in 0..times(200) {
        let keep = ["0.5", "0.6", "0.666666"][random.below(3)];
        if round % 4 == 0 {
            ["cache", "out"].iter().for_each(|f| std::fs::remove_dir_all(place.path(f)).unwrap());
            ran(&place, &["--set", "node.hulls.keep=0.55"]);
        }
        let spawn = |args: &[&str]| lodge(&place, args).stderr(Stdio::piped()).spawn().unwrap();
        let run = spawn(&["run", "p.toml", "--set", &format!("node.hulls.keep={keep}")]);
        std::thread::sleep(Duration::from_micros(random.below(60_000) as u64));
        let gc = spawn(&["cache", "gc"]);
        std::thread::sleep(Duration::from_micros(random.below(5_000) as u64));
        let late = spawn(&["run", "p.toml", "--set", &format!("node.hulls.keep={keep}")]);
        let (id, gc_id) = (run.id(), gc.id());
        let end = |child: std::process::Child| {
            let out = child.wait_with_output().unwrap();
            assert!(out.status.success(), "round {round}: {out:?}");
            String::from_utf8(out.stderr).unwrap()
        };
        let said = [end(run), end(gc), end(late)];
        assert!(said.iter().all(|s| !s.contains("damaged") && !s.contains("missing")), "round {round}: {said:?}");
        gc_waited += usize::from(said[1].contains(&format!("waiting for process {id}")));
        run_waited += said.iter().filter(|s| s.contains(&format!("cache: waiting for process {gc_id}"))).count();
        assert_eq!(ran(&place, &["--set", &format!("node.hulls.keep={keep}")]), 0, "round {round}");
        let verify = place.lodge_json(&["cache", "verify"]);
        for list in ["repaired", "evicted", "missing", "foreign", "changed", "unrepaired"] {
            assert_eq!(verify[list], json!([]), "round {round}: {list}");
        }
    }
    place.lodge_json(&["run", "p.toml"]);
    assert!(tree(&place.path("out")) == right);
    println!("gc waited for a run {gc_waited} times, a run for gc {run_waited} times");
    assert!(gc_waited > 0);
}

#[test]
fn killed_at_any_moment_it_has_taken_nothing_that_is_needed() {
    let place = town(6);
    for keep in ["0.5", "0.55", "0.6", "0.65", "0.7"] {
        ran(&place, &["--set", &format!("node.hulls.keep={keep}")]);
    }
    // A last run that stands on several packs.
    let last = ["--set", "node.hulls.keep=0.55", "--set", "node.tiles.max-triangles=900"];
    assert!(ran(&place, &last) > 0);
    let right = tree(&place.path("out"));
    copy(&place.path("cache"), &place.path("saved"));
    let mut random = Random::new("kills of gc");
    let (mut kills, mut early, mut halfway) = (0, 0, 0);
    let all = results(&place);
    while kills < times(200) {
        copy(&place.path("saved"), &place.path("cache"));
        let mut child = lodge(&place, &["cache", "gc"]).spawn().unwrap();
        std::thread::sleep(Duration::from_micros(random.below(30_000) as u64));
        if child.try_wait().unwrap().is_some() {
            early += 1;
            assert!(early < 400 + times(4000), "gc ends before it is killed");
            continue;
        }
        kill_group(&mut child);
        kills += 1;
        halfway += usize::from(results(&place) < all);
        let again = place.lodge_json(&[&["run", "p.toml", "--verify"], &last[..]].concat());
        assert_eq!((names(&again, "ran").len(), &again["warnings"]), (0, &json!([])), "kill {kills}");
        if kills % 5 == 0 {
            std::fs::remove_dir_all(place.path("out")).unwrap();
            assert_eq!(ran(&place, &last), 0, "kill {kills}");
        }
        assert!(tree(&place.path("out")) == right, "kill {kills}");
        let verify = place.lodge_json(&["cache", "verify"]);
        assert_eq!((&verify["evicted"], &verify["missing"]), (&json!([]), &json!([])), "kill {kills}");
        // The next one finishes, whatever the first one did.
        place.lodge_json(&["cache", "gc"]);
        assert_eq!(ran(&place, &last), 0, "kill {kills}");
    }
    println!("{kills} kills at work, {halfway} of them halfway, {early} ended before");
}
