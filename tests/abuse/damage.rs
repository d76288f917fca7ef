//! Random damage to files of the cache and to published files, size and times kept where that is possible.

use std::fs;
use std::os::unix::fs::{FileExt, PermissionsExt};
use std::path::{Path, PathBuf};

use lodge::run::Outcome;
use lodge::run::event::Status;
use lodge::run::pack::{self, Appender, Frame};
use lodge::run::store::Store;
use lodge::run::verify::{Found, verify};
use serde_json::json;

use super::toy::{Yard, tree};
use super::{Random, times};

/// Small and large objects, results, published files of all sizes, plans and notes.
fn yard(home: &Path) -> Yard {
    let mut yard = Yard::diamond(home);
    let large = yard.node("large", "toy-add", json!({"more": 600_000}), &[]);
    yard.node("larger", "toy-add", json!({"add": 1}), &[large]);
    let one = yard.node("one", "toy-add", json!({"more": 1}), &[]);
    yard.node("big", "toy-write", json!({"path": "big", "pad": 4_300_000}), &[one]);
    yard
}

type Tree = Vec<(String, Vec<u8>)>;

/// A folder to damage, and one as it should be.
pub struct Ground {
    home: tempfile::TempDir,
    pub yard: Yard,
    pub clean: Tree,
    /// Another setting, whose nodes read what the first ones made.
    other: Yard,
    other_clean: Tree,
    /// Cache and outputs.
    saved: [Tree; 2],
}

impl Ground {
    pub fn new() -> Self {
        let home = tempfile::tempdir().unwrap();
        let mut other = yard(home.path());
        other.set("left", "add", json!(3));
        other.set("larger", "add", json!(2));
        other.set("one", "more", json!(2));
        other.ran();
        let other_clean = tree(&other.out());
        [".lodge", "out"].iter().for_each(|f| fs::remove_dir_all(home.path().join(f)).unwrap());
        // Two packs, and a past.
        let mut yard = yard(home.path());
        yard.set("left", "add", json!(2));
        yard.ran();
        yard.set("left", "add", json!(1));
        assert_eq!(yard.ran(), ["left", "both", "out"]);
        let clean = tree(&yard.out());
        let saved = [".lodge", "out"].map(|f| tree(&home.path().join(f)));
        Self { home, yard, clean, other, other_clean, saved }
    }

    /// Puts everything back; what is as it was is not touched.
    pub fn reset(&self) {
        for (folder, saved) in [".lodge", "out"].iter().zip(&self.saved) {
            let folder = self.home.path().join(folder);
            let found = tree(&folder);
            let is_link = |name: &str| fs::symlink_metadata(folder.join(name)).is_ok_and(|m| m.is_symlink());
            found
                .iter()
                .filter(|(name, bytes)| is_link(name) || !saved.iter().any(|s| s.0 == *name && s.1 == *bytes))
                .for_each(|(name, _)| fs::remove_file(folder.join(name)).unwrap());
            for (name, bytes) in saved {
                let path = folder.join(name);
                if fs::symlink_metadata(&path).is_err() {
                    fs::create_dir_all(path.parent().unwrap()).unwrap();
                    fs::write(path, bytes).unwrap();
                }
            }
        }
    }

    pub fn cache(&self) -> PathBuf {
        self.home.path().join(".lodge")
    }

    pub fn verify(&self) -> Found {
        verify(&Store::open(&self.cache()).unwrap())
    }

    pub fn ran(outcome: &Outcome) -> usize {
        outcome.nodes.iter().filter(|n| n.status == Status::Ran).count()
    }
}

/// What was done, so that it can be done again.
#[derive(Clone, Debug)]
pub enum Damage {
    Flip(PathBuf, usize, u8),
    Zero(PathBuf, usize, usize),
    Truncate(PathBuf, usize),
    Extend(PathBuf, Vec<u8>),
    Delete(PathBuf),
    Swap(PathBuf, PathBuf),
    /// Bodies of two frames of a pack, each whole, under each other's names.
    SwapFrames(PathBuf, usize, usize),
    Link(PathBuf),
}

