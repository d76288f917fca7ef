//! What runs again after which change, and what damage costs.

mod toy;

use std::collections::BTreeMap;
use std::fs;

use lodge::digest::Digest;
use lodge::run::event::Status;
use lodge::run::published::{self, Published};
use lodge::run::stamp::Stamp;
use lodge::run::store::Store;
use lodge::run::verify::verify;
use serde_json::json;
use toy::{Yard, tree};

#[test]
fn nothing_runs_twice() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    assert_eq!(yard.ran(), ["read", "left", "right", "both", "out"]);
    let before = tree(&yard.out());
    assert_eq!(before.len(), 47);
    assert_eq!(yard.ran(), [""; 0]);
    let again = yard.run();
    assert!(again.files.iter().all(|f| !f.written));
    assert_eq!(tree(&yard.out()), before);
}

#[test]
fn touching_an_input_runs_nothing() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    yard.ran();
    yard.file("data.txt", "1 2 3.5");
    assert_eq!(yard.ran(), [""; 0]);
}

#[test]
fn an_input_that_gives_an_equal_result_runs_its_reader_only() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    yard.ran();
    yard.file("data.txt", "1 2 3.25");
    assert_eq!(yard.ran(), ["read"]);
    yard.file("data.txt", "1 2 4");
    assert_eq!(yard.ran(), ["read", "left", "right", "both", "out"]);
}

#[test]
fn a_parameter_runs_its_node_and_those_whose_inputs_changed() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.ran();
    yard.set("left", "add", json!(2));
    assert_eq!(yard.ran(), ["left", "both", "out"]);
    // Another parameter, the same result.
    yard.set("left", "slow-ms", json!(1));
    assert_eq!(yard.ran(), ["left"]);
    // 2 and 2.0 are equal; the old value is still known.
    yard.set("left", "add", json!(2.0));
    assert_eq!(yard.ran(), [""; 0]);
    yard.set("left", "add", json!(1));
    yard.set("left", "slow-ms", json!(0));
    assert_eq!(yard.ran(), [""; 0]);
}

#[test]
fn twins_are_computed_once() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.set("right", "add", json!(1));
    yard.set("right", "more", json!(0));
    let outcome = yard.run();
    assert!(outcome.ok());
    assert_eq!(yard.names(&outcome, Status::Cached), ["right"]);
}

#[test]
fn changed_and_deleted_outputs_come_back() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    yard.ran();
    let right = tree(&yard.out());
    let file = yard.out().join("files/index.txt");
    let meta = fs::metadata(&file).unwrap();
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace('2', "3")).unwrap();
    fs::File::options().write(true).open(&file).unwrap().set_modified(meta.modified().unwrap()).unwrap();
    fs::remove_file(yard.out().join("files/n/0.txt")).unwrap();
    fs::remove_file(yard.out().join("files/n/1.txt")).unwrap();
    std::os::unix::fs::symlink(&file, yard.out().join("files/n/1.txt")).unwrap();
    let outcome = yard.run();
    assert!(outcome.ok() && yard.names(&outcome, Status::Ran).is_empty());
    assert_eq!(outcome.files.iter().filter(|f| f.written).count(), 3);
    assert_eq!(tree(&yard.out()), right);
    assert!(fs::symlink_metadata(yard.out().join("files/n/1.txt")).unwrap().is_file());
}

#[test]
fn what_is_no_longer_made_goes_and_what_is_foreign_stays() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.ran();
    let changed = yard.out().join("files/n/41.txt");
    fs::write(&changed, "mine now").unwrap();
    fs::write(yard.out().join("files/n/foreign.txt"), "mine").unwrap();
    yard.set("right", "more", json!(0));
    yard.ran();
    let names: Vec<_> = tree(&yard.out()).into_iter().map(|f| f.0).collect();
    assert_eq!(names.len(), 7 + 2, "{names:?}");
    assert_eq!(fs::read_to_string(&changed).unwrap(), "mine now");
    yard.set("out", "path", json!("other"));
    yard.ran();
    let names: Vec<_> = tree(&yard.out()).into_iter().map(|f| f.0).collect();
    assert_eq!(names.len(), 7 + 2, "{names:?}");
}

