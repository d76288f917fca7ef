//! The planes that stand best for the surface of a voxel grid, one after the other.
//!
//! In:     black and white nodes of a grid. A *stick* is a grid edge with one black and one white end; a plane *stabs*
//!         it when the black end is inside and the white one is not.
//! Out:    planes in the order found. A stick votes for a plane that makes its whole neighbourhood of nodes: first,
//!         for the *flat* sticks, 5 x 5 x 4 nodes, to the end; then, for the others, 3 x 3 x 2. Each plane starts from
//!         the one with the most votes among 8 (2N)^3 sampled planes (exactly: proven by bounds), is moved to where
//!         still more votes are (`polish`), and takes all sticks within `reach-cells` that look its way, voting or not.
//!         Sticks whose cone holds no sample try a plane of their own. What is left is counted by cause.
//! Errors: no black node, and none at all: no tiles, no error. Cost: about 0.5 us for each pair of cone and block of
//!         samples, 10 to 25 times more for twice the resolution; memory 8 KiB for each of 6,144 blocks and 4 bytes a pair.
//! Source: Andújar, Brunet, Chica, Navazo, Rossignac, Vinacua: Computing maximal tiles and application to
//!         impostor-based simplification, sections 3 to 5 and appendix. The source removes by a rule of its section 5,
//!         searches in three phases and stops at the sample; blocks in a heap with drawn counters, and polish, are ours.
//! Tried:  an octree with lists of cones: the same planes, 170 times slower; removing only the sticks that voted: 7 times
//!         as many tiles.

mod climb;
pub mod cones;
pub mod dictionary;
mod polish;
mod raster;
mod search;
pub mod sticks;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::artifact::plane_tiles::{Given, LeftOver};
use crate::artifact::voxels::STEPS;
use crate::artifact::{PlaneTiles, Voxels};
use crate::diag::Result;
use crate::geom::lattice::Field;
use crate::op::{Ctx, Op};
use cones::Cones;
use dictionary::Dictionary;
use polish::{Voters, polish};
use search::Search;
use sticks::{Gather, Stick};

/// Which sticks may vote.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Stages {
    /// Flat sticks, then those of the small dictionary.
    Both,
    /// Flat sticks only.
    Flat,
}

crate::params! {
    /// The planes with the most votes of a grid's sticks.
    pub struct VoteTile {
        /// Votes that a plane needs.
        #[schemars(range(min = 1))]
        pub min_votes: u32 = 8,
        /// Stops when this share of all sticks (those over holes apart) is taken.
        #[schemars(range(min = 0.0, max = 1.0))]
        pub coverage: f64 = 1.0,
        /// Stops after this many tiles.
        #[schemars(range(min = 1))]
        pub max_tiles: Option<u32> = None,
        /// Which sticks may vote.
        pub stages: Stages = Stages::Both,
        /// Whether each sampled plane must be proven to be the best; else the first good one is taken.
        pub exact: bool = true,
        /// Whether planes are moved from the sample to where more votes are.
        pub polish: bool = true,
        /// Distance of a stick's middle from a plane that takes it.
        #[schemars(range(min = 0.5, max = 4.0), extend("x-unit" = "cells"))]
        pub reach_cells: f64 = 1.0,
    }
}

crate::inputs! {
    /// The grid.
    voxels: Voxels,
}

impl Op for VoteTile {
    const NAME: &'static str = "vote-tile";
    const VERSION: u32 = 2;
    type In = In;
    type Out = PlaneTiles;

    fn run(&self, ctx: &Ctx, input: In) -> Result<PlaneTiles> {
        vote_tile(&input.voxels, self, || ctx.check())
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (4 << 20) + 50 * input_bytes
    }
}

