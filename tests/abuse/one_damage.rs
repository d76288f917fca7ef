//! Damage that is chosen: to one record, to one note, at one place of a pack.

use std::fs;
use std::path::{Path, PathBuf};

use lodge::run::pack::{self, What};
use serde_json::json;

use super::damage::{Damage, Ground, computed_again, files, rewrite};
use super::support::Place;
use super::toy::{Yard, tree};
use super::{copy, names};

/// Between two others, where a killed run leaves none.
#[test]
fn a_frame_that_cannot_be_told_is_said_once() {
    let ground = Ground::new();
    let path = files(&ground.cache().join("packs")).into_iter().next().unwrap();
    let frames = pack::scan(&fs::File::open(&path).unwrap(), 0).unwrap().frames;
    for frame in frames[..frames.len() - 1].iter().step_by(5) {
        let damage = Damage::Flip(path.clone(), frame.at as usize - 20, 2);
        ground.reset();
        damage.inflict();
        let found = ground.verify();
        assert!(found.evicted.iter().any(|line| line.contains("damaged")), "{found:?}");
        ground.reset();
        damage.inflict();
        let outcome = ground.yard.run();
        assert_eq!((computed_again(&outcome), outcome.warnings.len()), (1, 1), "{:?}", outcome.warnings);
        assert!(outcome.ok() && tree(&ground.yard.out()) == ground.clean);
        assert!(ground.yard.run().warnings.is_empty());
    }
}

/// A flipped bit in a result that only `export` reads, the reasons of its rejects included: it is made again, and said.
#[test]
fn what_only_export_reads_is_made_again() {
    let place = Place::new();
    place.write("p.toml", "[node.plan]\nop = \"read-geojson\"\npath = \"town.geojson\"\n");
    place.write("town.geojson", fs::read(super::project().join("fixtures/town/buildings.geojson")).unwrap());
    place.lodge_json(&["run", "p.toml"]);
    let mut round = 0;
    for args in [
        &["export", "p.toml", "plan", "-o", "plan.geojson"][..],
        &["export", "p.toml", "plan", "--rejects", "-o", "rejects.csv"],
    ] {
        let output = place.path(args[args.len() - 1]);
        place.lodge_json(args);
        let right = fs::read(&output).unwrap();
        for _ in 0..3 {
            // Never the same bit twice: it would be right again.
            round += 1;
            // All objects that there are by now, the ones that were made again included.
            for path in files(&place.path("cache/packs")) {
                let frames = pack::scan(&fs::File::open(&path).unwrap(), 0).unwrap().frames;
                for frame in frames.iter().filter(|f| f.what == What::Object) {
                    rewrite(&path, |bytes| bytes[frame.at as usize + frame.len as usize / 2 + round] ^= 4);
                }
            }
            fs::remove_file(&output).unwrap();
            let done = place.lodge(args);
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            assert!(done.status.success(), "{args:?}: {said}");
            assert!(said.contains("in the cache is missing or damaged; it is computed again"), "{args:?}: {said}");
            assert!(fs::read(&output).unwrap() == right, "{args:?}");
            // Healed: there is nothing to say any more.
            let again = place.lodge(args);
            assert!(again.status.success() && !String::from_utf8_lossy(&again.stderr).contains("damaged"), "{again:?}");
            assert!(fs::read(&output).unwrap() == right, "{args:?}");
        }
    }
}

/// A record that is whole, of another key; what verify takes for damage, a run takes for a miss.
#[test]
fn two_results_that_change_places_give_no_wrong_bytes() {
    let ground = Ground::new();
    let path = files(&ground.cache().join("packs")).into_iter().next().unwrap();
    let frames = pack::scan(&fs::File::open(&path).unwrap(), 0).unwrap().frames;
    let results: Vec<usize> = (0..frames.len()).filter(|&i| frames[i].what == What::Result).collect();
    for pair in results.windows(2) {
        ground.reset();
        assert!(Damage::SwapFrames(path.clone(), pair[0], pair[1]).inflict());
        fs::remove_dir_all(ground.yard.out()).unwrap();
        let outcome = ground.yard.run();
        assert!(outcome.ok() && tree(&ground.yard.out()) == ground.clean, "{pair:?}");
        ground.reset();
        Damage::SwapFrames(path.clone(), pair[0], pair[1]).inflict();
        assert!(!ground.verify().is_clean(), "{pair:?}");
    }
}

