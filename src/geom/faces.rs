//! The faces of the plane minus segments: which points could see each other at all? Exact, without any new
//! coordinates: crossings are compared as fractions along the segments.

use super::Point;
use super::bounds::Bounds;
use super::gap::to_segment;
use super::predicates::{on_segment, orient, segments_meet};
use super::segment_grid::SegmentGrid;

/// The faces around segments. Every piece of a segment between two meetings has two sides; sides that lie on the
/// same face have the same root.
pub struct Faces<'a> {
    segments: &'a SegmentGrid,
    /// For each segment its first piece; pieces follow each other from the lower end (by y, then x) to the upper.
    first: Vec<u32>,
    /// Offsets of each segment's breaks, which part its pieces.
    breaks: Vec<Vec<Break>>,
    /// A piece that lies on another one stands for that one.
    stands_for: Vec<u32>,
    /// Over the left (2 p) and the right (2 p + 1) side of each piece, seen upwards, and the outside.
    sides: Groups,
}

/// A meeting in the interior of a segment, at `num / den` of the way up.
#[derive(Clone, Copy)]
struct Break {
    num: i64,
    den: i64,
    vertex: u32,
}

impl Break {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (i128::from(self.num) * i128::from(other.den)).cmp(&(i128::from(other.num) * i128::from(self.den)))
    }
}

/// From the lower end (by y, then x) to the upper.
fn upwards([a, b]: [Point; 2]) -> [Point; 2] {
    if (a[1], a[0]) <= (b[1], b[0]) { [a, b] } else { [b, a] }
}

impl<'a> Faces<'a> {
    pub fn new(segments: &'a SegmentGrid) -> Self {
        let all = &segments.all;
        // (1) Vertices: the ends, then one for each crossing; those at one place are joined.
        let mut ends: Vec<Point> = all.iter().flatten().copied().collect();
        ends.sort_unstable();
        ends.dedup();
        let vertex_at = |p: Point| ends.binary_search(&p).unwrap_or(0) as u32;
        let mut crossings = ends.len() as u32;
        let mut breaks = vec![Vec::new(); all.len()];
        for [i, j] in meetings(segments) {
            let ([a, b], [c, d]) = (upwards(all[i as usize]), upwards(all[j as usize]));
            let signs = [orient(c, d, a), orient(c, d, b), orient(a, b, c), orient(a, b, d)];
            if signs.iter().all(|&s| s != 0) {
                let at = |s: i64, t: i64| Break { num: s.abs(), den: (s - t).abs(), vertex: crossings };
                breaks[i as usize].push(at(signs[0], signs[1]));
                breaks[j as usize].push(at(signs[2], signs[3]));
                crossings += 1;
                continue;
            }
            for (on, [a, b], p) in [(i, [a, b], c), (i, [a, b], d), (j, [c, d], a), (j, [c, d], b)] {
                if p != a && p != b && on_segment(a, b, p) {
                    let k = usize::from(a[1] != b[1]);
                    let along = |q: Point| i64::from(q[k]) - i64::from(a[k]);
                    breaks[on as usize].push(Break { num: along(p), den: along(b), vertex: vertex_at(p) });
                }
            }
        }
        let mut vertices = Groups::new(crossings as usize);
        for list in &mut breaks {
            list.sort_by(Break::cmp);
            for w in list.windows(2) {
                if w[0].cmp(&w[1]).is_eq() {
                    vertices.join(w[0].vertex, w[1].vertex);
                }
            }
            list.dedup_by(|a, b| a.cmp(b).is_eq());
        }
        // (2) Pieces, and what lies on what.
        let mut first = Vec::with_capacity(all.len());
        let mut pieces: Vec<[u32; 2]> = Vec::new();
        let mut directions: Vec<[i64; 2]> = Vec::new();
        for (s, list) in all.iter().zip(&breaks) {
            first.push(pieces.len() as u32);
            let [a, b] = upwards(*s);
            let mut from = vertices.root(vertex_at(a));
            for to in list.iter().map(|b| b.vertex).chain([vertex_at(b)]) {
                let to = vertices.root(to);
                pieces.push([from, to]);
                directions.push([i64::from(b[0]) - i64::from(a[0]), i64::from(b[1]) - i64::from(a[1])]);
                from = to;
            }
        }
        let mut sorted: Vec<u32> = (0..pieces.len() as u32).collect();
        sorted.sort_unstable_by_key(|&p| (pieces[p as usize], p));
        let mut stands_for = vec![0; pieces.len()];
        for same in sorted.chunk_by(|&p, &q| pieces[p as usize] == pieces[q as usize]) {
            same.iter().for_each(|&p| stands_for[p as usize] = same[0]);
        }
        let mut out = Self { segments, first, breaks, stands_for, sides: Groups::new(2 * pieces.len() + 1) };
        // (3) Around every vertex, what lies between two neighbouring pieces is one face.
        let mut around: Vec<(u32, [i64; 2], u32, u32)> = Vec::with_capacity(2 * pieces.len());
        for (p, &[u, v]) in (0u32..).zip(&pieces) {
            if out.stands_for[p as usize] != p || u == v {
                continue;
            }
            let d = directions[p as usize];
            // Vertex, direction outwards, the sides to its left and right.
            around.push((u, d, 2 * p, 2 * p + 1));
            around.push((v, [-d[0], -d[1]], 2 * p + 1, 2 * p));
        }
        around.sort_by(|a, b| a.0.cmp(&b.0).then_with(|| by_angle(a.1, b.1)));
        let mut islands = Groups::new(crossings as usize);
        let mut outward = vec![u32::MAX; ends.len()];
        for fan in around.chunk_by(|a, b| a.0 == b.0) {
            for (k, end) in fan.iter().enumerate() {
                out.sides.join(end.2, fan[(k + 1) % fan.len()].3);
            }
            if let Some(slot) = outward.get_mut(fan[0].0 as usize) {
                *slot = fan[fan.len() - 1].2;
            }
        }
        for &[u, v] in &pieces {
            islands.join(u, v);
        }
        // (4) An island lies in the face to the left of its leftmost vertex. Ends are sorted and islands' roots are
        // their lowest vertices, so the leftmost is the root.
        for (v, &p) in ends.iter().enumerate() {
            if islands.root(v as u32) == v as u32 && outward[v] != u32::MAX {
                let seen = out.left_of(p).unwrap_or(out.outside());
                out.sides.join(outward[v], seen);
            }
        }
        out
    }

