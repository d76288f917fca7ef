//! What a null rerun reads instead of all: the names and stamps of every file that the last run depended on or
//! published, and what it said of each node. Kept beside the cache, checked by its own checksums; whatever does not
//! agree means the slow way, which needs no plan.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Instant, UNIX_EPOCH};

use super::codec::{Reader, Writer, checksum};
use super::event::Status;
use super::folder::{LARGEST_STATE, open};
use super::last;
use super::published::{self, Published};
use super::record::Record;
use super::rows::{self, Fresh, Role, Row};
use super::stamp::{self, Remotes, Stamp, boot, is_remote};
use super::store::Store;
use super::{NodeOutcome, Options, Outcome};
use crate::digest::Digest;
use crate::graph::{Graph, expand};

/// What was asked for: the same question has the same plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    pub file: PathBuf,
    pub sets: Vec<String>,
    /// Names of nodes.
    pub only: Vec<String>,
    pub out: PathBuf,
    /// Names operators and versions: another program makes other plans.
    pub build: String,
}

impl Identity {
    fn digest(&self) -> Digest {
        let mut out = Writer::default();
        out.text(&self.file.to_string_lossy());
        out.u32(self.sets.len() as u32);
        self.sets.iter().for_each(|s| out.text(s));
        out.u32(self.only.len() as u32);
        self.only.iter().for_each(|s| out.text(s));
        out.text(&self.out.to_string_lossy());
        if !self.sets.is_empty() {
            // Their paths start here.
            out.text(&std::env::current_dir().unwrap_or_default().to_string_lossy());
        }
        out.text(&self.build);
        checksum("lodge plan identity 1", &out.0)
    }

    fn path(&self, cache: &Path) -> PathBuf {
        cache.join("plans").join(self.digest().short(16))
    }
}

/// Version and operators, and the program's own file: while lodge is being written, versions do not tell all.
pub fn build_id(registry: &crate::op::Registry) -> String {
    let mut out = env!("CARGO_PKG_VERSION").to_string();
    registry.0.iter().for_each(|e| out += &format!(" {}@{}", e.name, e.version));
    let meta = std::env::current_exe().and_then(std::fs::metadata);
    let made = meta.and_then(|m| Ok((m.len(), m.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default())));
    made.map_or(out.clone(), |(bytes, when)| format!("{out} {bytes} {when:?}"))
}

const TAG: &str = "lodge plan 3";
/// Three lengths and checksums: files, table, words.
const HEAD: usize = 3 * 40;

/// Keeps a plan of a run in which all was well.
pub fn compile(
    store: &Store,
    identity: &Identity,
    graph: &Graph,
    outcome: &Outcome,
    options: &Options,
) -> io::Result<()> {
    if store.is_read_only() {
        return Ok(());
    }
    let mut rows = Vec::new();
    let mut remotes = Remotes::default();
    for text in graph.texts.iter().filter(|t| !t.path.as_os_str().is_empty()) {
        let (stamp, digest) = stamp::hash_input(&text.path)?;
        if digest != Digest::of(text.text.as_bytes()) {
            return Ok(()); // edited meanwhile
        }
        let (stamp, remote) = (stamp.on(store.grain()), remotes.is_remote(&text.path, &stamp));
        let Some(digest) = rows::of_text(&text.text) else { return Ok(()) };
        rows.push(Row { role: Role::Text, remote, path: text.path.clone(), stamp, digest });
    }
    for file in outcome.nodes.iter().flat_map(|n| &n.files) {
        let (path, stamp, digest) = (file.path.clone(), file.stamp, file.digest);
        rows.push(Row { role: Role::Input, remote: remotes.is_remote(&path, &stamp), path, stamp, digest });
    }
    if let Some(out) = &options.out {
        let remote = is_remote(out);
        for file in &outcome.files {
            let (path, stamp, digest) = (out.join(&file.path), file.stamp, file.digest);
            rows.push(Row { role: Role::Output, remote, path, stamp, digest });
        }
        // Another run that publishes here notes it.
        let state = store.state("published", &published::state_name(graph, out));
        if let Some((stamp, digest)) = stamp::hash_output(&state) {
            let (stamp, remote) = (stamp.on(store.grain()), is_remote(&state));
            rows.push(Row { role: Role::Output, remote, path: state, stamp, digest });
        }
    }
    // So does another run of the pipeline that had other results: then the last run is to be noted.
    let state = store.state("runs", &last::name(&graph.file));
    if let Some((stamp, digest)) = stamp::hash_output(&state) {
        let (stamp, remote) = (stamp.on(store.grain()), is_remote(&state));
        rows.push(Row { role: Role::Output, remote, path: state, stamp, digest });
    }
    let mut out = Writer::default();
    out.digest(&identity.digest());
    out.text(&boot());
    out.u32(outcome.nodes.len() as u32);
    out.u32(outcome.files.len() as u32);
    let mut globs: Vec<(&str, Digest)> = Vec::new();
    for pattern in outcome.nodes.iter().flat_map(|n| &graph.nodes[n.index].globs) {
        let (Some(text), Some(found)) = (pattern.to_str(), glob_digest(pattern)) else { return Ok(()) };
        globs.push((text, found));
    }
    out.u32(globs.len() as u32);
    for (pattern, found) in globs {
        out.text(pattern);
        out.digest(&found);
    }
    if rows::write(rows, &mut out).is_none() {
        return Ok(());
    }
    let table = (options.table)(&outcome.nodes);
    let bytes = join([&out.0, table.as_bytes(), &write_words(outcome)]);
    store.put_state("plans", &identity.digest().short(16), &bytes)
}

