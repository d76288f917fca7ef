//! From a frame to a tile's own axes: east, north, up at the tile's origin on the globe.
//!
//! In:     the way to the globe (local metres -> ECEF metres), the tile's window of the plan.
//! Out:    for a plan point its place at height 0 and its upward step, in metres along the tile's axes.
//! Cost:   41 ways to the globe for a tile, then 16 products a point, instead of a projection each.
//! Errors: interpolation is checked against the way itself; where it is off by more than 0.1 mm (windows far beyond
//!         50 km) every point goes the long way.

use super::space::{cross, dot, sub, unit};

/// Local metres to metres from the earth's centre.
pub type Ecef<'a> = &'a (dyn Fn([f64; 3]) -> [f64; 3] + Sync);

/// Where a tile stands: its origin and the directions of its axes, in the axes of whatever is above it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub origin: [f64; 3],
    /// East, north, up; unit length, at right angles.
    pub axes: [[f64; 3]; 3],
}

impl Place {
    /// A place in a frame that has none on the globe.
    pub fn flat(origin: [f64; 3]) -> Self {
        Self { origin, axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] }
    }

    /// The place of local point `p`: up is the way that height goes.
    pub fn on_globe(ecef: Ecef, p: [f64; 3]) -> Self {
        let origin = ecef(p);
        // A long step, so that rounding (1 nm) does not tilt it.
        let up = unit(sub(ecef([p[0], p[1], p[2] + 10_000.0]), origin));
        let pole = [0.0, 0.0, 1.0];
        let east = cross(pole, up);
        // At a pole every way is south.
        let east = if dot(east, east) > 1e-18 { unit(east) } else { [0.0, 1.0, 0.0] };
        Self { origin, axes: [east, cross(up, east), up] }
    }

    /// A point of the outer axes in ours.
    pub fn local(&self, p: [f64; 3]) -> [f64; 3] {
        let d = sub(p, self.origin);
        self.axes.map(|a| dot(a, d))
    }

    /// A point of our axes in the outer ones.
    pub fn global(&self, p: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| self.origin[k] + self.axes[0][k] * p[0] + self.axes[1][k] * p[1] + self.axes[2][k] * p[2])
    }

    /// This place in the axes of `outer`.
    pub fn within(&self, outer: &Place) -> Place {
        Place { origin: outer.local(self.origin), axes: self.axes.map(|a| outer.axes.map(|o| dot(o, a))) }
    }

    /// Column-major 4 x 4 matrix, as glTF and 3D Tiles want it.
    pub fn matrix(&self) -> [f64; 16] {
        let ([e, n, u], o) = (self.axes, self.origin);
        [e[0], e[1], e[2], 0.0, n[0], n[1], n[2], 0.0, u[0], u[1], u[2], 0.0, o[0], o[1], o[2], 1.0]
    }
}

/// The map of one tile.
pub struct Chart<'a> {
    pub place: Place,
    way: Way<'a>,
}

enum Way<'a> {
    Flat,
    Grid { middle: [f64; 2], half: [f64; 2], nodes: Box<[[f64; 6]; 16]> },
    Exact(Ecef<'a>),
}

impl<'a> Chart<'a> {
    /// A chart around the local point `origin` without a globe.
    pub fn flat(origin: [f64; 3]) -> Self {
        Self { place: Place::flat(origin), way: Way::Flat }
    }

    /// A chart around the local point `origin` for plan points between `low` and `high`.
    pub fn on_globe(ecef: Ecef<'a>, origin: [f64; 3], low: [f64; 2], high: [f64; 2]) -> Self {
        let place = Place::on_globe(ecef, origin);
        let middle = [0, 1].map(|k| (low[k] + high[k]) / 2.0);
        let half = [0, 1].map(|k| ((high[k] - low[k]) / 2.0).max(1.0));
        let point = |u: f64, v: f64| [middle[0] + half[0] * u, middle[1] + half[1] * v];
        let nodes: [[f64; 6]; 16] = std::array::from_fn(|i| {
            let [u, v] = [i % 4, i / 4].map(|k| k as f64 * (2.0 / 3.0) - 1.0);
            exact(&place, ecef, point(u, v))
        });
        let grid = Self { place, way: Way::Grid { middle, half, nodes: Box::new(nodes) } };
        // The middles between nodes, where a cubic is worst.
        let spots = [-0.667, 0.0, 0.667];
        let off = spots.iter().flat_map(|&u| spots.map(|v| point(u, v))).any(|p| {
            let (near, far) = (grid.at(p), exact(&place, ecef, p));
            // Not "more than": where the projection does not reach there are only NaNs.
            !(0..3).all(|k| (near.0[k] - far[k]).abs() <= 1e-4 && (near.1[k] - far[k + 3]).abs() <= 1e-8)
        });
        if off { Self { place, way: Way::Exact(ecef) } } else { grid }
    }

