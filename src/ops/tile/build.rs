//! The tree of tiles, bottom-up: which subtrees are tiles, and what each shows.

use std::sync::atomic::Ordering::Relaxed;

use rayon::prelude::*;

use super::Limits;
use super::city::City;
use super::content::Content;
use super::forms::{self, Form, Offers, Pen, Shape};
use super::least_cut::{self, Choice, Offer, Table, choose};
use super::levels::{self, Street};
use super::originals::raised_bytes;
use crate::geom::tree_cut::above;

/// A tile and all below it.
pub struct Built {
    pub node: u32,
    pub children: Vec<Built>,
    pub is_leaf: bool,
    /// In leaf order; a cluster before its landmarks. Of leaves nothing: they draw all originals.
    pub drawn: Vec<Drawn>,
    /// Their geometry; of leaves made at the end.
    pub content: Content,
    pub triangles: u64,
    /// Measured here.
    pub error_space: f64,
    pub error_height: f64,
    /// Largest of these and the children's.
    pub error: f64,
    /// True where the content exceeds a bound.
    pub exceeds: bool,
    /// Buildings over which nothing stands, and street points that are built over.
    pub lost: u64,
    pub closed: Vec<u32>,
    /// What the tile above begins with.
    cut: Cut,
}

struct Cut {
    /// Ascending, landmarks not among them.
    nodes: Vec<u32>,
    /// What the nodes from there up offer, where it was worked out.
    offers: Vec<(u32, Offers)>,
    lambda: f64,
}

/// A feature of a tile.
#[derive(Clone, Copy, Debug)]
pub struct Drawn {
    pub node: u32,
    pub triangles: u32,
    pub shape: Shape,
    pub landmark: bool,
    pub negative_space: f64,
}

impl Drawn {
    fn new(node: u32, form: &Form, landmark: bool) -> Self {
        let &Form { shape, triangles, negative_space, .. } = form;
        Self { node, triangles, shape, landmark, negative_space }
    }
}

impl Built {
    pub fn feature_count(&self, city: &City) -> usize {
        if self.is_leaf { city.size(self.node) } else { self.drawn.len() }
    }

    /// What it draws, in order.
    pub fn features<'a>(&'a self, city: &'a City) -> impl Iterator<Item = Drawn> + 'a {
        let originals = if self.is_leaf { city.places(self.node) } else { 0..0 };
        let original = |place: usize| Drawn {
            node: city.leaves[place],
            triangles: city.originals.triangles[place],
            shape: Shape::Original,
            landmark: false,
            negative_space: 0.0,
        };
        self.drawn.iter().copied().chain(originals.map(original))
    }
}

/// Builds the tile over a node.
pub fn build(city: &City, street: &Street, limits: &Limits, x: u32) -> Built {
    let stopped = || limits.stop.load(Relaxed);
    if stopped() || fits_as_it_is(city, limits, x) {
        return leaf(city, limits, x);
    }
    let children: Vec<Built> =
        children(city, limits, x).into_par_iter().map(|c| build(city, street, limits, c)).collect();
    if stopped() {
        return leaf(city, limits, x);
    }
    inner(city, street, limits, x, children)
}

/// Leaf tiles hold originals: all that fit, or one building.
pub fn fits_as_it_is(city: &City, limits: &Limits, x: u32) -> bool {
    city.is_leaf(x) || (city.triangles(x) <= limits.triangles && city.bytes(x) <= limits.bytes)
}

/// The tiles below an inner tile: its two halves, but where one half is small (under a quarter of the bound) the other
/// is opened in its place, so that no tile repeats its only large child. Only the subtree's own sizes decide.
fn children(city: &City, limits: &Limits, x: u32) -> Vec<u32> {
    let mut out = Vec::new();
    // (node, size of its sibling)
    let mut open = vec![(x, 0)];
    while let Some((y, beside)) = open.pop() {
        let small = beside < limits.triangles / 4;
        match city.children(y) {
            Some([l, r]) if y == x || (small && !fits_as_it_is(city, limits, y)) => {
                open.extend([(r, city.triangles(l)), (l, city.triangles(r))]);
            }
            _ => out.push(y),
        }
    }
    out
}

fn leaf(city: &City, limits: &Limits, x: u32) -> Built {
    let nodes: Vec<u32> = city.leaves[city.places(x)].to_vec();
    let nothing = nodes.iter().filter(|&&n| city.triangles(n) == 0 || city.built(n) <= 0.0).count();
    Built {
        node: x,
        children: Vec::new(),
        is_leaf: true,
        drawn: Vec::new(),
        content: Content::default(),
        triangles: city.triangles(x),
        error_space: 0.0,
        error_height: 0.0,
        error: 0.0,
        exceeds: city.triangles(x) > limits.triangles || city.bytes(x) > limits.bytes,
        lost: nothing as u64,
        closed: Vec::new(),
        cut: Cut { nodes, offers: Vec::new(), lambda: 0.0 },
    }
}