impl Damage {
    fn random(files: &[PathBuf], random: &mut Random) -> Self {
        let path = files[random.below(files.len())].clone();
        let size = fs::metadata(&path).unwrap().len() as usize;
        let is_pack = path.extension().is_some_and(|e| e == "pack");
        match random.below(if is_pack { 9 } else { 8 }) {
            0 | 1 if size > 0 => Self::Flip(path, random.below(size), 1 << random.below(8)),
            2 if size > 0 => Self::Zero(path, random.below(size), 1 + random.below(200)),
            3 if size > 0 => Self::Truncate(path, random.below(size)),
            4 => Self::Extend(path, (0..1 + random.below(100)).map(|_| random.below(256) as u8).collect()),
            5 => Self::Delete(path),
            6 => Self::Link(path),
            7 if !is_pack => {
                let like: Vec<_> = files.iter().filter(|f| **f != path).collect();
                match like.is_empty() {
                    true => Self::Flip(path, random.below(size), 1),
                    false => Self::Swap(path, like[random.below(like.len())].clone()),
                }
            }
            _ if is_pack => {
                let frames = pack::scan(&fs::File::open(&path).unwrap(), 0).unwrap().frames;
                let a = random.below(frames.len());
                let like: Vec<_> = (0..frames.len()).filter(|&b| b != a && frames[b].what == frames[a].what).collect();
                match like.is_empty() {
                    true => Self::Flip(path, random.below(size), 1),
                    false => Self::SwapFrames(path, a, like[random.below(like.len())]),
                }
            }
            _ => Self::Delete(path),
        }
    }

    /// False where nothing is different afterwards.
    pub fn inflict(&self) -> bool {
        match self {
            Self::Flip(path, at, bit) => rewrite(path, |b| b[*at] ^= bit),
            Self::Zero(path, at, n) => rewrite(path, |b| b.iter_mut().skip(*at).take(*n).for_each(|b| *b = 0)),
            Self::Truncate(path, n) => rewrite(path, |b| b.truncate(*n)),
            Self::Extend(path, more) => rewrite(path, |b| b.extend(more)),
            Self::Delete(path) => fs::remove_file(path).is_ok(),
            Self::Swap(a, b) => {
                let (x, y) = (fs::read(a).unwrap(), fs::read(b).unwrap());
                rewrite(a, |bytes| *bytes = y) | rewrite(b, |bytes| *bytes = x)
            }
            Self::SwapFrames(path, a, b) => {
                let from = fs::File::open(path).unwrap();
                let frames = pack::scan(&from, 0).unwrap().frames;
                let bytes = repacked(&from, &frames, *a, *b);
                rewrite(path, |all| *all = bytes)
            }
            Self::Link(path) => {
                // To its own bytes, where nobody looks for files of lodge's.
                let aside = path.ancestors().find(|p| p.join(".lodge").is_dir()).unwrap().join("aside");
                fs::rename(path, &aside).unwrap();
                std::os::unix::fs::symlink(&aside, path).is_ok()
            }
        }
    }
}

/// In place, and with the times that it had.
pub fn rewrite(path: &Path, change: impl FnOnce(&mut Vec<u8>)) -> bool {
    let before = fs::metadata(path).unwrap();
    let old = fs::read(path).unwrap();
    let mut new = old.clone();
    change(&mut new);
    fs::set_permissions(path, PermissionsExt::from_mode(0o644)).unwrap();
    let file = fs::File::options().write(true).open(path).unwrap();
    file.set_len(new.len() as u64).unwrap();
    file.write_all_at(&new, 0).unwrap();
    file.set_times(fs::FileTimes::new().set_modified(before.modified().unwrap())).unwrap();
    new != old
}

fn repacked(from: &fs::File, frames: &[Frame], a: usize, b: usize) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pack");
    let mut out = Appender::new(fs::File::create_new(&path).unwrap());
    for (i, frame) in frames.iter().enumerate() {
        let body = if i == a {
            &frames[b]
        } else if i == b {
            &frames[a]
        } else {
            frame
        };
        out.append(frame.what, &frame.name, &[pack::read(from, body).unwrap()]).unwrap();
    }
    fs::read(&path).unwrap()
}

/// Lines that say so.
pub fn computed_again(outcome: &Outcome) -> usize {
    outcome.warnings.iter().filter(|w| w.ends_with("computed again")).count()
}

pub fn files(folder: &Path) -> Vec<PathBuf> {
    tree(folder).into_iter().map(|(name, _)| folder.join(name)).collect()
}