/// Whatever an operator calls its files, and whatever a forged note says that lies there.
#[test]
fn nothing_is_published_or_removed_outside_the_output_folder() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.ran();
    let clean = tree(&yard.out());
    let (escaped, mine) = (home.path().join("escaped"), yard.file("mine.txt", "mine"));
    for path in ["../../escaped", "files/../../../escaped", escaped.to_str().unwrap()] {
        yard.set("out", "path", json!(path));
        let outcome = yard.run();
        assert!(!outcome.ok() && outcome.errors.iter().all(|e| e.code == "outside"), "{path}: {:?}", outcome.errors);
        assert!(!escaped.exists() && tree(&yard.out()) == clean, "{path}");
    }
    yard.set("out", "path", json!("files"));
    assert_eq!(yard.ran(), [""; 0]);
    // As if it had lain there, unchanged, with other bytes; as if it were about to be written.
    let forge = |path: &str, planned: bool| {
        let store = Store::open(&home.path().join(".lodge")).unwrap();
        let (name, folder) = published::all(&store).into_iter().next().unwrap();
        let files: Vec<Published> = folder.files.into_iter().map(|f| f.0).collect();
        let stamp = Stamp::of_output(&mine).unwrap();
        let bad = Published { path: path.into(), node: "gone".into(), stamp, ..Published::default() };
        let bad = Published { digest: Digest::of(if planned { b"mine" } else { b"ours" }), ..bad };
        let mut all: BTreeMap<&str, &Published> = files.iter().map(|f| (&*f.path, f)).collect();
        if !planned {
            all.insert(path, &bad);
        }
        let state =
            published::write_state(&yard.graph(), &yard.out(), &all, Some(&bad).into_iter().filter(|_| planned));
        store.put_state("published", &name, &state).unwrap();
    };
    for path in ["../../mine.txt", mine.to_str().unwrap()] {
        for planned in [false, true] {
            forge(path, planned);
            assert_eq!(yard.ran(), [""; 0], "{path}");
            forge(path, planned);
            let found = verify(&Store::open(&home.path().join(".lodge")).unwrap());
            assert_eq!(found.evicted.len(), 1, "{path}: {found:?}");
            assert_eq!(yard.ran(), [""; 0], "{path}");
            assert!(fs::read_to_string(&mine).unwrap() == "mine" && tree(&yard.out()) == clean, "{path}");
        }
    }
}

/// Somebody moved the files, and left a link to them: they are not lodge's any more.
#[test]
fn behind_a_link_in_place_of_a_folder_nothing_is_published_or_removed() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.ran();
    let (folder, aside) = (yard.out().join("files"), home.path().join("aside"));
    let clean = tree(&yard.out());
    for more in [40, 0] {
        let _ = fs::remove_dir_all(&aside);
        fs::rename(&folder, &aside).unwrap();
        std::os::unix::fs::symlink(&aside, &folder).unwrap();
        let moved = tree(&aside);
        yard.set("right", "more", json!(more));
        yard.ran();
        assert!(fs::symlink_metadata(&folder).unwrap().is_dir() && tree(&aside) == moved);
        // Or fewer of them.
        assert!(tree(&yard.out()) == clean || more == 0 && tree(&folder).len() < moved.len());
    }
}

