//! What is known of a cache without asking the disk: the frames of all packs by their names, and what is lost.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::folder::open;
use super::pack::{self, Frame, What};
use super::stamp::{Stamp, is_remote};
use crate::digest::Digest;

#[derive(Default)]
pub struct Index {
    pub packs: Vec<Pack>,
    /// The folder of packs as it was when they were last listed, and whether it is remote.
    listed: Option<(Stamp, bool)>,
    pub objects: BTreeMap<Digest, (usize, Frame)>,
    pub results: BTreeMap<Digest, (usize, Frame)>,
    /// Others of the same names: one of them may be whole where another is damaged.
    spare: BTreeMap<(bool, Digest), Vec<(usize, Frame)>>,
    /// Results that must be made again: a blob of theirs is lost.
    pub dropped: BTreeSet<Digest>,
    /// Objects that turned out damaged or missing.
    pub damaged: BTreeSet<Digest>,
    /// Keys of results that should be here: the last run had them.
    pub expected: BTreeSet<Digest>,
    pub lost: Lost,
}

/// What turned out damaged, or missing where it should be.
#[derive(Default)]
pub struct Lost {
    /// Of packs, between their records.
    pub bytes: u64,
    pub results: usize,
    pub objects: Vec<Digest>,
}

impl Lost {
    /// One sentence, however much it is.
    pub fn sentence(&self) -> Option<String> {
        let results = match self.results {
            0 => None,
            1 => Some("a result".to_string()),
            n => Some(format!("{n} results")),
        };
        let objects = match self.objects[..] {
            [] => None,
            [one] => Some(format!("object {}", one.short(6))),
            _ => Some(format!("{} objects", self.objects.len())),
        };
        let are = if self.results + self.objects.len() == 1 { "is" } else { "are" };
        let they = if are == "is" { "it is" } else { "they are" };
        match (results, objects) {
            (None, None) if self.bytes == 0 => None,
            (None, None) => {
                Some(format!("{} bytes of the cache are damaged; what is missing is computed again", self.bytes))
            }
            (a, b) => {
                let what = a.into_iter().chain(b).collect::<Vec<_>>().join(" and ");
                Some(format!("{what} in the cache {are} missing or damaged; {they} computed again"))
            }
        }
    }
}

pub struct Pack {
    pub file: Arc<File>,
    pub path: PathBuf,
    pub scanned: u64,
    /// Damaged bytes among what was scanned.
    pub lost: u64,
    pub own: bool,
    /// Of a run that has ended: nothing will be added.
    complete: bool,
}

impl Pack {
    pub fn new(file: Arc<File>, path: PathBuf, own: bool) -> Self {
        Self { file, path, scanned: 0, lost: 0, own, complete: false }
    }

    /// Of the run.
    fn id(&self) -> Option<u64> {
        u64::from_str_radix(self.path.file_stem()?.to_str()?, 16).ok()
    }
}

impl Index {
    pub fn add(&mut self, pack: usize, frame: Frame) {
        let map = match frame.what {
            What::Object => &mut self.objects,
            What::Result => &mut self.results,
        };
        if let Some(other) = map.insert(frame.name, (pack, frame)) {
            self.spare.entry((frame.what == What::Object, frame.name)).or_default().push(other);
        }
    }

    /// The one that is known of this name is damaged: another takes its place, if there is one.
    pub fn lose(&mut self, what: What, name: &Digest) {
        let map = match what {
            What::Object => &mut self.objects,
            What::Result => &mut self.results,
        };
        let spare = self.spare.get_mut(&(what == What::Object, *name)).and_then(Vec::pop);
        match spare {
            Some(other) => _ = map.insert(*name, other),
            None => _ = map.remove(name),
        }
    }

    /// Nothing that is known now of this object is to be used.
    pub fn distrust(&mut self, name: &Digest) {
        self.objects.remove(name);
        self.spare.remove(&(true, *name));
        self.damaged.insert(*name);
    }

    /// Reads what other processes have added to `folder`. Called before every node that runs: the folder is listed only
    /// when it is another, and of a run that has ended nothing is asked again. `lives` tells of a run whether it may
    /// write.
    pub fn refresh(&mut self, folder: &Path, grain: Option<u64>, lives: impl Fn(u64) -> bool) -> io::Result<()> {
        let now = Stamp::of_folder(folder).ok().map(|s| s.on(grain));
        let as_listed = |(old, remote): &(Stamp, bool)| now.is_some_and(|now| old.same(&now)) && old.settled(*remote);
        if !self.listed.as_ref().is_some_and(as_listed) {
            self.list(folder)?;
            self.listed = now.map(|now| (now, is_remote(folder)));
        }
        for i in 0..self.packs.len() {
            let pack = &mut self.packs[i];
            if pack.own || pack.complete {
                continue;
            }
            // First whether its run lives, then how far that came.
            pack.complete = !pack.id().is_none_or(&lives);
            if pack.file.metadata().map_or(0, |m| m.len()) <= pack.scanned {
                continue;
            }
            let Ok(scan) = pack::scan(&pack.file, pack.scanned) else { continue };
            pack.scanned = scan.end;
            pack.lost += scan.lost;
            for frame in scan.frames {
                self.add(i, frame);
            }
        }
        Ok(())
    }

    fn list(&mut self, folder: &Path) -> io::Result<()> {
        let mut paths: Vec<PathBuf> = match fs::read_dir(folder) {
            Ok(entries) => entries.filter_map(|e| Some(e.ok()?.path())).collect(),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(e) => return Err(e),
        };
        paths.retain(|p| p.extension().is_some_and(|e| e == "pack") && !self.packs.iter().any(|k| k.path == *p));
        paths.sort();
        for path in paths {
            if let Ok(file) = open(&path) {
                self.packs.push(Pack::new(Arc::new(file), path, false));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lost_is_one_sentence() {
        let said = |bytes, results, objects: &[&[u8]]| {
            Lost { bytes, results, objects: objects.iter().map(|o| Digest::of(o)).collect() }.sentence()
        };
        let [one, two] = [&b"a"[..], b"b"];
        assert_eq!(said(0, 0, &[]), None);
        assert_eq!(said(7, 0, &[]).unwrap(), "7 bytes of the cache are damaged; what is missing is computed again");
        assert_eq!(said(7, 1, &[]).unwrap(), "a result in the cache is missing or damaged; it is computed again");
        let named =
            format!("object {} in the cache is missing or damaged; it is computed again", Digest::of(one).short(6));
        assert_eq!(said(0, 0, &[one]).unwrap(), named);
        let all = "3 results and 2 objects in the cache are missing or damaged; they are computed again";
        assert_eq!(said(7, 3, &[one, two]).unwrap(), all);
    }
}
