//! The yardstick T of the figures: gunzip and serde_json into typed structs, line by line, on one thread; and
//! read-geojson beside it.
//!
//! `LODGE_DATA=.. cargo bench --bench yardstick` prints seconds of the best of some rounds, taken in turns.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::time::Instant;

use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::read_geojson::ReadGeojson;
use serde::Deserialize;

#[derive(Deserialize)]
struct Feature<'a> {
    #[serde(borrow)]
    properties: Properties<'a>,
    geometry: Geometry,
}

#[derive(Deserialize)]
struct Properties<'a> {
    id: &'a str,
    height: f64,
}

#[derive(Deserialize)]
#[serde(tag = "type", content = "coordinates")]
enum Geometry {
    Polygon(Vec<Vec<[f64; 2]>>),
    MultiPolygon(Vec<Vec<Vec<[f64; 2]>>>),
}

/// Features and coordinates of a file of one feature a line.
fn yardstick(path: &Path) -> (usize, usize) {
    let file = std::fs::File::open(path).unwrap();
    let mut text = BufReader::with_capacity(1 << 18, flate2::read::GzDecoder::new(file));
    let (mut line, mut all, mut coordinates) = (Vec::new(), Vec::new(), 0);
    while text.read_until(b'\n', &mut line).unwrap() > 0 {
        let json = line.trim_ascii_end();
        let json = json.strip_suffix(b",").unwrap_or(json);
        if json.starts_with(b"{\"type\":\"Feature\",") {
            let f: Feature = serde_json::from_slice(json).unwrap();
            coordinates += match &f.geometry {
                Geometry::Polygon(p) => p.iter().map(Vec::len).sum::<usize>(),
                Geometry::MultiPolygon(p) => p.iter().flatten().map(Vec::len).sum(),
            };
            all.push((f.properties.id.to_string(), f.properties.height, f.geometry));
        }
        line.clear();
    }
    (all.len(), coordinates)
}

fn reader(path: &Path) -> usize {
    let (name, file) = (path.file_name().unwrap().to_string_lossy().into_owned(), path.to_path_buf());
    let mut bench = Bench::default();
    bench.sources.push(Source {
        name,
        bytes: path.metadata().unwrap().len(),
        open: Box::new(move || Ok(Box::new(std::fs::File::open(&file)?))),
    });
    let out = ReadGeojson::default().run(&bench.ctx(), Inputs::take(Vec::new()));
    out.unwrap().len()
}

fn main() {
    let Some(data) = std::env::var_os("LODGE_DATA") else {
        return println!("skipped: LODGE_DATA is not set");
    };
    let path = PathBuf::from(data).join("buildings/tokyo_setagaya.geojson.gz");
    let mut best = [f64::INFINITY; 2];
    for _ in 0..7 {
        let start = Instant::now();
        assert_eq!(yardstick(&path), (127_212, 1_022_632));
        best[0] = best[0].min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        assert_eq!(reader(&path), 127_212);
        best[1] = best[1].min(start.elapsed().as_secs_f64());
    }
    println!("T {:.3} s   read-geojson {:.3} s = {:.2} T", best[0], best[1], best[1] / best[0]);
}
