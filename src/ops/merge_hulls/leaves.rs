//! The leaves' own rings: outlines made simple and counter-clockwise, several parts merged.

use rayon::prelude::*;

use crate::artifact::Footprints;
use crate::geom::merge_rings::{Merger, Ring};
use crate::geom::segments::is_simple;
use crate::geom::{Point, distinct, erode, ring};

/// The leaves' own rings.
pub struct Leaves {
    pub vertices: Vec<Point>,
    /// By building: where its ring begins and ends in `rings`.
    spans: Vec<(u32, u32)>,
    /// Vertex numbers: all shells', then the rings that had to be made.
    rings: Vec<u32>,
    pub repairs: Vec<(u32, &'static str)>,
    /// By building: an outline of its crosses or touches itself.
    pub crossed: Vec<bool>,
}

const CROSSED: &str = "outline crosses or touches itself: taken as the ring around its edges";
pub const NO_AREA: &str = "outline without area: no ring";

/// A ring that is not the only shell as it is, and what was wrong with that.
type Made = (Vec<u32>, Option<&'static str>);

impl Leaves {
    pub fn new(footprints: &Footprints, order: &[u32]) -> Self {
        let shapes = &footprints.polygons;
        // Where each building's shells begin and end among all.
        let mut spans = vec![(0u32, 0u32); footprints.len()];
        let mut at = 0u32;
        for &b in order {
            let from = at;
            at += shapes.shells(b as usize).map(|s| s.len() as u32).sum::<u32>();
            spans[b as usize] = (from, at);
        }
        let mut points: Vec<Point> = Vec::with_capacity(at as usize);
        order.iter().flat_map(|&b| shapes.shells(b as usize)).for_each(|s| points.extend_from_slice(s));
        let (vertices, mut rings) = distinct::number(&points);
        drop(points);
        let made: Vec<(u32, Made)> = (0..footprints.len())
            .into_par_iter()
            .filter_map(|b| {
                let (from, to) = spans[b];
                Some((b as u32, make(shapes.shells(b), &rings[from as usize..to as usize])?))
            })
            .collect();
        let mut crossed = vec![false; footprints.len()];
        let mut repairs = Vec::new();
        for (b, (ring, cause)) in made {
            let from = rings.len() as u32;
            rings.extend_from_slice(&ring);
            spans[b as usize] = (from, rings.len() as u32);
            crossed[b as usize] = cause.is_some();
            repairs.extend(cause.map(|c| (b, c)));
        }
        Self { vertices, spans, rings, repairs, crossed }
    }
    pub fn ring(&self, building: u32) -> &[u32] {
        let (from, to) = self.spans[building as usize];
        &self.rings[from as usize..to as usize]
    }
}

/// The ring of a building; none where that is its only shell as it is.
fn make<'a>(mut shells: impl Iterator<Item = &'a [Point]> + Clone, mut numbers: &[u32]) -> Option<Made> {
    let mut again = shells.clone();
    if let (Some(only), None) = (again.next(), again.next())
        && only.len() >= 3
        && ring::doubled_area(only) > 0
        && is_simple(only)
    {
        return None;
    }
    let (mut hull, mut cause): ((Vec<Point>, Vec<u32>), _) = (Default::default(), None);
    for shell in &mut shells {
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
    Some((hull.1, cause))
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
