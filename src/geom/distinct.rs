//! Equal points by equal numbers.

use super::Point;

/// The distinct points in order of first occurrence, and the number of each point given. Expected O(n).
pub fn number(points: impl ExactSizeIterator<Item = Point>) -> (Vec<Point>, Vec<u32>) {
    // An open table, half full at most: a library's map would be as good but for its memory.
    let bits = (2 * points.len()).next_power_of_two().trailing_zeros().max(1);
    let mut table = vec![u32::MAX; 1 << bits];
    let mut distinct: Vec<Point> = Vec::new();
    let numbers = points
        .map(|p| {
            let key = u64::from(p[0] as u32) << 32 | u64::from(p[1] as u32);
            let mixed = (key ^ key >> 29).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let mut slot = (mixed >> (64 - bits)) as usize;
            loop {
                let held = table[slot];
                if held == u32::MAX {
                    table[slot] = distinct.len() as u32;
                    distinct.push(p);
                    return table[slot];
                }
                if distinct[held as usize] == p {
                    return held;
                }
                slot = (slot + 1) & (table.len() - 1);
            }
        })
        .collect();
    (distinct, numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_come_first_numbered() {
        let points = [[5, 5], [-1, 2], [5, 5], [2, -1], [-1, 2]];
        assert_eq!(number(points.into_iter()), (vec![[5, 5], [-1, 2], [2, -1]], vec![0, 1, 0, 2, 1]));
        assert_eq!(number([].into_iter()), (vec![], vec![]));
    }
}
