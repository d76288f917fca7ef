//! What the levels lose: buildings over which nothing stands, and streets that are built over.
//!
//! Street points are a fixed sample of the plan, 4 to 25 m from the nearest footprint: some points in each cell that
//! has a footprint near, at places that hang on the cell alone. At most about 30,000 are tried, whatever the city.

use rayon::prelude::*;

use super::build::{Built, Drawn};
use super::city::City;
use super::forms::Shape;
use crate::artifact::tile_tree::Level;
use crate::artifact::{Footprints, Shapes};
use crate::geom::Point;
use crate::geom::bounds::Bounds;
use crate::geom::cover::Cover;

const NEAR_MM: i64 = 4_000;
const FAR_MM: i64 = 25_000;
const TRIED: usize = 30_000;

/// Points of the streets, in cells.
pub struct Street {
    grid: Grid,
    /// cells + 1 offsets into `points`.
    starts: Vec<u32>,
    pub points: Vec<Point>,
}

/// Square cells over a box.
#[derive(Clone, Copy)]
struct Grid {
    low: Point,
    cell: i64,
    columns: usize,
    rows: usize,
}

impl Grid {
    /// Cells of at least 50 m, at most about 1,000 each way.
    fn over(bounds: Bounds) -> Self {
        let reach = |k: usize| i64::from(bounds.high[k]) - i64::from(bounds.low[k]) + 1;
        let cell = (reach(0).max(reach(1)) / 1000).max(2 * FAR_MM);
        let count = |k: usize| ((reach(k) - 1) / cell + 1) as usize;
        Self { low: bounds.low, cell, columns: count(0), rows: count(1) }
    }

    /// Numbers of the cells that a box meets, row by row.
    fn cells(self, b: Bounds) -> impl Iterator<Item = usize> {
        let place = |v: i32, k: usize, count: usize| {
            ((i64::from(v) - i64::from(self.low[k])).div_euclid(self.cell)).clamp(0, count as i64 - 1) as usize
        };
        let (x0, x1) = (place(b.low[0], 0, self.columns), place(b.high[0], 0, self.columns));
        let (y0, y1) = (place(b.low[1], 1, self.rows), place(b.high[1], 1, self.rows));
        (y0..=y1).flat_map(move |y| (x0..=x1).map(move |x| y * self.columns + x))
    }
}

/// Sorts things that lie in cells: offsets, and the things' numbers cell by cell.
fn sorted(cells: usize, all: &[(usize, u32)]) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; cells + 1];
    all.iter().for_each(|&(c, _)| starts[c + 1] += 1);
    (0..cells).for_each(|c| starts[c + 1] += starts[c]);
    let mut next = starts.clone();
    let mut out = vec![0; all.len()];
    for &(c, i) in all {
        out[next[c] as usize] = i;
        next[c] += 1;
    }
    (starts, out)
}

impl Street {
    pub fn of(footprints: &Footprints) -> Self {
        let boxes: Vec<Bounds> = (0..footprints.len()).into_par_iter().map(|i| around(footprints, i)).collect();
        let is_street = |near: &[u32], p| is_street(footprints, &boxes, near, p);
        let all = boxes.iter().filter(|b| !b.is_empty()).flat_map(|b| [b.low, b.high]);
        let bounds = Bounds::of(all);
        if bounds.is_empty() {
            return Self {
                grid: Grid { low: [0; 2], cell: 1, columns: 0, rows: 0 },
                starts: vec![0],
                points: Vec::new(),
            };
        }
        let grid = Grid::over(bounds);
        let mut near: Vec<(usize, u32)> = Vec::with_capacity(2 * boxes.len());
        for (i, &b) in boxes.iter().enumerate().filter(|(_, b)| !b.is_empty()) {
            near.extend(grid.cells(b).map(|c| (c, i as u32)));
        }
        let cells = grid.columns * grid.rows;
        let (starts, buildings) = sorted(cells, &near);
        let in_cell = |c: usize| &buildings[starts[c] as usize..starts[c + 1] as usize];
        let occupied: Vec<usize> = (0..cells).filter(|&c| !in_cell(c).is_empty()).collect();
        // So many points in each of these cells, or one in every so manyth.
        let each = (TRIED / occupied.len()).max(1);
        let every = (occupied.len() / TRIED).max(1);
        let tried: Vec<usize> = occupied.into_iter().filter(|&c| mix(c as u64).is_multiple_of(every as u64)).collect();
        let found: Vec<(usize, Point)> = tried
            .into_par_iter()
            .flat_map_iter(|c| {
                let low = [c % grid.columns, c / grid.columns];
                (0..each).filter_map(move |i| {
                    let h = mix(mix(c as u64) ^ i as u64);
                    let part = [h & 0xffff_ffff, h >> 32].map(|v| ((v as u128 * grid.cell as u128) >> 32) as i64);
                    let p = [0, 1].map(|k| (i64::from(grid.low[k]) + low[k] as i64 * grid.cell + part[k]) as i32);
                    is_street(in_cell(c), p).then_some((c, p))
                })
            })
            .collect();
        let numbered: Vec<(usize, u32)> = found.iter().enumerate().map(|(i, &(c, _))| (c, i as u32)).collect();
        let (starts, order) = sorted(cells, &numbered);
        Self { grid, starts, points: order.iter().map(|&i| found[i as usize].1).collect() }
    }

