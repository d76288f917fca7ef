//! What a null rerun reads instead of all: the names and stamps of every file that the last run depended on or
//! published, and what it said of each node. Kept beside the cache, checked by its own checksums; whatever does not
//! agree means the slow way, which needs no plan.

use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Instant, UNIX_EPOCH};

use super::codec::{Reader, Writer, checksum};
use super::event::Status;
use super::folder::{LARGEST_STATE, open};
use super::last;
use super::published::{self, Published};
use super::record::Record;
use super::stamp::{self, Stamp, boot, is_remote};
use super::store::Store;
use super::{NodeOutcome, Outcome};
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

#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    /// A text or input: a link's target counts.
    Input = 0,
    /// A published file: a link is a change.
    Output = 1,
}

struct Row {
    role: Role,
    remote: bool,
    path: PathBuf,
    stamp: Stamp,
    digest: Digest,
}

const TAG: &str = "lodge plan 2";
/// Three lengths and checksums: rows, nodes, words.
const HEAD: usize = 3 * 40;

/// Keeps a plan of a run in which all was well.
pub fn compile(
    store: &Store,
    identity: &Identity,
    graph: &Graph,
    outcome: &Outcome,
    out: Option<&Path>,
) -> io::Result<()> {
    if store.is_read_only() {
        return Ok(());
    }
    let mut rows = Vec::new();
    for text in graph.texts.iter().filter(|t| !t.path.as_os_str().is_empty()) {
        let (stamp, digest) = stamp::hash_input(&text.path)?;
        if digest != Digest::of(text.text.as_bytes()) {
            return Ok(()); // edited meanwhile
        }
        let (stamp, remote) = (stamp.on(store.grain()), is_remote(&text.path));
        rows.push(Row { role: Role::Input, remote, path: text.path.clone(), stamp, digest });
    }
    for file in outcome.nodes.iter().flat_map(|n| &n.files) {
        let (path, stamp, digest) = (file.path.clone(), file.stamp, file.digest);
        rows.push(Row { role: Role::Input, remote: is_remote(&path), path, stamp, digest });
    }
    if let Some(out) = out {
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
    if rows.iter().any(|row| row.path.to_str().is_none()) {
        return Ok(());
    }
    let mut globs: Vec<(String, Digest)> = Vec::new();
    for pattern in outcome.nodes.iter().flat_map(|n| &graph.nodes[n.index].globs) {
        let (Some(text), Some(found)) = (pattern.to_str(), glob_digest(pattern)) else { return Ok(()) };
        globs.push((text.to_string(), found));
    }
    let bytes = write(identity, &rows, &globs, &write_nodes(outcome), &write_words(outcome));
    let name = identity.digest().short(16);
    store.put_state("plans", &name, &bytes)
}

fn glob_digest(pattern: &Path) -> Option<Digest> {
    let mut out = Writer::default();
    expand(pattern).ok()?.iter().for_each(|p| out.text(&p.to_string_lossy()));
    Some(Digest::of(&out.0))
}

fn write(identity: &Identity, rows: &[Row], globs: &[(String, Digest)], nodes: &[u8], words: &[u8]) -> Vec<u8> {
    let mut out = Writer::default();
    out.digest(&identity.digest());
    out.text(&boot());
    out.u32(rows.len() as u32);
    for row in rows {
        out.0.push(row.role as u8);
        out.0.push(row.remote.into());
        out.text(row.path.to_str().expect("looked at before"));
        row.stamp.write(&mut out);
        out.digest(&row.digest);
    }
    out.u32(globs.len() as u32);
    for (pattern, found) in globs {
        out.text(pattern);
        out.digest(found);
    }
    let mut head = Writer::default();
    for part in [&out.0[..], nodes, words] {
        head.u64(part.len() as u64);
        head.digest(&checksum(TAG, part));
    }
    [&head.0[..], &out.0, nodes, words].concat()
}

/// What the table needs.
fn write_nodes(outcome: &Outcome) -> Vec<u8> {
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
    }
    out.u32(outcome.files.len() as u32);
    out.0
}

