//! What is kept of a node that ran: enough for a hit to say everything that the run said.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::codec::{Reader, Writer};
use super::key::Lines;
use crate::digest::Digest;

/// The result of a key. Holds its own key, so that two records that change places are noticed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    pub key: Digest,
    /// Name of the artifact's kind.
    pub kind: String,
    /// The artifact's object.
    pub digest: Digest,
    pub bytes: u64,
    /// Bytes of the blobs beside it.
    pub blob_bytes: u64,
    /// What the run took.
    pub seconds: f64,
    pub warnings: Vec<String>,
    pub rejects: u32,
    pub repairs: u32,
    /// Object with the two lists as JSON (`diag::Findings` without warnings and facts), where there are any.
    pub notes: Option<Digest>,
    /// The frame as JSON, or empty.
    pub frame: String,
    /// One JSON object: the artifact's own lines, the operator's facts, notes by cause.
    pub summary: String,
    /// What the key was made of.
    pub lines: Lines,
}

const TAG: &str = "lodge result 1";

impl Record {
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Writer::default();
        out.digest(&self.key);
        out.text(&self.kind);
        out.digest(&self.digest);
        out.u64(self.bytes);
        out.u64(self.blob_bytes);
        out.f64(self.seconds);
        out.u32(self.warnings.len() as u32);
        self.warnings.iter().for_each(|w| out.text(w));
        out.u32(self.rejects);
        out.u32(self.repairs);
        out.option(self.notes.as_ref());
        out.text(&self.frame);
        out.text(&self.summary);
        out.u32(self.lines.len() as u32);
        for (name, value) in &self.lines {
            out.text(name);
            out.text(value);
        }
        out.sealed(TAG)
    }

    /// The record, if it is whole and the one of `key`.
    pub fn of_bytes(bytes: &[u8], key: &Digest) -> Option<Self> {
        let mut from = Reader::unseal(bytes, TAG)?;
        let record = Self {
            key: from.digest()?,
            kind: from.text()?.to_string(),
            digest: from.digest()?,
            bytes: from.u64()?,
            blob_bytes: from.u64()?,
            seconds: from.f64()?,
            warnings: from.list(|f| f.text().map(str::to_string))?,
            rejects: from.u32()?,
            repairs: from.u32()?,
            notes: from.option()?,
            frame: from.text()?.to_string(),
            summary: from.text()?.to_string(),
            lines: from.list(|f| Some((f.text()?.to_string(), f.text()?.to_string())))?,
        };
        (record.key == *key).then_some(record)
    }

    pub fn summary(&self) -> Map<String, Value> {
        serde_json::from_str(&self.summary).unwrap_or_default()
    }
}

/// The artifact's lines, the operator's facts, and how many features met which cause.
pub fn summary(artifact: Map<String, Value>, findings: &crate::diag::Findings) -> Map<String, Value> {
    let mut out = artifact;
    out.extend(findings.facts.iter().map(|(k, v)| (k.clone(), v.clone())));
    for (name, notes) in [("rejects", &findings.rejects), ("repairs", &findings.repairs)] {
        let mut causes = BTreeMap::<&str, u64>::new();
        notes.iter().for_each(|n| *causes.entry(&n.cause).or_default() += 1);
        if !causes.is_empty() && !out.contains_key(name) {
            out.insert(name.to_string(), causes.into_iter().map(|(k, v)| (k.to_string(), Value::from(v))).collect());
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_and_never_under_another_key() {
        let record = Record {
            key: Digest::of(b"key"),
            kind: "Mesh".into(),
            digest: Digest::of(b"object"),
            bytes: 12,
            warnings: vec!["ä".into()],
            notes: Some(Digest::of(b"notes")),
            summary: "{}".into(),
            lines: vec![("op".into(), "cluster".into())],
            ..Record::default()
        };
        let bytes = record.to_bytes();
        assert_eq!(Record::of_bytes(&bytes, &record.key), Some(record.clone()));
        assert_eq!(Record::of_bytes(&bytes, &Digest::of(b"other")), None);
        for i in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[i] ^= 1;
            assert_eq!(Record::of_bytes(&bad, &record.key), None);
            assert_eq!(Record::of_bytes(&bytes[..i], &record.key), None);
        }
    }
}
