//! Where eyes around the mesh see through its quads, and which tile closes the hole.
//!
//! In:     the scene, and every tile's pieces.
//! Out:    patches for each tile: lines of its plane along which its texels go on. Quads of neighbouring parts lie up to
//!         a reach off the surface, so an eye can see between their ends. A point is missing that an eye sees of the
//!         mesh, more than 2 pixels from its outline, where no quad draws anything. Of the tiles that draw the point
//!         and turn to the eye, the one whose texels have to go on least goes on, at most two cells, up to where the
//!         ray meets its plane; where there is none, the tile that the ray meets first shows the point. Only what lies
//!         within half a cell of every eye's outline is taken: so nothing sticks out.
//! Cost:   O(eyes x (triangles + pixels of triangles and quads)).
//! Source: ours. Most of these eyes lie 10 to 35 degrees from those of the report, which so measures what eyes in
//!         other places see.
//! Tried:  on a folded cloth at 128, with min-votes 2, 0.48 % of the pixels inside the outline were missing, 0.03 % are
//!         (32 eyes: 0.05 %, 48: 0.02 %); tiles that go on into nothing up to where their planes meet, along
//!         every seam: 0.24 %, and the silhouette of a Buddha from 0.950 to 0.930; without the look at every outline:
//!         0.01 %, and 0.952 to 0.950 (with it 0.953); other quads three or ten cells behind count as a hole: 0.04 %,
//!         and 0.942 to 0.945.

use rayon::prelude::*;

use super::pieces::Piece;
use super::planes::Scene;
use crate::geom::raster;
use crate::geom::space::{Vec3, cross, dot, sub, unit};
use crate::io::views::{self, Hit, SIDE, View};

/// Directions, evenly spread.
const EYES: usize = 36;
/// Pixels from the outline within which nothing is missing.
const OUTLINE: i64 = 2;
/// Cells that a tile's texels go on.
const LONGEST: f64 = 2.0;
/// Cells from its plane within which a tile shows a point that none draws.
const FAR: f64 = 2.0;
/// Quads that turn away more than that close nothing.
const STEEP: f64 = 0.2;

/// A tile's texels go on along a line of its plane.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    pub from: Vec3,
    pub to: Vec3,
    /// Linear.
    pub light: [f32; 3],
    /// On the side that the tile shows.
    pub normal: Vec3,
    pub two_sided: bool,
}

/// What an eye sees of the mesh: at which pixels, and what of it is missing.
struct Sight {
    view: View,
    /// Half a cell around as well.
    around: Vec<bool>,
    missing: Vec<Hit>,
}

/// What closes holes, by tile.
pub fn patches(scene: &Scene, pieces: &[Piece]) -> Vec<Vec<Patch>> {
    let mut of_tile = vec![Vec::new(); scene.planes.len()];
    pieces.iter().for_each(|p| of_tile[p.tile].push(p));
    let sights = sights(scene, pieces);
    let missing: Vec<(&View, &Hit)> =
        sights.iter().flat_map(|s| s.missing.iter().map(move |hit| (&s.view, hit))).collect();
    let close = |&(view, hit): &(&View, &Hit)| patch(scene, view, hit, &of_tile, &sights);
    let found: Vec<(usize, Patch)> = missing.par_iter().filter_map(close).collect();
    let mut out = vec![Vec::new(); scene.planes.len()];
    found.into_iter().for_each(|(k, patch)| out[k].push(patch));
    out
}

impl Sight {
    /// Whether a point lies in the mesh's outline, or no more than half a cell outside.
    fn has(&self, p: Vec3) -> bool {
        let ([x, y], side) = (self.view.place(p).0.map(|c| c.div_euclid(raster::PARTS)), i64::from(SIDE));
        (0..side).contains(&x) && (0..side).contains(&y) && self.around[(y * side + x) as usize]
    }
}

/// Pixels at most `far` from one of these, along rows and columns.
fn grown(mut pixels: Vec<bool>, far: usize) -> Vec<bool> {
    let side = SIDE as usize;
    for (line, step) in [(side, 1), (1, side)] {
        for i in 0..side {
            let at = |k: usize| i * line + k * step;
            let marked: Vec<usize> = (0..side).filter(|&k| pixels[at(k)]).collect();
            for k in marked {
                (k.saturating_sub(far)..=(k + far).min(side - 1)).for_each(|k| pixels[at(k)] = true);
            }
        }
    }
    pixels
}

fn sights(scene: &Scene, pieces: &[Piece]) -> Vec<Sight> {
    (0..EYES).into_par_iter().map(|i| sight(scene, eye(scene, i), pieces)).collect()
}

/// Pixels of all eyes where something is missing.
#[cfg(test)]
pub fn missing(scene: &Scene, pieces: &[Piece]) -> usize {
    sights(scene, pieces).iter().map(|s| s.missing.len()).sum()
}

/// One of the directions of a spiral from pole to pole.
fn eye(scene: &Scene, i: usize) -> View {
    let z = 1.0 - (2 * i + 1) as f64 / EYES as f64;
    let around = (1.0 - z * z).sqrt();
    // The golden angle.
    let (sin, cos) = libm::sincos(i as f64 * 2.399_963_229_728_653);
    let eye = [around * cos, around * sin, z];
    let right = unit(cross([0.0, 0.0, 1.0], eye));
    View { axes: [right, cross(eye, right), eye], ..views::cameras(scene.mesh)[0] }
}

