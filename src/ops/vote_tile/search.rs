//! The sampled plane with the most votes, again and again, proven.
//!
//! The cubes of samples are cut into blocks of 16^3. A block's list holds the cones that may reach it; the length of
//! the list bounds its best sample. Blocks wait in a heap by bound. The first one is drawn, which makes its bound its
//! exact maximum, and put back; when the first one is drawn and up to date, it holds the answer: no other block can do
//! better. Sticks that a tile took are subtracted from a block only when it comes first again.
//! Ties: most votes, then cube, block (first axis fastest), sample in the block (the same).

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use rayon::prelude::*;

use super::cones::{Cones, Reach, sample};
use super::raster::{Counters, Meets, Origin, Rough, SIDE, Span, draw, first_place, largest, rough};

/// Blocks that are worked on at once. Fixed: the order of work is the same for any number of threads.
const BATCH: usize = 32;
/// Blocks whose counters are kept: 8 KiB each.
const KEPT: usize = 6144;

/// A sampled plane and its votes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Best {
    pub votes: u32,
    pub cube: u8,
    pub at: [u16; 3],
}

/// Votes of all sampled planes for the sticks that are still alive.
pub struct Search<'a> {
    cones: &'a Cones,
    cells: u32,
    /// Blocks along an axis.
    across: u32,
    blocks: Vec<Block>,
    /// Reaches by block, as the blocks' ranges say; the lowest bit: all of the block's part is inside.
    lists: Vec<u32>,
    /// (bound, block, up to date at this epoch), the largest bound and then the first block on top.
    heap: BinaryHeap<(u32, Reverse<u32>, u32)>,
    /// When each stick was taken; `ALIVE` else.
    died: Vec<u32>,
    epoch: u32,
    drawn: VecDeque<u32>,
}

const ALIVE: u32 = u32::MAX;
/// A block that was never drawn.
const NEVER: u32 = u32::MAX;

#[derive(Default)]
struct Block {
    /// Cube, then block of the cube, first axis fastest.
    number: u32,
    first: u32,
    count: u32,
    /// The list once it was touched.
    list: Option<Vec<u32>>,
    /// What its best sample can have at most; the place of that sample where it is drawn.
    bound: u32,
    sample: u16,
    level: Level,
    rough: Option<Box<Rough>>,
    counters: Option<Box<Counters>>,
}

/// What a block's bound comes from.
#[derive(Clone, Copy, Default, PartialEq)]
enum Level {
    /// The length of its list.
    #[default]
    Listed,
    /// Parts of 4^3 samples.
    Rough,
    /// Its counters, though they may be thrown away.
    Drawn,
}

impl<'a> Search<'a> {
    pub fn new(cones: &'a Cones, cells: u32, sticks: usize) -> Self {
        let across = (2 * cells).div_ceil(SIDE as u32);
        let mut out = Self {
            cones,
            cells,
            across,
            blocks: Vec::new(),
            lists: Vec::new(),
            heap: BinaryHeap::new(),
            died: vec![ALIVE; sticks],
            epoch: 0,
            drawn: VecDeque::new(),
        };
        // (1) which reach may hold a sample of which block
        let pairs: Vec<Vec<(u32, u32)>> = cones
            .reaches
            .par_chunks(2048)
            .enumerate()
            .map(|(part, reaches)| {
                let mut pairs = Vec::new();
                for (i, reach) in reaches.iter().enumerate() {
                    out.meet(reach, (2048 * part + i) as u32, &mut pairs);
                }
                pairs
            })
            .collect();
        // (2) sorted by block, in the order of the reaches
        let mut starts = vec![0u32; 8 * (across * across * across) as usize + 1];
        pairs.iter().flatten().for_each(|&(block, _)| starts[block as usize + 1] += 1);
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        out.lists = vec![0; starts[starts.len() - 1] as usize];
        let mut next = starts.clone();
        for (block, entry) in pairs.into_iter().flatten() {
            out.lists[next[block as usize] as usize] = entry;
            next[block as usize] += 1;
        }
        for (number, range) in starts.windows(2).enumerate().filter(|(_, r)| r[0] < r[1]) {
            let (first, count) = (range[0], range[1] - range[0]);
            out.heap.push((count, Reverse(out.blocks.len() as u32), NEVER));
            out.blocks.push(Block { number: number as u32, first, count, bound: count, ..Block::default() });
        }
        out
    }

    /// Cube and place of a block.
    fn place(&self, number: u32) -> (u8, [u16; 3]) {
        let n = self.across;
        let at = [number % n, number / n % n, number / (n * n) % n].map(|v| v as u16);
        ((number / (n * n * n)) as u8, at)
    }

