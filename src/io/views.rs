//! Pictures of a mesh from 14 sides: six axes, eight corners; parallel light rays, base colours only.
//!
//! 512 x 512 pixels around the sphere of the mesh's box, one sample a pixel, no smoothing: what is compared must be drawn
//! by one rule. Backs are left out where the material says so. A contact sheet is shaded, so that bare meshes show.

use rayon::prelude::*;

use super::paint::Paint;
use super::picture::{Level, linear, screen};
use crate::artifact::mesh::Alpha;
use crate::artifact::{Impostors, Mesh};
use crate::diag::{Diagnostic, Result};
use crate::geom::raster::{self, PARTS};
use crate::geom::space::{bounds, cross, dot, sub, unit};

/// Pixels along each side.
pub const SIDE: u32 = 512;

/// A camera without perspective: rows are right, up, and towards the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    pub axes: [[f64; 3]; 3],
    /// What is in the middle of the picture, and half of its width.
    pub middle: [f64; 3],
    pub half: f64,
}

/// What one camera sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Each pixel on a screen, rows from the top; all 0 where nothing is, else alpha is 255.
    pub pixels: Vec<[u8; 4]>,
}

/// The 14 cameras: +x, -x, +y, -y, +z, -z, then the corners, x first; z is up, y from above and below.
pub fn cameras(mesh: &Mesh) -> [View; 14] {
    let (low, high) = bounds(mesh.positions.iter().copied());
    let middle = [0, 1, 2].map(|k| if low[k] <= high[k] { (low[k] + high[k]) / 2.0 } else { 0.0 });
    let far = |p: &[f64; 3]| {
        let d = sub(*p, middle);
        dot(d, d)
    };
    let radius = mesh.positions.iter().map(far).fold(0.0, f64::max).sqrt();
    let half = if radius > 0.0 { 1.02 * radius } else { 1.0 };
    std::array::from_fn(|i| {
        let eye: [f64; 3] = match i {
            0..6 => std::array::from_fn(|k| if k == i / 2 { 1.0 - 2.0 * (i % 2) as f64 } else { 0.0 }),
            _ => std::array::from_fn(|k| if (i - 6) >> k & 1 == 0 { 1.0 } else { -1.0 }),
        };
        let up = if i / 2 == 2 { [0.0, 1.0, 0.0] } else { [0.0, 0.0, 1.0] };
        View { axes: axes(eye, up), middle, half }
    })
}

/// Right, up and towards the eye, of length one.
fn axes(eye: [f64; 3], up: [f64; 3]) -> [[f64; 3]; 3] {
    let eye = unit(eye);
    let right = unit(cross(up, eye));
    [right, cross(eye, right), eye]
}

impl View {
    /// Where a point is on the picture, in parts of a pixel, and how near, in metres.
    pub fn place(&self, p: [f64; 3]) -> ([i64; 2], f64) {
        let middle = f64::from(SIDE) / 2.0;
        let [x, y, z] = self.axes.map(|a| dot(a, sub(p, self.middle)));
        let part = |v: f64| (v * PARTS as f64).round() as i64;
        let scale = middle / self.half;
        ([part(middle + x * scale), part(middle - y * scale)], z)
    }
}

/// What a camera sees at a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    pub triangle: usize,
    /// Of its corners.
    pub weights: [f64; 3],
    /// Of the copies of its picture.
    pub level: usize,
}

/// What a camera sees of a mesh. `shaded`: darker where the surface turns away.
pub fn draw(mesh: &Mesh, paint: &Paint, view: &View, shaded: bool) -> Seen {
    let mut out = blank();
    for (pixel, hit) in out.pixels.iter_mut().zip(hits(mesh, paint, view)) {
        let Some(hit) = hit else { continue };
        let light = hit.light(paint);
        *pixel = on_screen(if shaded { light.map(|l| l * hit.shade(paint, view)) } else { light });
    }
    out
}

