//! What vote-tile says it did, done again by hand: nodes of the grid against planes, without cones, blocks or lists.

use std::collections::BTreeSet;

use super::*;
use crate::artifact::voxels::stick_of;
use crate::geom::lattice::{factors, inside};

/// A grid whose sticks in a part of the upper half lie over a hole.
fn with_a_hole(mut voxels: Voxels) -> Voxels {
    let n = i32::from(voxels.lattice.cells as u16);
    let over = |s: &Stick| {
        let [x, y, z] = s.doubled_middle().map(|c| c - n);
        4 * x.abs() < n && 3 * y.abs() < n && z > 0
    };
    voxels.membrane = sticks::of(&voxels).iter().filter(|s| over(s)).map(Stick::number).collect();
    voxels
}

fn grids(resolution: u32) -> Vec<Voxels> {
    let mut all = shapes(resolution);
    let holes: Vec<Voxels> = all.iter().take(3).map(|v| with_a_hole(v.clone())).collect();
    assert!(holes.iter().all(|v| v.membrane.len() > 5 && 2 * v.membrane.len() < sticks::of(v).len()));
    all.extend(holes);
    all
}

/// The nodes around a stick as factors of a plane's corner values, and whether each is black.
fn around(voxels: &Voxels, dictionary: &Dictionary, stick: &Stick) -> Vec<([i64; 4], bool)> {
    let one = |n: usize| {
        let node = stick.node(dictionary.node(n));
        let black = node.iter().all(|&c| c >= 0 && c < voxels.lattice.side() as i32)
            && voxels.is_black(node.map(|c| c as usize));
        (factors(voxels.lattice.cells, node).map(i64::from), black)
    };
    (0..dictionary.nodes()).map(one).collect()
}

/// Whether the plane makes them all.
fn makes(w: &[i64; 4], around: &[([i64; 4], bool)]) -> bool {
    around.iter().all(|(a, black)| ((0..4).map(|k| a[k] * w[k]).sum::<i64>() >= 0) == *black)
}

/// Twice the field in the stick's middle times 2N: in its two ends, added.
fn doubled(cells: u32, w: &[i64; 4], stick: &Stick) -> i64 {
    let ends = [[0, 0, 0], [0, 0, 1]].map(|n| factors(cells, stick.node(n)));
    (0..4).map(|k| w[k] * i64::from(ends[0][k] + ends[1][k])).sum()
}

/// Whether the stick's middle lies within `halves` half cells of the plane, exactly, and it looks the plane's way.
fn in_reach(cells: u32, w: &[i64; 4], stick: &Stick, halves: i128) -> bool {
    let at = |n| factors(cells, n).iter().zip(w).map(|(&a, w)| i64::from(a) * w).sum::<i64>();
    let gradient = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|n| i128::from(at(n) - at([0; 3])));
    let far = i128::from(doubled(cells, w, stick));
    let along = at(stick.node([0, 0, 1])) - at(stick.node([0, 0, 0]));
    along < 0 && far * far <= halves * halves * gradient.iter().map(|g| g * g).sum::<i128>()
}

fn stick(number: u64) -> Stick {
    let (black, direction) = stick_of(number);
    Stick { black, direction }
}

/// A tile takes what voted, then all that is free within its reach and looks its way; nothing else.
#[test]
fn taken_by_distance() {
    let mut by_distance = 0;
    for voxels in grids(24) {
        for (halves, polish) in [(2, true), (1, true), (3, true), (2, false)] {
            let how = VoteTile { reach_cells: f64::from(halves) / 2.0, polish, ..VoteTile::default() };
            let tiles = vote_tile(&voxels, &how, || Ok(())).unwrap();
            let mut free: BTreeSet<u64> = sticks::of(&voxels).iter().map(Stick::number).collect();
            for (i, w) in tiles.planes.iter().enumerate() {
                let (votes, rest) = tiles.taken(i).split_at(tiles.votes[i] as usize);
                for v in votes {
                    assert!(free.remove(v) && voxels.membrane.binary_search(v).is_err());
                    let [black, white] = [[0, 0, 0], [0, 0, 1]].map(|n| stick(*v).node(n));
                    let cells = voxels.lattice.cells;
                    assert!(inside(cells, *w, black) && !inside(cells, *w, white), "who votes is stabbed");
                }
                let near = |&v: &u64| in_reach(voxels.lattice.cells, w, &stick(v), i128::from(halves));
                let near: Vec<u64> = free.iter().copied().filter(near).collect();
                assert_eq!(rest, near, "tile {i}, {halves} half cells");
                near.iter().for_each(|v| _ = free.remove(v));
                by_distance += near.len();
            }
        }
    }
    assert!(by_distance > 1000);
}

