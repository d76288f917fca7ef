//! Voxels: which nodes of a cubic grid are inside.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Artifact, Kind};
use crate::geom::frame::Frame;
use crate::geom::lattice::Lattice;

crate::json_field!(Lattice);

/// What the grid could not hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Losses {
    /// Grid edges that the surface crosses.
    pub crossed: u64,
    /// Of these, those whose ends have one colour: parts thinner than a cell.
    pub lost: u64,
    /// Nodes that `thin = "thicken"` made black.
    pub thickened: u64,
    /// The fill ran through a hole.
    pub leaked: bool,
}

crate::json_field!(Losses);

crate::columns! {
    /// (N + 1)^3 grid nodes, black (inside or on the surface) or white; at least two white layers around, one
    /// where nodes near the surface are black, too.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Voxels {
        pub frame: Frame,
        pub lattice: Lattice,
        /// Rows along x of [`Voxels::words`] words each, y then z; bit x of a row, the rest 0.
        pub black: Vec<u64>,
        /// Sticks that the surface does not cross (a membrane over a hole), ascending: see [`stick_number`].
        pub membrane: Vec<u64>,
        pub losses: Losses,
    }
}

/// Steps to the six neighbours: +x, -x, +y, -y, +z, -z.
pub const STEPS: [[i32; 3]; 6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];

/// A stick as one number, ascending by z, y, x of its black end, then by its direction (an index into [`STEPS`]).
pub fn stick_number(black: [u16; 3], direction: u8) -> u64 {
    u64::from(black[2]) << 48 | u64::from(black[1]) << 32 | u64::from(black[0]) << 16 | u64::from(direction)
}

/// Black end and direction of a [`stick_number`].
pub fn stick_of(number: u64) -> ([u16; 3], u8) {
    ([(number >> 16) as u16, (number >> 32) as u16, (number >> 48) as u16], number as u8)
}

impl Voxels {
    /// All white.
    pub fn new(frame: Frame, lattice: Lattice) -> Self {
        let side = lattice.side();
        let black = vec![0; side.div_ceil(64) * side * side];
        Self { frame, lattice, black, membrane: Vec::new(), losses: Losses::default() }
    }

    /// Words of a row.
    pub fn words(&self) -> usize {
        self.lattice.side().div_ceil(64)
    }
    pub fn row(&self, y: usize, z: usize) -> &[u64] {
        let words = self.words();
        let first = (z * self.lattice.side() + y) * words;
        &self.black[first..first + words]
    }
    pub fn is_black(&self, [x, y, z]: [usize; 3]) -> bool {
        self.row(y, z)[x / 64] >> (x % 64) & 1 == 1
    }
    pub fn set(&mut self, [x, y, z]: [usize; 3]) {
        let at = (z * self.lattice.side() + y) * self.words() + x / 64;
        self.black[at] |= 1 << (x % 64);
    }
    /// Black end and direction of every grid edge with one black and one white end, in the order of
    /// [`stick_number`].
    pub fn sticks(&self) -> Vec<([u16; 3], u8)> {
        (0..self.lattice.side()).into_par_iter().map(|z| self.sticks_of(z)).collect::<Vec<_>>().concat()
    }

    fn sticks_of(&self, z: usize) -> Vec<([u16; 3], u8)> {
        let (side, words) = (self.lattice.side(), self.words());
        let none = vec![0u64; words];
        let beside = |y: Option<usize>, z: Option<usize>| match (y, z) {
            (Some(y), Some(z)) if y < side && z < side => self.row(y, z),
            _ => &none[..],
        };
        let mut out = Vec::new();
        for y in 0..side {
            let row = self.row(y, z);
            if row.iter().all(|&w| w == 0) {
                continue;
            }
            let (front, back) = (beside(Some(y + 1), Some(z)), beside(y.checked_sub(1), Some(z)));
            let (above, below) = (beside(Some(y), Some(z + 1)), beside(Some(y), z.checked_sub(1)));
            for i in 0..words {
                let right = row[i] >> 1 | row.get(i + 1).map_or(0, |w| w << 63);
                let left = row[i] << 1 | if i > 0 { row[i - 1] >> 63 } else { 0 };
                let white = [right, left, front[i], back[i], above[i], below[i]].map(|other| row[i] & !other);
                let mut any = white.iter().fold(0, |m, w| m | w);
                while any != 0 {
                    let bit = any.trailing_zeros();
                    any &= any - 1;
                    let black = [(64 * i + bit as usize) as u16, y as u16, z as u16];
                    let open = (0..6u8).filter(|&d| white[usize::from(d)] >> bit & 1 == 1);
                    out.extend(open.map(|direction| (black, direction)));
                }
            }
        }
        out
    }

    /// Number of black nodes.
    pub fn inside(&self) -> u64 {
        self.black.iter().map(|w| u64::from(w.count_ones())).sum()
    }
}

impl Artifact for Voxels {
    const KIND: &'static Kind = &Kind::of::<Self>("Voxels", "black and white nodes of a cubic grid").keys(&[
        ("nodes", "grid nodes along each side of the cube"),
        ("cell_m", "side of a cell"),
        ("origin_m", "place of node 0, 0, 0 in the local frame"),
        ("black", "nodes inside or on the surface"),
        ("crossed_edges", "grid edges that the surface crosses"),
        ("lost_edges", "of these, those between nodes of one colour: parts thinner than a cell"),
        ("membrane_sticks", "sticks that the surface does not cross: over holes"),
        ("thickened", "nodes that `thin` made black"),
        ("leaked", "whether the fill ran through a hole"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        out.insert("nodes".into(), json!(self.lattice.side()));
        out.insert("cell_m".into(), json!(self.lattice.cell));
        out.insert("origin_m".into(), json!(self.lattice.origin));
        out.insert("black".into(), json!(self.inside()));
        out.insert("crossed_edges".into(), json!(self.losses.crossed));
        out.insert("lost_edges".into(), json!(self.losses.lost));
        out.insert("membrane_sticks".into(), json!(self.membrane.len()));
        out.insert("thickened".into(), json!(self.losses.thickened));
        out.insert("leaked".into(), json!(self.losses.leaked));
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
