//! Voxels: which nodes of a cubic grid are inside.

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
    /// (N + 1)^3 grid nodes, black (inside or on the surface) or white; at least two white layers around.
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
