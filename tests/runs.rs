//! The runs that a cache remembers, and what differs between two of them; damaged, missing and foreign records.

mod support;
mod toy;

use std::fs;

use lodge::run::event::Status;
use lodge::run::history;
use lodge::run::store::Store;
use serde_json::{Value, json};
use support::{Place, node};
use toy::Yard;

const TOWN: &str = r#"{"type": "FeatureCollection", "features": [
{"type": "Feature", "id": "a", "properties": {"height": 5}, "geometry": {"type": "Polygon", "coordinates": [[[4.0, 52.0], [4.0002, 52.0], [4.0002, 52.0001], [4.0001, 52.0001], [4.0001, 52.0002], [4.0, 52.0002], [4.0, 52.0]]]}},
{"type": "Feature", "id": "b", "properties": {"height": 7}, "geometry": {"type": "Polygon", "coordinates": [[[4.0003, 52.0], [4.0004, 52.0], [4.0004, 52.0002], [4.0003, 52.0002], [4.0003, 52.0]]]}}]}
"#;

const PIPELINE: &str = r#"
[params]
keep = 0.9

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
    place.write("town.geojson", TOWN);
    place.write("p.toml", PIPELINE);
    place
}

fn told(place: &Place, args: &[&str]) -> (i32, Value) {
    let done = place.lodge(&[args, &["--json"]].concat());
    let value = serde_json::from_slice(&done.stdout).unwrap_or_else(|e| panic!("{args:?}: {e}: {done:?}"));
    (done.status.code().unwrap(), value)
}

fn text(place: &Place, args: &[&str]) -> String {
    let done = place.lodge(args);
    assert!(done.status.success(), "{done:?}");
    String::from_utf8(done.stdout).unwrap()
}

/// Names, the newest first.
fn names(place: &Place) -> Vec<String> {
    let (code, runs) = told(place, &["runs", "p.toml"]);
    assert_eq!(code, 0);
    runs["runs"].as_array().unwrap().iter().map(|r| r["name"].as_str().unwrap().to_string()).collect()
}

#[test]
fn runs_that_did_something_are_listed() {
    let place = small();
    assert_eq!(names(&place), [""; 0]);
    assert!(!place.path("cache").exists(), "looking makes no cache");
    assert_eq!(told(&place, &["run", "p.toml"]).0, 0);
    // Nothing to do: by the plan, and by the slow way.
    assert_eq!(told(&place, &["run", "p.toml"]).0, 0);
    assert_eq!(told(&place, &["run", "p.toml", "--events", "e.jsonl"]).0, 0);
    assert_eq!(names(&place), ["p-1"]);
    assert_eq!(told(&place, &["run", "p.toml", "--set", "keep=0.5"]).0, 0);
    place.write("town.geojson", "{");
    assert_eq!(told(&place, &["run", "p.toml"]).0, 1);
    // Of the same name, from another folder.
    place.write("town.geojson", TOWN);
    place.write("other/town.geojson", TOWN);
    place.write("other/p.toml", PIPELINE.replace("hulls.geojson", "h.geojson"));
    assert_eq!(told(&place, &["run", "other/p.toml"]).0, 0);

    let (code, all) = told(&place, &["runs", "p.toml"]);
    assert_eq!((code, &all["pipeline"], &all["damaged"]), (0, &json!("p"), &json!([])));
    let runs = all["runs"].as_array().unwrap();
    let counts = |r: &Value| ["ran", "cached", "failed", "skipped", "written"].map(|k| r[k].as_u64().unwrap());
    assert_eq!(runs.iter().map(counts).collect::<Vec<_>>(), [[0, 0, 1, 3, 0], [2, 2, 0, 0, 1], [4, 0, 0, 0, 1]]);
    assert_eq!((&runs[0]["ok"], &runs[1]["ok"], &runs[1]["set"]), (&json!(false), &json!(true), &json!(["keep=0.5"])));
    assert!(runs.iter().all(|r| r["at"].as_f64().unwrap() > 1.7e9 && r["seconds"].as_f64().unwrap() > 0.0));
    assert_eq!(told(&place, &["runs", "p.toml", "--set", "keep=0.5"]).1["runs"].as_array().unwrap().len(), 1);
    let table = text(&place, &["runs", "p.toml"]);
    assert!(table.lines().count() == 3 && table.contains("1 failed, 3 skipped"), "{table}");
    assert!(table.contains("2 ran, 2 cached, 1 of 1 files written  --set keep=0.5"), "{table}");
}

