//! What the rings measure: areas, negative space, ground and heights.

use rayon::prelude::*;

use super::Height;
use super::heights::{Row, Sweep};
use super::walk::Walk;
use crate::artifact::{Footprints, Hulls};
use crate::geom::overlaps;
use crate::geom::union_area::Polygon;

/// Doubled square millimetres: whole numbers but for overlaps, so that sums are exact.
pub struct Built {
    /// Of each building, without its courtyards.
    own: Vec<f64>,
    /// Of each cluster, what its children's unions cover both.
    twice: Vec<f64>,
}

impl Built {
    pub fn new(footprints: &Footprints, walk: &Walk, crossed: &[bool]) -> Self {
        let tree = walk.tree;
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
        Self { own, twice }
    }
}

/// Fills negative space, ground and heights; areas come doubled, in square millimetres.
pub fn measure(hulls: &mut Hulls, footprints: &Footprints, walk: &Walk, height: Height, built: &Built) {
    let n = footprints.len();
    let above: Vec<f64> = footprints.top.iter().zip(&footprints.base).map(|(t, b)| t - b).collect();
    let sweep =
        Sweep { walk, how: height, base: &footprints.base, above: &above, own: &built.own, twice: &built.twice };
    let rows = sweep.rows();
    // Where each inner cluster's row is.
    let mut row = vec![0u32; rows.len()];
    let inner = walk.postorder.iter().filter_map(|&c| (c as usize).checked_sub(n));
    inner.zip(0..).for_each(|(merge, at)| row[merge] = at);
    let by_cluster = |leaf: &[f64], of: fn(&Row) -> f64| -> Vec<f64> {
        let inner = row.par_iter().map(|&r| of(&rows[r as usize]));
        leaf.par_iter().copied().chain(inner).collect()
    };
    hulls.ground = by_cluster(&footprints.base, |r| r.ground);
    hulls.height = by_cluster(&above, |r| r.height);
    hulls.negative_space_m2 = by_cluster(&built.own, |r| r.union);
    let areas = hulls.area_m2.par_iter_mut();
    areas.zip(&mut hulls.negative_space_m2).for_each(|(area, space)| {
        *space = (*area - *space).max(0.0) / 2e6;
        *area /= 2e6;
    });
}
