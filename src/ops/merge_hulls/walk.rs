//! The tree in postorder: a subtree is a run of places, so that a sweep over it needs a stack and nothing else.

use crate::artifact::Dendrogram;

/// Subtrees of at most so many leaves are one piece of work.
pub const GRAIN: u32 = 256;

pub struct Walk<'a> {
    pub tree: &'a Dendrogram,
    /// Clusters, left before right before their parent.
    pub postorder: Vec<u32>,
}

impl<'a> Walk<'a> {
    pub fn new(tree: &'a Dendrogram) -> Self {
        Self { tree, postorder: tree.postorder() }
    }
    /// Place of the root.
    pub fn root(&self) -> Option<usize> {
        self.postorder.len().checked_sub(1)
    }
    /// Places of the children and how many leaves they have; none for a leaf.
    pub fn children(&self, place: usize) -> Option<([usize; 2], [u32; 2])> {
        let [left, right] = self.tree.children(self.postorder[place])?;
        let (a, b) = (self.tree.size_of(left), self.tree.size_of(right));
        Some(([place - 2 * b as usize, place - 1], [a, b]))
    }
    /// All places of a subtree.
    pub fn subtree(&self, top: usize) -> std::ops::RangeInclusive<usize> {
        top + 2 - 2 * self.tree.size_of(self.postorder[top]) as usize..=top
    }
}
