//! Reads every byte of a cache and of what was published from it. What is damaged is repaired where its bytes are
//! still known, else evicted: then it is computed again when it is wanted.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::folder::{open, read_state};
use super::pack::{self, Frame, What};
use super::record::Record;
use super::store::Store;
use super::{history, last, needs, plan, publish, published, stamp};
use crate::digest::Digest;

/// What lies in a cache.
#[derive(Debug, Default)]
pub struct Stat {
    pub objects: u64,
    pub object_bytes: u64,
    pub packs: u64,
    pub pack_bytes: u64,
    /// In packs.
    pub packed_objects: u64,
    pub results: u64,
    pub other_bytes: u64,
}

impl Stat {
    pub fn bytes(&self) -> u64 {
        self.object_bytes + self.pack_bytes + self.other_bytes
    }
}

pub fn stat(root: &Path) -> Stat {
    let mut out = Stat::default();
    for (name, path) in files(root) {
        let bytes = fs::symlink_metadata(&path).map_or(0, |m| m.len());
        match name.split('/').next() {
            Some("objects") => {
                out.objects += 1;
                out.object_bytes += bytes;
            }
            Some("packs") => {
                let scan = open(&path).and_then(|f| pack::scan(&f, 0)).unwrap_or_default();
                out.packs += 1;
                out.pack_bytes += bytes;
                let results = scan.frames.iter().filter(|f| f.what == What::Result).count() as u64;
                out.results += results;
                out.packed_objects += scan.frames.len() as u64 - results;
            }
            _ => out.other_bytes += bytes,
        }
    }
    out
}

/// What [`verify`] found, a line each.
#[derive(Debug, Default)]
pub struct Found {
    pub checked: u64,
    pub bytes: u64,
    /// As they were again.
    pub repaired: Vec<String>,
    /// Gone; computed again when wanted.
    pub evicted: Vec<String>,
    /// Results of last runs that are not there, with what they consist of; computed again when wanted.
    pub missing: Vec<String>,
    /// Published files that somebody changed or removed: the next run puts them back.
    pub changed: Vec<String>,
    /// Not ours.
    pub foreign: Vec<String>,
    pub unrepaired: Vec<String>,
}

impl Found {
    pub fn is_clean(&self) -> bool {
        let lists = [&self.repaired, &self.evicted, &self.missing, &self.changed, &self.foreign, &self.unrepaired];
        lists.iter().all(|l| l.is_empty())
    }

    fn remove(&mut self, name: &str, path: &Path, what: &str) {
        match fs::remove_file(path) {
            Ok(()) => self.evicted.push(format!("{name}: {what}")),
            Err(e) => self.unrepaired.push(format!("{name}: {what}, and cannot be removed: {e}")),
        }
    }
}

