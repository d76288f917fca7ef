//! How nodes fail, and what the others do meanwhile.

mod support;
mod toy;

use std::process::Command;

use lodge::run::event::Status;
use serde_json::json;
use support::{Place, node};
use toy::{Yard, tree};

fn forked(home: &std::path::Path, fail: &str) -> Yard {
    let mut yard = Yard::diamond(home);
    yard.set("left", "fail", json!(fail));
    let alone = yard.node("alone", "toy-add", json!({"add": 3}), &[2]);
    yard.node("alone-out", "toy-write", json!({"path": "alone"}), &[alone]);
    yard
}

#[test]
fn the_others_go_on() {
    for (fail, text) in
        [("error", "told to fail"), ("panic", "told to panic"), ("panic-inside", "told to panic inside")]
    {
        let home = tempfile::tempdir().unwrap();
        let yard = forked(home.path(), fail);
        let outcome = yard.run();
        assert!(!outcome.ok());
        assert_eq!(yard.names(&outcome, Status::Failed), ["left"]);
        assert_eq!(yard.names(&outcome, Status::Skipped), ["both", "out"]);
        assert_eq!(yard.names(&outcome, Status::Ran), ["read", "right", "alone", "alone-out"]);
        assert!(outcome.nodes.iter().all(|n| n.status != Status::Skipped || n.because.as_deref() == Some("left")));
        let error = outcome.nodes[1].error.as_ref().unwrap().to_string();
        assert!(error.contains(text) && error.contains("`left`"), "{error}");
        assert_eq!(error.contains("tests/toy/mod.rs:"), fail != "error", "{error}");
        assert!(yard.out().join("alone/index.txt").exists());
        // The failed node runs again, the others do not.
        let again = yard.run();
        assert_eq!(yard.names(&again, Status::Ran), [""; 0]);
        assert_eq!(yard.names(&again, Status::Failed), ["left"]);
    }
}

#[test]
fn fail_fast_starts_nothing_more() {
    let home = tempfile::tempdir().unwrap();
    let yard = forked(home.path(), "error");
    let mut options = yard.options();
    options.fail_fast = true;
    options.jobs = 1;
    let outcome = yard.run_with(&options);
    assert_eq!(yard.names(&outcome, Status::Ran), ["read"]);
    assert_eq!(yard.names(&outcome, Status::Skipped).len(), 5);
}

#[test]
fn a_stopped_run_keeps_what_is_finished() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.set("both", "slow-ms", json!(20_000));
    let options = yard.options();
    let stop = options.stop.clone();
    let started = std::time::Instant::now();
    let outcome = lodge::run::run(&yard.graph(), &[], &options, &mut |event| {
        if let lodge::run::event::Event::NodeStarted { node, .. } = event
            && node == "both"
        {
            stop.store(true, std::sync::atomic::Ordering::SeqCst);
        }
    });
    assert!(outcome.interrupted && started.elapsed().as_secs_f64() < 5.0);
    yard.set("both", "slow-ms", json!(0));
    assert_eq!(yard.ran(), ["both", "out"]);
}

/// Whoever presses Ctrl-C does not wait for a disk.
#[test]
fn a_stopped_run_does_not_wait_for_the_disk() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    let mut options = yard.options();
    options.sync = true;
    let stop = options.stop.clone();
    let outcome = lodge::run::run(&yard.graph(), &[], &options, &mut |event| {
        if let lodge::run::event::Event::NodeDone { node, .. } = event
            && node == "read"
        {
            stop.store(true, std::sync::atomic::Ordering::SeqCst);
            // Which cannot be synced.
            for pack in std::fs::read_dir(home.path().join(".lodge/packs")).unwrap() {
                let path = pack.unwrap().path();
                std::fs::remove_file(&path).unwrap();
                std::fs::create_dir(&path).unwrap();
            }
        }
    });
    assert!(outcome.interrupted && yard.names(&outcome, Status::Ran).contains(&"read".to_string()));
    assert_eq!(outcome.warnings, [""; 0]);
}

