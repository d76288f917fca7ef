//! PlaneTiles: planes through a voxel grid, each with the sticks that it takes.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Artifact, Kind};
use crate::geom::frame::Frame;
use crate::geom::lattice::Lattice;

/// Sticks that no tile took, by cause, and sizes of the dictionaries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct LeftOver {
    /// Some plane is voted for, by fewer sticks than asked, or the search was told to stop.
    pub below_min_votes: u32,
    /// No sampled plane lies in the stick's cone, and its own plane has too few votes.
    pub unsampled: u32,
    /// No plane makes the stick's neighbourhood.
    pub not_a_pattern: u32,
    /// The surface does not cross the stick.
    pub membrane: u32,
}

/// What the search was given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Given {
    /// All sticks, those over holes among them.
    pub sticks: u32,
    pub membrane: u32,
    /// Sticks in the large dictionary.
    pub flat: u32,
    /// Sticks in the small dictionary only.
    pub small: u32,
    /// Each tile was proven to be the best of all sampled planes.
    pub exact: bool,
    /// Distance within which a tile takes sticks, in cells.
    pub reach_cells: f64,
}

crate::json_field!(LeftOver, Given);

crate::columns! {
    /// n planes in the order in which they were found.
    #[derive(Clone, Debug, PartialEq)]
    pub struct PlaneTiles {
        pub frame: Frame,
        pub lattice: Lattice,
        /// Field values at the four corners (see [`crate::geom::lattice`]), exact integers.
        pub planes: Vec<[i64; 4]>,
        /// Sticks that voted for the plane.
        pub votes: Vec<u32>,
        /// 0: found among flat sticks, 1: among the others.
        pub stages: Vec<u8>,
        /// n + 1 offsets into `sticks`.
        pub starts: Vec<u32>,
        /// Sticks that each tile took, the `votes` that voted first: [`super::voxels::stick_number`]s.
        pub sticks: Vec<u64>,
        pub given: Given,
        pub left_over: LeftOver,
    }
}

impl PlaneTiles {
    pub fn len(&self) -> usize {
        self.planes.len()
    }
    pub fn is_empty(&self) -> bool {
        self.planes.is_empty()
    }
    /// The sticks that tile i took.
    pub fn taken(&self, i: usize) -> &[u64] {
        &self.sticks[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
}

impl Artifact for PlaneTiles {
    const KIND: &'static Kind = &Kind::of::<Self>("PlaneTiles", "planes and the sticks that they take").keys(&[
        ("tiles", "number of planes"),
        ("flat_tiles", "of these, found among flat sticks"),
        ("sticks", "grid edges with one end inside"),
        ("flat_sticks", "sticks whose 5 x 5 x 4 neighbourhood a plane makes"),
        ("small_sticks", "of the others, those whose 3 x 3 x 2 neighbourhood a plane makes"),
        ("membrane_sticks", "sticks over holes, which never vote"),
        ("votes", "sum over the tiles"),
        ("captured", "sticks that tiles took"),
        ("coverage", "taken share of all sticks that are not over holes"),
        ("left_over", "sticks that no tile took, by cause"),
        ("exact", "whether each tile is proven to be the best sampled plane"),
        ("most_votes", "votes of the first ten tiles"),
        ("dictionary", "neighbourhoods in the large and the small dictionary, for one orientation"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        let given = &self.given;
        let left = self.left_over;
        let total = given.sticks - given.membrane;
        let missing = left.below_min_votes + left.unsampled + left.not_a_pattern;
        out.insert("tiles".into(), json!(self.len()));
        out.insert("flat_tiles".into(), json!(self.stages.iter().filter(|&&s| s == 0).count()));
        out.insert("sticks".into(), json!(given.sticks));
        out.insert("flat_sticks".into(), json!(given.flat));
        out.insert("small_sticks".into(), json!(given.small));
        out.insert("membrane_sticks".into(), json!(given.membrane));
        out.insert("votes".into(), json!(self.votes.iter().map(|&v| u64::from(v)).sum::<u64>()));
        out.insert("captured".into(), json!(self.sticks.len()));
        let covered = f64::from(total - missing) / f64::from(total.max(1));
        out.insert("coverage".into(), json!((covered * 1e6).round() / 1e6));
        out.insert("left_over".into(), json!(left));
        out.insert("exact".into(), json!(given.exact));
        out.insert("most_votes".into(), json!(self.votes[..self.len().min(10)]));
        out.insert("dictionary".into(), json!({ "large": 16_493, "small": 221 }));
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
