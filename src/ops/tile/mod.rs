//! The hierarchy as a tree of tiles: inner tiles show a cut of their subtree, leaves the originals.
//!
//! In:     footprints, their dendrogram, hulls of all nodes, landmarks; `buildings` with higher levels of detail of
//!         the same ids, if there are any.
//! Out:    tiles, parents before children. A tile is a subtree of the dendrogram. It is a leaf where its originals fit
//!         the bounds, or where it is one building. An inner tile's content is a cut of its subtree, never finer than
//!         its children's: clusters in some form, their landmarks beside them as features of their own, single
//!         buildings in some form. Triangles are those of walls and roofs: nobody sees the ground.
//! Cut:    E is the smallest error for which the fewest triangles (rings, landmarks as they are) fit the budget:
//!         `max-triangles`, and at most half of what the children draw together (where a handful of buildings cannot
//!         be drawn in half, the bound alone). `prefer = "fewest"` takes that cut. `"least-error"` takes the least cut
//!         (see `least_cut`) that spends the budget, no form with an error above E.
//! Error:  e = max(e0, largest height difference of a member that is not drawn beside). e0 = sqrt(S) of the
//!         negative-space box; members higher than the cluster by `skyline` * e0 are landmarks. Heights are compared
//!         above their own ground, and also as roofs above zero. A form's negative space is all that it draws wrong.
//! Facts:  exceeding (tiles above a bound: one building, or landmarks alone), extruded (originals known only by one
//!         height), street_points; and of each of `levels` `lost` (0) and `closed` (an estimate from some 10,000 street points, good
//!         to about a hundredth; they lie on a grid that does not turn with the city).
//! Errors: inputs differ, no building, hulls that are a cut or not nested.
//! Cost:   near O(n log n), parallel over subtrees; memory O(n).
//! Source: sections 6 and 8 of Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility;
//!         the least cut and the tree are ours.
//! Tried:  E over all forms, not the rings alone: 40 to 55 % of the error, but 15 to 20 % more shown wrong at equal
//!         triangles. Cuts finer than the children's where that would pay: 0.3 % less shown wrong. Tiles of 5,000
//!         triangles: 40 % fewer on a zoom, four times the files, worse skylines.

mod build;
mod city;
mod content;
mod error;
mod flatten;
mod forms;
mod least_cut;
mod levels;
mod originals;

use std::sync::atomic::AtomicBool;

use crate::artifact::hulls::HullState;
use crate::artifact::{Buildings, Dendrogram, Footprints, Hulls, Landmarks, TileTree};
use crate::diag::{Diagnostic, Result};
use crate::geom::tree_cut::Prefer;
use crate::op::{Ctx, Op};

use city::City;
use flatten::Flat;
use levels::Street;
use originals::Originals;

crate::params! {
    /// Tiles with bounded content and measured errors.
    pub struct Tile {
        /// Triangles that a tile may have; one building may have more.
        #[schemars(range(min = 16))]
        pub max_triangles: u64 = 20_000,
        /// Bytes that a tile's content may have; one building may have more.
        #[schemars(range(min = 16384), extend("x-unit" = "bytes"))]
        pub max_bytes: u64 = 4 << 20,
        /// How far a building stands above its cluster to be drawn beside it, as a share of the cluster's error.
        #[schemars(range(min = 0.0))]
        pub skyline: f64 = 0.2,
        /// The least error for its triangles, or the source's fewest triangles within the error.
        pub prefer: Prefer = Prefer::LeastError,
    }
}

crate::inputs! {
    /// Ground polygons of all buildings.
    footprints: Footprints,
    /// Merge tree over them.
    dendrogram: Dendrogram,
    /// Rings of all nodes of the tree.
    hulls: Hulls,
    /// The buildings by height.
    landmarks: Landmarks,
    /// Higher levels of detail: leaves and landmarks keep the highest, matched by id.
    buildings: Option<Buildings>,
}

