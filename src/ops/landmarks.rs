//! Every cluster's buildings by height, so that "all taller than h" needs no scan of all.
//!
//! In:     footprints, n of them; dendrogram over the same n.
//! Out:    heights in the dendrogram's leaf order under a tree of maxima; each cluster is a range of that order.
//! Errors: n differs. Cost: O(n); a question costs O(k log n) for k answers.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 8.

use rayon::prelude::*;

use crate::artifact::{Dendrogram, Footprints, Landmarks};
use crate::diag::{Diagnostic, Result};
use crate::op::{Ctx, Op};

crate::params! {
    /// Buildings by height within each cluster.
    pub struct FindLandmarks {}
}

crate::inputs! {
    /// Buildings with their heights.
    footprints: Footprints,
    /// Merge tree over the same buildings.
    dendrogram: Dendrogram,
}

impl Op for FindLandmarks {
    const NAME: &'static str = "landmarks";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Landmarks;

    fn run(&self, _: &Ctx, input: In) -> Result<Landmarks> {
        let (buildings, leaves) = (input.footprints.len(), input.dendrogram.leaf_count());
        if buildings != leaves {
            let message = format!("footprints and dendrogram differ: {buildings} buildings, {leaves} leaves");
            return Err(Diagnostic::error("inputs-differ", message));
        }
        Ok(landmarks(&input.footprints, &input.dendrogram))
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (2 << 20) + 3 * input_bytes / 2
    }
}

/// Heights in leaf order, and each cluster's mean height weighted by area without courtyards.
pub fn landmarks(footprints: &Footprints, tree: &Dendrogram) -> Landmarks {
    let (order, first) = tree.leaf_order();
    let size: Vec<u32> = (0..tree.cluster_count() as u32).map(|c| tree.size_of(c)).collect();
    let height: Vec<f64> = order.iter().map(|&b| footprints.height(b as usize)).collect();

    // (area, area * height, height) summed bottom-up: children come before their parents.
    let own = |b: usize| {
        let (area, height) = (footprints.area_m2(b), footprints.height(b));
        [area, area * height, height]
    };
    let mut sums: Vec<[f64; 3]> = (0..tree.leaf_count()).into_par_iter().with_min_len(256).map(own).collect();
    sums.reserve(tree.left.len());
    for (&l, &r) in tree.left.iter().zip(&tree.right) {
        let (l, r) = (sums[l as usize], sums[r as usize]);
        sums.push([0, 1, 2].map(|k| l[k] + r[k]));
    }
    let mean = |([area, weighted, plain], &size): (&[f64; 3], &u32)| {
        if *area > 0.0 { weighted / area } else { plain / f64::from(size) }
    };
    let cluster_height = sums.iter().zip(&size).map(mean).collect();
    let maxima = Landmarks::maxima_of(&height);
    Landmarks { order, first, size, cluster_height, height, maxima }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::{Attributes, Shapes};
    use crate::geom::frame::Frame;

    /// Squares of side 10 m (the first 20 m), 100 m apart, with these heights.
    fn row(heights: &[f64]) -> Footprints {
        let mut polygons = Shapes::default();
        for i in 0..heights.len() as i32 {
            let (x, side) = (100_000 * i, if i == 0 { 20_000 } else { 10_000 });
            polygons.push_ring(&[[x, 0], [x + side, 0], [x + side, side], [x, side]]);
            polygons.end_polygon();
            polygons.end_shape();
        }
        Footprints {
            frame: Frame::local(),
            ids: (0..heights.len()).map(|i| i.to_string()).collect(),
            polygons,
            base: vec![2.0; heights.len()],
            top: heights.iter().map(|h| h + 2.0).collect(),
            attributes: Attributes::default(),
        }
    }

    /// ((2, 0), 1)
    fn tree() -> Dendrogram {
        Dendrogram {
            left: vec![2, 3],
            right: vec![0, 1],
            distance: vec![1.0; 2],
            cost: vec![1.0; 2],
            size: vec![2, 3],
            crosses_barrier: vec![false; 2],
            leaves: vec![3],
        }
    }

    #[test]
    fn taller_than() {
        let marks = landmarks(&row(&[10.0, 30.0, 5.0]), &tree());
        assert_eq!(marks.order, [2, 0, 1]);
        assert_eq!(marks.height, [5.0, 10.0, 30.0]);
        assert_eq!(marks.cluster_height[3], (400.0 * 10.0 + 100.0 * 5.0) / 500.0);
        let taller = |cluster: usize, h: f64| {
            let first = marks.first[cluster] as usize;
            let mut found = Vec::new();
            marks.taller(first..first + marks.size[cluster] as usize, h, |place| found.push(marks.order[place]));
            found
        };
        assert_eq!(taller(4, 9.0), [0, 1]);
        assert_eq!(taller(3, 9.0), [0]);
        assert!(taller(3, 10.0).is_empty());
        assert_eq!(taller(4, -1.0), [2, 0, 1]);
    }

    #[test]
    fn one_building() {
        let tree = Dendrogram { leaves: vec![1], ..Dendrogram::default() };
        let marks = landmarks(&row(&[4.0]), &tree);
        assert_eq!(marks.cluster_height, [4.0]);
        assert_eq!(marks.maxima.len(), 2);
    }
}
