//! The exact greedy order of a size-weighted single link, by local decisions.
//!
//! With every distance above zero the cost is *reducible*: a union is dearer to any third cluster than the cheaper
//! of its parts was. So two clusters that are each other's nearest, in the total order (cost, ranks), may merge at
//! any time, and sorting all merges by that order afterwards is the greedy order. Two schedules use this: rounds
//! (all mutual nearest pairs at once, in parallel) while a round merges enough, then chains (each cluster leads to
//! its nearest until two are mutual), which no input can slow down.
//!
//! A cluster's nearest is found from its members. A member keeps what its last search found: the nearest foreign
//! site, or a lower bound of what any may cost. Sizes only grow and the foreign sites only get fewer, so these never
//! become too high, and most members are passed over by one comparison.

use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use rayon::prelude::*;

use super::forest::{Forest, NONE, Nearest};
use crate::geom::bounds::Bounds;
use crate::geom::nearest::Tree;

/// Things with a distance, 0..n in the order of a tree's places.
pub trait Sites: Sync {
    /// What a search from one site carries along.
    type Probe: Copy;
    fn len(&self) -> usize;
    fn bounds(&self, x: usize) -> Bounds;
    fn probe(&self, x: usize) -> Self::Probe;
    /// No site in the box has a smaller squared distance (before rounding the root, before the floor).
    fn square_to_box(&self, probe: Self::Probe, bounds: &Bounds) -> f64;
    /// The same for one site.
    fn square_to(&self, probe: Self::Probe, y: usize) -> f64;
    /// Millimetres, symmetric to the last bit; none where the two do not see each other.
    fn distance(&self, x: usize, y: usize, square: f64) -> Option<f64>;
    /// True where two sites have the same distance to everything.
    fn same(&self, x: usize, y: usize) -> bool;
    /// True where a root of `square_to_box` is never above the distances below it, by not even one rounding.
    const EXACT: bool;
    /// Every distance is at least this, above 0.
    fn floor(&self) -> f64;
}

/// One merge: of all pairs at that moment the first in the order (cost, low, high).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merge {
    /// (size * size) * distance, in millimetres.
    pub cost: f64,
    pub distance: f64,
    /// The lowest rank of either cluster, the lower one first.
    pub low: u32,
    pub high: u32,
}

/// Rounds go on while they merge at least one cluster in this many.
const ROUNDS: usize = 33;

/// Merges sites until none sees a foreign one, and returns the merges in no particular order, but always the same.
///
/// `ranks` are distinct, one a site. Sites with the same entry in `together` begin as one cluster. Once `stop` is
/// true, the merges so far.
pub fn join<S: Sites>(
    sites: &S,
    tree: &Tree,
    ranks: &[u32],
    together: Option<&[u32]>,
    stop: &AtomicBool,
) -> Vec<Merge> {
    let mut forest = Forest::new(sites, tree, ranks, together, stop);
    let mut merges = Vec::with_capacity(sites.len().saturating_sub(1));
    let mut live = forest.heads();
    while live.len() > 1 {
        let pairs = forest.mutual(&live);
        if forest.stopped() {
            return merges;
        }
        let few = pairs.len() * ROUNDS < live.len();
        merges.par_extend(pairs.par_iter().map(|&[a, b]| forest.merge(a as usize, b as usize)));
        forest.refresh();
        live.retain(|&c| forest.members[c as usize].of.load(Relaxed) == c && !forest.alone(c as usize));
        if few {
            break;
        }
    }
    forest.chains(&live, &mut merges);
    merges
}

impl<S: Sites> Forest<'_, S> {
    /// All pairs of mutual nearest clusters, the first member's cluster first.
    fn mutual(&self, live: &[u32]) -> Vec<[u32; 2]> {
        live.par_iter().with_min_len(64).for_each(|&c| {
            if !self.stopped() {
                self.nearest_of(c as usize);
            }
        });
        let partner = |c: u32| Nearest::load(&self.nearest[c as usize]).to;
        live.par_iter()
            .with_min_len(1024)
            .filter_map(|&c| {
                let to = partner(c);
                (to != NONE && c < to && partner(to) == c).then_some([c, to])
            })
            .collect()
    }

    /// The cluster's nearest, searched anew where its partner has changed.
    fn nearest_of(&self, c: usize) -> Nearest {
        let known = Nearest::load(&self.nearest[c]);
        if known.to != NONE {
            let partner = &self.members[known.to as usize];
            if partner.of.load(Relaxed) == known.to && partner.size.load(Relaxed) == known.size {
                return known;
            }
        } else if known.size == 1 {
            return known;
        }
        let found = self.search(c);
        found.store(&self.nearest[c]);
        found
    }

    fn alone(&self, c: usize) -> bool {
        let known = Nearest::load(&self.nearest[c]);
        known.to == NONE && known.size == 1
    }

    /// From each cluster to its nearest, until two are mutual; then on from what they have become. To go back to
    /// where the chain began would search a large cluster anew after every merge of small ones beside it.
    fn chains(&mut self, live: &[u32], merges: &mut Vec<Merge>) {
        for &start in live {
            if self.members[start as usize].of.load(Relaxed) != start {
                continue;
            }
            let mut at = start;
            while !self.stopped() {
                let nearest = self.nearest_of(at as usize).to;
                if nearest == NONE {
                    // Sees nobody; so nobody leads here.
                    break;
                }
                if self.nearest_of(nearest as usize).to == at {
                    merges.push(self.merge(at as usize, nearest as usize));
                    at = at.min(nearest);
                    self.refresh_along(at as usize);
                } else {
                    at = nearest;
                }
            }
        }
    }
}
