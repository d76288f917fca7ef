//! The leaves' own rings: outlines made simple and counter-clockwise, several parts merged.

use rayon::prelude::*;

use crate::artifact::Footprints;
use crate::geom::merge_rings::{Merger, Ring};
use crate::geom::segments::is_simple;
use crate::geom::{Point, distinct, erode, ring};

/// The leaves' own rings.
pub struct Leaves {
    pub vertices: Vec<Point>,
    /// By building: offsets into `rings`, vertex numbers.
    starts: Vec<u32>,
    rings: Vec<u32>,
    pub repairs: Vec<(u32, &'static str)>,
    /// By building: an outline of its crosses or touches itself.
    pub crossed: Vec<bool>,
}

const CROSSED: &str = "outline crosses or touches itself: taken as the ring around its edges";
pub const NO_AREA: &str = "outline without area: no ring";

impl Leaves {
    pub fn new(footprints: &Footprints, order: &[u32]) -> Self {
        let shapes = &footprints.polygons;
        let shells = || order.iter().flat_map(|&b| shapes.shells(b as usize));
        let points: Vec<Point> = shells().flatten().copied().collect();
        let (vertices, numbers) = distinct::number(points.into_iter());
        // Where each building's shells begin in `numbers`.
        let mut from = vec![0u32; footprints.len() + 1];
        let mut at = 0u32;
        for &b in order {
            from[b as usize] = at;
            at += shapes.shells(b as usize).map(|s| s.len() as u32).sum::<u32>();
        }
        let built: Vec<(Vec<u32>, Option<&'static str>)> = (0..footprints.len())
            .into_par_iter()
            .map(|b| {
                let mut numbers = &numbers[from[b] as usize..];
                let mut hull: (Vec<Point>, Vec<u32>) = (Vec::new(), Vec::new());
                let mut cause = None;
                for shell in shapes.shells(b) {
                    let (mine, rest) = numbers.split_at(shell.len());
                    numbers = rest;
                    let (outline, why) = clean(shell, mine);
                    cause = cause.or(why);
                    if hull.0.is_empty() {
                        hull = outline;
                    } else if !outline.0.is_empty() {
                        let mut merger = Merger::default();
                        merger.merge(Ring { at: &hull.0, ids: &hull.1 }, Ring { at: &outline.0, ids: &outline.1 });
                        hull = (merger.at, merger.ids);
                    }
                }
                if hull.0.is_empty() {
                    cause = Some(NO_AREA);
                }
                (hull.1, cause)
            })
            .collect();
        let mut leaves = Self {
            vertices,
            starts: vec![0],
            rings: Vec::with_capacity(numbers.len()),
            repairs: Vec::new(),
            crossed: Vec::new(),
        };
        for (b, (ring, cause)) in built.iter().enumerate() {
            leaves.rings.extend_from_slice(ring);
            leaves.starts.push(leaves.rings.len() as u32);
            leaves.crossed.push(cause.is_some());
            leaves.repairs.extend(cause.map(|c| (b as u32, c)));
        }
        leaves
    }
    pub fn ring(&self, building: u32) -> &[u32] {
        let b = building as usize;
        &self.rings[self.starts[b] as usize..self.starts[b + 1] as usize]
    }
}

/// A simple counter-clockwise ring around an outline, and what was wrong with it; empty where it has no area.
pub fn clean(shell: &[Point], numbers: &[u32]) -> ((Vec<Point>, Vec<u32>), Option<&'static str>) {
    let (mut at, mut ids) = (shell.to_vec(), numbers.to_vec());
    at.dedup();
    ids.dedup();
    while at.len() > 1 && at[0] == at[at.len() - 1] {
        at.pop();
        ids.pop();
    }
    if at.len() >= 3 && is_simple(&at) {
        if ring::doubled_area(&at) < 0 {
            at.reverse();
            ids.reverse();
        }
        return ((at, ids), None);
    }
    match erode::around(&at) {
        Some(places) => {
            let pick = |i: &u32| (at[*i as usize], ids[*i as usize]);
            (places.iter().map(pick).unzip(), Some(CROSSED))
        }
        None => ((Vec::new(), Vec::new()), Some(NO_AREA)),
    }
}
