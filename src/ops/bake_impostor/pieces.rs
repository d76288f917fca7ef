//! A tile's texels in connected pieces, each in the smallest rectangle.

use super::atlas::GUTTER;
use super::canvas::{self, Texel, Window};
use super::holes::Mending;
use super::planes::Scene;
use crate::geom::space::{Vec3, cross, dot};

/// A quad of a tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    pub tile: usize,
    pub window: Window,
    pub texels: Vec<Option<Texel>>,
}

impl Piece {
    /// Texels that show something, and of these those of two-sided materials.
    pub fn counts(&self) -> [usize; 2] {
        let shown = self.texels.iter().flatten();
        [shown.clone().count(), shown.filter(|t| t.two_sided).count()]
    }

    /// Whether most of what it shows is seen from behind as well.
    pub fn two_sided(&self) -> bool {
        let [shown, two_sided] = self.counts();
        2 * two_sided > shown
    }

    pub fn draws(&self, p: Vec3) -> bool {
        self.window.texel_at(p).is_some_and(|i| self.texels[i].is_some())
    }
}

/// Pieces of fewer texels are dropped.
const LEAST: usize = 4;
/// Texels up to so far apart are one piece.
const NEAR: i64 = 4;
/// Pieces are joined where their rectangle, with what is bled around it, takes less than that times theirs.
const JOIN: f64 = 1.2;
/// A turned rectangle is taken where it is smaller than that.
const TURN: f64 = 0.85;

/// First and last column and row of some texels, with what belongs to it.
struct Group {
    low: [u32; 2],
    high: [u32; 2],
    parts: Vec<u32>,
}

impl Group {
    fn with(&self, other: &Self) -> ([u32; 2], [u32; 2]) {
        ([0, 1].map(|k| self.low[k].min(other.low[k])), [0, 1].map(|k| self.high[k].max(other.high[k])))
    }
}

fn area(low: [u32; 2], high: [u32; 2]) -> f64 {
    let [w, h] = [0, 1].map(|k| f64::from(high[k] - low[k] + 1 + 2 * GUTTER));
    w * h
}

/// The pieces of tile k.
pub fn pieces(scene: &Scene, k: usize, texel: f64, mending: &Mending) -> Vec<Piece> {
    let window = canvas::around(scene, k, texel, mending);
    let texels = canvas::draw(scene, k, &window, mending);
    let (labels, groups) = connected(&texels, window.size);
    let piece = |group: &Group| {
        let own = |i: usize| labels[i] != 0 && group.parts.contains(&labels[i]);
        let whole = window.part(group.low, group.high);
        let turned = turned(&window, group, own);
        let [w, h] = turned.size.map(|s| s + 2 * GUTTER);
        // Drawn anew only where it will be seen.
        if !mending.is_none() && f64::from(w) * f64::from(h) < TURN * area(group.low, group.high) {
            // Drawn anew; a texel belongs to the piece whose texels are around its middle.
            let mut anew = canvas::draw(scene, k, &turned, mending);
            for (i, texel) in anew.iter_mut().enumerate() {
                let middle = [i as u32 % turned.size[0], i as u32 / turned.size[0]].map(|c| f64::from(c) + 0.5);
                let [x, y] = window.place(turned.point(middle)).map(|c| c.floor() as i64);
                let around = |v: i64| (-1..=1).any(|d| has(x + d, v, window.size, own));
                if texel.is_some() && !(-1..=1).any(|d| around(y + d)) {
                    *texel = None;
                }
            }
            return trimmed(Piece { tile: k, window: turned, texels: anew });
        }
        let mut out = Vec::with_capacity(whole.texels());
        for y in group.low[1]..=group.high[1] {
            for x in group.low[0]..=group.high[0] {
                let i = (y * window.size[0] + x) as usize;
                out.push(texels[i].filter(|_| own(i)));
            }
        }
        Some(Piece { tile: k, window: whole, texels: out })
    };
    groups.iter().filter_map(piece).collect()
}

fn has(x: i64, y: i64, size: [u32; 2], own: impl Fn(usize) -> bool) -> bool {
    let [w, h] = size.map(i64::from);
    (0..w).contains(&x) && (0..h).contains(&y) && own((y * w + x) as usize)
}

