//! Write a tile tree as 3D Tiles 1.1: `tileset.json`, a GLB for each tile, the ids of each leaf.
//!
//! In:     tiles with features in the local frame.
//! Out:    `tileset.json`; `t/<digest>.glb`, one a tile, named by the first 16 bytes of its BLAKE3 digest; beside each
//!         leaf's content `t/<digest>.ids.json` (`{"ids": [..]}` of its buildings in leaf order). Refinement is
//!         REPLACE, every tile has a box along its own east, north and up, and `transform` puts it on the globe. A
//!         tile's metadata say `source_first`, `source_count`, `error_negative_space`, `error_height`, `extruded`.
//! Facts:  `tiles`, `triangles`, `content_bytes`, `content_bytes_max`.
//! Errors: no tile; a tile where the coordinate reference system does not reach. Warned of: no system at all (the tileset is
//!         then local), national heights without `height-offset`, features that come to no triangle.
//! Cost:   O(vertices), tiles in parallel, one tile a thread in memory.
//! Source: 3D Tiles 1.1; ALGORITHMS, *cut, tile*: contents hold nothing global, so that a small edit changes few.
//! Tried:  positions as 16-bit numbers (20 bytes a corner would be 16): to stay within a centimetre a tile may be 800 m
//!         wide, which six in ten are not, so 6 % of all bytes; in pieces of that size 13 %, but four times the draw calls.

mod content;

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde_json::{Value, json};

use crate::artifact::files::{self, File};
use crate::artifact::{Blob, Files, TileTree};
use crate::diag::{Diagnostic, Result};
use crate::geom::chart::{Chart, Ecef, Place};
use crate::geom::crs::Crs;
use crate::io::gltf::{self, Model};
use crate::io::tiles3d::{Asset, Content, Metadata, Refine, Schema, Tile, Tileset, Volume};
use crate::op::{Ctx, Op};
use crate::{inputs, params};

params! {
    /// A tileset in a folder of its own.
    pub struct WriteTileset {
        /// Folder below the output folder.
        #[schemars(extend("x-required" = true, "x-output" = "folder"))]
        pub path: String = String::new(),
        /// Added to every height before the way to the globe: the geoid's height above the ellipsoid, where heights
        /// are national.
        #[schemars(extend("x-unit" = "m"))]
        pub height_offset: f64 = 0.0,
    }
}

inputs! {
    /// What each tile shows.
    tree: TileTree,
}

impl Op for WriteTileset {
    const NAME: &'static str = "write-tileset";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Files;
    const FACTS: &'static [(&'static str, &'static str)] = &[
        ("tiles", "number of tiles"),
        ("triangles", "triangles of all tiles"),
        ("content_bytes", "sizes of all contents together"),
        ("content_bytes_max", "size of the largest content"),
    ];

    fn run(&self, ctx: &Ctx, input: In) -> Result<Files> {
        let tree = &*input.tree;
        let globe = tree.frame.globe()?;
        if globe.is_none() {
            ctx.report.warn("the data name no coordinate reference system: the tileset is local, not on the globe");
        } else if self.height_offset == 0.0 && Crs::parse(&tree.frame.crs).is_ok_and(|c| c.national_heights) {
            ctx.report.warn(format!(
                "heights of `{}` are national but taken as ellipsoidal: `height-offset` mends it",
                tree.frame.crs
            ));
        }
        let ecef = globe.as_ref().map(|g| |p: [f64; 3]| g.ecef(p));
        let mut files = write_tileset(ctx, tree, ecef.as_ref().map(|e| e as Ecef), self.height_offset)?;
        files.files.iter_mut().for_each(|f| f.path = files::below(&self.path, &f.path));
        Ok(files)
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        // The tree, and a tile a thread.
        (4 << 20) + input_bytes * 3 / 2
    }
}

/// What of a tile is known once its content is written.
struct Written {
    place: Place,
    /// Of the content, along the tile's axes.
    low: [f64; 3],
    high: [f64; 3],
    content: Option<Blob>,
    ids: Option<Blob>,
    triangles: u64,
    empty: Vec<usize>,
}

