//! The small state files of `plan`, `published`, `last`, `history` and `stamp`: by folder and name.

use std::fs;
use std::io;
use std::path::PathBuf;

use super::Store;
use crate::run::folder::read_state;

impl Store {
    pub fn state(&self, folder: &str, name: &str) -> PathBuf {
        self.root.join(folder).join(name)
    }

    /// Writes a state file whole, or not at all.
    pub fn put_state(&self, folder: &str, name: &str, bytes: &[u8]) -> io::Result<()> {
        if self.is_read_only() {
            return Ok(());
        }
        let fresh = self.fresh();
        fs::write(&fresh, bytes)?;
        let path = self.state(folder, name);
        if folder == "runs" {
            self.fresh.lock().unwrap().push(path.clone());
        }
        match fs::rename(&fresh, &path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(self.root.join(folder))?;
                fs::rename(&fresh, &path)
            }
            other => other,
        }
    }

    /// Writes a state file whole, unless there is something of that name: whether it did.
    pub fn put_new_state(&self, folder: &str, name: &str, bytes: &[u8]) -> io::Result<bool> {
        let (fresh, path) = (self.fresh(), self.state(folder, name));
        fs::create_dir_all(self.root.join(folder))?;
        fs::write(&fresh, bytes)?;
        let put = match fs::hard_link(&fresh, &path) {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            // A file system without links.
            Err(_) if fs::symlink_metadata(&path).is_err() => fs::rename(&fresh, &path).map(|()| true),
            other => other.map(|()| true),
        };
        let _ = fs::remove_file(&fresh);
        put
    }

    /// A state file's bytes; none where there is no such file.
    pub fn get_state(&self, folder: &str, name: &str) -> Vec<u8> {
        read_state(&self.state(folder, name)).unwrap_or_default()
    }
}
