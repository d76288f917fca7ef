//! The inputs as tables that a sweep can run over: buildings in leaf order, clusters in postorder.

use rayon::prelude::*;

use crate::artifact::{Dendrogram, Hulls, Landmarks};
use crate::geom::Point;
use crate::geom::extremes::Extremes;

use super::error;
use super::forms::{Alone, Form};
use super::originals::Originals;

/// Everything that tiles are made from. A *node* is a place in the postorder of the dendrogram: the right child of
/// x is x - 1, its subtree the 2s - 1 nodes up to x. A *place* is one of the leaf order.
pub struct City<'a, 'o> {
    pub hulls: &'a Hulls,
    pub marks: &'a Landmarks,
    /// Heights above a cluster's that make a landmark, as a share of e0.
    pub skyline: f64,
    pub originals: Originals<'o>,

    /// Dendrogram cluster of each node.
    pub cluster: Vec<u32>,
    pub parent: Vec<u32>,
    /// Of each node's ring with its landmarks: error, and triangles with the landmarks as they are.
    pub ring_error: Vec<f64>,
    pub ring_triangles: Vec<u64>,

    /// Triangles and bytes of all originals before each place, and of all.
    triangles: Vec<u64>,
    bytes: Vec<u64>,
    /// By place: side of the square of the footprint's area, metres; roof above zero.
    pub side: Vec<f64>,
    pub roof: Vec<f64>,
    /// Extremes of roofs and of heights.
    pub roofs: Extremes,
    pub heights: Extremes,
    /// Some corner of its outline; one that no ring holds where it has none.
    pub corner: Vec<Point>,
    /// Node of each place.
    pub leaves: Vec<u32>,
    /// In what each building may be drawn.
    alone: Alone,
}

impl<'a, 'o> City<'a, 'o> {
    pub fn new(
        tree: &Dendrogram,
        hulls: &'a Hulls,
        marks: &'a Landmarks,
        originals: Originals<'o>,
        skyline: f64,
    ) -> Self {
        let footprints = originals.footprints;
        let cluster = tree.postorder();
        let (parent, leaves) = tree.postorder_parents(&cluster);
        let roof: Vec<f64> = marks.order.iter().map(|&b| footprints.top[b as usize]).collect();
        let mut city = Self {
            hulls,
            marks,
            skyline,
            parent,
            ring_error: Vec::new(),
            ring_triangles: Vec::new(),
            triangles: before(&originals.triangles),
            bytes: before(&originals.bytes),
            originals,
            side: marks.order.par_iter().map(|&b| footprints.area_m2(b as usize).sqrt()).collect(),
            roofs: Extremes::of(&roof),
            heights: Extremes::of(&marks.height),
            roof,
            corner: Vec::new(),
            leaves,
            cluster,
            alone: Alone::default(),
        };
        let corner = |place| city.outline(place).flatten().next().copied().unwrap_or([i32::MIN; 2]);
        city.corner = (0..city.leaves.len()).into_par_iter().map(corner).collect();
        let nodes = city.cluster.len() as u32;
        let (mut errors, mut triangles) = (Vec::new(), Vec::new());
        let ring = |x| error::of_ring(&city, x);
        (0..nodes).into_par_iter().map(ring).unzip_into_vecs(&mut errors, &mut triangles);
        (city.ring_error, city.ring_triangles) = (errors, triangles);
        city
    }

    /// Keeps of it what the geometry of originals needs, so that the rest no longer takes room.
    pub fn into_originals(self) -> Originals<'o> {
        self.originals
    }

    /// Works out the forms of single buildings, without which only leaves can be made.
    pub fn with_forms(mut self) -> Self {
        self.alone = Alone::new(&self);
        self
    }

    /// Lets go of them again.
    pub fn without_forms(self) -> Self {
        Self { alone: Alone::default(), ring_error: Vec::new(), ring_triangles: Vec::new(), ..self }
    }

    pub fn root(&self) -> u32 {
        self.cluster.len() as u32 - 1
    }
    pub fn size(&self, x: u32) -> usize {
        self.marks.size[self.cluster[x as usize] as usize] as usize
    }
    /// First place of a node's buildings.
    pub fn first(&self, x: u32) -> usize {
        self.marks.first[self.cluster[x as usize] as usize] as usize
    }
    pub fn places(&self, x: u32) -> std::ops::Range<usize> {
        self.first(x)..self.first(x) + self.size(x)
    }
    pub fn is_leaf(&self, x: u32) -> bool {
        self.size(x) == 1
    }
    pub fn children(&self, x: u32) -> Option<[u32; 2]> {
        (!self.is_leaf(x)).then(|| [x - 2 * self.size(x - 1) as u32, x - 1])
    }
    /// Triangles of all originals below a node.
    pub fn triangles(&self, x: u32) -> u64 {
        let places = self.places(x);
        self.triangles[places.end] - self.triangles[places.start]
    }
    /// Bytes of them.
    pub fn bytes(&self, x: u32) -> u64 {
        let places = self.places(x);
        self.bytes[places.end] - self.bytes[places.start]
    }
    /// Height of a node's block above its ground.
    pub fn height(&self, x: u32) -> f64 {
        self.hulls.height[self.cluster[x as usize] as usize]
    }
    /// Ground of a node's block.
    pub fn ground(&self, x: u32) -> f64 {
        self.hulls.ground[self.cluster[x as usize] as usize]
    }
    pub fn negative_space(&self, x: u32) -> f64 {
        self.hulls.negative_space_m2[self.cluster[x as usize] as usize]
    }
    /// Area of the union of a node's footprints.
    pub fn built(&self, x: u32) -> f64 {
        (self.hulls.area_m2[self.cluster[x as usize] as usize] - self.negative_space(x)).max(0.0)
    }
    /// A node's ring.
    pub fn ring(&self, x: u32, out: &mut Vec<Point>) {
        out.clear();
        out.extend(self.hulls.points(self.cluster[x as usize] as usize));
    }
    /// Row of the building at a place.
    pub fn building(&self, place: usize) -> usize {
        self.originals.order[place] as usize
    }
    /// The rings of the building at a place.
    pub fn outline(&self, place: usize) -> impl Iterator<Item = &'o [Point]> + Clone + use<'o> {
        self.originals.outline(place)
    }
    /// The forms of the building at a place; the first is the original.
    pub fn alone(&self, place: usize) -> impl ExactSizeIterator<Item = Form> {
        self.alone.forms(self, place)
    }
}

/// Sums of all before each, and of all.
fn before(all: &[u32]) -> Vec<u64> {
    let mut sum = 0;
    let next = |&v: &u32| {
        sum += u64::from(v);
        sum
    };
    std::iter::once(0).chain(all.iter().map(next)).collect()
}