impl Op for Tile {
    const NAME: &'static str = "tile";
    const VERSION: u32 = 2;
    type In = In;
    type Out = TileTree;
    const FACTS: &'static [(&'static str, &'static str)] = &[
        ("exceeding", "tiles above a bound: one building, or landmarks alone"),
        ("extruded", "originals known only by one height"),
        ("street_points", "points on streets, squares and yards at which `closed` of each level is sampled"),
    ];

    fn run(&self, ctx: &Ctx, input: In) -> Result<TileTree> {
        let In { footprints, dendrogram: tree, hulls, landmarks, buildings } = input;
        let n = footprints.len();
        let sizes = [("dendrogram", tree.leaf_count()), ("landmarks", landmarks.order.len())];
        if let Some((name, other)) = sizes.into_iter().find(|&(_, m)| m != n) {
            let message = format!("footprints and {name} differ: {n} buildings, {other} leaves");
            return Err(Diagnostic::error("inputs-differ", message));
        }
        if n == 0 {
            return Err(Diagnostic::error("no-buildings", "there is no building to tile"));
        }
        if hulls.state == HullState::Cut {
            return Err(Diagnostic::error("already-cut", "these hulls are a cut: tiles need those of all nodes"));
        }
        if hulls.len() != tree.cluster_count() {
            let message =
                format!("hulls and dendrogram differ: {} hulls, {} clusters", hulls.len(), tree.cluster_count());
            return Err(Diagnostic::error("inputs-differ", message));
        }
        let solids = buildings.as_deref().map(|b| moved(b, &footprints)).transpose()?;
        let originals = Originals::new(&footprints, &landmarks, solids.as_deref());
        let missing = originals.missing();
        if missing > 0 {
            ctx.report.warn(format!("{missing} of {n} buildings are not in `buildings`: their leaves are extruded"));
        }
        let city = City::new(&tree, &hulls, &landmarks, originals, self.skyline);
        // What is done with goes at once, here and below: this is where a run holds most.
        drop(tree);
        ctx.check()?;
        let street = Street::of(&footprints);
        let limits =
            Limits { triangles: self.max_triangles, bytes: self.max_bytes, prefer: self.prefer, stop: ctx.stop };
        let city = if build::fits_as_it_is(&city, &limits, city.root()) { city } else { city.with_forms() };
        ctx.check()?;
        let root = build::build(&city, &street, &limits, city.root());
        ctx.check()?;
        let city = city.without_forms();
        let levels = levels::report(&city, &root, &street);
        let flat = Flat::new(&city, root);
        ctx.report.fact("exceeding", flat.exceeding());
        ctx.report.fact("extruded", if buildings.is_some() { missing } else { n });
        ctx.report.fact("street_points", street.points.len());
        let originals = city.into_originals();
        drop((hulls, landmarks, street));
        Ok(flat.drawn(&originals, levels))
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (4 << 20) + 8 * input_bytes / 3
    }
}

/// What a tile may hold, and which cut fills it.
pub struct Limits<'a> {
    pub triangles: u64,
    pub bytes: u64,
    pub prefer: Prefer,
    /// Once true, tiles no longer matter.
    pub stop: &'a AtomicBool,
}

/// The buildings in the footprints' frame.
fn moved<'a>(solids: &'a Buildings, footprints: &Footprints) -> Result<std::borrow::Cow<'a, Buildings>> {
    if solids.frame == footprints.frame {
        return Ok(std::borrow::Cow::Borrowed(solids));
    }
    let mut out = solids.clone();
    let plan: Vec<[i32; 2]> = out.surfaces.points.iter().map(|p| [p[0], p[1]]).collect();
    let plan = footprints.frame.adopt(&plan, &solids.frame).map_err(|e| {
        Diagnostic::error("frames-differ", format!("`buildings` cannot be moved into the footprints' frame: {e}"))
    })?;
    out.surfaces.points.iter_mut().zip(plan).for_each(|(p, q)| (p[0], p[1]) = (q[0], q[1]));
    out.frame = footprints.frame.clone();
    Ok(std::borrow::Cow::Owned(out))
}

#[cfg(test)]
mod tests;