    /// The blocks that a reach may hold a sample of.
    fn meet(&self, reach: &Reach, number: u32, pairs: &mut Vec<(u32, u32)>) {
        let facets = self.cones.facets(reach.stick);
        let side = SIDE as u16;
        let (low, high) = (reach.low.map(|v| v / side), reach.high.map(|v| v / side));
        let single = low == high;
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let at = [x, y, z];
                    let block = [0, 1, 2].map(|k| u32::from(at[k]));
                    let block = ((u32::from(reach.cube) * self.across + block[2]) * self.across + block[1])
                        * self.across
                        + block[0];
                    if single && facets.len() > 2 {
                        pairs.push((block, 2 * number));
                        continue;
                    }
                    let origin = self.origin(reach.cube, at);
                    let span = span(reach, at);
                    let mut full = true;
                    let mut none = false;
                    for f in facets {
                        match f.meets(&origin, &span) {
                            Meets::Nowhere => none = true,
                            Meets::Somewhere(_) => full = false,
                            Meets::Everywhere => {}
                        }
                        if none {
                            break;
                        }
                    }
                    // Full means the whole block, not only a part of it.
                    full = full && span == [[0, SIDE as i32 - 1]; 3];
                    if !none {
                        pairs.push((block, 2 * number + u32::from(full)));
                    }
                }
            }
        }
    }

    fn origin(&self, cube: u8, at: [u16; 3]) -> Origin {
        Origin { w: sample(self.cells, cube, at.map(|v| v * SIDE as u16)), fixed: usize::from(cube / 2) }
    }

    /// The best sample, if it has at least `least` votes. With `proven` false: the best of the blocks that looked best.
    pub fn best(&mut self, least: u32, proven: bool) -> Option<Best> {
        loop {
            let mut batch = Vec::with_capacity(BATCH);
            let mut fresh = None;
            while let Some(&(bound, Reverse(block), epoch)) = self.heap.peek() {
                if bound < least {
                    // Bounds only fall: nothing below counts ever again.
                    if batch.is_empty() {
                        self.heap.clear();
                    }
                    break;
                }
                if epoch == self.epoch {
                    fresh = Some(block);
                    break;
                }
                self.heap.pop();
                batch.push(block);
                if batch.len() == BATCH {
                    break;
                }
            }
            if batch.is_empty() || !proven && fresh.is_some() {
                batch.into_iter().for_each(|b| self.heap.push((self.blocks[b as usize].bound, Reverse(b), NEVER)));
                let block = &self.blocks[fresh? as usize];
                let (cube, at) = self.place(block.number);
                let (votes, sample) = (block.bound, block.sample);
                let inner = [sample % 16, sample / 16 % 16, sample / 256];
                return Some(Best { votes, cube, at: [0, 1, 2].map(|k| at[k] * SIDE as u16 + inner[k]) });
            }
            let mut taken: Vec<Block> = batch.iter().map(|&b| std::mem::take(&mut self.blocks[b as usize])).collect();
            let this = &*self;
            let kept: Vec<bool> = taken.iter().map(|b| b.counters.is_some()).collect();
            taken.par_iter_mut().for_each(|block| this.refresh(block));
            for ((b, block), kept) in batch.into_iter().zip(taken).zip(kept) {
                if block.bound >= least {
                    let epoch = if block.level == Level::Drawn { self.epoch } else { NEVER };
                    self.heap.push((block.bound, Reverse(b), epoch));
                    if !kept && block.counters.is_some() {
                        self.drawn.push_back(b);
                    }
                    self.blocks[b as usize] = block;
                }
            }
            // The oldest counters go; their blocks are drawn again if they come first.
            while self.drawn.len() > KEPT {
                let b = self.drawn.pop_front().expect("more than kept");
                self.blocks[b as usize].counters = None;
            }
        }
    }

    /// Brings a block up to date: its list without the dead, then a rough count, then, if that leaves its bound where it
    /// was, its counters.
    fn refresh(&self, block: &mut Block) {
        let here = Here::new(self, block.number);
        let own = block.first as usize..(block.first + block.count) as usize;
        let mut list = block.list.take().unwrap_or_else(|| self.lists[own].to_vec());
        let alive = |entry: u32| self.died[self.cones.reaches[entry as usize / 2].stick as usize] == ALIVE;
        if let Some(counters) = &mut block.counters {
            list.retain(|&entry| {
                let alive = alive(entry);
                if !alive {
                    here.draw(counters, entry, u16::MAX);
                }
                alive
            });
        } else {
            // Cones that miss the block leave the list for good.
            if let Some(counters) = &mut block.rough {
                list.retain(|&entry| {
                    let alive = alive(entry);
                    if !alive {
                        here.rough(counters, entry, u32::MAX);
                    }
                    alive
                });
            } else {
                let counters = block.rough.insert(Box::new([0; 64]));
                list.retain(|&entry| alive(entry) && here.rough(counters, entry, 1));
            }
            let most = block.rough.iter().flat_map(|r| r.iter()).fold(0, |m, &c| m.max(c));
            let bound = most + full(&list);
            if bound < block.bound {
                (block.bound, block.level, block.list) = (bound, Level::Rough, Some(list));
                return;
            }
            block.rough = None;
            if list.len() > usize::from(u16::MAX) {
                return here.refresh_many(block, list);
            }
            let zeros = vec![0; SIDE * SIDE * SIDE].into_boxed_slice();
            let counters = block.counters.insert(zeros.try_into().expect("4,096 counters"));
            list.retain(|&entry| here.draw(counters, entry, 1));
        }
        let (most, sample) = block.counters.as_ref().map_or((0, 0), |c| largest(c));
        (block.bound, block.sample, block.level) = (u32::from(most) + full(&list), sample, Level::Drawn);
        block.list = Some(list);
    }

    /// The sticks are gone from now on.
    pub fn take(&mut self, sticks: impl Iterator<Item = u32>) {
        self.epoch += 1;
        sticks.for_each(|s| self.died[s as usize] = self.died[s as usize].min(self.epoch));
    }
    pub fn is_alive(&self, stick: u32) -> bool {
        self.died[stick as usize] == ALIVE
    }

    /// Whether any sampled plane is in the stick's cone.
    pub fn is_sampled(&self, reaches: &[Reach]) -> bool {
        reaches.iter().any(|reach| {
            let mut pairs = Vec::new();
            self.meet(reach, 0, &mut pairs);
            pairs.iter().any(|&(block, entry)| {
                entry % 2 == 1 || Here::new(self, block).draw_reach(&mut [0; SIDE * SIDE * SIDE], reach, 1)
            })
        })
    }
}