#[test]
fn of_the_cache_is_noticed_by_verify_and_by_whoever_reads_it() {
    let ground = Ground::new();
    let expected = {
        let ran = Ground::ran(&ground.other.run());
        ground.reset();
        ran
    };
    let cache = ground.cache();
    let marker = |p: &PathBuf| {
        let name = p.strip_prefix(&cache).unwrap().to_str().unwrap();
        ["locks", "CACHEDIR.TAG", ".gitignore"].contains(&name)
    };
    let all: Vec<PathBuf> = files(&cache).into_iter().filter(|p| !marker(p)).collect();
    // Most bytes are in packs and large objects: each kind of file gets its share.
    let kinds: Vec<Vec<PathBuf>> = ["packs", "objects", "plans", "published", "runs", "history"]
        .iter()
        .map(|kind| all.iter().filter(|p| p.strip_prefix(&cache).unwrap().starts_with(kind)).cloned().collect())
        .collect();
    assert!(kinds.iter().all(|k: &Vec<_>| !k.is_empty()), "{kinds:?}");
    let mut random = Random::new("damage to the cache");
    let (mut done, mut said, mut again, mut deaf) = (0, 0, 0, 0);
    while done < times(700) {
        let kind = if random.below(2) == 0 { random.below(2) } else { random.below(kinds.len()) };
        ground.reset();
        let damage = Damage::random(&kinds[kind], &mut random);
        if !damage.inflict() {
            continue; // zeros over zeros, a swap of equals
        }
        done += 1;
        let context = format!("damage {done}: {damage:?}");

        // (1) `verify` notices, once, and what it leaves is sound.
        let found = ground.verify();
        // A plan or a note that is not there is none.
        let free = matches!(&damage, Damage::Delete(_)) && kind >= 2;
        assert!(!found.is_clean() || free, "{context}");
        deaf += usize::from(found.is_clean());
        assert!(found.unrepaired.is_empty(), "{context}: {found:?}");
        let found = ground.verify();
        assert!(found.is_clean(), "{context}: {found:?}");
        let outcome = ground.yard.run();
        assert!(outcome.ok() && tree(&ground.yard.out()) == ground.clean, "{context}: {:?}", outcome.errors);
        assert!(outcome.warnings.is_empty(), "{context}: {:?}", outcome.warnings);

        // (2) So does a run that reads it, because outputs are gone or because new nodes take the old results.
        ground.reset();
        damage.inflict();
        let (yard, right, usual) = if random.below(2) == 0 {
            fs::remove_dir_all(ground.yard.out()).unwrap();
            (&ground.yard, &ground.clean, 0)
        } else {
            (&ground.other, &ground.other_clean, expected)
        };
        let outcome = yard.run();
        assert!(outcome.ok(), "{context}: {:?} {:?}", outcome.errors, outcome.diagnostics());
        assert!(tree(&yard.out()) == *right, "{context}: wrong bytes");
        // What was made once more is said, in one line.
        let more = Ground::ran(&outcome) > usual;
        let lines = computed_again(&outcome);
        assert!(lines == 1 || lines == 0 && !more, "{context}: {:?}", outcome.warnings);
        said += usize::from(!outcome.warnings.is_empty());
        again += usize::from(more);
        // The next one has nothing to do and nothing to say.
        let outcome = yard.run();
        assert_eq!((Ground::ran(&outcome), &outcome.warnings), (0, &vec![]), "{context}");
        assert!(tree(&yard.out()) == *right, "{context}");
    }
    println!(
        "{done} damages; {again} made something run again, {said} were said by a run; {deaf} deletions of notes passed `verify`"
    );
    assert!(said > 0 && again > 0);
}

#[test]
fn of_published_files_is_noticed_by_verify_and_put_back_without_running_anything() {
    let ground = Ground::new();
    let all = files(&ground.yard.out());
    let mut random = Random::new("damage to published files");
    let mut done = 0;
    while done < times(300) {
        ground.reset();
        let damage = Damage::random(&all, &mut random);
        // Stamps as after a run, not as after a copy.
        assert!(ground.yard.run().ok());
        if !damage.inflict() {
            continue;
        }
        done += 1;
        let context = format!("damage {done}: {damage:?}");
        let found = ground.verify();
        let files = if matches!(damage, Damage::Swap(..)) { 2 } else { 1 };
        assert_eq!(found.changed.len(), files, "{context}: {found:?}");
        assert!(found.evicted.is_empty() && found.unrepaired.is_empty(), "{context}: {found:?}");
        // Not by the plan, then.
        let replayed = lodge::run::plan::replay(&ground.cache(), &ground.yard.identity());
        assert!(replayed.is_none(), "{context}: trusted");
        let outcome = ground.yard.run();
        assert!(outcome.ok() && Ground::ran(&outcome) == 0, "{context}");
        assert_eq!(outcome.files.iter().filter(|f| f.written).count(), files, "{context}");
        assert!(tree(&ground.yard.out()) == ground.clean, "{context}");
        assert!(files_are_files(&all), "{context}");
    }
    println!("{done} damages, each put back with 0 nodes run");
}

fn files_are_files(all: &[PathBuf]) -> bool {
    all.iter().all(|p| fs::symlink_metadata(p).is_ok_and(|m| m.is_file()))
}
