//! The cache folder: objects by digest, results by key. Everything in it is written once under a fresh name and
//! checked when it is read. No node waits for the disk; what a power failure tears is noticed and made again. So that
//! little is, a run that computed something ends with one [`Store::sync`]: of its pack, its large objects and the note of
//! the last run, whatever else the disk has to do. Published files are not waited for: after a reboot no stamp of theirs
//! counts, and the next run reads them.
//!
//! ```text
//! CACHEDIR.TAG, .gitignore
//! objects/ab/cdef..   a large artifact or blob, named by the BLAKE3 hash of its bytes
//! packs/*.pack        results, and objects up to 4 MiB: one file per run (`pack`)
//! locks               claims (`lock`)
//! tmp/RUN/            files before they have a name; gone with the run
//! plans/, published/, runs/   what `plan`, `published` and `last` keep
//! history/NAME-N      runs of the past (`history`)
//! ```

mod state;
mod upkeep;

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use super::folder::{Wait, fresh_id, has_folders, is_read_only, object_path, open, prepare, read_large, read_through};
use super::index::{Index, Pack};
use super::lock::{Claim, Guard, Locks};
use super::pack::{self, Appender, Frame, What};
use super::record::Record;
use super::stamp;
use crate::artifact::Blob;
use crate::artifact::sections::Rest;
use crate::digest::Digest;
use crate::op::NEVER;

/// Objects up to this size lie in packs: the tiles of a tileset, thousands of them, take one file.
pub const SMALL: u64 = 1 << 22;
/// Pieces in which files are hashed and copied: less makes BLAKE3 slow.
pub const PIECE: usize = 1 << 18;

pub struct Store {
    /// Where things are looked for.
    root: PathBuf,
    /// Where things are written: `root`, or a folder that goes with the process where `root` cannot be written.
    write: PathBuf,
    overlay: Option<tempfile::TempDir>,
    /// Names this run's pack and folder; its byte in the lock file says that the run lives.
    id: u64,
    locks: Option<Arc<Locks>>,
    _alive: Option<Guard>,
    own: Mutex<Option<Appender>>,
    index: Mutex<Index>,
    names: AtomicU64,
    /// Files of this run that [`Store::sync`] waits for.
    fresh: Mutex<Vec<PathBuf>>,
    grain: OnceLock<Option<u64>>,
}

impl Store {
    /// Opens or makes the cache in `root`. Where that cannot be written, results go to a temporary folder.
    pub fn open(root: &Path) -> io::Result<Self> {
        Self::open_after(root, &mut Wait { tell: &mut |_| {}, stop: &NEVER })
    }

    /// The same, with words for a process that has the cache to itself and must end first.
    pub fn open_after(root: &Path, wait: &mut Wait) -> io::Result<Self> {
        has_folders(root)?;
        let id = fresh_id();
        let store = match prepare(root, id, false, wait) {
            Ok((locks, alive)) => Self::new(root, id, None, Some((locks, alive))),
            Err(e) if is_read_only(&e) => {
                let folder = tempfile::Builder::new().prefix("lodge-").tempdir()?;
                prepare(folder.path(), id, false, wait)?;
                Self::new(root, id, Some(folder), None)
            }
            Err(e) => return Err(e),
        };
        store.sweep();
        store.refresh()?;
        store.mend();
        Ok(store)
    }

    /// Opens a cache for oneself alone: waits until no run is at work, and those that start wait until this is closed.
    pub fn open_alone(root: &Path, wait: &mut Wait) -> io::Result<Self> {
        has_folders(root)?;
        let id = fresh_id();
        let store = Self::new(root, id, None, Some(prepare(root, id, true, wait)?));
        store.sweep();
        store.refresh()?;
        Ok(store)
    }

    /// Opens a cache, which may be absent, to look at its results. Nothing is made, and nothing can be put.
    pub fn look(root: &Path) -> io::Result<Self> {
        has_folders(root)?;
        let store = Self::new(root, fresh_id(), None, None);
        store.refresh()?;
        Ok(store)
    }

