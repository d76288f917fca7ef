//! What becomes of snapshots that differ: listed, reviewed at a terminal, accepted by us or by insta; and of those
//! whose node is gone.

mod support;

use std::process::Output;

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

    // A file that cannot be read is named.
    std::fs::write(place.path("snapshots/four__odd.snap.new"), b"---\n\xff").unwrap();
    let (code, text) = say(&place, &["pending"]);
    assert!(code == 1 && text.contains("four__odd.snap.new"), "{code} {text}");
}