pub fn verify(store: &Store) -> Found {
    let mut found = Found::default();
    let mut whole = Whole::default();
    // Opening may have mended something.
    found.evicted.extend(store.trouble());
    // First: what a run notes meanwhile may stand on what was not there yet.
    let runs = last::all(store);
    let all = files(store.root());
    let part = |folder: &str| -> Vec<(String, PathBuf)> {
        all.iter().filter(|(name, _)| name.split('/').next() == Some(folder)).cloned().collect()
    };

    // (1) Objects, in parallel.
    let checked: Vec<(String, PathBuf, Object)> = part("objects")
        .into_par_iter()
        .map(|(name, path)| (name.clone(), path.clone(), object(&name, &path)))
        .collect();
    for (name, path, object) in checked {
        found.checked += 1;
        match object {
            Object::Whole(digest, bytes) => {
                found.bytes += bytes;
                whole.objects.insert(digest);
            }
            Object::Damaged => found.remove(&name, &path, "damaged"),
            Object::Foreign => found.foreign.push(name),
        }
    }

    // (2) Packs. A damaged one is written again without what is damaged, and without results that lost an object.
    let mut packs = Vec::new();
    for (name, path) in part("packs") {
        let Some(id) = pack::id_of(&path).filter(|_| name.matches('/').count() == 1) else {
            found.foreign.push(name);
            continue;
        };
        // What such a run has put since is not seen.
        let alive = store.is_alive(id);
        match self::pack(&path, &mut found, &mut whole) {
            Some(good) => packs.push((name, path, alive, good)),
            None => found.remove(&name, &path, "cannot be read"),
        }
    }
    let bereft = whole.drop_incomplete(store);
    for (name, path, alive, mut good) in packs {
        let before = good.frames.len();
        good.frames.retain(|f| alive || f.what != What::Result || !bereft.contains(&f.name));
        let bereft = before - good.frames.len();
        if good.damaged == 0 && good.lost == 0 && bereft == 0 {
            continue;
        }
        let mut what = format!("{name}: {} damaged records, {} lost bytes", good.damaged, good.lost);
        if bereft > 0 {
            what += &format!(", {bereft} results without their objects");
        }
        if alive {
            found.changed.push(format!("{what}, of a run that is still at work"));
            continue;
        }
        match store.replace_pack(&path, &good.file, &good.frames) {
            Ok(()) => found.evicted.push(what),
            Err(e) => found.unrepaired.push(format!("{what}: {e}")),
        }
    }

    // (3) Plans and notes.
    for (name, path) in ["plans", "published", "runs", "history"].into_iter().flat_map(part) {
        if name.strip_prefix("history/").is_some_and(|n| !history::is_name(n)) {
            found.foreign.push(name);
            continue;
        }
        found.checked += 1;
        let bytes = read_state(&path).unwrap_or_default();
        found.bytes += bytes.len() as u64;
        let good = match name.split_once('/') {
            Some(("plans", plan)) => plan::is_whole(plan, &bytes),
            Some(("published", state)) => published::parse(&bytes, state).is_some(),
            Some(("history", run)) => history::is_whole(run, &bytes),
            Some(("runs", "stamps")) => stamp::is_whole(&bytes),
            Some((_, pipeline)) => last::parse(&bytes, pipeline).is_some(),
            None => false,
        };
        if !good {
            found.remove(&name, &path, "damaged");
        }
    }
    for (name, _) in &all {
        let top = name.split('/').next().unwrap_or_default();
        let ours =
            ["objects", "packs", "plans", "published", "runs", "history", "tmp", "locks", "CACHEDIR.TAG", ".gitignore"];
        if !ours.contains(&top) {
            found.foreign.push(name.clone());
        }
    }

    // (4) What the last runs had.
    for (name, mut run) in runs {
        let before = run.clone();
        run.nodes.retain(|node, last| {
            let there = whole.results.contains_key(&last.key);
            if !there {
                found.missing.push(format!("result of `{node}` of {}", run.file.display()));
            }
            there
        });
        if run != before
            && last::parse(&store.get_state("runs", &name), &name).is_some_and(|now| now == before)
            && let Err(error) = last::put(store, &run)
        {
            tracing::debug!(%error, "cannot note what is missing");
        }
    }

    // (5) Published files.
    let published = published::all(store).into_iter().flat_map(|(_, mut folder)| {
        if needs::is_gone(&folder.out) && !folder.files.is_empty() {
            found.changed.push(folder.out.display().to_string());
            folder.files.clear();
        }
        let files = folder.files.into_iter().filter(|f| !f.1).map(|f| f.0);
        files.map(|file| (folder.out.clone(), file)).collect::<Vec<_>>()
    });
    let published: Vec<_> = published.collect();
    for (out, file) in published {
        let path = out.join(&file.path);
        let Some((stamp, digest)) = stamp::hash_output(&path) else {
            found.changed.push(path.display().to_string());
            continue;
        };
        found.checked += 1;
        found.bytes += stamp.size;
        if digest == file.digest {
            continue;
        }
        let name = path.display().to_string();
        if !stamp.same(&file.stamp) {
            found.changed.push(name);
            continue;
        }
        // Nobody wrote to it, and yet it is another.
        match publish::restore(store, &out, &file) {
            Ok(true) => found.repaired.push(name),
            Ok(false) => match fs::remove_file(&path) {
                Ok(()) => found.evicted.push(format!("{name}: damaged, and not in the cache")),
                Err(e) => found.unrepaired.push(format!("{name}: {e}")),
            },
            Err(e) => found.unrepaired.push(format!("{name}: {e}")),
        }
    }
    found
}

