//! Which cut of its subtree an inner tile shows, and in which forms.
//!
//! cost(x) = min( cost(left) + cost(right),
//!                min over forms f of x: lambda * triangles(f) + 0.6 * negative_space(f)
//!                  + sum over members b: min( 0.8 * |height(b) - height(x)| * sqrt(area(b)), draw(b) if b is taller ) )
//! draw(b)  = min over forms of b: lambda * triangles + what the form shows wrong; members above the form's limit are
//!            always drawn. Of a single building cost = draw.
//! Only forms whose error is at most the tile's E compete, and E is the smallest for which the cut of the fewest
//! triangles (the source's: rings, landmarks as they are) fits the budget.

use std::cell::{OnceCell, RefCell};

use super::city::City;
use super::error::SEEN_FLAT;
use super::forms::{Form, Offers, Pen, Shape};
use crate::geom::Point;
use crate::geom::tree_cut::{self, Item, Prefer, Price, cheapest, spend};

/// The nodes that a tile's cut is made of, and what they offer.
pub struct Table {
    pub items: Vec<Item>,
    /// Of each item that is a single building its place; `u32::MAX` of clusters.
    place: Vec<u32>,
    /// Of clusters what all their forms show wrong at least.
    floor: Vec<f64>,
    /// Of clusters, worked out when first needed.
    offers: Vec<OnceCell<Offers>>,
    pen: RefCell<Pen>,
}

impl Table {
    /// `known`: offers that were worked out before, ascending by node; nodes that are no items are none.
    pub fn new(city: &City, items: Vec<Item>, known: Vec<(u32, Offers)>) -> Self {
        let place = |i: &Item| if city.is_leaf(i.node) { city.first(i.node) as u32 } else { u32::MAX };
        // No form has less negative space than the ring, but for the last bits.
        let floor = |i: &Item| SEEN_FLAT * city.negative_space(i.node) * (1.0 - 1e-9);
        let mut offers = vec![OnceCell::new(); items.len()];
        for (node, offer) in known {
            if let Ok(i) = items.binary_search_by_key(&node, |i| i.node) {
                offers[i] = OnceCell::from(offer);
            }
        }
        Self {
            place: items.iter().map(place).collect(),
            floor: items.iter().map(floor).collect(),
            items,
            offers,
            pen: RefCell::default(),
        }
    }

    /// What the tile above may ask for again: offers of the cut and of what lies above it.
    pub fn left(self, city: &City, cut: &[u32]) -> Vec<(u32, Offers)> {
        let mut next = cut.iter().peekable();
        let mut out = Vec::new();
        for (item, offer) in self.items.iter().zip(self.offers) {
            while next.peek().is_some_and(|&&c| c < item.node) {
                next.next();
            }
            // Below a node of the cut: in its subtree.
            let below = next.peek().is_some_and(|&&c| c != item.node && item.node + 2 * city.size(c) as u32 > c + 1);
            out.extend(offer.into_inner().filter(|_| !below).map(|o| (item.node, o)));
        }
        out
    }

    /// A form of an item.
    pub fn form(&self, city: &City, i: usize, form: usize) -> Form {
        match self.place[i] {
            u32::MAX => self.offers(city, i).forms[form],
            place => city.alone(place as usize).nth(form).expect("a form of this building"),
        }
    }

    /// A cluster's ring with half its edges; empty where it was not worked out.
    pub fn half(&self, i: usize) -> &[Point] {
        self.offers[i].get().map_or(&[], |o| &o.half)
    }

    fn offers(&self, city: &City, i: usize) -> &Offers {
        self.offers[i].get_or_init(|| Offers::of(city, self.items[i].node, &mut self.pen.borrow_mut()))
    }
}