/// The same without shades and with them, at the cost of one.
fn draw_both(mesh: &Mesh, paint: &Paint, view: &View) -> (Seen, Seen) {
    let (mut plain, mut shaded) = (blank(), blank());
    // Of the triangle before, mostly the same.
    let (mut shade_of, mut shade) = (usize::MAX, 0.0);
    for (i, hit) in hits(mesh, paint, view).enumerate() {
        let Some(hit) = hit else { continue };
        if hit.triangle != shade_of {
            (shade_of, shade) = (hit.triangle, hit.shade(paint, view));
        }
        let light = hit.light(paint);
        plain.pixels[i] = on_screen(light);
        shaded.pixels[i] = on_screen(light.map(|l| l * shade));
    }
    (plain, shaded)
}

impl Hit {
    pub fn light(&self, paint: &Paint) -> [f32; 3] {
        paint.at(self.triangle, self.weights, self.level).unwrap_or_default()
    }

    fn shade(&self, paint: &Paint, view: &View) -> f32 {
        0.3 + 0.7 * dot(paint.face_normal(self.triangle), view.axes[2]).abs() as f32
    }
}

/// No triangle.
const NONE: u32 = u32::MAX;

fn blank() -> Seen {
    Seen { pixels: vec![[0; 4]; (SIDE * SIDE) as usize] }
}

fn on_screen(light: [f32; 3]) -> [u8; 4] {
    let [r, g, b] = light.map(screen);
    [r, g, b, 255]
}

/// What a camera sees at each pixel, rows from the top: what is nearest; of that the first triangle.
fn hits(mesh: &Mesh, paint: &Paint, view: &View) -> impl Iterator<Item = Option<Hit>> {
    let placed: Vec<([i64; 2], f64)> = mesh.positions.iter().map(|&p| view.place(p)).collect();
    let mut levels = vec![0; mesh.triangles.len()];
    // The nearest triangle of each pixel.
    let mut nearest = vec![NONE; (SIDE * SIDE) as usize];
    let mut depth = vec![f64::NEG_INFINITY; nearest.len()];
    let mut draw = |triangle: usize| {
        let corners = mesh.triangles[triangle].map(|v| placed[v as usize]);
        let flat = corners.map(|c| c.0);
        let area = raster::doubled_area(&flat);
        // Counter-clockwise from outside is counter-clockwise on the picture: y is down there.
        if area == 0 || area > 0 && !paint.material(triangle).double_sided {
            return;
        }
        let level = paint.level(triangle, area.abs() as f64 / (2 * PARTS * PARTS) as f64);
        levels[triangle] = level;
        let mask = paint.mask(triangle, level);
        raster::cover(&flat, [SIDE; 2], |x, y, weights| {
            let i = (y * SIDE + x) as usize;
            let near = weights[0] * corners[0].1 + weights[1] * corners[1].1 + weights[2] * corners[2].1;
            let wins = || near > depth[i] || (triangle as u32) < nearest[i];
            if near >= depth[i] && wins() && mask.as_ref().is_none_or(|mask| mask.shows(weights)) {
                (depth[i], nearest[i]) = (near, triangle as u32);
            }
        });
    };
    // Alpha costs more than order: what is near goes first, so that less of what is behind is asked.
    if mesh.surface.materials.iter().any(|m| m.alpha != Alpha::Opaque) {
        let nearest = |t: &usize| mesh.triangles[*t].map(|v| placed[v as usize].1).into_iter().fold(f64::MIN, f64::max);
        let mut order: Vec<(f64, usize)> = (0..mesh.triangles.len()).map(|t| (nearest(&t), t)).collect();
        order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.into_iter().for_each(|(_, t)| draw(t));
    } else {
        (0..mesh.triangles.len()).for_each(draw);
    }
    nearest.into_iter().enumerate().map(move |(i, triangle)| {
        let triangle = Some(triangle as usize).filter(|_| triangle != NONE)?;
        let flat = mesh.triangles[triangle].map(|v| placed[v as usize].0);
        let (values, area) = raster::value_at(&flat, [i as u32 % SIDE, i as u32 / SIDE]);
        let weights = values.map(|v| v as f64 * (1.0 / area as f64));
        Some(Hit { triangle, weights, level: levels[triangle] })
    })
}

