//! A pipeline file's bytes to a table: what is no regular file, no UTF-8 or no TOML, and the parser's sentences in our words.

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use toml::de::DeTable;

use super::Table;
use super::value::Reader;
use crate::diag::{Diagnostic, Diagnostics, SourceFile, Span};

/// A pipeline file is written by hand, or by a program that is not mad.
const MOST_BYTES: u64 = 64 << 20;

/// The bytes of a pipeline file: a pipe or a device would never end.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let meta = path.metadata()?;
    if !meta.is_file() && !meta.is_dir() {
        return Err(io::Error::other("it is no regular file"));
    }
    if meta.len() > MOST_BYTES {
        return Err(io::Error::other(format!("it is larger than {} MiB", MOST_BYTES >> 20)));
    }
    std::fs::read(path)
}

/// UTF-16 with its byte-order mark, as some editors still write it.
pub fn wide_text(bytes: &[u8]) -> Option<String> {
    let (mark, rest) = bytes.split_first_chunk()?;
    let unit: fn([u8; 2]) -> u16 = match mark {
        [0xff, 0xfe] => u16::from_le_bytes,
        [0xfe, 0xff] => u16::from_be_bytes,
        _ => return None,
    };
    Some(String::from_utf16_lossy(&rest.as_chunks().0.iter().map(|&two| unit(two)).collect::<Vec<_>>()))
}

/// Data that was named where a pipeline file belongs: one sentence, not a mistake in every line.
pub fn other_format(text: &str, path: &Path) -> Option<&'static str> {
    let first = text.trim_start().bytes().next();
    let toml = path.extension().is_some_and(|e| e == "toml");
    match first {
        Some(b'{') if !toml => Some("JSON"),
        Some(b'<') if !toml => Some("XML"),
        _ => None,
    }
}

/// With syntax errors only those, the first of each line.
pub fn parse(file: &Arc<SourceFile>, wrong: &mut Diagnostics) -> Option<Table> {
    let (table, errors) = DeTable::parse_recoverable(&file.text);
    if errors.is_empty() {
        return Some(Reader::new(file, 0, wrong).table(table.get_ref()));
    }
    let place = |e: &toml::de::Error| e.span().unwrap_or_else(|| deep_key(&file.text));
    let mut found: Vec<_> = errors.iter().map(|e| (place(e), e.message())).collect();
    found.sort_by_key(|(range, _)| range.start);
    let mut line_end = None;
    for (range, message) in found {
        // The first of each line.
        let start = range.start.min(file.text.len());
        if line_end.is_some_and(|end| start <= end) {
            continue;
        }
        line_end =
            Some(file.text.as_bytes()[start..].iter().position(|&b| b == b'\n').map_or(usize::MAX, |n| start + n));
        let message = match message {
            m if m.contains("recursion limit") || m.contains("recurse further") => TOO_DEEP.to_string(),
            m => odd_character(&file.text[start..]).unwrap_or_else(|| in_our_words(m)),
        };
        wrong.push(Diagnostic::error("syntax", message).at(Span { file: file.clone(), range }));
    }
    None
}

/// Of the parser's sentences those that lead astray.
fn in_our_words(message: &str) -> String {
    let message = message.lines().collect::<Vec<_>>().join(", ");
    match message.split(", expected").next().unwrap_or_default() {
        "string values must be quoted" => "a text must stand in quotes".into(),
        "unexpected key or value" => "nothing more may follow on this line but a comment".into(),
        _ => message,
    }
}

/// What editors and web pages put into a text, and nobody sees.
fn odd_character(text: &str) -> Option<String> {
    let c = text.chars().next()?;
    let what = match c {
        '\u{feff}' => "a byte-order mark",
        '\u{201c}' | '\u{201d}' | '\u{2018}' | '\u{2019}' | '\u{201e}' | '\u{ab}' | '\u{bb}' => {
            "a quotation mark of prose"
        }
        _ if c.is_control() && !c.is_whitespace() => "a control character",
        _ if c.is_whitespace() && !c.is_ascii() => "an odd space",
        _ => return None,
    };
    Some(format!("{what} (U+{:04X}) does not belong here", u32::from(c)))
}

pub const TOO_DEEP: &str = "tables and lists are nested too deep";

/// The parser does not say which key has too many parts: the line with most dots.
fn deep_key(text: &str) -> Range<usize> {
    let mut at = 0;
    let lines = text.split_inclusive('\n').map(|line| {
        at += line.len();
        (line.bytes().filter(|&b| b == b'.').count(), at - line.len()..at - line.len() + line.trim_end().len())
    });
    lines.fold((0, 0..0), |most, line| if line.0 > most.0 { line } else { most }).1
}
