//! Two and eight runs on one cache.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::support::Place;
use super::toy::tree;
use super::{Random, kill_group, lodge, names, times, town};

/// Starts them together; what each printed, and its events.
fn all(place: &Place, runs: &[Vec<String>]) -> (Vec<Value>, Vec<Value>, Vec<u32>) {
    let start = |(i, args): (usize, &Vec<String>)| {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let mut command = lodge(place, &["run", "p.toml", "--json", "--events", &format!("e{i}.jsonl")]);
        command.args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let children: Vec<_> = runs.iter().enumerate().map(start).collect();
    let ids = children.iter().map(|c| c.id()).collect();
    let mut said = Vec::new();
    for child in children {
        let out = child.wait_with_output().unwrap();
        assert_eq!(out.status.code(), Some(0), "{out:?}");
        said.push(serde_json::from_slice(&out.stdout).unwrap());
    }
    let mut events = Vec::new();
    for i in 0..runs.len() {
        let text = std::fs::read_to_string(place.path(&format!("e{i}.jsonl"))).unwrap();
        events.extend(text.lines().map(|l| serde_json::from_str::<Value>(l).unwrap()));
    }
    (said, events, ids)
}

#[test]
fn each_node_is_computed_once_and_waiting_says_on_whom() {
    let place = town(12);
    let clean = place.lodge_json(&["run", "p.toml"]);
    let (nodes, right) = (names(&clean, "ran").len(), tree(&place.path("out")));
    // For a node, and for the output folder.
    let mut waited = [0, 0];
    for round in 0..times(20) {
        for runs in [2, 8] {
            ["cache", "out"].iter().for_each(|f| std::fs::remove_dir_all(place.path(f)).unwrap());
            let (said, events, ids) = all(&place, &vec![vec![]; runs]);
            let mut ran = BTreeMap::<&str, usize>::new();
            said.iter().flat_map(|run| names(run, "ran")).for_each(|n| *ran.entry(n).or_default() += 1);
            assert!(ran.len() == nodes && ran.values().all(|&n| n == 1), "round {round}, {runs} runs: {ran:?}");
            assert!(tree(&place.path("out")) == right, "round {round}, {runs} runs");
            for event in events.iter().filter(|e| e["event"] == "waiting") {
                let on = event["process"].as_u64().unwrap() as u32;
                // Nobody, where the other ended between the try and the question.
                assert!(on == 0 || ids.contains(&on), "{event}");
                let folder = event["what"].as_str().unwrap().contains('/');
                waited[usize::from(folder)] += usize::from(on != 0);
            }
        }
    }
    println!("{waited:?} waited for another process, for nodes and outputs");
    assert!(waited[0] > 0);
}

#[test]
fn runs_of_different_settings_publish_whole_one_after_the_other() {
    let place = town(3);
    let set = |i: usize| vec!["--set".to_string(), format!("node.tiles.max-triangles={}", 700 + 300 * i)];
    let runs: Vec<Vec<String>> = (0..4).map(set).collect();
    let trees: Vec<_> = runs
        .iter()
        .map(|args| {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            place.lodge_json(&[&["run", "p.toml"], &args[..]].concat());
            tree(&place.path("out"))
        })
        .collect();
    let mut random = Random::new("settings");
    let mut last = vec![0; runs.len()];
    let mut waited = 0;
    for round in 0..times(100) {
        // Sometimes with everything to do, sometimes with nothing but to publish.
        if round % 2 == 0 {
            ["cache", "out"].iter().for_each(|f| std::fs::remove_dir_all(place.path(f)).unwrap());
        }
        let mut order: Vec<usize> = (0..runs.len()).collect();
        order.sort_by_key(|_| random.below(1000));
        let these: Vec<_> = order[..2 + random.below(3)].iter().map(|&i| runs[i].clone()).collect();
        let (_, events, ids) = all(&place, &these);
        for event in events.iter().filter(|e| e["what"].as_str().is_some_and(|w| w.ends_with("out/p"))) {
            let on = event["process"].as_u64().unwrap() as u32;
            assert!(on == 0 || ids.contains(&on), "{event}");
            waited += usize::from(on != 0);
        }
        let found = tree(&place.path("out"));
        let which = trees.iter().position(|t| *t == found);
        let which = which.unwrap_or_else(|| panic!("round {round}: {these:?} left a mixture of {} files", found.len()));
        last[which] += 1;
    }
    println!("who came last: {last:?}; {waited} waited for another process to publish");
    assert!(waited > 0 || !Path::new("/proc/locks").exists());
}

/// The kernel frees the locks of the dead; what they had not finished is done by who waited for it.
#[test]
fn who_waits_for_a_run_that_is_killed_goes_on() {
    let place = town(6);
    const OTHER: &str = "--set=node.tiles.max-triangles=700";
    place.lodge_json(&["run", "p.toml", OTHER]);
    place.lodge_json(&["run", "p.toml"]);
    let right = tree(&place.path("out"));
    let empty = || ["cache", "out"].iter().for_each(|f| std::fs::remove_dir_all(place.path(f)).unwrap());
    let mut random = Random::new("deaths of those waited for");
    // While they publish, with nothing else to do; then while they compute a node.
    for folder in [true, false] {
        let mut length = Duration::ZERO;
        let (mut freed, mut tries) = (0, 0);
        while freed < times(20) {
            let _ = std::fs::remove_file(place.path("e1.jsonl"));
            if !folder {
                empty();
            }
            let started = Instant::now();
            let mut first = lodge(&place, &["run", "p.toml", OTHER]).spawn().unwrap();
            if length.is_zero() {
                assert!(first.wait().unwrap().success());
                length = started.elapsed();
                place.lodge_json(&["run", "p.toml"]);
                continue;
            }
            tries += 1;
            assert!(tries < 200 + times(2000), "nobody waited for it: {folder}, {freed}");
            std::thread::sleep(length.mul_f64(random.below(1000) as f64 / 1000.0));
            // Stopped, it keeps its locks until the other has come to them.
            let group = format!("-{}", first.id());
            assert!(Command::new("kill").args(["-STOP", "--", &group]).status().unwrap().success());
            let mut second = lodge(&place, &["run", "p.toml", "--events", "e1.jsonl"]).spawn().unwrap();
            // For what it waits, if it does: not every system tells who has a folder.
            let waits = |event: Value| {
                let on_folder = event["what"].as_str()?.contains('/');
                let nobody = on_folder && !Path::new("/proc/locks").exists() && event["process"] == 0;
                (event["event"] == "waiting" && (nobody || event["process"] == first.id())).then_some(on_folder)
            };
            let mut waited = None;
            let end = Instant::now() + Duration::from_secs(60);
            while waited.is_none() && second.try_wait().unwrap().is_none() {
                let text = std::fs::read_to_string(place.path("e1.jsonl")).unwrap_or_default();
                assert!(Instant::now() < end, "it neither waits nor ends: {text}");
                waited = text.lines().filter_map(|l| serde_json::from_str(l).ok()).find_map(waits);
                std::thread::sleep(Duration::from_millis(2));
            }
            assert!(waited.is_none() || second.try_wait().unwrap().is_none(), "it did not wait");
            kill_group(&mut first);
            while second.try_wait().unwrap().is_none() {
                assert!(end.elapsed().is_zero(), "it waits for the dead");
                std::thread::sleep(Duration::from_millis(2));
            }
            let code = second.wait().unwrap().code();
            assert!(code == Some(0) && tree(&place.path("out")) == right, "try {tries}: {code:?}");
            freed += usize::from(waited == Some(folder));
        }
        println!(
            "{freed} of {tries} runs that were killed were waited for, {}",
            if folder { "to publish" } else { "for a node" }
        );
        assert_eq!(names(&place.lodge_json(&["run", "p.toml"]), "ran"), [""; 0]);
        place.lodge_json(&["cache", "verify"]);
    }
}
