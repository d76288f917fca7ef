//! The tiles in preorder with their features, as the artifact has them.
//!
//! In two steps, so that hulls and landmarks need not be kept while the geometry of all leaves is put together.

use rayon::prelude::*;

use super::build::{Built, Drawn};
use super::city::City;
use super::content::Content;
use super::forms::Shape;
use super::originals::Originals;
use crate::artifact::tile_tree::Level;
use crate::artifact::{Shapes, TileTree};

/// All that is told of tiles and features, but ids and attributes; and the tiles, whose inner ones hold geometry.
pub struct Flat {
    tiles: Vec<Built>,
    told: TileTree,
}

impl Flat {
    pub fn new(city: &City, root: Built) -> Self {
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
        let heights = |d: &Drawn| city.heights.within(&city.marks.height, city.places(d.node));
        let told = TileTree {
            frame: city.originals.footprints.frame.clone(),
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
            ids: Default::default(),
            attributes: Default::default(),
            levels: Vec::new(),
        };
        Self { tiles, told }
    }

    /// How many tiles exceed a bound.
    pub fn exceeding(&self) -> usize {
        self.tiles.iter().filter(|t| t.exceeds).count()
    }

    /// With what they show: ids, attributes, and the geometry of leaves beside that of the others.
    pub fn drawn(self, originals: &Originals, levels: Vec<Level>) -> TileTree {
        let Self { tiles, told } = self;
        let (footprints, order) = (originals.footprints, &originals.order);
        let mut all = room(originals, &tiles, told.feature_first.len());
        for (i, t) in tiles.into_iter().enumerate() {
            if t.is_leaf {
                let features = told.tile_features[i] as usize..told.tile_features[i + 1] as usize;
                told.feature_first[features].iter().for_each(|&place| all.draw_original(originals, place as usize));
            } else {
                all.plans.append(&t.content.plans);
                all.solids.append(&t.content.solids);
                all.semantics.extend(&t.content.semantics);
            }
        }
        let (ids, attributes) = rayon::join(
            || order.iter().map(|&b| footprints.ids.get(b as usize)).collect(),
            || footprints.attributes.select(order),
        );
        let Content { plans, solids, semantics } = all;
        TileTree { plans, solids, semantics, ids, attributes, levels, ..told }
    }
}

/// A content with room for all that tiles draw, so that it need not grow: of leaves all footprints, once.
fn room(originals: &Originals, tiles: &[Built], features: usize) -> Content {
    let mut out = Content::default();
    let inner = |of: fn(&Shapes<[i32; 2]>) -> usize| tiles.iter().map(|t| of(&t.content.plans)).sum::<usize>();
    let leaves = &originals.footprints.polygons;
    out.plans.shapes.reserve_exact(features);
    out.solids.shapes.reserve_exact(features);
    if originals.buildings.is_none() {
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
            let (footprints, building) = (city.originals.footprints, city.building(city.first(d.node)));
            [footprints.base[building], footprints.top[building]]
        }
        _ => [city.ground(d.node), city.ground(d.node) + city.height(d.node)],
    }
}
