//! Every command from outside: exit codes, the shape of `--json`, what is made on disk and what is not.

mod support;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use lodge::run::folder::Wait;
use lodge::run::store::Store;
use serde_json::{Value, json};
use support::{Place, interrupt, node};

/// `side` times `side` square buildings of 10 m, 15 m apart.
fn town(side: usize) -> String {
    let square = |i: usize| {
        let (x, y) = (139.7 + (i % side) as f64 * 0.000_25, 35.7 + (i / side) as f64 * 0.000_25);
        let ring =
            [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]].map(|c: [i32; 2]| [0, 1].map(|k| [x, y][k] + c[k] as f64 * 1e-4));
        json!({"type": "Feature", "id": format!("b{i}"), "properties": {"height": 3 + i % 7},
            "geometry": {"type": "Polygon", "coordinates": [ring]}})
    };
    json!({"type": "FeatureCollection", "features": (0..side * side).map(square).collect::<Vec<_>>()}).to_string()
}

const PIPELINE: &str = r#"
[params]
keep = 0.5

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
keep = "${keep}"

[node.out]
op = "write-geojson"
in.layer = "hulls"
path = "hulls.geojson"
"#;

fn small() -> Place {
    let place = Place::new();
    place.write("town.geojson", town(4));
    place.write("p.toml", PIPELINE);
    place
}

/// Exit code, and the one object on standard output.
fn told(place: &Place, args: &[&str]) -> (i32, Value) {
    let done = place.lodge(&[args, &["--json"]].concat());
    let value = serde_json::from_slice(&done.stdout).unwrap_or_else(|e| panic!("{args:?}: {e}: {done:?}"));
    (done.status.code().unwrap(), value)
}

fn has_keys(value: &Value, keys: &[&str]) {
    let object = value.as_object().unwrap_or_else(|| panic!("{value}"));
    keys.iter().for_each(|key| assert!(object.contains_key(*key), "`{key}` in {value}"));
}

#[test]
fn looking_makes_nothing() {
    let place = small();
    for args in [
        &["check", "p.toml"][..],
        &["plan", "p.toml"],
        &["why", "p.toml", "hulls"],
        &["graph", "p.toml"],
        &["ops"],
        &["schema"],
        &["cache", "stat"],
    ] {
        let done = place.lodge(args);
        assert_eq!(done.status.code(), Some(0), "{args:?}: {done:?}");
        let mut names: Vec<_> = std::fs::read_dir(place.dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["p.toml", "town.geojson"], "{args:?}");
    }
    // Nor where the cache goes without being told.
    support::binary().current_dir(place.dir.path()).args(["plan", "p.toml"]).output().unwrap();
    assert!(!place.path(".lodge").exists());
}