/// Votes of all sampled planes, in the order in which the first of equal ones wins.
struct Samples {
    planes: Vec<[i64; 4]>,
    votes: Vec<u32>,
}

impl Samples {
    fn new(cells: u32) -> Self {
        let side = 2 * cells as u16;
        let mut order: Vec<(u8, [u16; 3], [u16; 3])> = Vec::new();
        for cube in 0..8 {
            for at in (0..side).flat_map(|z| (0..side).flat_map(move |y| (0..side).map(move |x| [z, y, x]))) {
                order.push((cube, at.map(|v| v / 16), at.map(|v| v % 16)));
            }
        }
        order.sort_unstable();
        let plane = |(cube, block, inner): (u8, [u16; 3], [u16; 3])| {
            cones::sample(cells, cube, [2, 1, 0].map(|k| 16 * block[k] + inner[k]))
        };
        Self { votes: vec![0; order.len()], planes: order.into_iter().map(plane).collect() }
    }

    fn add(&mut self, around: &[([i64; 4], bool)], by: u32) {
        let Self { planes, votes } = self;
        let all = votes.par_iter_mut().zip(planes.par_iter());
        all.filter(|(_, w)| makes(w, around)).for_each(|(v, _)| *v = v.wrapping_add(by));
    }

    /// The first of those with the most votes.
    fn best(&self) -> (u32, [i64; 4]) {
        let most = self.votes.iter().copied().max().unwrap();
        (most, self.planes[self.votes.iter().position(|&v| v == most).unwrap()])
    }
}

/// Tile after tile, with removal by distance, in both stages and to exhaustion: the first of the best sampled planes.
#[test]
fn each_tile_is_the_best_that_was_left() {
    // Of whole grids and of those with holes, the most tiles of one.
    let mut most_compared = [0; 2];
    for (number, voxels, halves) in grids(10).into_iter().enumerate().flat_map(|(i, v)| [(i, v.clone(), 2), (i, v, 1)])
    {
        let reach_cells = halves as f64 / 2.0;
        let how = VoteTile { min_votes: 1, polish: false, reach_cells, ..VoteTile::default() };
        let tiles = vote_tile(&voxels, &how, || Ok(())).unwrap();
        let mut free = sticks::of(&voxels);
        let (mut next, mut compared) = (0, 0);
        for (stage, dictionary) in [(0, dictionary::large()), (1, dictionary::small())] {
            let votes = |s: &Stick| voxels.membrane.binary_search(&s.number()).is_err();
            let known = |around: &[([i64; 4], bool)]| {
                let bit = |m, (n, (_, black)): (usize, &([i64; 4], bool))| m | u128::from(*black) << n;
                dictionary.find(around.iter().enumerate().fold(0u128, bit)).is_some()
            };
            let mut samples = Samples::new(voxels.lattice.cells);
            let mut voters: Vec<(u64, Vec<([i64; 4], bool)>)> =
                free.iter().filter(|s| votes(s)).map(|s| (s.number(), around(&voxels, dictionary, s))).collect();
            voters.retain(|(_, around)| known(around));
            voters.iter().for_each(|(_, around)| samples.add(around, 1));
            while next < tiles.len() && tiles.stages[next] == stage {
                let (w, taken) = (tiles.planes[next], tiles.taken(next));
                let voted = &taken[..tiles.votes[next] as usize];
                let (most, best) = samples.best();
                // Once no sample has a vote come the planes of sticks whose cones lie between the samples.
                if most > 0 {
                    assert_eq!((voted.len() as u32, w), (most, best), "grid {number}, tile {next}");
                    compared += 1;
                }
                let made: Vec<u64> = voters.iter().filter(|(_, a)| makes(&w, a)).map(|v| v.0).collect();
                assert_eq!(voted, made, "grid {number}, tile {next}");
                let gone = |s: &Stick| made.contains(&s.number()) || in_reach(voxels.lattice.cells, &w, s, halves);
                let gone: BTreeSet<u64> = free.iter().filter(|s| gone(s)).map(Stick::number).collect();
                assert_eq!(gone, taken.iter().copied().collect(), "grid {number}, tile {next}");
                free.retain(|s| !gone.contains(&s.number()));
                voters.iter().filter(|v| gone.contains(&v.0)).for_each(|v| samples.add(&v.1, u32::MAX));
                voters.retain(|v| !gone.contains(&v.0));
                next += 1;
            }
            assert_eq!(samples.best().0, 0, "grid {number}, stage {stage}: a plane with votes is left");
        }
        assert_eq!(next, tiles.len());
        let most = &mut most_compared[usize::from(!voxels.membrane.is_empty())];
        *most = compared.max(*most);
    }
    assert!(most_compared.iter().all(|&m| m >= 12), "{most_compared:?}");
}

