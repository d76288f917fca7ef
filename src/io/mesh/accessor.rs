//! Numbers out of glTF's buffers: every bound is looked at before anything is taken.

use std::borrow::Cow;
use std::cell::{Cell, OnceCell};

use serde::Deserialize;
use serde_json::Value;

use super::meshopt::{self, MOST_UNPACKED, Stream};
use super::{Files, MOST};
use crate::diag::{Diagnostic, Result};

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub struct Accessor {
    buffer_view: Option<usize>,
    byte_offset: u64,
    component_type: u32,
    normalized: bool,
    pub count: u64,
    r#type: String,
    sparse: Option<Sparse>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Sparse {
    count: u64,
    indices: Part,
    values: Part,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Part {
    buffer_view: usize,
    #[serde(default)]
    byte_offset: u64,
    #[serde(default)]
    component_type: u32,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub struct View {
    buffer: usize,
    byte_offset: u64,
    byte_length: u64,
    byte_stride: Option<u64>,
    extensions: Value,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub struct Buffer {
    pub uri: Option<String>,
    byte_length: u64,
}

impl Accessor {
    pub fn has_view(&self) -> bool {
        self.buffer_view.is_some()
    }
}

/// Buffers with what lies in them.
pub struct Data<'a> {
    pub files: &'a Files<'a>,
    pub accessors: &'a [Accessor],
    pub views: &'a [View],
    pub buffers: &'a [Buffer],
    /// The binary chunk of a GLB.
    pub chunk: Option<&'a [u8]>,
    /// Buffers that were asked for, or why they cannot be had.
    pub read: Vec<OnceCell<Result<Cow<'a, [u8]>>>>,
    /// Buffer views that were packed and asked for.
    pub unpacked: Vec<OnceCell<Vec<u8>>>,
    /// Their bytes together.
    pub unpacked_bytes: Cell<u64>,
    /// Numbers that were made for the sake of few of them.
    pub wasted: Cell<u64>,
}

/// More are not made: parts may share a sparse accessor without end.
const MOST_WASTE: u64 = 1 << 28;

impl<'a> Data<'a> {
    fn wrong(&self, what: impl std::fmt::Display) -> Box<Diagnostic> {
        self.files.broken(what)
    }

    fn buffer(&self, i: usize) -> Result<&[u8]> {
        let (Some(buffer), Some(cell)) = (self.buffers.get(i), self.read.get(i)) else {
            return Err(self.wrong(format!("there is no buffer {i}")));
        };
        cell.get_or_init(|| self.fetched(i, buffer)).as_deref().map_err(Clone::clone)
    }

    fn fetched(&self, i: usize, buffer: &Buffer) -> Result<Cow<'a, [u8]>> {
        let bytes: Cow<[u8]> = match (&buffer.uri, self.chunk) {
            (Some(uri), _) => Cow::Owned(fetch(self.files, uri)?),
            (None, Some(chunk)) if i == 0 => Cow::Borrowed(chunk),
            (None, _) => return Err(self.wrong(format!("buffer {i} has no data"))),
        };
        if (bytes.len() as u64) < buffer.byte_length {
            let what = format!("buffer {i} ends early: {} bytes of {}", bytes.len(), buffer.byte_length);
            return Err(self.wrong(what).help("the file was cut off; fetch it again"));
        }
        Ok(bytes)
    }

    /// Bytes of a buffer view.
    pub fn view(&self, i: usize) -> Result<&[u8]> {
        let view = self.views.get(i).ok_or_else(|| self.wrong(format!("there is no buffer view {i}")))?;
        let Some((name, said)) = meshopt::packed(&view.extensions) else { return self.plain(i, view) };
        if let Some(bytes) = self.unpacked[i].get() {
            return Ok(bytes);
        }
        // A plain copy is taken where there is one: what filters pack is rounded.
        if let Ok(bytes) = self.plain(i, view) {
            return Ok(bytes);
        }
        let wrong = |what: String| self.wrong(format!("buffer view {i}: {name}: {what}"));
        let stream = Stream::new(name, said, view.byte_length, view.byte_stride).map_err(wrong)?;
        let all = self.unpacked_bytes.get().saturating_add(view.byte_length);
        if all > MOST_UNPACKED {
            return Err(wrong(format!("with it more than the {MOST_UNPACKED} bytes that are unpacked of a file")));
        }
        let packed = self.buffer(stream.buffer)?;
        let end = stream.byte_offset.checked_add(stream.byte_length).filter(|&e| e <= packed.len() as u64);
        let end = end.ok_or_else(|| wrong(format!("it goes beyond buffer {}", stream.buffer)))?;
        let bytes = stream.unpack(&packed[stream.byte_offset as usize..end as usize]);
        let bytes = bytes.map_err(|what| wrong(what).help("the file was damaged, or its writer has a bug"))?;
        self.unpacked_bytes.set(all);
        Ok(self.unpacked[i].get_or_init(|| bytes))
    }

    fn plain(&self, i: usize, view: &View) -> Result<&[u8]> {
        let bytes = self.buffer(view.buffer)?;
        let end = view.byte_offset.checked_add(view.byte_length).filter(|&e| e <= bytes.len() as u64);
        let end = end.ok_or_else(|| self.wrong(format!("buffer view {i} goes beyond its buffer")))?;
        Ok(&bytes[view.byte_offset as usize..end as usize])
    }

    /// Elements of an accessor.
    pub fn count(&self, i: usize) -> Result<u64> {
        Ok(self.accessors.get(i).ok_or_else(|| self.wrong(format!("there is no accessor {i}")))?.count)
    }

    /// Numbers of an accessor, and how many each element has; only of these elements, which must be ones, in their order.
    pub fn values(&self, i: usize, only: Option<&[u32]>) -> Result<(usize, Vec<f64>)> {
        let a = self.accessors.get(i).ok_or_else(|| self.wrong(format!("there is no accessor {i}")))?;
        let width = match &*a.r#type {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" | "MAT2" => 4,
            "MAT3" => 9,
            "MAT4" => 16,
            other => return Err(self.wrong(format!("accessor {i}: `{}` is no type", other.escape_debug()))),
        };
        if a.count > MOST {
            return Err(
                self.wrong(format!("accessor {i}: {} elements are more than the {MOST} that are read", a.count))
            );
        }
        let n = a.count as usize;
        let whole = only.is_none() || a.sparse.is_some();
        let taken = if whole { n } else { only.map_or(n, <[u32]>::len) };
        if only.is_some() && whole {
            self.wasted.set(self.wasted.get() + (taken * width) as u64);
            if self.wasted.get() > MOST_WASTE {
                return Err(self.wrong(format!("accessor {i}: too many parts share sparse numbers as long as these")));
            }
        }
        let mut out = match a.buffer_view {
            Some(view) => {
                let stride = self.views.get(view).and_then(|v| v.byte_stride);
                let kind = (a.component_type, a.normalized, width);
                self.numbers(i, view, a.byte_offset, stride, n, kind, only.filter(|_| !whole))?
            }
            // Zeros; there is no reason for many.
            None if n * width > 1 << 22 => return Err(self.wrong(format!("accessor {i}: {n} elements without data"))),
            None => vec![0.0; taken * width],
        };
        if let Some(s) = &a.sparse {
            if s.count > a.count {
                return Err(self.wrong(format!("accessor {i}: more sparse values than elements")));
            }
            let (count, at, of) = (s.count as usize, &s.indices, &s.values);
            let kind = (at.component_type, false, 1);
            let places = self.numbers(i, at.buffer_view, at.byte_offset, None, count, kind, None)?;
            let kind = (a.component_type, a.normalized, width);
            let values = self.numbers(i, of.buffer_view, of.byte_offset, None, count, kind, None)?;
            for (place, value) in places.iter().zip(values.chunks_exact(width)) {
                let place = *place as usize;
                if place >= n {
                    return Err(self.wrong(format!("accessor {i}: sparse index {place} of {n} elements")));
                }
                out[place * width..][..width].copy_from_slice(value);
            }
        }
        if let Some(only) = only.filter(|_| whole) {
            out = only.iter().flat_map(|&e| out[e as usize * width..][..width].iter().copied()).collect();
        }
        Ok((width, out))
    }

    #[allow(clippy::too_many_arguments, reason = "the parts of an accessor")]
    fn numbers(
        &self,
        i: usize,
        view: usize,
        offset: u64,
        stride: Option<u64>,
        n: usize,
        (kind, normalized, width): (u32, bool, usize),
        only: Option<&[u32]>,
    ) -> Result<Vec<f64>> {
        let (size, most) = match kind {
            5120 => (1, 127.0),
            5121 => (1, 255.0),
            5122 => (2, 32767.0),
            5123 => (2, 65535.0),
            5125 => (4, 4_294_967_295.0),
            5126 => (4, 1.0),
            other => return Err(self.wrong(format!("accessor {i}: {other} is no component type"))),
        };
        // Columns of matrices begin at multiples of four bytes.
        let rows = match width {
            9 => 3,
            16 => 4,
            _ => width,
        };
        let column = if rows < width { (rows * size).next_multiple_of(4) } else { rows * size };
        let element = column * width / rows;
        let stride = stride.unwrap_or(element as u64);
        let bytes = self.view(view)?;
        let end = (n as u64)
            .checked_sub(1)
            .map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(element as u64)?.checked_add(offset));
        if stride < element as u64 || end.is_none_or(|e| e > bytes.len() as u64) {
            let what = format!("accessor {i}: {n} elements go beyond buffer view {view}");
            return Err(self.wrong(what).help("the file was cut off, or its writer has a bug"));
        }
        let scale = |v: f64| if normalized { (v / most).max(-1.0) } else { v };
        let taken = only.map_or(n, <[u32]>::len);
        let mut out = Vec::with_capacity(taken * width);
        for e in 0..taken {
            let e = only.map_or(e, |o| o[e] as usize);
            let at = &bytes[(offset + e as u64 * stride) as usize..][..element];
            for c in 0..width {
                let b = &at[c / rows * column + c % rows * size..][..size];
                out.push(match kind {
                    5120 => scale(f64::from(b[0] as i8)),
                    5121 => scale(f64::from(b[0])),
                    5122 => scale(f64::from(i16::from_le_bytes([b[0], b[1]]))),
                    5123 => scale(f64::from(u16::from_le_bytes([b[0], b[1]]))),
                    5125 => scale(f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))),
                    _ => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                });
            }
        }
        Ok(out)
    }

    /// Rows of an accessor that has this many numbers an element.
    pub fn rows<const N: usize>(&self, i: usize, what: &str, only: Option<&[u32]>) -> Result<Vec<[f64; N]>> {
        let (width, all) = self.values(i, only)?;
        if width != N {
            return Err(self.wrong(format!("accessor {i}: {what} of {width} numbers")));
        }
        Ok(all.as_chunks().0.to_vec())
    }
}

