//! One level out of the hierarchy: clusters of which every building is in exactly one.
//!
//! In:     hulls of all nodes, the dendrogram over the same buildings.
//! Out:    hulls in state `cut`, in the dendrogram's leaf order, with the vertices that they use.
//! Rule:   exactly one of four. `clusters` undoes the last N - 1 merges. `max-error` splits from the root down while
//!         a cluster's error exceeds it. `min-area` splits while both children reach it. `max-triangles` takes the
//!         least cut that fits (`prefer = "least-error"`), or splits the cluster of the largest error next while the
//!         total fits (`prefer = "fewest"`; ties: first in leaf order). Triangles are those of `extrude`, 4k - 4 for a
//!         ring of k edges (courtyards not counted).
//! Error:  of a cluster max(e0, largest height difference of a member), since a cut draws no landmarks; e0 as in
//!         `tile`; of a single building 0.
//! Facts:  clusters, triangles, error_m (the largest of the cut).
//! Errors: inputs differ; hulls that are a cut already. Cost: O(n log n).
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, sections 6 and 8;
//!         the least cut is ours.

use std::collections::BinaryHeap;

use rayon::prelude::*;

use crate::artifact::hulls::HullState;
use crate::artifact::{Dendrogram, Hulls};
use crate::diag::{Diagnostic, Result};
use crate::geom::bounds::{Bounds, shown_error};
use crate::geom::tree_cut::{self, Prefer, Price};
use crate::op::{Ctx, Mistake, Op};

crate::params! {
    /// A partition of the buildings into clusters. Exactly one of the first four parameters.
    pub struct Cut {
        /// Number of clusters: undoes the last merges.
        #[schemars(range(min = 1))]
        pub clusters: Option<u32> = None,
        /// Splits while a cluster's error exceeds it.
        #[schemars(range(min = 0.0), extend("x-unit" = "m"))]
        pub max_error: Option<f64> = None,
        /// Triangles that the extruded cut may have.
        #[schemars(range(min = 1))]
        pub max_triangles: Option<u64> = None,
        /// Splits while both children reach this area.
        #[schemars(range(min = 0.0), extend("x-unit" = "m2"))]
        pub min_area: Option<f64> = None,
        /// With `max-triangles`: the least error for its triangles, or the source's cut.
        pub prefer: Prefer = Prefer::LeastError,
    }
}

crate::inputs! {
    /// Rings of all nodes.
    hulls: Hulls,
    /// Merge tree over the same buildings.
    dendrogram: Dendrogram,
}

impl Op for Cut {
    const NAME: &'static str = "cut";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Hulls;
    const FACTS: &'static [(&'static str, &'static str)] = &[
        ("clusters", "clusters of the cut"),
        ("triangles", "triangles of their extrusions"),
        ("error_m", "largest error of a cluster"),
    ];

    fn check(&self) -> Vec<Mistake> {
        let given =
            [self.clusters.is_some(), self.max_error.is_some(), self.max_triangles.is_some(), self.min_area.is_some()];
        match given.iter().filter(|&&g| g).count() {
            1 => Vec::new(),
            n => vec![Mistake {
                param: "",
                message: format!("needs exactly one of `clusters`, `max-error`, `max-triangles`, `min-area`, got {n}"),
            }],
        }
    }

    fn run(&self, ctx: &Ctx, input: In) -> Result<Hulls> {
        let (hulls, tree) = (&*input.hulls, &*input.dendrogram);
        if hulls.state == HullState::Cut {
            return Err(
                Diagnostic::error("already-cut", "these hulls are a cut already").help("take the hulls of all nodes")
            );
        }
        if hulls.len() != tree.cluster_count() {
            let message =
                format!("hulls and dendrogram differ: {} hulls, {} clusters", hulls.len(), tree.cluster_count());
            return Err(Diagnostic::error("inputs-differ", message));
        }
        let error = errors(hulls, tree);
        let clusters = self.choose(hulls, tree, &error);
        if let Some(n) = self.clusters.filter(|&n| n as usize != clusters.len()) {
            ctx.report.warn(format!("`clusters` is {n}, but there are only {} buildings", clusters.len()));
        }
        let triangles: u64 = clusters.iter().map(|&c| triangles(hulls, c)).sum();
        if let Some(most) = self.max_triangles.filter(|&most| triangles > most) {
            ctx.report.warn(format!("no cut fits: the coarsest has {triangles} triangles, `max-triangles` is {most}"));
        }
        ctx.report.fact("clusters", clusters.len());
        ctx.report.fact("triangles", triangles);
        ctx.report.fact("error_m", clusters.iter().map(|&c| error[c as usize]).fold(0.0, f64::max));
        Ok(take(hulls, &clusters))
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (2 << 20) + 2 * input_bytes
    }
}

