//! A city end to end: `lodge run pipelines/city.toml`, cold and again, in turns with the yardstick T (see `support`).
//!
//!     LODGE_DATA=.. cargo bench --bench city [-- FILE [ROUNDS]]
//!
//! FILE is a name below `buildings/` or a path (default `tokyo_setagaya.geojson.gz`), ROUNDS the number of cold runs
//! (default 5). Seconds of wall time, the median of the rounds; processor seconds and peak memory of the process.

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// What one process did: wall seconds, its peak of resident memory in bytes, its report.
struct Seen {
    wall: f64,
    peak: u64,
    report: serde_json::Value,
}

fn run(file: &Path, folder: &Path) -> Seen {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut buildings = std::ffi::OsString::from("buildings=");
    buildings.push(file);
    let start = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_lodge"))
        .arg("run")
        .arg(here.join("pipelines/city.toml"))
        .arg("--set")
        .arg(buildings)
        .arg("--cache")
        .arg(folder.join("cache"))
        .arg("--out")
        .arg(folder.join("out"))
        .arg("--json")
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("lodge starts");
    let status = format!("/proc/{}/status", child.id());
    // The kernel keeps the highest: the last look before the end is enough.
    let watch = std::thread::spawn(move || {
        let mut peak = 0;
        while let Ok(text) = std::fs::read_to_string(&status) {
            let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:"));
            let Some(kb) = line.and_then(|l| l.split_whitespace().next()?.parse::<u64>().ok()) else { break };
            peak = peak.max(kb * 1024);
            std::thread::sleep(Duration::from_millis(4));
        }
        peak
    });
    let mut text = Vec::new();
    std::io::Read::read_to_end(child.stdout.as_mut().expect("piped"), &mut text).expect("a report");
    assert!(child.wait().expect("it ends").success(), "lodge run failed");
    let wall = start.elapsed().as_secs_f64();
    Seen { wall, peak: watch.join().expect("no panic"), report: serde_json::from_slice(&text).expect("JSON") }
}

fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

fn main() {
    let Some(yard) = support::data("tokyo_setagaya.geojson.gz") else { return };
    let args: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let file = args.first().map_or(yard.clone(), |a| {
        if a.contains('/') { PathBuf::from(a) } else { support::data(a).expect("checked above") }
    });
    let rounds = args.get(1).and_then(|n| n.parse().ok()).unwrap_or(5);
    let scratch = tempfile::tempdir().expect("a folder for the runs");

    let (mut t, mut cold, mut again, mut peaks) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut nodes: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut order = Vec::new();
    for round in 0..rounds {
        let (wall, _) = support::measure(2, || support::parse(&yard));
        t.push(wall.as_secs_f64());
        let folder = scratch.path().join(round.to_string());
        let first = run(&file, &folder);
        order = first.report["nodes"].as_array().expect("nodes").clone();
        for node in &order {
            let name = node["name"].as_str().expect("a name").to_string();
            nodes.entry(name).or_default().push(node["seconds"].as_f64().unwrap_or(0.0));
        }
        cold.push(first.wall);
        peaks.push(first.peak as f64);
        let (second, third) = (run(&file, &folder), run(&file, &folder));
        again.push([second.wall, third.wall]);
        std::fs::remove_dir_all(&folder).expect("ours");
    }
    let t = median(t);
    println!("{}: median of {rounds}; T = {t:.3} s", file.display());
    let line = |name: &str, seconds: f64| println!("  {name:12} {seconds:8.3} s = {:6.2} T", seconds / t);
    for node in &order {
        let name = node["name"].as_str().expect("a name");
        line(name, median(nodes[name].clone()));
    }
    line("whole, cold", median(cold));
    println!("  peak memory {:8.1} MB", median(peaks) / 1e6);
    println!("  again       {:8.1} ms, then {:.1} ms", 1e3 * median(again.iter().map(|a| a[0]).collect()), {
        1e3 * median(again.iter().map(|a| a[1]).collect())
    });
}
