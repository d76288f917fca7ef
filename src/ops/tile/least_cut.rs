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

/// Triangles of the simplest form there is: a prism over a triangle.
const FEWEST: f64 = 7.0;

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
    let offers = city.offers(x);
    // Members that may be drawn: those that some form forces out, and those whose hiding costs more than any drawing
    // (no form has fewer triangles than a prism over a triangle).
    let free = offers.rest.partition_point(|&(hidden, _)| hidden > FEWEST * lambda);
    let hidden = offers.low + offers.hidden_after.get(free).copied().unwrap_or(0.0);
    let mut sums: [Price; 3] = [Price { triangles: 0, shown: hidden }; 3];
    for (sum, form) in sums.iter_mut().zip(&offers.forms) {
        *sum = *sum + Price { triangles: u64::from(form.triangles), shown: form.shown };
    }
    for &(hidden, place) in offers.forced.iter().chain(&offers.rest[..free]) {
        let hidden = Price { triangles: 0, shown: hidden };
        let (_, drawn) = draw(city, city.leaves[place as usize], lambda, most_error);
        let better = if hidden.at_most(&drawn, lambda) { hidden } else { drawn };
        for (sum, form) in sums.iter_mut().zip(&offers.forms) {
            *sum = *sum + if city.marks.height[place as usize] > form.limit { drawn } else { better };
        }
    }
    // The first is the ring, whose error was compared.
    let allowed = (0..offers.forms.len()).filter(|&i| i == 0 || offers.forms[i].error() <= most_error);
    allowed.map(|i| (i, sums[i])).reduce(|best, other| if best.1.at_most(&other.1, lambda) { best } else { other })
}

/// The members of a node drawn in a form that are drawn beside it, in leaf order, and in which of their forms.
pub fn landmarks(city: &City, x: u32, form: &Form, lambda: f64, most_error: f64) -> Vec<(usize, usize)> {
    let offers = city.offers(x);
    let free = offers.rest.partition_point(|&(hidden, _)| hidden > FEWEST * lambda);
    let drawn = offers.forced.iter().chain(&offers.rest[..free]).filter_map(|&(hidden, place)| {
        let place = place as usize;
        let (best, drawn) = draw(city, city.leaves[place], lambda, most_error);
        let hidden = Price { triangles: 0, shown: hidden };
        (city.marks.height[place] > form.limit || !hidden.at_most(&drawn, lambda)).then_some((place, best))
    });
    let mut out: Vec<(usize, usize)> = drawn.collect();
    out.sort_unstable();
    out
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
