//! The cache folder itself: its parts and marker files, paths of objects, ids of runs.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use nix::libc;

use super::lock::{Claim, Guard, Locks};
use super::store::PIECE;
use crate::artifact::sections::Rest;
use crate::digest::Digest;

pub fn object_path(root: &Path, digest: &Digest) -> PathBuf {
    let name = digest.to_string();
    root.join("objects").join(&name[..2]).join(&name[2..])
}

/// For reading, never through a link, and nothing that is endless.
pub fn open(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("it is not a regular file")) }
}

/// A large object's bytes, if they are its own.
pub fn read_large(path: &Path, digest: &Digest) -> Option<Vec<u8>> {
    let file = open(path).ok()?;
    let bytes = file.metadata().ok()?.len();
    let mut out = Vec::new();
    out.try_reserve_exact(usize::try_from(bytes).ok()?).ok()?;
    let mut hash = blake3::Hasher::new();
    loop {
        let start = out.len();
        if (&file).take(PIECE as u64).read_to_end(&mut out).ok()? == 0 {
            break;
        }
        hash.update(&out[start..]);
    }
    (hash.finalize().as_bytes() == &digest.0).then_some(out)
}

/// What `decode` makes of a large object while it is read, if the bytes are its own: what it made of others is dropped.
pub fn read_through<T>(
    path: &Path,
    digest: &Digest,
    decode: &mut dyn FnMut(&[u8], usize, Rest) -> Option<T>,
) -> Option<T> {
    let file = open(path).ok()?;
    let len = usize::try_from(file.metadata().ok()?.len()).ok()?;
    let mut hashed = Hashed { file, at: 0, hash: blake3::Hasher::new() };
    let mut head = vec![0; len.min(PIECE)];
    hashed.fill(&mut head)?;
    let value = decode(&head, len, &mut |at, out| {
        hashed.pass_to(at)?;
        hashed.fill(out)
    })?;
    hashed.pass_to(len)?;
    (hashed.hash.finalize().as_bytes() == &digest.0).then_some(value)
}

/// A file that is read once, from its start to its end, and hashed on the way.
struct Hashed {
    file: File,
    at: usize,
    hash: blake3::Hasher,
}

impl Hashed {
    /// Each piece is hashed while it is in the processor's cache. Pieces end at multiples of their size: BLAKE3 is slower
    /// on others.
    fn fill(&mut self, mut out: &mut [u8]) -> Option<()> {
        while !out.is_empty() {
            let (piece, rest) = out.split_at_mut(out.len().min(PIECE - self.at % PIECE));
            self.file.read_exact(piece).ok()?;
            self.hash.update(piece);
            self.at += piece.len();
            out = rest;
        }
        Some(())
    }

    /// Reads what nobody asked for. There is no way back.
    fn pass_to(&mut self, at: usize) -> Option<()> {
        let mut left = at.checked_sub(self.at)?;
        let mut piece = vec![0; left.min(PIECE)];
        while left > 0 {
            let n = left.min(PIECE);
            self.fill(&mut piece[..n])?;
            left -= n;
        }
        Some(())
    }
}

/// The bytes of a file that lodge keeps for itself; what is larger than any of these is an error.
pub fn read_state(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = open(path)?;
    let bytes = file.metadata()?.len();
    if bytes > LARGEST_STATE {
        return Err(io::Error::other("it is larger than lodge makes any"));
    }
    let mut out = Vec::with_capacity(bytes as usize);
    file.read_to_end(&mut out)?;
    Ok(out)
}

/// Ten thousand nodes and published files take two million.
pub const LARGEST_STATE: u64 = 1 << 30;

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

/// What to do while another process must end first.
pub struct Wait<'a> {
    /// Hears which one it is.
    pub tell: &'a mut dyn FnMut(i32),
    /// Set to give up: an error of kind `Interrupted`.
    pub stop: &'a AtomicBool,
}

/// Folders and marker files. A marker that is not as it should be is rewritten. The run says that it lives before its
/// folder is there, else another would sweep it away; `alone`, that no other may.
pub fn prepare(root: &Path, id: u64, alone: bool, wait: &mut Wait) -> io::Result<(Arc<Locks>, Guard)> {
    fs::create_dir_all(root.join("packs"))?;
    let locks = Locks::open(&root.join("locks")).map_err(|e| {
        if is_read_only(&e) { e } else { io::Error::new(e.kind(), format!("`locks` in the cache: {e}")) }
    })?;
    let mut told = None;
    let alive = loop {
        match if alone { locks.claim_all()? } else { locks.claim(id) } {
            Claim::Got(guard) => break guard,
            Claim::Busy(process) if told != Some(process) => {
                told = Some(process);
                (wait.tell)(process);
            }
            Claim::Busy(_) if wait.stop.load(Ordering::Relaxed) => return Err(io::ErrorKind::Interrupted.into()),
            Claim::Busy(_) => thread::sleep(Duration::from_millis(2)),
        }
    };
    fs::create_dir_all(root.join("tmp").join(format!("{id:016x}")))?;
    let tag = "Signature: 8a477f597d28d172789f06886806bc55\n# Made by lodge; can be deleted at any time, and is then computed again.\n";
    for (name, text) in [("CACHEDIR.TAG", tag), (".gitignore", "*\n")] {
        let path = root.join(name);
        if open(&path).and_then(io::read_to_string).is_ok_and(|found| found == text) {
            continue;
        }
        // Without them nothing is lost.
        let _ = fs::remove_file(&path);
        let _ = fs::write(&path, text);
    }
    Ok((locks, alive))
}

/// Ids rise with time, so that packs are read in the order of their runs.
pub fn fresh_id() -> u64 {
    let nanos = std::time::UNIX_EPOCH.elapsed().map_or(0, |d| d.as_nanos() as u64);
    // The low bits of the clock are noise; two processes in one microsecond differ by their id.
    (nanos & !0xffff) | u64::from(std::process::id() as u16 ^ (nanos as u16).rotate_left(7))
}
