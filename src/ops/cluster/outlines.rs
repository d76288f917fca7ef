//! Buildings as their outer rings.

use super::join::Sites;
use crate::artifact::Shapes;
use crate::geom::Point;
use crate::geom::bounds::Bounds;
use crate::geom::faces::Faces;
use crate::geom::gap::{gap, shortest};
use crate::geom::nearest::Tree;
use crate::geom::segment_grid::SegmentGrid;

/// The shells of one building.
type Shells<'a> = Vec<&'a [Point]>;

/// Outlines in the order of a tree's places.
pub struct Outlines<'a> {
    shells: Vec<&'a Shells<'a>>,
    boxes: Vec<Bounds>,
    floor: f64,
    barriers: Option<&'a SegmentGrid>,
}

pub fn shells(polygons: &Shapes<Point>) -> Vec<Shells<'_>> {
    (0..polygons.len()).map(|i| polygons.shells(i).collect()).collect()
}

impl<'a> Outlines<'a> {
    /// The outlines `which`, and the tree over their boxes, which numbers them in that order.
    pub fn new(all: &'a [Shells<'a>], which: &[u32], floor: f64, barriers: Option<&'a SegmentGrid>) -> (Self, Tree) {
        let bounds = |&i: &u32| Bounds::of(all[i as usize].iter().flat_map(|ring| ring.iter().copied()));
        let boxes: Vec<Bounds> = which.iter().map(bounds).collect();
        let tree = Tree::new(&boxes);
        let shells = tree.order.iter().map(|&i| &all[which[i as usize] as usize]).collect();
        let boxes = tree.order.iter().map(|&i| boxes[i as usize]).collect();
        (Self { shells, boxes, floor, barriers }, tree)
    }
}

impl Sites for Outlines<'_> {
    type Probe = Bounds;
    const EXACT: bool = false;
    fn len(&self) -> usize {
        self.shells.len()
    }
    fn bounds(&self, x: usize) -> Bounds {
        self.boxes[x]
    }
    #[inline]
    fn probe(&self, x: usize) -> Bounds {
        self.boxes[x]
    }
    #[inline]
    fn square_to_box(&self, probe: Bounds, bounds: &Bounds) -> f64 {
        probe.square_to(bounds)
    }
    #[inline]
    fn square_to(&self, probe: Bounds, y: usize) -> f64 {
        probe.square_to(&self.boxes[y])
    }
    fn distance(&self, x: usize, y: usize, _: f64) -> Option<f64> {
        let (a, b) = (self.shells[x], self.shells[y]);
        let blocked = self.barriers.is_some_and(|barriers| blocked(a, b, barriers));
        (!blocked).then(|| gap(a, b).max(self.floor))
    }
    #[inline]
    fn same(&self, _: usize, _: usize) -> bool {
        false
    }
    fn floor(&self) -> f64 {
        self.floor
    }
}

/// True where the shortest way from one outline to the other meets a barrier. Outlines that touch or overlap have
/// none, and see each other.
pub fn blocked(a: &[&[Point]], b: &[&[Point]], barriers: &SegmentGrid) -> bool {
    shortest(a, b).is_some_and(|[p, q]| barriers.meet(p, q))
}

/// For each building a number that it shares with all that it can see: the faces that it lies in or comes within
/// 3 mm of are one (the ends of a shortest way are rounded to the grid), and so are those of what it may touch.
pub fn faces(all: &[Shells], faces: &mut Faces) -> Vec<Option<u32>> {
    let of = |shells: &Shells, faces: &mut Faces| {
        let mut face = None;
        for ring in shells {
            for (k, &p) in ring.iter().enumerate() {
                let found = [faces.of(p), faces.join_along(p, ring[(k + 1) % ring.len()], 3)];
                for f in found.into_iter().flatten() {
                    let known = *face.get_or_insert(f);
                    faces.join(known, f);
                }
            }
        }
        face
    };
    let first: Vec<Option<u32>> = all.iter().map(|shells| of(shells, faces)).collect();
    first.into_iter().map(|face| face.map(|f| faces.now(f))).collect()
}