#[test]
fn a_diff_names_what_changed() {
    let place = small();
    told(&place, &["run", "p.toml"]);
    told(&place, &["run", "p.toml", "--set", "keep=0.3"]);
    place.write("town.geojson", format!("{TOWN}\n"));
    let with =
        format!("{PIPELINE}[node.more]\nop = \"landmarks\"\nin.footprints = \"read\"\nin.dendrogram = \"blocks\"\n");
    place.write("p.toml", with);
    told(&place, &["run", "p.toml"]);

    let (code, diff) = told(&place, &["diff", "p-1", "p-2"]);
    assert_eq!((code, &diff["old"]["name"], &diff["new"]["name"]), (0, &json!("p-1"), &json!("p-2")));
    let what = ["read", "blocks", "hulls", "out"].map(|n| node(&diff, n)["what"].as_str().unwrap());
    assert_eq!(what, ["same", "same", "result", "result"]);
    let hulls = node(&diff, "hulls");
    assert_eq!(hulls["changes"], json!([{"what": "parameter", "name": "keep", "node": null, "old": 0.9, "new": 0.3}]));
    assert!(hulls["old"]["digest"] != hulls["new"]["digest"] && hulls["old"]["key"] != hulls["new"]["key"]);
    let out = &node(&diff, "out")["changes"];
    assert_eq!(
        (&out[0]["what"], &out[0]["name"], &out[0]["node"]),
        (&json!("input"), &json!("layer"), &json!("hulls"))
    );
    assert_eq!((&out[0]["old"], &out[0]["new"]), (&hulls["old"]["digest"], &hulls["new"]["digest"]));
    let said = text(&place, &["diff", "p-1", "p-2"]);
    assert!(said.contains("--set: none -> keep=0.3\n") && said.contains("\n  `keep`: 0.9 -> 0.3\n"), "{said}");
    assert!(said.ends_with("p-1 -> p-2: 2 with another result, 2 same\n"), "{said}");

    // Cut off: the reader was made otherwise, with the same result.
    let (_, diff) = told(&place, &["diff", "p-1", "p-3"]);
    let what = ["read", "blocks", "hulls", "out", "more"].map(|n| node(&diff, n)["what"].as_str().unwrap());
    assert_eq!(what, ["key", "same", "same", "same", "new"]);
    let change = &node(&diff, "read")["changes"][0];
    assert!(change["what"] == "file" && change["name"].as_str().unwrap().ends_with("/town.geojson"), "{change}");
    let (_, back) = told(&place, &["diff", "p-3", "p-1"]);
    assert_eq!(node(&back, "more")["what"], "gone");
    // What made the results is gone from the cache, not that they differ.
    fs::remove_dir_all(place.path("cache/packs")).unwrap();
    let (code, diff) = told(&place, &["diff", "p-1", "p-2"]);
    assert_eq!(
        (code, &node(&diff, "hulls")["what"], &node(&diff, "hulls")["changes"]),
        (0, &json!("result"), &json!(null))
    );
    assert!(text(&place, &["diff", "p-1", "p-2"]).contains("no longer in the cache"));
}

#[test]
fn a_failed_node_has_its_error() {
    let place = small();
    told(&place, &["run", "p.toml"]);
    place.write("town.geojson", "{");
    told(&place, &["run", "p.toml"]);
    let (_, diff) = told(&place, &["diff", "p-1", "p-2"]);
    let (read, out) = (node(&diff, "read"), node(&diff, "out"));
    assert_eq!((&read["what"], &read["new"]["status"]), (&json!("status"), &json!("failed")));
    assert_eq!((&out["new"]["status"], &out["new"]["because"]), (&json!("skipped"), &json!("read")));
    // Another error of it is another state, what is skipped because of it is as it was.
    place.write("town.geojson", "{\"type\": \"FeatureCollection\", \"features\": 7}");
    told(&place, &["run", "p.toml"]);
    let (_, diff) = told(&place, &["diff", "p-2", "p-3"]);
    assert_eq!(["read", "out"].map(|n| &node(&diff, n)["what"]), ["status", "same"]);
    assert_eq!(
        told(&place, &["diff", "p-2", "p-2"]).1["nodes"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|n| n["what"] != "same")
            .count(),
        0
    );
}

