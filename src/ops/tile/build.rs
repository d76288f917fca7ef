//! The tree of tiles, bottom-up: which subtrees are tiles, and what each shows.

use std::sync::atomic::Ordering::Relaxed;

use rayon::prelude::*;

use super::Limits;
use super::city::City;
use super::content::Content;
use super::forms::{Form, Shape};
use super::least_cut::{self, Choice, Offer, choose};
use super::levels::{self, Street};
use super::originals::raised_bytes;
use crate::geom::tree_cut::above;

/// A tile and all below it.
pub struct Built {
    pub node: u32,
    pub children: Vec<Built>,
    pub is_leaf: bool,
    /// In leaf order; a cluster before its landmarks.
    pub drawn: Vec<Drawn>,
    /// Their geometry; made at the end for leaves, which draw what is there.
    pub content: Option<Content>,
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
    /// Nodes of the cut, landmarks not among them.
    cut: Vec<u32>,
    lambda: f64,
}

/// A feature of a tile.
#[derive(Clone, Copy, Debug)]
pub struct Drawn {
    pub node: u32,
    pub form: Form,
    pub landmark: bool,
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
fn fits_as_it_is(city: &City, limits: &Limits, x: u32) -> bool {
    let x = x as usize;
    city.is_leaf(x as u32) || (city.triangles[x] <= limits.triangles && city.bytes[x] <= limits.bytes)
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
                let size = |c: u32| city.triangles[c as usize];
                open.extend([(r, size(l)), (l, size(r))]);
            }
            _ => out.push(y),
        }
    }
    out
}

fn leaf(city: &City, limits: &Limits, x: u32) -> Built {
    let cut: Vec<u32> = city.leaves[city.places(x)].to_vec();
    let original = |&node: &u32| Drawn { node, form: city.forms(node)[0], landmark: false };
    let drawn: Vec<Drawn> = cut.iter().map(original).collect();
    let nothing = cut.iter().filter(|&&n| city.triangles[n as usize] == 0 || city.built(n) <= 0.0).count();
    Built {
        node: x,
        children: Vec::new(),
        is_leaf: true,
        content: None,
        triangles: city.triangles[x as usize],
        error_space: 0.0,
        error_height: 0.0,
        error: 0.0,
        exceeds: city.triangles[x as usize] > limits.triangles || city.bytes[x as usize] > limits.bytes,
        lost: nothing as u64,
        closed: Vec::new(),
        drawn,
        cut,
        lambda: 0.0,
    }
}

fn inner(city: &City, street: &Street, limits: &Limits, x: u32, children: Vec<Built>) -> Built {
    let base: Vec<u32> = children.iter().flat_map(|c| &c.cut).copied().collect();
    let items = above(&base, &city.parent, x);
    let below: u64 = children.iter().map(|c| c.triangles).sum();
    let error_below = children.iter().map(|c| c.error).fold(0.0, f64::max);
    let guess = children.iter().map(|c| c.lambda).fold(1.0, f64::max);

    let mut most = limits.triangles.min(below / 2);
    let mut choice = choose(city, &items, most, error_below, guess, limits.prefer);
    if !choice.fits && most < limits.triangles {
        // Half of what lies below is out of reach for a few buildings: then the bound alone.
        most = limits.triangles;
        choice = choose(city, &items, most, error_below, guess, limits.prefer);
    }
    let mut drawn = drawn(city, &choice);
    let mut bytes = bytes_of(city, &drawn);
    while bytes > limits.bytes && choice.fits {
        most = (most as f64 * 0.95 * (limits.bytes as f64 / bytes as f64)) as u64;
        choice = choose(city, &items, most, error_below, guess, limits.prefer);
        drawn = self::drawn(city, &choice);
        bytes = bytes_of(city, &drawn);
    }

    let triangles = drawn.iter().map(|d| u64::from(d.form.triangles)).sum();
    let largest = |f: fn(&Form) -> f64| drawn.iter().map(|d| f(&d.form)).fold(0.0, f64::max);
    let (error_space, error_height) = (largest(|f| f.error_space), largest(|f| f.error_height));
    let mut content = Content::default();
    drawn.iter().for_each(|d| content.draw(city, d));
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
        content: Some(content),
        lambda: if let Offer::Least { lambda, .. } = choice.offer { lambda } else { guess },
        cut: choice.nodes,
    }
}

/// The features of a cut: each node in its form, its landmarks behind it.
fn drawn(city: &City, choice: &Choice) -> Vec<Drawn> {
    let mut out = Vec::with_capacity(choice.nodes.len());
    for &node in &choice.nodes {
        match choice.offer {
            Offer::Fewest => {
                let form = city.forms(node)[0];
                out.push(Drawn { node, form, landmark: false });
                city.marks.taller(city.places(node), form.limit, |place| {
                    let node = city.leaves[place];
                    out.push(Drawn { node, form: city.forms(node)[0], landmark: true });
                });
            }
            Offer::Least { lambda, most_error } => {
                let (form, _) = least_cut::best(city, node, lambda, most_error).expect("it was chosen");
                let form = city.forms(node)[form];
                out.push(Drawn { node, form, landmark: false });
                if city.is_leaf(node) {
                    continue;
                }
                for (place, form) in least_cut::landmarks(city, node, &form, lambda, most_error) {
                    let node = city.leaves[place];
                    out.push(Drawn { node, form: city.forms(node)[form], landmark: true });
                }
            }
        }
    }
    out
}

/// Upper bound of a content's bytes.
fn bytes_of(city: &City, drawn: &[Drawn]) -> u64 {
    let one = |d: &Drawn| match d.form.shape {
        Shape::Original => city.bytes[d.node as usize],
        _ => raised_bytes(d.form.triangles),
    };
    4096 + drawn.iter().map(one).sum::<u64>()
}