impl Cut {
    /// The clusters of the cut, in leaf order.
    fn choose(&self, hulls: &Hulls, tree: &Dendrogram, error: &[f64]) -> Vec<u32> {
        if let Some(n) = self.clusters {
            let kept = tree.cluster_count().saturating_sub(n as usize - 1).max(tree.leaf_count());
            return descend(tree, |c| c as usize >= kept);
        }
        if let Some(most) = self.max_error {
            return descend(tree, |c| error[c as usize] > most);
        }
        if let Some(least) = self.min_area {
            let reaches = |c: u32| hulls.area_m2[c as usize] >= least;
            return descend(tree, |c| tree.children(c).is_some_and(|ch| ch.into_iter().all(reaches)));
        }
        let budget = self.max_triangles.unwrap_or(u64::MAX);
        match self.prefer {
            Prefer::Fewest => split_worst(hulls, tree, error, budget),
            Prefer::LeastError => least(hulls, tree, budget),
        }
    }
}

/// The error of each cluster, were it drawn as a block.
pub fn errors(hulls: &Hulls, tree: &Dendrogram) -> Vec<f64> {
    // Lowest and highest (height, roof) of the members, bottom-up.
    let mut range: Vec<[[f64; 2]; 2]> = Vec::with_capacity(hulls.len());
    for c in 0..hulls.len() {
        range.push(match tree.children(c as u32) {
            None => [hulls.height[c], hulls.ground[c] + hulls.height[c]].map(|v| [v, v]),
            Some([l, r]) => {
                let (l, r) = (range[l as usize], range[r as usize]);
                [0, 1].map(|k| [l[k][0].min(r[k][0]), l[k][1].max(r[k][1])])
            }
        });
    }
    let one = |c: usize| {
        if tree.children(c as u32).is_none() {
            return 0.0;
        }
        let own = [hulls.height[c], hulls.ground[c] + hulls.height[c]];
        let off = [0, 1].map(|k| (range[c][k][1] - own[k]).max(own[k] - range[c][k][0]));
        let sides = Bounds::of(hulls.points(c)).sides();
        shown_error(hulls.negative_space_m2[c], sides, hulls.height[c]).max(off[0]).max(off[1])
    };
    (0..hulls.len()).into_par_iter().map(one).collect()
}

/// Triangles of a cluster's prism: walls, roof and ground.
fn triangles(hulls: &Hulls, cluster: u32) -> u64 {
    (4 * hulls.ring(cluster as usize).len() as u64).saturating_sub(4)
}

/// From the root down, left before right: the first clusters that are not split. Leaves never are.
fn descend(tree: &Dendrogram, split: impl Fn(u32) -> bool) -> Vec<u32> {
    let mut out = Vec::new();
    let mut stack: Vec<u32> = tree.root().into_iter().collect();
    while let Some(c) = stack.pop() {
        match tree.children(c) {
            Some([l, r]) if split(c) => stack.extend([r, l]),
            _ => out.push(c),
        }
    }
    out
}

/// Splits the cluster of the largest error as long as the total fits.
fn split_worst(hulls: &Hulls, tree: &Dendrogram, error: &[f64], budget: u64) -> Vec<u32> {
    let (_, first) = tree.leaf_order();
    // Errors are never negative: their bits order as they do.
    let key = |c: u32| (error[c as usize].to_bits(), std::cmp::Reverse(first[c as usize]), c);
    let mut open: BinaryHeap<_> = tree.root().map(key).into_iter().collect();
    let mut split = vec![false; tree.cluster_count()];
    let mut total: u64 = tree.root().map_or(0, |c| triangles(hulls, c));
    while let Some((_, _, c)) = open.pop() {
        let Some(children) = tree.children(c) else { break };
        total = total + children.map(|c| triangles(hulls, c)).iter().sum::<u64>() - triangles(hulls, c);
        if total > budget {
            break;
        }
        split[c as usize] = true;
        open.extend(children.map(key));
    }
    descend(tree, |c| split[c as usize])
}