#[test]
fn an_unknown_run_has_its_nearest_name() {
    let place = small();
    let (code, said) = told(&place, &["diff", "p-1", "p-1"]);
    assert_eq!((code, said["diagnostics"].as_array().unwrap().len()), (2, 1));
    told(&place, &["run", "p.toml"]);
    for (bad, hint) in [
        ("p-7", "did you mean `p-1`?"),
        ("../p-1", "`lodge runs FILE` lists them"),
        ("elephant", "`lodge runs FILE` lists them"),
    ] {
        let (code, said) = told(&place, &["diff", bad, "p-1"]);
        let first = &said["diagnostics"][0];
        assert_eq!((code, &first["code"], &first["value"]), (2, &json!("unknown-run"), &json!(bad)));
        assert_eq!(first["suggestion"], hint, "{bad}");
    }
    assert_eq!(told(&place, &["diff", "x", "y"]).1["diagnostics"].as_array().unwrap().len(), 2);
}

#[test]
fn damaged_and_foreign_records_harm_nothing() {
    let place = small();
    for keep in ["0.9", "0.5", "0.4", "0.3"] {
        assert_eq!(told(&place, &["run", "p.toml", "--set", &format!("keep={keep}")]).0, 0);
    }
    let at = |n: usize| place.path(&format!("cache/history/p-{n}"));
    let whole = fs::read(at(1)).unwrap();
    for i in (0..whole.len()).step_by(7) {
        let mut bad = whole.clone();
        bad[i] ^= 4;
        fs::write(at(1), bad).unwrap();
        let store = Store::look(&place.path("cache")).unwrap();
        assert!(history::load(&store, "p-1").is_none(), "byte {i}");
    }
    // One cut short, two that change places, a link, and a file that is none of ours.
    fs::write(at(1), &whole[..whole.len() / 2]).unwrap();
    let (two, three) = (fs::read(at(2)).unwrap(), fs::read(at(3)).unwrap());
    fs::write(at(2), three).unwrap();
    fs::write(at(3), two).unwrap();
    std::os::unix::fs::symlink(at(4), at(5)).unwrap();
    fs::write(place.path("cache/history/notes.txt"), "mine").unwrap();
    let (code, all) = told(&place, &["runs", "p.toml"]);
    assert_eq!((code, &all["damaged"]), (0, &json!(["p-3", "p-2", "p-1"])));
    assert_eq!(names(&place), ["p-4"]);
    for args in [["diff", "p-1", "p-4"], ["diff", "p-4", "p-3"]] {
        let (code, said) = told(&place, &args);
        assert_eq!((code, &said["diagnostics"][0]["code"]), (4, &json!("damaged-run")));
    }
    // The next run takes a name of its own.
    assert_eq!(told(&place, &["run", "p.toml", "--set", "keep=0.2"]).0, 0);
    assert_eq!(names(&place), ["p-6", "p-4"]);
    let (code, found) = told(&place, &["cache", "verify"]);
    assert_eq!((code, found["evicted"].as_array().unwrap().len()), (0, 4), "{found}");
    assert_eq!(found["foreign"], json!(["history/notes.txt"]));
    assert_eq!(names(&place), ["p-6", "p-4"]);
    assert_eq!(told(&place, &["runs", "p.toml"]).1["damaged"], json!([]));
}

#[test]
fn a_run_that_cannot_be_noted_is_a_good_run() {
    let place = small();
    let name = "x".repeat(250);
    place.write(&format!("{name}.toml"), PIPELINE);
    // The next number makes the name too long for any file system.
    place.write(&format!("cache/history/{name}-9999"), "");
    let (code, run) = told(&place, &["run", &format!("{name}.toml")]);
    assert_eq!((code, &run["ok"], &run["warnings"]), (0, &json!(true), &json!([])));
}

#[test]
fn the_last_fifty_stay() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    for i in 0..history::KEEP + 5 {
        yard.set("left", "add", json!(i));
        assert!(!yard.names(&yard.run(), Status::Ran).is_empty());
    }
    let store = Store::look(&home.path().join(".lodge")).unwrap();
    let names = history::names(&store);
    assert_eq!((names.len(), &*names[0]), (history::KEEP, "toy-6"));
    let last = history::load(&store, "toy-55").unwrap();
    assert_eq!((last.count(Status::Ran), last.nodes.len(), last.ok), (3, 5, true));
}
