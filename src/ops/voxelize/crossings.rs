//! Where a mesh crosses the edges of a grid, exactly.
//!
//! Vertices are snapped to 2^-16 of a cell; edge functions are i64, heights i128 where f64 cannot decide. A node on
//! the shared edge of two triangles belongs to one of them (as if it lay a little off, by e to the right and e^2 up),
//! so that closed meshes are crossed an even number of times on every line.

use std::cmp::Ordering;

use rayon::prelude::*;

use crate::geom::space::dot;

/// Parts of a cell.
pub const UNIT: i64 = 1 << 16;

/// A mesh on the grid.
pub struct Snapped {
    /// In parts of a cell from node (0, 0, 0).
    pub vertices: Vec<[i32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// Crossings of the grid edges along one axis, ascending; see [`Crossing`].
pub type Crossings = Vec<Crossing>;

/// Lower node as z, y, x of 11 bits each, then: how far along the edge in parts of [`LONG`] (0 and half of it only where it
/// is exact), then 1 where the ray comes in (0: goes out), then the triangle's normal (see [`octahedral`]).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct Crossing(u64);

/// Bits of a node's numbers.
const NODE: u32 = 11;
/// Nodes at most along a side of the grid.
pub const NODES: usize = 1 << NODE;
/// Bits of each of the two numbers of a normal, and what stands for 1: halves, thirds and quarters are exact.
const NORMAL: u32 = 9;
const ONE: f64 = 252.0;
/// Bits of how far along its edge a crossing is, and the edge.
const ALONG: u32 = 12;
const LONG: i64 = 1 << ALONG;
const COMES_IN: u32 = 2 * NORMAL;
/// Where along the edge begins, and the node.
const FROM_ALONG: u32 = COMES_IN + 1;
const FROM_NODE: u32 = FROM_ALONG + ALONG;

impl Crossing {
    fn new([x, y, z]: [usize; 3], comes_in: bool, along: i64, normal: u64) -> Self {
        let node = (z as u64) << (2 * NODE) | (y as u64) << NODE | x as u64;
        Self(node << FROM_NODE | (along as u64) << FROM_ALONG | u64::from(comes_in) << COMES_IN | normal)
    }
    /// x, y, z of the edge's lower node.
    pub fn node(self) -> [usize; 3] {
        [0, 1, 2].map(|k| (self.0 >> (FROM_NODE + k * NODE)) as usize & ((1 << NODE) - 1))
    }
    /// How far from the lower node, in cells; within 2^-12, but 0 and one half only where they are exact.
    pub fn along(self) -> f64 {
        (self.0 >> FROM_ALONG & (LONG as u64 - 1)) as f64 / LONG as f64
    }
    /// +1 where a ray along the axis comes in, -1 where it goes out.
    pub fn step(self) -> i32 {
        if self.0 >> COMES_IN & 1 == 1 { 1 } else { -1 }
    }
    pub fn place(self) -> Place {
        match (self.0 >> FROM_ALONG) as i64 & (LONG - 1) {
            0 => Place::OnNode,
            along => match along.cmp(&(LONG / 2)) {
                Ordering::Less => Place::Lower,
                Ordering::Equal => Place::Half,
                Ordering::Greater => Place::Upper,
            },
        }
    }
    /// The cosine of the angle between two triangles' normals, each on the side to which the axis runs; within 0.02.
    pub fn cosine(self, other: Self) -> f64 {
        let (a, b) = (self.normal(), other.normal());
        dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
    }
    /// The triangle's normal on the side to which the axis runs, along the next axis, the one after it and the axis
    /// itself; their sizes add up to one. Within 0.002 each, the last within 0.004.
    pub fn normal(self) -> [f64; 3] {
        let [u, v] = [0, NORMAL].map(|shift| (self.0 >> shift & ((1 << NORMAL) - 1)) as f64 / ONE - 1.0);
        [u, v, 1.0 - u.abs() - v.abs()]
    }
    /// z of the lower node.
    pub fn slice(self) -> usize {
        (self.0 >> (FROM_NODE + 2 * NODE)) as usize
    }
}

/// Where on its edge a crossing lies.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Place {
    Lower,
    Half,
    Upper,
    /// On the lower node.
    OnNode,
}

/// All crossings of a mesh, and the nodes that lie on it.
pub struct Hits {
    /// Along x, y, z.
    pub axes: [Crossings; 3],
    /// Nodes on the surface, as z, y, x of 16 bits each, ascending, each once.
    pub on: Vec<u64>,
}

/// x, y, z of a node in [`Hits::on`].
pub fn node_of(key: u64) -> [usize; 3] {
    [0, 16, 32].map(|shift| (key >> shift) as usize & 0xffff)
}
pub fn key_of([x, y, z]: [usize; 3]) -> u64 {
    (z as u64) << 32 | (y as u64) << 16 | x as u64
}

/// Every edge's crossings with every triangle. `flip`: the mesh is inside out.
pub fn of(mesh: &Snapped, flip: bool) -> Hits {
    let parts: Vec<([Crossings; 3], Vec<u64>)> = mesh
        .triangles
        .par_chunks(8192)
        .map(|triangles| {
            let (mut axes, mut on): ([Crossings; 3], Vec<u64>) = Default::default();
            for t in triangles {
                let corners = t.map(|v| mesh.vertices[v as usize]);
                for (axis, out) in axes.iter_mut().enumerate() {
                    cross(&corners, axis, flip, out, &mut on);
                }
            }
            (axes, on)
        })
        .collect();
    let (mut axes, mut on): ([Crossings; 3], Vec<u64>) = Default::default();
    for (part, part_on) in parts {
        axes.iter_mut().zip(part).for_each(|(all, some)| all.extend(some));
        on.extend(part_on);
    }
    axes.par_iter_mut().for_each(|all| all.sort_unstable());
    on.sort_unstable();
    on.dedup();
    Hits { axes, on }
}

/// First and last node between two places.
fn nodes(low: i32, high: i32) -> (i64, i64) {
    ((i64::from(low) + UNIT - 1) >> 16, i64::from(high) >> 16)
}

fn cross(corners: &[[i32; 3]; 3], axis: usize, flip: bool, out: &mut Crossings, on: &mut Vec<u64>) {
    let (iu, iv) = ((axis + 1) % 3, (axis + 2) % 3);
    let [a, mut b, mut c] = *corners;
    let range = |i: usize| nodes(a[i].min(b[i]).min(c[i]), a[i].max(b[i]).max(c[i]));
    let ((u0, u1), (v0, v1)) = (range(iu), range(iv));
    if u0 > u1 || v0 > v1 {
        return;
    }
    let at = |p: &[i32; 3]| [i64::from(p[iu]), i64::from(p[iv])];
    let doubled = |a: [i64; 2], b: [i64; 2], c: [i64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let mut area = doubled(at(&a), at(&b), at(&c));
    if area == 0 {
        return;
    }
    // A face that looks along the axis is where a ray goes out.
    let comes_in = (area < 0) != flip;
    if area < 0 {
        std::mem::swap(&mut b, &mut c);
        area = -area;
    }
    let normal = octahedral([[a[iu], a[iv], a[axis]], [b[iu], b[iv], b[axis]], [c[iu], c[iv], c[axis]]]);
    let ends = [(at(&b), at(&c)), (at(&c), at(&a)), (at(&a), at(&b))];
    let heights = [a, b, c].map(|p| i64::from(p[axis]));
    let edges = ends.map(|(p, q)| ([q[0] - p[0], q[1] - p[1]], p));
    let holds_edge = edges.map(|(d, _)| d[1] < 0 || d[1] == 0 && d[0] > 0);
    for v in v0..=v1 {
        // Each edge's value at u = 0 of this row, and what a node further adds.
        let row = edges.map(|(d, p)| (d[0] * (v * UNIT - p[1]) + d[1] * p[0], -d[1] * UNIT));
        let (mut first, mut last) = (u0, u1);
        if u1 - u0 > 3 {
            for (start, step) in row {
                // start + step u >= 0
                if step > 0 {
                    first = first.max(-start.div_euclid(step));
                } else if step < 0 {
                    last = last.min(start.div_euclid(-step));
                } else if start < 0 {
                    last = first - 1;
                }
            }
        }
        for u in first..=last {
            let e = row.map(|(start, step)| start + step * u);
            if e.iter().any(|&e| e < 0) {
                continue;
            }
            let inside = (0..3).all(|i| e[i] > 0 || holds_edge[i]);
            let (whole, along) = height(e, heights, area);
            let mut node = [0; 3];
            (node[iu], node[iv], node[axis]) = (u as usize, v as usize, whole as usize);
            if along == 0 {
                on.push(key_of(node));
            }
            if inside {
                out.push(Crossing::new(node, comes_in, along, normal));
            }
        }
    }
}

/// The normal of a triangle that turns clockwise as one looks along the third axis, on the upper half of the octahedron
/// (octahedral encoding): scaled so that its numbers' sizes add up to one, without the third, which is never negative;
/// whole numbers from 0, for -1, to twice [`ONE`].
fn octahedral([a, b, c]: [[i32; 3]; 3]) -> u64 {
    let side = |p: [i32; 3]| [0, 1, 2].map(|k| f64::from(p[k]) - f64::from(a[k]));
    let normal = crate::geom::space::cross(side(b), side(c));
    let size: f64 = normal.iter().map(|n| n.abs()).sum();
    let [u, v] = [0, 1].map(|k| ((normal[k] / size * ONE).round() + ONE) as u64);
    u | v << NORMAL
}

/// The node below the triangle's height where its edge functions are `e`, and how far above it the triangle is in parts
/// of [`LONG`]: 0 and half of it only where that is exact.
fn height(e: [i64; 3], heights: [i64; 3], area: i64) -> (i64, i64) {
    let about = (0..3).map(|i| e[i] as f64 * heights[i] as f64).sum::<f64>() / area as f64;
    // Parts of a cell; off by less than 2^-20.
    let halves = about / (UNIT / 2) as f64;
    let near = halves.round();
    let between = |along: i64, is_upper: bool| {
        let first = if is_upper { LONG / 2 } else { 0 };
        along.clamp(first + 1, first + LONG / 2 - 1)
    };
    if (halves - near).abs() * (UNIT / 2) as f64 > 0.001 {
        let half = halves.floor() as i64;
        let along = ((halves - (half & !1) as f64) * (LONG / 2) as f64).round() as i64;
        return (half >> 1, between(along, half & 1 == 1));
    }
    let sum: i128 = (0..3).map(|i| i128::from(e[i]) * i128::from(heights[i])).sum();
    let cell = i128::from(area) * i128::from(UNIT);
    let whole = sum.div_euclid(cell);
    let rest = 2 * sum.rem_euclid(cell);
    let along = (rest * i128::from(LONG / 2) / cell) as i64;
    let along = match rest.cmp(&cell) {
        _ if rest == 0 => 0,
        Ordering::Less => between(along, false),
        Ordering::Equal => LONG / 2,
        Ordering::Greater => between(along, true),
    };
    (whole as i64, along)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eighths lie half way between two codes.
    #[test]
    fn normals_are_mirrored() {
        let along_u = |p: i32| octahedral([[0; 3], [5, 0, -p], [0, 5, -2]]) & ((1 << NORMAL) - 1);
        assert_eq!([along_u(1), along_u(-1)], [252 + 32, 252 - 32]);
    }

    /// Two roofs over an edge of the grid, of all pitches and turns.
    #[test]
    fn normals_are_known_of_crossings() {
        for axis in 0..3 {
            let roof = |pitch: f64, turn: f64| {
                let slope = libm::tan(pitch);
                let (s, c) = (libm::sin(turn) * slope, libm::cos(turn) * slope);
                let corner = |u: f64, v: f64| {
                    let mut out = [0; 3];
                    let z = 3.4 + s * (u - 3.0) + c * (v - 3.0);
                    (out[(axis + 1) % 3], out[(axis + 2) % 3], out[axis]) =
                        ((u * UNIT as f64) as i32, (v * UNIT as f64) as i32, (z * UNIT as f64) as i32);
                    out
                };
                let mut found = Vec::new();
                let corners = [corner(2.5, 2.5), corner(3.6, 2.6), corner(2.9, 3.5)];
                cross(&corners, axis, false, &mut found, &mut Vec::new());
                let of_node = |c: &&Crossing| c.node() == [3; 3];
                (*found.iter().find(of_node).expect("it lies over the node"), [-s, -c, 1.0])
            };
            for (pitch, turn) in [(0.0, 0.0), (0.3, 1.0), (0.7, 2.0), (1.0, 4.0), (1.2, 5.5), (1.35, 0.4)] {
                for (other, way) in [(0.0, 0.0), (0.5, 3.0), (0.8, 1.5), (1.3, 3.6)] {
                    let ((a, m), (b, n)) = (roof(pitch, turn), roof(other, way));
                    let cosine = dot(m, n) / (dot(m, m) * dot(n, n)).sqrt();
                    assert!((a.cosine(b) - cosine).abs() < 0.02, "{pitch}, {turn} to {other}, {way}: {cosine}");
                }
            }
        }
    }
}
