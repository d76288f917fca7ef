//! The cube of grid nodes that voxels stand on, and planes written as values at four of its corners.
//!
//! A cube of N cells a side has nodes 0..=N on each axis. A linear field is given by its values w0..w3 at the corners
//! (0,0,0), (N,N,0), (N,0,N), (0,N,N); at the node (x, y, z) it is (a . w) / 2N with
//! a = (2N - x - y - z, x + y - z, x - y + z, -x + y + z). Where it is not negative is inside. Up to scale w lies on the
//! surface of a 4-D cube: eight 3-D cubes, one for each w_i = +1 or -1.
//! Source: Andújar et al., Computing maximal tiles and application to impostor-based simplification, section 3.

use serde::{Deserialize, Serialize};

use super::space::dot;

/// Where the nodes of a grid lie: N + 1 a side.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lattice {
    /// N, cells along each side of the cube.
    pub cells: u32,
    /// Node (0, 0, 0), metres in the local frame.
    pub origin: [f64; 3],
    /// Side of a cell, metres.
    pub cell: f64,
}

impl Lattice {
    /// The cube for a box whose longest side is `resolution` cells: three cells more, the box in its middle. So a
    /// turn by 90 degrees maps nodes to nodes, and two layers of nodes around the box stay white.
    pub fn around(low: [f64; 3], high: [f64; 3], resolution: u32) -> Self {
        let longest = [0, 1, 2].map(|k| high[k] - low[k]).into_iter().fold(0.0, f64::max);
        let cell = if longest > 0.0 { longest / f64::from(resolution) } else { 1.0 };
        let cells = resolution + 3;
        let origin = [0, 1, 2].map(|k| (low[k] + high[k]) / 2.0 - cell * f64::from(cells) / 2.0);
        Self { cells, origin, cell }
    }

    /// Nodes along each side.
    pub fn side(&self) -> usize {
        self.cells as usize + 1
    }

    /// A place in metres in cells from node (0, 0, 0).
    pub fn to_cells(&self, p: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| (p[k] - self.origin[k]) / self.cell)
    }

    /// A place in cells in metres.
    pub fn to_metres(&self, p: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| self.origin[k] + p[k] * self.cell)
    }

    /// The unit normal that points outside, and the offset: inside is normal . x <= offset, metres.
    pub fn plane(&self, w: [i64; 4]) -> ([f64; 3], f64) {
        let field = Field::new(self.cells, w);
        let length = field.slope();
        let normal = field.gradient.map(|g| 0.0 - g as f64 / length);
        // field(p) = start + gradient . p = 0 on the plane, p in cells.
        let offset = field.start as f64 / length * self.cell + dot(normal, self.origin);
        (normal, offset)
    }
}

/// The factors of w0..w3 at a node.
pub fn factors(cells: u32, [x, y, z]: [i32; 3]) -> [i32; 4] {
    [2 * cells as i32 - x - y - z, x + y - z, x - y + z, y + z - x]
}

/// Whether the node is inside the plane w.
pub fn inside(cells: u32, w: [i64; 4], node: [i32; 3]) -> bool {
    let a = factors(cells, node);
    (0..4).map(|i| i64::from(a[i]) * w[i]).sum::<i64>() >= 0
}

/// A plane's field in cells, times 2N: `start + gradient . p`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    pub start: i64,
    pub gradient: [i64; 3],
}

impl Field {
    pub fn new(cells: u32, w: [i64; 4]) -> Self {
        let gradient = [w[1] + w[2] - w[0] - w[3], w[1] + w[3] - w[0] - w[2], w[2] + w[3] - w[0] - w[1]];
        Self { start: 2 * i64::from(cells) * w[0], gradient }
    }

    /// The gradient's length.
    pub fn slope(&self) -> f64 {
        let square: i128 = self.gradient.iter().map(|&g| i128::from(g) * i128::from(g)).sum();
        (square as f64).sqrt()
    }

    /// Twice the field at half of `doubled`, exactly.
    pub fn doubled(&self, doubled: [i32; 3]) -> i64 {
        2 * self.start + (0..3).map(|k| self.gradient[k] * i64::from(doubled[k])).sum::<i64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_have_their_values() {
        let w = [3, -5, 7, 11];
        for (i, corner) in [[0, 0, 0], [9, 9, 0], [9, 0, 9], [0, 9, 9]].into_iter().enumerate() {
            let a = factors(9, corner);
            assert_eq!(a.iter().position(|&v| v != 0), Some(i));
            assert_eq!(a[i], 18);
            assert_eq!(Field::new(9, w).doubled(corner.map(|c| 2 * c)), 2 * 18 * w[i]);
        }
    }

    #[test]
    fn a_plane_in_metres() {
        let lattice = Lattice::around([0.0; 3], [4.0, 2.0, 1.0], 4);
        assert_eq!(lattice.cells, 7);
        assert_eq!(lattice.to_cells([0.0, 0.0, 0.0]), [1.5, 2.5, 3.0]);
        // Inside below z = 0.5, which is cell coordinate 3.5: values 3.5, 3.5, -3.5, -3.5 at the corners.
        let (normal, offset) = lattice.plane([1, 1, -1, -1]);
        assert_eq!(normal, [0.0, 0.0, 1.0]);
        assert!((offset - 0.5).abs() < 1e-12);
        assert!(inside(7, [1, 1, -1, -1], [0, 0, 3]) && !inside(7, [1, 1, -1, -1], [0, 0, 4]));
    }
}