#[test]
fn damage_in_the_cache_reaches_no_output() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    yard.ran();
    let right = tree(&yard.out());
    let cache = home.path().join(".lodge");
    let files: Vec<_> = tree(&cache).into_iter().filter(|(n, _)| n != "locks" && !n.starts_with("tmp/")).collect();
    let mut random = 12345u64;
    let mut next = |n: usize| {
        random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (random >> 33) as usize % n
    };
    for round in 0..60 {
        let (name, bytes) = &files[next(files.len())];
        let path = cache.join(name);
        let mut bad = fs::read(&path).unwrap_or_else(|_| bytes.clone());
        let at = next(bad.len().max(1));
        match round % 5 {
            0 if !bad.is_empty() => bad[at] ^= 1 << next(8),
            1 => bad.truncate(at),
            2 => bad.extend([7; 20]),
            3 => bad = files[next(files.len())].1.clone(),
            _ => bad.clear(),
        }
        let _ = fs::remove_file(&path);
        fs::write(&path, bad).unwrap();
        // An output that must come from the cache.
        fs::remove_dir_all(yard.out()).unwrap();
        let outcome = yard.run();
        assert!(outcome.ok(), "round {round}, {name}: {:?}", outcome.errors);
        assert!(tree(&yard.out()) == right, "round {round}, {name}");
    }
}

/// Flips a bit of each of these objects, in whichever pack.
fn damage_objects(cache: &std::path::Path, objects: &[lodge::digest::Digest]) {
    use std::os::unix::fs::FileExt;
    for entry in fs::read_dir(cache.join("packs")).unwrap() {
        let file = fs::File::options().read(true).write(true).open(entry.unwrap().path()).unwrap();
        let frames = lodge::run::pack::scan(&file, 0).unwrap().frames;
        for frame in frames.iter().filter(|f| objects.contains(&f.name)) {
            let mut byte = [0];
            file.read_exact_at(&mut byte, frame.at).unwrap();
            file.write_all_at(&[byte[0] ^ 1], frame.at).unwrap();
        }
    }
}

#[test]
fn a_lost_object_in_the_middle_is_made_again() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    let outcome = yard.run();
    let lost = outcome.nodes[1].record.as_ref().unwrap().digest;
    damage_objects(&home.path().join(".lodge"), &[lost]);
    yard.set("both", "add", json!(5));
    let outcome = yard.run();
    assert!(outcome.ok() && !outcome.warnings.is_empty());
    let other = tempfile::tempdir().unwrap();
    let mut clean = Yard::diamond(other.path());
    clean.nodes = yard.nodes.clone();
    clean.ran();
    assert!(tree(&yard.out()) == tree(&clean.out()));
}

#[test]
fn a_plan_says_the_same_and_trusts_nothing_that_changed() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    let cache = home.path().join(".lodge");
    let replay = || {
        let found = lodge::run::plan::replay(&cache, &yard.identity())?;
        assert_eq!(found.table()?, "5 nodes");
        found.outcome()
    };
    assert!(replay().is_none());
    yard.ran();
    let first = yard.run();
    for _ in 0..2 {
        let again = replay().expect("nothing has changed");
        assert!(again.ok());
        let said = |o: &lodge::run::Outcome| -> Vec<_> {
            let record = |n: &lodge::run::NodeOutcome| n.record.as_ref().map(|r| (r.key, r.digest, r.summary.clone()));
            o.nodes.iter().map(|n| (n.name.clone(), n.status, record(n))).collect()
        };
        assert_eq!(said(&again), said(&first));
        let files = |o: &lodge::run::Outcome| o.files.iter().map(|f| (f.path.clone(), f.digest)).collect::<Vec<_>>();
        assert_eq!(files(&again), files(&first));
    }
    // Touched, with equal bytes: still nothing to do.
    yard.file("data.txt", "1 2 3.5");
    assert!(replay().is_some() && replay().is_some());
    // Each of these is noticed.
    let output = yard.out().join("files/n/1.txt");
    let bytes = fs::read(&output).unwrap();
    let changes: [&dyn Fn(); 4] = [
        &|| fs::write(&output, "x").unwrap(),
        &|| fs::remove_file(&output).unwrap(),
        &|| {
            let meta = fs::metadata(&output).unwrap();
            let other: Vec<u8> = bytes.iter().map(|b| b ^ 1).collect();
            fs::write(&output, other).unwrap();
            fs::File::options().write(true).open(&output).unwrap().set_modified(meta.modified().unwrap()).unwrap();
        },
        &|| {
            fs::rename(&output, home.path().join("aside")).unwrap();
            std::os::unix::fs::symlink(home.path().join("aside"), &output).unwrap();
        },
    ];
    for (i, change) in changes.iter().enumerate() {
        change();
        assert!(replay().is_none(), "change {i}");
        assert_eq!(yard.ran(), [""; 0]);
        assert_eq!(fs::read(&output).unwrap(), bytes);
        assert!(replay().is_some());
    }
    yard.file("data.txt", "1 2 3.6");
    assert!(replay().is_none());
    yard.ran();
    // Not a bit of the plan may change.
    let plan = fs::read_dir(cache.join("plans")).unwrap().next().unwrap().unwrap().path();
    let good = fs::read(&plan).unwrap();
    for at in (0..good.len()).step_by(97) {
        let mut bad = good.clone();
        bad[at] ^= 4;
        fs::write(&plan, bad).unwrap();
        assert!(replay().is_none(), "byte {at}");
        fs::write(&plan, &good[..at]).unwrap();
        assert!(replay().is_none(), "cut at {at}");
    }
    fs::write(&plan, good).unwrap();
    assert!(replay().is_some());
}

