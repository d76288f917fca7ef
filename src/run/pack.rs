//! Results, and objects that are not large, in one append-only file per run: creating and renaming a file costs 60
//! microseconds on a good day, two milliseconds where many files were just deleted; appending under one.
//!
//! A frame: magic, kind, length, name (key or digest), a check of these, the body. A body is checked by whoever reads
//! it: an object by its digest, a record by its own checksum. What is torn or damaged is passed over: the next good
//! frame is found by its magic and check.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

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

/// What a scan of a file found.
#[derive(Debug, Default)]
pub struct Scan {
    pub frames: Vec<Frame>,
    /// Where the last whole frame ends: the next scan goes on here.
    pub end: u64,
    /// Bytes before `end` that belong to no frame.
    pub lost: u64,
}

/// Finds the frames from `start` to the file's end. Bodies are passed over, so that a pack of gigabytes is listed in
/// milliseconds.
pub fn scan(file: &File, start: u64) -> io::Result<Scan> {
    let size = file.metadata()?.len();
    let mut out = Scan { end: start, ..Scan::default() };
    let mut window = Window::default();
    let mut at = start;
    while at + HEAD as u64 <= size {
        let bytes = window.at(file, at)?;
        if bytes.len() < HEAD {
            break; // shorter by now
        }
        match read_head(bytes) {
            Some((what, name, len)) if at + HEAD as u64 + u64::from(len) <= size => {
                out.lost += at - out.end;
                out.frames.push(Frame { what, name, at: at + HEAD as u64, len });
                at += HEAD as u64 + u64::from(len);
                out.end = at;
            }
            // Damaged, or still being written.
            _ => at += 1 + next_magic(&bytes[1..]) as u64,
        }
    }
    Ok(out)
}

/// A part of a file: little after a jump, more and more where one frame follows the other.
#[derive(Default)]
struct Window {
    bytes: Vec<u8>,
    from: u64,
    step: usize,
}

impl Window {
    /// Some bytes from `at` on: a head at least, but at the file's end.
    fn at(&mut self, file: &File, at: u64) -> io::Result<&[u8]> {
        let end = self.from + self.bytes.len() as u64;
        if at < self.from || at + HEAD as u64 > end {
            let follows = at >= self.from && at <= end;
            self.step = if follows { (self.step * 4).min(1 << 18) } else { 1 << 12 };
            self.from = at;
            self.bytes.resize(self.step.max(1 << 12), 0);
            let mut n = 0;
            while n < self.bytes.len() {
                match file.read_at(&mut self.bytes[n..], at + n as u64) {
                    Ok(0) => break,
                    Ok(more) => n += more,
                    Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                    Err(e) => return Err(e),
                }
            }
            self.bytes.truncate(n);
        }
        Ok(&self.bytes[(at - self.from) as usize..])
    }
}

fn head(what: What, name: &Digest, len: u32) -> Vec<u8> {
    let mut out = Vec::with_capacity(HEAD);
    out.extend(MAGIC);
    out.extend([what as u8, 0, 0, 0]);
    out.extend(len.to_le_bytes());
    out.extend(name.0);
    let check = Digest::of(&out);
    out.extend(&check.0[..8]);
    out
}