/// Bytes of a `data:` address or of a file beside.
pub fn fetch(files: &Files, uri: &str) -> Result<Vec<u8>> {
    if let Some(rest) = uri.strip_prefix("data:") {
        let (head, body) = rest.split_once(',').unwrap_or(("", rest));
        return match head.ends_with(";base64") {
            true => base64(body).ok_or_else(|| files.broken("data in its text is no base64")),
            false => Ok(percent(body)),
        };
    }
    let name = file_name(uri);
    let shown: String = name.chars().take(80).collect();
    if uri.contains("://") {
        let d = files.broken(format!("`{}`, which it names, is elsewhere", shown.escape_debug()));
        return Err(d.help("put it beside the file: nothing is fetched"));
    }
    files.beside(&name).map_err(|why| files.broken(format!("`{}`, which it names, {why}", shown.escape_debug())))
}

/// The name of the file that an address means.
pub fn file_name(uri: &str) -> String {
    String::from_utf8_lossy(&percent(uri)).into_owned()
}

fn percent(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        let hex = |b: u8| (b as char).to_digit(16);
        if bytes[i] == b'%'
            && let (Some(&a), Some(&b)) = (bytes.get(i + 1), bytes.get(i + 2))
            && let (Some(a), Some(b)) = (hex(a), hex(b))
        {
            out.push((a * 16 + b) as u8);
            i += 3;
        } else {
            out.push(bytes[i]);
            i += 1;
        }
    }
    out
}

fn base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut held) = (0u32, 0);
    for b in text.bytes().filter(|b| !b.is_ascii_whitespace()) {
        let v = match b {
            b'A'..=b'Z' => b - b'A',
            b'a'..=b'z' => b - b'a' + 26,
            b'0'..=b'9' => b - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' => break,
            _ => return None,
        };
        (bits, held) = (bits << 6 | u32::from(v), held + 6);
        if held >= 8 {
            held -= 8;
            out.push((bits >> held) as u8);
            bits &= (1 << held) - 1;
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        assert_eq!(file_name("a%20b/%C3%A9%zz.bin"), "a b/é%zz.bin");
        assert_eq!(base64("aGVsbG8="), Some(b"hello".to_vec()));
        assert_eq!(base64("aGVsbG8h"), Some(b"hello!".to_vec()));
        assert_eq!(base64("aGV*"), None);
    }
}
