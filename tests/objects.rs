//! Large objects are decoded while they are read, before their digest is known to be theirs: whatever the bytes, the end
//! is a value, which is dropped, or an error. Never a panic, nor more memory than a column as long as the file for each.

mod support;

use std::collections::{BTreeMap, BTreeSet};

use lodge::artifact::sections::Decoder;
use lodge::artifact::{KINDS, Kind};
use lodge::digest::Digest;
use lodge::run::store::Store;
use support::{Place, Random, project};

/// One object of each kind, made by the shipped pipelines.
fn objects() -> Vec<(&'static Kind, Vec<u8>)> {
    let place = Place::new();
    let shipped = |name: &str| project().join("pipelines").join(name).to_string_lossy().into_owned();
    let runs = [
        vec!["run".to_string(), shipped("city-barriers.toml")],
        vec!["run".to_string(), shipped("city-cityjson.toml")],
        vec!["run".into(), shipped("impostor.toml"), "--set".into(), "node.voxels.matrix.resolution=[8]".into()],
    ];
    let mut digests = BTreeSet::new();
    for run in &runs {
        let done = place.lodge_json(&run.iter().map(String::as_str).collect::<Vec<_>>());
        let nodes = done["nodes"].as_array().unwrap();
        digests.extend(nodes.iter().map(|n| Digest::parse(n["digest"].as_str().unwrap()).unwrap()));
    }
    let store = Store::look(&place.path("cache")).unwrap();
    let mut smallest: BTreeMap<&str, (&'static Kind, Vec<u8>)> = BTreeMap::new();
    for digest in digests {
        let bytes = store.get(&digest).unwrap();
        let kind = *KINDS.iter().find(|k| Decoder::new(&bytes, k.name).is_ok()).expect("of some kind");
        let known = smallest.entry(kind.name).or_insert_with(|| (kind, bytes.clone()));
        if bytes.len() < known.1.len() {
            known.1 = bytes;
        }
    }
    assert_eq!(smallest.keys().copied().collect::<Vec<_>>(), KINDS.iter().map(|k| k.name).collect::<Vec<_>>());
    smallest.into_values().collect()
}

/// What the bytes decode to, encoded again, where that is anything: at once, and with all but the first `here` as they
/// are asked for, forwards only, as a file is read.
fn both(kind: &Kind, bytes: &[u8], here: usize) -> [Option<Vec<u8>>; 2] {
    let again = |mut from: Decoder| {
        let value = (kind.decode)(&mut from).ok()?;
        let mut out = lodge::artifact::sections::Encoder::new(kind.name);
        value.encode(&mut out);
        Some(out.to_bytes())
    };
    let here = here.min(bytes.len());
    let mut at = here;
    let mut rest = |from: usize, out: &mut [u8]| {
        at = Some(from).filter(|&from| from >= at)? + out.len();
        out.copy_from_slice(&bytes[from..at]);
        Some(())
    };
    let whole = Decoder::new(bytes, kind.name).ok().and_then(again);
    let streamed = Decoder::over(&bytes[..here], bytes.len(), &mut rest, kind.name).ok().and_then(again);
    [whole, streamed]
}

#[test]
fn bytes_that_are_not_its_own() {
    let mut random = Random(7);
    let mut dice = move |n: usize| random.below(n);
    let rounds = if support::is_long() { 200_000 } else { 2_000 };
    for (kind, bytes) in objects() {
        let [whole, streamed] = both(kind, &bytes, 4096);
        assert!(whole.as_ref() == Some(&bytes) && streamed == whole, "{}: its own bytes", kind.name);
        // Table and the first columns are changed as often as all the rest.
        let first = bytes.len().min(2048);
        let (mut values, mut errors) = (0, 0);
        for round in 0..rounds {
            let mut bad = bytes.clone();
            for _ in 0..1 + dice(3) {
                let range = if dice(2) == 0 { first } else { bad.len() };
                let at = dice(range);
                match dice(6) {
                    0 => bad.get_mut(at).into_iter().for_each(|b| *b = dice(256) as u8),
                    1 => bad.get_mut(at).into_iter().for_each(|b| *b ^= 1 << dice(8)),
                    2 => put(&mut bad, at, &[0, 1, 4, 255, u32::MAX, 1 << 31, 0x7fc0_0000][dice(7)].to_le_bytes()),
                    3 => put(&mut bad, at / 4 * 4, &(dice(bytes.len()) as u32).to_le_bytes()),
                    4 => {
                        let numbers = [0, 1, u64::MAX, 1 << 63, 1 << 40, bytes.len() as u64, bytes.len() as u64 / 2];
                        put(&mut bad, at, &numbers[dice(7)].to_le_bytes());
                    }
                    _ if round % 4 == 0 => bad.truncate(at),
                    _ => bad.extend(std::iter::repeat_n(0, dice(200))),
                }
            }
            let [whole, streamed] = both(kind, &bad, [0, 64, 1000, 4096][dice(4)]);
            match whole {
                Some(_) => values += 1,
                None => errors += 1,
            }
            // Out of order, or cut off in the table: then the other way says what it is.
            assert!(streamed.is_none() || streamed == whole, "{}, round {round}", kind.name);
        }
        assert!(values > rounds / 50 && errors > rounds / 50, "{}: {values} values, {errors} errors", kind.name);
    }
}

fn put(bytes: &mut [u8], at: usize, new: &[u8]) {
    bytes.iter_mut().skip(at).zip(new).for_each(|(b, n)| *b = *n);
}
