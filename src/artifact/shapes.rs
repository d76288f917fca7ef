//! Lists of multipolygons, packed: shape i has polygons, a polygon has rings (the first is its shell), a ring has
//! points. Rings are open: the first point is not repeated.

use std::ops::Range;

use super::sections::{Cell, Decoder, Encoder, Field};
use crate::diag::Result;

/// n multipolygons over points `P` (`[i32; 2]` or `[i32; 3]`, millimetres in the local frame).
#[derive(Clone, Debug, PartialEq)]
pub struct Shapes<P> {
    /// n + 1 offsets into polygons.
    pub shapes: Vec<u32>,
    /// Offsets of each polygon's rings, and the end.
    pub polygons: Vec<u32>,
    /// Offsets of each ring's points, and the end.
    pub rings: Vec<u32>,
    pub points: Vec<P>,
}

impl<P> Default for Shapes<P> {
    fn default() -> Self {
        Self { shapes: vec![0], polygons: vec![0], rings: vec![0], points: Vec::new() }
    }
}

impl<P: Copy> Shapes<P> {
    pub fn len(&self) -> usize {
        self.shapes.len() - 1
    }
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Polygon numbers of shape `i`.
    pub fn polygons_of(&self, i: usize) -> Range<usize> {
        self.shapes[i] as usize..self.shapes[i + 1] as usize
    }
    /// Ring numbers of polygon `p`; the first is its shell.
    pub fn rings_of(&self, p: usize) -> Range<usize> {
        self.polygons[p] as usize..self.polygons[p + 1] as usize
    }
    pub fn ring(&self, r: usize) -> &[P] {
        &self.points[self.rings[r] as usize..self.rings[r + 1] as usize]
    }
    /// The shells of shape `i`, in order.
    pub fn shells(&self, i: usize) -> impl Iterator<Item = &[P]> + Clone {
        self.polygons_of(i).map(|p| self.ring(self.polygons[p] as usize))
    }
    pub fn push_ring(&mut self, points: &[P]) {
        self.points.extend_from_slice(points);
        self.rings.push(self.points.len() as u32);
    }
    /// Closes a polygon over the rings pushed since the last one.
    pub fn end_polygon(&mut self) {
        self.polygons.push(self.rings.len() as u32 - 1);
    }
    /// Closes a shape over the polygons since the last one.
    pub fn end_shape(&mut self) {
        self.shapes.push(self.polygons.len() as u32 - 1);
    }
    /// Shapes, polygons, rings, points: a mark to go back to with `cut`.
    pub fn mark(&self) -> [usize; 4] {
        [self.shapes.len(), self.polygons.len(), self.rings.len(), self.points.len()]
    }
    /// Takes back what was pushed since `mark`.
    pub fn cut(&mut self, mark: [usize; 4]) {
        self.shapes.truncate(mark[0]);
        self.polygons.truncate(mark[1]);
        self.rings.truncate(mark[2]);
        self.points.truncate(mark[3]);
    }
    /// Appends all shapes of `other`.
    pub fn append(&mut self, other: &Self) {
        let moved = |to: &mut Vec<u32>, from: &[u32]| {
            let by = to[to.len() - 1];
            to.extend(from[1..].iter().map(|v| v + by));
        };
        moved(&mut self.shapes, &other.shapes);
        moved(&mut self.polygons, &other.polygons);
        moved(&mut self.rings, &other.rings);
        self.points.extend_from_slice(&other.points);
    }
    /// Appends shape `i` of `other`.
    pub fn push_from(&mut self, other: &Self, i: usize) {
        for p in other.polygons_of(i) {
            for r in other.rings_of(p) {
                self.push_ring(other.ring(r));
            }
            self.end_polygon();
        }
        self.end_shape();
    }
}

impl<P: Cell> Field for Shapes<P> {
    fn put<'a>(&'a self, name: &str, out: &mut Encoder<'a>) {
        self.shapes.put(&format!("{name}.shapes"), out);
        self.polygons.put(&format!("{name}.polygons"), out);
        self.rings.put(&format!("{name}.rings"), out);
        self.points.put(&format!("{name}.points"), out);
    }
    fn get(name: &str, from: &mut Decoder) -> Result<Self> {
        let out = Self {
            shapes: Field::get(&format!("{name}.shapes"), from)?,
            polygons: Field::get(&format!("{name}.polygons"), from)?,
            rings: Field::get(&format!("{name}.rings"), from)?,
            points: Field::get(&format!("{name}.points"), from)?,
        };
        let fits = |offsets: &[u32], end: usize| {
            offsets.first() == Some(&0)
                && offsets.last() == Some(&(end as u32))
                && offsets.windows(2).all(|w| w[0] <= w[1])
        };
        let sound = fits(&out.rings, out.points.len())
            && fits(&out.polygons, out.rings.len() - 1)
            && fits(&out.shapes, out.polygons.len() - 1);
        if sound { Ok(out) } else { Err(from.broken(&format!("`{name}` has wrong offsets"))) }
    }
}
