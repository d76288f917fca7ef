//! Missing, foreign and hostile files where lodge looks for its own: a clear message, the right exit code, no file
//! touched that is not ours, nobody waiting for ever.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use lodge::digest::Digest;
use lodge::run::pack::{Appender, What};

use super::support::Place;
use super::toy::tree;
use super::{lodge, names, town};

/// Runs the binary, and kills it where it hangs.
fn told(place: &Place, args: &[&str]) -> Output {
    let mut child = lodge(place, args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    fn read(mut from: impl std::io::Read + Send + 'static) -> std::thread::JoinHandle<Vec<u8>> {
        std::thread::spawn(move || {
            let mut all = Vec::new();
            from.read_to_end(&mut all).map(|_| all).unwrap()
        })
    }
    let (stdout, stderr) = (read(child.stdout.take().unwrap()), read(child.stderr.take().unwrap()));
    let until = Instant::now() + Duration::from_secs(120);
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if Instant::now() > until {
            super::kill_group(&mut child);
            panic!("lodge {args:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    Output { status, stdout: stdout.join().unwrap(), stderr: stderr.join().unwrap() }
}

fn fifo(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

fn remove(path: &Path) {
    match fs::symlink_metadata(path) {
        Ok(meta) if meta.is_dir() => fs::remove_dir_all(path).unwrap(),
        Ok(_) => fs::remove_file(path).unwrap(),
        Err(_) => {}
    }
}

/// What may lie in a file's or folder's place: name, and how it is made.
fn strangers(place: &Place) -> Vec<(&'static str, Box<dyn Fn(&Path)>)> {
    let treasure = place.path("treasure");
    fs::create_dir_all(&treasure).unwrap();
    fs::write(treasure.join("gold"), "gold").unwrap();
    let (folder, file) = (treasure.clone(), treasure.join("gold"));
    let mut all: Vec<(&'static str, Box<dyn Fn(&Path)>)> = vec![
        ("a file", Box::new(|p| fs::write(p, "mine").unwrap())),
        ("a folder", Box::new(|p| fs::create_dir(p).unwrap())),
        ("a pipe", Box::new(fifo)),
        ("a link to a folder", Box::new(move |p| symlink(&folder, p).unwrap())),
        ("a link to a file", Box::new(move |p| symlink(&file, p).unwrap())),
        ("a link to nothing", Box::new(|p| symlink("/nowhere/at/all", p).unwrap())),
        ("a link to an endless device", Box::new(|p| symlink("/dev/zero", p).unwrap())),
    ];
    let node = place.path("device");
    if Command::new("mknod").arg(&node).args(["c", "1", "5"]).output().is_ok_and(|o| o.status.success()) {
        all.push((
            "an endless device",
            Box::new(|p| assert!(Command::new("mknod").arg(p).args(["c", "1", "5"]).status().unwrap().success())),
        ));
    }
    all
}

fn treasure_is_there(place: &Place) {
    assert_eq!(tree(&place.path("treasure")), [("gold".to_string(), b"gold".to_vec())]);
}

#[test]
fn in_place_of_the_cache_and_its_folders() {
    let place = town(1);
    let strangers = strangers(&place);
    for part in ["", "objects", "packs", "tmp", "plans", "published", "runs", "history", "locks"] {
        for (what, make) in &strangers {
            // A folder may be one; an empty file is as good a lock file as any; a link to a folder may be the user's.
            let fine = match part {
                "" => ["a folder", "a link to a folder"].contains(what),
                "locks" => *what == "a file",
                _ => *what == "a folder",
            };
            remove(&place.path("cache"));
            remove(&place.path("out"));
            if !part.is_empty() {
                fs::create_dir(place.path("cache")).unwrap();
            }
            make(&place.path(format!("cache/{part}").trim_end_matches('/')));
            let done = told(&place, &["run", "p.toml", "districts"]);
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            let expected = if fine { 0 } else { 4 };
            assert_eq!(done.status.code(), Some(expected), "{what} as `{part}`: {said}");
            assert!(fine || said.contains("cannot use the cache"), "{what} as `{part}`: {said}");
            assert!(fine || said.contains(&format!("`{part}`")) || part.is_empty(), "{what} as `{part}`: {said}");
            if part.is_empty() && *what == "a link to a folder" {
                remove(&place.path("treasure"));
                fs::create_dir(place.path("treasure")).unwrap();
                fs::write(place.path("treasure/gold"), "gold").unwrap();
                continue;
            }
            treasure_is_there(&place);
            for args in [&["plan", "p.toml"][..], &["cache", "verify"], &["cache", "stat"], &["cache", "gc"]] {
                let done = told(&place, args);
                assert!(matches!(done.status.code(), Some(0 | 2 | 4)), "{what} as `{part}`: {args:?}: {done:?}");
            }
            treasure_is_there(&place);
        }
    }
}

#[test]
fn in_place_of_the_files_of_a_cache() {
    let place = town(1);
    place.lodge_json(&["run", "p.toml"]);
    let right = tree(&place.path("out"));
    super::copy(&place.path("cache"), &place.path("saved"));
    let name = |folder: &str| {
        let first = fs::read_dir(place.path("cache").join(folder)).unwrap().next().unwrap().unwrap();
        format!("{folder}/{}", first.file_name().into_string().unwrap())
    };
    let mut files = ["packs", "plans", "published", "runs", "history"].map(name).to_vec();
    files.extend(["CACHEDIR.TAG", ".gitignore", "runs/stamps"].map(String::from));
    // An object that the run will look for, and a pack, a plan and a run that nobody made.
    let run = place.lodge_json(&["run", "p.toml"]);
    let digest = super::support::node(&run, "tileset")["digest"].as_str().unwrap().to_string();
    files.push(format!("objects/{}/{}", &digest[..2], &digest[2..]));
    files.extend(
        ["packs/0000000000000001.pack", "plans/0123456789abcdef", "history/p-77", "tmp/1", "odd"].map(String::from),
    );
    for file in &files {
        for (what, make) in &strangers(&place) {
            super::copy(&place.path("saved"), &place.path("cache"));
            remove(&place.path("out"));
            let path = place.path("cache").join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            remove(&path);
            if file.starts_with("objects") {
                // The pack has it as well.
                fs::remove_dir_all(place.path("cache/packs")).unwrap();
            }
            make(&path);
            let context = format!("{what} as {file}");
            let done = told(&place, &["run", "p.toml"]);
            assert_eq!(done.status.code(), Some(0), "{context}: {done:?}");
            assert!(tree(&place.path("out")) == right, "{context}");
            for args in [
                &["plan", "p.toml"][..],
                &["runs", "p.toml"],
                &["cache", "stat"],
                &["cache", "verify"],
                &["cache", "gc"],
                &["run", "p.toml", "--verify"],
            ] {
                let done = told(&place, args);
                let code = done.status.code().unwrap();
                // A folder cannot be removed as a file is.
                let fine = code == 0 || code == 4 && args[1] == "verify" && *what == "a folder";
                assert!(fine, "{context}: {args:?}: {done:?}");
            }
            treasure_is_there(&place);
        }
    }
}

/// Frames that are whole by their own checks, and say what cannot be.
#[test]
fn packs_of_a_stranger() {
    let place = town(1);
    place.lodge_json(&["run", "p.toml"]);
    let right = tree(&place.path("out"));
    let pack = |name: &str| fs::File::create_new(place.path("cache/packs").join(name)).unwrap();
    // A head that promises four gigabytes, twice; a result that is none; an object under another's name.
    let path = place.path("cache/packs/0000000000000002.pack");
    let mut out = Appender::new(pack("0000000000000002.pack"));
    out.append(What::Object, &Digest::of(b"a"), &[b"b"]).unwrap();
    out.append(What::Result, &Digest::of(b"key"), &[vec![255; 100]]).unwrap();
    drop(out);
    let mut bytes = fs::read(&path).unwrap();
    let mut head = bytes[..44].to_vec();
    head[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    let check = Digest::of(&head);
    head.extend(&check.0[..8]);
    bytes.extend(head.repeat(2));
    fs::write(&path, bytes).unwrap();
    // Nothing but holes, and much of it.
    pack("0000000000000003.pack").set_len(1 << 30).unwrap();
    fs::File::create(place.path("cache/plans/0123456789abcdef")).unwrap().set_len(1 << 42).unwrap();
    fs::File::create(place.path("cache/history/p-99")).unwrap().set_len(1 << 42).unwrap();
    remove(&place.path("out"));
    let run = place.lodge_json(&["run", "p.toml", "--verify"]);
    assert_eq!(names(&run, "ran"), [""; 0]);
    assert!(tree(&place.path("out")) == right);
    assert!(told(&place, &["runs", "p.toml"]).status.success());
    let verify = place.lodge_json(&["cache", "verify"]);
    assert_eq!(verify["evicted"].as_array().unwrap().len(), 3, "{verify}");
    assert!(!place.path("cache/history/p-99").exists(), "the run made room");
    assert_eq!(place.lodge_json(&["cache", "verify"])["evicted"], serde_json::json!([]));
}

#[test]
fn in_place_of_outputs() {
    let place = town(1);
    place.lodge_json(&["run", "p.toml"]);
    let right = tree(&place.path("out"));
    let file = right.iter().find(|f| f.0.contains("tileset/")).unwrap().0.clone();
    let folder = Path::new(&file).parent().unwrap().to_str().unwrap().to_string();
    for at in [&file, &folder] {
        for (what, make) in &strangers(&place) {
            let path = place.path("out").join(at);
            remove(&path);
            make(&path);
            let done = told(&place, &["run", "p.toml"]);
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            if *what == "a folder" && at == &file {
                // It may hold something of somebody's.
                assert_eq!(done.status.code(), Some(1), "{what} as {at}: {said}");
                assert!(said.contains("is a folder"), "{said}");
                remove(&path);
                assert_eq!(told(&place, &["run", "p.toml"]).status.code(), Some(0));
            }
            assert!(done.status.success() || *what == "a folder", "{what} as {at}: {said}");
            assert!(tree(&place.path("out")) == right, "{what} as {at}");
            treasure_is_there(&place);
        }
    }
    // No path in a pipeline leads out of there.
    for path in ["../x.geojson", "/tmp/x.geojson", "a/../../x.geojson", "", ".", "a/..", "~/../../x"] {
        let text = format!("extends = \"p.toml\"\n[node.plan]\npath = {path:?}\n");
        place.write("q.toml", text);
        let done = told(&place, &["run", "q.toml", "plan"]);
        assert_eq!(done.status.code(), Some(2), "{path}: {done:?}");
        assert!(!place.path("out/q").exists() && !place.path("x.geojson").exists(), "{path}");
    }
}

#[test]
fn in_place_of_snapshots() {
    let place = town(1);
    let file = fs::read_to_string(place.path("p.toml")).unwrap();
    place.write("p.toml", file + "[node]\nplan = false\nmodel = false\ntileset = false\ntiles = false\nlandmarks = false\n\"blocks-of-stone\" = false\n");
    assert_eq!(told(&place, &["test", "p.toml"]).status.code(), Some(3));
    assert_eq!(told(&place, &["accept", "p.toml"]).status.code(), Some(0));
    super::copy(&place.path("snapshots"), &place.path("saved"));
    for name in ["p__hulls.snap", "p__hulls.snap.new", "p__blocks.snap", "odd", "p__gone.snap", "p__gone.snap.new"] {
        for (what, make) in &strangers(&place) {
            super::copy(&place.path("saved"), &place.path("snapshots"));
            let path = place.path("snapshots").join(name);
            remove(&path);
            make(&path);
            for args in [
                &["test", "p.toml", "--set", "node.hulls.keep=0.5"][..],
                &["test", "p.toml"],
                &["pending", "p.toml"],
                &["accept", "p.toml"],
                &["test", "p.toml"],
                &["reject", "p.toml"],
            ] {
                let done = told(&place, args);
                let code = done.status.code().unwrap();
                assert!([0, 1, 2, 3].contains(&code), "{what} as {name}: {args:?}: {done:?}");
                let said = String::from_utf8_lossy(&done.stderr);
                assert!(
                    code == 0 || code == 3 || said.contains("snapshots") || said.contains("pending"),
                    "{what} as {name}: {args:?}: {said}"
                );
                assert!(!said.contains("panicked"), "{what} as {name}: {args:?}: {said}");
            }
            treasure_is_there(&place);
        }
    }
}

#[test]
fn in_place_of_pipelines_and_inputs() {
    let place = town(1);
    let text = |path: &str| format!("[node.read]\nop = \"read-geojson\"\npath = {path:?}\n");
    for (what, make) in &strangers(&place) {
        for name in ["bad.toml", "bad.geojson"] {
            let path = place.path(name);
            remove(&path);
            make(&path);
            let file = if name == "bad.toml" { "bad.toml" } else { "q.toml" };
            if name == "bad.geojson" {
                place.write("q.toml", text(name));
            }
            for command in ["check", "run", "plan"] {
                let done = told(&place, &[command, file]);
                let code = done.status.code().unwrap();
                let said = String::from_utf8_lossy(&done.stderr);
                let fine = if command == "run" { [1, 2].contains(&code) } else { [0, 2].contains(&code) };
                assert!(fine, "{what} as {name}: {command}: {code} {said}");
                assert!(!said.contains("panicked"), "{what} as {name}: {said}");
            }
            remove(&path);
        }
    }
}
