//! What every figure is a ratio to: T = gunzip and serde_json into typed structs of tokyo_setagaya.geojson.gz, line
//! by line, on one thread. It stays as it is, whatever our own reader does.

#![allow(dead_code)]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Deserialize;

use lodge::artifact::{Attributes, Footprints, Lines, Shapes, Strings};
use lodge::geom::Point;
use lodge::geom::frame::Frame;

#[derive(Deserialize)]
pub struct Feature {
    pub properties: Properties,
    pub geometry: Geometry,
}

#[derive(Deserialize)]
pub struct Properties {
    pub id: Option<String>,
    pub osm: Option<String>,
    pub layer: Option<String>,
    pub height: Option<f64>,
}

#[derive(Deserialize)]
#[serde(tag = "type", content = "coordinates")]
pub enum Geometry {
    Point([f64; 2]),
    LineString(Vec<[f64; 2]>),
    MultiLineString(Vec<Vec<[f64; 2]>>),
    Polygon(Vec<Vec<[f64; 2]>>),
    MultiPolygon(Vec<Vec<Vec<[f64; 2]>>>),
}

/// The folder of test data, or a line and nothing.
pub fn data(file: &str) -> Option<PathBuf> {
    match std::env::var_os("LODGE_DATA") {
        Some(folder) => Some(PathBuf::from(folder).join("buildings").join(file)),
        None => {
            println!("skipped: LODGE_DATA is not set");
            None
        }
    }
}

pub fn features(file: &PathBuf, mut each: impl FnMut(Feature)) {
    let bytes = std::fs::File::open(file).expect("the data is there");
    let mut lines = BufReader::with_capacity(1 << 16, flate2::bufread::GzDecoder::new(BufReader::new(bytes)));
    let mut line = String::new();
    while lines.read_line(&mut line).expect("the data is sound") > 0 {
        let text = line.trim_end().trim_end_matches(',');
        if text.starts_with("{\"type\":\"Feature\",") {
            each(serde_json::from_str(text).expect("the data is sound"));
        }
        line.clear();
    }
}

/// T, the best of five: wall and CPU time.
pub fn yardstick() -> Option<(Duration, Duration)> {
    let file = data("tokyo_setagaya.geojson.gz")?;
    Some(measure(5, || parse(&file)))
}

/// What T is the time of: every feature of tokyo_setagaya with its id, height and coordinates.
pub fn parse(file: &Path) -> usize {
    #[derive(Deserialize)]
    struct Typed<'a> {
        #[serde(borrow)]
        properties: Known<'a>,
        geometry: Geometry,
    }
    #[derive(Deserialize)]
    struct Known<'a> {
        id: &'a str,
        height: f64,
    }
    let bytes = std::fs::File::open(file).expect("the data is there");
    let mut text = BufReader::with_capacity(1 << 18, flate2::read::GzDecoder::new(bytes));
    let (mut line, mut all) = (Vec::new(), Vec::new());
    while text.read_until(b'\n', &mut line).expect("the data is sound") > 0 {
        let json = line.trim_ascii_end();
        let json = json.strip_suffix(b",").unwrap_or(json);
        if json.starts_with(b"{\"type\":\"Feature\",") {
            let f: Typed = serde_json::from_slice(json).expect("the data is sound");
            all.push((f.properties.id.to_string(), f.properties.height, f.geometry));
        }
        line.clear();
    }
    assert_eq!(all.len(), 127_212);
    all.len()
}

