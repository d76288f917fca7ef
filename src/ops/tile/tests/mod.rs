//! Small cities that can be checked by brute force.

mod solids;

use super::forms::{Pen, Shape};
use super::least_cut::Table;
use super::*;
use crate::artifact::Artifact;
use crate::artifact::sections::Encoder;
use crate::artifact::toy::{self, Toy};
use crate::geom::bounds::{Bounds, shown_error};
use crate::geom::cover::Cover;
use crate::geom::ring::area_m2;
use crate::geom::tree_cut::{self, Price};
use crate::op::{Bench, NEVER};

fn toy(n: u64, seed: u64) -> Toy {
    toy::city(&(0..n).collect::<Vec<_>>(), seed)
}

fn tile_with(toy: &Toy, tile: &Tile, buildings: Option<Buildings>) -> (TileTree, crate::diag::Findings) {
    let bench = Bench::default();
    let input = In {
        footprints: toy.footprints.clone().into(),
        dendrogram: toy.dendrogram.clone().into(),
        hulls: toy.hulls.clone().into(),
        landmarks: toy.landmarks.clone().into(),
        buildings: buildings.map(Into::into),
    };
    let out = tile.run(&bench.ctx(), input).unwrap();
    (out, bench.report.finish())
}

fn small(max_triangles: u64) -> Tile {
    Tile { max_triangles, ..Tile::default() }
}

fn bytes(tree: &TileTree) -> Vec<u8> {
    let mut out = Encoder::new("TileTree");
    Artifact::encode(tree, &mut out);
    out.to_bytes()
}

fn city(toy: &Toy) -> City<'_, '_> {
    let originals = Originals::new(&toy.footprints, &toy.landmarks, None);
    City::new(&toy.dendrogram, &toy.hulls, &toy.landmarks, originals, 0.2).with_forms()
}

fn forms_of(city: &City, x: u32) -> Vec<forms::Form> {
    if city.is_leaf(x) {
        return city.alone(city.first(x)).collect();
    }
    forms::Offers::of(city, x, &mut Pen::default()).forms
}

/// All nodes of a city.
fn table(city: &City) -> Table {
    Table::new(city, tree_cut::above(&city.leaves, &city.parent, city.root()), Vec::new())
}

/// Every cut below a node.
fn all_cuts(city: &City, x: u32) -> Vec<Vec<u32>> {
    let mut out = vec![vec![x]];
    if let Some([l, r]) = city.children(x) {
        let right = all_cuts(city, r);
        for l in all_cuts(city, l) {
            out.extend(right.iter().map(|r| [&l[..], r].concat()));
        }
    }
    out
}

/// The formula of the contract, word for word, for one node: every form, every member drawn or not.
fn price_by_hand(city: &City, x: u32, lambda: f64, most: f64) -> Option<Price> {
    let cost = |p: &Price| lambda * p.triangles as f64 + p.shown;
    let cheaper = |a: Price, b: Price| if cost(&b) < cost(&a) { b } else { a };
    let own = |f: &forms::Form| Price { triangles: f.triangles.into(), shown: 0.6 * f.negative_space };
    let alone = |leaf: u32| {
        let allowed = forms_of(city, leaf).into_iter().filter(|f| f.shape == Shape::Original || f.error() <= most);
        allowed.map(|f| own(&f)).reduce(cheaper).unwrap()
    };
    if city.is_leaf(x) {
        return Some(alone(x));
    }
    let mut best = None;
    for form in forms_of(city, x).iter().filter(|f| f.error() <= most) {
        let mut sum = own(form);
        for place in city.places(x) {
            let above = city.marks.height[place] - city.height(x);
            let hidden = Price { triangles: 0, shown: 0.8 * above.abs() * city.side[place] };
            let drawn = alone(city.leaves[place]);
            let landmark = above > 0.2 * form.error_space;
            sum = sum
                + if landmark {
                    drawn
                } else if above > 0.0 {
                    cheaper(hidden, drawn)
                } else {
                    hidden
                };
        }
        best = Some(best.map_or(sum, |b| cheaper(b, sum)));
    }
    best
}