#[test]
fn run_plan_why_show_and_export() {
    let place = small();
    let (code, plan) = told(&place, &["plan", "p.toml"]);
    assert_eq!((code, &plan["pipeline"]), (0, &json!("p")));
    let fates: Vec<_> = plan["nodes"].as_array().unwrap().iter().map(|n| n["status"].as_str().unwrap()).collect();
    assert_eq!(fates, ["run", "may-run", "may-run", "may-run"]);
    plan["nodes"].as_array().unwrap().iter().for_each(|n| has_keys(n, &["name", "op", "status", "reason", "changes"]));
    assert_eq!(plan["nodes"][1]["input"], "read");

    let (code, run) = told(&place, &["run", "p.toml"]);
    assert_eq!((code, &run["ok"], &run["pipeline"]), (0, &json!(true), &json!("p")));
    has_keys(&run, &["lodge", "pipeline", "ok", "seconds", "nodes", "files"]);
    for n in run["nodes"].as_array().unwrap() {
        has_keys(n, &["name", "op", "status", "seconds", "digest", "bytes", "summary", "warnings"]);
        assert_eq!(n["status"], "ran");
    }
    has_keys(&run["files"][0], &["path", "bytes", "digest", "written"]);
    assert_eq!((&run["files"][0]["path"], &run["files"][0]["written"]), (&json!("hulls.geojson"), &json!(true)));
    let reader = &node(&run, "read")["summary"];
    assert_eq!((&reader["read"], &reader["accepted"]), (&json!(16), &json!(16)));
    // By the plan, and by the slow way.
    for args in [&["run", "p.toml"][..], &["run", "p.toml", "--verify"]] {
        let (code, again) = told(&place, args);
        assert_eq!(code, 0);
        for (a, b) in run["nodes"].as_array().unwrap().iter().zip(again["nodes"].as_array().unwrap()) {
            assert_eq!(b["status"], "cached");
            ["name", "op", "digest", "bytes", "summary", "warnings"].iter().for_each(|k| assert_eq!(a[k], b[k], "{k}"));
        }
        assert_eq!(again["files"][0]["written"], false);
    }

    let (_, why) = told(&place, &["why", "p.toml", "hulls", "--set", "keep=0.25"]);
    has_keys(&why, &["name", "status", "reason", "changes", "because"]);
    assert_eq!(why["changes"], json!([{"what": "parameter", "name": "keep", "node": null, "old": 0.5, "new": 0.25}]));
    let (_, why) = told(&place, &["why", "p.toml", "out", "--set", "keep=0.25"]);
    assert_eq!((&why["status"], &why["because"][0]["name"]), (&json!("may-run"), &json!("hulls")));

    let (code, show) = told(&place, &["show", "p.toml", "hulls"]);
    assert_eq!((code, &show["kind"], &show["digest"]), (0, &json!("Hulls"), &node(&run, "hulls")["digest"]));
    has_keys(&show, &["name", "op", "kind", "digest", "bytes", "frame", "summary"]);
    assert_eq!(place.lodge(&["show", "p.toml", "hulls", "-o", "t.csv"]).status.code(), Some(0));
    assert_eq!(std::fs::read_to_string(place.path("t.csv")).unwrap().lines().count(), 2);

    for (node, file, start) in [
        ("blocks", "b.csv", "left,right,distance,cost,size,crosses_barrier"),
        ("hulls", "h.svg", "<svg"),
        ("hulls", "h.geojson", "{"),
    ] {
        let done = place.lodge(&["export", "p.toml", node, "-o", file]);
        assert_eq!(done.status.code(), Some(0), "{done:?}");
        assert!(std::fs::read_to_string(place.path(file)).unwrap().starts_with(start));
    }
    let (code, export) = told(&place, &["export", "p.toml", "hulls", "-o", "j.geojson"]);
    assert_eq!((code, &export["node"], &export["path"]), (0, &json!("hulls"), &json!("j.geojson")));
    assert_eq!(export["bytes"], std::fs::metadata(place.path("j.geojson")).unwrap().len());
    let rejects = place.lodge(&["export", "p.toml", "read", "--rejects", "-o", "r.csv"]);
    assert_eq!(rejects.status.code(), Some(0), "{rejects:?}");
    assert_eq!(told(&place, &["export", "p.toml", "hulls", "-o", "h.obj"]).0, 2);
    assert_eq!(told(&place, &["show", "p.toml", "hulsl"]).1["diagnostics"][0]["suggestion"], "did you mean `hulls`?");

    let (code, drawing) = told(&place, &["graph", "p.toml"]);
    assert_eq!((code, &drawing["ok"]), (0, &json!(true)));
    has_keys(&drawing, &["format", "text"]);
    let (_, stat) = told(&place, &["cache", "stat"]);
    has_keys(&stat, &["cache", "objects", "object_bytes", "packs", "pack_bytes", "packed_objects", "results", "bytes"]);
    assert_eq!(stat["results"], 4);
    let (code, verify) = told(&place, &["cache", "verify"]);
    assert_eq!((code, &verify["ok"], &verify["evicted"]), (0, &json!(true), &json!([])));
    has_keys(&verify, &["checked", "checked_bytes", "repaired", "evicted", "foreign", "changed", "unrepaired"]);
}