/// What is there and as it should be.
#[derive(Default)]
struct Whole {
    objects: BTreeSet<Digest>,
    /// By key.
    results: BTreeMap<Digest, Record>,
}

impl Whole {
    /// Drops results of which something is missing; their keys.
    fn drop_incomplete(&mut self, store: &Store) -> BTreeSet<Digest> {
        let complete = |record: &Record| {
            let own = [Some(record.digest), record.notes];
            own.iter().flatten().all(|d| self.objects.contains(d))
                && needs::objects_of(store, record).iter().all(|d| self.objects.contains(d))
        };
        let bereft: BTreeSet<Digest> = self.results.iter().filter(|(_, r)| !complete(r)).map(|(k, _)| *k).collect();
        self.results.retain(|key, _| !bereft.contains(key));
        bereft
    }
}

enum Object {
    Whole(Digest, u64),
    Damaged,
    Foreign,
}

fn object(name: &str, path: &Path) -> Object {
    let parts: Vec<&str> = name.split('/').collect();
    let digest = match parts[..] {
        ["objects", a, b] if a.len() == 2 => Digest::parse(&format!("{a}{b}")),
        _ => None,
    };
    let Some(digest) = digest else { return Object::Foreign };
    match stamp::hash_output(path) {
        Some((stamp, found)) if found == digest => Object::Whole(digest, stamp.size),
        _ => Object::Damaged,
    }
}

/// What of a pack is as it should be.
struct Good {
    file: fs::File,
    frames: Vec<Frame>,
    damaged: usize,
    lost: u64,
}

fn pack(path: &Path, found: &mut Found, whole: &mut Whole) -> Option<Good> {
    let file = open(path).ok()?;
    let size = file.metadata().ok()?.len();
    let scan = pack::scan(&file, 0).ok()?;
    let lost = scan.lost + (size - scan.end);
    found.bytes += size;
    found.checked += scan.frames.len() as u64;
    // Of a whole frame, the record that it may be.
    let read = |frame: &Frame| {
        let body = pack::read(&file, frame).ok()?;
        Some(match frame.what {
            What::Object => (Digest::of(&body) == frame.name).then_some(None),
            What::Result => Record::of_bytes(&body, &frame.name).map(Some),
        })
    };
    let read: Vec<Option<Option<Record>>> = scan.frames.par_iter().map(read).collect::<Option<_>>()?;
    let all = scan.frames.len();
    let mut frames = Vec::with_capacity(all);
    for (frame, read) in scan.frames.into_iter().zip(read) {
        match read {
            None => continue,
            // Without its words, which take room.
            Some(Some(record)) => {
                let record = Record { summary: String::new(), lines: Vec::new(), ..record };
                whole.results.insert(frame.name, record);
            }
            Some(None) => _ = whole.objects.insert(frame.name),
        }
        frames.push(frame);
    }
    Some(Good { file, damaged: all - frames.len(), frames, lost })
}

/// Every file below a folder, links not followed: name with `/`, and path; sorted.
fn files(root: &Path) -> Vec<(String, PathBuf)> {
    let mut out = Vec::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if entry.file_type().is_ok_and(|t| t.is_dir()) {
                folders.push(path);
            } else if let Ok(name) = path.strip_prefix(root) {
                out.push((name.to_string_lossy().into_owned(), path));
            }
        }
    }
    out.sort();
    out
}
