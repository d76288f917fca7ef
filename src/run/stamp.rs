//! When a file is known to be unchanged without reading it.
//!
//! A stamp is what the file system says of a file: device, inode, size, mtime and ctime. A program may put back size
//! and mtime; ctime it cannot set. A clock that ticks coarsely can give two writes one ctime: so a stamp counts only if
//! it was taken a margin after the file's last change; or where the file system gives every change after a look a time of
//! its own ([`grain`]), which makes the margin needless.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use nix::fcntl::AtFlags;
use nix::libc;
use nix::sys::stat::fstatat;

use super::codec::{Reader, Writer};
use super::executor::InputFile;
use super::store::{PIECE, Store};
use crate::digest::Digest;

/// What the file system says of a file, and when it said so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    device: u64,
    inode: u64,
    pub size: u64,
    /// Nanoseconds.
    mtime: i64,
    ctime: i64,
    /// Nanoseconds; not part of what is compared.
    taken: i64,
    /// Any change since would show, whatever the clock's tick ([`grain`]); not part of what is compared.
    fine: bool,
}

/// Local file systems tick in 4 ms at most.
const MARGIN: i64 = 20_000_000;
/// Others have clocks of their own.
const MARGIN_REMOTE: i64 = 2_000_000_000;

impl Stamp {
    fn of_meta(meta: &Metadata) -> Self {
        let nanos = |s: i64, n: i64| s.saturating_mul(1_000_000_000).saturating_add(n);
        Self {
            device: meta.dev(),
            inode: meta.ino(),
            size: meta.size(),
            mtime: nanos(meta.mtime(), meta.mtime_nsec()),
            ctime: nanos(meta.ctime(), meta.ctime_nsec()),
            taken: now(),
            fine: false,
        }
    }

    /// Of an input: a link's target. Only regular files have stamps.
    pub fn of_input(path: &Path) -> io::Result<Self> {
        let meta = fs::metadata(path)?;
        if !meta.is_file() {
            let what = if meta.is_dir() { "it is a folder" } else { "it is not a regular file" };
            return Err(io::Error::other(what));
        }
        Ok(Self::of_meta(&meta))
    }

    /// Of a published file: none where there is something else than a regular file.
    pub fn of_output(path: &Path) -> Option<Self> {
        fs::symlink_metadata(path).ok().filter(Metadata::is_file).map(|m| Self::of_meta(&m))
    }

    /// Of a file below an open folder, with a link's target or without; none of anything but a regular file.
    pub fn of_entry(folder: &File, name: &str, follow: bool) -> Option<Self> {
        let flags = if follow { AtFlags::empty() } else { AtFlags::AT_SYMLINK_NOFOLLOW };
        let found = fstatat(folder, name, flags).ok()?;
        let nanos = |s: i64, n: i64| s.saturating_mul(1_000_000_000).saturating_add(n);
        (found.st_mode & libc::S_IFMT == libc::S_IFREG).then(|| Self {
            device: found.st_dev,
            inode: found.st_ino,
            size: found.st_size as u64,
            mtime: nanos(found.st_mtime, found.st_mtime_nsec),
            ctime: nanos(found.st_ctime, found.st_ctime_nsec),
            taken: now(),
            fine: false,
        })
    }

    /// Of a folder: another one when a name in it is.
    pub fn of_folder(path: &Path) -> io::Result<Self> {
        Ok(Self::of_meta(&fs::metadata(path)?))
    }

    /// Of an open file.
    pub fn of_file(file: &File) -> io::Result<Self> {
        Ok(Self::of_meta(&file.metadata()?))
    }

    /// The same file, by all that the file system says.
    pub fn same(&self, other: &Self) -> bool {
        (self.device, self.inode, self.size, self.mtime, self.ctime)
            == (other.device, other.inode, other.size, other.mtime, other.ctime)
    }

    /// Taken so long after the last change that another one would show.
    pub fn settled(&self, remote: bool) -> bool {
        let margin = if remote { MARGIN_REMOTE } else { MARGIN };
        self.fine || self.ctime.saturating_add(margin) <= self.taken
    }

