//! What is done to a cache before and after the work: clean up after the dead, mend, wait for the disk.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Store;
use crate::run::folder::open;
use crate::run::pack::{self, Frame};

impl Store {
    /// Removes this run's folder. Nothing large can be written afterwards.
    pub fn close(&self) {
        let _ = fs::remove_dir_all(self.write.join("tmp").join(format!("{:016x}", self.id)));
    }

    /// Removes what runs that died left in `tmp`.
    pub(super) fn sweep(&self) {
        let Some(locks) = &self.locks else { return };
        let Ok(entries) = fs::read_dir(self.root.join("tmp")) else { return };
        for entry in entries.flatten() {
            let id = entry.file_name().to_str().and_then(|n| u64::from_str_radix(n, 16).ok());
            if let Some(id) = id.filter(|&id| id != self.id)
                && !locks.is_held(id)
            {
                let _ = fs::remove_dir_all(entry.path());
            }
        }
    }

    /// Whether the run of this id is at work.
    pub fn is_alive(&self, id: u64) -> bool {
        id != self.id && self.locks.as_ref().is_some_and(|l| l.is_held(id))
    }

    /// Writes a damaged pack of a run that has ended again, with what is `good` of it.
    pub fn replace_pack(&self, path: &Path, file: &File, good: &[Frame]) -> io::Result<()> {
        if good.is_empty() {
            return fs::remove_file(path);
        }
        let fresh = self.fresh();
        let copied = pack::rewrite(&fresh, file, good);
        copied.and_then(|()| fs::rename(&fresh, path)).inspect_err(|_| _ = fs::remove_file(&fresh))
    }

    /// Writes packs that are damaged between their records again, without what cannot be read.
    pub(super) fn mend(&self) {
        let damaged: Vec<(PathBuf, Arc<File>, u64)> = {
            let index = self.index.lock().unwrap();
            let damaged = index.packs.iter().filter(|p| p.lost > 0);
            damaged.map(|p| (p.path.clone(), p.file.clone(), p.lost)).collect()
        };
        for (path, file, lost) in damaged {
            if self.is_read_only() || pack::id_of(&path).is_none_or(|id| self.is_alive(id)) {
                continue;
            }
            let again = pack::scan(&file, 0).and_then(|scan| self.replace_pack(&path, &file, &scan.frames));
            if let Err(error) = again {
                tracing::debug!(%error, "cannot mend a pack");
            }
            self.index.lock().unwrap().lost.bytes += lost;
        }
    }

    /// Waits until what this run computed is on the disk. Costs nothing where it computed nothing.
    pub fn sync(&self) -> io::Result<()> {
        let fresh = std::mem::take(&mut *self.fresh.lock().unwrap());
        if self.is_read_only() || self.own.lock().unwrap().is_none() {
            return Ok(());
        }
        let mut folders = BTreeSet::new();
        for path in &fresh {
            match open(path) {
                Ok(file) => file.sync_data()?,
                // Another run found it damaged.
                Err(e) if e.kind() == io::ErrorKind::NotFound => continue,
                Err(e) => return Err(e),
            }
            folders.extend(path.ancestors().skip(1).take_while(|p| p.starts_with(&self.root)));
        }
        folders.iter().try_for_each(|folder| File::open(folder)?.sync_all())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::folder::object_path;
    use crate::run::store::SMALL;

    /// Whether the end of the run looks for what was written here.
    fn waits_for(which: impl Fn(&Path, &Store) -> PathBuf) -> bool {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.put(&[vec![1; 10].into()]).unwrap();
        store.put(&[vec![2; SMALL as usize + 1].into()]).unwrap();
        store.put_state("runs", "note", b"x").unwrap();
        let path = which(folder.path(), &store);
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        store.sync().is_err()
    }

    #[test]
    fn the_end_of_a_run_waits_for_all_that_it_computed() {
        let large = crate::digest::Digest::of(&vec![2; SMALL as usize + 1]);
        assert!(waits_for(|root, store| root.join(format!("packs/{:016x}.pack", store.id))));
        assert!(waits_for(|root, _| object_path(root, &large)));
        assert!(waits_for(|root, _| root.join("runs/note")));
        assert!(!waits_for(|root, _| root.join("CACHEDIR.TAG")));
        // A run without a result waits for nothing.
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.put_state("runs", "note", b"x").unwrap();
        fs::remove_file(folder.path().join("runs/note")).unwrap();
        fs::create_dir(folder.path().join("runs/note")).unwrap();
        store.sync().unwrap();
    }
}
