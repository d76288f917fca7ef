//! The program from outside: exit codes, and standard output that holds nothing but the JSON.

mod support;

use std::path::Path;
use std::process::Output;

use serde_json::Value;

fn lodge(args: &[&str]) -> Output {
    support::binary().args(args).output().unwrap()
}

fn json(args: &[&str]) -> (i32, Value) {
    let out = lodge(args);
    let value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{args:?}: {e}: {out:?}"));
    (out.status.code().unwrap(), value)
}

fn pipeline(folder: &Path, text: &str) -> String {
    let file = folder.join("p.toml");
    std::fs::write(&file, text).unwrap();
    std::fs::write(folder.join("a.geojson"), "{}").unwrap();
    file.to_str().unwrap().to_string()
}

const GOOD: &str = "[node.read]\nop = \"read-geojson\"\npath = \"a.geojson\"\n";

#[test]
fn bad_usage_is_2_and_says_so() {
    for args in [&["chek"][..], &[], &["check"], &["check", "a", "--fnord"], &["-j", "0", "ops"], &["ops", "clutser"]] {
        let out = lodge(args);
        assert_eq!(out.status.code(), Some(2), "{args:?}");
        assert!(out.stdout.is_empty() && !out.stderr.is_empty(), "{args:?}");
        let (code, value) = json(&[args, &["--json"]].concat());
        assert_eq!((code, &value["ok"]), (2, &Value::Bool(false)));
        let first = &value["diagnostics"][0];
        assert!(first["message"].as_str().is_some_and(|m| !m.is_empty()), "{value}");
        for key in
            ["code", "severity", "file", "line", "column", "end-line", "end-column", "node", "value", "suggestion"]
        {
            assert!(first.get(key).is_some(), "{key} in {value}");
        }
    }
    assert_eq!(lodge(&["--help"]).status.code(), Some(0));
    assert_eq!(lodge(&["--version"]).status.code(), Some(0));
}

#[test]
fn a_broken_pipeline_is_2_in_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let file = pipeline(folder.path(), &GOOD.replace("path", "paht"));
    for command in ["check", "graph"] {
        let out = lodge(&[command, &file]);
        assert_eq!(out.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&out.stderr).contains("p.toml:3:1"), "{out:?}");
        let (code, value) = json(&[command, &file, "--json"]);
        assert_eq!((code, &value["ok"], &value["diagnostics"][0]["line"]), (2, &false.into(), &3.into()));
        assert_eq!(value["diagnostics"][0]["suggestion"], "did you mean `path`?");
    }
}

#[test]
fn check_and_graph_of_a_good_one() {
    let folder = tempfile::tempdir().unwrap();
    let file = pipeline(folder.path(), GOOD);
    let (code, value) = json(&["check", &file, "--json"]);
    assert_eq!((code, &value["ok"], &value["files"][0]["nodes"]), (0, &true.into(), &1.into()));
    assert_eq!(json(&["check", &file, "--json", "--set", "node.read.crs=EPSG:28992"]).0, 0);
    assert_eq!(json(&["check", &file, "--json", "--set", "node.read.max-rejected=3"]).0, 2);
    let picture = folder.path().join("g.svg");
    let out = lodge(&["graph", &file, "-o", picture.to_str().unwrap()]);
    assert_eq!((out.status.code(), out.stdout.len()), (Some(0), 0), "{out:?}");
    assert!(std::fs::read_to_string(&picture).unwrap().starts_with("<svg"));
    assert!(!folder.path().join(".lodge").exists(), "a drawing makes no cache");
    let nowhere = folder.path().join("no/g.svg");
    assert_eq!(lodge(&["graph", &file, "-o", nowhere.to_str().unwrap()]).status.code(), Some(1));
}

#[test]
fn the_manual_and_the_schema() {
    let (code, value) = json(&["ops", "cluster", "--json"]);
    assert_eq!((code, &value["result"]), (0, &"Dendrogram".into()));
    assert!(value["params"]["distance"].is_object() && value["summary"]["merges"].is_string());
    assert!(json(&["ops", "--json"]).1["operators"].as_array().unwrap().len() > 5);
    assert_eq!(json(&["schema"]).1["$schema"], "http://json-schema.org/draft-07/schema#");
}

#[test]
fn an_operator_for_benches_works_and_is_shown_nowhere() {
    let folder = tempfile::tempdir().unwrap();
    let file = pipeline(folder.path(), "[node.a]\nop = \"concat\"\n[node.b]\nop = \"concat\"\nin.parts = \"a\"\n");
    assert_eq!(lodge(&["check", &file]).status.code(), Some(0));
    let run = lodge(&["run", &file]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let typo = pipeline(folder.path(), "[node.a]\nop = \"concta\"\n");
    for args in [&["ops"][..], &["ops", "--json"], &["schema"], &["ops", "concta"], &["check", &typo]] {
        let out = lodge(args);
        let said = [out.stdout, out.stderr].concat();
        assert!(!String::from_utf8_lossy(&said).contains("concat"), "{args:?}");
    }
}