    fn outside(&self) -> u32 {
        2 * self.stands_for.len() as u32
    }

    /// The face of a point, as a number; none on a segment.
    pub fn of(&mut self, p: Point) -> Option<u32> {
        let cell = self
            .segments
            .grid
            .cell(self.segments.grid.column(i64::from(p[0])), self.segments.grid.row(i64::from(p[1])));
        let on = |&i: &u32| {
            let [a, b] = self.segments.all[i as usize];
            on_segment(a, b, p)
        };
        if cell.is_some_and(|cell| self.segments.in_cell(cell).iter().any(on)) {
            return None;
        }
        let side = self.left_of(p).unwrap_or(self.outside());
        Some(self.sides.root(side))
    }

    /// Makes one face of all that lies along the segments within `reach` mm of the closed segment `a`-`b`, and
    /// returns it; none where no segment is so near. Whatever is joined can only be compared too often.
    pub fn join_along(&mut self, a: Point, b: Point, reach: i32) -> Option<u32> {
        let around = Bounds::of([a, b]);
        let grid = &self.segments.grid;
        let (r, mut near) = (i64::from(reach), Vec::new());
        for row in grid.row(i64::from(around.low[1]) - r)..=grid.row(i64::from(around.high[1]) + r) {
            for column in grid.column(i64::from(around.low[0]) - r)..=grid.column(i64::from(around.high[0]) + r) {
                let Some(cell) = grid.cell(column, row) else { continue };
                near.extend(self.segments.in_cell(cell).iter().copied().filter(|&i| {
                    let [c, d] = self.segments.all[i as usize];
                    let ends = || [(a, c, d), (b, c, d), (c, a, b), (d, a, b)];
                    around.square_to(&Bounds::of([c, d])) <= (r * r) as f64
                        && (segments_meet(a, b, c, d)
                            || ends().iter().any(|&(p, u, v)| to_segment(p, u, v).1 <= f64::from(reach)))
                }));
            }
        }
        let mut joined = None;
        for i in near {
            let i = i as usize;
            for piece in self.first[i] as usize..=self.first[i] as usize + self.breaks[i].len() {
                let side = 2 * self.stands_for[piece];
                self.sides.join(side, side + 1);
                let with = *joined.get_or_insert(side);
                self.sides.join(side, with);
            }
        }
        joined.map(|side| self.sides.root(side))
    }

    /// Makes one face of two.
    pub fn join(&mut self, a: u32, b: u32) {
        self.sides.join(a, b);
    }

    /// The number of a face now, after joins.
    pub fn now(&mut self, face: u32) -> u32 {
        self.sides.root(face)
    }

