//! The artifact format: a magic word, the kind, a table of named columns, then the columns, little-endian, each
//! aligned to 64 bytes. Canonical: equal values give equal bytes. Encoding borrows, so that a large artifact is
//! hashed and written piece by piece without a copy.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;

use crate::diag::{Diagnostic, Result};

const MAGIC: &[u8; 8] = b"lodge\0\0\x01";
const ALIGN: usize = 64;

/// Gathers columns, then gives the file in pieces.
pub struct Encoder<'a> {
    kind: &'static str,
    columns: Vec<(String, u32, Cow<'a, [u8]>)>,
}

impl<'a> Encoder<'a> {
    pub fn new(kind: &'static str) -> Self {
        Self { kind, columns: Vec::new() }
    }

    /// A column of cells of `size` bytes.
    pub fn put(&mut self, name: impl Into<String>, size: usize, bytes: impl Into<Cow<'a, [u8]>>) {
        self.columns.push((name.into(), size as u32, bytes.into()));
    }

    /// The encoded artifact, in order. Joined they are the object.
    pub fn pieces(self) -> Vec<Cow<'a, [u8]>> {
        let mut table = Vec::new();
        let text = |out: &mut Vec<u8>, t: &str| {
            out.extend((t.len() as u32).to_le_bytes());
            out.extend(t.as_bytes());
        };
        table.extend(MAGIC);
        text(&mut table, self.kind);
        table.extend((self.columns.len() as u32).to_le_bytes());
        let mut head = table.len();
        for (name, ..) in &self.columns {
            head += 4 + name.len() + 4 + 8 + 8;
        }
        let mut offset = head.next_multiple_of(ALIGN);
        for (name, size, bytes) in &self.columns {
            text(&mut table, name);
            table.extend(size.to_le_bytes());
            table.extend((offset as u64).to_le_bytes());
            table.extend((bytes.len() as u64).to_le_bytes());
            offset = (offset + bytes.len()).next_multiple_of(ALIGN);
        }
        table.resize(table.len().next_multiple_of(ALIGN), 0);
        let mut out = vec![Cow::Owned(table)];
        for (.., bytes) in self.columns {
            let pad = bytes.len().next_multiple_of(ALIGN) - bytes.len();
            out.push(bytes);
            if pad > 0 {
                out.push(Cow::Borrowed(&[0u8; ALIGN][..pad]));
            }
        }
        out
    }

    pub fn to_bytes(self) -> Vec<u8> {
        self.pieces().concat()
    }
}

/// Fills a buffer with the bytes that lie from a place on, places rising from call to call; none where it cannot.
pub type Rest<'a> = &'a mut dyn FnMut(usize, &mut [u8]) -> Option<()>;

/// Reads columns back by name, each into its own memory. Digests are checked by whoever has the bytes: before, so that
/// a mismatch here is another version's artifact; or, of what comes as it is read, before the value is used.
pub struct Decoder<'a> {
    kind: &'static str,
    columns: BTreeMap<&'a str, (usize, Range<usize>)>,
    /// The first bytes, and how to get at those that follow.
    head: &'a [u8],
    rest: Option<Rest<'a>>,
}

impl<'a> Decoder<'a> {
    pub fn new(bytes: &'a [u8], kind: &'static str) -> Result<Self> {
        Self::parse(bytes, bytes.len(), None, kind).ok_or_else(|| broken(kind, "its table of columns is damaged"))
    }

    /// Over `len` bytes of which the first, with the whole table, are here. Columns come in the order of the file.
    pub fn over(head: &'a [u8], len: usize, rest: Rest<'a>, kind: &'static str) -> Result<Self> {
        Self::parse(head, len, Some(rest), kind).ok_or_else(|| broken(kind, "its table of columns is damaged"))
    }

    fn parse(head: &'a [u8], len: usize, rest: Option<Rest<'a>>, kind: &'static str) -> Option<Self> {
        let mut at = head.strip_prefix(MAGIC)?;
        let mut take = |n: usize| {
            let (head, rest) = at.split_at_checked(n)?;
            at = rest;
            Some(head)
        };
        let n = u32::from_le_bytes(take(4)?.try_into().ok()?) as usize;
        if take(n)? != kind.as_bytes() {
            return None;
        }
        let count = u32::from_le_bytes(take(4)?.try_into().ok()?);
        let mut columns = BTreeMap::new();
        for _ in 0..count {
            let n = u32::from_le_bytes(take(4)?.try_into().ok()?) as usize;
            let name = std::str::from_utf8(take(n)?).ok()?;
            let size = u32::from_le_bytes(take(4)?.try_into().ok()?) as usize;
            let offset = u64::from_le_bytes(take(8)?.try_into().ok()?) as usize;
            let bytes = u64::from_le_bytes(take(8)?.try_into().ok()?) as usize;
            let end = offset.checked_add(bytes).filter(|&end| end <= len)?;
            columns.insert(name, (size, offset..end));
        }
        Some(Self { kind, columns, head, rest })
    }

