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
mod forms;
mod least_cut;
mod levels;
mod originals;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use crate::artifact::hulls::HullState;
use crate::artifact::{Buildings, Dendrogram, Footprints, Hulls, Landmarks, Shapes, TileTree};
use crate::diag::{Diagnostic, Result};
use crate::geom::tree_cut::Prefer;
use crate::op::{Ctx, Op};

use build::{Built, Drawn};
use city::City;
use content::Content;
use forms::{Pen, Shape};
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
    const VERSION: u32 = 1;
    type In = In;
    type Out = TileTree;
    const FACTS: &'static [(&'static str, &'static str)] = &[
        ("exceeding", "tiles above a bound: one building, or landmarks alone"),
        ("extruded", "originals known only by one height"),
        ("street_points", "points on streets, squares and yards at which `closed` of each level is sampled"),
    ];

    fn run(&self, ctx: &Ctx, input: In) -> Result<TileTree> {
        let (footprints, tree, hulls) = (&*input.footprints, &*input.dendrogram, &*input.hulls);
        let n = footprints.len();
        let sizes = [("dendrogram", tree.leaf_count()), ("landmarks", input.landmarks.order.len())];
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
        let solids = input.buildings.as_deref().map(|b| moved(b, footprints)).transpose()?;
        let originals = Originals::new(footprints, &input.landmarks, solids.as_deref());
        let missing = originals.missing();
        if missing > 0 {
            ctx.report.warn(format!("{missing} of {n} buildings are not in `buildings`: their leaves are extruded"));
        }
        let city = City::new(footprints, tree, hulls, &input.landmarks, originals, self.skyline);
        ctx.check()?;
        let street = Street::of(footprints);
        let limits =
            Limits { triangles: self.max_triangles, bytes: self.max_bytes, prefer: self.prefer, stop: ctx.stop };
        let city = if build::fits_as_it_is(&city, &limits, city.root()) { city } else { city.with_forms() };
        ctx.check()?;
        let root = build::build(&city, &street, &limits, city.root());
        ctx.check()?;
        let (tree, exceeding) = flatten(&city, &street, root);
        ctx.report.fact("exceeding", exceeding);
        ctx.report.fact("extruded", if input.buildings.is_some() { missing } else { n });
        ctx.report.fact("street_points", street.points.len());
        Ok(tree)
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

/// The tiles in preorder with their features, and how many exceed a bound.
fn flatten(city: &City, street: &Street, root: Built) -> (TileTree, usize) {
    let levels = levels::report(city, &root, street);
    let mut tiles: Vec<Built> = Vec::new();
    let mut parent = Vec::new();
    let mut open = vec![(root, u32::MAX)];
    while let Some((mut t, above)) = open.pop() {
        let me = tiles.len() as u32;
        open.extend(std::mem::take(&mut t.children).into_iter().rev().map(|c| (c, me)));
        tiles.push(t);
        parent.push(above);
    }
    let mut tile_features = vec![0];
    for t in &tiles {
        tile_features.push(tile_features[tile_features.len() - 1] + t.feature_count(city) as u32);
    }
    let mut drawn: Vec<Drawn> = Vec::with_capacity(tile_features[tiles.len()] as usize);
    tiles.iter().for_each(|t| drawn.extend(t.features(city)));
    tiles.iter_mut().for_each(|t| t.drawn = Vec::new());
    let each = |of: &(dyn Fn(&Drawn) -> f64 + Sync)| drawn.par_iter().map(of).collect::<Vec<f64>>();
    let (ids, attributes) = rayon::join(
        || city.marks.order.iter().map(|&b| city.footprints.ids.get(b as usize)).collect(),
        || city.footprints.attributes.select(&city.marks.order),
    );
    let heights = |d: &Drawn| city.heights.within(&city.marks.height, city.places(d.node));
    let mut out = TileTree {
        frame: city.footprints.frame.clone(),
        parent,
        error: tiles.iter().map(|t| t.error).collect(),
        error_negative_space: tiles.iter().map(|t| t.error_space).collect(),
        error_height: tiles.iter().map(|t| t.error_height).collect(),
        source_first: tiles.iter().map(|t| city.first(t.node) as u32).collect(),
        source_count: tiles.iter().map(|t| city.size(t.node) as u32).collect(),
        tile_features,
        is_leaf: tiles.iter().map(|t| t.is_leaf).collect(),
        feature_first: drawn.iter().map(|d| city.first(d.node) as u32).collect(),
        feature_count: drawn.iter().map(|d| city.size(d.node) as u32).collect(),
        landmark: drawn.iter().map(|d| d.landmark).collect(),
        footprint_area_m2: each(&|d| city.built(d.node)),
        height_min: each(&|d| heights(d)[0]),
        height_max: each(&|d| heights(d)[1]),
        negative_space_m2: each(&|d| d.negative_space),
        base: each(&|d| stands(city, d)[0]),
        top: each(&|d| stands(city, d)[1]),
        plans: Shapes::default(),
        solids: Shapes::default(),
        semantics: Vec::new(),
        ids,
        attributes,
        levels,
    };
    let exceeding = tiles.iter().filter(|t| t.exceeds).count();
    let mut all = room(city, &tiles, drawn.len());
    let mut pen = Pen::default();
    let mut drawn = &drawn[..];
    for (t, ends) in tiles.into_iter().zip(out.tile_features.windows(2)) {
        let (own, others) = drawn.split_at((ends[1] - ends[0]) as usize);
        if t.is_leaf {
            own.iter().for_each(|d| all.draw(city, d, &mut pen));
        } else {
            all.plans.append(&t.content.plans);
            all.solids.append(&t.content.solids);
            all.semantics.extend(&t.content.semantics);
        }
        drawn = others;
    }
    (out.plans, out.solids, out.semantics) = (all.plans, all.solids, all.semantics);
    (out, exceeding)
}

/// A content with room for all that tiles draw, so that it need not grow: of leaves all footprints, once.
fn room(city: &City, tiles: &[Built], features: usize) -> Content {
    let mut out = Content::default();
    let inner = |of: fn(&Shapes<[i32; 2]>) -> usize| tiles.iter().map(|t| of(&t.content.plans)).sum::<usize>();
    let leaves = &city.footprints.polygons;
    out.plans.shapes.reserve_exact(features);
    out.solids.shapes.reserve_exact(features);
    if city.originals.buildings.is_none() {
        out.plans.polygons.reserve_exact(inner(|s| s.polygons.len()) + leaves.polygons.len());
        out.plans.rings.reserve_exact(inner(|s| s.rings.len()) + leaves.rings.len());
        out.plans.points.reserve_exact(inner(|s| s.points.len()) + leaves.points.len());
    }
    out
}

/// Between which heights a feature stands.
fn stands(city: &City, d: &Drawn) -> [f64; 2] {
    match (d.shape, city.originals.solid(city.first(d.node))) {
        (Shape::Original, Some((all, geometry))) => {
            let rings = all.surfaces.polygons_of(geometry).flat_map(|p| all.surfaces.rings_of(p));
            let heights = rings.flat_map(|r| all.surfaces.ring(r)).map(|p| f64::from(p[2]) / 1000.0);
            heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], z| [l.min(z), h.max(z)])
        }
        _ if city.is_leaf(d.node) => {
            let building = city.building(city.first(d.node));
            [city.footprints.base[building], city.footprints.top[building]]
        }
        _ => [city.ground(d.node), city.ground(d.node) + city.height(d.node)],
    }
}

#[cfg(test)]
mod tests;