    /// Place of the plan point at height 0, and what a metre of height adds.
    #[inline]
    pub fn at(&self, p: [f64; 2]) -> ([f64; 3], [f64; 3]) {
        match &self.way {
            Way::Flat => {
                let o = self.place.origin;
                ([p[0] - o[0], p[1] - o[1], -o[2]], [0.0, 0.0, 1.0])
            }
            Way::Grid { middle, half, nodes } => {
                let [wu, wv] = [0, 1].map(|k| weights((p[k] - middle[k]) / half[k]));
                let mut sum = [0.0; 6];
                for (j, row) in nodes.as_chunks::<4>().0.iter().enumerate() {
                    for (node, u) in row.iter().zip(wu) {
                        let w = u * wv[j];
                        (0..6).for_each(|k| sum[k] += w * node[k]);
                    }
                }
                let [a, b, c, d, e, f] = sum;
                ([a, b, c], [d, e, f])
            }
            Way::Exact(ecef) => {
                let [a, b, c, d, e, f] = exact(&self.place, *ecef, p);
                ([a, b, c], [d, e, f])
            }
        }
    }
}

/// Height is a straight line on the globe, so two points of it say all.
fn exact(place: &Place, ecef: Ecef, p: [f64; 2]) -> [f64; 6] {
    let [a, b] = [0.0, 1000.0].map(|z| place.local(ecef([p[0], p[1], z])));
    let up = sub(b, a).map(|v| v / 1000.0);
    [a[0], a[1], a[2], up[0], up[1], up[2]]
}

/// Lagrange's weights at `u` of the nodes -1, -1/3, 1/3, 1.
#[inline]
fn weights(u: f64) -> [f64; 4] {
    let (outer, inner) = ((u * u - 1.0 / 9.0) * (9.0 / 16.0), (u * u - 1.0) * (27.0 / 16.0));
    [outer * (1.0 - u), inner * (u - 1.0 / 3.0), inner * (-u - 1.0 / 3.0), outer * (u + 1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    const R: f64 = 6_371_000.0;

    /// A sphere, mapped by x = R lon, y = R lat around 50 degrees: curved enough.
    fn sphere(p: [f64; 3]) -> [f64; 3] {
        let (lat, lon) = (0.87 + p[1] / R, 0.1 + p[0] / R / libm::cos(0.87));
        let (r, c) = (R + p[2], libm::cos(lat));
        [r * c * libm::cos(lon), r * c * libm::sin(lon), r * libm::sin(lat)]
    }

    fn worst(size: f64) -> (f64, bool) {
        let chart = Chart::on_globe(&sphere, [100.0, 200.0, 0.0], [-size, -size], [size, size]);
        let mut worst = 0.0f64;
        for i in -7..=7 {
            for j in -7..=7 {
                let p = [size * f64::from(i) / 7.0, size * f64::from(j) / 7.0];
                let (a, up) = chart.at(p);
                let got = chart.place.global([0, 1, 2].map(|k| a[k] + 300.0 * up[k]));
                let want = sphere([p[0], p[1], 300.0]);
                worst = (0..3).fold(worst, |w, k| w.max((got[k] - want[k]).abs()));
            }
        }
        (worst, matches!(chart.way, Way::Grid { .. }))
    }

    #[test]
    fn as_good_as_the_long_way() {
        for (size, grid) in [(0.5, true), (500.0, true), (10_000.0, true), (200_000.0, false)] {
            let (off, is_grid) = worst(size);
            assert!(off < 2e-4, "{size} m: {off}");
            assert_eq!(is_grid, grid, "{size} m");
        }
    }

    #[test]
    fn axes_are_east_north_up() {
        let place = Place::on_globe(&sphere, [0.0; 3]);
        let [e, n, u] = [[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 5.0]].map(|p| place.local(sphere(p)));
        assert!((e[0] - 5.0).abs() < 1e-3 && (n[1] - 5.0).abs() < 1e-3 && (u[2] - 5.0).abs() < 1e-6);
        let outer = Place::on_globe(&sphere, [9000.0, 0.0, 0.0]);
        let p = [1.0, 2.0, 3.0];
        let both = outer.global(place.within(&outer).global(p));
        assert!((0..3).all(|k| (both[k] - place.global(p)[k]).abs() < 1e-7));
    }

    #[test]
    fn flat_only_shifts() {
        assert_eq!(Chart::flat([1.0, 2.0, 0.5]).at([3.0, 3.0]), ([2.0, 1.0, -0.5], [0.0, 0.0, 1.0]));
    }
}
