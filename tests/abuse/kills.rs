//! `kill -9` of the whole process group at any moment.

use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

use serde_json::Value;

use super::support::{Place, node};
use super::toy::{Yard, tree};
use super::{Random, is_empty, kill_group, lodge, names, times, town};

/// Name, size and time of everything below a folder.
fn stamps(folder: &Path) -> Vec<(std::path::PathBuf, u64, SystemTime)> {
    let mut out = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let entry = entry.unwrap();
            let meta = entry.metadata().unwrap();
            if meta.is_dir() {
                folders.push(entry.path());
            }
            out.push((entry.path(), meta.len(), meta.modified().unwrap()));
        }
    }
    out.sort();
    out
}

/// Nodes that the events of a killed run say had run.
fn told(events: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(events).unwrap_or_default();
    let lines = text.split_inclusive('\n').filter(|l| l.ends_with('\n'));
    let events = lines.map(|l| serde_json::from_str::<Value>(l).unwrap());
    let ran = events.filter(|e| e["event"] == "node-done" && e["status"] == "ran");
    ran.map(|e| e["node"].as_str().unwrap().to_string()).collect()
}

/// Waits, kills, and sees that nobody goes on writing. False where the run had ended before.
fn strike(place: &Place, mut child: std::process::Child, after: Duration) -> bool {
    std::thread::sleep(after);
    if child.try_wait().unwrap().is_some() {
        return false;
    }
    let group = child.id();
    kill_group(&mut child);
    let frozen = [place.path("cache"), place.path("out")].map(|f| stamps(&f));
    std::thread::sleep(Duration::from_millis(5));
    assert_eq!(frozen, [place.path("cache"), place.path("out")].map(|f| stamps(&f)), "an orphan writes on");
    let left = std::process::Command::new("kill").args(["-0", "--", &format!("-{group}")]).output().unwrap();
    assert!(!left.status.success(), "a process of the killed run is left");
    true
}

#[test]
fn a_killed_run_is_taken_up_where_it_was() {
    let place = town(24);
    place.lodge_json(&["run", "p.toml"]);
    let clean = tree(&place.path("out"));
    let mut random = Random::new("kills");
    let (mut kills, mut early, mut nodes, mut redone) = (0, 0, 0, 0);
    let mut length = Duration::ZERO;
    while kills < times(200) {
        ["cache", "out"].iter().for_each(|f| std::fs::remove_dir_all(place.path(f)).unwrap_or_default());
        let _ = std::fs::remove_file(place.path("e.jsonl"));
        let started = Instant::now();
        let mut child = lodge(&place, &["run", "p.toml", "--events", "e.jsonl"]).spawn().unwrap();
        if length.is_zero() {
            assert!(child.wait().unwrap().success());
            length = started.elapsed();
            continue;
        }
        if !strike(&place, child, length.mul_f64(random.below(1000) as f64 / 1000.0)) {
            early += 1;
            assert!(early < 200 + times(2000), "the runs end before they are killed");
            continue;
        }
        kills += 1;
        let stat = place.lodge_json(&["cache", "stat"]);
        let again = place.lodge_json(&["run", "p.toml"]);
        // Exactly what was not finished, and it needs no words.
        let all = again["nodes"].as_array().unwrap().len();
        let ran = names(&again, "ran").len();
        assert_eq!(ran, all - stat["results"].as_u64().unwrap() as usize, "kill {kills}");
        for name in told(&place.path("e.jsonl")) {
            assert_eq!(node(&again, &name)["status"], "cached", "kill {kills}: {name}");
        }
        assert_eq!(again["warnings"], serde_json::json!([]), "kill {kills}");
        let out = tree(&place.path("out"));
        let odd: Vec<&str> = out.iter().filter(|f| !clean.contains(f)).map(|f| &*f.0).collect();
        assert!(out == clean, "kill {kills}: {} files for {}, of which differ {odd:?}", out.len(), clean.len());
        // What was torn is passed over, and goes.
        let verify = place.lodge_json(&["cache", "verify"]);
        assert!(is_empty(&place.path("cache/tmp")), "kill {kills}");
        assert!(verify["unrepaired"] == verify["missing"] && verify["missing"] == verify["changed"], "{verify}");
        let none = place.lodge_json(&["run", "p.toml", "--verify"]);
        assert_eq!(names(&none, "ran"), [""; 0], "kill {kills}");
        (nodes, redone) = (nodes + all, redone + ran);
    }
    println!("{kills} kills at work, {redone} of {nodes} nodes redone, {early} runs ended before");
    assert!(redone > 0 && redone < nodes, "all kills came at one moment");
}

