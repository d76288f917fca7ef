//! Points spread evenly over a surface, the same ones each time.

use super::space::{Vec3, dot, doubled_area};

/// A surface by its area: sums over the triangles so far.
pub struct Scatter {
    ends: Vec<f64>,
}

impl Scatter {
    /// Cost: O(triangles).
    pub fn new(triangles: impl IntoIterator<Item = [Vec3; 3]>) -> Self {
        let mut sum = 0.0;
        let end = |t: [Vec3; 3]| {
            let across = doubled_area(t);
            sum += dot(across, across).sqrt();
            sum
        };
        Self { ends: triangles.into_iter().map(end).collect() }
    }

    /// Whether it has no area.
    pub fn is_empty(&self) -> bool {
        self.ends.last().is_none_or(|&sum| sum <= 0.0)
    }

    /// Point i of n: its triangle, and the corners' weights. Not where the surface is empty. Cost: O(log triangles).
    pub fn point(&self, i: u64, n: u64) -> (usize, [f64; 3]) {
        let sum = self.ends[self.ends.len() - 1];
        let at = sum * (i as f64 + 0.5) / n as f64;
        let t = self.ends.partition_point(|&e| e <= at).min(self.ends.len() - 1);
        // A fixed sequence, spread evenly over the square, folded into the triangle.
        let part = |step: u64| (i.wrapping_mul(step) >> 11) as f64 / (1u64 << 53) as f64;
        let (mut a, mut b) = (part(0xc13f_a9a9_02a6_328f), part(0x91e1_0da5_c79e_7b1d));
        if a + b > 1.0 {
            (a, b) = (1.0 - a, 1.0 - b);
        }
        (t, [1.0 - a - b, a, b])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_as_the_area_says() {
        let corner = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let large = corner.map(|p| p.map(|c| 2.0 * c));
        let flat = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        let scatter = Scatter::new([corner, flat, large]);
        let (mut counts, mut left) = ([0; 3], 0);
        for i in 0..10_000 {
            let (t, w) = scatter.point(i, 10_000);
            counts[t] += 1;
            assert!(w.iter().all(|&w| (0.0..=1.0).contains(&w)) && (w.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            left += usize::from(w[1] < 1.0 - 0.5f64.sqrt());
        }
        assert_eq!(counts, [2000, 0, 8000]);
        // Half of a right triangle lies to the left of there.
        assert!((left as f64 - 5000.0).abs() < 100.0, "{left}");
        assert!(Scatter::new([flat]).is_empty() && Scatter::new([]).is_empty());
    }
}
