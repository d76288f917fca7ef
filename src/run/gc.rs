//! Makes room: removes what no pipeline needs any more, and nothing that the last run of one does.
//!
//! It has the cache to itself (`Store::open_alone`): it begins when no run is at work, and a run that starts meanwhile
//! waits for it. A pack is written again without what goes, under a fresh name, synced and renamed over the old one; the
//! newest first, so that a result goes before its objects. So a death at any point leaves what is needed whole.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, UNIX_EPOCH};

use super::folder::open;
use super::needs::{self, Needs};
use super::pack::{self, Frame, HEAD, What};
use super::stamp::Stamps;
use super::store::Store;
use super::{history, plan, verify};
use crate::digest::Digest;

/// What of the rest may stay. Without a wish nothing does.
#[derive(Default)]
pub struct Wish {
    /// Results of these keys.
    pub keys: Vec<Digest>,
    /// What was made in this time.
    pub age: Option<Duration>,
    /// The newest, until the cache is so large.
    pub size: Option<u64>,
}

/// What went, or would go.
#[derive(Debug, Default)]
pub struct Swept {
    pub results: u64,
    pub objects: u64,
    pub plans: u64,
    /// Of input files that are gone or others by now, and of those that nothing here was read from.
    pub stamps: u64,
    /// Pipelines whose files are gone.
    pub gone: BTreeSet<PathBuf>,
    /// Of the cache before and after.
    pub before: u64,
    pub after: u64,
    /// What the last runs need.
    pub needed: u64,
    /// Ended early; what is done is done.
    pub interrupted: bool,
}

struct Pack {
    path: PathBuf,
    id: u64,
    frames: Vec<Frame>,
    bytes: u64,
}

/// `dry`: only tells.
pub fn gc(store: &Store, wish: &Wish, dry: bool, stop: &AtomicBool) -> io::Result<Swept> {
    let mut swept = Swept { before: verify::stat(store.root()).bytes(), ..Swept::default() };
    let stopped = || stop.load(Ordering::Relaxed);

    // (1) What is there, and what stays.
    let packs = packs(store)?;
    let large = needs::large_objects(store);
    let mut size = BTreeMap::<Digest, u64>::new();
    packs.iter().flat_map(|p| &p.frames).for_each(|f| _ = size.insert(f.name, (HEAD as u64) + u64::from(f.len)));
    large.iter().for_each(|(digest, (_, bytes))| *size.entry(*digest).or_default() += bytes);
    let sum = |names: &mut dyn Iterator<Item = &Digest>| names.filter_map(|n| size.get(n)).sum::<u64>();
    let mut needs = Needs::of(store);
    swept.needed = sum(&mut needs.results.iter().chain(&needs.objects));
    swept.gone = needs.gone.clone();
    wish.keys.iter().for_each(|key| needs.add(store, key));
    keep_more(store, wish, &packs, &mut needs, &sum);
    if stopped() {
        swept.interrupted = true;
        return Ok(swept);
    }

    // (2) Plans and notes: no plan may speak of what is gone.
    let mut went = 0;
    let mut remove = |path: &Path| -> io::Result<()> {
        went += fs::symlink_metadata(path).map_or(0, |m| m.len());
        if dry { Ok(()) } else { fs::remove_file(path) }
    };
    for entry in fs::read_dir(store.state("plans", "")).into_iter().flatten().flatten() {
        let Ok(name) = entry.file_name().into_string() else { continue };
        if entry.file_type().is_ok_and(|t| t.is_dir()) {
            continue; // not ours
        }
        let keys = plan::keys(&name, &store.get_state("plans", &name));
        if keys.is_none_or(|keys| keys.iter().any(|k| !needs.results.contains(k))) {
            remove(&entry.path())?;
            swept.plans += 1;
        }
    }
    for (folder, name) in &needs.idle {
        remove(&store.state(folder, name))?;
    }
    for name in history::names(store) {
        if history::load(store, &name).is_some_and(|run| needs::is_gone(Path::new(&run.file))) {
            remove(&store.state("history", &name))?;
        }
    }

    let mut stamps = Stamps::load(store);
    swept.stamps = stamps.keep(&needs.files);
    if !dry {
        stamps.save(store);
    }

    // (3) Packs, the newest first.
    let mut seen = BTreeSet::new();
    for pack in packs.iter().rev() {
        if stopped() {
            swept.interrupted = true;
            break;
        }
        // Of two frames of one name the last one counts.
        let mut good: Vec<Frame> = Vec::new();
        for frame in pack.frames.iter().rev() {
            let kept = match frame.what {
                What::Result => needs.results.contains(&frame.name),
                What::Object => needs.objects.contains(&frame.name),
            };
            if kept && seen.insert((frame.what as u8, frame.name)) {
                good.push(*frame);
                continue;
            }
            match frame.what {
                What::Result => swept.results += 1,
                What::Object => swept.objects += 1,
            }
        }
        let left: u64 = good.iter().map(|f| HEAD as u64 + u64::from(f.len)).sum();
        if left == pack.bytes {
            continue;
        }
        good.reverse();
        went += pack.bytes - left;
        if !dry {
            store.replace_pack(&pack.path, &open(&pack.path)?, &good)?;
        }
    }

    // (4) Large objects, and folders that are empty then.
    for (path, bytes) in large.iter().filter(|(d, _)| !needs.objects.contains(d)).map(|(_, file)| file) {
        if stopped() || swept.interrupted {
            swept.interrupted = true;
            break;
        }
        went += bytes;
        swept.objects += 1;
        if !dry {
            fs::remove_file(path)?;
            let _ = path.parent().map(fs::remove_dir);
        }
    }
    swept.after = if dry { swept.before.saturating_sub(went) } else { verify::stat(store.root()).bytes() };
    Ok(swept)
}

/// In the order of their runs.
fn packs(store: &Store) -> io::Result<Vec<Pack>> {
    let mut out = Vec::new();
    for entry in fs::read_dir(store.state("packs", "")).into_iter().flatten().flatten() {
        let path = entry.path();
        let Some(id) = pack::id_of(&path) else { continue };
        let Ok(file) = open(&path) else { continue };
        let frames = pack::scan(&file, 0)?.frames;
        out.push(Pack { path, id, frames, bytes: file.metadata()?.len() });
    }
    out.sort_by_key(|p| p.id);
    Ok(out)
}

/// Adds what is wished for beyond what is needed: whole results, the newest first.
fn keep_more(
    store: &Store,
    wish: &Wish,
    packs: &[Pack],
    needs: &mut Needs,
    sum: &dyn Fn(&mut dyn Iterator<Item = &Digest>) -> u64,
) {
    if wish.age.is_none() && wish.size.is_none() {
        return;
    }
    let now = UNIX_EPOCH.elapsed().unwrap_or_default();
    let other = verify::stat(store.root()).other_bytes;
    let mut all = other + sum(&mut needs.results.iter().chain(&needs.objects));
    for pack in packs.iter().rev() {
        // The id of a run is when it began.
        if wish.age.is_some_and(|age| now.saturating_sub(Duration::from_nanos(pack.id)) > age) {
            return;
        }
        for frame in pack.frames.iter().rev().filter(|f| f.what == What::Result) {
            if needs.results.contains(&frame.name) {
                continue;
            }
            let Some(record) = store.lookup(&frame.name) else { continue };
            let more: BTreeSet<Digest> = needs::objects_of(store, &record).into_iter().collect();
            all += sum(&mut more.difference(&needs.objects).chain([&frame.name]));
            if wish.size.is_some_and(|most| all > most) {
                return;
            }
            needs.keep(frame.name, &record, more);
        }
    }
}
