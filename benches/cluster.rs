//! The figures of `cluster`, as ratios to T (see `support`): `LODGE_DATA=.. cargo bench --bench cluster [-- NAME]`.

mod support;

use std::time::Duration;

use lodge::artifact::{Footprints, Strings};
use lodge::geom::Point;
use lodge::op::NEVER;
use lodge::ops::cluster::{Cluster, Distance, cluster};
use support::{Dice, city, data, eight_times, footprints, measure, yardstick};

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let wants = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w.as_str()));
    let Some((t, t_cpu)) = yardstick() else { return };
    println!("T = {:.3} s wall, {:.3} s CPU", t.as_secs_f64(), t_cpu.as_secs_f64());
    let line = |name: &str, n: usize, (wall, cpu): (Duration, Duration)| {
        let (w, c) = (wall.as_secs_f64(), cpu.as_secs_f64());
        println!(
            "{name:32} {n:9} wall {w:7.3} s = {:6.2} T, cpu {c:7.3} s = {:6.2} T, {:6.2} us each",
            w / t.as_secs_f64(),
            c / t_cpu.as_secs_f64(),
            c * 1e6 / n as f64
        );
    };
    // Made once: the CPU time of threads that end would be lost.
    let pools = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads"));
    let with = |threads: usize, times: usize, all: &Footprints, barriers: &[[Point; 2]], how: &Cluster| {
        measure(times, || pools[threads - 1].install(|| cluster(all, barriers.to_vec(), how, &NEVER)))
    };
    let how = Cluster::default();

    if wants("setagaya") || wants("eight") || wants("gaps") {
        let (all, _) = city(&data("tokyo_setagaya.geojson.gz").expect("checked above"));
        for threads in [1, 2] {
            if wants("setagaya") {
                line(&format!("setagaya, {threads} threads"), all.len(), with(threads, 3, &all, &[], &how));
            }
        }
        if wants("gaps") {
            let how = Cluster { distance: Distance::Footprint, ..Cluster::default() };
            line("setagaya, gaps, 2 threads", all.len(), with(2, 1, &all, &[], &how));
        }
        if wants("eight") {
            let eight = eight_times(&all);
            for threads in [1, 2] {
                line(&format!("eight, {threads} threads"), eight.len(), with(threads, 1, &eight, &[], &how));
            }
        }
    }
    if wants("liechtenstein") {
        let (all, lines) = city(&data("liechtenstein_osm.geojson.gz").expect("checked above"));
        let barriers: Vec<[Point; 2]> =
            (0..lines.len()).flat_map(|i| lines.line(i).windows(2).map(|w| [w[0], w[1]])).collect();
        line("liechtenstein", all.len(), with(1, 5, &all, &[], &how));
        line(&format!("its {} barriers", barriers.len()), all.len(), with(1, 5, &all, &barriers, &how));
    }
    for (name, centres) in layouts() {
        if wants(name) || wants("layouts") {
            line(name, centres.len(), with(1, 2, &dots(&centres), &[], &how));
        }
    }
}

fn layouts() -> Vec<(&'static str, Vec<Point>)> {
    let n = 122_500i32;
    let mut dice = Dice(1);
    let mut random =
        |n: i32, side: i32| -> Vec<Point> { (0..n).map(|_| [dice.below(side), dice.below(side)]).collect() };
    let uniform = random(n, 6_000_000);
    let sites = random(100, 6_000_000);
    let places = random(50, 60_000_000);
    let near = random(n, 300_000);
    let circle = |i: i32| {
        let turn = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        [(libm::cos(turn) * 3e8) as i32, (libm::sin(turn) * 3e8) as i32]
    };
    let square = |i: i32| {
        let i = i64::from(i - n / 2);
        [((i * i * i.signum()) / 8) as i32, 0]
    };
    vec![
        ("uniform", uniform),
        ("exact grid", (0..n).map(|i| [i % 350 * 17_000, i / 350 * 17_000]).collect()),
        ("rows", (0..n).map(|i| [i % 3500 * 10_000, i / 3500 * 100_000]).collect()),
        ("i^2 line", (0..n).map(square).collect()),
        ("100 sites", (0..n).map(|i| sites[(i % 100) as usize]).collect()),
        ("circle", (0..n).map(circle).collect()),
        ("50 towns", {
            let put = |i: i32| -> Point {
                let (p, q) = (places[(i % 50) as usize], near[i as usize]);
                [p[0] + q[0], p[1] + q[1]]
            };
            (0..n).map(put).collect()
        }),
    ]
}

fn dots(centres: &[Point]) -> Footprints {
    let mut polygons = lodge::artifact::Shapes::default();
    for &[x, y] in centres {
        polygons.push_ring(&[[x - 1, y - 1], [x + 1, y - 1], [x + 1, y + 1], [x - 1, y + 1]]);
        polygons.end_polygon();
        polygons.end_shape();
    }
    footprints((0..centres.len()).map(|i| i.to_string()).collect::<Strings>(), polygons)
}
