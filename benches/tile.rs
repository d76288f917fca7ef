//! From a city file to tiles, operator by operator: seconds (wall, and CPU of all threads), and the levels.
//!
//! `LODGE_DATA=.. cargo bench --bench tile [FILE] [-- fewest]`; FILE is a name below `buildings/` or a path (default
//! `tokyo_setagaya.geojson.gz`).

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use lodge::artifact::AnyArtifact;
use lodge::op::{Bench, Source};
use serde_json::{Value, json};

type Any = Arc<dyn AnyArtifact>;

/// Seconds of CPU that this process has used, in hundredths.
fn cpu() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

/// Runs an operator by name and says how long it took.
fn run(name: &str, params: Value, path: Option<&Path>, inputs: &[&Any]) -> Any {
    let entry = lodge::ops::ALL.get(name).unwrap();
    let op = (entry.build)(params).unwrap();
    let mut bench = Bench::default();
    if let Some(path) = path {
        let (name, file) = (path.file_name().unwrap().to_string_lossy().into_owned(), path.to_path_buf());
        let bytes = path.metadata().unwrap().len();
        bench.sources.push(Source {
            name,
            beside: false,
            bytes,
            open: Box::new(move || Ok(Box::new(std::fs::File::open(&file)?))),
        });
    }
    let (start, before) = (Instant::now(), cpu());
    // Ports that are left out take nothing.
    let ports = (0..entry.ports.len()).map(|p| inputs.get(p).map(|&a| a.clone()).into_iter().collect());
    let inputs = ports.collect::<Vec<Vec<Any>>>();
    let ports = if name == "cluster" { vec![inputs[0].clone(), Vec::new()] } else { inputs };
    let out = op.run(&bench.ctx(), ports).unwrap();
    println!("{name:16} {:6.3} s wall {:6.2} s cpu", start.elapsed().as_secs_f64(), cpu() - before);
    let mut facts = bench.report.finish().facts;
    facts.retain(|_, v| !v.is_array() && !v.is_object());
    println!("                 {}", json!(facts));
    out
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let Some(data) = std::env::var_os("LODGE_DATA") else {
        return println!("skipped: LODGE_DATA is not set");
    };
    let file = args.iter().find(|a| a.contains(".geojson")).map_or("tokyo_setagaya.geojson.gz", |a| a);
    let path = PathBuf::from(data).join("buildings").join(file);
    let prefer = if args.iter().any(|a| a == "fewest") { "fewest" } else { "least-error" };
    let read = run("read-geojson", json!({"path": "x"}), Some(&path), &[]);
    let tree = run("cluster", json!({}), None, &[&read]);
    let hulls = run("merge-hulls", json!({}), None, &[&read, &tree]);
    let marks = run("landmarks", json!({}), None, &[&read, &tree]);
    let tiles = run("tile", json!({"prefer": prefer}), None, &[&read, &tree, &hulls, &marks]);
    let summary = tiles.summary();
    println!("tiles {} leaves {} features {}", summary["tiles"], summary["leaf_tiles"], summary["features"]);
    println!("depth tiles features triangles   error_m  lost  closed");
    for l in summary["levels"].as_array().unwrap() {
        let f = |key: &str| l[key].as_f64().unwrap();
        println!(
            "{:5} {:5} {:8} {:9} {:9.2} {:5} {:6.2} %",
            l["depth"],
            l["tiles"],
            l["features"],
            l["triangles"],
            f("error_max"),
            l["lost"],
            100.0 * f("closed")
        );
    }
    run("write-tileset", json!({"path": "x"}), None, &[&tiles]);
}