/// The number of the connected part of each texel, from 1, and the groups of parts that share a rectangle.
fn connected(texels: &[Option<Texel>], size: [u32; 2]) -> (Vec<u32>, Vec<Group>) {
    let [width, height] = size.map(i64::from);
    let mut labels = vec![0u32; texels.len()];
    let mut groups: Vec<Group> = Vec::new();
    let mut todo: Vec<[i64; 2]> = Vec::new();
    let mut label = 0;
    for first in 0..texels.len() {
        if labels[first] != 0 || texels[first].is_none() {
            continue;
        }
        label += 1;
        labels[first] = label;
        let at = [first as u32 % size[0], first as u32 / size[0]];
        let mut group = Group { low: at, high: at, parts: vec![label] };
        let mut count = 0;
        todo.push(at.map(i64::from));
        while let Some([x, y]) = todo.pop() {
            count += 1;
            for (k, c) in [x, y].into_iter().enumerate() {
                (group.low[k], group.high[k]) = (group.low[k].min(c as u32), group.high[k].max(c as u32));
            }
            for v in (y - NEAR).max(0)..=(y + NEAR).min(height - 1) {
                for u in (x - NEAR).max(0)..=(x + NEAR).min(width - 1) {
                    let i = (v * width + u) as usize;
                    if labels[i] == 0 && texels[i].is_some() {
                        labels[i] = label;
                        todo.push([u, v]);
                    }
                }
            }
        }
        if count >= LEAST {
            groups.push(group);
        }
    }
    // Each join may make another one worth it.
    let mut joined = true;
    while joined {
        joined = false;
        let mut a = 0;
        while a < groups.len() {
            let mut b = a + 1;
            while b < groups.len() {
                let (low, high) = groups[a].with(&groups[b]);
                let apart = area(groups[a].low, groups[a].high) + area(groups[b].low, groups[b].high);
                if area(low, high) <= JOIN * apart {
                    let other = groups.swap_remove(b);
                    groups[a].parts.extend(other.parts);
                    (groups[a].low, groups[a].high) = (low, high);
                    joined = true;
                } else {
                    b += 1;
                }
            }
            a += 1;
        }
    }
    (labels, groups)
}

/// The smallest rectangle around a group's texels: one of its sides lies along their convex hull's.
fn turned(window: &Window, group: &Group, own: impl Fn(usize) -> bool) -> Window {
    let hull = hull(window, group, own);
    let mut best = (f64::INFINITY, [1.0, 0.0], [0.0; 2], [0.0; 2]);
    for (i, a) in hull.iter().enumerate() {
        let b = hull[(i + 1) % hull.len()];
        let along = [(b[0] - a[0]) as f64, (b[1] - a[1]) as f64];
        let length = (along[0] * along[0] + along[1] * along[1]).sqrt();
        let along = along.map(|c| c / length);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in &hull {
            let p = p.map(|c| c as f64);
            for (k, c) in [p[0] * along[0] + p[1] * along[1], p[1] * along[0] - p[0] * along[1]].into_iter().enumerate()
            {
                (low[k], high[k]) = (low[k].min(c), high[k].max(c));
            }
        }
        let size = (high[0] - low[0] + 2.0 * f64::from(GUTTER)) * (high[1] - low[1] + 2.0 * f64::from(GUTTER));
        if size < best.0 {
            best = (size, along, low, high);
        }
    }
    let (_, [c, s], low, high) = best;
    // Columns run right, rows down: along is (c, s) of (right, -up).
    let [right, up, normal] = window.axes;
    let turn = |a: f64, b: f64| [0, 1, 2].map(|k| a * right[k] + b * up[k]);
    let right = turn(c, -s);
    let axes = [right, cross(normal, right), normal];
    let upper_left = window.point([c * low[0] - s * low[1], s * low[0] + c * low[1]]);
    let corner = [0, 1].map(|k| dot(axes[k], upper_left));
    let size = [0, 1].map(|k| (high[k] - low[k]).ceil().max(1.0) as u32);
    Window { axes, corner: [corner[0], corner[1], window.corner[2]], size, ..*window }
}

/// Of the corners of a group's texels, clockwise as one sees them.
fn hull(window: &Window, group: &Group, own: impl Fn(usize) -> bool) -> Vec<[i64; 2]> {
    // The ends of each row are enough.
    let (mut left, mut right) = (Vec::new(), Vec::new());
    for y in group.low[1]..=group.high[1] {
        let mine = |x: &u32| own((y * window.size[0] + x) as usize);
        let mut row = group.low[0]..=group.high[0];
        if let Some(first) = row.find(mine) {
            let last = row.rev().find(mine).unwrap_or(first);
            for v in [y, y + 1].map(i64::from) {
                left.push([i64::from(first), v]);
                right.push([i64::from(last) + 1, v]);
            }
        }
    }
    // Both chains run down; the right one turns one way, the left one the other.
    let chain = |all: &[[i64; 2]], sign: i64| {
        let mut out: Vec<[i64; 2]> = Vec::new();
        for &p in all {
            while let [.., a, b] = out[..]
                && sign * ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])) <= 0
            {
                out.pop();
            }
            out.push(p);
        }
        out
    };
    let mut out = chain(&right, 1);
    out.extend(chain(&left, -1).into_iter().rev());
    out
}

/// Without empty columns and rows at its ends; none if little is left.
fn trimmed(piece: Piece) -> Option<Piece> {
    let size = piece.window.size;
    let (mut low, mut high, mut count) = ([u32::MAX; 2], [0; 2], 0);
    for (i, _) in piece.texels.iter().enumerate().filter(|(_, t)| t.is_some()) {
        count += 1;
        for (k, c) in [i as u32 % size[0], i as u32 / size[0]].into_iter().enumerate() {
            (low[k], high[k]) = (low[k].min(c), high[k].max(c));
        }
    }
    if count < LEAST {
        return None;
    }
    let window = piece.window.part(low, high);
    let rows = (low[1]..=high[1]).map(|y| (y * size[0] + low[0]) as usize..=(y * size[0] + high[0]) as usize);
    let texels = rows.flat_map(|row| piece.texels[row].iter().copied()).collect();
    Some(Piece { tile: piece.tile, window, texels })
}