/// What all 14 cameras see.
pub fn all(mesh: &Mesh, paint: &Paint, cameras: &[View; 14], shaded: bool) -> Vec<Seen> {
    cameras.par_iter().map(|view| draw(mesh, paint, view, shaded)).collect()
}

/// What all 14 cameras see, without shades and with them.
pub fn all_both(mesh: &Mesh, paint: &Paint, cameras: &[View; 14]) -> (Vec<Seen>, Vec<Seen>) {
    cameras.par_iter().map(|view| draw_both(mesh, paint, view)).unzip()
}

/// How alike two sets of pictures are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likeness {
    /// Pixels that both draw, of those that either draws: the mean over the views.
    pub silhouette: f64,
    /// Mean difference of a channel, 0..255 on a screen, where either draws; nothing is black.
    pub colour: f64,
    /// Pixels that only the first draws, and all around which, [`INSIDE`] far, it draws as well.
    pub holes: u32,
}

/// Pixels from the outline within which nothing counts as a hole.
pub const INSIDE: u32 = 2;

/// Whether a pixel of a square picture and all those `far` around it are drawn; what lies beyond its border is not.
pub fn is_inside(side: u32, far: u32, i: usize, drawn: impl Fn(usize) -> bool) -> bool {
    let [x, y] = [i as u32 % side, i as u32 / side];
    let within = |c: u32| c >= far && c + far < side;
    within(x) && within(y) && (y - far..=y + far).all(|v| (x - far..=x + far).all(|u| drawn((v * side + u) as usize)))
}

pub fn likeness(a: &[Seen], b: &[Seen]) -> Likeness {
    let (mut silhouettes, mut off, mut drawn, mut holes) = (0.0, 0u64, 0u64, 0);
    for (a, b) in a.iter().zip(b) {
        let (mut both, mut either) = (0u64, 0u64);
        let pixels = a.pixels.iter().zip(&b.pixels).enumerate();
        for (i, (p, q)) in pixels.filter(|(_, (p, q))| p[3] > 0 || q[3] > 0) {
            either += 1;
            both += u64::from(p[3] > 0 && q[3] > 0);
            holes += u32::from(q[3] == 0 && is_inside(SIDE, INSIDE, i, |j| a.pixels[j][3] > 0));
            off += (0..3).map(|k| u64::from(p[k].abs_diff(q[k]))).sum::<u64>();
        }
        silhouettes += if either > 0 { both as f64 / either as f64 } else { 1.0 };
        drawn += either;
    }
    let views = a.len().max(1) as f64;
    Likeness { silhouette: silhouettes / views, colour: off as f64 / (3 * drawn.max(1)) as f64, holes }
}

/// Views a row, and the side of each on the sheet.
const ROW: u32 = 7;
const SMALL: u32 = SIDE / 2;
/// What is behind.
const GROUND: [u8; 4] = [230, 230, 230, 255];

/// A contact sheet: seven views a row, shaded, on light grey; half the size, so that edges are smooth.
pub fn sheet(mesh: &Mesh) -> Result<Vec<u8>> {
    let paint = Paint::new(mesh);
    if let Some(fault) = paint.faults.first() {
        return Err(Diagnostic::error("bad-picture", fault));
    }
    Ok(on_sheet(&[all(mesh, &paint, &cameras(mesh), true)]).png())
}

/// The sheet that was made with them: the original over the quads.
pub fn impostors(of: &Impostors) -> Result<Vec<u8>> {
    Ok(of.sheet.clone())
}

