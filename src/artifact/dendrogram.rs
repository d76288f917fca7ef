//! Dendrogram: a merge tree over n leaves.

use serde_json::{Map, Value, json};

use super::{Artifact, Kind};

crate::columns! {
    /// n - 1 merges in merge order. Clusters 0..n-1 are the leaves in input order, merge i makes cluster n + i.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct Dendrogram {
        /// The child with the lower rank.
        pub left: Vec<u32>,
        pub right: Vec<u32>,
        /// Smallest distance between the two, metres, floored at `min-distance`.
        pub distance: Vec<f64>,
        /// size * size * distance (metres) / avg^2, as the source records it.
        pub cost: Vec<f64>,
        /// Leaves below.
        pub size: Vec<u32>,
        pub crosses_barrier: Vec<bool>,
        /// n; also where there is no merge.
        pub leaves: Vec<u32>,
    }
}

impl Dendrogram {
    /// Number of leaves, n.
    pub fn leaf_count(&self) -> usize {
        self.leaves[0] as usize
    }
    /// Number of clusters, leaves included: 2n - 1 (0 where there are no leaves).
    pub fn cluster_count(&self) -> usize {
        self.leaf_count() + self.left.len()
    }
    /// The last cluster made; none where there are no leaves.
    pub fn root(&self) -> Option<u32> {
        self.cluster_count().checked_sub(1).map(|i| i as u32)
    }
    /// Left and right child; none for a leaf.
    pub fn children(&self, cluster: u32) -> Option<[u32; 2]> {
        let merge = (cluster as usize).checked_sub(self.leaf_count())?;
        Some([self.left[merge], self.right[merge]])
    }
    /// Leaves below a cluster.
    pub fn size_of(&self, cluster: u32) -> u32 {
        (cluster as usize).checked_sub(self.leaf_count()).map_or(1, |merge| self.size[merge])
    }
    /// Parent of each cluster; `u32::MAX` for the root.
    pub fn parents(&self) -> Vec<u32> {
        let mut out = vec![u32::MAX; self.cluster_count()];
        for (merge, (&l, &r)) in self.left.iter().zip(&self.right).enumerate() {
            let me = (self.leaf_count() + merge) as u32;
            out[l as usize] = me;
            out[r as usize] = me;
        }
        out
    }
    /// Leaves in depth-first order, left before right, and for each cluster its first place in that order:
    /// the leaves of cluster c are `order[first[c]..first[c] + size_of(c)]`.
    pub fn leaf_order(&self) -> (Vec<u32>, Vec<u32>) {
        let n = self.leaf_count();
        let mut first = vec![0u32; self.cluster_count()];
        // Parents come after their children, so one sweep from the root down places everything.
        for merge in (0..self.left.len()).rev() {
            let at = first[n + merge];
            first[self.left[merge] as usize] = at;
            first[self.right[merge] as usize] = at + self.size_of(self.left[merge]);
        }
        let mut order = vec![0u32; n];
        for leaf in 0..n {
            order[first[leaf] as usize] = leaf as u32;
        }
        (order, first)
    }
    /// Clusters in postorder, left before right: the subtree of place x is the 2s - 1 places up to x, s its size.
    pub fn postorder(&self) -> Vec<u32> {
        let n = self.leaf_count();
        let mut place = vec![0u32; self.cluster_count()];
        if let Some(root) = self.root() {
            place[root as usize] = root;
        }
        for merge in (0..self.left.len()).rev() {
            let (l, r) = (self.left[merge], self.right[merge]);
            place[r as usize] = place[n + merge] - 1;
            place[l as usize] = place[n + merge] - 2 * self.size_of(r);
        }
        let mut out = vec![0; place.len()];
        place.iter().enumerate().for_each(|(c, &p)| out[p as usize] = c as u32);
        out
    }
    /// Of each place of the postorder its parent's (`u32::MAX` at the root), and the places of the leaves.
    pub fn postorder_parents(&self, postorder: &[u32]) -> (Vec<u32>, Vec<u32>) {
        let mut parent = vec![u32::MAX; postorder.len()];
        let mut leaves = Vec::with_capacity(self.leaf_count());
        for (x, &c) in postorder.iter().enumerate() {
            match self.children(c) {
                None => leaves.push(x as u32),
                Some([_, r]) => {
                    parent[x - 1] = x as u32;
                    parent[x - 2 * self.size_of(r) as usize] = x as u32;
                }
            }
        }
        (parent, leaves)
    }
}

impl Artifact for Dendrogram {
    const KIND: &'static Kind = &Kind::of::<Self>("Dendrogram", "merge tree over footprints").keys(&[
        ("leaves", "clusters of one footprint"),
        ("merges", "merges of two clusters"),
        ("crossing_merges", "merges across a barrier"),
        ("max_depth", "merges above the deepest leaf"),
        ("max_distance_m", "distance of the last merge"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        let (_, depth) = self.depths();
        out.insert("leaves".into(), json!(self.leaf_count()));
        out.insert("merges".into(), json!(self.left.len()));
        out.insert("crossing_merges".into(), json!(self.crosses_barrier.iter().filter(|&&c| c).count()));
        out.insert("max_depth".into(), json!(depth));
        out.insert("max_distance_m".into(), json!(self.distance.iter().copied().fold(0.0, f64::max)));
        out
    }
}

impl Dendrogram {
    /// Depth of each cluster (root 0) and the largest.
    pub fn depths(&self) -> (Vec<u32>, u32) {
        let n = self.leaf_count();
        let mut depth = vec![0u32; self.cluster_count()];
        for merge in (0..self.left.len()).rev() {
            let below = depth[n + merge] + 1;
            depth[self.left[merge] as usize] = below;
            depth[self.right[merge] as usize] = below;
        }
        let most = depth.iter().copied().max().unwrap_or(0);
        (depth, most)
    }
}