fn sight(scene: &Scene, view: View, pieces: &[Piece]) -> Sight {
    let hits = views::hits(scene.mesh, scene.paint, &view);
    let covered = covered(&view, pieces);
    let missing = (0..hits.len()).filter(|&i| !covered[i] && is_inner(&hits, i)).filter_map(|i| hits[i]).collect();
    let half = 0.5 * scene.planes.cell / view.half * f64::from(SIDE / 2);
    let around = grown(hits.iter().map(Option::is_some).collect(), (half as usize).clamp(1, SIDE as usize));
    Sight { view, around, missing }
}

fn is_inner(hits: &[Option<Hit>], i: usize) -> bool {
    let side = i64::from(SIDE);
    let (x, y) = (i as i64 % side, i as i64 / side);
    let is_there =
        |x: i64, y: i64| (0..side).contains(&x) && (0..side).contains(&y) && hits[(y * side + x) as usize].is_some();
    (y - OUTLINE..=y + OUTLINE).all(|v| (x - OUTLINE..=x + OUTLINE).all(|u| is_there(u, v)))
}

/// Pixels where a quad draws something.
fn covered(view: &View, pieces: &[Piece]) -> Vec<bool> {
    let mut out = vec![false; (SIDE * SIDE) as usize];
    for piece in pieces {
        let facing = dot(piece.window.axes[2], view.axes[2]);
        if facing == 0.0 || facing < 0.0 && !piece.two_sided() {
            continue;
        }
        let [w, h] = piece.window.size.map(f64::from);
        // Where they are on the picture, and which texels.
        let corners = piece.window.corners().map(|p| view.place(p).0);
        let texels = [[0.0, h], [w, h], [w, 0.0], [0.0, 0.0]];
        for half in [[0, 1, 2], [0, 2, 3]] {
            let [a, b, c] = half.map(|k: usize| texels[k]);
            raster::cover(&half.map(|k| corners[k]), [SIDE; 2], |x, y, w| {
                let covered = &mut out[(y * SIDE + x) as usize];
                if !*covered {
                    let [u, v] = [0, 1].map(|k| w[0] * a[k] + w[1] * b[k] + w[2] * c[k]);
                    *covered = piece.shows(u as u32, v as u32);
                }
            });
        }
    }
    out
}

/// What closes the hole at a place that the eye should see.
fn patch(scene: &Scene, view: &View, hit: &Hit, of_tile: &[Vec<&Piece>], sights: &[Sight]) -> Option<(usize, Patch)> {
    let (planes, t) = (scene.planes, hit.triangle);
    let corners = scene.mesh.corners(t);
    let p = [0, 1, 2].map(|k| (0..3).map(|c| hit.weights[c] * corners[c][k]).sum::<f64>());
    let (smooth, two_sided) = (scene.paint.normal(t, hit.weights), scene.paint.material(t).double_sided);
    // Too small to have a direction.
    if smooth == [0.0; 3] {
        return None;
    }
    // (1) Every tile that turns to the surface and to the eye: how far it is, and where the eye's ray meets it; inside
    //     the outline that every eye sees.
    let meets = |k: usize| {
        let (normal, off) = (planes.normal(k), planes.distance(k, p));
        let (facing, shown) = (dot(normal, smooth), dot(normal, view.axes[2]));
        let turned = shown.abs() >= STEEP && (two_sided || facing > 0.0 && shown > 0.0);
        let to = [0, 1, 2].map(|c| p[c] - off / shown * view.axes[2][c]);
        (turned && off.abs() <= FAR * planes.cell).then_some((off, to, facing, shown))
    };
    let length = |v: Vec3| dot(v, v).sqrt();

    // (2) Of those that draw it, the one that has to go on least.
    let goes_on = |k: usize| {
        let (off, to, facing, shown) = meets(k)?;
        let from = [0, 1, 2].map(|c| p[c] - off * planes.normal(k)[c]);
        let draws = |piece: &&Piece| (shown > 0.0 || piece.two_sided()) && piece.draws(from);
        let beside = length(sub(to, from));
        let can = off.abs() <= planes.reach && beside <= LONGEST * planes.cell && of_tile[k].iter().any(draws);
        (can && sights.iter().all(|s| s.has(to))).then_some((beside, k, from, to, facing))
    };
    let reached = scene.reached.tiles(t).iter().map(|&k| k as usize);
    // (3) Where none draws it, the one that the ray meets first.
    let is_met = |k: usize| {
        let (_, to, facing, _) = meets(k)?;
        sights.iter().all(|s| s.has(to)).then_some((length(sub(to, p)), k, to, to, facing))
    };
    let least = |a: &(f64, usize, Vec3, Vec3, f64), b: &(f64, usize, Vec3, Vec3, f64)| a.0.total_cmp(&b.0);
    let first = || (0..planes.len()).filter_map(is_met).min_by(least);
    let (_, k, from, to, facing) = reached.filter_map(goes_on).min_by(least).or_else(first)?;
    let normal = if facing < 0.0 { smooth.map(|c| -c) } else { smooth };
    Some((k, Patch { from, to, light: hit.light(scene.paint), normal, two_sided }))
}