    fn new(root: &Path, id: u64, overlay: Option<tempfile::TempDir>, locks: Option<(Arc<Locks>, Guard)>) -> Self {
        let (locks, alive) = locks.unzip();
        Self {
            root: root.to_path_buf(),
            write: overlay.as_ref().map_or(root, |f| f.path()).to_path_buf(),
            overlay,
            id,
            locks,
            _alive: alive,
            own: Mutex::default(),
            index: Mutex::default(),
            names: AtomicU64::new(0),
            fresh: Mutex::default(),
            grain: OnceLock::new(),
        }
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The device of the cache, where changes of files show however soon they come ([`stamp::grain`]).
    pub fn grain(&self) -> Option<u64> {
        *self.grain.get_or_init(|| stamp::grain(&self.fresh()))
    }

    pub fn is_read_only(&self) -> bool {
        self.overlay.is_some()
    }

    /// A name in this run's folder that nobody else uses.
    pub fn fresh(&self) -> PathBuf {
        let n = self.names.fetch_add(1, Ordering::Relaxed);
        self.write.join("tmp").join(format!("{:016x}", self.id)).join(n.to_string())
    }

    /// Claims a key, so that two processes do not compute it at once. None where there are no claims.
    pub fn claim(&self, key: &Digest) -> Option<Claim> {
        let at = u64::from_le_bytes(key.0[..8].try_into().expect("eight bytes"));
        self.locks.as_ref().map(|l| l.claim(at))
    }

    // ----------------------------------------------------------------------------------------------- results

    /// Reads what other processes have added.
    pub fn refresh(&self) -> io::Result<()> {
        let grain = self.grain.get().copied().flatten();
        let lives = |id| self.locks.is_none() || self.is_alive(id);
        self.index.lock().unwrap().refresh(&self.root.join("packs"), grain, lives)
    }

    /// The whole and undamaged result of `key`.
    pub fn lookup(&self, key: &Digest) -> Option<Record> {
        let (file, frame) = {
            let mut index = self.index.lock().unwrap();
            let expected = index.expected.remove(key);
            let Some(&(pack, frame)) = index.results.get(key) else {
                index.lost.results += usize::from(expected);
                return None;
            };
            (index.packs[pack].file.clone(), frame)
        };
        let record = pack::read(&file, &frame).ok().and_then(|bytes| Record::of_bytes(&bytes, key));
        let mut index = self.index.lock().unwrap();
        match record {
            None => {
                index.lose(What::Result, key);
                if index.results.contains_key(key) {
                    drop(index);
                    return self.lookup(key);
                }
                index.lost.results += 1;
                None
            }
            // Known to be lost, and not made again since.
            Some(record) if index.damaged.contains(&record.digest) && !has(&index, self, &record.digest) => None,
            Some(_) if index.dropped.contains(key) => None,
            record => record,
        }
    }

    /// The last run had these results: where one is asked for and not there, it is lost.
    pub fn expect(&self, keys: impl Iterator<Item = Digest>) {
        self.index.lock().unwrap().expected = keys.collect();
    }

    pub fn put_result(&self, record: &Record) -> io::Result<()> {
        self.append(What::Result, &record.key, &[record.to_bytes()])?;
        self.index.lock().unwrap().dropped.remove(&record.key);
        Ok(())
    }

    /// Objects that someone else found damaged: results of theirs are misses until they are put again.
    pub fn distrust(&self, objects: &BTreeSet<Digest>) {
        let mut index = self.index.lock().unwrap();
        objects.iter().for_each(|digest| index.distrust(digest));
    }

    /// Makes `key` a miss until it is put again.
    pub fn drop_result(&self, key: &Digest) {
        self.index.lock().unwrap().dropped.insert(*key);
    }

    // ----------------------------------------------------------------------------------------------- objects

    /// Keeps bytes that are given in pieces, without joining them.
    pub fn put(&self, pieces: &[Cow<[u8]>]) -> io::Result<Blob> {
        let mut hash = blake3::Hasher::new();
        pieces.iter().for_each(|p| _ = hash.update(p));
        let digest = Digest(*hash.finalize().as_bytes());
        let bytes = pieces.iter().map(|p| p.len() as u64).sum();
        let blob = Blob { digest, bytes };
        if self.has(&blob) {
            return Ok(blob);
        }
        if bytes <= SMALL {
            self.append(What::Object, &digest, pieces)?;
            return Ok(blob);
        }
        let fresh = self.fresh();
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o444).open(&fresh)?;
        let written = pieces.iter().try_for_each(|p| file.write_all(p)).and_then(|()| self.install(&fresh, &digest));
        if written.is_err() {
            let _ = fs::remove_file(&fresh);
        }
        written.map(|()| blob)
    }