#[test]
fn the_least_cut_is_the_least_of_all_cuts() {
    let mut landmarks = 0;
    for seed in 0..40 {
        let n = 1 + seed % 9;
        let toy = toy(n, seed);
        let city = city(&toy);
        let table = table(&city);
        let cuts = all_cuts(&city, city.root());
        for most in [0.0, 8.0, 15.0, 25.0, 1e9] {
            for lambda in [0.01, 0.5, 2.0, 10.0, 300.0] {
                let own = |i, _| least_cut::price(&city, &table, i, lambda, most);
                // All nodes are items, so places and nodes are the same.
                let (cut, found) = tree_cut::cheapest(&table.items, lambda, own);
                let price = |cut: &[u32]| {
                    let prices = cut.iter().map(|&x| price_by_hand(&city, x, lambda, most));
                    prices.reduce(|a, b| Some(a? + b?)).flatten().map(|p| p.cost(lambda))
                };
                let best = cuts.iter().filter_map(|c| price(c)).fold(f64::INFINITY, f64::min);
                assert!((found.cost(lambda) - best).abs() < 1e-9 * best.max(1.0), "{seed} {most} {lambda}");
                assert!((price(&cut).unwrap() - best).abs() < 1e-9 * best.max(1.0));
                for &x in cut.iter().filter(|&&x| !city.is_leaf(x)) {
                    let (form, _) = least_cut::best(&city, &table, x as usize, lambda, most).unwrap();
                    let form = table.form(&city, x as usize, form);
                    landmarks += least_cut::landmarks(&city, &table, x as usize, &form, lambda, most).len();
                }
            }
        }
    }
    assert!(landmarks > 20, "only {landmarks} landmarks were tried");
}

#[test]
fn the_budget_is_kept_and_the_error_is_the_smallest_that_can() {
    for seed in 0..20 {
        let toy = toy(8, seed);
        let city = city(&toy);
        let table = table(&city);
        let cuts = all_cuts(&city, city.root());
        for budget in [20, 40, 60, 90, 120] {
            let fewest = |most: f64| {
                let allowed = cuts.iter().filter(|c| c.iter().all(|&x| city.ring_error[x as usize] <= most));
                allowed.map(|c| c.iter().map(|&x| city.ring_triangles[x as usize]).sum::<u64>()).min()
            };
            let choice = least_cut::choose(&city, &table, budget, 0.0, 1.0, Prefer::LeastError);
            let smallest = city.ring_error.iter().copied().filter(|&e| fewest(e).unwrap() <= budget);
            let smallest = smallest.fold(f64::INFINITY, f64::min);
            assert_eq!(choice.fits, smallest.is_finite());
            let least_cut::Offer::Least { lambda, most_error } = choice.offer else {
                assert!(!choice.fits);
                continue;
            };
            assert_eq!(most_error, smallest);
            let total = |lambda: f64| {
                let own = |i, _| least_cut::price(&city, &table, i, lambda, smallest);
                tree_cut::cheapest(&table.items, lambda, own).1.triangles
            };
            assert!(total(lambda) <= budget);
            assert!(lambda < 2e-6 || total(lambda * 0.99) > budget || total(lambda) == total(lambda * 0.99));
        }
    }
}

#[test]
fn forms_are_what_they_say() {
    let mut seen = [0; 6];
    for seed in 0..6 {
        let toy = toy(24, seed);
        let city = city(&toy);
        for x in 0..=city.root() {
            let (mut ring, mut pen) = (Vec::new(), Pen::default());
            city.ring(x, &mut ring);
            for form in &forms_of(&city, x) {
                seen[form.shape as usize] += 1;
                if form.shape == Shape::Original {
                    assert_eq!((form.negative_space, form.error()), (0.0, 0.0));
                    continue;
                }
                let plan = forms::plan(&city, x, form.shape, &mut pen).to_vec();
                assert_eq!(form.triangles as usize, 3 * plan.len() - 2);
                let cover = Cover::new(std::iter::once(&plan[..]));
                if form.shape == Shape::Rectangle {
                    assert!((area_m2(&plan) - city.built(x)).abs() < 0.1);
                } else {
                    assert!(ring.iter().all(|&p| cover.holds(p)));
                    assert!((area_m2(&plan) - city.built(x) - form.negative_space).abs() < 1e-6);
                }
                let e0 = shown_error(form.negative_space, Bounds::of(plan).sides(), city.height(x));
                assert!((e0 - form.error_space).abs() < 1e-9);
            }
        }
    }
    // Half of a ring here is convex already.
    let [original, footprint, ring, half, rectangle, convex] = seen;
    assert!(original > 100 && ring > 50 && half > 10 && rectangle > 10 && [convex, footprint] == [0, 0], "{seen:?}");
}

