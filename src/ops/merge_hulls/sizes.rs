//! What the rings measure: areas, negative space, ground and heights.

use rayon::prelude::*;

use super::Height;
use crate::artifact::{Dendrogram, Footprints, Hulls};
use crate::geom::union_area::Polygon;
use crate::geom::{overlaps, ring};

/// Doubled square millimetres: whole numbers but for overlaps, so that sums are exact.
pub struct Built {
    /// Of each building, without its courtyards.
    own: Vec<f64>,
    /// Of the union of each cluster's buildings.
    union: Vec<f64>,
}

impl Built {
    pub fn new(footprints: &Footprints, tree: &Dendrogram, crossed: &[bool]) -> Self {
        let (order, first) = tree.leaf_order();
        let shapes = &footprints.polygons;
        let polygons = |b: usize| -> Vec<Polygon> {
            let polygon = |p: usize| {
                let mut rings = shapes.rings_of(p).map(|r| shapes.ring(r));
                Some(Polygon { shell: rings.next()?, holes: rings.collect() })
            };
            shapes.polygons_of(b).filter_map(polygon).collect()
        };
        let n = footprints.len();
        let own: Vec<f64> = (0..n).into_par_iter().map(|b| overlaps::built_area(&polygons(b), !crossed[b])).collect();
        let size: Vec<u32> = (0..tree.cluster_count() as u32).map(|c| tree.size_of(c)).collect();
        let by_place: Vec<f64> = order.iter().map(|&b| own[b as usize]).collect();
        let by = overlaps::Tree { first: &first, size: &size, parent: &tree.parents(), leaf: &order };
        let twice = overlaps::covered_twice(&by, &by_place, &|place| polygons(order[place] as usize));
        let mut union = own.clone();
        for (merge, (&l, &r)) in tree.left.iter().zip(&tree.right).enumerate() {
            union.push(union[l as usize] + union[r as usize] - twice[n + merge]);
        }
        Self { own, union }
    }
}

/// Fills areas, negative space and heights.
pub fn measure(hulls: &mut Hulls, footprints: &Footprints, tree: &Dendrogram, height: Height, built: &Built) {
    let n = tree.leaf_count();
    let above: Vec<f64> = footprints.top.iter().zip(&footprints.base).map(|(t, b)| t - b).collect();
    let mut sums: Vec<[f64; 3]> =
        (0..n).map(|b| [built.own[b], built.own[b] * footprints.base[b], built.own[b] * above[b]]).collect();
    let mut plain: Vec<[f64; 2]> = (0..n).map(|b| [footprints.base[b], above[b]]).collect();
    hulls.ground = footprints.base.clone();
    hulls.height = above.clone();
    for (merge, (&l, &r)) in tree.left.iter().zip(&tree.right).enumerate() {
        let (l, r) = (l as usize, r as usize);
        let sum = [0, 1, 2].map(|k| sums[l][k] + sums[r][k]);
        let even = [0, 1].map(|k| plain[l][k] + plain[r][k]);
        let size = f64::from(tree.size[merge]);
        // Members without any area weigh alike.
        let mean = |k: usize| if sum[0] > 0.0 { sum[k + 1] / sum[0] } else { even[k] / size };
        hulls.ground.push(mean(0));
        hulls.height.push(mean(1));
        sums.push(sum);
        plain.push(even);
    }
    if height == Height::Median {
        medians(&mut hulls.height, tree, &built.own, &above);
    }
    let areas: Vec<f64> = (0..hulls.len())
        .into_par_iter()
        .map_init(Vec::new, |points, i| {
            points.clear();
            points.extend(hulls.points(i));
            ring::doubled_area(points) as f64
        })
        .collect();
    hulls.negative_space_m2 = areas.iter().zip(&built.union).map(|(a, b)| (a - b).max(0.0) / 2e6).collect();
    hulls.area_m2 = areas.iter().map(|a| a / 2e6).collect();
}

/// Area-weighted medians: the leaves of every cluster sorted by height, by merging its children's.
fn medians(out: &mut [f64], tree: &Dendrogram, weight: &[f64], height: &[f64]) {
    let (mut sorted, first) = tree.leaf_order();
    let n = sorted.len();
    let mut buffer: Vec<u32> = Vec::new();
    for (merge, (&l, &r)) in tree.left.iter().zip(&tree.right).enumerate() {
        let from = first[l as usize] as usize;
        let middle = first[r as usize] as usize;
        let to = from + tree.size[merge] as usize;
        buffer.clear();
        let (mut i, mut j) = (from, middle);
        while i < middle || j < to {
            let left = j == to || (i < middle && height[sorted[i] as usize] <= height[sorted[j] as usize]);
            buffer.push(sorted[if left { i } else { j }]);
            if left { i += 1 } else { j += 1 }
        }
        sorted[from..to].copy_from_slice(&buffer);
        let total: f64 = buffer.iter().map(|&b| weight[b as usize]).sum();
        let weigh = |b: u32| if total > 0.0 { weight[b as usize] } else { 1.0 };
        let half = if total > 0.0 { total } else { buffer.len() as f64 } / 2.0;
        let mut below = 0.0;
        for &b in &buffer {
            below += weigh(b);
            if below >= half {
                out[n + merge] = height[b as usize];
                break;
            }
        }
    }
}
