//! From crossings to black and white: rays, and runs of nodes.

use std::ops::Range;

use rayon::prelude::*;

use super::crossings::{Crossing, Crossings, Hits, Place, key_of};

/// Slices worked on at once. Fixed: the same for any number of threads.
const SLICES: usize = 16;

/// What six rays to each node say: along each axis, from below and from above.
pub struct Rays {
    /// Rows of words: nodes where all six (`winding`), or at least four of six (`parity`), are inside.
    pub black: Vec<u64>,
    /// Nodes where the six differ: z, y, x of 16 bits each, ascending.
    pub doubts: Vec<u64>,
}

/// How a ray counts.
#[derive(Clone, Copy, PartialEq)]
pub enum Count {
    /// Crossings, odd is inside.
    Parity,
    /// Comings in less goings out, at least one is inside.
    Winding,
}

/// One column's count from below and in all.
#[derive(Clone, Copy, Default)]
struct Column {
    below: i32,
    all: i32,
}

impl Column {
    fn inside(&self, count: Count) -> [bool; 2] {
        match count {
            Count::Parity => [self.below & 1 == 1, (self.below - self.all) & 1 == 1],
            Count::Winding => [self.below >= 1, self.below - self.all >= 1],
        }
    }
}

/// Columns of a plane of lines, and the bits that say which are inside now.
struct Front {
    words: usize,
    columns: Vec<Column>,
    bits: [Vec<u64>; 2],
}

impl Front {
    fn new(side: usize, rows: usize) -> Self {
        let words = side.div_ceil(64);
        Self {
            words,
            columns: vec![Column::default(); side * rows],
            bits: [vec![0; words * rows], vec![0; words * rows]],
        }
    }
    fn set(&mut self, side: usize, row: usize, x: usize, count: Count) {
        let inside = self.columns[row * side + x].inside(count);
        for (bits, inside) in self.bits.iter_mut().zip(inside) {
            let word = &mut bits[row * self.words + x / 64];
            *word = *word & !(1 << (x % 64)) | u64::from(inside) << (x % 64);
        }
    }
    /// A crossing is behind us.
    fn pass(&mut self, side: usize, row: usize, crossing: Crossing, count: Count) {
        let x = crossing.node()[0];
        self.columns[row * side + x].below += crossing.step();
        self.set(side, row, x, count);
    }
    /// What lies ahead: shown from above at once.
    fn expect(&mut self, side: usize, row: usize, crossing: Crossing, count: Count) {
        let x = crossing.node()[0];
        self.columns[row * side + x].all += crossing.step();
        self.set(side, row, x, count);
    }
}

/// The part of a sorted list that lies in some slices.
fn of_slices(all: &[Crossing], slices: Range<usize>) -> &[Crossing] {
    let at = |z: usize| all.partition_point(|c| c.slice() < z);
    &all[at(slices.start)..at(slices.end)]
}

/// Asks six rays for every node.
pub fn rays(hits: &Hits, side: usize, count: Count) -> Rays {
    let words = side.div_ceil(64);
    // Lines along z are followed through all slices: their state at the start of each part.
    let mut front = Front::new(side, side);
    hits.axes[2].iter().for_each(|&c| front.expect(side, c.node()[1], c, count));
    let mut starts = Vec::new();
    for first in (0..side).step_by(SLICES) {
        starts.push((first, Front { words, columns: front.columns.clone(), bits: front.bits.clone() }));
        of_slices(&hits.axes[2], first..first + SLICES).iter().for_each(|&c| front.pass(side, c.node()[1], c, count));
    }
    let parts: Vec<Rays> = starts
        .into_par_iter()
        .map(|(first, mut front)| {
            let mut out = Rays { black: Vec::with_capacity(SLICES * side * words), doubts: Vec::new() };
            for z in first..(first + SLICES).min(side) {
                slice(hits, side, z, count, &front, &mut out);
                of_slices(&hits.axes[2], z..z + 1).iter().for_each(|&c| front.pass(side, c.node()[1], c, count));
            }
            out
        })
        .collect();
    let mut out = Rays { black: Vec::with_capacity(side * side * words), doubts: Vec::new() };
    for part in parts {
        out.black.extend(part.black);
        out.doubts.extend(part.doubts);
    }
    out
}

/// One slice of nodes; `up`: the lines along z, as they stand at it.
fn slice(hits: &Hits, side: usize, z: usize, count: Count, up: &Front, out: &mut Rays) {
    let words = up.words;
    let mut along_x = of_slices(&hits.axes[0], z..z + 1);
    let mut along_y = of_slices(&hits.axes[1], z..z + 1);
    let mut front = Front::new(side, 1);
    along_y.iter().for_each(|&c| front.expect(side, 0, c, count));
    let mut row = [vec![0u64; words], vec![0u64; words]];
    for y in 0..side {
        // (1) the row's own line
        let n = along_x.partition_point(|c| c.node()[1] <= y);
        let (own, rest) = along_x.split_at(n);
        along_x = rest;
        row.iter_mut().for_each(|bits| bits.fill(0));
        let mut column = Column { below: 0, all: own.iter().map(|c| c.step()).sum() };
        let mut from = 0;
        for (i, c) in own.iter().enumerate() {
            let end = c.node()[0] + 1;
            if end > from {
                paint(&mut row, from..end, column.inside(count));
                from = end;
            }
            column.below += c.step();
            if i + 1 == own.len() {
                paint(&mut row, from..side, column.inside(count));
            }
        }
        // (2) with the lines along y and z
        for w in 0..words {
            let six = [
                row[0][w],
                row[1][w],
                front.bits[0][w],
                front.bits[1][w],
                up.bits[0][y * words + w],
                up.bits[1][y * words + w],
            ];
            let (all, any) = six.iter().fold((u64::MAX, 0), |(all, any), b| (all & b, any | b));
            let mut differ = any & !all;
            out.black.push(match count {
                Count::Winding => all,
                Count::Parity => four_of_six(six),
            });
            while differ != 0 {
                out.doubts.push(key_of([64 * w + differ.trailing_zeros() as usize, y, z]));
                differ &= differ - 1;
            }
        }
        let n = along_y.partition_point(|c| c.node()[1] <= y);
        along_y[..n].iter().for_each(|&c| front.pass(side, 0, c, count));
        along_y = &along_y[n..];
    }
}

