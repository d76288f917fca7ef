//! Pairs of boxes that overlap, by a grid of square cells.

use rayon::prelude::*;

use super::segments::Rect;

/// All pairs (i, j), i < j, of boxes whose insides share a point, in order. Empty boxes have no pairs. A box is
/// listed in every cell it covers; cells are wide enough that there are at most four entries a box.
/// Near O((n + pairs) log n) for boxes of like sizes; parallel.
pub fn overlapping(boxes: &[Rect]) -> Vec<(u32, u32)> {
    let real: Vec<&Rect> = boxes.iter().filter(|b| **b != Rect::EMPTY).collect();
    let span = |b: &Rect| [0, 1].map(|k| i64::from(b.high[k]) - i64::from(b.low[k]));
    let extent: i64 = real.iter().map(|b| span(b)[0].max(span(b)[1])).sum();
    let mut shift = (extent / real.len().max(1) as i64 * 2 + 1).ilog2();
    let cells = |b: &Rect, shift: u32| {
        let [x, y] = [0, 1].map(|k| i64::from(b.low[k] >> shift)..=i64::from(b.high[k] >> shift));
        y.flat_map(move |y| x.clone().map(move |x| (x, y)))
    };
    let count = |shift: u32| -> i64 {
        let of = |b: &&Rect| (0..2).map(|k| i64::from((b.high[k] >> shift) - (b.low[k] >> shift)) + 1).product::<i64>();
        real.iter().map(of).sum()
    };
    while count(shift) > 4 * real.len() as i64 && shift < 31 {
        shift += 1;
    }
    // (1) Cells and who covers them, by cell.
    let mut entries: Vec<(u64, u32)> = boxes
        .par_iter()
        .enumerate()
        .filter(|(_, b)| **b != Rect::EMPTY)
        .flat_map_iter(|(i, b)| {
            cells(b, shift).map(move |(x, y)| (u64::from(y as u32) << 32 | u64::from(x as u32), i as u32))
        })
        .collect();
    entries.par_sort_unstable();
    // (2) Pairs in a cell, each in the one cell where their common part begins.
    let mut pairs: Vec<(u32, u32)> = entries
        .par_chunk_by(|a, b| a.0 == b.0)
        .flat_map_iter(|cell| {
            (0..cell.len()).flat_map(move |k| {
                let (key, i) = cell[k];
                let a = boxes[i as usize];
                cell[k + 1..].iter().filter_map(move |&(_, j)| {
                    let both = a.intersection(&boxes[j as usize]);
                    let inside = both.low[0] < both.high[0] && both.low[1] < both.high[1];
                    let begins = [0, 1].map(|k| u64::from((both.low[k] >> shift) as u32));
                    (inside && key == begins[1] << 32 | begins[0]).then_some((i, j))
                })
            })
        })
        .collect();
    pairs.par_sort_unstable();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_asking_all() {
        let mut state = 5u64;
        let mut below = |n: i32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % n as u64) as i32
        };
        for (width, most) in [(40, 9), (4000, 40), (4000, 3000), (1_000_000_000, 50), (10, 1)] {
            let boxes: Vec<Rect> = (0..200)
                .map(|i| {
                    let low = [below(width) - width / 2, below(width) - width / 2];
                    let side = if i % 50 == 0 { width / 2 } else { most };
                    let high = [low[0] + below(side), low[1] + below(side)];
                    if i % 37 == 0 { Rect::EMPTY } else { Rect { low, high } }
                })
                .collect();
            let meet = |a: &Rect, b: &Rect| {
                (0..2).all(|k| a.low[k] < b.high[k] && b.low[k] < a.high[k])
                    && (0..2).all(|k| a.low[k].max(b.low[k]) < a.high[k].min(b.high[k]))
            };
            let all: Vec<(u32, u32)> = (0..200u32)
                .flat_map(|i| (i + 1..200).map(move |j| (i, j)))
                .filter(|&(i, j)| meet(&boxes[i as usize], &boxes[j as usize]))
                .collect();
            assert_eq!(overlapping(&boxes), all);
        }
        assert!(overlapping(&[]).is_empty() && overlapping(&[Rect::EMPTY; 3]).is_empty());
    }
}
