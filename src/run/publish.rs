//! From the cache to the output folder: copies, only where something differs, never through a link.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use rayon::prelude::*;

use super::Options;
use super::event::{Event, Observer};
use super::executor::decode;
use super::lock;
use super::published::{Published, State, is_below, note, state_name, write_state};
use super::record::Record;
use super::stamp::{self, Stamp};
use super::store::Store;
use crate::artifact::{Files, files};
use crate::diag::Diagnostic;
use crate::digest::Digest;
use crate::graph::Graph;

#[derive(Default)]
pub struct Found {
    pub files: Vec<Published>,
    /// Keys of results with blobs that are missing or damaged.
    pub lost: Vec<Digest>,
    pub errors: Vec<Box<Diagnostic>>,
    pub interrupted: bool,
    /// All is there, and nothing that should not be.
    complete: bool,
}

/// What came of a file.
enum End {
    Unchanged(Stamp),
    Written(Stamp),
    /// Its object is missing or damaged.
    Lost,
    /// The run was interrupted before.
    Stopped,
}

/// Publishes the results of `ready` into `out`.
pub fn publish(
    graph: &Graph,
    ready: &[(usize, Arc<Record>)],
    out: &Path,
    store: &Store,
    options: &Options,
    observer: &mut Observer,
) -> Found {
    let mut found = Found::default();
    let name = state_name(graph, out);
    if ready.is_empty() && store.get_state("published", &name).is_empty() {
        return found;
    }
    // What was published is read and noted under the lock: of two runs at once the second sees all of the first's.
    let result = lock(out, &options.stop, observer).and_then(|guard| {
        let Some(guard) = guard else { return Ok(found.interrupted = true) };
        let state = State::read(store, &name);
        let (verify, stop, remote) = (options.verify, &*options.stop, stamp::is_remote(out));
        let work = Work { out, store, before: &state.before, verify, remote, stop, folders: Mutex::default() };
        let planned = work.run(graph, ready, (&name, &state), &mut found, observer);
        // What was not asked for, or failed, stays as it is; what was not reached is still to be looked at.
        let (fresh, known) = nodes_of(graph, ready);
        let stays = |p: &&Published| !found.complete || !fresh.contains(&*p.node) && known.contains(&*p.node);
        let mut all: BTreeMap<&str, &Published> = BTreeMap::new();
        all.extend(state.before.values().filter(stays).map(|p| (&*p.path, p)));
        all.extend(found.files.iter().map(|p| (&*p.path, p)));
        let new = planned.as_deref().unwrap_or_default().iter().filter(|_| !found.complete);
        let bytes = write_state(graph, out, &all, state.planned.iter().filter(stays).chain(new));
        note(store, &name, &bytes);
        drop(guard);
        planned.map(|_| ())
    });
    if let Err(error) = result {
        let message = format!("cannot publish into `{}`: {error}", out.display());
        found.errors.push(Diagnostic::error("cannot-publish", message));
    }
    found
}

/// Nodes whose files are all told here, and all nodes.
fn nodes_of<'a>(graph: &'a Graph, ready: &[(usize, Arc<Record>)]) -> (BTreeSet<&'a str>, BTreeSet<&'a str>) {
    let fresh = ready.iter().map(|(n, _)| &*graph.nodes[*n].name).collect();
    (fresh, graph.nodes.iter().map(|n| &*n.name).collect())
}

/// One run at a time per folder, whichever cache it has; the kernel frees the lock. None where the run is interrupted
/// while it waits.
fn lock(out: &Path, stop: &AtomicBool, observer: &mut Observer) -> io::Result<Option<File>> {
    fs::create_dir_all(out)?;
    let folder = File::open(out)?;
    let mut told = false;
    // Not `File::lock`: that hears no Ctrl-C.
    while let Err(fs::TryLockError::WouldBlock) = folder.try_lock() {
        if !told {
            let on = lock::holder_of(&folder);
            observer(&Event::Waiting { what: out.display().to_string(), on });
            told = true;
        }
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        thread::sleep(Duration::from_millis(2));
    }
    Ok(Some(folder))
}

struct Work<'a> {
    out: &'a Path,
    store: &'a Store,
    before: &'a BTreeMap<String, Published>,
    verify: bool,
    remote: bool,
    stop: &'a AtomicBool,
    /// Folders that are there and are no links.
    folders: Mutex<BTreeSet<PathBuf>>,
}

