//! Parts thinner than a cell: `thin = "thicken"`.
//!
//! A sheet becomes a layer that is a digital plane: the nodes less than half of |a| + |b| + |c| off its middle, (a, b, c)
//! its unit normal. It is the thinnest in which no neighbourhood of 3 x 3 x 2 nodes looks through to the other side, so
//! that sticks on both sides know their plane at any slant (Andres, Acharya, Sibata: Discrete analytical hyperplanes).

use std::cmp::Ordering;
use std::ops::RangeInclusive;

use super::Thin;
use super::crossings::{Crossing, Crossings, Hits, Place, key_of, node_of};
use crate::artifact::Voxels;
use crate::artifact::voxels::{STEPS, stick_number};
use crate::geom::space::dot;

/// What thickening made.
#[derive(Default)]
pub struct Thick {
    /// Nodes that became black, as [`key_of`] says, ascending.
    pub nodes: Vec<u64>,
    /// Sticks along sheets thinner than a cell, at their rims, ascending.
    pub rims: Vec<u64>,
}

/// Counts edges that the surface crosses between nodes of one colour; with `thicken` blackens nodes around thin parts.
pub fn thicken(hits: &Hits, out: &mut Voxels, thin: Thin) -> Thick {
    let mut thick = Thick::default();
    // Nodes at edges that are clipped by faces far from parallel.
    let mut clipped = Vec::new();
    let mut sheets = Vec::new();
    for (axis, all) in hits.axes.iter().enumerate() {
        for edge in all.chunk_by(|a, b| a.node() == b.node()) {
            let is_lost = is_lost(edge, axis, out);
            out.losses.crossed += 1;
            out.losses.lost += u64::from(is_lost);
            if thin == Thin::Keep {
                continue;
            }
            if is_lost && !out.is_black(edge[0].node()) {
                let nodes = if is_wedge(edge) { &mut clipped } else { &mut thick.nodes };
                nodes.push(key_of(nearer(edge, axis, out)));
            }
            sheets.extend(Sheet::that_leaves(edge, all, axis, out));
        }
    }
    for sheet in &sheets {
        let layer = sheet.layer([0, 0], out.lattice.cells);
        let nodes = layer.map(|height| at(sheet.node, sheet.axis, height as usize));
        thick.nodes.extend(nodes.filter(|&n| !out.is_black(n)).map(key_of));
    }
    // Beside a body that is its edge, and no thin part.
    clipped.retain(|&key| !is_beside_black(out, node_of(key)));
    thick.nodes.iter().for_each(|&key| out.set(node_of(key)));
    clipped.iter().for_each(|&key| out.set(node_of(key)));
    thick.nodes.extend(clipped);
    let mut faces = Vec::new();
    sheets.iter().filter(|s| s.is_thin()).for_each(|s| s.sticks(out, &mut thick.rims, &mut faces));
    for numbers in [&mut thick.nodes, &mut thick.rims, &mut faces] {
        numbers.sort_unstable();
        numbers.dedup();
    }
    // What runs along one sheet may be another's face.
    thick.rims.retain(|stick| faces.binary_search(stick).is_err());
    out.losses.thickened = thick.nodes.len() as u64;
    thick
}

fn at(mut node: [usize; 3], axis: usize, along: usize) -> [usize; 3] {
    node[axis] = along;
    node
}

/// Whether the surface crosses an edge whose ends have one colour. A surface on the node itself is no loss: the node is
/// black.
fn is_lost(edge: &[Crossing], axis: usize, colours: &Voxels) -> bool {
    let low = edge[0].node();
    edge.iter().any(|c| c.place() != Place::OnNode)
        && colours.is_black(low) == colours.is_black(at(low, axis, low[axis] + 1))
}

/// The end of a lost edge that is nearer to the surface; not the one in the border, though a corner far from the origin
/// may snap into it.
fn nearer(edge: &[Crossing], axis: usize, colours: &Voxels) -> [usize; 3] {
    let low = edge[0].node();
    let (place, cells) = (edge[0].along() + edge[edge.len() - 1].along(), colours.lattice.cells);
    let node = low[axis] + usize::from(is_upper(place - 1.0, low[axis], cells));
    at(low, axis, node.clamp(BORDER as usize, cells as usize - BORDER as usize))
}

/// Whether the upper of two nodes is taken; `place` is positive where it is nearer. Half way: the one nearer to the
/// grid's middle, then the lower.
fn is_upper(place: f64, low: usize, cells: u32) -> bool {
    match place.total_cmp(&0.0) {
        Ordering::Less => false,
        Ordering::Greater => true,
        Ordering::Equal => 2 * low + 1 < cells as usize,
    }
}

/// The cosine of the sharpest angle between faces that enclose no thin part: 60 degrees.
const WEDGE: f64 = 0.5;

/// Whether what an edge clips is enclosed by two faces that are far from parallel.
fn is_wedge(edge: &[Crossing]) -> bool {
    matches!(edge, [a, b] if a.cosine(*b) < WEDGE)
}

/// Whether one of the nodes around is black.
fn is_beside_black(all: &Voxels, node: [usize; 3]) -> bool {
    let last = all.lattice.side() - 1;
    let [x, y, z] = node.map(|c| c.saturating_sub(1)..=(c + 1).min(last));
    z.into_iter().any(|z| y.clone().any(|y| x.clone().any(|x| all.is_black([x, y, z]))))
}

