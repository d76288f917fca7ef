mod replay;

use super::*;
use crate::artifact::Artifact;
use crate::geom::frame::Frame;
use crate::geom::lattice::Lattice;

fn grid(resolution: u32, black: impl Fn([f64; 3]) -> bool) -> Voxels {
    let cells = resolution + 3;
    let lattice = Lattice { cells, origin: [0.0; 3], cell: 1.0 };
    let mut out = Voxels::new(Frame::local(), lattice);
    let middle = f64::from(cells) / 2.0;
    let range = 2..lattice.side() - 2;
    for (x, y, z) in range.clone().flat_map(|x| {
        let range = range.clone();
        range.clone().flat_map(move |y| range.clone().map(move |z| (x, y, z)))
    }) {
        if black([x, y, z].map(|c| c as f64 - middle)) {
            out.set([x, y, z]);
        }
    }
    out
}

/// A turn by angles of 3-4-5 and 5-12-13 triangles.
fn turned([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (x, y) = (0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y);
    let (y, z) = ((12.0 * y - 5.0 * z) / 13.0, (5.0 * y + 12.0 * z) / 13.0);
    [x, y, z]
}

fn shapes(resolution: u32) -> Vec<Voxels> {
    let r = f64::from(resolution) / 2.0;
    vec![
        grid(resolution, |p| p.iter().map(|v| v * v).sum::<f64>() <= 0.8 * r * r),
        grid(resolution, |p| turned(p).iter().all(|v| v.abs() <= 0.55 * r)),
        grid(resolution, |p| p[0].abs() <= r && p[1].abs() <= 0.3 * r && p[2].abs() <= 0.7 * r),
        grid(resolution, |[x, y, z]| x + y + 2.0 * z <= 0.3 * r && x.abs().max(y.abs()).max(z.abs()) <= 0.9 * r),
        grid(resolution, |[x, y, z]| (x * 7.3 + y * 3.1 - z * 5.7).rem_euclid(4.0) < 2.2 && x * x + y * y < r * r),
    ]
}

/// Every tile is the best of all sampled planes, tile after tile, in both dictionaries.
#[test]
fn as_brute_force() {
    for (voxels, resolution) in [4, 7, 10].into_iter().flat_map(|m| shapes(m).into_iter().map(move |v| (v, m))) {
        let all = sticks::of(&voxels);
        let cells = voxels.lattice.cells;
        for dictionary in [dictionary::large(), dictionary::small()] {
            let gather = Gather::new(&voxels, dictionary);
            let voters: Vec<(Stick, u16)> = all.iter().filter_map(|s| Some((*s, gather.entry(s)?))).collect();
            let cones = Cones::new(&voters, dictionary, cells);
            let mut search = Search::new(&cones, cells, voters.len());
            let mut alive = vec![true; voters.len()];
            for _ in 0..if resolution == 4 { 12 } else { 3 } {
                let best = search.best(1, true);
                assert_eq!(best, brute_force(&cones, cells, &alive), "at {resolution}");
                let Some(best) = best else { break };
                let w = cones::sample(cells, best.cube, best.at);
                let voting: Vec<u32> =
                    (0..voters.len() as u32).filter(|&v| alive[v as usize] && cones.holds(v, &w)).collect();
                assert_eq!(voting.len() as u32, best.votes);
                voting.iter().for_each(|&v| alive[v as usize] = false);
                search.take(voting.into_iter());
            }
        }
    }
}

/// Sticks that a plane stabs: the black end inside, the white one not.
fn stabbed(tiles: &PlaneTiles, all: &[Stick]) -> usize {
    let cells = tiles.lattice.cells;
    let stabs = |w: [i64; 4], s: &Stick| {
        let black = s.black.map(i32::from);
        let step = STEPS[usize::from(s.direction)];
        let inside = |n| crate::geom::lattice::inside(cells, w, n);
        inside(black) && !inside([0, 1, 2].map(|k| black[k] + step[k]))
    };
    all.iter().filter(|s| tiles.planes.iter().any(|&w| stabs(w, s))).count()
}

#[test]
fn a_box_is_six_planes_at_any_turn() {
    for resolution in [32, 48, 64] {
        let r = f64::from(resolution) / 2.0;
        for turns in 0..6 {
            let turn = |mut p: [f64; 3]| {
                (0..turns).for_each(|_| p = turned([p[1], p[2], p[0]]));
                p
            };
            let voxels = grid(resolution, |p| {
                let [x, y, z] = turn(p);
                x.abs() <= 0.55 * r && y.abs() <= 0.6 * r && z.abs() <= 0.52 * r
            });
            let tiles = vote_tile(&voxels, &VoteTile::default(), || Ok(())).unwrap();
            assert_eq!(tiles.len(), 6, "turned {turns} times at {resolution}: {:?}", tiles.votes);
            let all = sticks::of(&voxels);
            let share = stabbed(&tiles, &all) as f64 / all.len() as f64;
            assert!(share >= 0.99, "turned {turns} times at {resolution}: {share}");
        }
    }
}

#[test]
fn every_stick_is_taken_once_or_counted() {
    let mut compared = 0;
    for voxels in shapes(24) {
        for how in [
            VoteTile::default(),
            VoteTile { stages: Stages::Flat, min_votes: 1, ..VoteTile::default() },
            VoteTile { polish: false, exact: false, max_tiles: Some(3), ..VoteTile::default() },
            VoteTile { polish: false, ..VoteTile::default() },
        ] {
            let tiles = vote_tile(&voxels, &how, || Ok(())).unwrap();
            let all = sticks::of(&voxels);
            let mut taken = tiles.sticks.clone();
            taken.sort_unstable();
            assert!(taken.windows(2).all(|t| t[0] < t[1]), "no stick twice");
            let left = tiles.left_over;
            let missing = left.below_min_votes + left.unsampled + left.not_a_pattern + left.membrane;
            assert_eq!(taken.len() + missing as usize, all.len());
            for i in 0..tiles.len() {
                let sticks = tiles.taken(i);
                let (votes, rest) = sticks.split_at(tiles.votes[i] as usize);
                assert!(votes.len() >= how.min_votes as usize && votes.is_sorted() && rest.is_sorted());
            }
            // Samples that are the best of what is left: votes never rise from tile to tile of a stage.
            if how.exact && !how.polish {
                let samples: Vec<usize> = (0..tiles.len()).filter(|&i| is_sample(&tiles, i)).collect();
                let falls =
                    |t: &[usize]| tiles.stages[t[0]] < tiles.stages[t[1]] || tiles.votes[t[0]] >= tiles.votes[t[1]];
                assert!(samples.windows(2).all(falls), "{:?}", tiles.votes);
                compared += samples.len();
            }
        }
    }
    assert!(compared > 20);
}

/// Not one of the planes of their own that sticks between the samples try.
fn is_sample(tiles: &PlaneTiles, i: usize) -> bool {
    let whole = 2 * i64::from(tiles.lattice.cells);
    let (fixed, free): (Vec<i64>, Vec<i64>) = tiles.planes[i].iter().partition(|v| v.abs() == whole);
    fixed.len() == 1 && free.iter().all(|v| v.abs() < whole && v % 2 != 0)
}

#[test]
fn the_same_on_any_number_of_threads() {
    let voxels = &shapes(40)[1];
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| vote_tile(voxels, &VoteTile::default(), || Ok(())).unwrap())
    };
    let one = with(1);
    assert!(one.len() >= 6);
    assert_eq!(one, with(2));
    assert_eq!(one, with(8));
}

