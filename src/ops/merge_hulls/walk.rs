//! The tree in postorder: a subtree is a run of places, so that a sweep over it needs a stack and nothing else.

use rayon::prelude::*;

use crate::artifact::Dendrogram;

/// Subtrees of at most so many leaves are one piece of work.
pub const GRAIN: u32 = 256;

pub struct Walk<'a> {
    pub tree: &'a Dendrogram,
    /// Clusters, left before right before their parent.
    pub postorder: Vec<u32>,
    /// By place: leaves of the subtree.
    sizes: Vec<u32>,
}

impl<'a> Walk<'a> {
    pub fn new(tree: &'a Dendrogram) -> Self {
        let postorder = tree.postorder();
        let sizes = postorder.par_iter().map(|&c| tree.size_of(c)).collect();
        Self { tree, postorder, sizes }
    }
    /// Place of the root.
    pub fn root(&self) -> Option<usize> {
        self.postorder.len().checked_sub(1)
    }
    /// Places of the children and how many leaves they have; none for a leaf.
    pub fn children(&self, place: usize) -> Option<([usize; 2], [u32; 2])> {
        if self.is_leaf(place) {
            return None;
        }
        let right = self.sizes[place - 1];
        Some(([place - 2 * right as usize, place - 1], [self.sizes[place] - right, right]))
    }
    pub fn is_leaf(&self, place: usize) -> bool {
        self.sizes[place] == 1
    }
    /// Leaves of a subtree.
    pub fn size(&self, place: usize) -> u32 {
        self.sizes[place]
    }
    /// All places of a subtree.
    pub fn subtree(&self, top: usize) -> std::ops::RangeInclusive<usize> {
        top + 2 - 2 * self.sizes[top] as usize..=top
    }
}