    /// The cells of a column.
    pub fn cells<T: Cell>(&mut self, name: &str) -> Result<Vec<T>> {
        let size = size_of::<T>();
        let range = match self.columns.get(name) {
            Some((s, range)) if *s == size && range.len() % size == 0 => range.clone(),
            Some(_) => return Err(self.broken(&format!("column `{name}` has another type"))),
            None => return Err(self.broken(&format!("column `{name}` is missing"))),
        };
        let n = range.len() / size;
        // A file can be longer than the memory: an error, where `vec!` would end the program.
        if Vec::<T>::new().try_reserve_exact(n).is_err() {
            return Err(self.broken(&format!("column `{name}` is larger than the memory")));
        }
        let mut cells = vec![T::zeroed(); n];
        match self.copy(range.start, bytemuck::cast_slice_mut(&mut cells)) {
            Some(()) => Ok(cells),
            None => Err(self.broken(&format!("column `{name}` cannot be read"))),
        }
    }

    fn copy(&mut self, at: usize, out: &mut [u8]) -> Option<()> {
        let here = self.head.get(at..).unwrap_or_default();
        let here = &here[..here.len().min(out.len())];
        let (first, out) = out.split_at_mut(here.len());
        first.copy_from_slice(here);
        if out.is_empty() { Some(()) } else { self.rest.as_mut()?(at + here.len(), out) }
    }

    pub fn broken(&self, what: &str) -> Box<Diagnostic> {
        broken(self.kind, what)
    }
}

fn broken(kind: &str, what: &str) -> Box<Diagnostic> {
    Diagnostic::error("bad-artifact", format!("not a {kind} artifact of this version: {what}"))
}

/// A field of an artifact: how it becomes one or more columns.
pub trait Field: Sized {
    fn put<'a>(&'a self, name: &str, out: &mut Encoder<'a>);
    fn get(name: &str, from: &mut Decoder) -> Result<Self>;
}

/// Fixed-size numbers that a column may hold.
pub trait Cell: bytemuck::Pod {}

macro_rules! cells { ($($t:ty),*) => { $(impl Cell for $t {})* } }
cells!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);
cells!(
    [i32; 2], [i32; 3], [u32; 2], [u32; 3], [f64; 2], [f64; 3], [f64; 4], [f32; 2], [f32; 3], [f32; 4], [u8; 4],
    [i64; 4]
);

#[cfg(target_endian = "big")]
compile_error!("artifacts are little-endian and columns are copied as they lie in memory");

impl<T: Cell> Field for Vec<T> {
    fn put<'a>(&'a self, name: &str, out: &mut Encoder<'a>) {
        out.put(name, size_of::<T>(), bytemuck::cast_slice::<T, u8>(self));
    }
    fn get(name: &str, from: &mut Decoder) -> Result<Self> {
        from.cells(name)
    }
}

impl Field for Vec<bool> {
    fn put<'a>(&'a self, name: &str, out: &mut Encoder<'a>) {
        out.put(name, 1, bytemuck::cast_slice::<bool, u8>(self));
    }
    fn get(name: &str, from: &mut Decoder) -> Result<Self> {
        Ok(from.cells::<u8>(name)?.into_iter().map(|b| b != 0).collect())
    }
}

impl Field for String {
    fn put<'a>(&'a self, name: &str, out: &mut Encoder<'a>) {
        out.put(name, 1, self.as_bytes());
    }
    fn get(name: &str, from: &mut Decoder) -> Result<Self> {
        String::from_utf8(from.cells(name)?).map_err(|_| from.broken(&format!("column `{name}` is not UTF-8")))
    }
}

/// A small record that travels as canonical JSON.
pub fn put_json<T: serde::Serialize>(value: &T, name: &str, out: &mut Encoder) {
    // Through `Value`: its maps are sorted.
    let value = serde_json::to_value(value).expect("records are plain data");
    out.put(name, 1, value.to_string().into_bytes());
}

pub fn get_json<T: serde::de::DeserializeOwned>(name: &str, from: &mut Decoder) -> Result<T> {
    serde_json::from_slice(&from.cells::<u8>(name)?).map_err(|e| from.broken(&format!("column `{name}`: {e}")))
}

/// A `Field` for a type that is plain serde data.
#[macro_export]
macro_rules! json_field {
    ($($t:ty),+) => { $(impl $crate::artifact::sections::Field for $t {
        fn put<'a>(&'a self, name: &str, out: &mut $crate::artifact::sections::Encoder<'a>) {
            $crate::artifact::sections::put_json(self, name, out);
        }
        fn get(name: &str, from: &mut $crate::artifact::sections::Decoder) -> $crate::diag::Result<Self> {
            $crate::artifact::sections::get_json(name, from)
        }
    })+ };
}