#[test]
fn every_rerun_is_explained() {
    use lodge::run::forecast::{Fate, Reason, forecast};
    use lodge::run::store::Store;
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    let fates = |yard: &Yard| -> Vec<(String, &'static str, Vec<String>)> {
        let graph = yard.graph();
        let store = Store::open(&home.path().join(".lodge")).unwrap();
        let all = forecast(&graph, &[], &store);
        let row = |f: &lodge::run::forecast::Forecast| {
            let word = match f.fate {
                Fate::Cached(_) => "cached",
                Fate::Runs => "run",
                Fate::MayRun(_) => "may-run",
                Fate::Fails(_) => "fails",
            };
            let reasons = f.changes.iter().map(|c| Reason::of(c, &graph, f.index).to_string()).collect();
            (graph.nodes[f.index].name.clone(), word, reasons)
        };
        all.iter().map(row).collect()
    };
    let words = |yard: &Yard| fates(yard).into_iter().map(|f| f.1).collect::<Vec<_>>();
    assert_eq!(words(&yard), ["run", "may-run", "may-run", "may-run", "may-run"]);
    yard.ran();
    assert_eq!(words(&yard), ["cached"; 5]);

    yard.set("left", "add", json!(2.5));
    let now = fates(&yard);
    assert_eq!(words(&yard), ["cached", "run", "cached", "may-run", "may-run"]);
    assert_eq!(now[1].2, ["`add`: 1 -> 2.5"]);
    yard.ran();
    let now = fates(&yard);
    assert_eq!(now[1].2, ["`add`: 1 -> 2.5"], "why it last ran");
    assert!(now[3].2[0].starts_with("`in.values.0`: result of `left`: "), "{:?}", now[3].2);

    yard.file("data.txt", "1 2 3.75");
    let now = fates(&yard);
    assert_eq!(words(&yard), ["run", "may-run", "may-run", "may-run", "may-run"]);
    assert!(now[0].2[0].starts_with("contents of `") && now[0].2[0].contains("data.txt`: "), "{:?}", now[0].2);
    yard.ran();

    yard.nodes[3].3.pop();
    let now = fates(&yard);
    assert_eq!(now[3].1, "run");
    assert_eq!(now[3].2[0], "number of inputs of `in.values`: 2 -> 1");
}

#[test]
fn a_cache_that_cannot_be_written_still_runs() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    let mut options = yard.options();
    // Nobody, not even root, makes folders here.
    options.cache = "/sys/lodge".into();
    let outcome = yard.run_with(&options);
    assert!(outcome.ok(), "{:?}", outcome.diagnostics());
    assert_eq!(outcome.warnings.len(), 1);
    assert!(outcome.warnings[0].contains("cannot be written"));
    assert_eq!(tree(&yard.out()).len(), 47);
}

