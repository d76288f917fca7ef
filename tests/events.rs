//! Every line of `--events` of real runs fits `schemas/events.schema.json`; and the memory that nodes took is there.

mod support;

use std::collections::BTreeSet;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use lodge::run::peak::Peak;
use serde_json::{Value, json};
use support::Place;

fn town(side: usize) -> String {
    let square = |i: usize| {
        let (x, y) = (139.7 + (i % side) as f64 * 0.000_25, 35.7 + (i / side) as f64 * 0.000_25);
        let ring =
            [[0., 0.], [1., 0.], [1., 1.], [0., 1.], [0., 0.]].map(|c: [f64; 2]| [x + c[0] * 1e-4, y + c[1] * 1e-4]);
        json!({"type": "Feature", "id": format!("b{i}"), "properties": {"height": 3 + i % 7},
            "geometry": {"type": "Polygon", "coordinates": [ring]}})
    };
    json!({"type": "FeatureCollection", "features": (0..side * side).map(square).collect::<Vec<_>>()}).to_string()
}

const PIPELINE: &str = r#"
[node.read]
op = "read-geojson"
path = "town.geojson"
height = "height"

[node.blocks]
op = "cluster"
in.footprints = "read"

[node.hulls]
op = "merge-hulls"
in.footprints = "read"
in.dendrogram = "blocks"

[node.out]
op = "write-geojson"
in.layer = "hulls"
path = "hulls.geojson"
"#;

fn against_schema(value: &Value) -> Vec<String> {
    let path = support::project().join("schemas/events.schema.json");
    let schema: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let mut out = Vec::new();
    support::schema::mistakes(&schema, value, "", &mut out);
    out
}

/// The lines of a run, each of which fits.
fn lines(place: &Place, file: &str) -> Vec<Value> {
    let text = std::fs::read_to_string(place.path(file)).unwrap();
    assert!(text.ends_with('\n'), "a torn line");
    let all: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    for line in &all {
        assert_eq!(against_schema(line), [""; 0], "{line}");
    }
    assert_eq!((&all[0]["event"], &all.last().unwrap()["event"]), (&json!("started"), &json!("done")));
    all
}

/// Statuses in the order of the nodes' names given, after a run.
fn run(place: &Place, more: &[&str], seen: &mut BTreeSet<String>) -> Vec<Value> {
    place.lodge(&[&["run", "p.toml", "--events", "e.jsonl"], more].concat());
    let all = lines(place, "e.jsonl");
    for line in &all {
        seen.insert(line["event"].as_str().unwrap().to_string());
        line["status"].as_str().into_iter().for_each(|s| _ = seen.insert(s.to_string()));
    }
    all
}

fn status<'a>(all: &'a [Value], node: &str) -> &'a Value {
    &all.iter().rfind(|e| e["event"] == "node-done" && e["node"] == node).unwrap_or_else(|| panic!("{node}"))["status"]
}

#[test]
fn every_line_fits_the_schema() {
    let place = Place::new();
    place.write("town.geojson", town(4));
    place.write("p.toml", PIPELINE);
    let mut seen = BTreeSet::new();
    let all = run(&place, &[], &mut seen);
    assert_eq!(["read", "out"].map(|n| status(&all, n)), ["ran", "ran"]);
    let all = run(&place, &[], &mut seen);
    assert_eq!(["read", "out"].map(|n| status(&all, n)), ["cached", "cached"]);
    // Cut off: the reader runs, its result is as before.
    place.write("town.geojson", town(4) + "\n\n");
    let all = run(&place, &[], &mut seen);
    assert_eq!(["read", "blocks", "out"].map(|n| status(&all, n)), ["ran", "cached", "cached"]);
    // Another file, with a branch that fails and one below it; a budget that is too small warns.
    let file = PIPELINE.replace("hulls.geojson", "h.geojson")
        + "[node.bad]\nop = \"read-geojson\"\npath = \"/proc/self/mem\"\n[node.below]\nop = \"cluster\"\nin.footprints = \"bad\"\n";
    place.write("p.toml", file.replace("[node.hulls]", "[node.hulls]\nkeep = 0.5"));
    let all = run(&place, &["--memory", "1K"], &mut seen);
    assert_eq!(["bad", "below", "hulls"].map(|n| status(&all, n)), ["failed", "skipped", "ran"]);
    place.write("p.toml", PIPELINE.replace("hulls.geojson", "h.geojson"));
    run(&place, &[], &mut seen);
    let wanted = [
        "started",
        "node-started",
        "node-done",
        "warning",
        "published",
        "removed",
        "done",
        "ran",
        "cached",
        "failed",
        "skipped",
    ];
    assert!(wanted.iter().all(|w| seen.contains(*w)), "{seen:?}");
}

