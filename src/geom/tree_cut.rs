//! Cuts of a binary tree: which nodes to show so that every leaf is below exactly one of them.
//!
//! Nodes are numbered in postorder, left subtree first: the right child of x is x - 1, a node is a right child if and
//! only if its parent is the next number. Each node may offer itself at a price in triangles and in what it shows
//! wrong; a cut's price is the sum. Three questions are answered, all by one sweep bottom-up:
//! the cheapest cut for a given worth of a triangle (`lambda`), the fewest triangles (`lambda` infinite), and the
//! lambda whose cheapest cut just fits a budget.
//! Exact: cost(x) = min(cost(left) + cost(right), own(x)). Ties: fewer triangles, then the node above.
//! Cost: O(n) a sweep. The search for lambda sweeps some thirty times over ever fewer nodes: where both ends of the
//! interval have the same best cut below a node, that node is settled (the best cost is concave in lambda).

use serde::{Deserialize, Serialize};

/// Which cut of many is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Prefer {
    /// The least error for its triangles.
    LeastError,
    /// The fewest triangles within the error.
    Fewest,
}

/// What a cut costs: triangles, and the error it shows (m2, any scale that lambda shares).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Price {
    pub triangles: u64,
    pub shown: f64,
}

impl Price {
    /// lambda * triangles + shown.
    pub fn cost(&self, lambda: f64) -> f64 {
        lambda * self.triangles as f64 + self.shown
    }

    /// True where it is not dearer than `other`; with infinite lambda only triangles count, then what is shown.
    pub fn at_most(&self, other: &Self, lambda: f64) -> bool {
        if lambda == f64::INFINITY {
            return (self.triangles, self.shown) <= (other.triangles, other.shown);
        }
        (self.cost(lambda), self.triangles) <= (other.cost(lambda), other.triangles)
    }
}

/// Dearer than anything.
const DEAREST: Price = Price { triangles: u64::MAX, shown: f64::INFINITY };

impl std::ops::Add for Price {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { triangles: self.triangles + other.triangles, shown: self.shown + other.shown }
    }
}

/// A node of the tree that is swept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Item {
    pub node: u32,
    /// Nothing below is looked at; the node must offer itself.
    pub base: bool,
}

/// The nodes from `base` (ascending, a cut of `root`'s subtree) up to `root`, in postorder. `parent` by node.
pub fn above(base: &[u32], parent: &[u32], root: u32) -> Vec<Item> {
    let mut out = Vec::with_capacity(2 * base.len());
    for &b in base {
        out.push(Item { node: b, base: true });
        let mut at = b;
        // After a right child comes its parent: the left one is there already.
        while at != root && parent[at as usize] == at + 1 {
            at += 1;
            out.push(Item { node: at, base: false });
        }
    }
    out
}

/// The cheapest cut: places of its nodes in `items`, ascending, and its price. `own` gives the price at which the
/// node of an item shows itself; it may keep quiet where that is above the price of what lies below, which it is
/// told. A base node must have one.
pub fn cheapest(items: &[Item], lambda: f64, mut own: impl FnMut(usize, Price) -> Option<Price>) -> (Vec<u32>, Price) {
    let mut picked: Vec<u32> = Vec::new();
    // Of each finished subtree: its price, and how many nodes were picked before it.
    let mut done: Vec<(Price, usize)> = Vec::new();
    for (i, item) in items.iter().enumerate() {
        if item.base {
            done.push((own(i, DEAREST).expect("a base node offers itself"), picked.len()));
            picked.push(i as u32);
            continue;
        }
        let (right, _) = done.pop().expect("postorder");
        let (left, start) = done.pop().expect("postorder");
        let split = left + right;
        match own(i, split) {
            Some(own) if own.at_most(&split, lambda) => {
                picked.truncate(start);
                picked.push(i as u32);
                done.push((own, start));
            }
            _ => done.push((split, start)),
        }
    }
    let price = done.pop().map_or(Price::default(), |(p, _)| p);
    debug_assert!(done.is_empty());
    (picked, price)
}