fn paint(rows: &mut [Vec<u64>; 2], range: Range<usize>, inside: [bool; 2]) {
    for (row, inside) in rows.iter_mut().zip(inside) {
        if inside {
            set_bits(row, range.clone());
        }
    }
}

/// Sets the bits of a range of a row.
pub fn set_bits(row: &mut [u64], range: Range<usize>) {
    let mut from = range.start;
    while from < range.end {
        let word = from / 64;
        let end = range.end.min(64 * (word + 1));
        let ones = if end - from == 64 { u64::MAX } else { ((1u64 << (end - from)) - 1) << (from % 64) };
        row[word] |= ones;
        from = end;
    }
}

/// Bits that at least four of six words have.
fn four_of_six(words: [u64; 6]) -> u64 {
    let (mut ones, mut twos, mut fours) = (0, 0, 0);
    for w in words {
        let carry = ones & w;
        ones ^= w;
        fours |= twos & carry;
        twos ^= carry;
    }
    fours
}

/// Nodes that cannot be reached from the outside without crossing the surface: rows of words.
/// Runs of nodes between crossings are joined where a neighbouring run can be reached by one open edge.
pub fn flood(hits: &Hits, side: usize) -> Vec<u64> {
    struct Run {
        row: u32,
        first: u16,
        end: u16,
    }
    let words = side.div_ceil(64);
    // (1) runs of each row
    let mut runs: Vec<Run> = Vec::new();
    let mut starts = Vec::with_capacity(side * side + 1);
    let (mut x_hits, mut on) = (&hits.axes[0][..], &hits.on[..]);
    for row in 0..side * side {
        starts.push(runs.len());
        let mut cuts: Vec<usize> = Vec::new();
        while let Some((&c, rest)) = x_hits.split_first().filter(|(c, _)| c.node()[2] * side + c.node()[1] == row) {
            if c.place() != Place::OnNode {
                cuts.push(2 * c.node()[0] + 1);
            }
            x_hits = rest;
        }
        while let Some((&key, rest)) = on.split_first() {
            let [x, y, z] = super::crossings::node_of(key);
            if z * side + y != row {
                break;
            }
            cuts.push(2 * x);
            on = rest;
        }
        cuts.sort_unstable();
        cuts.dedup();
        let mut from = 0;
        // An odd cut lies behind node cut / 2, an even one on it.
        for cut in cuts.into_iter().chain([2 * side - 1]) {
            let end = cut.div_ceil(2);
            if end > from {
                runs.push(Run { row: row as u32, first: from as u16, end: end as u16 });
            }
            from = from.max(cut / 2 + 1);
        }
    }
    starts.push(runs.len());
    // (2) joined across rows
    let mut parent: Vec<u32> = (0..runs.len() as u32).collect();
    fn root(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    for (axis, step) in [(1, 1), (2, side)] {
        let closed: &Crossings = &hits.axes[axis];
        let mut rest = &closed[..];
        for row in 0..side * side {
            let (y, z) = (row % side, row / side);
            let n = rest.partition_point(|c| (c.node()[2], c.node()[1]) <= (z, y));
            let mut shut: Vec<usize> =
                rest[..n].iter().filter(|c| c.place() != Place::OnNode).map(|c| c.node()[0]).collect();
            rest = &rest[n..];
            if if axis == 1 { y } else { z } + 1 == side {
                continue;
            }
            shut.dedup();
            let (mut i, mut j) = (starts[row], starts[row + step]);
            while i < starts[row + 1] && j < starts[row + step + 1] {
                let (a, b) = (&runs[i], &runs[j]);
                let (first, end) = (a.first.max(b.first) as usize, a.end.min(b.end) as usize);
                if first < end {
                    let count = shut.partition_point(|&x| x < end) - shut.partition_point(|&x| x < first);
                    if count < end - first {
                        let (p, q) = (root(&mut parent, i as u32), root(&mut parent, j as u32));
                        parent[p.max(q) as usize] = p.min(q);
                    }
                }
                if a.end <= b.end {
                    i += 1;
                } else {
                    j += 1;
                }
            }
        }
    }
    // (3) node (0, 0, 0) is outside
    let mut out = vec![0u64; side * side * words];
    for row in out.chunks_mut(words) {
        set_bits(row, 0..side);
    }
    for (i, run) in runs.iter().enumerate() {
        if root(&mut parent, i as u32) == 0 {
            let row = &mut out[run.row as usize * words..][..words];
            for x in run.first..run.end {
                row[usize::from(x) / 64] &= !(1 << (x % 64));
            }
        }
    }
    out
}
