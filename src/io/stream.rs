//! Text of a file, plain or gzipped, block by block: one thread reads and unpacks, the caller parses.

use std::io::{self, Read};
use std::sync::mpsc::{Receiver, sync_channel};

use super::json::{Json, Parsed, Stop};
use crate::diag::{Diagnostic, Result};

const BLOCK: usize = 1 << 18;

/// The part of the text that has arrived and was not parsed yet.
pub struct Stream<'n> {
    name: &'n str,
    blocks: Receiver<io::Result<Vec<u8>>>,
    text: Vec<u8>,
    at: usize,
    ended: bool,
    /// Line at `counted`.
    line: u64,
    counted: usize,
}

/// Runs `work` over the text of `reader`. `name` is for diagnostics. The answer to gzip is in the bytes, not the name.
pub fn stream<T>(name: &str, reader: Box<dyn Read + Send>, work: impl FnOnce(&mut Stream) -> Result<T>) -> Result<T> {
    let (send, blocks) = sync_channel(4);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let mut reader = match unpacked(reader) {
                Ok(reader) => reader,
                Err(e) => return drop(send.send(Err(e))),
            };
            loop {
                let mut block = Vec::with_capacity(BLOCK);
                let got = reader.by_ref().take(BLOCK as u64).read_to_end(&mut block);
                let done = block.is_empty();
                // What came before an error is parsed first: its own mistakes have a line.
                if !done && send.send(Ok(block)).is_err() {
                    return;
                }
                match got {
                    Err(e) => return drop(send.send(Err(e))),
                    Ok(_) if done => return,
                    Ok(_) => {}
                }
            }
        });
        work(&mut Stream { name, blocks, text: Vec::new(), at: 0, ended: false, line: 1, counted: 0 })
    })
}

/// The bytes behind a reader, unpacked where they are gzip (of any number of members).
pub fn unpacked(mut reader: Box<dyn Read + Send>) -> io::Result<Box<dyn Read + Send>> {
    let mut head = Vec::new();
    reader.by_ref().take(2).read_to_end(&mut head)?;
    let gzip = head == [0x1f, 0x8b];
    let whole = io::Cursor::new(head).chain(reader);
    Ok(if gzip { Box::new(flate2::read::MultiGzDecoder::new(whole)) } else { Box::new(whole) })
}

/// The whole text of a file, unpacked, without a byte-order mark.
pub fn whole(name: &str, reader: Box<dyn Read + Send>) -> Result<Vec<u8>> {
    let mut text = at_most(name, reader, u64::MAX)?;
    if text.starts_with(BOM) {
        text.drain(..BOM.len());
    }
    Ok(text)
}

/// The bytes of a file, unpacked; more than that are an error: a few kilobytes of gzip can hold gigabytes.
pub fn at_most(name: &str, reader: Box<dyn Read + Send>, most: u64) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let read = unpacked(reader).and_then(|r| r.take(most.saturating_add(1)).read_to_end(&mut out));
    read.map_err(|e| unreadable(name, &e))?;
    if out.len() as u64 > most {
        return Err(Diagnostic::error("too-large", format!("`{name}` is larger than the {most} bytes that are read")));
    }
    Ok(out)
}

const BOM: &[u8] = b"\xef\xbb\xbf";

fn unreadable(name: &str, e: &io::Error) -> Box<Diagnostic> {
    match e.kind() {
        io::ErrorKind::UnexpectedEof => {
            Diagnostic::error("bad-gzip", format!("`{name}` ends in the middle of its compressed data"))
                .help("the file was cut off; fetch it again")
        }
        io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => {
            Diagnostic::error("bad-gzip", format!("`{name}` holds damaged compressed data: {e}"))
        }
        _ => Diagnostic::error("unreadable-file", format!("cannot read `{name}`: {e}")),
    }
}