/// Fewest triangles of any cut; `own` as above, infinite worth: of what is shown nothing is asked.
pub fn fewest(items: &[Item], mut own: impl FnMut(usize) -> Option<u64>) -> u64 {
    let mut done: Vec<u64> = Vec::new();
    for (i, item) in items.iter().enumerate() {
        let own = own(i);
        if item.base {
            done.push(own.expect("a base node offers itself"));
        } else {
            let split = done.pop().expect("postorder") + done.pop().expect("postorder");
            done.push(own.map_or(split, |own| own.min(split)));
        }
    }
    done.pop().unwrap_or(0)
}

/// The smallest lambda found (to one part in 10^6) whose cheapest cut has at most `budget` triangles; infinite where
/// not even the fewest triangles fit. `guess` is where the search begins: it moves no result by more than that part.
/// `own` as for [`cheapest`], and for any lambda.
pub fn spend(items: &[Item], budget: u64, guess: f64, own: impl Fn(usize, f64, Price) -> Option<Price>) -> f64 {
    const LEAST: f64 = 1e-6;
    const MOST: f64 = 1e12;
    let mut search = Search {
        work: items
            .iter()
            .enumerate()
            .map(|(i, item)| Work {
                at: i as u32,
                base: item.base,
                settled: false,
                low: Price::default(),
                high: Price::default(),
            })
            .collect(),
        found: Vec::with_capacity(items.len()),
        done: Vec::new(),
    };
    let (mut low, mut high) = (guess.clamp(LEAST, MOST), guess.clamp(LEAST, MOST));
    if search.sweep(high, &own) <= budget {
        search.keep_high();
        loop {
            low = (low / 4.0).max(LEAST);
            if search.sweep(low, &own) > budget {
                break search.keep_low();
            }
            if low == LEAST {
                return LEAST;
            }
            search.keep_high();
            high = low;
        }
    } else {
        search.keep_low();
        loop {
            high *= 4.0;
            if high > MOST {
                return f64::INFINITY;
            }
            if search.sweep(high, &own) <= budget {
                break search.keep_high();
            }
            search.keep_low();
            low = high;
        }
    }
    while high > low * (1.0 + 1e-6) {
        search.settle();
        let middle = (low * high).sqrt();
        if search.sweep(middle, &own) <= budget {
            search.keep_high();
            high = middle;
        } else {
            search.keep_low();
            low = middle;
        }
    }
    high
}

/// Sweeps over the nodes that are not settled yet.
struct Search {
    work: Vec<Work>,
    /// Price below each of `work` at the last lambda.
    found: Vec<Price>,
    done: Vec<Price>,
}

#[derive(Clone, Copy)]
struct Work {
    /// Place of its item.
    at: u32,
    base: bool,
    settled: bool,
    /// Best price below it at the ends of the interval.
    low: Price,
    high: Price,
}

impl Search {
    /// Triangles of the cheapest cut.
    fn sweep(&mut self, lambda: f64, own: &impl Fn(usize, f64, Price) -> Option<Price>) -> u64 {
        self.found.clear();
        self.done.clear();
        for w in &self.work {
            let price = if w.settled {
                w.high
            } else if w.base {
                own(w.at as usize, lambda, DEAREST).expect("a base node offers itself")
            } else {
                let right = self.done.pop().expect("postorder");
                let split = self.done.pop().expect("postorder") + right;
                match own(w.at as usize, lambda, split) {
                    Some(own) if own.at_most(&split, lambda) => own,
                    _ => split,
                }
            };
            self.done.push(price);
            self.found.push(price);
        }
        self.done.last().map_or(0, |p| p.triangles)
    }

    fn keep_low(&mut self) {
        self.work.iter_mut().zip(&self.found).for_each(|(w, &p)| w.low = p);
    }

    fn keep_high(&mut self) {
        self.work.iter_mut().zip(&self.found).for_each(|(w, &p)| w.high = p);
    }