/// All work on one thread: the switch is the thread's own.
#[test]
fn the_same_with_narrow_registers() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for voxels in &shapes(30) {
        let all = || vote_tile(voxels, &VoteTile { min_votes: 2, ..VoteTile::default() }, || Ok(())).unwrap();
        let narrow = pool.install(|| crate::geom::wide::narrow(all));
        assert!(!narrow.is_empty());
        assert_eq!(pool.install(all), narrow);
    }
}

#[test]
fn nothing_black_nothing_found() {
    let tiles = vote_tile(&grid(6, |_| false), &VoteTile::default(), || Ok(())).unwrap();
    assert!(tiles.is_empty() && tiles.given.sticks == 0);
    // A single node: six sticks, whose neighbourhoods no plane makes.
    let tiles = vote_tile(&grid(6, |p| p.iter().all(|v| v.abs() < 0.6)), &VoteTile::default(), || Ok(())).unwrap();
    assert_eq!(tiles.left_over.not_a_pattern + tiles.sticks.len() as u32, tiles.given.sticks);
}

/// The best sampled plane by counting them all: for the tests of small grids.
fn brute_force(cones: &Cones, cells: u32, alive: &[bool]) -> Option<search::Best> {
    let side = 2 * cells as u16;
    let mut best: Option<(u32, u8, [u16; 3], [u16; 3])> = None;
    for cube in 0..8u8 {
        for (z, y, x) in (0..side).flat_map(|z| (0..side).flat_map(move |y| (0..side).map(move |x| (z, y, x)))) {
            let w = cones::sample(cells, cube, [x, y, z]);
            let votes = (0..alive.len() as u32).filter(|&s| alive[s as usize] && cones.holds(s, &w)).count() as u32;
            let (block, inner) = ([z / 16, y / 16, x / 16], [z % 16, y % 16, x % 16]);
            let first = |b: &(u32, u8, [u16; 3], [u16; 3])| (b.1, b.2, b.3) <= (cube, block, inner);
            if best.is_none_or(|b| votes > b.0 || votes == b.0 && !first(&b)) {
                best = Some((votes, cube, block, inner));
            }
        }
    }
    let (votes, cube, block, inner) = best.filter(|b| b.0 > 0)?;
    Some(search::Best { votes, cube, at: [2, 1, 0].map(|k| 16 * block[k] + inner[k]) })
}
