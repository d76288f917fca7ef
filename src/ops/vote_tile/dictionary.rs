//! Which black and white neighbourhoods of a stick a plane can make, and for which planes: one cone each.
//!
//! A neighbourhood is a box of nodes around the stick, in its own coordinates: u and v across, t along it, black end
//! (0, 0, 0), white end (0, 0, 1). A plane is a linear function g, black where g >= 0; it is written by its values at
//! the tetrahedron O = (0,0,0), P = (0,0,1), A = (1,0,0), B = (0,1,0), in which it is
//! g(u, v, t) = (1 - u - v - t) g(O) + t g(P) + u g(A) + v g(B).
//! Every node cuts the space of functions by a hyperplane; the cells of this arrangement with O black and P white are
//! the dictionary. Cells are held by extreme rays in exact integers and cut node by node (double description).
//! 5 x 5 x 4 nodes give 16,493 cells, 3 x 3 x 2 give 221: half of the source's counts, which also has the mirror.
//! Source: Andújar et al., section 3.2 and appendix; facets and rays of the cones are other than it says.

use std::hash::{BuildHasherDefault, Hasher};
use std::sync::OnceLock;

/// A function by its values at O, P, A, B.
pub type Ray = [i32; 4];

/// All neighbourhoods of one size.
pub struct Dictionary {
    /// Nodes reach from -across to across in u and v.
    pub across: i32,
    /// Nodes reach from -behind to behind + 1 in t.
    pub behind: i32,
    /// Black nodes as bits, ascending.
    pub patterns: Vec<u128>,
    /// n + 1 offsets into `facets`.
    facet_starts: Vec<u32>,
    /// Node numbers whose hyperplanes bound the cell.
    facets: Vec<u8>,
    /// n + 1 offsets into `rays`.
    ray_starts: Vec<u32>,
    rays: Vec<Ray>,
    /// Which of the cell's facets a ray lies on.
    on: Vec<u16>,
    find: Find,
}

/// The 5 x 5 x 4 neighbourhoods: 16,493.
pub fn large() -> &'static Dictionary {
    static LARGE: OnceLock<Dictionary> = OnceLock::new();
    LARGE.get_or_init(|| Dictionary::new(2, 1))
}

/// The 3 x 3 x 2 neighbourhoods: 221.
pub fn small() -> &'static Dictionary {
    static SMALL: OnceLock<Dictionary> = OnceLock::new();
    SMALL.get_or_init(|| Dictionary::new(1, 0))
}

impl Dictionary {
    /// Nodes from -across to across in u and v, from -behind to behind + 1 in t; at most 128.
    pub fn new(across: i32, behind: i32) -> Self {
        let mut out = Self {
            across,
            behind,
            patterns: Vec::new(),
            facet_starts: vec![0],
            facets: Vec::new(),
            ray_starts: vec![0],
            rays: Vec::new(),
            on: Vec::new(),
            find: Find::default(),
        };
        let nodes: Vec<[i32; 3]> = (0..out.nodes()).map(|i| out.node(i)).collect();
        let mut cells = enumerate(&nodes);
        let patterns: Vec<u128> = cells.iter().map(|cell| pattern(cell, &nodes)).collect();
        let mut order: Vec<usize> = (0..cells.len()).collect();
        order.sort_by_key(|&i| patterns[i]);
        for (number, i) in order.into_iter().enumerate() {
            let cell = &mut cells[i];
            // Equal functions in an order of their own, whatever the cuts were.
            cell.sort_by_key(|c| c.ray);
            let first = out.facets.len();
            let touched = cell.iter().fold(0, |t, c| t | c.tight);
            let facets = (0..nodes.len()).filter(|&n| touched >> n & 1 == 1 && is_facet(cell, n));
            out.facets.extend(facets.map(|n| n as u8));
            for c in cell.iter() {
                out.rays.push(c.ray);
                let own = out.facets[first..].iter().enumerate();
                out.on.push(own.fold(0, |m, (k, &n)| m | ((c.tight >> n & 1) as u16) << k));
            }
            out.facet_starts.push(out.facets.len() as u32);
            out.ray_starts.push(out.rays.len() as u32);
            out.patterns.push(patterns[i]);
            out.find.insert(patterns[i], number as u16);
        }
        out
    }

