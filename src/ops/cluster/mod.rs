//! Join buildings that lie close together into one merge tree, small clusters first.
//!
//! In:     footprints; lines that separate (roads, rails, water), in any frame.
//! Out:    n - 1 merges in the order (crosses a barrier, cost, ranks), n leaves in input order.
//! Cost:   near O(n log n). 100 bytes a building while it runs.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 4.
//!
//! The cost of a pair of clusters is `size * size / avg^2` times their smallest distance, as the source has it, but
//! `avg` (the average size of the clusters that are not leaves) divides all pairs alike: it stands in the record and
//! never decides. Distances are taken on the millimetre grid. Ties go by rank: a building's place when all are
//! sorted by a hash of their ids, so that another order of the features gives the same tree.
//!
//! Two buildings whose connecting segment touches a barrier do not link. What cannot be joined without crossing is
//! joined last, by the same cost with barriers ignored; these merges are marked.
//!
//! Tried: Delaunay edges as candidates (0.3 % of the merges of real cities join a pair that is no such edge).

mod join;
mod points;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::join::Merge;
use self::points::Points;
use crate::artifact::{Dendrogram, Footprints, Lines, Strings};
use crate::diag::{Diagnostic, Result};
use crate::op::{Ctx, Op};
use crate::{inputs, params};

params! {
    /// Join buildings that lie close together into one merge tree, small clusters first.
    pub struct Cluster {
        /// What lies between two buildings: the way between their centres, or the gap between their outlines.
        pub distance: Distance = Distance::Centroid,
        /// Shorter distances count as this. Without it touching buildings would cost nothing, whatever their number.
        #[schemars(range(min = 0.001, max = 1000.0), extend("x-unit" = "m"))]
        pub min_distance: f64 = 0.01,
    }
}

/// How the distance of two buildings is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Distance {
    /// Between the area centroids of the outer rings.
    Centroid,
    /// The smallest gap between the outer rings; 0 where they overlap.
    Footprint,
}

inputs! {
    /// Ground polygons of all buildings.
    footprints: Footprints,
    /// Roads, rails, water: what lies on two sides of them is joined last.
    barriers: Vec<Lines>,
}

impl Op for Cluster {
    const NAME: &'static str = "cluster";
    const VERSION: u32 = 1;
    type In = In;
    type Out = Dendrogram;

    fn run(&self, _ctx: &Ctx, input: In) -> Result<Dendrogram> {
        let In { footprints, barriers } = input;
        if !barriers.is_empty() {
            return Err(Diagnostic::error("not-built", "barriers are not there yet"));
        }
        if self.distance == Distance::Footprint {
            return Err(Diagnostic::error("not-built", "`distance = \"footprint\"` is not there yet"));
        }
        Ok(cluster(&footprints, self))
    }
}

/// The merge tree over the footprints.
pub fn cluster(footprints: &Footprints, how: &Cluster) -> Dendrogram {
    let ranking = Ranking::new(&footprints.ids);
    let centres = points::centres(&footprints.polygons);
    let (points, tree) = Points::new(&centres, how.min_distance * 1000.0);
    let ranks: Vec<u32> = tree.order.iter().map(|&i| ranking.of[i as usize]).collect();
    let merges = join::join(&points, &tree, &ranks, None);
    dendrogram(&ranking, merges, Vec::new())
}

/// Who comes first where costs are equal.
struct Ranking {
    /// The rank of each building.
    of: Vec<u32>,
    /// The building of each rank.
    at: Vec<u32>,
}

impl Ranking {
    fn new(ids: &Strings) -> Self {
        let mut hashed: Vec<(u64, u32)> = (0..ids.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| {
                let hash = blake3::hash(ids.get(i).as_bytes());
                let head = hash.as_bytes().first_chunk::<8>().expect("a hash has 32 bytes");
                (u64::from_le_bytes(*head), i as u32)
            })
            .collect();
        hashed.par_sort_unstable();
        let at: Vec<u32> = hashed.into_iter().map(|(_, i)| i).collect();
        let mut of = vec![0; at.len()];
        at.iter().zip(0..).for_each(|(&i, rank)| of[i as usize] = rank);
        Self { of, at }
    }
}

/// Merges sorted and numbered: those within barriers, then those across.
fn dendrogram(ranking: &Ranking, mut within: Vec<Merge>, mut across: Vec<Merge>) -> Dendrogram {
    let n = ranking.at.len();
    let mut out = Dendrogram { leaves: vec![n as u32], ..Dendrogram::default() };
    // By lowest rank: the cluster's number in the tree, and its size.
    let mut number = ranking.at.clone();
    let mut size = vec![1u32; n];
    // Sizes of the clusters that are not leaves: their sum and number.
    let (mut sum, mut count) = (0u64, 0u64);
    for (crosses, merges) in [(false, &mut within), (true, &mut across)] {
        // No cost is negative, so its bits sort like its value.
        merges.par_sort_unstable_by_key(|m| (m.cost.to_bits(), m.low, m.high));
        for m in merges.iter() {
            let (low, high) = (m.low as usize, m.high as usize);
            let avg = if count == 0 { 1.0 } else { sum as f64 / count as f64 };
            let (a, b) = (size[low], size[high]);
            let distance = m.distance / 1000.0;
            out.left.push(number[low]);
            out.right.push(number[high]);
            out.distance.push(distance);
            out.cost.push((u64::from(a) * u64::from(b)) as f64 * distance / (avg * avg));
            out.size.push(a + b);
            out.crosses_barrier.push(crosses);
            number[low] = (n + out.size.len() - 1) as u32;
            size[low] = a + b;
            for part in [a, b].into_iter().filter(|&part| part > 1) {
                (sum, count) = (sum - u64::from(part), count - 1);
            }
            (sum, count) = (sum + u64::from(a + b), count + 1);
        }
    }
    out
}

#[cfg(test)]
mod tests;