/// Small nodes, and some that take five times as much because their input is large: the estimates of those at work
/// never sum to more than the budget, and what is larger than that runs alone and is told.
#[test]
fn what_is_at_work_fits_the_budget() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::new(home.path());
    let large = yard.node("large", "toy-add", json!({"more": 600_000}), &[]);
    for i in 0..4 {
        yard.node(&format!("small-{i}"), "toy-add", json!({"add": i, "slow-ms": 20}), &[]);
        yard.node(&format!("heavy-{i}"), "toy-add", json!({"add": i, "slow-ms": 20}), &[large]);
    }
    // By budget: the most that was at work at once, in bytes and nodes.
    let most = |budget: u64| {
        std::fs::remove_dir_all(home.path().join(".lodge")).unwrap_or_default();
        let graph = yard.graph();
        let mut options = yard.options();
        (options.jobs, options.memory) = (8, Some(budget));
        let mut bytes = vec![0; graph.nodes.len()];
        let mut at_work = std::collections::BTreeMap::new();
        let mut peak = (0, 0);
        let outcome = lodge::run::run(&graph, &[], &options, &mut |event| match event {
            lodge::run::event::Event::NodeStarted { node, .. } => {
                let n = graph.nodes.iter().position(|n| n.name == *node).unwrap();
                let inputs = graph.nodes[n].inputs.iter().flatten().map(|&i| bytes[i]).sum();
                at_work.insert(node.clone(), graph.nodes[n].op.estimate_of(&[inputs], 0));
                peak = (at_work.values().sum::<u64>().max(peak.0), at_work.len().max(peak.1));
            }
            lodge::run::event::Event::NodeDone { node, bytes: size, .. } => {
                bytes[graph.nodes.iter().position(|n| n.name == *node).unwrap()] = *size;
                at_work.remove(node);
            }
            _ => {}
        });
        assert!(outcome.ok() && yard.names(&outcome, Status::Ran).len() == 9);
        let alone = outcome.warnings.iter().filter(|w| w.contains("it runs alone")).count();
        (peak.0, peak.1, alone)
    };
    const MIB: u64 = 1 << 20;
    let (sum, _, alone) = most(1 << 40);
    assert!(sum > 60 * MIB && alone == 0, "all at once: {sum}");
    for (budget, heavy) in [(60 * MIB, 0), (30 * MIB, 0), (12 * MIB, 4)] {
        let (sum, nodes, alone) = most(budget);
        assert!(alone == heavy && nodes > 1, "{budget}: {nodes} nodes, {alone} alone");
        assert!(sum <= budget || heavy > 0 && sum < 30 * MIB, "{budget}: {sum}");
    }
    assert_eq!((most(1).1, most(1).2), (1, 9));
}

#[test]
fn rejects_fail_a_node_also_on_a_hit() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.file("data.txt", "1 two 3");
    assert_eq!(yard.ran().len(), 5);
    let outcome = yard.run();
    let record = outcome.nodes[0].record.as_ref().unwrap();
    assert_eq!(record.rejects, 1);
    assert_eq!(record.summary()["rejects"], json!({"not a number": 1}));
    assert_eq!(record.summary()["read"], json!(3));
    yard.fail_on_reject = true;
    let outcome = yard.run();
    assert_eq!(yard.names(&outcome, Status::Failed), ["read"]);
    assert_eq!(yard.names(&outcome, Status::Ran), [""; 0]);
}

#[test]
fn warnings_are_repeated_by_hits() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.set("left", "warn", json!("mind the gap"));
    for status in [Status::Ran, Status::Cached] {
        let outcome = yard.run();
        assert_eq!(outcome.nodes[1].status, status);
        assert_eq!(outcome.nodes[1].warnings, ["mind the gap"]);
    }
}

#[test]
fn a_missing_input_fails_its_reader_only() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.node("other", "toy-add", json!({"more": 3}), &[]);
    yard.set("read", "path", json!("absent.txt"));
    let outcome = yard.run();
    assert_eq!(yard.names(&outcome, Status::Failed), ["read"]);
    assert_eq!(yard.names(&outcome, Status::Ran), ["other"]);
    assert!(outcome.nodes[0].error.as_ref().unwrap().message.contains("absent.txt"));
}