    /// The side that a ray from `p` to the left meets first; a ray that runs into a vertex passes just above it.
    fn left_of(&self, p: Point) -> Option<u32> {
        let grid = &self.segments.grid;
        let y = i64::from(p[1]);
        let row = grid.row(y);
        let mut best: Option<(Hit, u32)> = None;
        for column in (0..=grid.column(i64::from(p[0])).min(grid.last_column())).rev() {
            let cell = grid.cell(column, row)?;
            for &i in self.segments.in_cell(cell) {
                let [a, b] = upwards(self.segments.all[i as usize]);
                if a[1] <= p[1] && p[1] < b[1] && orient(a, b, p) < 0 {
                    let hit = Hit::new(a, b, y);
                    if best.as_ref().is_none_or(|(known, _)| known.is_left_of(&hit)) {
                        best = Some((hit, i));
                    }
                }
            }
            if best.as_ref().is_some_and(|(hit, _)| hit.is_right_of(grid.left_of(column))) {
                break;
            }
        }
        best.map(|(hit, i)| {
            let i = i as usize;
            // Breaks at or below the ray.
            let below = |b: &Break| i128::from(b.num) * i128::from(hit.rise) <= i128::from(hit.up) * i128::from(b.den);
            let piece = self.first[i] as usize + self.breaks[i].partition_point(below);
            2 * self.stands_for[piece] + 1
        })
    }
}

/// Where a segment that rises meets a horizontal: at x = num / rise.
struct Hit {
    num: i128,
    rise: i64,
    run: i64,
    up: i64,
}

impl Hit {
    fn new(a: Point, b: Point, y: i64) -> Self {
        let (rise, run) = (i64::from(b[1]) - i64::from(a[1]), i64::from(b[0]) - i64::from(a[0]));
        let up = y - i64::from(a[1]);
        Self { num: i128::from(a[0]) * i128::from(rise) + i128::from(up) * i128::from(run), rise, run, up }
    }

    /// On the horizontal, or, where equal, just above it.
    fn is_left_of(&self, other: &Self) -> bool {
        let (p, q) = (self.num * i128::from(other.rise), other.num * i128::from(self.rise));
        let (s, t) = (self.run as i128 * other.rise as i128, other.run as i128 * self.rise as i128);
        (p, s) < (q, t)
    }

    fn is_right_of(&self, x: i64) -> bool {
        self.num >= i128::from(x) * i128::from(self.rise)
    }
}

/// Pairs of segments that share a point other than a common end.
fn meetings(segments: &SegmentGrid) -> Vec<[u32; 2]> {
    let all = &segments.all;
    let mut out = Vec::new();
    for cell in 0..segments.grid.cells() {
        let here = segments.in_cell(cell);
        for (k, &i) in here.iter().enumerate() {
            let [a, b] = all[i as usize];
            for &j in &here[k + 1..] {
                let [c, d] = all[j as usize];
                let apart = |k: usize| a[k].max(b[k]) < c[k].min(d[k]) || c[k].max(d[k]) < a[k].min(b[k]);
                if apart(0) || apart(1) {
                    continue;
                }
                let (o1, o2) = (orient(a, b, c).signum(), orient(a, b, d).signum());
                let (o3, o4) = (orient(c, d, a).signum(), orient(c, d, b).signum());
                if o1 * o2 > 0 || o3 * o4 > 0 {
                    continue;
                }
                let ends = [a == c, a == d, b == c, b == d].into_iter().filter(|&e| e).count();
                let collinear = o1 == 0 && o2 == 0;
                if ends == 0 || (ends == 1 && collinear) {
                    out.push([i, j]);
                }
            }
        }
    }
    out.sort_unstable();
    out.dedup();
    out
}

/// Counter-clockwise from just above the negative x axis, through below.
fn by_angle(a: [i64; 2], b: [i64; 2]) -> std::cmp::Ordering {
    let upper = |d: [i64; 2]| d[1] >= 0;
    upper(a).cmp(&upper(b)).then_with(|| {
        // Along the x axis: the positive half comes first of the upper, the negative half last.
        (b[0] * a[1]).cmp(&(a[0] * b[1])).then_with(|| b[0].signum().cmp(&a[0].signum()))
    })
}

/// Disjoint sets whose root is their lowest member.
pub struct Groups(Vec<u32>);