impl Work<'_> {
    fn run(
        &self,
        graph: &Graph,
        ready: &[(usize, Arc<Record>)],
        (name, state): (&str, &State),
        found: &mut Found,
        observer: &mut Observer,
    ) -> io::Result<Vec<Published>> {
        // (1) What there should be. Files that name others come after all others.
        let mut all: Vec<(files::File, String, Digest)> = Vec::new();
        for (n, record) in ready {
            let node = &graph.nodes[*n];
            let Some(artifact) = decode(self.store, &record.kind, &record.digest) else {
                found.lost.push(record.key);
                continue;
            };
            let Ok(list) = artifact.into_any().downcast::<Files>() else { continue };
            all.extend(list.files.iter().map(|f| (f.clone(), node.name.clone(), record.key)));
        }
        all.sort_by(|a, b| (a.0.last, &a.0.path).cmp(&(b.0.last, &b.0.path)));

        // (2) Write what differs, side by side; first it is noted, so that a killed run leaves nothing unknown.
        all.retain(|(file, node, _)| {
            let below = is_below(&file.path);
            if !below {
                let message = format!("`{}` does not lie below the output folder", file.path);
                found.errors.push(Diagnostic::error("outside", message).node(node.clone()));
            }
            below
        });
        let differs = |f: &files::File| self.before.get(&f.path).is_none_or(|old| old.digest != f.blob.digest);
        let planned = |(file, node, _): &(files::File, String, Digest)| Published {
            path: file.path.clone(),
            digest: file.blob.digest,
            bytes: file.blob.bytes,
            node: node.clone(),
            ..Published::default()
        };
        let planned: Vec<Published> = all.iter().filter(|(f, ..)| differs(f)).map(planned).collect();
        if !planned.is_empty() {
            let before = self.before.iter().map(|(path, old)| (&**path, old)).collect();
            note(self.store, name, &write_state(graph, self.out, &before, state.planned.iter().chain(&planned)));
        }
        for group in all.chunk_by(|a, b| a.0.last == b.0.last) {
            let ends: Vec<io::Result<End>> = group.par_iter().map(|(file, ..)| self.publish_one(file)).collect();
            for ((file, node, key), end) in group.iter().zip(ends) {
                let (stamp, written) = match end? {
                    End::Unchanged(stamp) => (stamp, false),
                    End::Written(stamp) => (stamp, true),
                    End::Lost => {
                        found.lost.push(*key);
                        continue;
                    }
                    End::Stopped => {
                        found.interrupted = true;
                        continue;
                    }
                };
                let (path, digest, bytes) = (file.path.clone(), file.blob.digest, file.blob.bytes);
                if written {
                    observer(&Event::Published { path: path.clone(), bytes });
                }
                found.files.push(Published { path, digest, bytes, written, stamp, node: node.clone() });
            }
        }
        found.files.sort_by(|a, b| a.path.cmp(&b.path));
        if !found.lost.is_empty() || !found.errors.is_empty() || found.interrupted {
            return Ok(planned);
        }

        // (3) Remove what a killed run left half, and what the last run published and this one does not make, unless somebody changed it.
        let (fresh, known) = nodes_of(graph, ready);
        let made: BTreeSet<&str> = found.files.iter().map(|f| &*f.path).collect();
        for old in &state.planned {
            let path = half(&self.out.join(&old.path));
            if self.parents_are_folders(&path) {
                let _ = fs::remove_file(path);
            }
        }
        for old in self.before.values().chain(&state.planned) {
            let gone = fresh.contains(&*old.node) || !known.contains(&*old.node);
            if gone && !made.contains(&*old.path) {
                self.remove(old, observer);
            }
        }
        found.complete = true;
        Ok(planned)
    }

    fn publish_one(&self, file: &files::File) -> io::Result<End> {
        if self.stop.load(Ordering::Relaxed) {
            return Ok(End::Stopped);
        }
        let path = self.out.join(&file.path);
        if let Some(stamp) = self.unchanged(&path, file) {
            return Ok(End::Unchanged(stamp));
        }
        match self.write(&path, &file.blob.digest) {
            Err(e) if e.kind() == io::ErrorKind::Interrupted => Ok(End::Stopped),
            written => Ok(written?.map_or(End::Lost, End::Written)),
        }
    }

    /// The stamp of a file that is there as it should be.
    fn unchanged(&self, path: &Path, file: &files::File) -> Option<Stamp> {
        let now = Stamp::of_output(path)?;
        if now.size != file.blob.bytes || !self.parents_are_folders(path) {
            return None;
        }
        if let Some(known) = self.before.get(&file.path)
            && known.digest == file.blob.digest
            && known.stamp.same(&now)
            && known.stamp.settled(self.remote)
            && !self.verify
        {
            return Some(known.stamp);
        }
        let (stamp, digest) = stamp::hash_output(path)?;
        (digest == file.blob.digest).then_some(stamp.on(self.store.grain()))
    }

    fn parents_are_folders(&self, path: &Path) -> bool {
        let parents = path.ancestors().skip(1).take_while(|p| *p != self.out);
        parents.into_iter().all(|p| fs::symlink_metadata(p).is_ok_and(|m| m.is_dir()))
    }

    /// A verified copy of an object under a fresh name, then in place; none if the object is lost. An error of kind
    /// `Interrupted` where the run is: the file may be large.
    fn write(&self, path: &Path, digest: &Digest) -> io::Result<Option<Stamp>> {
        let folder = path.parent().expect("published files lie in a folder");
        self.make_folder(folder)?;
        // Beside its place where the cache lies on another device.
        let mut fresh = self.store.fresh();
        for attempt in 0..2 {
            let mut file = OpenOptions::new().write(true).create_new(true).open(&fresh)?;
            let read = self.store.read(digest, &mut |piece| match self.stop.load(Ordering::Relaxed) {
                true => Err(io::ErrorKind::Interrupted.into()),
                false => file.write_all(piece),
            });
            let before = Stamp::of_file(&file)?;
            drop(file);
            if !matches!(read, Ok(Some(_))) {
                let _ = fs::remove_file(&fresh);
                return read.map(|_| None);
            }
            if fs::symlink_metadata(path).is_ok_and(|m| m.is_dir()) {
                let _ = fs::remove_file(&fresh);
                return Err(io::Error::other(format!("`{}` is a folder", path.display())));
            }
            match fs::rename(&fresh, path) {
                Err(e) if e.kind() == io::ErrorKind::CrossesDevices && attempt == 0 => {
                    let _ = fs::remove_file(&fresh);
                    fresh = half(path);
                    let _ = fs::remove_file(&fresh);
                }
                Err(e) => {
                    let _ = fs::remove_file(&fresh);
                    return Err(e);
                }
                Ok(()) => {
                    let stamp = Stamp::of_output(path);
                    let alone = |s: &Stamp| s.is_renamed(&before);
                    return Ok(stamp.map(|s| if alone(&s) { s.on(self.store.grain()) } else { s }));
                }
            }
        }
        unreachable!("the second attempt renames within a folder")
    }

    /// Folders down to `folder`; a link or file in the way is replaced.
    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        let mut known = self.folders.lock().unwrap();
        if known.contains(folder) {
            return Ok(());
        }
        let mut missing: Vec<&Path> = folder.ancestors().take_while(|p| *p != self.out).collect();
        while let Some(path) = missing.pop() {
            match fs::symlink_metadata(path) {
                Ok(meta) if meta.is_dir() => continue,
                Ok(_) => fs::remove_file(path)?,
                Err(_) => {}
            }
            fs::create_dir(path)?;
        }
        known.insert(folder.to_path_buf());
        Ok(())
    }

    fn remove(&self, old: &Published, observer: &mut Observer) {
        let path = self.out.join(&old.path);
        let same = Stamp::of_output(&path).is_some_and(|now| now.same(&old.stamp) && old.stamp.settled(self.remote))
            || stamp::hash_output(&path).is_some_and(|(_, digest)| digest == old.digest);
        if !same || !self.parents_are_folders(&path) || fs::remove_file(&path).is_err() {
            return;
        }
        observer(&Event::Removed { path: old.path.clone() });
        for folder in path.ancestors().skip(1).take_while(|p| *p != self.out) {
            if fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
}

/// Where a file lies while it is copied from another device: a name of its own, and the same the next time, so that
/// what a killed run leaves is known.
fn half(path: &Path) -> PathBuf {
    let name = path.file_name().expect("published files have names");
    path.with_file_name(format!(".lodge-{}", Digest::of(name.as_encoded_bytes()).short(12)))
}

/// Puts a published file back from its object; false where that is lost.
pub fn restore(store: &Store, out: &Path, file: &Published) -> io::Result<bool> {
    let before = BTreeMap::new();
    let (stop, folders) = (&AtomicBool::new(false), Mutex::default());
    let work = Work { out, store, before: &before, verify: true, remote: false, stop, folders };
    Ok(work.write(&out.join(&file.path), &file.digest)?.is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupted_copy_leaves_nothing() {
        let home = tempfile::tempdir().unwrap();
        let store = Store::open(&home.path().join("cache")).unwrap();
        let (small, large) = (vec![1; 100], vec![2; crate::run::store::SMALL as usize + 1]);
        let (before, out) = (BTreeMap::new(), home.path().join("out"));
        fs::create_dir(&out).unwrap();
        for bytes in [small, large] {
            let digest = store.put(&[(&bytes[..]).into()]).unwrap().digest;
            let stop = AtomicBool::new(true);
            let folders = Mutex::default();
            let work =
                Work { out: &out, store: &store, before: &before, verify: false, remote: false, stop: &stop, folders };
            let path = out.join("a");
            assert_eq!(work.write(&path, &digest).unwrap_err().kind(), io::ErrorKind::Interrupted);
            let left = fs::read_dir(store.fresh().parent().unwrap()).unwrap().count();
            assert!(left == 0 && !path.exists());
            stop.store(false, Ordering::Relaxed);
            assert!(work.write(&path, &digest).unwrap().is_some());
            assert!(fs::read(&path).unwrap() == bytes);
            fs::remove_file(path).unwrap();
        }
    }
}
