//! The inputs as tables that a sweep can run over: buildings in leaf order, clusters in postorder.

use std::sync::OnceLock;

use rayon::prelude::*;

use crate::artifact::{Dendrogram, Footprints, Hulls, Landmarks};
use crate::geom::Point;

use super::error;
use super::forms::{self, Form, Offers};
use super::originals::Originals;

/// Everything that tiles are made from. A *node* is a place in the postorder of the dendrogram: the right child of
/// x is x - 1, its subtree the 2s - 1 nodes up to x. A *place* is one of the leaf order.
pub struct City<'a> {
    pub footprints: &'a Footprints,
    pub hulls: &'a Hulls,
    pub marks: &'a Landmarks,
    /// Heights above a cluster's that make a landmark, as a share of e0.
    pub skyline: f64,
    pub originals: Originals<'a>,

    /// Dendrogram cluster of each node.
    pub cluster: Vec<u32>,
    pub parent: Vec<u32>,
    /// Triangles and bytes of all originals below each node.
    pub triangles: Vec<u64>,
    pub bytes: Vec<u64>,
    /// Of each node's ring with its landmarks: error, and triangles with the landmarks as they are.
    pub ring_error: Vec<f64>,
    pub ring_triangles: Vec<u64>,

    /// By place: side of the square of the footprint's area, metres; roof above zero.
    pub side: Vec<f64>,
    pub roof: Vec<f64>,
    /// Node of each place.
    pub leaves: Vec<u32>,
    /// Forms of each node, made when first asked for.
    offers: Vec<OnceLock<Offers>>,
}

impl<'a> City<'a> {
    pub fn new(
        footprints: &'a Footprints,
        tree: &'a Dendrogram,
        hulls: &'a Hulls,
        marks: &'a Landmarks,
        originals: Originals<'a>,
        skyline: f64,
    ) -> Self {
        let cluster = tree.postorder();
        let (parent, leaves) = tree.postorder_parents(&cluster);
        let area = |&b: &u32| footprints.area_m2(b as usize);
        let mut city = Self {
            footprints,
            hulls,
            marks,
            skyline,
            originals,
            parent,
            triangles: Vec::new(),
            bytes: Vec::new(),
            ring_error: Vec::new(),
            ring_triangles: Vec::new(),
            side: marks.order.par_iter().map(|b| area(b).sqrt()).collect(),
            roof: marks.order.iter().map(|&b| footprints.top[b as usize]).collect(),
            leaves,
            offers: (0..cluster.len()).map(|_| OnceLock::new()).collect(),
            cluster,
        };
        for x in 0..city.cluster.len() {
            let (triangles, bytes) = match city.children(x as u32) {
                None => {
                    let place = city.first(x as u32);
                    (u64::from(city.originals.triangles[place]), u64::from(city.originals.bytes[place]))
                }
                Some([l, r]) => (
                    city.triangles[l as usize] + city.triangles[r as usize],
                    city.bytes[l as usize] + city.bytes[r as usize],
                ),
            };
            city.triangles.push(triangles);
            city.bytes.push(bytes);
        }
        let rings: Vec<(f64, u64)> =
            (0..city.cluster.len() as u32).into_par_iter().map(|x| error::of_ring(&city, x)).collect();
        (city.ring_error, city.ring_triangles) = rings.into_iter().unzip();
        city
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
    pub fn ring(&self, x: u32) -> Vec<Point> {
        self.hulls.points(self.cluster[x as usize] as usize).collect()
    }
    /// Row of the building at a place.
    pub fn building(&self, place: usize) -> usize {
        self.marks.order[place] as usize
    }
    /// The rings of the building at a place.
    pub fn outline(&self, place: usize) -> impl Iterator<Item = &'a [Point]> + Clone {
        let polygons = &self.footprints.polygons;
        polygons.polygons_of(self.building(place)).flat_map(|p| polygons.rings_of(p)).map(|r| polygons.ring(r))
    }
    pub fn offers(&self, x: u32) -> &Offers {
        self.offers[x as usize].get_or_init(|| forms::of(self, x))
    }
    /// The forms that a node may be drawn in; the first is the truest (the original, or the ring).
    pub fn forms(&self, x: u32) -> &[Form] {
        &self.offers(x).forms
    }
}
