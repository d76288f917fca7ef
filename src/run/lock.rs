//! Claims between processes: POSIX locks on single bytes of one file, at an offset that stands for the thing claimed.
//! The kernel frees them when their process dies, and tells who holds one. Every run holds the byte of its id as long as
//! it lives; whoever holds all bytes is alone.
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

/// Frees its byte, or all of them, when dropped.
pub struct Guard {
    locks: Arc<Locks>,
    at: u64,
}

/// Stands for every byte at once: no byte's number is so large.
const ALL: u64 = u64::MAX;

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
        if !meta.is_file() {
            return Err(io::Error::other("it is not a regular file"));
        }
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
        if held.contains(&at) || held.contains(&ALL) {
            return Claim::Busy(std::process::id() as i32);
        }
        match fcntl(&self.file, FcntlArg::F_SETLK(&bytes(at, libc::F_WRLCK))) {
            Err(Errno::EAGAIN | Errno::EACCES) => return Claim::Busy(self.holder(at).unwrap_or(0)),
            _ => held.insert(at),
        };
        Claim::Got(Guard { locks: self.clone(), at })
    }

    /// Claims all bytes without waiting: nobody else has any claim, nor gets one. An error where there are no locks.
    pub fn claim_all(self: &Arc<Self>) -> io::Result<Claim> {
        let mut held = self.held.lock().unwrap();
        if !held.is_empty() {
            return Ok(Claim::Busy(std::process::id() as i32));
        }
        match fcntl(&self.file, FcntlArg::F_SETLK(&bytes(ALL, libc::F_WRLCK))) {
            Err(Errno::EAGAIN | Errno::EACCES) => return Ok(Claim::Busy(self.holder(ALL).unwrap_or(0))),
            Err(error) => return Err(error.into()),
            Ok(_) => held.insert(ALL),
        };
        Ok(Claim::Got(Guard { locks: self.clone(), at: ALL }))
    }

    /// Whether anybody holds byte `at`.
    pub fn is_held(&self, at: u64) -> bool {
        let at = at & i64::MAX as u64;
        self.held.lock().unwrap().contains(&at) || self.holder(at).is_some()
    }

    fn holder(&self, at: u64) -> Option<i32> {
        let mut ask = bytes(at, libc::F_WRLCK);
        fcntl(&self.file, FcntlArg::F_GETLK(&mut ask)).ok()?;
        (ask.l_type != libc::F_UNLCK as libc::c_short).then_some(ask.l_pid)
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        let mut held = self.locks.held.lock().unwrap();
        let _ = fcntl(&self.locks.file, FcntlArg::F_SETLK(&bytes(self.at, libc::F_UNLCK)));
        held.remove(&self.at);
    }
}

/// The process that has locked this file or folder as a whole, or 0: only Linux tells.
pub fn holder_of(file: &File) -> i32 {
    let Ok(meta) = file.metadata() else { return 0 };
    let text = fs::read_to_string("/proc/locks").unwrap_or_default();
    // `3: FLOCK  ADVISORY  WRITE 1234 fe:00:5678 0 EOF`; those who wait have `->` behind the number.
    let holder = text.lines().find_map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let inode = words.get(5)?.rsplit(':').next()?.parse::<u64>().ok()?;
        (words[1] == "FLOCK" && inode == meta.ino()).then(|| words[4].parse().ok())?
    });
    holder.unwrap_or(0)
}

/// One byte, or all of them.
fn bytes(at: u64, kind: libc::c_int) -> libc::flock {
    // To the end, wherever that is, is a length of 0.
    let (start, len) = if at == ALL { (0, 0) } else { (at, 1) };
    libc::flock {
        l_type: kind as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: start as libc::off_t,
        l_len: len,
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

    #[test]
    fn all_bytes_are_claimed_where_none_is() {
        let folder = tempfile::tempdir().unwrap();
        let locks = Locks::open(&folder.path().join("locks")).unwrap();
        let one = locks.claim(7);
        assert!(matches!(locks.claim_all().unwrap(), Claim::Busy(_)));
        drop(one);
        let Claim::Got(all) = locks.claim_all().unwrap() else { panic!("free") };
        assert!(matches!(locks.claim(8), Claim::Busy(_)));
        drop(all);
        assert!(matches!(locks.claim(8), Claim::Got(_)));
    }
}