#[test]
fn verify_finds_and_mends() {
    use lodge::run::store::Store;
    use lodge::run::verify::verify;
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.set("right", "more", json!(1000));
    yard.node("large", "toy-add", json!({"more": 600_000}), &[]);
    yard.ran();
    let cache = home.path().join(".lodge");
    assert!(cache.join("objects").exists());
    let look = || verify(&Store::open(&cache).unwrap());
    assert!(look().is_clean(), "{:?}", look());
    for (name, bytes) in tree(&cache).into_iter().filter(|f| f.0.contains('/')).step_by(3) {
        let path = cache.join(&name);
        let mut bad = bytes.clone();
        let middle = bad.len() / 2;
        bad[middle] ^= 1;
        let _ = fs::remove_file(&path);
        fs::write(&path, bad).unwrap();
        let found = look();
        assert_eq!((found.evicted.len(), found.unrepaired.len()), (1, 0), "{name}: {found:?}");
        assert!(look().is_clean(), "{name}");
    }
    fs::write(cache.join("objects/note"), "x").unwrap();
    assert_eq!(look().foreign, ["objects/note"]);
    yard.ran();
    fs::write(yard.out().join("files/n/3.txt"), "x").unwrap();
    assert_eq!(look().changed.len(), 1);
    assert!(yard.run().ok());
}

/// Everything that is in a key, and nothing else, is in what explains it: of each, one change.
#[test]
fn each_line_of_a_key_is_one_that_explains() {
    use lodge::run::forecast::{Reason, forecast};
    use lodge::run::store::Store;
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    yard.ran();
    let told = |change: &dyn Fn(&mut lodge::graph::Graph)| -> Vec<String> {
        let mut graph = yard.graph();
        change(std::sync::Arc::get_mut(&mut graph).unwrap());
        let all = forecast(&graph, &[], &Store::open(&home.path().join(".lodge")).unwrap());
        let runs = all.iter().find(|f| !f.changes.is_empty()).expect("something runs");
        runs.changes.iter().map(|c| Reason::of(c, &graph, runs.index).to_string()).collect()
    };
    let newer = |graph: &mut lodge::graph::Graph| {
        let old = graph.nodes[1].entry;
        let entry = lodge::op::Entry { version: old.version + 1, ..toy::TOYS[0] };
        assert_eq!(entry.name, old.name);
        graph.nodes[1].entry = Box::leak(Box::new(entry));
    };
    assert_eq!(told(&newer), ["operator version: 1 -> 2"]);
    assert_eq!(told(&|g| g.nodes[1].params["add"] = json!({"x": 1})), ["`add.x`: none -> 1", "`add`: 1 -> none"]);
    assert_eq!(told(&|g| g.nodes[1].params["warn"] = json!("w")), ["`warn`: \"\" -> \"w\""]);
    let more = told(&|g| g.nodes[3].inputs[0].insert(0, 0));
    assert_eq!(more[0], "number of inputs of `in.values`: 2 -> 3");
    assert!(more.len() == 2 && more[1].starts_with("`in.values.0`: result of `read`: none -> "), "{more:?}");
    let other = told(&|g| g.nodes[4].inputs[0] = vec![2]);
    assert!(
        other.len() == 1 && other[0].starts_with("`in.values`: result of `right` in place of `both`: "),
        "{other:?}"
    );
    let named = told(&|g| g.nodes[0].beside[0] = Some("n".into()));
    assert!(named.len() == 1 && named[0].ends_with("data.txt`: none -> n"), "{named:?}");
    let beside = told(&|g| {
        let path = home.path().join("more.txt");
        fs::write(&path, "4").unwrap();
        g.nodes[0].files.push(path);
        g.nodes[0].beside.push(Some("more.txt".into()));
    });
    assert!(
        beside.len() == 1
            && beside[0]
                .ends_with(&format!("more.txt`: none -> {}", &lodge::digest::Digest::of(b"4").to_string()[..12])),
        "{beside:?}"
    );
}