/// A cut of a tile's subtree.
pub struct Choice {
    /// Places in the table's items, ascending.
    pub picked: Vec<u32>,
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

/// The cut of the table's items within `budget`. No error below `error_floor` is aimed at (what lies below has that
/// error already); `guess` is where the search for lambda begins.
pub fn choose(city: &City, table: &Table, budget: u64, error_floor: f64, guess: f64, prefer: Prefer) -> Choice {
    let rings: Vec<(f64, u64)> = table
        .items
        .iter()
        .zip(&table.place)
        .map(|(i, &place)| {
            let error = if place == u32::MAX { city.ring_error[i.node as usize] } else { f64::NEG_INFINITY };
            (error, city.ring_triangles[i.node as usize])
        })
        .collect();
    let mut errors: Vec<f64> = rings.iter().map(|r| r.0).collect();
    errors.retain(|&e| e > error_floor && e.is_finite());
    errors.push(error_floor);
    errors.sort_unstable_by(f64::total_cmp);
    errors.dedup();
    // More errors allowed never mean more triangles.
    let within = |i: usize, most_error: f64| (rings[i].0 <= most_error).then_some(rings[i].1);
    let fewest = |most_error: f64| tree_cut::fewest(&table.items, |i| within(i, most_error));
    let enough = errors.partition_point(|&e| fewest(e) > budget);
    let (most_error, fits) = match errors.get(enough) {
        Some(&e) => (e, true),
        None => (errors[errors.len() - 1], false),
    };
    if fits && prefer == Prefer::LeastError {
        let own = |i: usize, lambda: f64, below: Price| {
            let least = (table.place[i] == u32::MAX).then(|| FEWEST * lambda + table.floor[i]);
            // Dearer than what lies below in any form: no need to know how much.
            if least.is_some_and(|least| least > below.cost(lambda)) {
                return None;
            }
            price(city, table, i, lambda, most_error)
        };
        let lambda = spend(&table.items, budget, guess, own);
        // The search adds up in another order: what it found may miss by a triangle's breadth.
        let mut lambda = lambda;
        while lambda.is_finite() {
            let (picked, total) = cheapest(&table.items, lambda, |i, below| own(i, lambda, below));
            if total.triangles <= budget {
                return Choice { picked, offer: Offer::Least { lambda, most_error }, fits };
            }
            lambda *= 1.0 + 1e-6;
        }
    }
    let ring = |i, _| within(i, most_error).map(|triangles| Price { triangles, shown: 0.0 });
    Choice { picked: cheapest(&table.items, f64::INFINITY, ring).0, offer: Offer::Fewest, fits }
}

/// Triangles of the simplest form there is: a prism over a triangle.
const FEWEST: f64 = 7.0;

/// The price of showing an item itself; none where its error is too large. Single buildings always have one.
pub fn price(city: &City, table: &Table, i: usize, lambda: f64, most_error: f64) -> Option<Price> {
    best(city, table, i, lambda, most_error).map(|(_, p)| p)
}

/// The best form of an item, as a place in its forms.
pub fn best(city: &City, table: &Table, i: usize, lambda: f64, most_error: f64) -> Option<(usize, Price)> {
    if table.place[i] != u32::MAX {
        return Some(draw(city, table.place[i], lambda, most_error));
    }
    if city.ring_error[table.items[i].node as usize] > most_error {
        return None;
    }
    let offers = table.offers(city, i);
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
        let (_, drawn) = draw(city, place, lambda, most_error);
        let better = if hidden.at_most(&drawn, lambda) { hidden } else { drawn };
        for (sum, form) in sums.iter_mut().zip(&offers.forms) {
            *sum = *sum + if city.marks.height[place as usize] > form.limit { drawn } else { better };
        }
    }
    // The first is the ring, whose error was compared.
    let allowed = (0..offers.forms.len()).filter(|&i| i == 0 || offers.forms[i].error() <= most_error);
    allowed.map(|i| (i, sums[i])).reduce(|best, other| if best.1.at_most(&other.1, lambda) { best } else { other })
}

/// The members of a cluster drawn in a form that are drawn beside it, in leaf order, and in which of their forms.
pub fn landmarks(
    city: &City,
    table: &Table,
    i: usize,
    form: &Form,
    lambda: f64,
    most_error: f64,
) -> Vec<(usize, usize)> {
    let offers = table.offers(city, i);
    let free = offers.rest.partition_point(|&(hidden, _)| hidden > FEWEST * lambda);
    let drawn = offers.forced.iter().chain(&offers.rest[..free]).filter_map(|&(hidden, place)| {
        let (best, drawn) = draw(city, place, lambda, most_error);
        let hidden = Price { triangles: 0, shown: hidden };
        let place = place as usize;
        (city.marks.height[place] > form.limit || !hidden.at_most(&drawn, lambda)).then_some((place, best))
    });
    let mut out: Vec<(usize, usize)> = drawn.collect();
    out.sort_unstable();
    out
}

/// The best form of a single building; its original is always allowed.
fn draw(city: &City, place: u32, lambda: f64, most_error: f64) -> (usize, Price) {
    let mut best: Option<(usize, Price)> = None;
    for (i, form) in city.alone(place as usize).enumerate() {
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