fn glob_digest(pattern: &Path) -> Option<Digest> {
    let mut out = Writer::default();
    expand(pattern).ok()?.iter().for_each(|p| out.text(&p.to_string_lossy()));
    Some(Digest::of(&out.0))
}

/// What only `--json` and `cache gc` need.
fn write_words(outcome: &Outcome) -> Vec<u8> {
    let mut out = Writer::default();
    out.u32(outcome.nodes.len() as u32);
    for node in &outcome.nodes {
        let record = node.record.as_ref().expect("all is well");
        out.text(&node.name);
        out.text(&node.op);
        out.digest(&record.key);
        out.digest(&record.digest);
        out.u64(record.bytes);
        out.u64(record.blob_bytes);
        out.f64(record.seconds);
        out.u32(node.warnings.len() as u32);
        node.warnings.iter().for_each(|w| out.text(w));
        out.text(&record.summary);
    }
    out.u32(outcome.files.len() as u32);
    for file in &outcome.files {
        out.text(&file.path);
        out.text(&file.node);
        out.u64(file.bytes);
        out.digest(&file.digest);
        file.stamp.write(&mut out);
    }
    out.0
}

fn join(parts: [&[u8]; 3]) -> Vec<u8> {
    let mut head = Writer::default();
    for part in parts {
        head.u64(part.len() as u64);
        head.digest(&checksum(TAG, part));
    }
    [&head.0[..], parts[0], parts[1], parts[2]].concat()
}

/// Lengths and checksums, if they fill a file of `size` bytes.
fn parts(head: &[u8], size: u64) -> Option<[(usize, Digest); 3]> {
    let mut from = Reader::new(head);
    let mut one = || Some((from.u64()?, from.digest()?));
    let parts = [one()?, one()?, one()?];
    let sum = parts.iter().try_fold(HEAD as u64, |sum, p| sum.checked_add(p.0))?;
    (sum == size).then_some(parts.map(|(n, sum)| (n as usize, sum)))
}

/// Whether a plan is whole and the one of this name.
pub fn is_whole(name: &str, bytes: &[u8]) -> bool {
    whole(name, bytes).is_some()
}

fn whole<'a>(name: &str, bytes: &'a [u8]) -> Option<[&'a [u8]; 3]> {
    let (head, mut rest) = bytes.split_at_checked(HEAD)?;
    let mut out = [&[][..]; 3];
    for (part, (n, sum)) in out.iter_mut().zip(parts(head, bytes.len() as u64)?) {
        (*part, rest) = rest.split_at_checked(n)?;
        if checksum(TAG, part) != sum {
            return None;
        }
    }
    (Reader::new(out[0]).digest()?.short(16) == name).then_some(out)
}

/// The keys of a plan's nodes, if it is whole.
pub fn keys(name: &str, bytes: &[u8]) -> Option<Vec<Digest>> {
    let nodes = Reader::new(whole(name, bytes)?[2]).list(node)?;
    Some(nodes.into_iter().filter_map(|n| Some(n.record?.key)).collect())
}

/// A run that has nothing to do: that much is certain. What it says is read when it is wanted, and none where that is
/// damaged: then the run goes the slow way.
pub struct Replay {
    started: Instant,
    pub nodes: usize,
    /// Published ones.
    pub files: usize,
    file: File,
    parts: [(usize, Digest); 3],
}