/// A city, roughly: a plain equirectangular projection around the first coordinate, millimetres. Layers apart from
/// `building` (and files without layers) become lines.
pub fn city(file: &PathBuf) -> (Footprints, Lines) {
    let mut origin = None;
    let mut local = |p: [f64; 2]| -> Point {
        let o: [f64; 2] = *origin.get_or_insert(p);
        let east = 111_320_000.0 * libm::cos(o[1].to_radians());
        [((p[0] - o[0]) * east).round() as i32, ((p[1] - o[1]) * 111_132_000.0).round() as i32]
    };
    let mut ring_of = |ring: &[[f64; 2]]| -> Vec<Point> {
        let mut out: Vec<Point> = ring.iter().map(|&p| local(p)).collect();
        out.dedup();
        out
    };
    let mut polygons = Shapes::default();
    let mut ids = Strings::default();
    let (mut starts, mut points, mut names) = (vec![0], Vec::new(), Strings::default());
    features(file, |f| {
        let layer = f.properties.layer.as_deref().unwrap_or("building");
        let id = f.properties.id.or(f.properties.osm).unwrap_or_default();
        let parts = match f.geometry {
            Geometry::Polygon(p) if layer == "building" => vec![p],
            Geometry::MultiPolygon(p) if layer == "building" => p,
            Geometry::LineString(line) if layer == "road" || layer == "rail" => {
                points.extend(ring_of(&line));
                starts.push(points.len() as u32);
                names.push(&id);
                return;
            }
            _ => return,
        };
        for part in &parts {
            for ring in part {
                let mut ring = ring_of(ring);
                if ring.len() > 1 && ring[0] == ring[ring.len() - 1] {
                    ring.pop();
                }
                if lodge::geom::ring::doubled_area(&ring) < 0 {
                    ring.reverse();
                }
                polygons.push_ring(&ring);
            }
            polygons.end_polygon();
        }
        polygons.end_shape();
        ids.push(&id);
    });
    let lines = Lines { frame: Frame::local(), ids: names, starts, points };
    (footprints(ids, polygons), lines)
}

pub fn footprints(ids: Strings, polygons: Shapes<Point>) -> Footprints {
    let n = ids.len();
    Footprints {
        frame: Frame::local(),
        ids,
        polygons,
        base: vec![0.0; n],
        top: vec![3.0; n],
        attributes: Attributes::default(),
    }
}

/// The city eight times side by side (4 x 2), every building moved by up to 2 cm.
pub fn eight_times(one: &Footprints) -> Footprints {
    let points = &one.polygons.points;
    let span = |k: usize| {
        let (low, high) = points.iter().fold((i32::MAX, i32::MIN), |(l, h), p| (l.min(p[k]), h.max(p[k])));
        high - low + 50_000
    };
    let step = [span(0), span(1)];
    let mut dice = Dice(8);
    let mut polygons = Shapes::default();
    let mut ids = Strings::default();
    for copy in 0..8 {
        for i in 0..one.len() {
            let by = [step[0] * (copy % 4) + dice.below(41) - 20, step[1] * (copy / 4) + dice.below(41) - 20];
            for p in one.polygons.polygons_of(i) {
                for r in one.polygons.rings_of(p) {
                    let ring: Vec<Point> = one.polygons.ring(r).iter().map(|q| [q[0] + by[0], q[1] + by[1]]).collect();
                    polygons.push_ring(&ring);
                }
                polygons.end_polygon();
            }
            polygons.end_shape();
            ids.push(&format!("{}-{copy}", one.ids.get(i)));
        }
    }
    footprints(ids, polygons)
}

/// The same numbers everywhere.
pub struct Dice(pub u64);

impl Dice {
    pub fn below(&mut self, n: i32) -> i32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (((self.0 >> 33) * n as u64) >> 31) as i32
    }
}

/// Wall time and CPU time of all threads, each the best of `times`.
pub fn measure<T>(times: usize, mut work: impl FnMut() -> T) -> (Duration, Duration) {
    let mut best = (Duration::MAX, Duration::MAX);
    for _ in 0..times {
        let (cpu, start) = (cpu_time(), Instant::now());
        let result = work();
        let (wall, cpu) = (start.elapsed(), cpu_time() - cpu);
        drop(result);
        best = (best.0.min(wall), best.1.min(cpu));
    }
    best
}

/// Nanoseconds on a core, summed over the threads there are; zero where the system does not say.
fn cpu_time() -> Duration {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let of = |path: PathBuf| -> Option<u64> {
        std::fs::read_to_string(path.join("schedstat")).ok()?.split(' ').next()?.parse().ok()
    };
    Duration::from_nanos(tasks.filter_map(|t| of(t.path())).sum())
}
