//! Small things in one append-only file per run: creating and renaming a file costs 30 to 800 microseconds, appending
//! under one.
//!
//! A frame: magic, kind, length, name (key or digest), a check of these, the body. A body is checked by whoever reads
//! it: an object by its digest, a record by its own checksum. What is torn or damaged is passed over: the next good
//! frame is found by its magic and check.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

use crate::digest::Digest;

const MAGIC: [u8; 4] = *b"LDG\x01";
pub const HEAD: usize = 4 + 4 + 4 + 32 + 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    Object = 1,
    Result = 2,
}

/// Where a body lies in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    pub what: What,
    pub name: Digest,
    pub at: u64,
    pub len: u32,
}

pub fn frame(what: What, name: &Digest, body: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(HEAD + body.len());
    out.extend(MAGIC);
    out.extend([what as u8, 0, 0, 0]);
    out.extend((body.len() as u32).to_le_bytes());
    out.extend(name.0);
    let check = Digest::of(&out);
    out.extend(&check.0[..8]);
    out.extend(body);
    out
}

/// What a scan of a file found.
#[derive(Debug, Default)]
pub struct Scan {
    pub frames: Vec<Frame>,
    /// Where the last whole frame ends: the next scan goes on here.
    pub end: u64,
    /// Bytes before `end` that belong to no frame.
    pub lost: u64,
}

/// Reads the frames from `start` to the file's end.
pub fn scan(file: &File, start: u64) -> io::Result<Scan> {
    let size = file.metadata()?.len();
    let mut out = Scan { end: start, ..Scan::default() };
    if size <= start {
        return Ok(out);
    }
    let mut bytes = vec![0; (size - start) as usize];
    file.read_exact_at(&mut bytes, start)?;
    let mut at = 0;
    while let Some(rest) = bytes.get(at..).filter(|r| r.len() >= HEAD) {
        match head(rest) {
            Some((what, name, len)) if rest.len() >= HEAD + len as usize => {
                out.lost += start + at as u64 - out.end;
                out.frames.push(Frame { what, name, at: start + (at + HEAD) as u64, len });
                at += HEAD + len as usize;
                out.end = start + at as u64;
            }
            // Damaged, or still being written.
            _ => at += 1 + next_magic(&rest[1..]),
        }
    }
    Ok(out)
}

fn head(bytes: &[u8]) -> Option<(What, Digest, u32)> {
    if bytes[..4] != MAGIC || Digest::of(&bytes[..HEAD - 8]).0[..8] != bytes[HEAD - 8..HEAD] {
        return None;
    }
    let what = match bytes[4] {
        1 => What::Object,
        2 => What::Result,
        _ => return None,
    };
    Some((what, Digest(bytes[12..44].try_into().ok()?), u32::from_le_bytes(bytes[8..12].try_into().ok()?)))
}

fn next_magic(bytes: &[u8]) -> usize {
    bytes.windows(4).position(|w| w == MAGIC).unwrap_or(bytes.len())
}

/// The body of a frame, unchecked.
pub fn read(file: &File, frame: &Frame) -> io::Result<Vec<u8>> {
    let mut out = vec![0; frame.len as usize];
    file.read_exact_at(&mut out, frame.at)?;
    Ok(out)
}

/// A file that only this process appends to.
pub struct Appender {
    pub file: File,
    end: u64,
}

impl Appender {
    /// Over an empty file.
    pub fn new(file: File) -> Self {
        Self { file, end: 0 }
    }

    /// Appends in one write. After a failure (full disk) the file is as it was before.
    pub fn append(&mut self, what: What, name: &Digest, body: &[u8]) -> io::Result<Frame> {
        let bytes = frame(what, name, body);
        if let Err(error) = self.file.write_all_at(&bytes, self.end) {
            let _ = self.file.set_len(self.end);
            return Err(error);
        }
        let frame = Frame { what, name: *name, at: self.end + HEAD as u64, len: body.len() as u32 };
        self.end += bytes.len() as u64;
        Ok(frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file_of(bytes: &[u8]) -> File {
        let file = tempfile::tempfile().unwrap();
        file.write_all_at(bytes, 0).unwrap();
        file
    }

    #[test]
    fn a_damaged_frame_costs_only_itself() {
        let bodies: Vec<Vec<u8>> = (0..5u8).map(|i| vec![i; 10 * i as usize]).collect();
        let mut bytes = Vec::new();
        let mut ends = vec![0];
        for body in &bodies {
            bytes.extend(frame(What::Object, &Digest::of(body), body));
            ends.push(bytes.len());
        }
        let whole = scan(&file_of(&bytes), 0).unwrap();
        assert_eq!((whole.frames.len(), whole.end, whole.lost), (5, bytes.len() as u64, 0));
        for i in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[i] ^= 0x40;
            let file = file_of(&bad);
            let good = scan(&file, 0)
                .unwrap()
                .frames
                .iter()
                .filter(|f| Digest::of(&read(&file, f).unwrap()) == f.name)
                .count();
            assert_eq!(good, 4, "byte {i}");
        }
        for cut in 0..bytes.len() {
            let found = scan(&file_of(&bytes[..cut]), 0).unwrap();
            assert_eq!(found.frames.len(), ends.iter().filter(|&&e| e > 0 && e <= cut).count());
            assert_eq!(found.end as usize, *ends.iter().rfind(|&&e| e <= cut).unwrap());
        }
    }

    #[test]
    fn appended_frames_are_found_from_where_the_last_scan_ended() {
        let mut pack = Appender::new(tempfile::tempfile().unwrap());
        let a = pack.append(What::Object, &Digest::of(b"a"), b"a").unwrap();
        let first = scan(&pack.file, 0).unwrap();
        assert_eq!(first.frames, [a]);
        let b = pack.append(What::Result, &Digest::of(b"b"), b"bb").unwrap();
        assert_eq!(scan(&pack.file, first.end).unwrap().frames, [b]);
        assert_eq!(read(&pack.file, &b).unwrap(), b"bb");
    }
}