    /// Says that the file lies on a device of fine grain, if it does.
    pub fn on(mut self, grain: Option<u64>) -> Self {
        self.fine = grain == Some(self.device);
        self
    }

    /// As if it had been taken so long after the file's last change.
    #[cfg(test)]
    pub fn taken_after(mut self, nanos: i64) -> Self {
        self.taken = self.ctime + nanos;
        self
    }

    /// Of a file that was looked at, and then renamed by us: whether nobody wrote to it between the two looks.
    pub fn is_renamed(&self, before: &Self) -> bool {
        (self.device, self.inode, self.size, self.mtime) == (before.device, before.inode, before.size, before.mtime)
    }

    pub fn write(&self, out: &mut Writer) {
        out.u64(self.device);
        out.u64(self.inode);
        out.u64(self.size);
        out.i64(self.mtime);
        out.i64(self.ctime);
        out.i64(self.taken);
        out.0.push(self.fine.into());
    }

    pub fn read(from: &mut Reader) -> Option<Self> {
        Some(Self {
            device: from.u64()?,
            inode: from.u64()?,
            size: from.u64()?,
            mtime: from.i64()?,
            ctime: from.i64()?,
            taken: from.i64()?,
            fine: from.u8()? != 0,
        })
    }
}

fn now() -> i64 {
    std::time::UNIX_EPOCH.elapsed().map_or(0, |d| d.as_nanos() as i64)
}

/// The device of a new file at `path`, if any change after a look at a file there changes its ctime, however soon: so
/// on Linux 6.13 and later with ext4, xfs, btrfs and tmpfs (multigrain timestamps). Tried, not believed: where clocks
/// tick, the first try fails.
pub fn grain(path: &Path) -> Option<u64> {
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).ok()?;
    let mut seen = BTreeSet::new();
    let tries = (0..16).try_for_each(|_| {
        file.write_all(b"x").ok()?;
        seen.insert(Stamp::of_file(&file).ok()?.ctime).then_some(())
    });
    let device = Stamp::of_file(&file).ok().map(|s| s.device);
    let remote = is_remote(path);
    fs::remove_file(path).ok()?;
    tries.and(device).filter(|_| !remote)
}

/// Whether `path` lies on a file system that is not known to be local.
pub fn is_remote(path: &Path) -> bool {
    // ext, xfs, btrfs, tmpfs, overlayfs, zfs, f2fs, bcachefs, ramfs
    const LOCAL: [i64; 9] = [
        0xef53,
        0x5846_5342,
        0x9123_683e,
        0x0102_1994,
        0x794c_7630,
        0x2fc1_2fc1,
        0xf2f5_2010,
        0xca45_1a4e,
        0x8584_58f6,
    ];
    let mut at = path;
    loop {
        match nix::sys::statfs::statfs(at) {
            Ok(found) => return !LOCAL.contains(&(found.filesystem_type().0 & 0xffff_ffff)),
            Err(_) => match at.parent() {
                Some(parent) if !parent.as_os_str().is_empty() => at = parent,
                _ => return true,
            },
        }
    }
}

/// [`is_remote`] of many files: of a device the system is asked once.
#[derive(Default)]
pub struct Remotes(BTreeMap<u64, bool>);

impl Remotes {
    pub fn is_remote(&mut self, path: &Path, stamp: &Stamp) -> bool {
        *self.0.entry(stamp.device).or_insert_with(|| is_remote(path))
    }
}

/// Digests of input files that were read before, with the stamps that they had.
#[derive(Default)]
pub struct Stamps {
    known: BTreeMap<PathBuf, (Stamp, Digest)>,
    changed: bool,
    remotes: Remotes,
}

const TAG: &str = "lodge stamps 2";

impl Stamps {
    pub fn load(store: &Store) -> Self {
        let bytes = store.get_state("runs", "stamps");
        let parse = || {
            let mut from = Reader::unseal(&bytes, TAG)?;
            let same_boot = from.text()? == boot();
            let all = from.list(|f| Some((PathBuf::from(f.text()?), (Stamp::read(f)?, f.digest()?))))?;
            same_boot.then(|| all.into_iter().collect())
        };
        Self { known: parse().unwrap_or_default(), ..Self::default() }
    }