/// What must hold of every tree.
fn assert_sound(toy: &Toy, tile: &Tile, tree: &TileTree, exceeding: u64) {
    let mut large = 0;
    let (order, _) = toy.dendrogram.leaf_order();
    assert_eq!(tree.source_count[0] as usize, order.len());
    for t in 0..tree.len() {
        let children: Vec<usize> = (0..tree.len()).filter(|&c| tree.parent[c] as usize == t).collect();
        assert_eq!(children.is_empty(), tree.is_leaf[t]);
        let own = |t: usize| {
            tree.features_of(t).filter(|&f| !tree.landmark[f]).map(|f| (tree.feature_first[f], tree.feature_count[f]))
        };
        // The clusters are a partition of the sources, in order.
        let mut next = tree.source_first[t];
        for (first, count) in own(t) {
            assert_eq!(first, next);
            next += count;
        }
        assert_eq!(next, tree.source_first[t] + tree.source_count[t]);
        if tree.is_leaf[t] {
            assert_eq!(tree.error[t], 0.0);
            assert!(own(t).all(|(_, count)| count == 1));
        } else {
            // Children share the sources out, and their cuts are finer.
            let mut next = tree.source_first[t];
            for &c in &children {
                assert_eq!(tree.source_first[c], next);
                next += tree.source_count[c];
                assert!(tree.error[c] <= tree.error[t]);
                let starts: Vec<u32> = own(c).map(|o| o.0).collect();
                let end = tree.source_first[c] + tree.source_count[c];
                assert!(own(t).filter(|o| (tree.source_first[c]..end).contains(&o.0)).all(|o| starts.contains(&o.0)));
            }
            assert_eq!(next, tree.source_first[t] + tree.source_count[t]);
        }
        let triangles: usize = tree
            .features_of(t)
            .flat_map(|f| tree.plans.polygons_of(f))
            .map(|p| tree.plans.rings_of(p).map(|r| 3 * tree.plans.ring(r).len() + 2).sum::<usize>() - 4)
            .sum();
        large += u64::from(triangles as u64 > tile.max_triangles);
        // The error bounds what is drawn.
        let mut cluster = usize::MAX;
        for f in tree.features_of(t) {
            let place = tree.feature_first[f] as usize;
            if !tree.landmark[f] {
                cluster = f;
            } else {
                let (first, count) = (tree.feature_first[cluster], tree.feature_count[cluster]);
                assert!((first..first + count).contains(&(place as u32)) && tree.feature_count[f] == 1);
            }
            let bounds = Bounds::of(tree.plans.shells(f).flatten().copied());
            let height = tree.top[f] - tree.base[f];
            assert!(shown_error(tree.negative_space_m2[f], bounds.sides(), height) <= tree.error[t] + 1e-9);
            let drawn: Vec<u32> =
                tree.features_of(t).filter(|&g| tree.landmark[g]).map(|g| tree.feature_first[g]).collect();
            for p in tree.feature_first[f]..tree.feature_first[f] + tree.feature_count[f] {
                let b = order[p as usize] as usize;
                let off = (toy.footprints.top[b] - tree.top[f]).abs();
                assert!(drawn.contains(&p) || off <= tree.error[t] + 1e-9);
                let (low, high) = (tree.height_min[f] - 1e-9, tree.height_max[f] + 1e-9);
                assert!((low..=high).contains(&toy.footprints.height(b)));
            }
        }
    }
    assert_eq!(large, exceeding);
    for level in &tree.levels {
        assert_eq!(level.lost, 0);
        assert!((0.0..=1.0).contains(&level.closed));
    }
    assert_eq!(tree.levels.last().unwrap().closed, 0.0);
    let ids: Vec<&str> = tree.ids.iter().collect();
    assert!(ids.iter().zip(&order).all(|(id, &b)| *id == toy.footprints.ids.get(b as usize)));
}

#[test]
fn trees_are_sound() {
    for (n, seed) in [(1, 0), (2, 1), (3, 2), (20, 3), (64, 4), (90, 5)] {
        for prefer in [Prefer::LeastError, Prefer::Fewest] {
            for max_triangles in [16, 100, 300, 20_000] {
                let toy = toy(n, seed);
                let tile = Tile { max_triangles, prefer, ..Tile::default() };
                let (tree, found) = tile_with(&toy, &tile, None);
                assert_sound(&toy, &tile, &tree, found.facts["exceeding"].as_u64().unwrap());
            }
        }
    }
}

