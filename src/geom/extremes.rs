//! The least and the greatest of any range of a list.

use std::ops::Range;

const BLOCK: usize = 16;
const NONE: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

/// A binary tree over blocks of the list. O(n) to make, O(log n) to ask.
pub struct Extremes {
    /// Blocks from half of it on; each before them joins its two.
    tree: Vec<[f64; 2]>,
}

impl Extremes {
    pub fn of(values: &[f64]) -> Self {
        let width = values.len().div_ceil(BLOCK);
        let mut tree = vec![NONE; width];
        tree.extend(values.chunks(BLOCK).map(scan));
        for i in (1..width).rev() {
            tree[i] = join(tree[2 * i], tree[2 * i + 1]);
        }
        Self { tree }
    }

    /// Least and greatest of `values[range]`, the list that this was made of; infinities where it is empty.
    pub fn within(&self, values: &[f64], range: Range<usize>) -> [f64; 2] {
        let (first, last) = (range.start.div_ceil(BLOCK), range.end / BLOCK);
        if first >= last {
            return scan(&values[range]);
        }
        let mut out = join(scan(&values[range.start..first * BLOCK]), scan(&values[last * BLOCK..range.end]));
        let (mut low, mut high) = (first + self.tree.len() / 2, last + self.tree.len() / 2);
        while low < high {
            if low % 2 == 1 {
                out = join(out, self.tree[low]);
                low += 1;
            }
            if high % 2 == 1 {
                high -= 1;
                out = join(out, self.tree[high]);
            }
            (low, high) = (low / 2, high / 2);
        }
        out
    }
}

fn scan(values: &[f64]) -> [f64; 2] {
    values.iter().fold(NONE, |o, &v| join(o, [v, v]))
}

#[inline]
fn join(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_range() {
        for n in [0, 1, 15, 16, 17, 100, 263] {
            let values: Vec<f64> = (0..n).map(|i| f64::from(i * 7919 % 263)).collect();
            let all = Extremes::of(&values);
            for from in 0..=values.len() {
                for to in from..=values.len() {
                    assert_eq!(all.within(&values, from..to), scan(&values[from..to]), "{n} {from} {to}");
                }
            }
        }
    }
}