/// Both settings are cached: the killed run has nothing to do but to publish.
#[test]
fn a_run_that_is_killed_while_it_publishes_leaves_nothing_behind() {
    let place = town(6);
    const OTHER: &str = "node.tiles.max-triangles=700";
    // On another device, too: there files are copied, not renamed.
    let shm = tempfile::Builder::new().prefix("lodge-").tempdir_in("/dev/shm").ok();
    let outs: Vec<_> =
        [Some(place.path("out")), shm.as_ref().map(|d| d.path().join("out"))].into_iter().flatten().collect();
    let args = |out: &Path, other: bool| -> Vec<String> {
        let mut all = vec!["run".to_string(), "p.toml".into(), "--out".into(), out.to_str().unwrap().into()];
        all.extend(other.then(|| format!("--set={OTHER}")));
        all
    };
    let run = |out: &Path, other: bool| {
        let args = args(out, other);
        place.lodge_json(&args.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let clean = [false, true].map(|other| {
        run(&outs[0], other);
        tree(&outs[0])
    });
    assert!(clean[1].len() > clean[0].len() + 10);
    let mut random = Random::new("kills while publishing");
    let (mut kills, mut early, mut littered) = (0, 0, 0);
    let mut length = Duration::ZERO;
    while kills < times(200) || littered == 0 {
        assert!(kills < times(4000), "no kill came while files were written");
        let out = &outs[random.below(outs.len())];
        let other = random.below(2) == 1;
        run(out, !other);
        let args = args(out, other);
        let started = Instant::now();
        let mut child = lodge(&place, &args.iter().map(String::as_str).collect::<Vec<_>>()).spawn().unwrap();
        if length.is_zero() {
            assert!(child.wait().unwrap().success());
            length = started.elapsed();
            continue;
        }
        if !strike(&place, child, length.mul_f64(random.below(1000) as f64 / 1000.0)) {
            early += 1;
            assert!(early < 400 + times(4000), "the runs end before they are killed");
            continue;
        }
        kills += 1;
        littered += usize::from(!clean.contains(&tree(out)));
        let other = random.below(2) == 1;
        let again = run(out, other);
        assert_eq!(names(&again, "ran"), [""; 0], "kill {kills}");
        assert!(tree(out) == clean[usize::from(other)], "kill {kills}");
    }
    place.lodge_json(&["cache", "verify"]);
    assert!(is_empty(&place.path("cache/tmp")));
    println!("{kills} kills at work, {littered} with files of both runs, {early} runs ended before");
}

/// A file is copied, then renamed, where outputs and cache lie on different devices. The killed run had noted what it
/// was about to write.
#[test]
fn half_a_file_on_another_device_goes() {
    use lodge::run::published::{self, Published};
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    yard.ran();
    let clean = tree(&yard.out());
    let half = |name: &str| format!(".lodge-{}", lodge::digest::Digest::of(name.as_bytes()).short(12));
    std::fs::write(yard.out().join("files/n").join(half("77.txt")), "ha").unwrap();
    std::fs::write(yard.out().join("files/n").join(half("mine.txt")), "somebody's").unwrap();
    {
        let store = lodge::run::store::Store::open(&home.path().join(".lodge")).unwrap();
        let (name, folder) = published::all(&store).into_iter().next().unwrap();
        let files: Vec<Published> = folder.files.into_iter().map(|f| f.0).collect();
        let planned = Published { path: "files/n/77.txt".into(), node: "out".into(), ..Published::default() };
        let all = files.iter().map(|f| (&*f.path, f)).collect();
        let state = published::write_state(&yard.graph(), &yard.out(), &all, [&planned].into_iter());
        store.put_state("published", &name, &state).unwrap();
    }
    assert_eq!(yard.ran(), [""; 0]);
    std::fs::remove_file(yard.out().join("files/n").join(half("mine.txt"))).unwrap();
    assert!(tree(&yard.out()) == clean);
}
