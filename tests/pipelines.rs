//! Every shipped pipeline runs, from nothing, and each of its stages is as its snapshot says.

mod support;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The binary with a cache and outputs of its own.
fn lodge(home: &Path) -> Command {
    let mut command = support::binary();
    command.arg("--cache").arg(home.join("cache")).arg("--out").arg(home.join("out"));
    command.current_dir(home);
    command
}

fn text(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat()
}

fn shipped() -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join("pipelines")).unwrap().map(|e| e.unwrap().path());
    let mut out: Vec<PathBuf> = entries.filter(|p| p.extension().is_some_and(|e| e == "toml")).collect();
    out.sort();
    out
}

#[test]
fn every_stage_is_as_its_snapshot_says() {
    let home = tempfile::tempdir().unwrap();
    // In CI nothing is written: what is new or differs is told, and fails.
    let output = lodge(home.path()).arg("test").args(shipped()).env("CI", "1").output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    assert_eq!(text(&output).matches(" as they were\n").count(), shipped().len(), "{}", text(&output));
    assert!(!text(&output).contains("no such stage any more"), "{}", text(&output));
}

#[test]
fn no_snapshot_waits() {
    let waiting: Vec<PathBuf> = std::fs::read_dir(root().join("pipelines/snapshots"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "new"))
        .collect();
    assert_eq!(waiting, [] as [PathBuf; 0]);
}

#[test]
fn the_town_is_published() {
    let home = tempfile::tempdir().unwrap();
    let output = lodge(home.path()).arg("run").arg(root().join("pipelines/town.toml")).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    let out = home.path().join("out/town");
    let tileset: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("tileset/tileset.json")).unwrap()).unwrap();
    assert_eq!(tileset["asset"]["version"], "1.1");
    // Inner tiles are not empty: that is what all of this is for.
    let (mut tiles, mut inner) = (vec![&tileset["root"]], 0);
    while let Some(tile) = tiles.pop() {
        let content = tile["content"]["uri"].as_str().expect("every tile has content");
        assert!(out.join("tileset").join(content).is_file(), "{content}");
        let children = tile["children"].as_array().map_or(&[][..], |c| c);
        inner += usize::from(!children.is_empty());
        tiles.extend(children);
    }
    assert!(inner > 0);
    for clusters in [40, 150, 600] {
        assert!(out.join(format!("districts-{clusters}.geojson")).is_file());
        assert!(out.join(format!("districts-{clusters}.glb")).is_file());
    }
}

/// README shows what lodge draws today. With `LODGE_UPDATE=1` its pictures are drawn anew.
#[test]
fn the_pictures_of_readme_are_as_lodge_draws_them() {
    let home = tempfile::tempdir().unwrap();
    for (pipeline, node, name) in [
        ("town", "footprints", "town-buildings.svg"),
        ("town", "districts[clusters=600]", "town-600.svg"),
        ("town", "districts[clusters=40]", "town-40.svg"),
        ("impostor", "impostor[resolution=128]", "pavilion-128.png"),
    ] {
        let (picture, drawn) = (root().join("pipelines/pictures").join(name), home.path().join(name));
        let pipeline = root().join(format!("pipelines/{pipeline}.toml"));
        let output = lodge(home.path()).arg("export").arg(&pipeline).args([node, "-o", name]).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output));
        if std::env::var_os("LODGE_UPDATE").is_some() {
            std::fs::copy(&drawn, &picture).unwrap();
        }
        let (drawn, shown) = (std::fs::read(&drawn).unwrap(), std::fs::read(&picture).unwrap_or_default());
        assert!(drawn == shown, "{name} is of another day: LODGE_UPDATE=1 cargo test --test pipelines");
        assert!(shown.len() < 600_000, "{name} is to stay small: {} bytes", shown.len());
    }
}

#[test]
fn a_file_for_each_resolution() {
    let home = tempfile::tempdir().unwrap();
    let pipeline = root().join("pipelines/impostor.toml");
    let set = ["--set", "node.voxels.matrix.resolution=[12, 16]"];
    let output = lodge(home.path()).arg("run").arg(pipeline).args(set).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    let mut names: Vec<_> =
        std::fs::read_dir(home.path().join("out/impostor")).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["impostor-12.glb", "impostor-16.glb"]);
}

/// The life of a snapshot: new, accepted, the same, different, rejected.
#[test]
fn snapshots_are_made_accepted_and_rejected() {
    let home = tempfile::tempdir().unwrap();
    let squares = |side: f64| {
        let feature = |k: usize| {
            let [x, y] = [5.7 + 0.001 * k as f64, 53.8];
            let ring = [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side], [0.0, 0.0]].map(|p| [x + p[0], y + p[1]]);
            serde_json::json!({"type": "Feature", "id": format!("s{k}"), "properties": {"height": 5.0},
                "geometry": {"type": "Polygon", "coordinates": [ring]}})
        };
        let all: Vec<_> = (0..4).map(feature).collect();
        serde_json::json!({"type": "FeatureCollection", "features": all}).to_string()
    };
    let write = |name: &str, text: &str| std::fs::write(home.path().join(name), text).unwrap();
    write("four.geojson", &squares(0.0001));
    write(
        "four.toml",
        "[node.plan]\nop = \"read-geojson\"\npath = \"four.geojson\"\n\
         [node.tree]\nop = \"cluster\"\nin.footprints = \"plan\"\nmatrix.min-distance = [0.01, 0.1]\n",
    );
    let say = |args: &[&str]| {
        let output = lodge(home.path()).args(args).output().unwrap();
        (output.status.code().unwrap(), text(&output))
    };
    let files = || {
        let entries = std::fs::read_dir(home.path().join("snapshots")).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };

    let (code, told) = say(&["test", "four.toml"]);
    assert_eq!(code, 3, "{told}");
    assert!(told.contains("3 stages, 0 as they were, 3 new"), "{told}");
    let all = ["four__plan.snap", "four__tree-min-distance-0.01.snap", "four__tree-min-distance-0.1.snap"];
    assert_eq!(files(), all.map(|n| format!("{n}.new")));

    assert_eq!(say(&["accept", "four.toml", "tree"]).0, 0);
    assert_eq!(files(), [format!("{}.new", all[0]), all[1].into(), all[2].into()]);
    assert_eq!(say(&["accept", "four.toml", "tree"]).0, 2);
    assert_eq!(say(&["accept"]).0, 0);
    assert_eq!(files(), all);
    assert_eq!(say(&["test", "four.toml"]).0, 0);
    assert_eq!(say(&["test", "--exact", "four.toml"]).0, 0);

    // A millimetre is a difference; in CI nothing is written about it.
    write("four.geojson", &squares(0.0001001));
    let output = lodge(home.path()).args(["test", "four.toml"]).env("CI", "true").output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", text(&output));
    assert_eq!(files(), all);
    let (code, told) = say(&["test", "four.toml"]);
    assert_eq!(code, 3, "{told}");
    assert!(told.contains("differs: plan") && told.contains("\n    -") && told.contains("\n    +"), "{told}");
    assert!(files().contains(&format!("{}.new", all[0])));
    assert_eq!(say(&["reject", "four.toml"]).0, 0);
    assert_eq!(files(), all);

    // What waits is forgotten when the stage is as it was again.
    assert_eq!(say(&["test", "four.toml"]).0, 3);
    write("four.geojson", &squares(0.0001));
    assert_eq!(say(&["test", "four.toml"]).0, 0);
    assert_eq!(files(), all);
}
