//! What runs again after which change, and what damage costs.

mod toy;

use std::fs;

use lodge::run::event::Status;
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

#[test]
fn a_lost_object_in_the_middle_is_made_again() {
    let home = tempfile::tempdir().unwrap();
    let mut yard = Yard::diamond(home.path());
    yard.set("left", "more", json!(3000));
    yard.ran();
    fs::remove_dir_all(home.path().join(".lodge/objects")).unwrap();
    yard.set("both", "add", json!(5));
    let outcome = yard.run();
    assert!(outcome.ok() && !outcome.warnings.is_empty());
    let other = tempfile::tempdir().unwrap();
    let mut clean = Yard::diamond(other.path());
    clean.nodes = yard.nodes.clone();
    clean.ran();
    assert!(tree(&yard.out()) == tree(&clean.out()));
}