/// Writes the contents as they come, then `tileset.json` over them. `ecef` is the way to the globe.
pub fn write_tileset(ctx: &Ctx, tree: &TileTree, ecef: Option<Ecef>, offset: f64) -> Result<Files> {
    if tree.is_empty() {
        return Err(Diagnostic::error("no-tiles", "a tileset needs a tile, and the tree has none"));
    }
    let tiles: Vec<Written> = (0..tree.len())
        .into_par_iter()
        .with_max_len(1)
        .map(|t| write_tile(ctx, tree, t, ecef, offset))
        .collect::<Result<_>>()?;
    let empty: Vec<usize> = tiles.iter().flat_map(|t| &t.empty).copied().collect();
    if let Some(&f) = empty.first() {
        let id = tree.ids.get(tree.feature_first[f] as usize);
        ctx.report.warn(format!("{} features come to no triangle; the first holds `{id}`", empty.len()));
    }
    let sizes = || tiles.iter().filter_map(|t| t.content).map(|b| b.bytes);
    ctx.report.fact("tiles", tiles.len());
    ctx.report.fact("triangles", tiles.iter().map(|t| t.triangles).sum::<u64>());
    ctx.report.fact("content_bytes", sizes().sum::<u64>());
    ctx.report.fact("content_bytes_max", sizes().max().unwrap_or(0));

    let text = tileset(tree, &tiles).to_bytes();
    let mut files = Vec::new();
    for tile in &tiles {
        let Some(content) = tile.content else { continue };
        files.push(File { path: content_path(content), blob: content, last: false });
        files.extend(tile.ids.map(|ids| File { path: ids_path(content), blob: ids, last: false }));
    }
    files.push(File { path: "tileset.json".into(), blob: put(ctx, &text)?, last: true });
    files.sort_by(|a, b| a.path.cmp(&b.path));
    // Two tiles may draw the very same.
    files.dedup_by(|a, b| a.path == b.path);
    Ok(Files { files })
}

fn content_path(content: Blob) -> String {
    format!("t/{}.glb", content.digest.short(16))
}

fn ids_path(content: Blob) -> String {
    format!("t/{}.ids.json", content.digest.short(16))
}

fn put(ctx: &Ctx, bytes: &[u8]) -> Result<Blob> {
    ctx.blobs.put(bytes).map_err(|e| Diagnostic::error("io", format!("cannot keep a tile's content: {e}")))
}

fn write_tile(ctx: &Ctx, tree: &TileTree, t: usize, ecef: Option<Ecef>, offset: f64) -> Result<Written> {
    ctx.check()?;
    let (low, high) = window(tree, t);
    let [x, y] = origin(low, high);
    let chart = match ecef {
        Some(ecef) => Chart::on_globe(ecef, [x, y, offset], low, high),
        None => Chart::flat([x, y, offset]),
    };
    let drawn = content::draw(tree, t, &chart, offset);
    let finite = drawn.low.iter().chain(&drawn.high).chain(&chart.place.origin).all(|v| v.is_finite());
    if !finite && drawn.triangles > 0 {
        let id = tree.ids.get(tree.source_first[t] as usize);
        let message = format!("`{}` does not reach the tile of `{id}`", tree.frame.crs);
        return Err(Diagnostic::error("off-the-globe", message).value(format!("[{x}, {y}] m from the frame's origin")));
    }
    let mut out = Written {
        place: chart.place,
        low: drawn.low,
        high: drawn.high,
        content: None,
        ids: None,
        triangles: drawn.triangles,
        empty: drawn.empty,
    };
    let features = tree.features_of(t).len();
    if drawn.triangles > 0 {
        let (own, attributes) = content::table(tree, t);
        let (own, attributes) = (&own, &attributes);
        let model = Model { parts: &drawn.parts, normals: true, features, own, attributes, origin: [0.0; 3] };
        out.content = Some(put(ctx, &gltf::glb(&model))?);
        if tree.is_leaf[t] {
            let first = tree.source_first[t] as usize;
            let ids: Vec<&str> = (first..first + tree.source_count[t] as usize).map(|i| tree.ids.get(i)).collect();
            out.ids = Some(put(ctx, &serde_json::to_vec(&json!({ "ids": ids })).expect("ids are text"))?);
        }
    }
    Ok(out)
}

/// The plan's window of what a tile draws, metres; `[0, 0]` twice where it draws nothing.
fn window(tree: &TileTree, t: usize) -> ([f64; 2], [f64; 2]) {
    let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
    let mut meet = |x: i32, y: i32| {
        low = [low[0].min(x), low[1].min(y)];
        high = [high[0].max(x), high[1].max(y)];
    };
    for f in tree.features_of(t) {
        tree.plans.polygons_of(f).flat_map(|p| tree.plans.rings_of(p)).for_each(|r| {
            tree.plans.ring(r).iter().for_each(|p| meet(p[0], p[1]));
        });
        tree.solids.polygons_of(f).flat_map(|p| tree.solids.rings_of(p)).for_each(|r| {
            tree.solids.ring(r).iter().for_each(|p| meet(p[0], p[1]));
        });
    }
    if low[0] > high[0] {
        return ([0.0; 2], [0.0; 2]);
    }
    (low.map(|v| f64::from(v) / 1000.0), high.map(|v| f64::from(v) / 1000.0))
}

