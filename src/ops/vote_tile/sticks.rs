//! The sticks of a grid, and the neighbourhood of each.

use super::dictionary::{Dictionary, Ray};
use crate::artifact::voxels::{STEPS, Voxels, stick_number};
use crate::geom::lattice::factors;

/// A grid edge with one end black and one white.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stick {
    pub black: [u16; 3],
    /// From the black end to the white one: an index into [`STEPS`].
    pub direction: u8,
}

impl Stick {
    pub fn number(&self) -> u64 {
        stick_number(self.black, self.direction)
    }
    /// Twice the place of its middle, in cells.
    pub fn doubled_middle(&self) -> [i32; 3] {
        let step = STEPS[usize::from(self.direction)];
        [0, 1, 2].map(|k| 2 * i32::from(self.black[k]) + step[k])
    }
    /// Axis along it, and whether it runs down.
    fn axis(&self) -> (usize, i32) {
        (usize::from(self.direction / 2), if self.direction.is_multiple_of(2) { 1 } else { -1 })
    }
    /// A node of its neighbourhood in the grid.
    pub fn node(&self, [u, v, t]: [i32; 3]) -> [i32; 3] {
        let (a, sign) = self.axis();
        let mut out = self.black.map(i32::from);
        out[(a + 1) % 3] += u;
        out[(a + 2) % 3] += v;
        out[a] += sign * t;
        out
    }
    /// A function of the neighbourhood as values at the cube's four corners.
    pub fn to_corners(&self, ray: Ray, cells: u32) -> [i64; 4] {
        let (a, sign) = self.axis();
        let n = cells as i32;
        [[0, 0, 0], [n, n, 0], [n, 0, n], [0, n, n]].map(|corner| {
            let off = |k: usize| i64::from(corner[k] - i32::from(self.black[k]));
            let (u, v, t) = (off((a + 1) % 3), off((a + 2) % 3), i64::from(sign) * off(a));
            let [o, p, x, y] = ray.map(i64::from);
            o * (1 - u - v - t) + p * t + x * u + y * v
        })
    }
    /// A node of its neighbourhood as factors of w0..w3.
    pub fn factors(&self, node: [i32; 3], cells: u32) -> [i32; 4] {
        factors(cells, self.node(node))
    }
}

/// All sticks, ascending by z, y, x of the black end, then by direction.
pub fn of(voxels: &Voxels) -> Vec<Stick> {
    voxels.sticks().into_iter().map(|(black, direction)| Stick { black, direction }).collect()
}

/// Reads neighbourhoods of one size out of the grid.
pub struct Gather<'a> {
    voxels: &'a Voxels,
    bytes: &'a [u8],
    dictionary: &'a Dictionary,
    /// Bits across, set apart as they lie in a pattern: along u, along v.
    along_u: Vec<u128>,
    along_v: Vec<u128>,
}

impl<'a> Gather<'a> {
    pub fn new(voxels: &'a Voxels, dictionary: &'a Dictionary) -> Self {
        let wide = 2 * dictionary.across as usize + 1;
        let long = 2 * (dictionary.behind as usize + 1);
        let apart = |stride: usize| {
            let spread = |bits: usize| (0..wide).fold(0u128, |m, k| m | ((bits >> k & 1) as u128) << (k * stride));
            (0..1 << wide).map(spread).collect()
        };
        let bytes = bytemuck::cast_slice(&voxels.black);
        Self { voxels, bytes, dictionary, along_u: apart(long), along_v: apart(wide * long) }
    }

    /// `count` (at most 9) bits along x.
    fn bits(&self, x: i32, y: i32, z: i32, count: i32) -> usize {
        let row = (z as usize * self.voxels.lattice.side() + y as usize) * self.voxels.words() * 8;
        let at = row + x as usize / 8;
        let high = self.bytes.get(at + 1).copied().unwrap_or(0);
        let both = usize::from(self.bytes[at]) | usize::from(high) << 8;
        both >> (x % 8) & ((1 << count) - 1)
    }

