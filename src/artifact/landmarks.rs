//! Landmarks: every cluster's buildings by height, so that "all taller than h" needs no scan of all.

use serde_json::{Map, Value, json};

use super::{Artifact, Kind};

crate::columns! {
    /// Heights above ground of n buildings in the dendrogram's leaf order, under a tree of maxima.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Landmarks {
        /// Building (input row) at each place of the leaf order.
        pub order: Vec<u32>,
        /// First place of each of the 2n - 1 clusters; its buildings are `order[first..first + size]`.
        pub first: Vec<u32>,
        pub size: Vec<u32>,
        /// Area-weighted mean height of each cluster, metres above its ground.
        pub cluster_height: Vec<f64>,
        /// Height above its own ground of the building at each place, metres.
        pub height: Vec<f64>,
        /// Implicit binary tree over places, root at 1, leaves from `maxima.len() / 2`: the largest height below.
        pub maxima: Vec<f64>,
    }
}

impl Landmarks {
    /// The tree of maxima over `height`.
    pub fn maxima_of(height: &[f64]) -> Vec<f64> {
        let width = height.len().next_power_of_two();
        let mut tree = vec![f64::NEG_INFINITY; 2 * width];
        tree[width..width + height.len()].copy_from_slice(height);
        for i in (1..width).rev() {
            tree[i] = tree[2 * i].max(tree[2 * i + 1]);
        }
        tree
    }

    /// Places in `range` whose height is above `h`, in order. Cost O(k log n) for k of them.
    pub fn taller(&self, range: std::ops::Range<usize>, h: f64, mut visit: impl FnMut(usize)) {
        let width = self.maxima.len() / 2;
        let mut stack = vec![(1usize, 0usize, width)];
        while let Some((node, from, to)) = stack.pop() {
            if to <= range.start || range.end <= from || self.maxima[node] <= h {
                continue;
            }
            if node >= width {
                visit(from);
                continue;
            }
            let middle = (from + to) / 2;
            stack.push((2 * node + 1, middle, to));
            stack.push((2 * node, from, middle));
        }
    }
}

impl Artifact for Landmarks {
    const KIND: &'static Kind = &Kind::of::<Self>("Landmarks", "buildings by height above their cluster").keys(&[
        ("buildings", "number of buildings"),
        ("clusters", "clusters with candidates"),
        ("tallest_m", "height of the highest building above its cluster"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        out.insert("buildings".into(), json!(self.order.len()));
        out.insert("clusters".into(), json!(self.first.len()));
        if let Some(&tallest) = self.maxima.get(1) {
            out.insert("tallest_m".into(), json!(tallest));
        }
        out
    }
}