#[test]
fn snapshots_pend_are_taken_and_thrown_away() {
    let place = small();
    let test = |args: &[&str]| told(&place, &[&["test", "p.toml"], args].concat());
    let verdicts = |v: &Value| -> Vec<String> {
        v["pipelines"][0]["stages"].as_array().unwrap().iter().map(|s| s["verdict"].as_str().unwrap().into()).collect()
    };
    let (code, first) = test(&[]);
    assert_eq!((code, &first["ok"], verdicts(&first)), (3, &json!(false), vec!["new".to_string(); 4]));
    has_keys(&first["pipelines"][0]["stages"][0], &["name", "verdict", "snapshot"]);
    let (code, accepted) = told(&place, &["accept", "p.toml"]);
    assert_eq!((code, accepted["accepted"].as_array().unwrap().len()), (0, 4));
    assert_eq!(test(&["--exact"]).0, 0);

    let (code, other) = test(&["--set", "node.read.height=9"]);
    let differ = verdicts(&other).iter().filter(|v| *v == "differs").count();
    assert!(code == 3 && differ >= 1, "{other}");
    let stages = other["pipelines"][0]["stages"].as_array().unwrap();
    assert!(
        stages.iter().any(|s| s["diff"].as_str().is_some_and(|d| d.contains("\n-") && d.contains("\n+"))),
        "{other}"
    );
    let (code, rejected) = told(&place, &["reject", "p.toml"]);
    assert_eq!((code, rejected["rejected"].as_array().unwrap().len()), (0, differ));
    assert_eq!(test(&[]).0, 0);
    assert_eq!(told(&place, &["accept", "p.toml", "hulls"]).0, 2, "nothing is pending");

    // In CI nothing is written; progress is told wherever a run is.
    let done = support::binary()
        .current_dir(place.dir.path())
        .env("CI", "true")
        .args(["test", "p.toml", "--cache", "fresh", "--set", "node.read.height=9"])
        .output()
        .unwrap();
    assert_eq!(done.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&done.stderr).contains("read: ran, "), "{done:?}");
    assert!(
        !std::fs::read_dir(place.path("snapshots")).unwrap().any(|e| e.unwrap().path().extension().unwrap() == "new")
    );
}

#[test]
fn standard_output_that_is_lost_is_a_failure() {
    let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") else {
        return println!("skipped: no /dev/full");
    };
    for args in [&["schema"][..], &["--json", "ops"]] {
        let done = support::binary().args(args).stdout(full.try_clone().unwrap()).output().unwrap();
        assert_eq!(done.status.code(), Some(1), "{done:?}");
        assert!(String::from_utf8_lossy(&done.stderr).contains("cannot write to standard output"), "{done:?}");
    }
}

/// Values of variants become parts of file names, but never of paths.
#[test]
fn snapshots_of_odd_values_stay_in_their_folder() {
    let place = Place::new();
    place.write("q/p/town.geojson", town(4));
    place.write("q/p/other/town.geojson", town(3));
    let three = PIPELINE.split("[node.out]").next().unwrap();
    let matrix = "matrix.path = [\"town.geojson\", \"../p/other/town.geojson\"]";
    place.write("q/p/p.toml", three.replace("path = \"town.geojson\"", matrix));
    let (code, told_of) = told(&place, &["test", "q/p/p.toml"]);
    assert_eq!(code, 3, "{told_of}");
    let names = |dir: &str| -> Vec<String> {
        let mut all: Vec<String> = std::fs::read_dir(place.path(dir))
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        all.sort();
        all
    };
    assert_eq!(names("q/p"), ["other", "p.toml", "snapshots", "town.geojson"]);
    assert_eq!(names("q/p/other"), ["town.geojson"]);
    assert_eq!(names("q/p/snapshots").len(), 6, "{:?}", names("q/p/snapshots"));
    assert_eq!(told(&place, &["accept", "q/p/p.toml"]).1["accepted"].as_array().unwrap().len(), 6);
    assert_eq!(told(&place, &["test", "q/p/p.toml"]).0, 0);
}

#[test]
fn a_misspelt_parameter_has_its_nearest_name() {
    let place = small();
    for (wrong, right) in [("heigth", "height"), ("defalt-height", "default-height"), ("pth", "path")] {
        place
            .write("p.toml", format!("[node.read]\nop = \"read-geojson\"\npath = \"town.geojson\"\n{wrong} = \"x\"\n"));
        let (code, broken) = told(&place, &["check", "p.toml"]);
        let first = &broken["diagnostics"][0];
        assert_eq!((code, &first["line"], &first["value"]), (2, &json!(4), &json!(wrong)));
        assert_eq!(first["suggestion"], format!("did you mean `{right}`?"));
        let done = place.lodge(&["run", "p.toml"]);
        assert!(String::from_utf8_lossy(&done.stderr).contains(&format!("did you mean `{right}`?")), "{done:?}");
        assert!(!place.path("cache").exists(), "nothing runs");
    }
}

