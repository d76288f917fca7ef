//! From a plane, line by line, to where most cones overlap: the second move of `polish`.

use super::polish::{PARTS, Voters};
use crate::geom::wide::{self, Work};

/// Line by line to where most cones overlap: shifts, tilts about three axes and about six diagonals.
pub fn climb(voters: &Voters, w: &mut [i64; 4], most: &mut usize) {
    const LINES: [[i64; 4]; 10] = [
        [1, 1, 1, 1],
        [-1, 1, 1, -1],
        [-1, 1, -1, 1],
        [-1, -1, 1, 1],
        [-1, 1, 0, 0],
        [0, 0, 1, -1],
        [-1, 0, 0, 1],
        [0, 1, -1, 0],
        [-1, 0, 1, 0],
        [0, 1, 0, -1],
    ];
    let mut near = Around::default();
    near.fill(voters, w);
    let mut idle = 0;
    for line in LINES.iter().cycle() {
        wide::run(Stretches { near: &mut near, line });
        let to = near.along(w, line);
        let count = wide::run(Votes { near: &mut near, w: &to });
        idle += 1;
        if count > *most {
            (*w, *most, idle) = (to, count, 0);
            near.fill(voters, w);
        }
        if idle == LINES.len() {
            return;
        }
    }
}

/// The cones whose reach comes within four samples of a plane w, their facets side by side. All numbers are whole and
/// below 2^53, but for the quotients.
#[derive(Default)]
struct Around {
    /// n + 1 offsets into the facets.
    starts: Vec<u32>,
    a: [Vec<f64>; 4],
    sign: Vec<f64>,
    /// a . w
    at: Vec<f64>,
    /// Of a line, or of another plane: a . it; then, for a line, the first and the last t inside.
    dots: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    /// Of the cones that a line goes through: its first t inside of each, and its last, as [`ordered`] numbers.
    firsts: Vec<i64>,
    lasts: Vec<i64>,
}

/// Farthest from w along a line.
const LIMIT: f64 = (8 * PARTS) as f64;

/// A number whose order is the order of all but NaN, and back: whole ones sort faster.
fn ordered(v: f64) -> i64 {
    let bits = v.to_bits() as i64;
    bits ^ ((bits >> 63) as u64 >> 1) as i64
}

fn number(of: i64) -> f64 {
    f64::from_bits((of ^ ((of >> 63) as u64 >> 1) as i64) as u64)
}

#[inline(always)]
fn dots(a: &[Vec<f64>; 4], w: &[i64; 4], out: &mut Vec<f64>) {
    let [p, q, r, s] = w.map(|v| v as f64);
    let n = a[0].len();
    out.resize(n, 0.0);
    let [a, b, c, d] = a.each_ref().map(|all| &all[..n]);
    for (i, out) in out.iter_mut().enumerate() {
        *out = a[i] * p + b[i] * q + c[i] * r + d[i] * s;
    }
}

/// Where a line through w goes through each cone.
struct Stretches<'a> {
    near: &'a mut Around,
    line: &'a [i64; 4],
}

impl Work for Stretches<'_> {
    type Out = ();
    #[inline(always)]
    fn work(self) {
        let Around { starts, a, sign, at, dots: slopes, low, high, firsts, lasts } = self.near;
        dots(a, self.line, slopes);
        let n = at.len();
        low.resize(n, 0.0);
        high.resize(n, 0.0);
        let (at, sign, slopes, low, high) = (&at[..n], &sign[..n], &slopes[..n], &mut low[..n], &mut high[..n]);
        for i in 0..n {
            let (at, slope) = (at[i], slopes[i]);
            let t = 0.0 - at / slope;
            // A line that runs along a facet is on one side of it.
            let outside = slope == 0.0 && (at < 0.0 || at == 0.0 && sign[i] < 0.0);
            low[i] = if slope > 0.0 { t } else { -LIMIT };
            high[i] = if slope < 0.0 { t } else { LIMIT };
            high[i] = if outside { f64::NEG_INFINITY } else { high[i] };
        }
        firsts.clear();
        lasts.clear();
        for c in starts.windows(2) {
            let own = c[0] as usize..c[1] as usize;
            let low = low[own.clone()].iter().fold(-LIMIT, |l, &v| if v > l { v } else { l });
            let high = high[own].iter().fold(LIMIT, |h, &v| if v < h { v } else { h });
            if low < high {
                firsts.push(ordered(low));
                lasts.push(ordered(high));
            }
        }
    }
}

/// How many cones hold a plane.
struct Votes<'a> {
    near: &'a mut Around,
    w: &'a [i64; 4],
}

impl Work for Votes<'_> {
    type Out = usize;
    #[inline(always)]
    fn work(self) -> usize {
        let Around { starts, a, sign, dots: at, .. } = self.near;
        dots(a, self.w, at);
        let inside = |i: usize| at[i] > 0.0 || at[i] == 0.0 && sign[i] > 0.0;
        starts.windows(2).filter(|c| (c[0]..c[1]).all(|i| inside(i as usize))).count()
    }
}

impl Around {
    fn fill(&mut self, voters: &Voters, w: &[i64; 4]) {
        self.starts.clear();
        self.starts.push(0);
        self.a.iter_mut().for_each(Vec::clear);
        self.sign.clear();
        for stick in voters.around(w) {
            for f in voters.cones.facets(stick) {
                self.a.iter_mut().zip(f.a).for_each(|(all, v)| all.push(f64::from(v)));
                self.sign.push(f64::from(f.sign));
            }
            self.starts.push(self.sign.len() as u32);
        }
        dots(&self.a, w, &mut self.at);
    }

    /// The plane w + t line, t within four samples, in the middle of where most of the line's [`Stretches`] overlap; of
    /// equal places the longest, then the first.
    fn along(&mut self, w: &[i64; 4], line: &[i64; 4]) -> [i64; 4] {
        let Self { firsts, lasts, .. } = self;
        firsts.sort_unstable();
        lasts.sort_unstable();
        let (mut count, mut best) = (0, (0, 0.0, 0.0));
        let (mut i, mut j) = (0, 0);
        while j < lasts.len() {
            // Where one cone ends and another begins, the end comes first.
            let begins = i < firsts.len() && firsts[i] < lasts[j];
            let at = if begins { firsts[i] } else { lasts[j] };
            (i, j) = if begins { (i + 1, j) } else { (i, j + 1) };
            count += if begins { 1 } else { -1 };
            let next = match (firsts.get(i), lasts.get(j)) {
                (Some(&first), Some(&last)) if first < last => first,
                (_, Some(&last)) => last,
                _ => at,
            };
            let (at, length) = (number(at), number(next) - number(at));
            if count > best.0 && length > 0.0 || count == best.0 && length > best.1 {
                best = (count, length, at + length / 2.0);
            }
        }
        let t = best.2.round() as i64;
        [0, 1, 2, 3].map(|i| w[i] + t * line[i])
    }
}