/// A tile's origin: the middle of its window, on a grid of about its own size, so that a building more at its edge
/// seldom moves it. No coordinate is longer than the window: f32 keeps a millimetre up to 16 km, 4 mm up to 64 km.
fn origin(low: [f64; 2], high: [f64; 2]) -> [f64; 2] {
    let size = (high[0] - low[0]).max(high[1] - low[1]);
    let mut cell = 1.0;
    while cell * 2.0 < size {
        cell *= 2.0;
    }
    [0, 1].map(|k| ((low[k] + high[k]) / 2.0 / cell).round() * cell + 0.0)
}

/// The tree over the contents: boxes around contents and children, places relative to the parents'.
fn tileset(tree: &TileTree, tiles: &[Written]) -> Tileset {
    let (mut low, mut high): (Vec<_>, Vec<_>) = tiles.iter().map(|t| (t.low, t.high)).unzip();
    let mut out = Vec::with_capacity(tree.len());
    // Children come after their parents, so from the end every tile finds its own complete.
    for t in (0..tree.len()).rev() {
        let parent = (tree.parent[t] != u32::MAX).then_some(tree.parent[t] as usize);
        let volume = volume(low[t], high[t]);
        let place = match parent {
            Some(p) if tiles[t].place == tiles[p].place => Place::flat([0.0; 3]),
            Some(p) => tiles[t].place.within(&tiles[p].place),
            None => tiles[t].place,
        };
        if let Some(p) = parent {
            for corner in volume.corners().map(|c| place.global(c)) {
                low[p] = [0, 1, 2].map(|k| low[p][k].min(corner[k]));
                high[p] = [0, 1, 2].map(|k| high[p][k].max(corner[k]));
            }
        }
        let content = tiles[t].content.map(|content| Content {
            uri: content_path(content),
            extras: tiles[t].ids.map_or(Value::Null, |_| json!({ "ids": ids_path(content) })),
        });
        out.push(Tile {
            parent,
            bounding_volume: volume,
            geometric_error: tree.error[t],
            refine: parent.is_none().then_some(Refine::Replace),
            transform: (place != Place::flat([0.0; 3])).then(|| place.matrix()),
            content,
            metadata: metadata(tree, t),
        });
    }
    out.reverse();
    let b = &out[0].bounding_volume.bounds;
    let diagonal = 2.0 * (b[3] * b[3] + b[7] * b[7] + b[11] * b[11]).sqrt();
    Tileset {
        asset: Asset { version: "1.1".into(), generator: "lodge".into() },
        geometric_error: diagonal.max(out[0].geometric_error),
        schema: schema(),
        extras: json!({ "crs": tree.frame.crs, "levels": tree.levels }),
        tiles: out,
    }
}

/// A box on whole millimetres, one more on each side: rounding on the way through parents stays inside.
fn volume(low: [f64; 3], high: [f64; 3]) -> Volume {
    if !(0..3).all(|k| low[k] <= high[k]) {
        return Volume::between([-0.001; 3], [0.001; 3]);
    }
    let low = low.map(|v| ((v * 1000.0).floor() - 1.0) / 1000.0);
    let high = high.map(|v| ((v * 1000.0).ceil() + 1.0) / 1000.0);
    Volume::between(low, high)
}

fn metadata(tree: &TileTree, t: usize) -> Metadata {
    let extruded = tree.features_of(t).all(|f| tree.solids.polygons_of(f).is_empty());
    let properties = [
        ("source_first", json!(tree.source_first[t])),
        ("source_count", json!(tree.source_count[t])),
        ("error_negative_space", json!(tree.error_negative_space[t])),
        ("error_height", json!(tree.error_height[t])),
        ("extruded", json!(extruded)),
    ];
    Metadata { class: "tile".into(), properties: properties.map(|(k, v)| (k.to_string(), v)).into() }
}

fn schema() -> Schema {
    let number = |kind: &str, doc: &str| json!({ "type": "SCALAR", "componentType": kind, "required": true, "description": doc });
    let properties: BTreeMap<&str, Value> = [
        ("source_first", number("UINT32", "place of the tile's first building in the whole order")),
        ("source_count", number("UINT32", "buildings of the tile")),
        ("error_negative_space", number("FLOAT64", "largest square root of negative space drawn, metres")),
        ("error_height", number("FLOAT64", "largest height difference drawn, metres")),
        (
            "extruded",
            json!({ "type": "BOOLEAN", "required": true,
            "description": "all that the tile draws stands between one lowest and one highest height" }),
        ),
    ]
    .into();
    let tile = json!({ "name": "tile", "properties": properties });
    Schema { id: "lodge".into(), classes: [("tile".to_string(), tile)].into() }
}