/// A struct whose fields are all [`Field`]s: the struct, and its encoding in that order under those names.
#[macro_export]
macro_rules! columns {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$fmeta:meta])* pub $field:ident: $ty:ty),* $(,)? }) => {
        $(#[$meta])*
        pub struct $name { $($(#[$fmeta])* pub $field: $ty),* }
        impl $crate::artifact::sections::Field for $name {
            fn put<'a>(&'a self, name: &str, out: &mut $crate::artifact::sections::Encoder<'a>) {
                let dot = if name.is_empty() { "" } else { "." };
                $($crate::artifact::sections::Field::put(&self.$field, &format!("{name}{dot}{}", stringify!($field)), out);)*
            }
            fn get(name: &str, from: &mut $crate::artifact::sections::Decoder) -> $crate::diag::Result<Self> {
                let dot = if name.is_empty() { "" } else { "." };
                Ok(Self { $($field: $crate::artifact::sections::Field::get(&format!("{name}{dot}{}", stringify!($field)), from)?),* })
            }
        }
    };
}

/// Encode and decode of an artifact that is a `columns!` struct: for use inside `impl Artifact`.
#[macro_export]
macro_rules! coded_as_columns {
    () => {
        fn encode<'a>(&'a self, out: &mut $crate::artifact::sections::Encoder<'a>) {
            $crate::artifact::sections::Field::put(self, "", out);
        }
        fn decode(from: &mut $crate::artifact::sections::Decoder) -> $crate::diag::Result<Self> {
            $crate::artifact::sections::Field::get("", from)
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    crate::columns! {
        #[derive(Debug, PartialEq)]
        pub struct Pair { pub a: Vec<u32>, pub b: Vec<bool>, pub c: String }
    }

    /// An input that comes from the cache must give the bytes that it gave from memory.
    #[test]
    fn numbers_in_json_come_back_to_the_bit() {
        let mut random = 1u64;
        for i in 0..20_000 {
            random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let x = if i == 0 { 95.909_839_627_030_69 } else { (random >> 11) as f64 / (1u64 << (random % 60)) as f64 };
            let mut out = Encoder::new("Number");
            put_json(&x, "x", &mut out);
            let bytes = out.to_bytes();
            let back: f64 = get_json("x", &mut Decoder::new(&bytes, "Number").unwrap()).unwrap();
            assert_eq!(back.to_bits(), x.to_bits(), "{x:?}");
        }
    }

    #[test]
    fn there_and_back() {
        let pair = Pair { a: vec![1, 2, 3], b: vec![true, false], c: "ä".into() };
        let mut out = Encoder::new("Pair");
        pair.put("", &mut out);
        let bytes = out.to_bytes();
        assert_eq!(bytes.len() % 64, 0);
        assert_eq!(Pair::get("", &mut Decoder::new(&bytes, "Pair").unwrap()).unwrap(), pair);
        assert!(Decoder::new(&bytes, "Other").is_err());
        for cut in 0..bytes.len() {
            if let Ok(mut d) = Decoder::new(&bytes[..cut], "Pair") {
                let _ = Pair::get("", &mut d);
            }
            // With the rest of the bytes elsewhere.
            let mut rest = |at: usize, out: &mut [u8]| {
                out.copy_from_slice(&bytes[at..at + out.len()]);
                (at >= cut).then_some(())
            };
            match Decoder::over(&bytes[..cut], bytes.len(), &mut rest, "Pair") {
                Ok(mut d) => assert_eq!(Pair::get("", &mut d).unwrap(), pair),
                Err(_) => assert!(cut < 192, "the table was here"),
            }
        }
    }

    /// A table that promises more than the file has is seen before any memory is taken.
    #[test]
    fn columns_beyond_the_file() {
        let cells = vec![7u64; 100];
        let mut out = Encoder::new("Pair");
        cells.put("a", &mut out);
        let bytes = out.to_bytes();
        let mut none = |_: usize, _: &mut [u8]| None;
        assert!(Decoder::over(&bytes[..64], bytes.len(), &mut none, "Pair").unwrap().cells::<u64>("a").is_err());
        assert!(Decoder::over(&bytes[..64], 63 + 800, &mut none, "Pair").is_err());
        let length = bytes.windows(8).position(|w| w == 800u64.to_le_bytes()).unwrap();
        for hostile in [u64::MAX, u64::MAX / 2, 1 << 50, 808 + 64] {
            let mut bad = bytes.clone();
            bad[length..length + 8].copy_from_slice(&hostile.to_le_bytes());
            assert!(Decoder::new(&bad, "Pair").is_err());
            assert!(Decoder::over(&bad[..64], bad.len(), &mut none, "Pair").is_err());
        }
    }
}