/// All tiles; `check` is asked between them.
pub fn vote_tile(voxels: &Voxels, how: &VoteTile, check: impl Fn() -> Result<()>) -> Result<PlaneTiles> {
    let sticks = sticks::of(voxels);
    let mut hunt = Hunt::new(voxels, how, &sticks);
    let (large, small) = (dictionary::large(), dictionary::small());
    let flat = hunt.entries(voxels, large, |_| true);
    hunt.out.given.flat = flat.iter().flatten().count() as u32;
    hunt.stage(0, large, &flat, &check)?;
    // Flat sticks that are left over vote again with the others.
    let rest = hunt.entries(voxels, small, |i| how.stages == Stages::Both && hunt.is_free(i));
    let only = hunt.entries(voxels, small, |i| flat[i].is_none());
    hunt.out.given.small = only.iter().flatten().count() as u32;
    hunt.unsampled.fill(false);
    if how.stages == Stages::Both {
        hunt.stage(1, small, &rest, &check)?;
    }
    let pattern = |i: usize| flat[i].is_some() || how.stages == Stages::Both && only[i].is_some();
    Ok(hunt.finish(pattern))
}

/// What is taken already, and by which tiles.
struct Hunt<'a> {
    how: &'a VoteTile,
    sticks: &'a [Stick],
    membrane: Vec<bool>,
    taken: Vec<bool>,
    /// Left over because no sample is in the cone.
    unsampled: Vec<bool>,
    /// Sticks not yet taken, by direction.
    free: [Vec<u32>; 6],
    /// Of those not over holes.
    counted: u32,
    out: PlaneTiles,
}

impl<'a> Hunt<'a> {
    fn new(voxels: &Voxels, how: &'a VoteTile, sticks: &'a [Stick]) -> Self {
        let membrane: Vec<bool> =
            sticks.par_iter().map(|s| voxels.membrane.binary_search(&s.number()).is_ok()).collect();
        let mut free: [Vec<u32>; 6] = Default::default();
        for (i, s) in sticks.iter().enumerate() {
            free[usize::from(s.direction)].push(i as u32);
        }
        let over = membrane.iter().filter(|&&m| m).count() as u32;
        let given = Given {
            sticks: sticks.len() as u32,
            membrane: over,
            exact: how.exact,
            reach_cells: how.reach_cells,
            ..Given::default()
        };
        let out = PlaneTiles {
            frame: voxels.frame.clone(),
            lattice: voxels.lattice,
            planes: Vec::new(),
            votes: Vec::new(),
            stages: Vec::new(),
            starts: vec![0],
            sticks: Vec::new(),
            given,
            left_over: LeftOver::default(),
        };
        let n = sticks.len();
        Self { how, sticks, membrane, taken: vec![false; n], unsampled: vec![false; n], free, counted: 0, out }
    }

    fn is_free(&self, i: usize) -> bool {
        !self.taken[i]
    }

    /// Dictionary entries of the sticks that may vote.
    fn entries(&self, voxels: &Voxels, of: &Dictionary, may: impl Fn(usize) -> bool + Sync) -> Vec<Option<u16>> {
        let gather = Gather::new(voxels, of);
        let entry = |(i, s): (usize, &Stick)| if self.membrane[i] || !may(i) { None } else { gather.entry(s) };
        self.sticks.par_iter().enumerate().map(entry).collect()
    }

    /// Whether enough is done.
    fn is_over(&self) -> bool {
        let all = self.out.given.sticks - self.out.given.membrane;
        let covered = f64::from(self.counted) >= self.how.coverage * f64::from(all) && self.how.coverage < 1.0;
        covered || self.how.max_tiles.is_some_and(|m| self.out.len() >= m as usize)
    }

