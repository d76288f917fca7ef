//! Files among the snapshots that no lodge wrote.

use serde_json::{Value, json};

use super::{four, say, squares};

/// What cannot be read is named, harms nobody, and stands in nobody's way.
#[cfg(unix)]
#[test]
fn hostile_files_among_the_snapshots_stop_nothing() {
    let place = four();
    say(&place, &["test", "four.toml"]);
    let outside = place.write("outside", "mine");
    let at = |name: &str| place.path("snapshots").join(name);
    let bad = ["bytes", "folder", "huge", "link", "pipe"].map(|n| at(&format!("four__{n}.snap.new")));
    let make = || {
        std::fs::write(&bad[0], b"---\n\xff").unwrap();
        std::fs::create_dir_all(&bad[1]).unwrap();
        std::fs::File::create(&bad[2]).unwrap().set_len(1 << 40).unwrap();
        let _ = std::os::unix::fs::symlink(&outside, &bad[3]);
        let _ = nix::unistd::mkfifo(&bad[4], nix::sys::stat::Mode::S_IRWXU);
    };
    make();
    let told_json = |args: &[&str]| -> (i32, Value) {
        let done = place.lodge(&[&["--json"], args].concat());
        (done.status.code().unwrap(), serde_json::from_slice(&done.stdout).unwrap())
    };
    for args in [&["pending"][..], &["pending", "four.toml"]] {
        let (code, all) = told_json(args);
        assert_eq!((code, &all["ok"], all["pending"].as_array().unwrap().len()), (1, &json!(false), 3));
        let named: Vec<&str> =
            all["diagnostics"].as_array().unwrap().iter().map(|d| d["message"].as_str().unwrap()).collect();
        assert_eq!(named.len(), 5, "{all}");
        for (message, word) in
            named.iter().zip(["UTF-8", "not a regular file", "larger", "a link", "not a regular file"])
        {
            assert!(message.contains(word), "{message}: {word}");
        }
        let (code, text) = say(&place, args);
        assert!(
            code == 1 && text.contains("new: plan (four)") && text.contains("four__pipe.snap.new: it is not"),
            "{text}"
        );
    }
    let (code, all) = told_json(&["accept"]);
    assert_eq!(
        (code, all["accepted"].as_array().unwrap().len(), all["diagnostics"].as_array().unwrap().len()),
        (1, 3, 5)
    );
    assert!(at("four__plan.snap").is_file() && !at("four__link.snap").exists());
    // Rejected they go, but for the folder.
    let (code, all) = told_json(&["reject"]);
    assert_eq!(
        (code, all["rejected"].as_array().unwrap().len(), all["diagnostics"].as_array().unwrap().len()),
        (1, 4, 1)
    );
    assert_eq!(std::fs::read_to_string(&outside).unwrap(), "mine");

    // In the place of a file that `test` writes, and of one that it reads.
    place.write("four.geojson", squares(0.0001001));
    std::os::unix::fs::symlink(&outside, at("four__plan.snap.new")).unwrap();
    assert_eq!(say(&place, &["test", "four.toml"]).0, 3);
    assert_eq!(std::fs::read_to_string(&outside).unwrap(), "mine");
    assert!(at("four__plan.snap.new").symlink_metadata().unwrap().is_file());
    std::fs::remove_file(at("four__plan.snap")).unwrap();
    nix::unistd::mkfifo(&at("four__plan.snap"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    let (code, text) = say(&place, &["test", "four.toml"]);
    assert!(code == 3 && text.contains("four__plan.snap: it is not a regular file"), "{code} {text}");
}

/// It is named, and the stages of all others are compared.
#[cfg(unix)]
#[test]
fn a_snapshot_that_cannot_be_read_is_that_nodes_alone() {
    use std::os::unix::fs::PermissionsExt;
    let place = four();
    say(&place, &["test", "four.toml"]);
    say(&place, &["accept"]);
    let at = |name: &str| place.path("snapshots").join(name);
    let (plan, tree) = (at("four__plan.snap"), at("four__tree-min-distance-0.01.snap"));
    let (right, other) = (std::fs::read_to_string(&plan).unwrap(), std::fs::read_to_string(&tree).unwrap());
    std::fs::write(&tree, other.replace("leaves: 4", "leaves: 5")).unwrap();
    let remove = || {
        let _ = std::fs::remove_file(&plan).or_else(|_| std::fs::remove_dir(&plan));
    };
    for (what, word) in [("bytes", "UTF-8"), ("a folder", "not a regular file"), ("locked", "ermission denied")] {
        remove();
        match what {
            "bytes" => std::fs::write(&plan, b"---\n\xff").unwrap(),
            "a folder" => std::fs::create_dir(&plan).unwrap(),
            _ => {
                std::fs::write(&plan, &right).unwrap();
                std::fs::set_permissions(&plan, PermissionsExt::from_mode(0o0)).unwrap();
                if std::fs::read(&plan).is_ok() {
                    println!("skipped: this user may read everything");
                    continue;
                }
            }
        }
        let (code, text) = say(&place, &["test", "four.toml"]);
        assert!(code == 3 && text.contains("3 stages, 1 as they were, 1 differ, 1 cannot be read"), "{what}: {text}");
        assert!(text.contains("four__plan.snap: ") && text.contains(word) && text.contains("put it back"), "{text}");
        assert!(text.contains("differs: tree[min-distance=0.01]\n"), "{what}: {text}");
        let done = place.lodge(&["--json", "test", "four.toml"]);
        let told: Value = serde_json::from_slice(&done.stdout).unwrap();
        let verdicts: Vec<&Value> =
            told["pipelines"][0]["stages"].as_array().unwrap().iter().map(|s| &s["verdict"]).collect();
        assert_eq!((done.status.code(), &told["ok"]), (Some(3), &json!(false)));
        assert_eq!(verdicts, ["unreadable", "differs", "same"]);
        let wrong = told["diagnostics"].as_array().unwrap();
        assert!(wrong.len() == 1 && wrong[0]["node"] == "plan" && wrong[0].to_string().contains(word), "{told}");
        // Nothing waits in its place: what is wrong there is for a person.
        assert!(!at("four__plan.snap.new").exists() && at("four__tree-min-distance-0.01.snap.new").exists());
    }
    remove();
    let (code, text) = say(&place, &["test", "four.toml"]);
    assert!(code == 3 && text.contains("3 stages, 1 as they were, 1 differ, 1 new"), "{text}");

    // What cannot be written is a failure, and the others are written.
    for name in ["four__plan.snap.new", "four__tree-min-distance-0.01.snap.new"] {
        std::fs::remove_file(at(name)).unwrap();
    }
    std::fs::create_dir(at("four__plan.snap.new")).unwrap();
    let (code, text) = say(&place, &["test", "four.toml"]);
    assert!(code == 1 && text.contains("cannot write beside") && text.contains("four__plan.snap: "), "{code} {text}");
    assert!(text.contains("1 differ, 1 new") && at("four__tree-min-distance-0.01.snap.new").is_file(), "{text}");
}