    /// The stick's entry in the dictionary, if a plane makes its neighbourhood. Along the stick black comes before
    /// white wherever one does: that sorts most others out at once.
    pub fn entry(&self, stick: &Stick) -> Option<u16> {
        let (across, behind) = (self.dictionary.across, self.dictionary.behind);
        let (wide, long) = (2 * across + 1, 2 * (behind + 1));
        let [x, y, z] = stick.black.map(i32::from);
        let (axis, sign) = stick.axis();
        let last = self.voxels.lattice.cells as i32 - behind.max(across) - 1;
        if [x, y, z].iter().any(|c| !(behind.max(across) + 1..=last).contains(c)) {
            return self.at_the_edge(stick);
        }
        let mut pattern = 0u128;
        match axis {
            0 => {
                let first = if sign > 0 { x - behind } else { x - behind - 1 };
                for v in 0..wide {
                    for u in 0..wide {
                        let mut run = self.bits(first, y + u - across, z + v - across, long);
                        if sign < 0 {
                            run = (run as u32).reverse_bits() as usize >> (32 - long);
                        }
                        if run & (run + 1) != 0 {
                            return None;
                        }
                        pattern |= (run as u128) << ((v * wide + u) * long);
                    }
                }
            }
            1 => {
                for u in 0..wide {
                    let mut before = (1 << wide) - 1;
                    for t in 0..long {
                        let bits = self.bits(x - across, y + sign * (t - behind), z + u - across, wide);
                        if bits & !before != 0 {
                            return None;
                        }
                        before = bits;
                        pattern |= self.along_v[bits] << (u * long + t);
                    }
                }
            }
            _ => {
                for v in 0..wide {
                    let mut before = (1 << wide) - 1;
                    for t in 0..long {
                        let bits = self.bits(x - across, y + v - across, z + sign * (t - behind), wide);
                        if bits & !before != 0 {
                            return None;
                        }
                        before = bits;
                        pattern |= self.along_u[bits] << (v * wide * long + t);
                    }
                }
            }
        }
        self.dictionary.find(pattern)
    }

    /// The same, node by node, where the neighbourhood may reach beyond the grid: white is there.
    fn at_the_edge(&self, stick: &Stick) -> Option<u16> {
        let inside = 0..=self.voxels.lattice.cells as i32;
        let black = |n: usize| {
            let node = stick.node(self.dictionary.node(n));
            node.iter().all(|c| inside.contains(c)) && self.voxels.is_black(node.map(|c| c as usize))
        };
        let pattern = (0..self.dictionary.nodes()).fold(0u128, |m, n| m | u128::from(black(n)) << n);
        self.dictionary.find(pattern)
    }
}

#[cfg(test)]
mod tests {
    use super::super::dictionary::{large, small};
    use super::*;
    use crate::geom::frame::Frame;
    use crate::geom::lattice::Lattice;

    /// Black nodes next to the grid's border, as the fill `surface` makes them: beyond is white.
    #[test]
    fn at_the_edge_beyond_is_white() {
        let block = |from: usize| {
            let mut voxels = Voxels::new(Frame::local(), Lattice { cells: 14, origin: [0.0; 3], cell: 1.0 });
            for (x, y, z) in (0..6).flat_map(|x| (0..6).flat_map(move |y| (0..6).map(move |z| (x, y, z)))) {
                voxels.set([x + from, y + from, z + from]);
            }
            voxels
        };
        let [edge, middle] = [1, 4].map(block);
        let all = of(&edge);
        assert_eq!(all.len(), 6 * 36);
        for dictionary in [large(), small()] {
            let (at_edge, inside) = (Gather::new(&edge, dictionary), Gather::new(&middle, dictionary));
            for stick in &all {
                let moved = Stick { black: stick.black.map(|c| c + 3), ..*stick };
                assert_eq!(at_edge.entry(stick), inside.entry(&moved), "{stick:?}");
            }
        }
    }

    /// Every stick's pattern, bit by bit, for a ball of nodes that is not quite in the middle.
    #[test]
    fn gathered_as_by_hand() {
        let lattice = Lattice { cells: 70, origin: [0.0; 3], cell: 1.0 };
        let mut voxels = Voxels::new(Frame::local(), lattice);
        for (x, y, z) in (2..68).flat_map(|x| (2..68).flat_map(move |y| (2..68).map(move |z| (x, y, z)))) {
            let off = |v: usize, m: f64| (v as f64 - m) * (v as f64 - m);
            if off(x, 34.8) + off(y, 34.1) + 1.7 * off(z, 35.4) < 900.0 {
                voxels.set([x, y, z]);
            }
        }
        let sticks = of(&voxels);
        assert!(sticks.is_sorted_by_key(Stick::number) && sticks.len() > 5000);
        for dictionary in [large(), small()] {
            let gather = Gather::new(&voxels, dictionary);
            let mut found = 0;
            for stick in &sticks {
                let black = |n: usize| voxels.is_black(stick.node(dictionary.node(n)).map(|c| c as usize));
                let pattern = (0..dictionary.nodes()).fold(0u128, |m, n| m | u128::from(black(n)) << n);
                assert_eq!(gather.entry(stick), dictionary.find(pattern));
                found += usize::from(gather.entry(stick).is_some());
            }
            assert!(found > 500);
        }
    }
}