    /// One dictionary's sticks, until no plane has enough votes.
    fn stage(
        &mut self,
        stage: u8,
        dictionary: &Dictionary,
        entries: &[Option<u16>],
        check: &impl Fn() -> Result<()>,
    ) -> Result<()> {
        let cells = self.out.lattice.cells;
        // Voters by number, and back.
        let voters: Vec<u32> = (0..entries.len() as u32).filter(|&i| entries[i as usize].is_some()).collect();
        let with_entry: Vec<(Stick, u16)> =
            voters.iter().filter_map(|&i| Some((self.sticks[i as usize], entries[i as usize]?))).collect();
        let mut voter = vec![u32::MAX; entries.len()];
        voters.iter().enumerate().for_each(|(v, &i)| voter[i as usize] = v as u32);
        let cones = Cones::new(&with_entry, dictionary, cells);
        let mut search = Search::new(&cones, cells, voters.len());
        let mut left = Voters::new(&cones, &with_entry, cells);
        let accept = |hunt: &mut Self, search: &mut Search, left: &mut Voters, w: [i64; 4]| {
            let taken = hunt.take(stage, w, left.voting(&w).into_iter().map(|v| voters[v as usize]).collect());
            search.take(taken.into_iter().map(|i| voter[i as usize]).filter(|&v| v != u32::MAX));
            left.retain(|v| search.is_alive(v));
        };
        while !self.is_over() {
            check()?;
            let Some(best) = search.best(self.how.min_votes, self.how.exact) else { break };
            let w = if self.how.polish { polish(&left, &best) } else { cones::sample(cells, best.cube, best.at) };
            accept(self, &mut search, &mut left, w);
        }
        // Cones between the samples: a plane of their own.
        let mut own: Vec<Vec<cones::Reach>> = vec![Vec::new(); voters.len()];
        cones.reaches.iter().filter(|r| search.is_alive(r.stick)).for_each(|r| own[r.stick as usize].push(*r));
        let between = (0..voters.len() as u32).into_par_iter().filter(|&v| search.is_alive(v));
        let between: Vec<u32> = between.filter(|&v| !search.is_sampled(&own[v as usize])).collect();
        while !self.is_over() {
            check()?;
            let open: Vec<u32> = between.iter().copied().filter(|&v| search.is_alive(v)).collect();
            let all: Vec<(usize, std::cmp::Reverse<u32>)> = open
                .par_iter()
                .map(|&v| (left.voting(&cones.middles[v as usize]).len(), std::cmp::Reverse(v)))
                .collect();
            let Some(&(most, std::cmp::Reverse(v))) = all.iter().max() else { break };
            if most < self.how.min_votes as usize {
                break;
            }
            accept(self, &mut search, &mut left, cones.middles[v as usize]);
        }
        for v in between {
            self.unsampled[voters[v as usize] as usize] = search.is_alive(v);
        }
        Ok(())
    }

    /// Makes a tile of a plane: it takes the sticks that voted, then those near it that look its way.
    fn take(&mut self, stage: u8, w: [i64; 4], voting: Vec<u32>) -> Vec<u32> {
        let field = Field::new(self.out.lattice.cells, w);
        let reach = 2.0 * self.how.reach_cells * field.slope();
        let votes = voting.len();
        let mut all = voting;
        all.iter().for_each(|&i| self.taken[i as usize] = true);
        let first = all.len();
        for (direction, free) in self.free.iter_mut().enumerate() {
            let along: i64 = (0..3).map(|k| field.gradient[k] * i64::from(STEPS[direction][k])).sum();
            if along >= 0 {
                continue;
            }
            let (taken, sticks) = (&mut self.taken, self.sticks);
            free.retain(|&i| {
                if taken[i as usize] {
                    return false;
                }
                let near = (field.doubled(sticks[i as usize].doubled_middle()) as f64).abs() <= reach;
                if near {
                    taken[i as usize] = true;
                    all.push(i);
                }
                !near
            });
        }
        all[first..].sort_unstable();
        self.counted += all.iter().filter(|&&i| !self.membrane[i as usize]).count() as u32;
        self.out.planes.push(w);
        self.out.votes.push(votes as u32);
        self.out.stages.push(stage);
        self.out.sticks.extend(all.iter().map(|&i| self.sticks[i as usize].number()));
        self.out.starts.push(self.out.sticks.len() as u32);
        all
    }

    fn finish(mut self, is_pattern: impl Fn(usize) -> bool) -> PlaneTiles {
        let left = &mut self.out.left_over;
        for i in (0..self.sticks.len()).filter(|&i| !self.taken[i]) {
            *(if self.membrane[i] {
                &mut left.membrane
            } else if !is_pattern(i) {
                &mut left.not_a_pattern
            } else if self.unsampled[i] {
                &mut left.unsampled
            } else {
                &mut left.below_min_votes
            }) += 1;
        }
        self.out
    }
}

#[cfg(test)]
mod tests;