/// Sets of views, one below the other for each half.
pub fn on_sheet(sets: &[Vec<Seen>]) -> Level {
    let rows = 2 * sets.len() as u32;
    let (width, height) = (ROW * SMALL, rows * SMALL);
    let light = linear();
    let ground = light[usize::from(GROUND[0])];
    let mut texels = vec![[0; 4]; (width * height) as usize];
    for (s, set) in sets.iter().enumerate() {
        for (v, seen) in set.iter().enumerate() {
            let (column, row) = (v as u32 % ROW, v as u32 / ROW * sets.len() as u32 + s as u32);
            for (y, x) in (0..SMALL).flat_map(|y| (0..SMALL).map(move |x| (y, x))) {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)]
                    .map(|(dx, dy)| seen.pixels[((2 * y + dy) * SIDE + 2 * x + dx) as usize]);
                let to = ((row * SMALL + y) * width + column * SMALL + x) as usize;
                // Mostly all four are the same.
                if four.iter().all(|p| p == &four[0]) {
                    texels[to] = if four[0][3] > 0 { four[0] } else { GROUND };
                    continue;
                }
                let four =
                    four.map(|p| if p[3] > 0 { [0, 1, 2].map(|k| light[usize::from(p[k])]) } else { [ground; 3] });
                let [r, g, b] = [0, 1, 2].map(|k| screen(four.iter().map(|p| p[k]).sum::<f32>() / 4.0));
                texels[to] = [r, g, b, 255];
            }
        }
    }
    Level { width, height, texels }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::mesh::{Material, Primitive, Surface};
    use crate::geom::frame::Frame;

    /// A box with one corner at 0, faces outside, green.
    fn brick(size: [f64; 3], double_sided: bool) -> Mesh {
        let positions = (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 1 { size[k] } else { 0.0 })).collect();
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles: Vec<[u32; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let material = Material { base_colour: [0.0, 1.0, 0.0, 1.0], double_sided, ..Material::default() };
        Mesh {
            frame: Frame::local(),
            positions,
            primitives: vec![Primitive { name: "mesh".into(), first_triangle: 0, triangles: 12, material: Some(0) }],
            triangles,
            features: vec![0; 8],
            feature_ids: ["a"].into_iter().collect(),
            attributes: Default::default(),
            surface: Surface { materials: vec![material], ..Surface::default() },
        }
    }

    #[test]
    fn a_brick_from_all_sides() {
        let mesh = brick([2.0, 1.0, 0.5], false);
        let cameras = cameras(&mesh);
        let all = |mesh: &Mesh| super::all(mesh, &Paint::new(mesh), &cameras, false);
        let seen = all(&mesh);
        let pixel = 2.0 * cameras[0].half / f64::from(SIDE);
        let count = |i: usize| seen[i].pixels.iter().filter(|p| p[3] > 0).count() as f64 * pixel * pixel;
        for (i, area) in [0.5, 0.5, 1.0, 1.0, 2.0, 2.0].into_iter().enumerate() {
            assert!((count(i) - area).abs() < 0.03, "view {i}: {} of {area}", count(i));
        }
        for i in 6..14 {
            assert!((count(i) - 3.5 / 3f64.sqrt()).abs() < 0.03, "view {i}: {}", count(i));
        }
        assert!(seen.iter().all(|s| s.pixels.iter().all(|&p| [[0; 4], [0, 255, 0, 255]].contains(&p))));
        // Inside out nothing changes but what is seen of it: the far walls.
        let mut inside = mesh.clone();
        inside.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        let other = all(&inside);
        let like = likeness(&seen, &other);
        assert_eq!(like, Likeness { silhouette: 1.0, colour: 0.0, holes: 0 });
        inside.triangles.clear();
        inside.primitives.clear();
        let none = all(&inside);
        // Nothing at all is one hole, but for two pixels along each side.
        let sides = |i: usize| {
            let [w, h] = [[1.0, 0.5], [2.0, 0.5], [2.0, 1.0]][i].map(|s| (s / pixel).round() - 4.0);
            w * h
        };
        let axes = (0..3).map(sides).sum::<f64>() * 2.0;
        let six = likeness(&seen[..6], &none[..6]).holes;
        assert!((f64::from(six) / axes - 1.0).abs() < 0.02, "{six} of {axes}");
        let all = likeness(&seen, &none);
        assert_eq!((all.silhouette, all.colour), (0.0, 85.0));
        assert_eq!(likeness(&none, &none).silhouette, 1.0);
    }

    #[test]
    fn the_same_bytes_again() {
        let mesh = brick([2.0, 1.0, 0.5], true);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(one.install(|| sheet(&mesh).unwrap()), sheet(&mesh).unwrap());
    }
}