#[test]
fn what_cannot_be_read_fails_its_branch_only() {
    let place = small();
    // A regular file by all that is known of it, and no byte of it can be read.
    let file = PIPELINE.replace("[node.blocks]", "[node.bad]\nop = \"read-geojson\"\npath = \"/proc/self/mem\"\n[node.below]\nop = \"cluster\"\nin.footprints = \"bad\"\n[node.blocks]");
    place.write("p.toml", file);
    let (code, run) = told(&place, &["run", "p.toml"]);
    assert_eq!((code, &run["ok"]), (1, &json!(false)));
    let states = ["read", "bad", "below", "blocks", "hulls", "out"].map(|n| node(&run, n)["status"].as_str().unwrap());
    assert_eq!(states, ["ran", "failed", "skipped", "ran", "ran", "ran"]);
    assert!(node(&run, "bad")["error"].as_str().unwrap().contains("cannot read `/proc/self/mem`"), "{run}");
    assert_eq!(node(&run, "below")["because"], "bad");
    assert!(place.path("out/p/hulls.geojson").exists());
    let done = place.lodge(&["run", "p.toml", "--fail-fast", "-j", "1", "--cache", "other"]);
    assert_eq!(done.status.code(), Some(1));
}

#[test]
fn a_cache_that_is_no_cache_is_4() {
    let place = small();
    place.write("cache/packs", "a file");
    let (code, run) = told(&place, &["run", "p.toml"]);
    assert_eq!((code, &run["ok"]), (4, &json!(false)));
    assert!(run["diagnostics"][0]["message"].as_str().unwrap().contains("`packs`"), "{run}");
    for args in [&["plan", "p.toml"][..], &["cache", "verify"], &["show", "p.toml", "read"]] {
        assert_eq!(told(&place, args).0, 4, "{args:?}");
    }
}

#[test]
fn a_read_only_cache_runs_and_says_so() {
    let place = small();
    // Nobody, not even root, makes folders here.
    let (code, run) = told(&place, &["run", "p.toml", "--cache", "/sys/lodge"]);
    assert_eq!((code, run["warnings"].as_array().unwrap().len()), (0, 1));
    assert!(run["warnings"][0].as_str().unwrap().contains("cannot be written"), "{run}");
    assert!(place.path("out/p/hulls.geojson").exists());
}

#[test]
fn a_full_disk_fails_and_keeps_nothing_bad() {
    let place = small();
    place.write("town.geojson", town(60));
    let disk = place.path("disk");
    std::fs::create_dir(&disk).unwrap();
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=256k", "tmpfs"]).arg(&disk).output();
    if !mount.is_ok_and(|done| done.status.success()) {
        return println!("skipped: this user cannot mount a tmpfs");
    }
    struct Mounted(std::path::PathBuf);
    impl Drop for Mounted {
        fn drop(&mut self) {
            let _ = Command::new("umount").arg("-l").arg(&self.0).status();
        }
    }
    let _mounted = Mounted(disk.clone());
    let cache = disk.join("cache");
    let cache = cache.to_str().unwrap();
    let (code, run) = told(&place, &["run", "p.toml", "--cache", cache]);
    assert_eq!(code, 1, "{run}");
    let failed: Vec<_> = run["nodes"].as_array().unwrap().iter().filter(|n| n["status"] == "failed").collect();
    assert!(
        !failed.is_empty() && failed.iter().all(|n| n["error"].as_str().unwrap().contains("No space left")),
        "{run}"
    );
    // With more room the next run goes on.
    let more = Command::new("mount").args(["-o", "remount,size=64m"]).arg(&disk).status().unwrap();
    assert!(more.success());
    let (code, verify) = told(&place, &["cache", "verify", "--cache", cache]);
    assert_eq!((code, &verify["evicted"]), (0, &json!([])));
    assert_eq!(told(&place, &["run", "p.toml", "--cache", cache]).0, 0);
    let full = std::fs::read(place.path("out/p/hulls.geojson")).unwrap();
    // The output folder may be full as well.
    let small = Command::new("mount").args(["-o", "remount,size=16m"]).arg(&disk).status().unwrap();
    assert!(small.success());
    std::fs::write(disk.join("ballast"), vec![1; 15 << 20]).unwrap_or_default();
    let out = disk.join("out");
    let (code, run) = told(&place, &["run", "p.toml", "--out", out.to_str().unwrap()]);
    assert_eq!((code, &run["ok"]), (1, &json!(false)), "{run}");
    assert!(!out.join("p/hulls.geojson").exists());
    std::fs::remove_file(disk.join("ballast")).unwrap();
    assert_eq!(told(&place, &["run", "p.toml", "--out", out.to_str().unwrap()]).0, 0);
    assert!(std::fs::read(out.join("p/hulls.geojson")).unwrap() == full);
}