/// The cut that shows the least error within the budget.
fn least(hulls: &Hulls, tree: &Dendrogram, budget: u64) -> Vec<u32> {
    let Some(root) = tree.root() else { return Vec::new() };
    let (order, first) = tree.leaf_order();
    let built = |b: u32| (hulls.area_m2[b as usize] - hulls.negative_space_m2[b as usize]).max(0.0);
    let height: Vec<f64> = order.iter().map(|&b| hulls.height[b as usize]).collect();
    let side: Vec<f64> = order.iter().map(|&b| built(b).sqrt()).collect();
    let shown = |c: u32| {
        let members = first[c as usize] as usize..(first[c as usize] + tree.size_of(c)) as usize;
        let off = members.map(|m| (height[m] - hulls.height[c as usize]).abs() * side[m]);
        0.6 * hulls.negative_space_m2[c as usize] + 0.8 * off.sum::<f64>()
    };
    let postorder = tree.postorder();
    let prices: Vec<Price> =
        postorder.par_iter().map(|&c| Price { triangles: triangles(hulls, c), shown: shown(c) }).collect();
    let (parent, leaves) = tree.postorder_parents(&postorder);
    let items = tree_cut::above(&leaves, &parent, postorder.len() as u32 - 1);
    debug_assert_eq!(postorder.last(), Some(&root));
    // All nodes are items, so places and nodes are the same.
    let own = |i: usize, _| Some(prices[i]);
    let lambda = tree_cut::spend(&items, budget, 1.0, |i, _, below| own(i, below));
    let (picked, _) = tree_cut::cheapest(&items, lambda, own);
    picked.iter().map(|&x| postorder[x as usize]).collect()
}

/// The hulls of these clusters alone, with the vertices that they use.
fn take(hulls: &Hulls, clusters: &[u32]) -> Hulls {
    let mut used: Vec<u32> = clusters.iter().flat_map(|&c| hulls.ring(c as usize)).copied().collect();
    used.sort_unstable();
    used.dedup();
    let mut out = Hulls {
        frame: hulls.frame.clone(),
        state: HullState::Cut,
        vertices: used.iter().map(|&v| hulls.vertices[v as usize]).collect(),
        starts: vec![0],
        rings: Vec::new(),
        cluster: clusters.to_vec(),
        parent: vec![u32::MAX; clusters.len()],
        buildings: pick(&hulls.buildings, clusters),
        merged_edges: pick(&hulls.merged_edges, clusters),
        area_m2: pick(&hulls.area_m2, clusters),
        negative_space_m2: pick(&hulls.negative_space_m2, clusters),
        ground: pick(&hulls.ground, clusters),
        height: pick(&hulls.height, clusters),
    };
    for &c in clusters {
        let place = |v: &u32| used.binary_search(v).expect("every vertex of the rings is there") as u32;
        out.rings.extend(hulls.ring(c as usize).iter().map(place));
        out.starts.push(out.rings.len() as u32);
    }
    out
}