#[test]
fn bounds_hold_and_what_exceeds_them_is_counted() {
    let toy = toy(64, 7);
    let (tree, found) = tile_with(&toy, &small(200), None);
    assert_eq!(found.facts["exceeding"], 0);
    assert!(tree.levels.len() > 3);
    for pair in tree.levels.windows(2) {
        // A level draws at most half of what the next one does, where tiles are not leaves already.
        assert!(pair[0].triangles <= pair[1].triangles);
    }
    // A bound below any building: one building a leaf, all of them counted.
    let (tree, found) = tile_with(&toy, &small(16), None);
    let large = (0..tree.len()).filter(|&t| tree.is_leaf[t] && tree.source_count[t] > 1);
    assert_eq!(large.count(), 0);
    assert!(found.facts["exceeding"].as_u64().unwrap() > 0);
    // Bytes bind as triangles do.
    let (tree, found) = tile_with(&toy, &Tile { max_bytes: 16_384, ..Tile::default() }, None);
    assert_eq!(found.facts["exceeding"], 0);
    assert!(tree.len() > 3);
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_in_any_order_of_rows() {
    let numbers: Vec<u64> = (0..60).collect();
    let tile = small(150);
    let (expected, _) = tile_with(&toy::city(&numbers, 9), &tile, None);
    for threads in [1, 2, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| tile_with(&toy::city(&numbers, 9), &tile, None).0);
        assert!(bytes(&found) == bytes(&expected));
    }
    let mut shuffled = numbers;
    shuffled.sort_by_key(|&b| toy::mix(b));
    let (found, _) = tile_with(&toy::city(&shuffled, 9), &tile, None);
    assert!(bytes(&found) == bytes(&expected));
}

/// What a tile's content says, in the tile's own numbers.
fn contents(tree: &TileTree) -> Vec<String> {
    let one = |t: usize| {
        let first = tree.source_first[t];
        let features = tree.features_of(t).map(|f| {
            let rings: Vec<_> =
                tree.plans.polygons_of(f).flat_map(|p| tree.plans.rings_of(p)).map(|r| tree.plans.ring(r)).collect();
            format!("{} {} {} {} {rings:?}", tree.feature_first[f] - first, tree.landmark[f], tree.top[f], tree.base[f])
        });
        features.collect::<Vec<_>>().join("\n")
    };
    (0..tree.len()).map(one).collect()
}

#[test]
fn a_higher_building_changes_only_the_tiles_above_it() {
    let numbers: Vec<u64> = (0..80).collect();
    let before = toy::city(&numbers, 11);
    let mut after = toy::city(&numbers, 11);
    let building = 37;
    after.footprints.top[building] += 4.0;
    let place = after.landmarks.order.iter().position(|&b| b as usize == building).unwrap();
    after.landmarks.height[place] += 4.0;
    after.landmarks.maxima = Landmarks::maxima_of(&after.landmarks.height);
    let areas: Vec<f64> = (0..80).map(|b| after.footprints.area_m2(b)).collect();
    let (order, first) = after.dendrogram.leaf_order();
    for c in 0..after.hulls.len() {
        let members = &order[first[c] as usize..(first[c] + after.hulls.buildings[c]) as usize];
        if members.contains(&(building as u32)) {
            let built: f64 = members.iter().map(|&b| areas[b as usize]).sum();
            after.hulls.height[c] += 4.0 * areas[building] / built;
        }
    }
    let (old, _) = tile_with(&before, &small(150), None);
    let (new, _) = tile_with(&after, &small(150), None);
    let (old_contents, new_contents) = (contents(&old), contents(&new));
    let changed = new_contents.iter().filter(|c| !old_contents.contains(c)).count();
    assert!(changed > 0 && changed <= 2 * new.levels.len(), "{changed} of {}", new.len());
}

#[test]
fn a_wish_to_stop_ends_it() {
    let toy = toy(300, 1);
    let city = city(&toy);
    let limits = |stop| Limits { triangles: 500, bytes: 1 << 20, prefer: Prefer::LeastError, stop };
    let street = Street::of(&toy.footprints);
    let stop = AtomicBool::new(true);
    let built = build::build(&city, &street, &limits(&stop), city.root());
    assert!(built.is_leaf && built.children.is_empty());
    assert!(!build::build(&city, &street, &limits(&NEVER), city.root()).is_leaf);
}

#[test]
fn what_cannot_be_tiled() {
    let (a, b) = (toy(5, 1), toy(4, 1));
    let bench = Bench::default();
    let input = In {
        footprints: a.footprints.into(),
        dendrogram: b.dendrogram.into(),
        hulls: a.hulls.into(),
        landmarks: a.landmarks.into(),
        buildings: None,
    };
    assert_eq!(Tile::default().run(&bench.ctx(), input).err().unwrap().code, "inputs-differ");
}