    /// A file that is surely as it was when it was read.
    pub fn known(&mut self, path: &Path) -> Option<InputFile> {
        let &(stamp, digest) = self.known.get(path)?;
        let now = Stamp::of_input(path).ok()?;
        let sure = now.same(&stamp) && stamp.settled(self.remotes.is_remote(path, &now));
        sure.then(|| InputFile { path: path.to_path_buf(), stamp, digest })
    }

    pub fn add(&mut self, file: &InputFile) {
        self.known.insert(file.path.clone(), (file.stamp, file.digest));
        self.changed = true;
    }

    /// Drops those that can tell nothing any more: of files that are no longer as they were, and of files other than
    /// `wanted`. How many went.
    pub fn keep(&mut self, wanted: &BTreeSet<Digest>) -> u64 {
        let before = self.known.len();
        self.known.retain(|path, (stamp, digest)| {
            wanted.contains(digest) && Stamp::of_input(path).is_ok_and(|now| now.same(stamp))
        });
        let gone = (before - self.known.len()) as u64;
        self.changed |= gone > 0;
        gone
    }

    pub fn save(&self, store: &Store) {
        if !self.changed {
            return;
        }
        let mut out = Writer::default();
        out.text(&boot());
        let utf8: Vec<_> = self.known.iter().filter_map(|(path, v)| Some((path.to_str()?, v))).collect();
        out.u32(utf8.len() as u32);
        for (path, (stamp, digest)) in utf8 {
            out.text(path);
            stamp.write(&mut out);
            out.digest(digest);
        }
        if let Err(error) = store.put_state("runs", "stamps", &out.sealed(TAG)) {
            tracing::debug!(%error, "cannot keep stamps");
        }
    }
}

/// Whether the stored stamps are as they were written.
pub fn is_whole(bytes: &[u8]) -> bool {
    Reader::unseal(bytes, TAG).is_some()
}

/// Names the time since the machine was started; nothing is synced to disk, so stamps do not outlive that.
pub fn boot() -> String {
    fs::read_to_string("/proc/sys/kernel/random/boot_id").map_or(String::new(), |t| t.trim().to_string())
}

/// Reads a file whole: the stamp it had before, and its digest. A file that changes meanwhile is an error.
pub fn hash_input(path: &Path) -> io::Result<(Stamp, Digest)> {
    let stamp = Stamp::of_input(path)?;
    let digest = hash(&mut OpenOptions::new().read(true).open(path)?)?;
    if !Stamp::of_input(path)?.same(&stamp) {
        return Err(io::Error::other("changed while it was read"));
    }
    Ok((stamp, digest))
}

/// The same of a published file; none where there is something else, or where it cannot be read.
pub fn hash_output(path: &Path) -> Option<(Stamp, Digest)> {
    let mut file = OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path).ok()?;
    let stamp = Stamp::of_output(path)?;
    let digest = hash(&mut file).ok()?;
    Stamp::of_output(path)?.same(&stamp).then_some((stamp, digest))
}

