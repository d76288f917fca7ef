//! A balanced k-d tree: the places of points (or boxes) in memory so that neighbours lie together, and a box around
//! every node. Searches are their owners' business: they keep what else a node must know beside its box.

use super::bounds::Bounds;

/// Leaves hold four to eight places each. Nodes are numbered as in a heap: 1 is the root, `i`'s children are `2 i`
/// and `2 i + 1`, leaf `k` is node `leaves + k`.
pub struct Tree {
    /// What lies at each place: numbers of the boxes the tree was built from.
    pub order: Vec<u32>,
    /// A power of two.
    pub leaves: usize,
}

const LEAF: usize = 8;

impl Tree {
    /// Cost: O(n log n), in parallel. Equal boxes lie side by side except where a split parts them.
    pub fn new(boxes: &[Bounds]) -> Self {
        let n = boxes.len();
        let leaves = n.div_ceil(LEAF).next_power_of_two();
        // The doubled centre, so that no half is lost.
        let mut keyed: Vec<([i32; 2], u32)> =
            boxes.iter().enumerate().map(|(i, b)| ([b.low[0] + b.high[0], b.low[1] + b.high[1]], i as u32)).collect();
        split(&mut keyed, 0, leaves, n, leaves);
        Self { order: keyed.into_iter().map(|(_, i)| i).collect(), leaves }
    }

    /// The places of leaf `k`.
    #[inline]
    pub fn places(&self, k: usize) -> std::ops::Range<usize> {
        start(k, self.order.len(), self.leaves)..start(k + 1, self.order.len(), self.leaves)
    }

    /// The places below a node.
    #[inline]
    pub fn places_below(&self, node: usize) -> std::ops::Range<usize> {
        let up = self.leaves.ilog2() - node.ilog2();
        let first = (node << up) - self.leaves;
        let n = self.order.len();
        start(first, n, self.leaves)..start(first + (1 << up), n, self.leaves)
    }

    /// The node of the leaf that holds a place.
    #[inline]
    pub fn leaf_of(&self, place: usize) -> usize {
        self.leaves + (((place + 1) * self.leaves - 1) / self.order.len())
    }
}

#[inline]
fn start(k: usize, n: usize, leaves: usize) -> usize {
    k * n / leaves
}

/// Orders the places of the leaves `first..first + count`.
fn split(at: &mut [([i32; 2], u32)], first: usize, count: usize, n: usize, leaves: usize) {
    if count == 1 {
        at.sort_unstable();
        return;
    }
    let all = at.iter().fold(Bounds::EMPTY, |all, (p, _)| all.join(&Bounds { low: *p, high: *p }));
    let span = |k: usize| i64::from(all.high[k]) - i64::from(all.low[k]);
    let k = usize::from(span(1) > span(0));
    let half = start(first + count / 2, n, leaves) - start(first, n, leaves);
    if half < at.len() {
        at.select_nth_unstable_by_key(half, |&(p, i)| (p[k], p[1 - k], i));
    }
    let (left, right) = at.split_at_mut(half);
    let mut halves = [(left, first), (right, first + count / 2)];
    let [(left, a), (right, b)] = &mut halves;
    if n > 4096 && count > 64 {
        rayon::join(|| split(left, *a, count / 2, n, leaves), || split(right, *b, count / 2, n, leaves));
    } else {
        split(left, *a, count / 2, n, leaves);
        split(right, *b, count / 2, n, leaves);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_box_has_a_place_and_every_place_a_leaf() {
        for n in [0usize, 1, 2, 7, 8, 9, 63, 64, 65, 1000] {
            let boxes: Vec<Bounds> = (0..n as i32).map(|i| Bounds::of([[i * 7919 % 101, i * 104_729 % 97]])).collect();
            let tree = Tree::new(&boxes);
            let mut seen = tree.order.clone();
            seen.sort_unstable();
            assert!(seen.iter().enumerate().all(|(i, &s)| i as u32 == s));
            let places: Vec<usize> = (0..tree.leaves).flat_map(|k| tree.places(k)).collect();
            assert_eq!(places, (0..n).collect::<Vec<_>>());
            for k in 0..tree.leaves {
                assert!(tree.places(k).len() <= LEAF);
                assert!(tree.places(k).all(|p| tree.leaf_of(p) == tree.leaves + k));
            }
        }
    }
}