/// The cosine between the normals of a sheet's two faces, at least: 32 degrees.
const SHEET: f64 = 0.85;
/// Layers at most of a sheet, along its main axis: as many as a digital plane has at the steepest slant.
const LAYERS: usize = 3;
/// How much a crossing's normal may be off along its axis.
const SLACK: f64 = 0.005;
/// Nodes at a grid's border that stay white, each side.
const BORDER: i32 = 2;

/// A sheet where a line of the grid goes through it, along the axis that its normal is nearest to.
struct Sheet {
    axis: usize,
    /// A node on the line.
    node: [usize; 3],
    /// Half way between its faces, from the grid's border, in cells.
    middle: f64,
    /// Between its faces, along the line, in cells.
    depth: f64,
    /// As [`Crossing::normal`] says.
    normal: [f64; 3],
}

impl Sheet {
    /// The sheet through which a line goes, and comes out at an edge; none where what it comes out of is thick, has
    /// faces that are not parallel, or is seen better along another axis.
    fn that_leaves(edge: &[Crossing], all: &Crossings, axis: usize, colours: &Voxels) -> Option<Self> {
        let (low, last) = (edge[0].node(), edge[edge.len() - 1]);
        let normal = last.normal();
        let is_main = normal[2] + SLACK >= normal[0].abs().max(normal[1].abs());
        if !is_main || colours.is_black(at(low, axis, low[axis] + 1)) {
            return None;
        }
        let run = (0..=LAYERS).find(|&n| n <= low[axis] && !colours.is_black(at(low, axis, low[axis] - n)))?;
        let (first, start) = if run == 0 { (edge[0], edge[0].along()) } else { came_in(all, low, axis, run)? };
        let sheet = Self {
            axis,
            node: low,
            middle: low[axis] as f64 + (start + last.along()) / 2.0,
            depth: last.along() - start,
            normal,
        };
        (first.cosine(last) >= SHEET && sheet.depth < 2.0 * sheet.reach()).then_some(sheet)
    }

    /// From its middle to the ends of its layer, along the line, in cells.
    fn reach(&self) -> f64 {
        // The sizes of the normal's numbers add up to one.
        if self.normal[2] == 1.0 { 0.5 } else { 0.5 / (self.normal[2] - SLACK) }
    }

    /// Its nodes along a line, so many nodes across from its own.
    fn layer(&self, across: [i32; 2], cells: u32) -> RangeInclusive<i32> {
        let rise = [0, 1].map(|k| -self.normal[k] / self.normal[2] * f64::from(across[k]));
        let (middle, reach) = (self.middle + rise[0] + rise[1], self.reach());
        let (mut first, mut last) = ((middle - reach).ceil() as i32, (middle + reach).floor() as i32);
        // Both ends half way: only with faces straight across.
        if f64::from(last - first) == 2.0 * reach {
            if is_upper(0.0, first as usize, cells) { first += 1 } else { last -= 1 }
        }
        first.max(BORDER)..=last.min(cells as i32 - BORDER)
    }

    /// Whether it is thinner than a cell.
    fn is_thin(&self) -> bool {
        self.depth * self.normal[2] < dot(self.normal, self.normal).sqrt()
    }

    /// Sticks of this line and the eight around it whose white end lies in the layer, too: they run along the sheet. And
    /// those of this line whose white end does not: its faces.
    fn sticks(&self, colours: &Voxels, along: &mut Vec<u64>, faces: &mut Vec<u64>) {
        let cells = colours.lattice.cells;
        let axes = [self.axis, (self.axis + 1) % 3, (self.axis + 2) % 3];
        let own = self.node.map(|c| c as i32);
        let is_inside = |node: [i32; 3]| {
            let across = [1, 2].map(|k| node[axes[k]] - own[axes[k]]);
            self.layer(across, cells).contains(&node[axes[0]])
        };
        let is_black = |node: [i32; 3]| colours.is_black(node.map(|c| c as usize));
        for across in (-1..=1).flat_map(|u| (-1..=1).map(move |v| [u, v])) {
            for height in self.layer(across, cells) {
                let mut black = own;
                black[axes[0]] = height;
                (0..2).for_each(|k| black[axes[k + 1]] += across[k]);
                if !is_black(black) {
                    continue;
                }
                for (direction, step) in STEPS.iter().enumerate() {
                    let white = [0, 1, 2].map(|k| black[k] + step[k]);
                    let is_inside = is_inside(white);
                    if !is_black(white) && (is_inside || across == [0, 0]) {
                        let sticks = if is_inside { &mut *along } else { &mut *faces };
                        sticks.push(stick_number(black.map(|c| c as u16), direction as u8));
                    }
                }
            }
        }
    }
}

/// Where a line came into the `run` black nodes that end at `low`, and how far from there.
fn came_in(all: &Crossings, low: [usize; 3], axis: usize, run: usize) -> Option<(Crossing, f64)> {
    let order = |[x, y, z]: [usize; 3]| [z, y, x];
    let first_at = |back: usize| {
        let node = at(low, axis, low[axis] - back);
        let i = all.partition_point(|c| order(c.node()) < order(node));
        all.get(i).copied().filter(|c| c.node() == node).map(|c| (c, c.along() - back as f64))
    };
    let is_on_node = |(c, _): &(Crossing, f64)| c.place() == Place::OnNode;
    first_at(run).filter(|c| !is_on_node(c)).or_else(|| first_at(run - 1).filter(is_on_node))
}