#[test]
fn an_input_that_changes_while_it_is_read_keeps_nothing() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.set("read", "slow-ms", json!(200));
    let alone = yard.node("alone", "toy-add", json!({"more": 3, "slow-ms": 400}), &[]);
    yard.node("alone-out", "toy-write", json!({"path": "alone"}), &[alone]);
    let path = home.path().join("data.txt");
    let outcome = lodge::run::run(&yard.graph(), &[], &yard.options(), &mut |event| {
        if let lodge::run::event::Event::NodeStarted { node, .. } = event
            && node == "read"
        {
            std::thread::sleep(std::time::Duration::from_millis(50));
            std::fs::write(&path, "7 8 9").unwrap();
        }
    });
    assert_eq!(yard.names(&outcome, Status::Failed), ["read"]);
    assert!(outcome.nodes[0].error.as_ref().unwrap().message.contains("changed while it was read"));
    // The others go on, and what is kept is right.
    assert_eq!(yard.names(&outcome, Status::Ran), ["alone", "alone-out"]);
    assert_eq!(yard.names(&outcome, Status::Skipped), ["left", "right", "both", "out"]);
    let store = lodge::run::store::Store::open(&yard.options().cache).unwrap();
    let found = lodge::run::verify::verify(&store);
    assert!(found.checked > 0 && found.is_clean(), "{found:?}");
    assert_eq!(yard.ran().len(), 5);
    assert!(std::fs::read_to_string(yard.out().join("files/n/0.txt")).unwrap().starts_with('8'));
}

#[test]
fn any_number_of_threads_and_any_folder_give_the_same_bytes() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut trees = Vec::new();
    let mut digests = Vec::new();
    for (home, jobs) in [(&a, 1), (&a, 2), (&b, 8)] {
        let yard = Yard::diamond(home.path());
        let _ = std::fs::remove_dir_all(home.path().join(".lodge"));
        let _ = std::fs::remove_dir_all(yard.out());
        let mut options = yard.options();
        options.jobs = jobs;
        let outcome = yard.run_with(&options);
        assert!(outcome.ok());
        trees.push(tree(&yard.out()));
        digests.push(
            outcome
                .nodes
                .iter()
                .map(|n| n.record.as_ref().unwrap().clone())
                .map(|r| (r.key, r.digest))
                .collect::<Vec<_>>(),
        );
    }
    assert!(trees.windows(2).all(|w| w[0] == w[1]));
    assert!(digests.windows(2).all(|w| w[0] == w[1]));
}

/// Counted by strace: what one run waits for does not grow with its nodes.
#[test]
fn no_node_waits_for_the_disk() {
    let strace = |place: &Place| {
        let mut command = Command::new("strace");
        let calls = "trace=fsync,fdatasync,sync,syncfs,sync_file_range,msync";
        command.args(["-f", "-qq", "-e", "signal=none", "-e", calls, "-o", "calls"]).current_dir(place.dir.path());
        command
    };
    if !strace(&Place::new()).arg("true").output().is_ok_and(|done| done.status.success()) {
        return println!("skipped: no strace that may trace");
    }
    let counted = [10, 1000].map(|nodes| {
        let place = Place::new();
        // Each a result and a published file of its own; a tree, so that some wait for others.
        let text = (0..nodes).map(|i| {
            let of = if i == 0 { String::new() } else { format!("in.parts = \"n{}\"\n", (i - 1) / 3) };
            format!("[node.n{i}]\nop = \"concat\"\ntext = \"{i}\"\npublish = \"n{i}\"\n{of}")
        });
        place.write("p.toml", text.collect::<String>());
        let mut command = strace(&place);
        command.arg(env!("CARGO_BIN_EXE_lodge")).args(["--json", "-j", "2", "--cache", "cache", "run", "p.toml"]);
        let done = command.output().unwrap();
        let run: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
        assert_eq!(node(&run, &format!("n{}", nodes - 1))["status"], "ran", "{run}");
        assert_eq!(tree(&place.path("out")).iter().filter(|(name, _)| name.contains("/n")).count(), nodes);
        let calls = std::fs::read_to_string(place.path("calls")).unwrap();
        calls.lines().filter(|line| !line.contains("resumed>")).map(String::from).collect::<Vec<_>>()
    });
    let [few, many] = &counted;
    println!("{} waits for the disk in a run of 10 nodes, {} in one of 1,000", few.len(), many.len());
    assert!(!few.is_empty(), "the end of a run waits for the disk");
    assert_eq!(few.len(), many.len(), "{few:#?} {many:#?}");
}