    /// Drops what lies below nodes whose best price is the same at both ends.
    fn settle(&mut self) {
        let mut kept: Vec<Work> = Vec::with_capacity(self.work.len());
        // Where each finished subtree begins in `kept`.
        let mut starts: Vec<usize> = Vec::new();
        for w in &self.work {
            let mut start = kept.len();
            if !w.settled && !w.base {
                starts.pop();
                start = starts.pop().expect("postorder");
            }
            let settled = w.settled || w.low == w.high;
            if settled {
                kept.truncate(start);
            }
            kept.push(Work { settled, ..*w });
            starts.push(start);
        }
        self.work = kept;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A random tree over n leaves in postorder: (parents, sizes).
    fn tree(n: usize, mut seed: u64) -> (Vec<u32>, Vec<u32>) {
        fn grow(n: usize, seed: &mut u64, parent: &mut Vec<u32>, size: &mut Vec<u32>) -> usize {
            if n > 1 {
                *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                let left = 1 + (*seed >> 33) as usize % (n - 1);
                let l = grow(left, seed, parent, size);
                let r = grow(n - left, seed, parent, size);
                let me = size.len();
                parent[l] = me as u32;
                parent[r] = me as u32;
            }
            size.push(n as u32);
            parent.push(u32::MAX);
            size.len() - 1
        }
        let (mut parent, mut size) = (Vec::new(), Vec::new());
        grow(n, &mut seed, &mut parent, &mut size);
        (parent, size)
    }

    /// Every cut of the subtree of `x`, as lists of nodes.
    pub fn all_cuts(x: usize, size: &[u32]) -> Vec<Vec<u32>> {
        let mut out = vec![vec![x as u32]];
        if size[x] > 1 {
            let (right, left) = (x - 1, x - 2 * size[x - 1] as usize);
            for l in all_cuts(left, size) {
                for r in all_cuts(right, size) {
                    out.push([&l[..], &r[..]].concat());
                }
            }
        }
        out
    }

    proptest! {
        #[test]
        fn the_cheapest_of_all_cuts(n in 1usize..9, seed: u64, prices in prop::collection::vec((1u64..40, 0u32..60), 17), lambda in 0.01f64..9.0, budget in 1u64..90) {
            let (parent, size) = tree(n, seed);
            let own = |x: u32| Price { triangles: prices[x as usize].0, shown: f64::from(prices[x as usize].1) };
            let leaves: Vec<u32> = (0..size.len() as u32).filter(|&x| size[x as usize] == 1).collect();
            let root = size.len() - 1;
            let items = above(&leaves, &parent, root as u32);
            prop_assert_eq!(items.len(), size.len());
            let price = |cut: &Vec<u32>| cut.iter().map(|&x| own(x)).fold(Price::default(), |a, b| a + b);
            let cuts = all_cuts(root, &size);
            // All nodes are items here, so places and nodes are the same.
            let own_at = |i: usize, _| Some(own(i as u32));
            // Quiet where it would not be taken.
            let shy = |i: usize, beat: Price| Some(own(i as u32)).filter(|p| p.cost(lambda) <= beat.cost(lambda));
            prop_assert_eq!(cheapest(&items, lambda, shy), cheapest(&items, lambda, own_at));

            let (picked, found) = cheapest(&items, lambda, own_at);
            prop_assert_eq!(price(&picked), found);
            let best = cuts.iter().map(|c| price(c).cost(lambda)).fold(f64::INFINITY, f64::min);
            prop_assert!((found.cost(lambda) - best).abs() < 1e-9);

            let (_, few) = cheapest(&items, f64::INFINITY, own_at);
            prop_assert_eq!(few.triangles, cuts.iter().map(|c| price(c).triangles).min().unwrap());
            prop_assert_eq!(fewest(&items, |i| Some(own(i as u32).triangles)), few.triangles);

            // The search agrees with the sweep, and a tenth less would not do.
            let found = spend(&items, budget, 1.0, |i, _, beat| own_at(i, beat));
            prop_assert_eq!(found.is_finite(), few.triangles <= budget);
            if found.is_finite() {
                prop_assert!(cheapest(&items, found, own_at).1.triangles <= budget);
                let less = found * 0.9;
                prop_assert!(less < 1e-6 || cheapest(&items, less, own_at).1.triangles > budget);
            }
        }
    }

    #[test]
    fn items_above_a_cut() {
        // ((0 1)2 (3 4)5)6
        let parent = [2, 2, 6, 5, 5, 6, u32::MAX];
        let nodes = |base: &[u32]| above(base, &parent, 6).iter().map(|i| (i.node, i.base)).collect::<Vec<_>>();
        assert_eq!(nodes(&[2, 3, 4]), [(2, true), (3, true), (4, true), (5, false), (6, false)]);
        assert_eq!(nodes(&[6]), [(6, true)]);
    }
}