    pub fn len(&self) -> usize {
        self.patterns.len()
    }
    pub fn is_empty(&self) -> bool {
        self.patterns.is_empty()
    }
    /// Nodes of a neighbourhood.
    pub fn nodes(&self) -> usize {
        let wide = 2 * self.across + 1;
        (wide * wide * 2 * (self.behind + 1)) as usize
    }
    /// (u, v, t) of a node: t runs fastest, then u, then v.
    pub fn node(&self, number: usize) -> [i32; 3] {
        let (wide, long) = (2 * self.across + 1, 2 * (self.behind + 1));
        let n = number as i32;
        [n / long % wide - self.across, n / (long * wide) - self.across, n % long - self.behind]
    }
    /// The number of a neighbourhood, if some plane makes it.
    pub fn find(&self, pattern: u128) -> Option<u16> {
        self.find.get(&pattern).copied()
    }
    /// Nodes that bound the cell, and whether each is black.
    pub fn facets(&self, entry: u16) -> impl Iterator<Item = (usize, bool)> + '_ {
        let e = usize::from(entry);
        let own = &self.facets[self.facet_starts[e] as usize..self.facet_starts[e + 1] as usize];
        own.iter().map(move |&n| (usize::from(n), self.patterns[e] >> n & 1 == 1))
    }
    /// The cell's extreme rays, each with the facets that it lies on.
    pub fn rays(&self, entry: u16) -> impl Iterator<Item = (Ray, u16)> + '_ {
        let e = usize::from(entry);
        let range = self.ray_starts[e] as usize..self.ray_starts[e + 1] as usize;
        self.rays[range.clone()].iter().copied().zip(self.on[range].iter().copied())
    }
}

/// An extreme ray, and the nodes where it is zero.
#[derive(Clone, Copy)]
struct Corner {
    ray: Ray,
    tight: u128,
}

/// g at a node.
fn value(ray: &Ray, [u, v, t]: [i32; 3]) -> i32 {
    ray[0] * (1 - u - v - t) + ray[1] * t + ray[2] * u + ray[3] * v
}

/// All cells with O black and P white.
fn enumerate(nodes: &[[i32; 3]]) -> Vec<Vec<Corner>> {
    let number = |n: [i32; 3]| nodes.iter().position(|&m| m == n).expect("the tetrahedron is in the neighbourhood");
    let first = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0]].map(number);
    let all = first.iter().fold(0u128, |m, &n| m | 1 << n);
    let mut cells: Vec<Vec<Corner>> = Vec::new();
    for signs in [[1, -1, 1, 1], [1, -1, 1, -1], [1, -1, -1, 1], [1, -1, -1, -1]] {
        let corner = |i: usize| {
            let mut ray = [0; 4];
            ray[i] = signs[i];
            Corner { ray, tight: all & !(1 << first[i]) }
        };
        cells.push((0..4).map(corner).collect());
    }
    for (n, &node) in nodes.iter().enumerate() {
        if !first.contains(&n) {
            cells = cells.into_iter().flat_map(|cell| split(cell, n, node)).collect();
        }
    }
    cells
}

/// The parts of a cell on both sides of a node's hyperplane, or the cell itself.
fn split(mut cell: Vec<Corner>, n: usize, node: [i32; 3]) -> Vec<Vec<Corner>> {
    let at: Vec<i32> = cell.iter().map(|c| value(&c.ray, node)).collect();
    for (c, &v) in cell.iter_mut().zip(&at) {
        if v == 0 {
            c.tight |= 1 << n;
        }
    }
    if at.iter().all(|&v| v >= 0) || at.iter().all(|&v| v <= 0) {
        return vec![cell];
    }
    let mut new = Vec::new();
    for (i, p) in cell.iter().enumerate().filter(|&(i, _)| at[i] > 0) {
        for (j, q) in cell.iter().enumerate().filter(|&(j, _)| at[j] < 0) {
            // Neighbours share a face that no third ray lies on.
            let common = p.tight & q.tight;
            let third = |k: usize| k != i && k != j && cell[k].tight & common == common;
            if common.count_ones() >= 2 && !(0..cell.len()).any(third) {
                let ray = reduced([0, 1, 2, 3].map(|k| at[i] * q.ray[k] - at[j] * p.ray[k]));
                new.push(Corner { ray, tight: common | 1 << n });
            }
        }
    }
    let side = |sign: i32| -> Vec<Corner> {
        let own = cell.iter().zip(&at).filter(|&(_, &v)| v * sign >= 0).map(|(c, _)| *c);
        own.chain(new.iter().copied()).collect()
    };
    vec![side(1), side(-1)]
}

fn reduced(ray: Ray) -> Ray {
    fn gcd(a: i32, b: i32) -> i32 {
        if b == 0 { a.abs() } else { gcd(b, a % b) }
    }
    let g = ray.iter().fold(0, |g, &v| gcd(g, v));
    ray.map(|v| v / g)
}