impl Groups {
    pub fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }
    pub fn root(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            let up = self.0[self.0[i as usize] as usize];
            self.0[i as usize] = up;
            i = up;
        }
        i
    }
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faces_of(segments: &[[Point; 2]], points: &[Point]) -> Vec<Option<u32>> {
        let segments = SegmentGrid::new(segments.to_vec());
        let mut faces = Faces::new(&segments);
        points.iter().map(|&p| faces.of(p)).collect()
    }

    fn square(low: i32, high: i32) -> [[Point; 2]; 4] {
        let [a, b, c, d] = [[low, low], [high, low], [high, high], [low, high]];
        [[a, b], [b, c], [c, d], [d, a]]
    }

    #[test]
    fn inside_outside_and_on() {
        let f = faces_of(&square(0, 10), &[[5, 5], [1, 9], [-5, 5], [50, 50], [0, 5], [10, 10], [5, -1]]);
        assert_eq!(f[0], f[1]);
        assert_ne!(f[0], f[2]);
        assert_eq!([f[2], f[2]], [f[3], f[6]]);
        assert_eq!([f[4], f[5]], [None, None]);
    }

    #[test]
    fn islands_and_dead_ends() {
        let mut all = square(0, 100).to_vec();
        all.extend(square(40, 60));
        // A dead end into the outer ring from the left side, and a segment that floats.
        all.push([[0, 50], [20, 50]]);
        all.push([[70, 20], [90, 20]]);
        let f = faces_of(&all, &[[10, 40], [10, 60], [80, 50], [80, 10], [50, 50], [200, 50], [-3, 50]]);
        assert!(f[..4].iter().all(|x| *x == f[0]));
        assert_ne!(f[0], f[4]);
        assert_ne!(f[0], f[5]);
        assert_ne!(f[4], f[5]);
        assert_eq!(f[5], f[6]);
    }

    #[test]
    fn crossings_that_no_grid_holds() {
        // Two and two lines: nine faces, of which the eight outer ones are one.
        let all = [[[-100, 1], [101, 8]], [[-100, -9], [101, -3]], [[3, -50], [11, 51]], [[-9, -50], [-2, 50]]];
        let f = faces_of(&all, &[[0, 0], [0, 50], [50, 0], [-50, 0], [0, -50], [3, 2]]);
        assert!(f[1..5].iter().all(|x| *x == f[1]));
        assert_ne!(f[0], f[1]);
        assert_eq!(f[0], f[5]);
    }

    #[test]
    fn overlapping_segments() {
        // The lower side twice, in pieces of other lengths; crossed there by a third.
        let mut all = square(0, 10).to_vec();
        all.extend([[[2, 0], [14, 0]], [[8, 0], [-3, 0]], [[3, -5], [5, 4]], [[0, 0], [10, 0]]]);
        let f = faces_of(&all, &[[1, 1], [9, 9], [1, -1], [20, 5], [12, 1], [12, -1]]);
        assert_eq!(f[0], f[1]);
        assert_ne!(f[0], f[2]);
        assert!(f[3..].iter().all(|x| *x == f[2]));
    }

    /// Who sees each other is in one face; and faces are few enough to be of use: as many as Euler says.
    #[test]
    fn sound_and_fine() {
        let mut state = 11u64;
        let mut dice = |n: i32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (((state >> 33) * n as u64) >> 31) as i32
        };
        for round in 0..60 {
            let side = [6, 12, 40][round % 3];
            let count = [8, 14, 20][round / 3 % 3];
            let all: Vec<[Point; 2]> = (0..count)
                .map(|_| [[dice(side), dice(side)], [dice(side), dice(side)]])
                .filter(|s| s[0] != s[1])
                .collect();
            let segments = SegmentGrid::new(all.clone());
            let mut faces = Faces::new(&segments);
            let points: Vec<Point> = (-1..=side).flat_map(|x| (-1..=side).map(move |y| [x, y])).collect();
            let of: Vec<Option<u32>> = points.iter().map(|&p| faces.of(p)).collect();
            let mut reached = Groups::new(points.len());
            for i in 0..points.len() {
                assert_eq!(of[i].is_none(), segments.meet(points[i], points[i]));
                for j in 0..i {
                    if !segments.meet(points[i], points[j]) {
                        assert_eq!(of[i], of[j], "{all:?}: {:?} sees {:?}", points[i], points[j]);
                        reached.join(i as u32, j as u32);
                    }
                }
            }
            // Hops over free grid points join nearly all of what is one face.
            let hops = (0..points.len()).filter(|&i| of[i].is_some() && reached.root(i as u32) == i as u32).count();
            let mut found: Vec<u32> = of.iter().flatten().copied().collect();
            found.sort_unstable();
            found.dedup();
            assert!(found.len() <= hops);
            if side == 40 {
                assert!(found.len() * 10 >= hops * 8, "{} faces, {hops} by hops", found.len());
            }
        }
    }
}