fn events(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    // The last line may still be on its way.
    text.split_inclusive('\n').filter(|l| l.ends_with('\n')).map(|l| serde_json::from_str(l).unwrap()).collect()
}

#[test]
fn events_are_lines_in_the_order_of_happening() {
    let place = small();
    for (run, state) in ["ran", "cached"].iter().enumerate() {
        assert_eq!(place.lodge(&["run", "p.toml", "-j", "1", "--events", "e.jsonl"]).status.code(), Some(0));
        let all = events(&place.path("e.jsonl"));
        let times: Vec<f64> = all.iter().map(|e| e["after"].as_f64().unwrap()).collect();
        assert!(times.is_sorted() && all.iter().all(|e| e["at"].is_f64()));
        let words: Vec<&str> = all.iter().map(|e| e["event"].as_str().unwrap()).collect();
        let one = if run == 0 { &["node-started", "node-done"][..] } else { &["node-done"] };
        let published = if run == 0 { &["published"][..] } else { &[] };
        assert_eq!(words, [&["started"][..], &one.repeat(4), published, &["done"]].concat());
        has_keys(&all[0], &["pipeline", "nodes"]);
        for e in all.iter().filter(|e| e["event"] == "node-done") {
            has_keys(e, &["node", "status", "seconds", "digest", "bytes"]);
            assert_eq!(&e["status"], state);
        }
        assert_eq!(all.last().unwrap()["ok"], true);
    }
}