    /// Whether an object of this digest and size is there. Its bytes are not looked at.
    pub fn has(&self, blob: &Blob) -> bool {
        if self.index.lock().unwrap().objects.get(&blob.digest).is_some_and(|(_, f)| u64::from(f.len) == blob.bytes) {
            return true;
        }
        self.places(&blob.digest)
            .iter()
            .any(|path| fs::symlink_metadata(path).is_ok_and(|meta| meta.is_file() && meta.len() == blob.bytes))
    }

    /// The bytes of an object. None if it is missing or damaged; then it is deleted, and remembered as lost.
    pub fn get(&self, digest: &Digest) -> Option<Vec<u8>> {
        let small = self.packed(digest).and_then(|(file, frame)| pack::read(&file, &frame).ok());
        if let Some(bytes) = small.filter(|bytes| Digest::of(bytes) == *digest) {
            return Some(bytes);
        }
        // Into its place at once, hashed while it is in the processor's cache. Whatever is wrong, `read` says it.
        if let Some(bytes) = self.places(digest).iter().find_map(|path| read_large(path, digest)) {
            return Some(bytes);
        }
        let mut out = Vec::new();
        self.read(digest, &mut |piece| Ok(out.extend_from_slice(piece))).ok().flatten()?;
        Some(out)
    }

    /// What `decode` makes of a large object's first bytes, its length and the bytes that follow, without a copy between
    /// the file and there. None where anything is not as usual: [`Store::get`] then says what.
    pub fn get_through<T>(
        &self,
        digest: &Digest,
        decode: &mut dyn FnMut(&[u8], usize, Rest) -> Option<T>,
    ) -> Option<T> {
        if self.packed(digest).is_some() {
            return None;
        }
        self.places(digest).iter().find_map(|path| read_through(path, digest, decode))
    }

    fn packed(&self, digest: &Digest) -> Option<(Arc<File>, Frame)> {
        let index = self.index.lock().unwrap();
        index.objects.get(digest).map(|&(pack, frame)| (index.packs[pack].file.clone(), frame))
    }

