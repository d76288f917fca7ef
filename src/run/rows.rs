//! The files that a plan depends on, folder by folder: each with the stamp and digest that it had. Asked for below an open
//! folder, a stamp costs half of what it does by its whole path.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use nix::libc;

use super::codec::{Reader, Writer};
use super::stamp::{self, Stamp};
use crate::digest::Digest;
use crate::graph::bare;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// A link's target counts.
    Input = 0,
    /// A published file: a link is a change.
    Output = 1,
    /// The text of a pipeline, as an input; its digest is that of [`bare`] text.
    Text = 2,
}

impl Role {
    fn of(number: u8) -> Option<Self> {
        [Self::Input, Self::Output, Self::Text].into_iter().find(|&r| r as u8 == number)
    }

    /// The stamp of a file, and the digest of what counts in it.
    fn read(self, path: &Path) -> Option<(Stamp, Digest)> {
        match self {
            Self::Input => stamp::hash_input(path).ok(),
            Self::Output => stamp::hash_output(path),
            Self::Text => {
                let before = Stamp::of_input(path).ok().filter(|s| s.size <= LARGEST_TEXT)?;
                let text = std::fs::read_to_string(path).ok()?;
                let same = Stamp::of_input(path).is_ok_and(|s| s.same(&before));
                same.then_some((before, of_text(&text)?))
            }
        }
    }
}

/// Larger ones are parsed again after every change.
const LARGEST_TEXT: u64 = 1 << 24;

/// What a row of [`Role::Text`] has for its digest.
pub fn of_text(text: &str) -> Option<Digest> {
    Some(Digest::of(bare(text)?.as_bytes()))
}

pub struct Row {
    pub role: Role,
    pub remote: bool,
    pub path: PathBuf,
    pub stamp: Stamp,
    pub digest: Digest,
}

impl Row {
    fn folder(&self) -> (&Path, Role, bool) {
        (self.path.parent().unwrap_or(Path::new("/")), self.role, self.remote)
    }
}

/// The rows as bytes; none where a path is not UTF-8.
pub fn write(mut rows: Vec<Row>, out: &mut Writer) -> Option<()> {
    // By the bytes of the paths: comparing them part by part is slow.
    let key = |row: &Row| (row.folder().0.as_os_str().to_owned(), row.role, row.path.as_os_str().to_owned());
    rows.sort_by_cached_key(key);
    rows.dedup_by(|a, b| {
        (a.role, a.remote, &a.path, a.digest) == (b.role, b.remote, &b.path, b.digest) && a.stamp.same(&b.stamp)
    });
    let groups: Vec<&[Row]> = rows.chunk_by(|a, b| a.folder() == b.folder()).collect();
    out.u32(groups.len() as u32);
    for group in groups {
        let (folder, role, remote) = group[0].folder();
        out.text(folder.to_str()?);
        out.0.extend([role as u8, remote.into()]);
        out.u32(group.len() as u32);
        for row in group {
            out.text(row.path.file_name()?.to_str()?);
            row.stamp.write(out);
            out.digest(&row.digest);
        }
    }
    Some(())
}

/// A stamp of rows that [`unchanged`] had to bring up to date.
pub struct Fresh {
    /// Bytes of the reader that were left behind the old one's start.
    pub left: usize,
    pub stamp: Stamp,
}

/// Looks at every file. None where one is not as it was; else the new stamps of those that were read to be certain.
pub fn unchanged(from: &mut Reader) -> Option<Vec<Fresh>> {
    let mut fresh = Vec::new();
    for _ in 0..from.u32()? {
        let path = Path::new(from.text()?);
        let role = Role::of(from.u8()?)?;
        let remote = from.u8()? != 0;
        let folder = open_folder(path)?;
        for _ in 0..from.u32()? {
            let name = from.text()?;
            let left = from.left();
            let (stamp, digest) = (Stamp::read(from)?, from.digest()?);
            let now = Stamp::of_entry(&folder, name, role != Role::Output)?;
            if !now.same(&stamp) || !stamp.settled(remote) {
                // Perhaps only touched, or a comment is another.
                let path = path.join(name);
                let (stamp, found) = role.read(&path)?;
                if found != digest {
                    return None;
                }
                fresh.push(Fresh { left, stamp });
            }
        }
    }
    Some(fresh)
}

/// A place to ask below, no more.
fn open_folder(path: &Path) -> Option<File> {
    OpenOptions::new().read(true).custom_flags(libc::O_PATH | libc::O_DIRECTORY).open(path).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_row_a_file_and_every_change_shows() {
        let home = tempfile::tempdir().unwrap();
        let at = |name: &str| home.path().join(name);
        std::fs::create_dir(at("sub")).unwrap();
        // Of the stamps.
        let age = std::cell::Cell::new(0);
        let row = |name: &str, role| {
            let (stamp, digest) = stamp::hash_input(&at(name)).unwrap();
            Row { role, remote: false, path: at(name), stamp: stamp.taken_after(age.get()), digest }
        };
        let names = ["b", "sub/a", "a"];
        let all = || {
            names.iter().for_each(|n| std::fs::write(at(n), n).unwrap());
            let roles = [Role::Input, Role::Output, Role::Input];
            let mut out = Writer::default();
            write(
                roles.iter().flat_map(|&r| names.iter().map(move |n| (n, r))).map(|(n, r)| row(n, r)).collect(),
                &mut out,
            )
            .unwrap();
            out.0
        };
        let bytes = all();
        let each = 4 + 49 + 32;
        assert!(bytes.len() < 7 * each + 4 * (home.path().as_os_str().len() + 20), "a file has one row for each role");
        let look = |bytes: &[u8]| unchanged(&mut Reader::new(bytes)).map(|f| f.len());
        // What may have changed in the same tick is read, each name in both roles; what is older is not.
        assert_eq!(look(&bytes), Some(2 * names.len()));
        age.set(1_000_000_000);
        let bytes = all();
        assert_eq!(look(&bytes), Some(0));
        for name in names {
            std::fs::write(at(name), "x").unwrap();
            assert_eq!(look(&bytes), None, "{name}");
            all();
            // Touched.
            assert!(look(&bytes).is_some_and(|read| read >= 2), "{name}");
            std::fs::remove_file(at(name)).unwrap();
            assert_eq!(look(&bytes), None, "{name}");
            std::os::unix::fs::symlink(at("aside"), at(name)).unwrap();
            std::fs::write(at("aside"), name).unwrap();
            assert_eq!(look(&bytes), None, "{name}: as an output a link is a change");
            std::fs::remove_file(at(name)).unwrap();
        }
        assert!((0..bytes.len()).all(|n| look(&bytes[..n]).is_none()));
    }

    #[test]
    fn of_a_text_comments_do_not_count() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("p.toml");
        std::fs::write(&path, "a = \"# 1\" # x\n").unwrap();
        let (stamp, digest) = Role::Text.read(&path).unwrap();
        let mut out = Writer::default();
        write(vec![Row { role: Role::Text, remote: false, path: path.clone(), stamp, digest }], &mut out).unwrap();
        for (text, fine) in [
            ("# y\n\n  a = \"# 1\"\t\r\n", true),
            ("a = \"# 2\" # x\n", false),
            ("a = \"# 1\" # \u{1}\n", false),
            ("a = \"# 1\" x\n", false),
        ] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(unchanged(&mut Reader::new(&out.0)).is_some_and(|f| f.len() == 1), fine, "{text}");
        }
        std::fs::write(&path, b"a = \"# 1\" # \xff\n").unwrap();
        assert!(unchanged(&mut Reader::new(&out.0)).is_none());
    }
}