/// `run`, and Ctrl-C once `ready` says so of the events: what it printed, and how long it took to end.
fn interrupted(place: &Place, ready: impl Fn(&[Value]) -> bool) -> (Value, Duration) {
    let mut child = support::binary()
        .current_dir(place.dir.path())
        .env("LODGE_CACHE", place.path("cache"))
        .args(["run", "p.toml", "-j", "1", "--events", "e.jsonl", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let until = Instant::now() + Duration::from_secs(120);
    while !ready(&events(&place.path("e.jsonl"))) {
        assert!(Instant::now() < until && child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(2));
    }
    // In the middle of it.
    std::thread::sleep(Duration::from_millis(300));
    assert!(child.try_wait().unwrap().is_none(), "it is not long enough");
    let (_, took) = interrupt(&mut child);
    let out = child.wait_with_output().unwrap();
    std::fs::remove_file(place.path("e.jsonl")).unwrap();
    assert_eq!(out.status.code(), Some(130), "{out:?}");
    (serde_json::from_slice(&out.stdout).unwrap(), took)
}

const SECOND: Duration = Duration::from_secs(1);

/// One node looks whether it should stop, the other never does: it is left behind.
#[test]
fn ctrl_c_is_130_within_a_second_and_what_is_finished_is_kept() {
    let place = Place::new();
    let asks = "[node.read]\nop = \"concat\"\n[node.long]\nop = \"concat\"\nin.parts = \"read\"\nwork = 10000000\n\
        [node.out]\nop = \"concat\"\nin.parts = \"long\"\npublish = \"out\"\n";
    // Open, so that each node of the grid asks all triangles whether it is inside; some minutes of that.
    let side = 60;
    let height = |i: usize| ((i % side * 7 + i / side * 5) % 11) as f64 / 4.0;
    let mut mesh: String = (0..side * side).map(|i| format!("v {} {} {}\n", i % side, i / side, height(i))).collect();
    for i in (0..side * (side - 1)).filter(|i| i % side < side - 1) {
        let [a, b, c, d] = [i + 1, i + 2, i + side + 2, i + side + 1];
        mesh += &format!("f {a} {b} {c}\nf {a} {c} {d}\n");
    }
    place.write("m.obj", mesh);
    let voxels = "[node.read]\nop = \"read-mesh\"\npath = \"m.obj\"\n[node.out]\nop = \"voxelize\"\nin.mesh = \"read\"\nresolution = 1000\n";
    for (file, long) in [(asks, "long"), (voxels, "out")] {
        place.write("p.toml", file);
        let (run, took) =
            interrupted(&place, |all| all.iter().any(|e| e["event"] == "node-started" && e["node"] == long));
        println!("{long}: {took:?}");
        assert!(took < SECOND, "{long}: {took:?}");
        assert_eq!((&run["ok"], &node(&run, "read")["status"]), (&json!(false), &json!("ran")));
        for name in [long, "out"] {
            let node = node(&run, name);
            assert_eq!((&node["status"], &node["because"]), (&json!("skipped"), &json!("interrupted")));
        }
        let (code, plan) = told(&place, &["plan", "p.toml"]);
        assert_eq!(
            (code, &plan["nodes"][0]["status"], &node(&plan, long)["status"]),
            (0, &json!("cached"), &json!("run"))
        );
    }
}

/// Nobody reads what is said aside, or stops reading: the run goes on as it would.
#[test]
fn a_reader_that_goes_away_changes_nothing() {
    for (i, more) in [&[][..], &["-v"], &["-vvv"], &["--log-format", "json"], &["--json"]].into_iter().enumerate() {
        let place = small();
        let mut command = support::binary();
        command.current_dir(place.dir.path()).env("LODGE_CACHE", place.path("cache"));
        command.arg("--out").arg(place.path("out")).args(["run", "p.toml"]).args(more);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stderr.take());
        let started = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if started.elapsed() > Duration::from_secs(60) {
                child.kill().unwrap();
                panic!("{more:?}: it does not end");
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        assert_eq!(status.code(), Some(0), "{i}: {more:?}");
        assert!(!place.published().is_empty(), "{more:?}");
    }
}

/// Nor does a run that waits for another one keep anybody waiting: for its outputs, for its cache.
#[test]
fn ctrl_c_ends_a_run_that_waits() {
    let place = small();
    let out = std::fs::canonicalize(place.dir.path()).unwrap().join("out/p");
    std::fs::create_dir_all(&out).unwrap();
    let waits = |all: &[Value]| all.iter().any(|e| e["event"] == "waiting" && e["process"] == std::process::id());
    {
        let folder = std::fs::File::open(&out).unwrap();
        folder.lock().unwrap();
        let (run, took) = interrupted(&place, waits);
        assert!(took < SECOND, "{took:?}");
        assert_eq!((&run["files"], &run["nodes"][3]["status"]), (&json!([]), &json!("ran")));
    }
    {
        let (tell, stop) = (&mut |_| (), &false.into());
        let _alone = Store::open_alone(&place.path("cache"), &mut Wait { tell, stop }).unwrap();
        let (run, took) = interrupted(&place, waits);
        assert!(took < SECOND, "{took:?}");
        assert_eq!(run["nodes"], json!([]));
    }
    let run = place.lodge_json(&["run", "p.toml"]);
    assert!(run["nodes"].as_array().unwrap().iter().all(|n| n["status"] == "cached"));
    assert_eq!(run["files"][0]["written"], true);
}

/// A material library that is missing, comes, changes and goes is noticed by a rerun that reads nothing else.
#[test]
fn files_beside_a_file_are_inputs() {
    let place = Place::new();
    place.write("p.toml", "[node.mesh]\nop = \"read-mesh\"\npath = \"in/a.obj\"\n");
    place.write("in/a.obj", "mtllib m/a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n");
    let run = || {
        let run = place.lodge_json(&["run", "p.toml"]);
        let mesh = node(&run, "mesh").clone();
        (mesh["status"].as_str().unwrap().to_string(), mesh["warnings"].as_array().unwrap().len())
    };
    let is = |status: &str, warnings: usize| (status.to_string(), warnings);
    assert_eq!(run(), is("ran", 1));
    assert_eq!(run(), is("cached", 1));
    place.write("in/m/a.mtl", "newmtl red\nKd 1 0 0\n");
    assert_eq!(run(), is("ran", 0));
    assert_eq!(run(), is("cached", 0));
    place.write("in/m/a.mtl", "newmtl red\nKd 0 0 1\n");
    let (code, why) = told(&place, &["why", "p.toml", "mesh"]);
    assert!(code == 0 && why.to_string().contains("a.mtl"), "{why}");
    assert_eq!(run(), is("ran", 0));
    std::fs::remove_file(place.path("in/m/a.mtl")).unwrap();
    assert_eq!(run(), is("cached", 1));
}
