//! Equal points by equal numbers.

use rayon::prelude::*;

use super::Point;

/// Points in a piece of work, and about how many hash to a bucket: either's tables fit a core's cache.
const MANY: usize = 1 << 15;

/// Some points of a chunk by bucket, those of bucket b at `starts[b]..starts[b + 1]`, in order.
struct Sorted {
    starts: Vec<u32>,
    points: Vec<(Point, u32)>,
}

/// The distinct points in order of first occurrence, and the number of each point given. Expected O(n), parallel.
pub fn number(points: &[Point]) -> (Vec<Point>, Vec<u32>) {
    let buckets = (points.len() / MANY).next_power_of_two();
    let bits = buckets.trailing_zeros();
    // (1) Equal points into equal buckets.
    let sorted: Vec<Sorted> =
        points.par_chunks(MANY).enumerate().map(|(c, chunk)| by_bucket(chunk, c * MANY, bits)).collect();
    // (2) In each bucket the first of equal ones, for each in the order of the chunks.
    let firsts: Vec<Vec<u32>> = (0..buckets).into_par_iter().map(|b| firsts(&sorted, b)).collect();
    let mut read = vec![0usize; buckets];
    let from: Vec<Vec<usize>> = sorted
        .iter()
        .map(|chunk| {
            let now = read.clone();
            chunk.starts.windows(2).zip(&mut read).for_each(|(w, r)| *r += (w[1] - w[0]) as usize);
            now
        })
        .collect();
    // (3) Of each point its first, and how many points of each chunk are.
    let mut first = vec![0u32; points.len()];
    let counts: Vec<u32> = first
        .par_chunks_mut(MANY)
        .zip(&sorted)
        .zip(&from)
        .enumerate()
        .map(|(c, ((out, chunk), from))| {
            let mut count = 0;
            for (b, w) in chunk.starts.windows(2).enumerate() {
                let mine = &chunk.points[w[0] as usize..w[1] as usize];
                for (&(_, i), &f) in mine.iter().zip(&firsts[b][from[b]..]) {
                    out[i as usize - c * MANY] = f;
                    count += u32::from(i == f);
                }
            }
            count
        })
        .collect();
    drop((sorted, firsts, from));
    // (4) Numbers of the firsts, in order; then of all.
    let mut base = 0;
    let mut bases = Vec::with_capacity(counts.len());
    for count in counts {
        bases.push(base);
        base += count;
    }
    let mut rank = vec![0u32; points.len()];
    rank.par_chunks_mut(MANY).zip(first.par_chunks(MANY)).zip(&bases).enumerate().for_each(|(c, ((out, first), b))| {
        let mut next = *b;
        for (i, (out, &f)) in (c * MANY..).zip(out.iter_mut().zip(first)) {
            if i as u32 == f {
                *out = next;
                next += 1;
            }
        }
    });
    let mut distinct = Vec::with_capacity(base as usize);
    distinct.extend(points.iter().zip(0u32..).zip(&first).filter(|((_, i), f)| i == *f).map(|((p, _), _)| *p));
    first.par_iter_mut().for_each(|f| *f = rank[*f as usize]);
    (distinct, first)
}

fn mixed(p: Point) -> u64 {
    let key = u64::from(p[0] as u32) << 32 | u64::from(p[1] as u32);
    (key ^ key >> 29).wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

fn by_bucket(chunk: &[Point], base: usize, bits: u32) -> Sorted {
    let bucket = |p: Point| (mixed(p) >> 32) as usize & ((1 << bits) - 1);
    let mut starts = vec![0u32; (1 << bits) + 1];
    chunk.iter().for_each(|&p| starts[bucket(p) + 1] += 1);
    for b in 1..starts.len() {
        starts[b] += starts[b - 1];
    }
    let mut next = starts.clone();
    let mut points = vec![([0; 2], 0); chunk.len()];
    for (&p, i) in chunk.iter().zip(base as u32..) {
        let slot = &mut next[bucket(p)];
        points[*slot as usize] = (p, i);
        *slot += 1;
    }
    Sorted { starts, points }
}

/// Of each point of a bucket the first that equals it.
fn firsts(sorted: &[Sorted], b: usize) -> Vec<u32> {
    let mine = || sorted.iter().flat_map(|s| &s.points[s.starts[b] as usize..s.starts[b + 1] as usize]);
    let count: usize = sorted.iter().map(|s| (s.starts[b + 1] - s.starts[b]) as usize).sum();
    // An open table, half full at most.
    let bits = (2 * count).next_power_of_two().trailing_zeros().max(1);
    let mut table = vec![([0; 2], u32::MAX); 1 << bits];
    let mut out = Vec::with_capacity(count);
    for &(p, i) in mine() {
        let mut slot = (mixed(p) >> (64 - bits)) as usize;
        let first = loop {
            let held = &mut table[slot];
            if held.1 == u32::MAX {
                *held = (p, i);
                break i;
            }
            if held.0 == p {
                break held.1;
            }
            slot = (slot + 1) & ((1 << bits) - 1);
        };
        out.push(first);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_come_first_numbered() {
        let points = [[5, 5], [-1, 2], [5, 5], [2, -1], [-1, 2]];
        assert_eq!(number(&points), (vec![[5, 5], [-1, 2], [2, -1]], vec![0, 1, 0, 2, 1]));
        assert_eq!(number(&[]), (vec![], vec![]));
    }

    #[test]
    fn many_as_one_by_one() {
        let mut state = 3u64;
        let mut below = |n: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % n) as i32
        };
        let points: Vec<Point> = (0..3 * MANY + 77).map(|_| [below(300) - 150, below(200)]).collect();
        let mut known = std::collections::BTreeMap::new();
        let mut distinct = Vec::new();
        let numbers: Vec<u32> = points
            .iter()
            .map(|&p| {
                *known.entry(p).or_insert_with(|| {
                    distinct.push(p);
                    distinct.len() as u32 - 1
                })
            })
            .collect();
        assert_eq!(number(&points), (distinct, numbers));
    }
}