impl Stream<'_> {
    /// Calls `parse` on the text; where that ends too early, gets more and calls it again from the same place.
    /// What it took is gone afterwards. After the end of the file `Stop::End` is a mistake in it.
    pub fn parse<T>(&mut self, mut parse: impl FnMut(&mut Json, u64) -> Parsed<T>) -> Result<T> {
        loop {
            let before = self.line_of(self.at);
            let mut json = Json::new(&self.text, self.at);
            match parse(&mut json, before) {
                Ok(value) => {
                    self.at = json.at;
                    return Ok(value);
                }
                // Twice as much each time: a long value is not parsed more than a few times over.
                Err(Stop::End) if !self.ended => {
                    let enough = 2 * (self.text.len() - self.at);
                    while !self.ended && self.text.len() - self.at <= enough {
                        self.more()?;
                    }
                }
                Err(Stop::End) => {
                    let line = self.line_of(self.text.trim_ascii_end().len());
                    return Err(bad_json(self.name, line, "the text ends too early"));
                }
                Err(Stop::Bad { at, what }) => {
                    let line = self.line_of(at.max(self.counted));
                    return Err(bad_json(self.name, line, &what));
                }
                Err(Stop::Fail(d)) => return Err(d),
            }
        }
    }

    /// The next byte that is not white space; none at the end of the file.
    pub fn peek(&mut self) -> Result<Option<u8>> {
        loop {
            let rest = &self.text[self.at..];
            // The record separator of GeoJSON text sequences (RFC 8142) is white space here.
            match rest.iter().position(|b| !matches!(b, b' ' | b'\n' | b'\r' | b'\t' | 0x1e)) {
                Some(n) => {
                    self.at += n;
                    return Ok(Some(self.text[self.at]));
                }
                None => self.at = self.text.len(),
            }
            if self.ended {
                return Ok(None);
            }
            self.more()?;
        }
    }

    fn more(&mut self) -> Result<()> {
        let first = self.counted == 0 && self.text.is_empty();
        let Ok(block) = self.blocks.recv() else {
            self.ended = true;
            return Ok(());
        };
        let block = block.map_err(|e| unreadable(self.name, &e))?;
        self.line_of(self.at);
        self.text.drain(..self.at);
        (self.at, self.counted) = (0, 0);
        self.text.extend_from_slice(if first { block.strip_prefix(BOM).unwrap_or(&block) } else { &block });
        Ok(())
    }

    /// Line of a place at or after the last one asked for.
    fn line_of(&mut self, at: usize) -> u64 {
        let new = &self.text[self.counted..at.max(self.counted)];
        // In pieces that a byte can count: sixteen or more at a time.
        let breaks = |piece: &[u8]| u64::from(piece.iter().map(|&b| u8::from(b == b'\n')).sum::<u8>());
        self.line += new.chunks(255).map(breaks).sum::<u64>();
        self.counted = at.max(self.counted);
        self.line
    }
}

pub fn bad_json(name: &str, line: u64, what: &str) -> Box<Diagnostic> {
    Diagnostic::error("bad-json", format!("{name}:{line}: broken JSON: {what}"))
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn lists(bytes: Vec<u8>) -> Result<Vec<(u64, f64)>> {
        stream("a.json", Box::new(io::Cursor::new(bytes)), |s| {
            let mut out = Vec::new();
            while s.peek()?.is_some() {
                s.parse(|json, line| {
                    let mut sum = 0.0;
                    json.list(|json| Ok(sum += json.number()?))?;
                    out.push((line, sum));
                    Ok(())
                })?;
            }
            Ok(out)
        })
    }

    #[test]
    fn values_over_block_borders() {
        let list = format!("[{}]\n", vec!["1"; 100_000].join(","));
        let text = format!("\u{feff}[1,\n2]\n{list}{list}[3]");
        let expected = [(1, 3.0), (3, 100_000.0), (4, 100_000.0), (5, 3.0)];
        assert_eq!(lists(text.clone().into_bytes()).unwrap(), expected);
        let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gz.write_all(text.trim_start_matches('\u{feff}').as_bytes()).unwrap();
        let gz = gz.finish().unwrap();
        assert_eq!(lists(gz.clone()).unwrap(), expected);
        assert_eq!(lists([gz.clone(), gz.clone()].concat()).unwrap().len(), 8);
        for cut in [2, 9, 20, gz.len() / 2, gz.len() - 1] {
            let e = lists(gz[..cut].to_vec()).unwrap_err();
            assert!(e.message.contains("a.json"), "{cut}: {e}");
            assert_eq!(e.code, "bad-gzip", "{cut}: {e}");
        }
        assert_eq!(lists(b"\x1f\x8b garbage".to_vec()).unwrap_err().code, "bad-gzip");
    }

    #[test]
    fn mistakes_have_a_line() {
        let e = lists(b"[1]\n[2,\n\n x]\n".to_vec()).unwrap_err();
        assert_eq!(e.to_string(), "a.json:4: broken JSON: expected a number");
        let e = lists(b"[1]\n[2,\n\n".to_vec()).unwrap_err();
        assert_eq!(e.to_string(), "a.json:2: broken JSON: the text ends too early");
        assert_eq!(lists(Vec::new()).unwrap(), []);
    }
}