/// The plan, if every file is as it was.
pub fn replay(cache: &Path, identity: &Identity) -> Option<Replay> {
    let started = Instant::now();
    let path = identity.path(cache);
    let file = open(&path).ok()?;
    let mut head = [0; HEAD];
    file.read_exact_at(&mut head, 0).ok()?;
    let size = file.metadata().ok()?.len();
    let parts = parts(&head, size).filter(|_| size <= LARGEST_STATE)?;
    let mut replay = Replay { started, nodes: 0, files: 0, file, parts };
    let mut bytes = replay.part(0)?;
    let mut from = Reader::new(&bytes);
    if from.digest()? != identity.digest() || from.text()? != boot() {
        return None;
    }
    (replay.nodes, replay.files) = (from.u32()? as usize, from.u32()? as usize);
    let globs = from.list(|f| Some((f.text()?, f.digest()?)))?;
    if globs.iter().any(|(pattern, found)| glob_digest(Path::new(pattern)).as_ref() != Some(found)) {
        return None;
    }
    let fresh = rows::unchanged(&mut from)?;
    if !fresh.is_empty() {
        // The next time their stamps will do.
        for Fresh { left, stamp } in fresh {
            let mut new = Writer::default();
            stamp.write(&mut new);
            let at = bytes.len() - left;
            bytes[at..at + new.0.len()].copy_from_slice(&new.0);
        }
        let bytes = join([&bytes, &replay.part(1)?, &replay.part(2)?]);
        let fresh = path.with_extension(format!("{}", std::process::id()));
        let _ = std::fs::write(&fresh, bytes).and_then(|()| std::fs::rename(&fresh, &path));
    }
    Some(replay)
}

impl Replay {
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    fn part(&self, n: usize) -> Option<Vec<u8>> {
        let at = HEAD + self.parts[..n].iter().map(|p| p.0).sum::<usize>();
        let mut bytes = vec![0; self.parts[n].0];
        self.file.read_exact_at(&mut bytes, at as u64).ok()?;
        (checksum(TAG, &bytes) == self.parts[n].1).then_some(bytes)
    }

    /// What [`Options::table`] gave.
    pub fn table(&self) -> Option<String> {
        String::from_utf8(self.part(1)?).ok()
    }

    /// Everything.
    pub fn outcome(&self) -> Option<Outcome> {
        let bytes = self.part(2)?;
        let mut from = Reader::new(&bytes);
        let mut nodes = from.list(node)?;
        nodes.iter_mut().enumerate().for_each(|(i, n)| n.index = i);
        Some(Outcome { seconds: self.seconds(), nodes, files: from.list(published)?, ..Outcome::default() })
    }
}

fn node(from: &mut Reader) -> Option<NodeOutcome> {
    let (name, op) = (from.text()?.to_string(), from.text()?.to_string());
    let mut record = Record {
        key: from.digest()?,
        digest: from.digest()?,
        bytes: from.u64()?,
        blob_bytes: from.u64()?,
        seconds: from.f64()?,
        ..Record::default()
    };
    let warnings = from.list(|f| f.text().map(str::to_string))?;
    record.summary = from.text()?.to_string();
    Some(NodeOutcome {
        index: 0,
        name,
        op,
        status: Status::Cached,
        seconds: record.seconds,
        record: Some(Arc::new(record)),
        warnings,
        error: None,
        because: None,
        files: Vec::new(),
    })
}

fn published(from: &mut Reader) -> Option<Published> {
    let (path, node) = (from.text()?.to_string(), from.text()?.to_string());
    let (bytes, digest, stamp) = (from.u64()?, from.digest()?, Stamp::read(from)?);
    Some(Published { path, digest, bytes, written: false, stamp, node })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_of_another_question_or_another_time_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let (cache, none) = (folder.path(), Vec::new);
        let one = Identity { file: "a".into(), sets: none(), only: none(), out: "out".into(), build: "1".into() };
        std::fs::create_dir(cache.join("plans")).unwrap();
        let replays = |asked: &Identity, since: &str| {
            let mut out = Writer::default();
            out.digest(&asked.digest());
            out.text(since);
            // Without nodes, files, patterns, rows.
            (0..4).for_each(|_| out.u32(0));
            std::fs::write(one.path(cache), join([&out.0, b"", b""])).unwrap();
            replay(cache, &one).is_some()
        };
        assert!(replays(&one, &boot()));
        assert!(!replays(&one, "another time"));
        for other in [
            Identity { file: "b".into(), ..one.clone() },
            Identity { sets: vec!["a=1".into()], ..one.clone() },
            Identity { only: vec!["a".into()], ..one.clone() },
            Identity { out: "o".into(), ..one.clone() },
            Identity { build: "2".into(), ..one.clone() },
        ] {
            assert!(!replays(&other, &boot()), "{other:?}");
        }
    }
}