/// The colours that a function inside of the cell gives.
fn pattern(cell: &[Corner], nodes: &[[i32; 3]]) -> u128 {
    let middle = [0, 1, 2, 3].map(|k| cell.iter().map(|c| c.ray[k]).sum());
    nodes.iter().enumerate().fold(0, |m, (n, &node)| m | u128::from(value(&middle, node) > 0) << n)
}

/// Whether the rays on a node's hyperplane span it: three of them are independent.
fn is_facet(cell: &[Corner], n: usize) -> bool {
    let on: Vec<&Ray> = cell.iter().filter(|c| c.tight >> n & 1 == 1).map(|c| &c.ray).collect();
    let Some((a, rest)) = on.split_first() else { return false };
    let minor = |r: &Ray, i: usize, j: usize| a[i] * r[j] - a[j] * r[i];
    let independent = |r: &&&Ray| (0..4).any(|i| (0..i).any(|j| minor(r, i, j) != 0));
    let Some(b) = rest.iter().find(independent) else { return false };
    let det = |c: &Ray, i: usize, j: usize, k: usize| {
        i64::from(minor(b, i, j)) * i64::from(c[k]) - i64::from(minor(b, i, k)) * i64::from(c[j])
            + i64::from(minor(b, j, k)) * i64::from(c[i])
    };
    rest.iter().any(|c| [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]].iter().any(|&[i, j, k]| det(c, i, j, k) != 0))
}

#[allow(clippy::disallowed_types, reason = "asked only for single patterns: its order gets nowhere")]
type Find = std::collections::HashMap<u128, u16, BuildHasherDefault<Mixer>>;

/// Two words of a pattern into one, the same on every machine.
#[derive(Default)]
struct Mixer(u64);

impl Hasher for Mixer {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u128(u128::from(b)));
    }
    fn write_u128(&mut self, v: u128) {
        let mixed = (v as u64 ^ self.0).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (v >> 64) as u64;
        self.0 = (mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        self.0 ^= self.0 >> 32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_counts_are_the_sources() {
        assert_eq!(2 * large().len(), 32_986);
        assert_eq!(2 * small().len(), 442);
    }

    #[test]
    fn facets_as_found() {
        let count = |d: &Dictionary| {
            let mut by = std::collections::BTreeMap::new();
            (0..d.len()).for_each(|e| *by.entry(d.facets(e as u16).count()).or_insert(0) += 1);
            by.into_iter().collect::<Vec<_>>()
        };
        assert_eq!(count(small()), [(4, 120), (5, 40), (6, 44), (7, 8), (8, 9)]);
        let all = [(4, 7232), (5, 5176), (6, 2520), (7, 824), (8, 557), (9, 96), (10, 44), (11, 24), (12, 12), (13, 8)];
        assert_eq!(count(large()), all);
        assert!(large().rays.iter().flatten().all(|v| v.abs() <= 26));
    }

    /// Any plane's neighbourhood is found, and its cone holds exactly the planes that make it.
    #[test]
    fn facets_against_all_nodes() {
        let mut state = 7u64;
        let mut dice = |n: i32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((state >> 33) % (2 * n as u64 + 1)) as i32 - n
        };
        for dictionary in [large(), small()] {
            let nodes: Vec<[i32; 3]> = (0..dictionary.nodes()).map(|n| dictionary.node(n)).collect();
            let mut made = 0;
            for _ in 0..20_000 {
                let ray: Ray = [0; 4].map(|_| dice(1000));
                let colours = |r: &Ray| {
                    nodes.iter().enumerate().fold(0u128, |m, (n, &node)| m | u128::from(value(r, node) >= 0) << n)
                };
                if ray[0] <= 0 || ray[1] >= 0 || nodes.iter().any(|&n| value(&ray, n) == 0) {
                    continue;
                }
                made += 1;
                let entry = dictionary.find(colours(&ray)).expect("a plane's pattern is in the dictionary");
                assert!(dictionary.facets(entry).all(|(n, black)| (value(&ray, nodes[n]) >= 0) == black));
                // A plane a little off: inside of all facets, or another pattern.
                let other: Ray = ray.map(|v| v + dice(60));
                let same = dictionary.facets(entry).all(|(n, black)| (value(&other, nodes[n]) >= 0) == black);
                assert_eq!(same, colours(&other) == dictionary.patterns[usize::from(entry)]);
                for (r, on) in dictionary.rays(entry) {
                    let zero = dictionary.facets(entry).enumerate().filter(|&(_, (n, _))| value(&r, nodes[n]) == 0);
                    assert_eq!(zero.fold(0, |m, (k, _)| m | 1 << k), on);
                }
            }
            assert!(made > 1000);
        }
    }
}