fn hash(file: &mut File) -> io::Result<Digest> {
    let mut hash = blake3::Hasher::new();
    let mut piece = vec![0; PIECE];
    loop {
        match file.read(&mut piece) {
            Ok(0) => return Ok(Digest(*hash.finalize().as_bytes())),
            Ok(n) => _ = hash.update(&piece[..n]),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_of_the_file_system_counts() {
        let one = Stamp { device: 1, inode: 2, size: 3, mtime: 4, ctime: 5, taken: 6, fine: false };
        assert!(one.same(&Stamp { taken: 7, fine: true, ..one }));
        for other in [
            Stamp { device: 0, ..one },
            Stamp { inode: 0, ..one },
            Stamp { size: 0, ..one },
            Stamp { mtime: 0, ..one },
            Stamp { ctime: 0, ..one },
        ] {
            assert!(!one.same(&other), "{other:?}");
        }
    }

    #[test]
    fn stamps_do_not_outlive_the_machine() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("cache")).unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "one").unwrap();
        let (stamp, digest) = hash_input(&path).unwrap();
        let stamp = stamp.taken_after(MARGIN_REMOTE);
        for (since, known) in [(boot(), true), ("another time".to_string(), false)] {
            let mut out = Writer::default();
            out.text(&since);
            out.u32(1);
            out.text(path.to_str().unwrap());
            stamp.write(&mut out);
            out.digest(&digest);
            store.put_state("runs", "stamps", &out.sealed(TAG)).unwrap();
            assert_eq!(Stamps::load(&store).known(&path).is_some(), known, "{since}");
        }
    }

    #[test]
    fn what_changes_while_it_is_read_has_no_digest() {
        use std::os::unix::fs::FileExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, vec![0; 1 << 24]).unwrap();
        let file = File::options().write(true).open(&path).unwrap();
        let done = std::sync::atomic::AtomicBool::new(false);
        let told = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    file.write_all_at(b"x", 0).unwrap();
                }
            });
            // The other thread may have to wait for a processor.
            let told = (0..1000).find_map(|_| hash_input(&path).err());
            done.store(true, std::sync::atomic::Ordering::Relaxed);
            told
        });
        assert_eq!(told.unwrap().to_string(), "changed while it was read");
        assert!(hash_input(&path).is_ok());
    }

    #[test]
    fn putting_size_and_mtime_back_shows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "one").unwrap();
        let before = Stamp::of_input(&path).unwrap();
        let mtime = fs::metadata(&path).unwrap().modified().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(20));
        fs::write(&path, "two").unwrap();
        File::options().write(true).open(&path).unwrap().set_modified(mtime).unwrap();
        let after = Stamp::of_input(&path).unwrap();
        assert_eq!(before.mtime, after.mtime);
        assert!(!before.same(&after));
    }

    #[test]
    fn where_the_grain_is_fine_every_write_after_a_look_shows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let grain = grain(&path);
        assert!(!path.exists());
        fs::write(&path, "one").unwrap();
        let old = Stamp::of_input(&path).unwrap().on(grain);
        assert_eq!(old.settled(true), grain.is_some());
        assert!(!old.on(Some(old.device + 1)).settled(false));
        if grain.is_none() {
            return println!("skipped: this file system's clock ticks");
        }
        for i in 0..500 {
            let before = Stamp::of_input(&path).unwrap();
            fs::write(&path, format!("{i:03}")).unwrap();
            File::options().write(true).open(&path).unwrap().set_modified(std::time::UNIX_EPOCH).unwrap();
            assert!(!Stamp::of_input(&path).unwrap().same(&before), "write {i}");
        }
    }

    #[test]
    fn below_a_folder_a_file_has_the_same_stamp() {
        let folder = tempfile::tempdir().unwrap();
        let (a, link) = (folder.path().join("a"), folder.path().join("link"));
        fs::write(&a, "one").unwrap();
        std::os::unix::fs::symlink(&a, &link).unwrap();
        let open = File::open(folder.path()).unwrap();
        let of = |name, follow| Stamp::of_entry(&open, name, follow);
        let by_path = Stamp::of_input(&a).unwrap();
        assert!(by_path.same(&Stamp::of_output(&a).unwrap()));
        assert!([("a", true), ("a", false), ("link", true)].iter().all(|&(n, f)| of(n, f).unwrap().same(&by_path)));
        assert!(of("link", false).is_none() && of("absent", true).is_none() && of(".", true).is_none());
    }

    #[test]
    fn a_young_stamp_is_not_settled() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "one").unwrap();
        let mut stamp = Stamp::of_input(&path).unwrap();
        assert!(!stamp.settled(false));
        stamp.taken += MARGIN;
        assert!(stamp.settled(false) && !stamp.settled(true));
        assert!(is_remote(Path::new("/proc")));
    }
}