/// Each of them is whole, and that of another pipeline.
#[test]
fn notes_and_plans_that_change_places_are_not_believed() {
    let place = Place::new();
    let pipelines = ["p", "q"].map(|name| {
        let file = format!("{name}.toml");
        let text = format!("[node.{name}]\nop = \"concat\"\ntext = \"{name}\"\npublish = \"{name}\"\n");
        place.write(&file, text);
        place.lodge_json(&["run", &file]);
        (name, file)
    });
    let clean = tree(&place.path("out"));
    copy(&place.path("cache"), &place.path("saved"));
    for folder in ["plans", "runs", "published", "history"] {
        let swap = || {
            copy(&place.path("saved"), &place.path("cache"));
            let all = files(&place.path("cache").join(folder));
            let [a, b]: [PathBuf; 2] = all.try_into().unwrap();
            let aside = place.path("aside");
            fs::rename(&a, &aside).unwrap();
            fs::rename(&b, &a).unwrap();
            fs::rename(&aside, &b).unwrap();
        };
        swap();
        let found = place.lodge_json(&["cache", "verify"]);
        assert_eq!(found["evicted"].as_array().unwrap().len(), 2, "{folder}: {found}");
        swap();
        for (name, file) in &pipelines {
            for args in [&["run", file][..], &["run", file, "--verify"]] {
                let run = place.lodge_json(args);
                assert_eq!((names(&run, "cached"), &run["files"][0]["path"]), (vec![*name], &json!(name)), "{folder}");
            }
            let runs = place.lodge_json(&["runs", file]);
            let swapped = usize::from(folder == "history");
            assert_eq!(runs["damaged"].as_array().unwrap().len(), swapped, "{folder}: {runs}");
        }
        assert!(tree(&place.path("out")) == clean, "{folder}");
    }
}

/// Cut anywhere: what is whole before that counts. A run that had ended noted its results, so what is behind is missed, in
/// one line; a run that was killed noted none, and there is nothing to say.
#[test]
fn a_torn_pack_is_said_unless_a_killed_run_left_it() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    assert_eq!(yard.ran().len(), 5);
    let (clean, saved) = (tree(&yard.out()), home.path().join("saved"));
    let cache = home.path().join(".lodge");
    copy(&cache, &saved);
    let pack = |cache: &Path| files(&cache.join("packs")).remove(0);
    let frames = pack::scan(&fs::File::open(pack(&saved)).unwrap(), 0).unwrap().frames;
    let results: Vec<u64> = frames.iter().filter(|f| f.what == What::Result).map(|f| f.at).collect();
    assert_eq!((results.len(), frames.last().unwrap().at), (5, results[4]));
    for (kept, &at) in results.iter().enumerate() {
        // In the body, in the head, and between two frames.
        for end in [at + 1, at - 1, at - pack::HEAD as u64] {
            for killed in [false, true] {
                copy(&saved, &cache);
                fs::remove_dir_all(yard.out()).unwrap();
                fs::File::options().write(true).open(pack(&cache)).unwrap().set_len(end).unwrap();
                if killed {
                    // What a run leaves at its end.
                    ["runs", "plans", "published", "history"]
                        .iter()
                        .for_each(|f| fs::remove_dir_all(cache.join(f)).unwrap_or_default());
                }
                let outcome = yard.run();
                assert_eq!(Ground::ran(&outcome), 5 - kept, "{kept} {end} {killed}");
                assert!(tree(&yard.out()) == clean);
                let said = match 5 - kept {
                    1 => "a result in the cache is missing or damaged; it is computed again".to_string(),
                    n => format!("{n} results in the cache are missing or damaged; they are computed again"),
                };
                assert_eq!(outcome.warnings, if killed { vec![] } else { vec![said] }, "{kept} {end}");
                assert_eq!(yard.run().warnings, [""; 0]);
            }
        }
    }
}