/// Cones whose part of the block is all of it.
fn full(list: &[u32]) -> u32 {
    list.iter().map(|entry| entry % 2).sum()
}

/// A block as the cones see it. What is asked of a cone that holds all of it does nothing and is true.
struct Here<'a> {
    cones: &'a Cones,
    at: [u16; 3],
    origin: Origin,
}

impl<'a> Here<'a> {
    fn new(search: &Search<'a>, number: u32) -> Self {
        let (cube, at) = search.place(number);
        Self { cones: search.cones, at, origin: search.origin(cube, at) }
    }

    /// Adds `by` to the samples of a cone; false where there is none.
    fn draw(&self, counters: &mut Counters, entry: u32, by: u16) -> bool {
        if entry % 2 == 1 {
            return true;
        }
        self.draw_reach(counters, &self.cones.reaches[entry as usize / 2], by)
    }

    fn draw_reach(&self, counters: &mut Counters, reach: &Reach, by: u16) -> bool {
        let span = span(reach, self.at);
        let mut planes = [[0.0; 4]; 16];
        let mut count = 0;
        for f in self.cones.facets(reach.stick) {
            match f.meets(&self.origin, &span) {
                Meets::Nowhere => return false,
                Meets::Everywhere => {}
                Meets::Somewhere(plane) => {
                    planes[count] = plane;
                    count += 1;
                }
            }
        }
        draw(counters, &planes[..count], &span, by)
    }

    /// Adds `by` to the parts that a cone may reach; false where there is none.
    fn rough(&self, counters: &mut Rough, entry: u32, by: u32) -> bool {
        if entry % 2 == 1 {
            return true;
        }
        let facets = self.cones.facets(self.cones.reaches[entry as usize / 2].stick);
        rough(counters, facets, &self.origin, by)
    }

    /// A block with more cones than a counter can count: in parts, and without keeping the counters.
    fn refresh_many(&self, block: &mut Block, list: Vec<u32>) {
        let mut sums = vec![0u32; SIDE * SIDE * SIDE];
        for part in list.chunks(usize::from(u16::MAX)) {
            let mut counters = [0u16; SIDE * SIDE * SIDE];
            part.iter().for_each(|&entry| _ = self.draw(&mut counters, entry, 1));
            sums.iter_mut().zip(&counters).for_each(|(s, &c)| *s += u32::from(c));
        }
        let most = sums.iter().copied().fold(0, u32::max);
        block.sample = first_place(&sums, most);
        (block.bound, block.level) = (most + full(&list), Level::Drawn);
        block.list = Some(list);
    }
}

/// The part of a reach that lies in a block, from the block's first sample.
fn span(reach: &Reach, block: [u16; 3]) -> Span {
    [0, 1, 2].map(|k| {
        let first = i32::from(block[k]) * SIDE as i32;
        [(i32::from(reach.low[k]) - first).max(0), (i32::from(reach.high[k]) - first).min(SIDE as i32 - 1)]
    })
}
