//! Draw a mesh onto its tiles: quads with a texture that stand for it from afar.
//!
//! In:     the mesh, and the planes that vote-tile found for it.
//! Out:    quads, one or more a tile, in one atlas of colour and coverage. A surface point is drawn where a plane within
//!         the tiles' reach faces its smooth normal (of a two-sided material either side); of several planes by the one
//!         that it faces most, then the nearest, then the first; along seams one texel of overlap, and up to two cells of
//!         what lies behind the neighbour's plane: seams close; what sticks out of the outlines that 128 eyes
//!         see is cut off, and what they still see through is closed (`holes`). What is nearest to the eye wins. Quads
//!         lie parallel to their tile's plane, where the surface that it is best for lies on average.
//!         Each connected piece of a tile gets the smallest rectangle around it, turned where that saves 15 %; pieces are
//!         joined where their rectangle with its surroundings grows by less than 20 %; below four texels they are
//!         dropped. A quad is seen from both sides if most of what it shows is (a mesh without materials is). Around each
//!         piece colours are bled eight texels far, and alpha is the one below a half that keeps the area drawn in four
//!         smaller copies best. `normal-map` adds an atlas of smooth normals. An atlas that would be too large gets fewer
//!         texels a cell.
//! Errors: frames that differ; a picture that cannot be read; no tile, or nothing drawn; pieces that do not fit.
//! Cost:   O(triangles x tiles) plane tests, O(fragments x tiles that reach them); a canvas of a tile's size at a time for
//!         each thread, 2^24 texels at most.
//! Source: Andújar et al., Computing maximal tiles and application to impostor-based simplification, section 5. Best
//!         tiles, pieces, alpha, and the report of 14 views and a million surface points are ours.
//! Tried:  three or five texels of overlap instead of one: the silhouette of a Buddha at 128 no better (0.951 and 0.951
//!         for 0.954), of a camera by 0.003; quads of two-sided materials culled: 0.77 for 0.95 on a car on a cloth; the
//!         nearest plane instead of the one faced most: +0.003, seams less straight, the house 0.003 worse; leftovers drawn
//!         by tiles two cells away: +0.002 on the car, -0.004 on the Buddha. Before quads were cut at outlines, 4.3 % of its
//!         pixels lay outside, each less than a cell off. Quads in the tile's plane itself: silhouettes of nine meshes .002
//!         worse on average at 128 cells, .009 at 32 (a helicopter .649 for .687); moved only so far that nothing is
//!         farther from a quad than the reach: a fifth of that, or less.

mod atlas;
mod canvas;
mod eyes;
mod holes;
mod pieces;
mod planes;

use rayon::prelude::*;

use crate::artifact::impostors::Worth;
use crate::artifact::{Impostors, Mesh, PlaneTiles};
use crate::diag::{Diagnostic, Result};
use crate::io::paint::Paint;
use crate::io::views;
use crate::op::{Ctx, Op};
use atlas::{Atlas, Packed, pack};
use holes::Mending;
use pieces::Piece;
use planes::{Planes, Reached, Scene};

crate::params! {
    /// Quads with a texture that stand for a mesh from afar.
    pub struct BakeImpostor {
        /// Texels along the side of a grid cell; fewer if the atlas would be too large.
        #[schemars(range(min = 0.25, max = 16.0))]
        pub texels_per_cell: f64 = 2.0,
        /// Largest side of the atlas.
        #[schemars(range(min = 64, max = 16384), extend("x-unit" = "px"))]
        pub max_atlas_px: u32 = 4096,
        /// A second atlas of normals, so that light can fall on the quads; without it they keep their colours.
        pub normal_map: bool = false,
    }
}

crate::inputs! {
    /// What to draw.
    mesh: Mesh,
    /// Planes to draw it on.
    tiles: PlaneTiles,
}

impl Op for BakeImpostor {
    const NAME: &'static str = "bake-impostor";
    const VERSION: u32 = 5;
    type In = In;
    type Out = Impostors;

    fn run(&self, ctx: &Ctx, input: In) -> Result<Impostors> {
        bake_impostor(&input.mesh, &input.tiles, self, || ctx.check())
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (150 << 20) + 5 * input_bytes
    }
}

/// Densities that are tried one after the other.
const TRIES: usize = 12;
/// Each this much of the one before.
const SPARSER: f64 = 0.75;
/// A pixel of 1080 rows and 60 degrees, seen from a metre: 2 tan 30 / 1080.
const PIXEL: f64 = 1.154_700_538_379_251_7 / 1080.0;

