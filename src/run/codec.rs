//! Small records as bytes: numbers little-endian, texts behind their length. Reading never panics.

use crate::digest::Digest;

/// Appends fields.
#[derive(Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    pub fn u32(&mut self, v: u32) {
        self.0.extend(v.to_le_bytes());
    }
    pub fn u64(&mut self, v: u64) {
        self.0.extend(v.to_le_bytes());
    }
    pub fn i64(&mut self, v: i64) {
        self.0.extend(v.to_le_bytes());
    }
    pub fn f64(&mut self, v: f64) {
        self.0.extend(v.to_le_bytes());
    }
    pub fn blob(&mut self, v: &[u8]) {
        self.u32(v.len() as u32);
        self.0.extend(v);
    }
    pub fn text(&mut self, v: &str) {
        self.blob(v.as_bytes());
    }
    pub fn digest(&mut self, v: &Digest) {
        self.0.extend(v.0);
    }
    pub fn option(&mut self, v: Option<&Digest>) {
        self.0.push(v.is_some().into());
        self.0.extend(v.copied().unwrap_or_default().0);
    }

    /// The fields behind `tag` and a checksum over both: what a file of ours looks like.
    pub fn sealed(self, tag: &str) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.0.len() + 32);
        out.extend(checksum(tag, &self.0).0);
        out.extend(self.0);
        out
    }
}

/// Takes fields off the front; none where they do not fit.
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// The fields of a [`Writer::sealed`] file, if not a bit of it changed.
    pub fn unseal(bytes: &'a [u8], tag: &str) -> Option<Self> {
        let (sum, rest) = bytes.split_at_checked(32)?;
        (checksum(tag, rest).0 == sum).then_some(Self(rest))
    }

    /// Bytes that are left.
    pub fn left(&self) -> usize {
        self.0.len()
    }

    pub fn bytes(&mut self, n: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(head)
    }
    pub fn u8(&mut self) -> Option<u8> {
        Some(self.bytes(1)?[0])
    }
    pub fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.bytes(4)?.try_into().ok()?))
    }
    pub fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.bytes(8)?.try_into().ok()?))
    }
    pub fn i64(&mut self) -> Option<i64> {
        Some(i64::from_le_bytes(self.bytes(8)?.try_into().ok()?))
    }
    pub fn f64(&mut self) -> Option<f64> {
        Some(f64::from_le_bytes(self.bytes(8)?.try_into().ok()?))
    }
    pub fn blob(&mut self) -> Option<&'a [u8]> {
        let n = self.u32()? as usize;
        self.bytes(n)
    }
    pub fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.blob()?).ok()
    }
    pub fn digest(&mut self) -> Option<Digest> {
        Some(Digest(self.bytes(32)?.try_into().ok()?))
    }
    pub fn option(&mut self) -> Option<Option<Digest>> {
        let some = self.u8()? != 0;
        let digest = self.digest()?;
        Some(some.then_some(digest))
    }
    /// `n` items, never more than there can be.
    pub fn list<T>(&mut self, mut item: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        let n = self.u32()? as usize;
        let mut out = Vec::with_capacity(n.min(self.0.len()));
        for _ in 0..n {
            out.push(item(self)?);
        }
        Some(out)
    }
}

pub fn checksum(tag: &str, bytes: &[u8]) -> Digest {
    let mut hash = blake3::Hasher::new();
    hash.update(&(tag.len() as u64).to_le_bytes());
    hash.update(tag.as_bytes());
    hash.update(bytes);
    Digest(*hash.finalize().as_bytes())
}
