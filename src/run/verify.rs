//! Reads every byte of a cache and of what was published from it. What is damaged is repaired where its bytes are
//! still known, else evicted: then it is computed again when it is wanted.

use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::folder::open;
use super::pack::{self, Frame, What};
use super::record::Record;
use super::store::Store;
use super::{history, last, plan, publish, published, stamp};
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
    /// Published files that somebody changed: the next run puts them back.
    pub changed: Vec<String>,
    /// Not ours.
    pub foreign: Vec<String>,
    pub unrepaired: Vec<String>,
}

impl Found {
    pub fn is_clean(&self) -> bool {
        let lists = [&self.repaired, &self.evicted, &self.changed, &self.foreign, &self.unrepaired];
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
            Object::Whole(bytes) => found.bytes += bytes,
            Object::Damaged => found.remove(&name, &path, "damaged"),
            Object::Foreign => found.foreign.push(name),
        }
    }

    // (2) Packs. A damaged one is written again without what is damaged.
    let mut rewrite = Vec::new();
    for (name, path) in part("packs") {
        let Some(id) = name.strip_prefix("packs/").and_then(|n| n.strip_suffix(".pack")).and_then(hex) else {
            found.foreign.push(name);
            continue;
        };
        match self::pack(&path, &mut found) {
            Some(good) if good.damaged > 0 || good.lost > 0 => rewrite.push((name, path, id, good)),
            Some(_) => {}
            None => found.remove(&name, &path, "cannot be read"),
        }
    }
    for (name, path, id, good) in rewrite {
        let what = format!("{name}: {} damaged records, {} lost bytes", good.damaged, good.lost);
        if store.is_alive(id) {
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
        let bytes = fs::read(&path).unwrap_or_default();
        found.bytes += bytes.len() as u64;
        let good = match name.split_once('/') {
            Some(("plans", _)) => plan::is_whole(&bytes),
            Some(("published", _)) => published::is_whole(&bytes),
            Some(("history", run)) => history::is_whole(run, &bytes),
            Some((_, "stamps")) => stamp::is_whole(&bytes),
            _ => last::is_whole(&bytes),
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

    // (4) Published files.
    for (out, file) in published::all(store) {
        let path = out.join(&file.path);
        let Some((stamp, digest)) = stamp::hash_output(&path) else { continue };
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

enum Object {
    Whole(u64),
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
        Some((stamp, found)) if found == digest => Object::Whole(stamp.size),
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

fn pack(path: &Path, found: &mut Found) -> Option<Good> {
    let file = open(path).ok()?;
    let size = file.metadata().ok()?.len();
    let scan = pack::scan(&file, 0).ok()?;
    let lost = scan.lost + (size - scan.end);
    found.bytes += size;
    found.checked += scan.frames.len() as u64;
    let fits = |frame: &Frame| {
        let body = pack::read(&file, frame).ok()?;
        Some(match frame.what {
            What::Object => Digest::of(&body) == frame.name,
            What::Result => Record::of_bytes(&body, &frame.name).is_some(),
        })
    };
    let fits: Vec<bool> = scan.frames.par_iter().map(fits).collect::<Option<_>>()?;
    let all = scan.frames.len();
    let frames: Vec<Frame> = scan.frames.into_iter().zip(fits).filter(|f| f.1).map(|f| f.0).collect();
    Some(Good { file, damaged: all - frames.len(), frames, lost })
}

fn hex(text: &str) -> Option<u64> {
    u64::from_str_radix(text, 16).ok()
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