/// From each sample to a plane with at least its votes, counted by the nodes.
#[test]
fn polish_never_loses_a_vote() {
    let (mut before, mut after) = (0, 0);
    for voxels in shapes(14).into_iter().chain([shapes(26).swap_remove(1)]) {
        let cells = voxels.lattice.cells;
        for dictionary in [dictionary::large(), dictionary::small()] {
            let gather = Gather::new(&voxels, dictionary);
            let all = sticks::of(&voxels);
            let voters: Vec<(Stick, u16)> = all.iter().filter_map(|s| Some((*s, gather.entry(s)?))).collect();
            let nodes: Vec<_> = voters.iter().map(|(s, _)| around(&voxels, dictionary, s)).collect();
            let cones = Cones::new(&voters, dictionary, cells);
            let mut search = Search::new(&cones, cells, voters.len());
            let mut left = Voters::new(&cones, &voters, cells);
            while let Some(best) = search.best(2, true) {
                let sampled = cones::sample(cells, best.cube, best.at);
                let polished = polish(&left, &best);
                let votes = |w: &[i64; 4], s: &Search| -> Vec<u32> {
                    (0..voters.len() as u32).filter(|&v| s.is_alive(v) && makes(w, &nodes[v as usize])).collect()
                };
                let (first, last) = (votes(&sampled, &search), votes(&polished, &search));
                assert_eq!(first.len() as u32, best.votes);
                assert!(
                    last.len() >= first.len(),
                    "{} votes became {}: {sampled:?} {polished:?}",
                    first.len(),
                    last.len()
                );
                assert_eq!(left.voting(&polished), last);
                (before, after) = (before + first.len(), after + last.len());
                search.take(last.into_iter());
                left.retain(|v| search.is_alive(v));
            }
        }
    }
    assert!(10 * after > 11 * before, "{before} votes became {after}: nothing was polished");
}

#[test]
fn the_first_tiles_only() {
    for voxels in grids(24) {
        let with = |max_tiles| vote_tile(&voxels, &VoteTile { max_tiles, ..VoteTile::default() }, || Ok(())).unwrap();
        let all = with(None);
        for most in [1, 3, all.len() as u32, 1000] {
            let some = with(Some(most));
            let n = some.len();
            assert_eq!(n, all.len().min(most as usize));
            assert_eq!(
                (&some.planes[..], &some.votes[..], &some.starts[..]),
                (&all.planes[..n], &all.votes[..n], &all.starts[..=n])
            );
            assert_eq!(some.sticks, all.sticks[..some.sticks.len()]);
        }
    }
}

/// It stops with the tile that brings enough, and not before.
#[test]
fn half_of_the_sticks() {
    // The fifth has no flat part of any size.
    for voxels in grids(24).into_iter().enumerate().filter(|g| g.0 != 4).map(|g| g.1) {
        let with = |coverage| vote_tile(&voxels, &VoteTile { coverage, ..VoteTile::default() }, || Ok(())).unwrap();
        let (all, some) = (with(1.0), with(0.5));
        let n = some.len();
        assert!(n < all.len() && some.planes == all.planes[..n]);
        let counted = |sticks: &[u64]| sticks.iter().filter(|s| voxels.membrane.binary_search(s).is_err()).count();
        let total = (some.given.sticks - some.given.membrane) as usize;
        assert_eq!(total + voxels.membrane.len(), sticks::of(&voxels).len());
        assert!(2 * counted(&some.sticks) >= total);
        assert!(2 * counted(&some.sticks[..some.starts[n - 1] as usize]) < total);
    }
}

#[test]
fn a_search_without_proof_says_so() {
    for voxels in grids(16) {
        for exact in [false, true] {
            let tiles = vote_tile(&voxels, &VoteTile { exact, ..VoteTile::default() }, || Ok(())).unwrap();
            assert_eq!(tiles.given.exact, exact);
            assert_eq!(tiles.summary()["exact"], exact);
        }
    }
}
