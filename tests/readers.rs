//! The readers on real data (`LODGE_DATA`), and on the bad input that they must survive.

use std::path::PathBuf;
use std::sync::Arc;

use lodge::artifact::{Buildings, Footprints};
use lodge::diag::{Findings, Result};
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::footprint::Footprint;
use lodge::ops::read_cityjson::ReadCityjson;
use lodge::ops::read_geojson::ReadGeojson;

/// Runs a reader on files in memory, with parameters as TOML.
fn read<O: Op>(params: &str, files: &[(&str, Vec<u8>)]) -> (Result<O::Out>, Findings) {
    let mut bench = Bench::default();
    bench.sources = files.iter().map(|(name, bytes)| Source::of_bytes(name, bytes.clone())).collect();
    let op: O = toml::from_str(params).unwrap();
    let out = op.run(&bench.ctx(), O::In::take(Vec::new()));
    (out, bench.report.finish())
}

/// A file of the real data, if there is any.
fn data(path: &str) -> Option<(&str, Vec<u8>)> {
    let Some(folder) = std::env::var_os("LODGE_DATA") else {
        println!("skipped: LODGE_DATA is not set");
        return None;
    };
    Some((path, std::fs::read(PathBuf::from(folder).join(path)).unwrap()))
}

fn counts(f: &Findings) -> [u64; 4] {
    let [read, accepted, rejected, filtered] =
        ["read", "accepted", "rejected", "filtered"].map(|k| f.facts[k].as_u64().unwrap());
    assert_eq!(read, accepted + rejected + filtered);
    assert_eq!(rejected, f.rejects.len() as u64);
    [read, accepted, rejected, filtered]
}

#[test]
fn every_building_of_the_real_files() {
    for (file, params, expected) in [
        ("tokyo_setagaya", "", [127_212, 127_212, 0, 0]),
        ("tokyo_centre", "", [18_718, 18_718, 0, 0]),
        ("boston_z13_footprints", "", [19_316, 19_316, 0, 0]),
        ("liechtenstein_osm", "where.layer = 'building'", [0, 8_994, 0, 0]),
        ("monaco_osm", "where.layer = 'building'", [0, 1_207, 0, 0]),
        ("helsinki_osm", "where.layer = 'building'", [0, 446, 0, 0]),
        ("andorra_osm", "where.layer = 'building'", [0, 292, 0, 0]),
    ] {
        let path = format!("buildings/{file}.geojson.gz");
        let Some(file) = data(&path) else { return };
        let (out, findings) = read::<ReadGeojson>(params, &[file]);
        let out: Footprints = out.unwrap();
        let [read, accepted, rejected, filtered] = counts(&findings);
        println!("{path}: {read} {accepted} {rejected} {filtered} {:?}", findings.facts);
        assert_eq!((accepted, rejected), (expected[1], expected[2]), "{path}: {:?}", findings.rejects);
        assert_eq!(out.len() as u64, accepted);
        if expected[0] > 0 {
            assert_eq!(read, expected[0]);
        }
    }
}

#[test]
fn every_building_of_the_city_models() {
    for (file, buildings, parts, lods) in [
        ("3dbag_tile5908_99b.city.jsonl", 99, 100, &[("0", 99), ("1.2", 99), ("1.3", 99), ("2.2", 99)][..]),
        ("3dbag_tile901_52b.city.jsonl", 52, 52, &[("0", 52), ("1.2", 52), ("1.3", 52), ("2.2", 52)]),
        ("3dbag_multi_lod_10b.city.json", 10, 0, &[("1.2", 10), ("1.3", 10), ("2.2", 10)]),
        ("vienna_lod2.city.jsonl", 149, 443, &[("2", 149)]),
        ("delft_lod1_themes.city.json", 160, 0, &[("1", 160)]),
    ] {
        let path = format!("citylod/{file}");
        let Some(file) = data(&path) else { return };
        let (out, findings) = read::<ReadCityjson>("", &[file]);
        println!("{path}: {:?} {:?} {:?}", findings.facts, findings.warnings, findings.rejects);
        let out: Buildings = out.unwrap();
        let [_, accepted, rejected, _] = counts(&findings);
        assert_eq!((accepted, rejected), (buildings, 0), "{path}");
        assert_eq!(findings.facts["parts"], parts, "{path}");
        let mut found = std::collections::BTreeMap::<&str, u64>::new();
        out.lods.iter().for_each(|l| *found.entry(l).or_default() += 1);
        assert_eq!(found.into_iter().collect::<Vec<_>>(), lods, "{path}");
        // Every building stands on something.
        let bench = Bench::default();
        let flat = Footprint::default().run(&bench.ctx(), Inputs::take(vec![vec![Arc::new(out)]]));
        let findings = bench.report.finish();
        println!("  {:?} {:?}", findings.facts, findings.rejects);
        assert_eq!(flat.unwrap().len() as u64, buildings, "{path}");
    }
}

#[test]
fn every_conformance_case() {
    let Some(folder) = std::env::var_os("LODGE_DATA") else {
        println!("skipped: LODGE_DATA is not set");
        return;
    };
    let folder = PathBuf::from(folder).join("peer/cityjson/conformance_v2_0");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 34);
    for path in files {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let (out, findings) = read::<ReadCityjson>("max-rejected = 1.0", &[(&name, std::fs::read(&path).unwrap())]);
        let said = match out {
            Ok(out) => format!("{} buildings, {:?}", out.len(), out.lods.iter().collect::<Vec<_>>()),
            Err(e) => e.to_string(),
        };
        println!("{name}: {said} {:?}", findings.facts);
        if findings.facts.contains_key("read") {
            counts(&findings);
        }
    }
}