    /// Gives an object in pieces and its size at the end; none if what was given is not to be used, because the
    /// object is missing or damaged. Errors are the sink's.
    pub fn read(&self, digest: &Digest, sink: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<Option<u64>> {
        while let Some((file, frame)) = self.packed(digest) {
            match pack::read(&file, &frame) {
                Ok(bytes) if Digest::of(&bytes) == *digest => {
                    sink(&bytes)?;
                    return Ok(Some(bytes.len() as u64));
                }
                _ => self.index.lock().unwrap().lose(What::Object, digest),
            }
        }
        for path in self.places(digest) {
            let Ok(mut file) = open(&path) else { continue };
            let mut hash = blake3::Hasher::new();
            let mut piece = vec![0; PIECE];
            let mut size = 0;
            let whole = loop {
                match file.read(&mut piece) {
                    Ok(0) => break true,
                    Ok(n) => {
                        hash.update(&piece[..n]);
                        sink(&piece[..n])?;
                        size += n as u64;
                    }
                    Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                    Err(_) => break false,
                }
            };
            if whole && hash.finalize().as_bytes() == &digest.0 {
                return Ok(Some(size));
            }
            let _ = fs::remove_file(&path);
            break;
        }
        let mut index = self.index.lock().unwrap();
        if index.damaged.insert(*digest) {
            tracing::debug!(%digest, "an object is missing or damaged");
            index.lost.objects.push(*digest);
        }
        Ok(None)
    }

    /// What turned out damaged or missing since the last call, in one sentence.
    pub fn trouble(&self) -> Option<String> {
        std::mem::take(&mut self.index.lock().unwrap().lost).sentence()
    }

    fn places(&self, digest: &Digest) -> Vec<PathBuf> {
        let roots = if self.overlay.is_some() { vec![&self.write, &self.root] } else { vec![&self.root] };
        roots.into_iter().map(|root| object_path(root, digest)).collect()
    }

    /// Gives a finished file its name.
    fn install(&self, fresh: &Path, digest: &Digest) -> io::Result<()> {
        let path = object_path(&self.write, digest);
        self.fresh.lock().unwrap().push(path.clone());
        match fs::rename(fresh, &path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(path.parent().expect("objects lie in folders"))?;
                fs::rename(fresh, &path)
            }
            other => other,
        }
    }

    fn append(&self, what: What, name: &Digest, body: &[impl AsRef<[u8]>]) -> io::Result<()> {
        let mut own = self.own.lock().unwrap();
        if own.is_none() {
            let path = self.write.join("packs").join(format!("{:016x}.pack", self.id));
            let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
            let reader = Arc::new(file.try_clone()?);
            self.fresh.lock().unwrap().push(path.clone());
            self.index.lock().unwrap().packs.push(Pack::new(reader, path, true));
            *own = Some(Appender::new(file));
        }
        let frame = own.as_mut().expect("made above").append(what, name, body)?;
        let mut index = self.index.lock().unwrap();
        let pack = index.packs.iter().position(|p| p.own).expect("made above");
        index.add(pack, frame);
        Ok(())
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        self.close();
    }
}

impl crate::op::Blobs for Store {
    fn put(&self, bytes: &[u8]) -> io::Result<Blob> {
        Store::put(self, &[Cow::Borrowed(bytes)])
    }
}

