//! Which cut of its subtree an inner tile shows, and in which forms.
//!
//! cost(x) = min( cost(left) + cost(right),
//!                min over forms f of x: lambda * triangles(f) + 0.6 * negative_space(f)
//!                  + sum over members b: min( 0.8 * |height(b) - height(x)| * sqrt(area(b)), draw(b) if b is taller ) )
//! draw(b)  = min over forms of b: lambda * triangles + what the form shows wrong; members above the form's limit are
//!            always drawn. Of a single building cost = draw.
//! Only forms whose error is at most the tile's E compete, and E is the smallest for which the cut of the fewest
//! triangles (the source's: rings, landmarks as they are) fits the budget.

use super::city::City;
use super::error::SEEN_TALL;
use super::forms::{Form, Shape};
use crate::geom::tree_cut::{Item, Prefer, Price, cheapest, spend};

/// A cut of a tile's subtree.
pub struct Choice {
    /// Ascending nodes.
    pub nodes: Vec<u32>,
    pub offer: Offer,
    /// False where not even the fewest triangles fit the budget.
    pub fits: bool,
}

/// The rule by which a node offers itself.
#[derive(Clone, Copy, Debug)]
pub enum Offer {
    /// Rings, and landmarks as they are.
    Fewest,
    /// The best form for a triangle's worth, none with a larger error.
    Least { lambda: f64, most_error: f64 },
}

/// The cut of `items` within `budget`. No error below `error_floor` is aimed at (what lies below has that error
/// already); `guess` is where the search for lambda begins.
pub fn choose(city: &City, items: &[Item], budget: u64, error_floor: f64, guess: f64, prefer: Prefer) -> Choice {
    let fewest = |most_error: f64| {
        cheapest(items, f64::INFINITY, |x| {
            let offered = city.is_leaf(x) || city.ring_error[x as usize] <= most_error;
            offered.then(|| Price { triangles: city.ring_triangles[x as usize], shown: 0.0 })
        })
    };
    let mut errors: Vec<f64> = items.iter().map(|i| city.ring_error[i.node as usize]).collect();
    errors.retain(|&e| e > error_floor && e.is_finite());
    errors.push(error_floor);
    errors.sort_unstable_by(f64::total_cmp);
    errors.dedup();
    // More errors allowed never mean more triangles.
    let enough = errors.partition_point(|&e| fewest(e).1.triangles > budget);
    let (most_error, fits) = match errors.get(enough) {
        Some(&e) => (e, true),
        None => (errors[errors.len() - 1], false),
    };
    if fits && prefer == Prefer::LeastError {
        let lambda = spend(items, budget, guess, |x, lambda| price(city, x, lambda, most_error));
        // The search adds up in another order: what it found may miss by a triangle's breadth.
        let mut lambda = lambda;
        while lambda.is_finite() {
            let (nodes, total) = cheapest(items, lambda, |x| price(city, x, lambda, most_error));
            if total.triangles <= budget {
                return Choice { nodes, offer: Offer::Least { lambda, most_error }, fits };
            }
            lambda *= 1.0 + 1e-6;
        }
    }
    Choice { nodes: fewest(most_error).0, offer: Offer::Fewest, fits }
}

/// The price of showing a node itself; none where its error is too large. Single buildings always have one.
pub fn price(city: &City, x: u32, lambda: f64, most_error: f64) -> Option<Price> {
    best(city, x, lambda, most_error).map(|(_, p)| p)
}

/// The best form of a node, as a place in its forms.
pub fn best(city: &City, x: u32, lambda: f64, most_error: f64) -> Option<(usize, Price)> {
    if city.is_leaf(x) {
        return Some(draw(city, x, lambda, most_error));
    }
    if city.ring_error[x as usize] > most_error {
        return None;
    }
    let mut best: Option<(usize, Price)> = None;
    for (i, form) in city.forms(x).iter().enumerate() {
        // The first is the ring, whose error was compared.
        if i > 0 && form.error() > most_error {
            continue;
        }
        let own = Price { triangles: u64::from(form.triangles), shown: form.shown };
        let mut sum = own;
        members(city, x, form, lambda, most_error, |member| sum = sum + member.price);
        if best.is_none_or(|(_, b)| !b.at_most(&sum, lambda)) {
            best = Some((i, sum));
        }
    }
    best
}

/// What becomes of a member of a drawn cluster.
pub struct Member {
    pub place: usize,
    /// The form in which it is drawn as a landmark; none where only the cluster stands for it.
    pub landmark: Option<usize>,
    pub price: Price,
}

/// Visits the members of a node drawn in a form, in leaf order.
pub fn members(city: &City, x: u32, form: &Form, lambda: f64, most_error: f64, mut visit: impl FnMut(Member)) {
    let height = city.height(x);
    for place in city.places(x) {
        let above = city.marks.height[place] - height;
        let hidden = Price { triangles: 0, shown: SEEN_TALL * above.abs() * city.side[place] };
        let mut member = Member { place, landmark: None, price: hidden };
        // No form has fewer than seven triangles (a prism over a triangle).
        let forced = city.marks.height[place] > form.limit;
        if forced || (above > 0.0 && hidden.shown > 7.0 * lambda) {
            let (form, drawn) = draw(city, city.leaves[place], lambda, most_error);
            if forced || !hidden.at_most(&drawn, lambda) {
                member = Member { place, landmark: Some(form), price: drawn };
            }
        }
        visit(member);
    }
}

/// The best form of a single building; its original is always allowed.
pub fn draw(city: &City, leaf: u32, lambda: f64, most_error: f64) -> (usize, Price) {
    let mut best: Option<(usize, Price)> = None;
    for (i, form) in city.forms(leaf).iter().enumerate() {
        if form.shape != Shape::Original && form.error() > most_error {
            continue;
        }
        let own = Price { triangles: u64::from(form.triangles), shown: form.shown };
        if best.is_none_or(|(_, b)| !b.at_most(&own, lambda)) {
            best = Some((i, own));
        }
    }
    best.expect("the original comes first")
}