pub fn bake_impostor(
    mesh: &Mesh,
    tiles: &PlaneTiles,
    how: &BakeImpostor,
    check: impl Fn() -> Result<()>,
) -> Result<Impostors> {
    if mesh.frame != tiles.frame {
        return Err(Diagnostic::error("other-frame", "mesh and tiles do not lie in the same frame"));
    }
    if tiles.is_empty() {
        let help = "fewer `min-votes`, or a finer `resolution`, find some";
        return Err(Diagnostic::error("no-tiles", "there are no tiles to draw on").help(help));
    }
    let paint = Paint::new(mesh);
    if let Some(fault) = paint.faults.first() {
        return Err(Diagnostic::error("bad-picture", fault));
    }
    let mut planes = Planes::new(tiles);
    let reached = Reached::new(mesh, &planes);
    planes.settle(mesh, &paint, &reached);
    let scene = Scene { mesh, paint: &paint, planes: &planes, reached: &reached };
    // (1) Every tile's pieces, in an atlas that fits: without what sticks out of the first ones, and without their holes.
    let none = Mending::none();
    let densities = std::iter::successors(Some(how.texels_per_cell), |d| Some(d * SPARSER)).take(TRIES);
    let mut density = densities.into_iter().find(|&d| fits(&scene, &none, d)).ok_or_else(|| too_large(how))?;
    let mending = Mending::new(&scene, &all_pieces(&scene, &none, density));
    check()?;
    let (pieces, packed) = fit(&scene, &mending, how, &mut density, &check)?;

    // (2) The atlas and the quads.
    let atlas = Atlas::fill(&pieces, &packed, how.normal_map);
    let size = packed.size;
    let mut out = Impostors {
        frame: mesh.frame.clone(),
        corners: Vec::new(),
        uvs: Vec::new(),
        normals: Vec::new(),
        tangents: Vec::new(),
        tiles: Vec::new(),
        two_sided: Vec::new(),
        colour: atlas.colour.png(),
        normal_map: atlas.normals.map_or_else(Vec::new, |normals| normals.png()),
        sheet: Vec::new(),
        worth: Worth::default(),
    };
    for (piece, &[x, y]) in pieces.iter().zip(&packed.places) {
        let window = &piece.window;
        out.corners.extend(window.corners());
        let at = |x: u32, y: u32| [x as f32 / size[0] as f32, y as f32 / size[1] as f32];
        let (right, down) = (x + window.size[0], y + window.size[1]);
        out.uvs.extend([at(x, down), at(right, down), at(right, y), at(x, y)]);
        out.normals.push(window.axes[2].map(|c| c as f32));
        out.tangents.push(window.axes[0].map(|c| c as f32));
        out.tiles.push(piece.tile as u32);
        out.two_sided.push(piece.two_sided());
    }
    check()?;

    // (3) What it is worth.
    let quads = out.mesh();
    let cameras = views::cameras(mesh);
    let quad_paint = Paint::new(&quads);
    let (plain, shaded) = views::all_both(mesh, &paint, &cameras);
    let (quads_plain, quads_shaded) = views::all_both(&quads, &quad_paint, &cameras);
    let like = views::likeness(&plain, &quads_plain);
    // Bare surfaces show by their shading.
    let bare = mesh.surface.materials.is_empty();
    let sets = if bare { [shaded, quads_shaded] } else { [plain, quads_plain] };
    out.sheet = views::on_sheet(&sets).png();
    let mut of_tile = vec![Vec::new(); planes.len()];
    pieces.iter().for_each(|p| of_tile[p.tile].push(p));
    let cell = tiles.lattice.cell;
    out.worth = Worth {
        error_m: cell,
        distance_m: cell / PIXEL,
        texels_per_cell: density,
        silhouette: like.silhouette,
        colour_error: like.colour,
        holes: like.holes,
        drawn: scene.share_drawn(|k, p| of_tile[k].iter().any(|piece| piece.draws(p))),
        atlas: size,
        filled: atlas.filled,
        coverage: atlas.coverage,
        original_triangles: mesh.triangles.len() as u32,
    };
    Ok(out)
}

/// Whether each tile's canvas can be drawn within memory.
fn fits(scene: &Scene, mending: &Mending, density: f64) -> bool {
    let texel = scene.planes.cell / density;
    (0..scene.planes.len()).all(|k| canvas::around(scene, k, texel, mending).fits())
}

fn all_pieces(scene: &Scene, mending: &Mending, density: f64) -> Vec<Piece> {
    let texel = scene.planes.cell / density;
    (0..scene.planes.len()).into_par_iter().flat_map_iter(|k| pieces::pieces(scene, k, texel, mending)).collect()
}

/// Every tile's pieces in an atlas, with fewer texels a cell where it would be too large.
fn fit(
    scene: &Scene,
    mending: &Mending,
    how: &BakeImpostor,
    density: &mut f64,
    check: impl Fn() -> Result<()>,
) -> Result<(Vec<Piece>, Packed)> {
    for _ in 0..TRIES {
        check()?;
        if fits(scene, mending, *density) {
            let pieces = all_pieces(scene, mending, *density);
            if pieces.is_empty() {
                return Err(Diagnostic::error("nothing-drawn", "no tile draws as much as four texels"));
            }
            let sizes: Vec<[u32; 2]> = pieces.iter().map(|p| p.window.size).collect();
            if let Some(packed) = pack(&sizes, how.max_atlas_px) {
                return Ok((pieces, packed));
            }
        }
        *density *= SPARSER;
    }
    Err(too_large(how))
}

fn too_large(how: &BakeImpostor) -> Box<Diagnostic> {
    Diagnostic::error("small-atlas", format!("the quads do not fit into {} px", how.max_atlas_px))
}

#[cfg(test)]
mod tests;
