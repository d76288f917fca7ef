//! The cache folder itself: its parts and marker files, paths of objects, ids of runs.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nix::libc;

use super::lock::{Claim, Guard, Locks};
use crate::digest::Digest;

pub fn object_path(root: &Path, digest: &Digest) -> PathBuf {
    let name = digest.to_string();
    root.join("objects").join(&name[..2]).join(&name[2..])
}

/// For reading, never through a link.
pub fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path)
}

pub fn is_read_only(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied)
}

/// What should be a folder, if it is there at all, is one.
pub fn has_folders(root: &Path) -> io::Result<()> {
    for part in ["objects", "packs", "tmp", "plans", "published", "runs", "history"] {
        if let Ok(meta) = fs::symlink_metadata(root.join(part))
            && !meta.is_dir()
        {
            return Err(io::Error::other(format!("`{part}` in the cache is not a folder: remove it")));
        }
    }
    Ok(())
}

/// Folders and marker files. A marker that is not as it should be is rewritten. The run says that it lives before its
/// folder is there, else another would sweep it away.
pub fn prepare(root: &Path, id: u64) -> io::Result<(Arc<Locks>, Guard)> {
    fs::create_dir_all(root.join("packs"))?;
    let locks = Locks::open(&root.join("locks"))?;
    let Claim::Got(alive) = locks.claim(id) else { return Err(io::Error::other("another run has the same id")) };
    fs::create_dir_all(root.join("tmp").join(format!("{id:016x}")))?;
    let tag = "Signature: 8a477f597d28d172789f06886806bc55\n# Made by lodge; can be deleted at any time, and is then computed again.\n";
    for (name, text) in [("CACHEDIR.TAG", tag), (".gitignore", "*\n")] {
        let path = root.join(name);
        if open(&path).and_then(io::read_to_string).is_ok_and(|found| found == text) {
            continue;
        }
        let _ = fs::remove_file(&path);
        fs::write(&path, text)?;
    }
    Ok((locks, alive))
}

/// Ids rise with time, so that packs are read in the order of their runs.
pub fn fresh_id() -> u64 {
    let nanos = std::time::UNIX_EPOCH.elapsed().map_or(0, |d| d.as_nanos() as u64);
    // The low bits of the clock are noise; two processes in one microsecond differ by their id.
    (nanos & !0xffff) | u64::from(std::process::id() as u16 ^ (nanos as u16).rotate_left(7))
}