/// Whether an object is there at all, under the index' lock.
fn has(index: &Index, store: &Store, digest: &Digest) -> bool {
    index.objects.contains_key(digest)
        || store.places(digest).iter().any(|p| fs::symlink_metadata(p).is_ok_and(|m| m.is_file()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(store: &Store, bytes: &[u8]) -> Digest {
        store.put(&[Cow::Borrowed(bytes)]).unwrap().digest
    }

    #[test]
    fn small_and_large_objects_come_back_and_to_others() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let other = Store::open(folder.path()).unwrap();
        let (small, large) = (vec![1; 10], vec![2; SMALL as usize + 1]);
        let digests = [put(&store, &small), put(&store, &large)];
        other.refresh().unwrap();
        for store in [&store, &other, &Store::open(folder.path()).unwrap()] {
            assert_eq!(store.get(&digests[0]).as_ref(), Some(&small));
            assert_eq!(store.get(&digests[1]).as_ref(), Some(&large));
            assert_eq!(store.get(&Digest::of(b"absent")), None);
        }
        assert!(folder.path().join("CACHEDIR.TAG").exists());
    }

    #[test]
    fn a_damaged_object_is_gone_and_can_be_put_again() {
        let folder = tempfile::tempdir().unwrap();
        for bytes in [vec![3; 5000], vec![3; SMALL as usize + 1]] {
            let store = Store::open(folder.path()).unwrap();
            let digest = put(&store, &bytes);
            let path = object_path(folder.path(), &digest);
            let pack = store.write.join("packs").join(format!("{:016x}.pack", store.id));
            let file = if bytes.len() as u64 > SMALL { &path } else { &pack };
            let mut bad = fs::read(file).unwrap();
            *bad.last_mut().unwrap() ^= 1;
            fs::remove_file(file).unwrap();
            fs::write(file, bad).unwrap();
            let store = Store::open(folder.path()).unwrap();
            assert_eq!(store.get(&digest), None);
            assert!(!path.exists());
            assert_eq!(put(&store, &bytes), digest);
            for store in [&store, &Store::open(folder.path()).unwrap()] {
                assert_eq!(store.get(&digest).as_ref(), Some(&bytes));
            }
        }
    }

    #[test]
    fn a_large_object_is_read_through_once_and_forwards_and_not_if_a_bit_changed() {
        let folder = tempfile::tempdir().unwrap();
        let bytes: Vec<u8> = (0..SMALL as usize + 1000).map(|i| (i ^ (i >> 8)) as u8).collect();
        let store = Store::open(folder.path()).unwrap();
        let digest = put(&store, &bytes);
        let parts = |from: &[usize]| {
            store.get_through(&digest, &mut |head, len, rest| {
                assert_eq!((head, len), (&bytes[..PIECE], bytes.len()));
                let mut parts = vec![vec![0; 1000]; from.len()];
                parts.iter_mut().zip(from).try_for_each(|(part, &at)| rest(at, part)).map(|()| parts)
            })
        };
        let right = |from: &[usize]| Some(from.iter().map(|&at| bytes[at..at + 1000].to_vec()).collect::<Vec<_>>());
        for from in [&[][..], &[PIECE, PIECE + 1000, 3 * PIECE - 7], &[SMALL as usize]] {
            assert_eq!(parts(from), right(from));
        }
        assert_eq!(parts(&[3 * PIECE, PIECE]), None);
        assert_eq!(parts(&[SMALL as usize + 1]), None);
        // A bit in what is asked for, and in what is passed over.
        let path = object_path(folder.path(), &digest);
        for at in [PIECE + 5, bytes.len() - 1] {
            let mut bad = bytes.clone();
            bad[at] ^= 1;
            fs::remove_file(&path).unwrap();
            fs::write(&path, bad).unwrap();
            assert_eq!(parts(&[PIECE]), None);
        }
        assert!(path.exists(), "`get` is who deletes");
        assert_eq!(store.get(&digest), None);
        assert!(!path.exists());
    }

    /// What is small is appended to one file, however much of it there is; what is large has a file of its own.
    #[test]
    fn small_objects_of_a_run_share_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let small: Vec<Vec<u8>> = (0..500u32).map(|i| i.to_le_bytes().repeat(1 + i as usize)).collect();
        let mut all: Vec<(Digest, &Vec<u8>)> = small.iter().map(|bytes| (put(&store, bytes), bytes)).collect();
        let large = vec![7; SMALL as usize + 1];
        all.push((put(&store, &large), &large));
        let files = |name: &str| {
            let mut folders = vec![folder.path().join(name)];
            let mut found = 0;
            while let Some(next) = folders.pop() {
                let entries = fs::read_dir(next).into_iter().flatten().map(|e| e.unwrap().path());
                entries.for_each(|path| if path.is_dir() { folders.push(path) } else { found += 1 });
            }
            found
        };
        assert_eq!((files("packs"), files("objects")), (1, 1));
        assert!(all.iter().all(|(digest, bytes)| store.get(digest).as_ref() == Some(bytes)));
    }

    #[test]
    fn folders_of_dead_runs_are_swept() {
        let folder = tempfile::tempdir().unwrap();
        let living = Store::open(folder.path()).unwrap();
        let dead = folder.path().join("tmp/00000000000000aa");
        fs::create_dir_all(&dead).unwrap();
        let _store = Store::open(folder.path()).unwrap();
        assert!(!dead.exists());
        assert!(living.fresh().parent().unwrap().exists());
    }
}