    /// False where no point can lie within the box of some rings.
    fn is_near<'a>(&self, rings: impl Iterator<Item = &'a [Point]>) -> bool {
        let bounds = Bounds::of(rings.flatten().copied());
        if self.points.is_empty() || bounds.is_empty() {
            return false;
        }
        let in_cell = |c: usize| self.starts[c] as usize..self.starts[c + 1] as usize;
        self.grid.cells(bounds).any(|c| self.points[in_cell(c)].iter().any(|&p| bounds.contains(p)))
    }

    /// Numbers of the points that a region covers.
    fn covered(&self, cover: &Cover, out: &mut Vec<u32>) {
        if self.points.is_empty() || cover.bounds.is_empty() {
            return;
        }
        for c in self.grid.cells(cover.bounds) {
            let all = self.starts[c]..self.starts[c + 1];
            out.extend(all.filter(|&i| cover.holds(self.points[i as usize])));
        }
    }
}

/// The box of a building's points, wider by the reach of a street.
fn around(footprints: &Footprints, i: usize) -> Bounds {
    let b = Bounds::of(footprints.polygons.shells(i).flatten().copied());
    if b.is_empty() {
        return b;
    }
    let reach = FAR_MM as i32;
    Bounds { low: b.low.map(|v| v - reach), high: b.high.map(|v| v + reach) }
}

/// True where the nearest of these buildings is 4 to 25 m away; `boxes` reach 25 m around each.
fn is_street(footprints: &Footprints, boxes: &[Bounds], near: &[u32], p: Point) -> bool {
    let polygons = &footprints.polygons;
    let mut nearest = i64::MAX;
    for &b in near.iter().filter(|&&b| boxes[b as usize].contains(p)) {
        let rings = polygons.polygons_of(b as usize).flat_map(|g| polygons.rings_of(g)).map(|r| polygons.ring(r));
        let mut odd = false;
        for ring in rings {
            let Some(&last) = ring.last() else { continue };
            let mut a = last;
            for &b in ring {
                nearest = nearest.min(squared_distance(a, b, p));
                if (a[1] > p[1]) != (b[1] > p[1]) {
                    odd ^= (crate::geom::predicates::orient(a, b, p) > 0) == (b[1] > a[1]);
                }
                a = b;
            }
        }
        if odd || nearest < NEAR_MM * NEAR_MM {
            return false;
        }
    }
    nearest <= FAR_MM * FAR_MM
}

/// Squared distance of a point from a segment, in mm2, rounded down.
fn squared_distance(a: Point, b: Point, p: Point) -> i64 {
    let to = |q: Point| [0, 1].map(|k| i64::from(p[k]) - i64::from(q[k]));
    let edge = [0, 1].map(|k| i64::from(b[k]) - i64::from(a[k]));
    let (from, length) = (to(a), edge[0] * edge[0] + edge[1] * edge[1]);
    let along = from[0] * edge[0] + from[1] * edge[1];
    if along <= 0 || length == 0 {
        return from[0] * from[0] + from[1] * from[1];
    }
    if along >= length {
        let from = to(b);
        return from[0] * from[0] + from[1] * from[1];
    }
    let across = i128::from(from[0] * edge[1] - from[1] * edge[0]);
    (across * across / i128::from(length)).min(i128::from(i64::MAX)) as i64
}

/// Splitmix64: a number that hangs on a cell alone.
fn mix(v: u64) -> u64 {
    let z = v.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// What a cut leaves bare and what it closes: buildings over which nothing stands (no vertex of their outline lies in
/// what is drawn for them, and of a rectangle no part of them does), and the street points built over.
pub fn covered(city: &City, street: &Street, drawn: &[Drawn], plans: &Shapes<Point>) -> (u64, Vec<u32>) {
    let (mut lost, mut closed) = (0, Vec::new());
    for (i, d) in drawn.iter().enumerate() {
        let alone = city.is_leaf(d.node);
        if alone && !d.landmark && !stands(city, d) {
            lost += 1;
        }
        // Originals stand on their own ground, 4 m and more from any street point.
        if matches!(d.shape, Shape::Original | Shape::Footprint) || (alone && !street.is_near(plans.shells(i))) {
            continue;
        }
        let cover = Cover::new(plans.shells(i));
        street.covered(&cover, &mut closed);
        if alone {
            continue;
        }
        let landmarks = drawn[i + 1..].iter().take_while(|d| d.landmark).map(|d| city.first(d.node));
        let mut beside = landmarks.peekable();
        for place in city.places(d.node) {
            if beside.next_if_eq(&place).is_none()
                && !cover.holds(city.corner[place])
                && !city.outline(place).flatten().any(|&p| cover.holds(p))
            {
                lost += 1;
            }
        }
    }
    closed.sort_unstable();
    closed.dedup();
    (lost, closed)
}

/// True where something of a single building's form stands over it.
fn stands(city: &City, d: &Drawn) -> bool {
    match d.shape {
        Shape::Rectangle => d.negative_space < 2.0 * city.built(d.node),
        _ => d.triangles > 0 && city.built(d.node) > 0.0,
    }
}

/// The report: level d is the whole city as tiles of depth d show it, and leaves above that depth.
pub fn report(city: &City, root: &Built, street: &Street) -> Vec<Level> {
    let mut out = Vec::new();
    let mut shown: Vec<&Built> = vec![root];
    loop {
        let mut level = Level { depth: out.len() as u32, tiles: shown.len() as u32, ..Level::default() };
        let mut closed = vec![false; street.points.len()];
        for t in &shown {
            level.features += t.feature_count(city) as u64;
            level.triangles += t.triangles;
            level.error_max = level.error_max.max(t.error);
            level.lost += t.lost;
            t.closed.iter().for_each(|&i| closed[i as usize] = true);
        }
        let count = closed.iter().filter(|&&c| c).count();
        level.closed = count as f64 / street.points.len().max(1) as f64;
        out.push(level);
        if shown.iter().all(|t| t.is_leaf) {
            return out;
        }
        shown = shown.into_iter().flat_map(|t| if t.is_leaf { vec![t] } else { t.children.iter().collect() }).collect();
    }
}