fn read_head(bytes: &[u8]) -> Option<(What, Digest, u32)> {
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

/// Where the next magic is, or may start.
fn next_magic(bytes: &[u8]) -> usize {
    bytes.windows(4).position(|w| w == MAGIC).unwrap_or(bytes.len().saturating_sub(3))
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

    /// Appends a body that is given in pieces. After a failure (full disk) the file is as it was before.
    pub fn append(&mut self, what: What, name: &Digest, body: &[impl AsRef<[u8]>]) -> io::Result<Frame> {
        let len = body.iter().map(|p| p.as_ref().len()).sum::<usize>();
        let frame = Frame { what, name: *name, at: self.end + HEAD as u64, len: len as u32 };
        if let Err(error) = self.write(head(what, name, frame.len), body) {
            let _ = self.file.set_len(self.end);
            return Err(error);
        }
        self.end = frame.at + len as u64;
        Ok(frame)
    }

    /// What is small goes in one write.
    fn write(&self, mut bytes: Vec<u8>, body: &[impl AsRef<[u8]>]) -> io::Result<()> {
        let mut at = self.end;
        for piece in body.iter().map(AsRef::as_ref) {
            if bytes.len() + piece.len() <= 1 << 14 {
                bytes.extend_from_slice(piece);
                continue;
            }
            self.file.write_all_at(&bytes, at)?;
            at += bytes.len() as u64;
            bytes.clear();
            self.file.write_all_at(piece, at)?;
            at += piece.len() as u64;
        }
        self.file.write_all_at(&bytes, at)
    }
}

/// A new pack at `path` with some frames of another, on the disk when this returns.
pub fn rewrite(path: &Path, from: &File, frames: &[Frame]) -> io::Result<()> {
    let mut pack = Appender::new(File::create_new(path)?);
    frames.iter().try_for_each(|frame| pack.append(frame.what, &frame.name, &[read(from, frame)?]).map(drop))?;
    pack.file.sync_data()
}

/// The run whose pack this is, by its name.
pub fn id_of(path: &Path) -> Option<u64> {
    let name = path.file_name()?.to_str()?.strip_suffix(".pack")?;
    u64::from_str_radix(name, 16).ok().filter(|_| name.len() == 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file_of(bytes: &[u8]) -> File {
        let file = tempfile::tempfile().unwrap();
        file.write_all_at(bytes, 0).unwrap();
        file
    }

    /// A pack's bytes, and where its frames end.
    fn packed(bodies: &[Vec<u8>]) -> (Vec<u8>, Vec<usize>) {
        let mut pack = Appender::new(tempfile::tempfile().unwrap());
        let mut ends = vec![0];
        for body in bodies {
            // Any pieces make one body.
            let (a, b) = body.split_at(body.len() / 3);
            let frame = pack.append(What::Object, &Digest::of(body), &[a, b]).unwrap();
            ends.push(frame.at as usize + body.len());
        }
        let mut bytes = vec![0; *ends.last().unwrap()];
        pack.file.read_exact_at(&mut bytes, 0).unwrap();
        (bytes, ends)
    }

    #[test]
    fn a_damaged_frame_costs_only_itself() {
        let bodies: Vec<Vec<u8>> = (0..5u8).map(|i| vec![i; 10 * i as usize]).collect();
        let (bytes, ends) = packed(&bodies);
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
        let a = pack.append(What::Object, &Digest::of(b"a"), &[b"a"]).unwrap();
        let first = scan(&pack.file, 0).unwrap();
        assert_eq!(first.frames, [a]);
        let b = pack.append(What::Result, &Digest::of(b"b"), &[b"bb"]).unwrap();
        assert_eq!(scan(&pack.file, first.end).unwrap().frames, [b]);
        assert_eq!(read(&pack.file, &b).unwrap(), b"bb");
    }

    #[test]
    fn large_bodies_are_passed_over_and_damage_among_them_is_found() {
        let bodies: Vec<Vec<u8>> =
            (0..60usize).map(|i| vec![i as u8; [0, 100, 5_000, 70_000, 300_000][i % 5]]).collect();
        let (bytes, ends) = packed(&bodies);
        let whole = scan(&file_of(&bytes), 0).unwrap();
        assert_eq!((whole.frames.len(), whole.end, whole.lost), (60, bytes.len() as u64, 0));
        for broken in 0..60 {
            let mut bad = bytes.clone();
            bad[ends[broken] + 20] ^= 1; // in its head
            let found = scan(&file_of(&bad), 0).unwrap();
            let names: Vec<Digest> = found.frames.iter().map(|f| f.name).collect();
            let right = bodies.iter().enumerate().filter(|&(i, _)| i != broken).map(|(_, b)| Digest::of(b));
            assert_eq!(names, right.collect::<Vec<_>>(), "frame {broken}");
            let last = broken == 59;
            assert_eq!(found.lost, if last { 0 } else { (ends[broken + 1] - ends[broken]) as u64 });
        }
    }
}