/// What only `--json` needs.
fn write_words(outcome: &Outcome) -> Vec<u8> {
    let mut out = Writer::default();
    out.u32(outcome.nodes.len() as u32);
    outcome.nodes.iter().for_each(|n| out.text(&n.record.as_ref().expect("all is well").summary));
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

/// Lengths and checksums, if they fill a file of `size` bytes.
fn parts(head: &[u8], size: u64) -> Option<Vec<(usize, Digest)>> {
    let mut from = Reader::new(head);
    let parts: Vec<(u64, Digest)> = (0..3).map_while(|_| Some((from.u64()?, from.digest()?))).collect();
    let sum = parts.iter().try_fold(HEAD as u64, |sum, p| sum.checked_add(p.0))?;
    (parts.len() == 3 && sum == size).then(|| parts.into_iter().map(|(n, d)| (n as usize, d)).collect())
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
    let nodes = Reader::new(whole(name, bytes)?[1]).list(node)?;
    Some(nodes.into_iter().filter_map(|n| Some(n.record?.key)).collect())
}

/// The outcome of a run that has nothing to do, if that is certain. `words`: with summaries and files; without,
/// `Outcome::files` has only its length.
pub fn replay(cache: &Path, identity: &Identity, words: bool) -> Option<Outcome> {
    let started = Instant::now();
    let path = identity.path(cache);
    let mut file = open(&path).ok()?;
    let mut head = [0; HEAD];
    file.read_exact(&mut head).ok()?;
    let size = file.metadata().ok()?.len();
    let parts = parts(&head, size).filter(|_| size <= LARGEST_STATE)?;
    let mut part = |n: usize| {
        let mut bytes = vec![0; parts[n].0];
        file.read_exact(&mut bytes).ok()?;
        (checksum(TAG, &bytes) == parts[n].1).then_some(bytes)
    };

    // (1) Is every file as it was?
    let rows_part = part(0)?;
    let mut from = Reader::new(&rows_part);
    if from.digest()? != identity.digest() || from.text()? != boot() {
        return None;
    }
    let mut young = false;
    let mut rows = Vec::new();
    for _ in 0..from.u32()? {
        let role = if from.u8()? == 0 { Role::Input } else { Role::Output };
        let remote = from.u8()? != 0;
        let path = Path::new(from.text()?);
        let (stamp, digest) = (Stamp::read(&mut from)?, from.digest()?);
        let now = match role {
            Role::Input => Stamp::of_input(path).ok()?,
            Role::Output => Stamp::of_output(path)?,
        };
        let mut row = Row { role, remote, path: path.to_path_buf(), stamp, digest };
        if !now.same(&stamp) || !stamp.settled(remote) {
            // Perhaps only touched.
            let (fresh, found) = match role {
                Role::Input => stamp::hash_input(path).ok()?,
                Role::Output => stamp::hash_output(path)?,
            };
            if found != digest {
                return None;
            }
            row.stamp = fresh;
            young = true;
        }
        rows.push(row);
    }
    let globs = from.list(|f| Some((f.text()?.to_string(), f.digest()?)))?;
    if globs.iter().any(|(pattern, found)| glob_digest(Path::new(pattern)).as_ref() != Some(found)) {
        return None;
    }

    // (2) Then all is said already.
    let nodes_part = part(1)?;
    let mut from = Reader::new(&nodes_part);
    let mut nodes = from.list(node)?;
    let mut files = vec![Published::default(); from.u32()? as usize];
    let words_part = if words || young { part(2)? } else { Vec::new() };
    if words {
        let mut from = Reader::new(&words_part);
        let summaries = from.list(|f| f.text().map(str::to_string))?;
        for (node, summary) in nodes.iter_mut().zip(summaries) {
            Arc::get_mut(node.record.as_mut()?)?.summary = summary;
        }
        files = from.list(published)?;
    }
    if young {
        // The next time their stamps will do.
        let bytes = write(identity, &rows, &globs, &nodes_part, &words_part);
        let fresh = path.with_extension(format!("{}", std::process::id()));
        let _ = std::fs::write(&fresh, bytes).and_then(|()| std::fs::rename(&fresh, &path));
    }
    nodes.iter_mut().enumerate().for_each(|(i, n)| n.index = i);
    Some(Outcome { seconds: started.elapsed().as_secs_f64(), nodes, files, ..Outcome::default() })
}

fn node(from: &mut Reader) -> Option<NodeOutcome> {
    let (name, op) = (from.text()?.to_string(), from.text()?.to_string());
    let record = Record {
        key: from.digest()?,
        digest: from.digest()?,
        bytes: from.u64()?,
        blob_bytes: from.u64()?,
        seconds: from.f64()?,
        ..Record::default()
    };
    Some(NodeOutcome {
        index: 0,
        name,
        op,
        status: Status::Cached,
        seconds: record.seconds,
        record: Some(Arc::new(record)),
        warnings: from.list(|f| f.text().map(str::to_string))?,
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