fn pick<T: Copy>(all: &[T], clusters: &[u32]) -> Vec<T> {
    clusters.iter().map(|&c| all[c as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::toy;
    use crate::op::Bench;

    fn run(toy: &toy::Toy, cut: Cut) -> (Hulls, crate::diag::Findings) {
        let bench = Bench::default();
        let input = In { hulls: toy.hulls.clone().into(), dendrogram: toy.dendrogram.clone().into() };
        assert!(cut.check().is_empty());
        let out = cut.run(&bench.ctx(), input).unwrap();
        (out, bench.report.finish())
    }

    /// Every building below exactly one cluster.
    fn assert_partition(toy: &toy::Toy, cut: &Hulls) {
        let (order, first) = toy.dendrogram.leaf_order();
        let mut seen = vec![0; order.len()];
        for &c in &cut.cluster {
            let from = first[c as usize] as usize;
            seen[from..from + toy.dendrogram.size_of(c) as usize].iter_mut().for_each(|s| *s += 1);
        }
        assert!(seen.iter().all(|&s| s == 1));
        assert_eq!(cut.buildings.iter().sum::<u32>() as usize, order.len());
    }

    fn all_cuts(tree: &Dendrogram, c: u32) -> Vec<Vec<u32>> {
        let mut out = vec![vec![c]];
        if let Some([l, r]) = tree.children(c) {
            let right = all_cuts(tree, r);
            for l in all_cuts(tree, l) {
                out.extend(right.iter().map(|r| [&l[..], r].concat()));
            }
        }
        out
    }

    #[test]
    fn a_cut_is_a_partition() {
        let toy = toy::city(&(0..40).collect::<Vec<_>>(), 3);
        let error = errors(&toy.hulls, &toy.dendrogram);
        for n in [1, 2, 7, 40] {
            let (cut, _) = run(&toy, Cut { clusters: Some(n), ..Cut::default() });
            assert_partition(&toy, &cut);
            assert_eq!(cut.len(), n as usize);
            // The first 40 - n merges are done, the others are not.
            assert!(cut.cluster.iter().all(|&c| c <= 80 - 1 - n));
        }
        for most in [0.0, 5.0, 12.0, 30.0, 1e9] {
            let (cut, found) = run(&toy, Cut { max_error: Some(most), ..Cut::default() });
            assert_partition(&toy, &cut);
            assert!(cut.cluster.iter().all(|&c| error[c as usize] <= most));
            assert!(found.facts["error_m"].as_f64().unwrap() <= most);
        }
        for least in [0.0, 100.0, 900.0, 1e9] {
            let (cut, _) = run(&toy, Cut { min_area: Some(least), ..Cut::default() });
            assert_partition(&toy, &cut);
        }
        for prefer in [Prefer::Fewest, Prefer::LeastError] {
            for most in [1, 60, 200, 700, 10_000] {
                let (cut, found) = run(&toy, Cut { max_triangles: Some(most), prefer, ..Cut::default() });
                assert_partition(&toy, &cut);
                assert_eq!(
                    found.facts["triangles"],
                    (0..cut.len()).map(|i| 4 * cut.ring(i).len() as u64 - 4).sum::<u64>()
                );
                assert!(found.facts["triangles"].as_u64().unwrap() <= most || cut.len() == 1);
            }
        }
        let (all, found) = run(&toy, Cut { clusters: Some(41), ..Cut::default() });
        assert_eq!((all.len(), found.warnings.len()), (40, 1));
    }

    #[test]
    fn least_error_shows_the_least_for_its_triangles() {
        for seed in 0..20 {
            let toy = toy::city(&[0, 1, 2, 8, 9, 10, 17], seed);
            let (order, first) = toy.dendrogram.leaf_order();
            let shown = |c: u32| {
                let c = c as usize;
                let members = &order[first[c] as usize..(first[c] + toy.dendrogram.size_of(c as u32)) as usize];
                let off = members.iter().map(|&b| {
                    let (h, a) = (toy.footprints.height(b as usize), toy.footprints.area_m2(b as usize));
                    (h - toy.hulls.height[c]).abs() * a.sqrt()
                });
                0.6 * toy.hulls.negative_space_m2[c] + 0.8 * off.sum::<f64>()
            };
            let cuts = all_cuts(&toy.dendrogram, 12);
            for budget in [20, 50, 80, 110] {
                let (cut, _) = run(&toy, Cut { max_triangles: Some(budget), ..Cut::default() });
                let price = |c: &[u32]| {
                    (c.iter().map(|&c| triangles(&toy.hulls, c)).sum::<u64>(), c.iter().map(|&c| shown(c)).sum::<f64>())
                };
                let (used, error) = price(&cut.cluster);
                // Nothing with as many triangles or fewer shows less.
                assert!(cuts.iter().map(|c| price(c)).all(|(t, e)| t > used || e > error - 1e-6), "{seed} {budget}");
            }
        }
    }

    #[test]
    fn exactly_one_rule() {
        assert_eq!(Cut::default().check().len(), 1);
        assert_eq!(Cut { clusters: Some(2), max_error: Some(1.0), ..Cut::default() }.check().len(), 1);
        let toy = toy::city(&[0], 1);
        let (cut, _) = run(&toy, Cut { max_triangles: Some(1), ..Cut::default() });
        assert_eq!(cut.cluster, [0]);
        let again = In { hulls: cut.into(), dendrogram: toy.dendrogram.into() };
        assert!(Cut { clusters: Some(1), ..Cut::default() }.run(&Bench::default().ctx(), again).is_err());
    }
}