fn inner(city: &City, street: &Street, limits: &Limits, x: u32, mut children: Vec<Built>) -> Built {
    let below: u64 = children.iter().map(|c| c.triangles).sum();
    let error_below = children.iter().map(|c| c.error).fold(0.0, f64::max);
    let guess = children.iter().map(|c| c.cut.lambda).fold(1.0, f64::max);
    let (mut base, mut known) = (Vec::new(), Vec::new());
    for child in &mut children {
        base.append(&mut child.cut.nodes);
        known.append(&mut child.cut.offers);
        child.cut = Cut { nodes: Vec::new(), offers: Vec::new(), lambda: 0.0 };
    }
    let table = Table::new(city, above(&base, &city.parent, x), known);

    let mut most = limits.triangles.min(below / 2);
    let mut choice = choose(city, &table, most, error_below, guess, limits.prefer);
    if !choice.fits && most < limits.triangles {
        // Half of what lies below is out of reach for a few buildings: then the bound alone.
        most = limits.triangles;
        choice = choose(city, &table, most, error_below, guess, limits.prefer);
    }
    let (mut drawn, mut errors) = drawn(city, &table, &choice);
    let mut bytes = bytes_of(city, &drawn);
    while bytes > limits.bytes && choice.fits {
        most = (most as f64 * 0.95 * (limits.bytes as f64 / bytes as f64)) as u64;
        choice = choose(city, &table, most, error_below, guess, limits.prefer);
        (drawn, errors) = self::drawn(city, &table, &choice);
        bytes = bytes_of(city, &drawn);
    }
    let (mut content, mut pen) = (Content::default(), Pen::default());
    let mut picked = choice.picked.iter();
    for d in &drawn {
        let item = if d.landmark { None } else { picked.next() };
        match (d.shape, item.map(|&i| table.half(i as usize))) {
            (Shape::Half, Some(half)) if !half.is_empty() => content.draw_ring(half),
            _ => content.draw(city, d, &mut pen),
        }
    }
    let nodes: Vec<u32> = choice.picked.iter().map(|&i| table.items[i as usize].node).collect();
    let lambda = if let Offer::Least { lambda, .. } = choice.offer { lambda } else { guess };
    let cut = Cut { offers: table.left(city, &nodes), nodes, lambda };

    let triangles = drawn.iter().map(|d| u64::from(d.triangles)).sum();
    let [error_space, error_height] = errors;
    let (lost, closed) = levels::covered(city, street, &drawn, &content.plans);
    Built {
        node: x,
        children,
        is_leaf: false,
        triangles,
        error_space,
        error_height,
        error: error_space.max(error_height).max(error_below),
        exceeds: triangles > limits.triangles || bytes > limits.bytes,
        lost,
        closed,
        drawn,
        content,
        cut,
    }
}

/// The features of a cut: each node in its form, its landmarks behind it; and the largest errors, of space and height.
fn drawn(city: &City, table: &Table, choice: &Choice) -> (Vec<Drawn>, [f64; 2]) {
    let mut out = Vec::with_capacity(choice.picked.len());
    let (mut space, mut height) = (0.0f64, 0.0f64);
    let mut add = |node: u32, form: &Form, landmark: bool| {
        space = space.max(form.error_space);
        height = height.max(form.error_height);
        out.push(Drawn::new(node, form, landmark));
    };
    let alone = |place: usize, form: usize| city.alone(place).nth(form).expect("a form of this building");
    for i in choice.picked.iter().map(|&i| i as usize) {
        let node = table.items[i].node;
        match choice.offer {
            Offer::Fewest if city.is_leaf(node) => add(node, &alone(city.first(node), 0), false),
            Offer::Fewest => {
                let form = forms::ring(city, node);
                add(node, &form, false);
                city.marks.taller(city.places(node), form.limit, |place| {
                    add(city.leaves[place], &alone(place, 0), true);
                });
            }
            Offer::Least { lambda, most_error } => {
                let (form, _) = least_cut::best(city, table, i, lambda, most_error).expect("it was chosen");
                let form = table.form(city, i, form);
                add(node, &form, false);
                if city.is_leaf(node) {
                    continue;
                }
                for (place, form) in least_cut::landmarks(city, table, i, &form, lambda, most_error) {
                    add(city.leaves[place], &alone(place, form), true);
                }
            }
        }
    }
    (out, [space, height])
}

/// Upper bound of a content's bytes.
fn bytes_of(city: &City, drawn: &[Drawn]) -> u64 {
    let one = |d: &Drawn| match d.shape {
        Shape::Original => city.bytes(d.node),
        _ => raised_bytes(d.triangles),
    };
    4096 + drawn.iter().map(one).sum::<u64>()
}