fn start(place: &Place, events: &str) -> Child {
    let mut command = support::binary();
    command.current_dir(place.dir.path()).env("LODGE_CACHE", place.path("cache"));
    command.args(["run", "p.toml", "-j", "1", "--events", events]);
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Until the events of a run that goes on say so.
fn until(place: &Place, child: &mut Child, events: &str, word: &str) {
    let end = Instant::now() + Duration::from_secs(60);
    while !std::fs::read_to_string(place.path(events)).is_ok_and(|t| t.contains(word)) {
        assert!(Instant::now() < end && child.try_wait().unwrap().is_none(), "no {word} in {events}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

/// The first is stopped at work, so that the second has to wait.
#[test]
fn a_run_that_waits_says_on_whom() {
    let place = Place::new();
    place.write("town.geojson", town(110));
    place.write("p.toml", PIPELINE);
    let mut first = loop {
        let mut child = start(&place, "e.jsonl");
        until(&place, &mut child, "e.jsonl", "\"node-started\"");
        signal(&child, "-STOP");
        std::thread::sleep(Duration::from_millis(20));
        if std::fs::read_to_string(place.path("e.jsonl")).unwrap().lines().last().unwrap().contains("node-started") {
            break child;
        }
        // Between two nodes it holds nothing.
        signal(&child, "-CONT");
        assert!(child.wait().unwrap().success());
        std::fs::remove_dir_all(place.path("cache")).unwrap();
    };
    let mut second = start(&place, "e2.jsonl");
    until(&place, &mut second, "e2.jsonl", "\"waiting\"");
    signal(&first, "-CONT");
    assert!(first.wait().unwrap().success() && second.wait().unwrap().success());
    let work = lines(&place, "e.jsonl");
    let all = lines(&place, "e2.jsonl");
    let told = all.iter().find(|e| e["event"] == "waiting").unwrap();
    assert_eq!(told["process"], first.id());
    assert!(work.iter().any(|e| e["event"] == "node-started" && e["node"] == told["what"]), "{told}");
}

#[test]
fn an_interrupted_run_has_whole_lines() {
    let place = Place::new();
    place.write("town.geojson", town(110));
    place.write("p.toml", PIPELINE);
    let mut child = start(&place, "e.jsonl");
    until(&place, &mut child, "e.jsonl", "\"ran\"");
    signal(&child, "-INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let all = lines(&place, "e.jsonl");
    let done = all.last().unwrap();
    assert_eq!((&done["ok"], &done["interrupted"]), (&json!(false), &json!(true)));
}

/// The check above can say no.
#[test]
fn what_does_not_fit_is_told() {
    let good = json!({"event": "node-done", "node": "a", "status": "ran", "seconds": 0.5, "digest": null, "bytes": 3,
        "peak_bytes": null, "at": 1.0, "after": 0.0});
    assert_eq!(against_schema(&good), [""; 0]);
    for (key, bad) in [
        ("event", json!("nod-done")),
        ("status", json!("run")),
        ("bytes", json!(-3)),
        ("seconds", json!("1")),
        ("node", json!(null)),
        ("more", json!(1)),
    ] {
        let mut line = good.clone();
        line[key] = bad;
        assert!(!against_schema(&line).is_empty(), "{line}");
    }
    for key in good.as_object().unwrap().keys() {
        let mut line = good.clone();
        line.as_object_mut().unwrap().remove(key);
        assert!(!against_schema(&line).is_empty(), "{line}");
    }
}

/// The mark rises with what is held, and is set back for the next one.
#[test]
fn peaks_are_of_what_runs() {
    let peaks = |place: &Place, jobs: &str| -> Vec<Option<u64>> {
        let all = run(place, &["-j", jobs], &mut BTreeSet::new());
        all.iter().filter(|e| e["event"] == "node-done").map(|e| e["peak_bytes"].as_u64()).collect()
    };
    let place = Place::new();
    place.write("town.geojson", town(4));
    place.write("p.toml", PIPELINE);
    assert!(peaks(&place, "2").iter().all(Option::is_none), "not of one node alone");
    assert!(peaks(&place, "1").iter().all(Option::is_none), "nothing ran");
    if !cfg!(target_os = "linux") || std::fs::write("/proc/self/clear_refs", "5").is_err() {
        println!("skipped: the mark of memory cannot be set back here");
        return;
    }
    std::fs::remove_dir_all(place.path("cache")).unwrap();
    let all = peaks(&place, "1");
    assert!(all.len() == 4 && all.iter().all(|p| p.is_some_and(|p| (1 << 20..1 << 30).contains(&p))), "{all:?}");

    const LARGE: u64 = 256 << 20;
    let watch = Peak::start();
    let large = std::hint::black_box(vec![1u8; LARGE as usize]);
    let peak = watch.end().unwrap();
    drop(large);
    let after = Peak::start().end().unwrap();
    assert!(peak >= LARGE && after < peak - LARGE / 2, "{peak} {after}");
}
