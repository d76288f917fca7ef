//! Claims between processes: POSIX locks on single bytes of one file, at an offset that stands for the thing claimed.
//! The kernel frees them when their process dies, and tells who holds one.
//!
//! Such locks belong to the process and fall when it closes *any* descriptor of the file: so each lock file is opened
//! once and never closed, and threads (and runs) of one process are kept apart by a set.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::sync::{Arc, Mutex};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;

/// An open lock file.
pub struct Locks {
    file: File,
    held: Mutex<BTreeSet<u64>>,
}

/// What came of [`Locks::claim`].
pub enum Claim {
    Got(Guard),
    /// By the process with this id.
    Busy(i32),
}

/// Frees its byte when dropped.
pub struct Guard {
    locks: Arc<Locks>,
    at: u64,
}

static OPEN: Mutex<BTreeMap<(u64, u64), Arc<Locks>>> = Mutex::new(BTreeMap::new());

impl Locks {
    pub fn open(path: &Path) -> io::Result<Arc<Self>> {
        let mut open = OPEN.lock().unwrap();
        if let Ok(meta) = fs::symlink_metadata(path)
            && let Some(known) = open.get(&(meta.dev(), meta.ino()))
        {
            return Ok(known.clone());
        }
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .custom_flags(libc::O_NOFOLLOW)
            .open(path)?;
        let meta = file.metadata()?;
        let new = Arc::new(Self { file, held: Mutex::default() });
        // Somebody may have put it back between the look and the opening: then the new descriptor must stay open too.
        let known = open.entry((meta.dev(), meta.ino())).or_insert_with(|| new.clone()).clone();
        if !Arc::ptr_eq(&known, &new) {
            std::mem::forget(new);
        }
        Ok(known)
    }

    /// Claims byte `at` without waiting. A file system without locks grants everything: work may then be done twice.
    pub fn claim(self: &Arc<Self>, at: u64) -> Claim {
        let at = at & i64::MAX as u64;
        let mut held = self.held.lock().unwrap();
        if held.contains(&at) {
            return Claim::Busy(std::process::id() as i32);
        }
        match fcntl(&self.file, FcntlArg::F_SETLK(&byte(at, libc::F_WRLCK))) {
            Err(Errno::EAGAIN | Errno::EACCES) => return Claim::Busy(self.holder(at).unwrap_or(0)),
            _ => held.insert(at),
        };
        Claim::Got(Guard { locks: self.clone(), at })
    }

    /// Whether anybody holds byte `at`.
    pub fn is_held(&self, at: u64) -> bool {
        let at = at & i64::MAX as u64;
        self.held.lock().unwrap().contains(&at) || self.holder(at).is_some()
    }

    fn holder(&self, at: u64) -> Option<i32> {
        let mut ask = byte(at, libc::F_WRLCK);
        fcntl(&self.file, FcntlArg::F_GETLK(&mut ask)).ok()?;
        (ask.l_type != libc::F_UNLCK as libc::c_short).then_some(ask.l_pid)
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        let mut held = self.locks.held.lock().unwrap();
        let _ = fcntl(&self.locks.file, FcntlArg::F_SETLK(&byte(self.at, libc::F_UNLCK)));
        held.remove(&self.at);
    }
}

fn byte(at: u64, kind: libc::c_int) -> libc::flock {
    libc::flock {
        l_type: kind as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: at as libc::off_t,
        l_len: 1,
        l_pid: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_is_claimed_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("locks");
        let (a, b) = (Locks::open(&path).unwrap(), Locks::open(&path).unwrap());
        let Claim::Got(guard) = a.claim(7) else { panic!("free") };
        assert!(matches!(b.claim(7), Claim::Busy(_)));
        assert!(matches!(b.claim(8), Claim::Got(_)));
        assert!(b.is_held(7) && !b.is_held(8));
        drop(guard);
        assert!(matches!(b.claim(7), Claim::Got(_)));
    }
}
