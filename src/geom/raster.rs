//! Which pixels a triangle covers: whole numbers, so that triangles that share an edge leave no pixel out, take none
//! twice, and every machine agrees.
//!
//! Coordinates are parts of a pixel, x right, y down; a pixel is covered where its middle is inside, on an upper or left
//! edge too. Cost: O(pixels of the box).

/// Parts of a pixel.
pub const PARTS: i64 = 256;
/// Largest coordinate: products of two differences stay below 2^62.
pub const MOST: i64 = 1 << 29;

/// Twice the signed area: positive where the corners turn clockwise as one sees them (y is down).
pub fn doubled_area([a, b, c]: &[[i64; 2]; 3]) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Calls `at` with x, y and the corners' weights for each pixel of a `width` x `height` canvas that the triangle covers,
/// whichever way it turns. Triangles without an area cover nothing.
#[inline]
pub fn cover(triangle: &[[i64; 2]; 3], size: [u32; 2], mut at: impl FnMut(u32, u32, [f64; 3])) {
    // One division a triangle.
    let part = 1.0 / doubled_area(triangle).abs().max(1) as f64;
    values(triangle, size, |x, y, values, _| at(x, y, values.map(|v| v as f64 * part)));
}

/// What [`values`] gives for one pixel, inside or not.
pub fn value_at(triangle: &[[i64; 2]; 3], pixel: [u32; 2]) -> ([i64; 3], i64) {
    let [a, b, c] = *triangle;
    let p = pixel.map(|v| i64::from(v) * PARTS + PARTS / 2);
    let area = doubled_area(triangle);
    ([[p, b, c], [a, p, c], [a, b, p]].map(|part| area.signum() * doubled_area(&part)), area.abs())
}

/// Columns of a triangle's box from which on a row's ends are worked out, three divisions, and not searched for.
const WIDE: i64 = 24;

/// Calls `at` with x, y, a value that grows with each corner's weight, and their sum, twice the area.
#[inline]
pub fn values(triangle: &[[i64; 2]; 3], [width, height]: [u32; 2], mut at: impl FnMut(u32, u32, [i64; 3], i64)) {
    let area = doubled_area(triangle);
    if area == 0 || triangle.iter().flatten().any(|c| c.abs() > MOST) {
        return;
    }
    let sign = area.signum();
    let range = |k: usize, size: u32| {
        let all = triangle.map(|p| p[k]);
        let (low, high) = (all.into_iter().fold(i64::MAX, i64::min), all.into_iter().fold(i64::MIN, i64::max));
        // Middles at or after the lowest corner, at or before the highest.
        let first = (low - PARTS / 2).div_euclid(PARTS) + i64::from((low - PARTS / 2).rem_euclid(PARTS) > 0);
        let last = (high - PARTS / 2).div_euclid(PARTS);
        (first.max(0), last.min(i64::from(size) - 1))
    };
    let ((x0, x1), (y0, y1)) = (range(0, width), range(1, height));
    // Most small ones.
    if x0 > x1 || y0 > y1 {
        return;
    }
    // Edge i is opposite corner i; its value grows inside. What only touches belongs to upper and left edges.
    let edge = |i: usize| {
        let (a, b) = (triangle[(i + 1) % 3], triangle[(i + 2) % 3]);
        let (dx, dy) = (sign * (b[0] - a[0]), sign * (b[1] - a[1]));
        let owns = dy < 0 || dy == 0 && dx > 0;
        let start = dx * (y0 * PARTS + PARTS / 2 - a[1]) - dy * (x0 * PARTS + PARTS / 2 - a[0]);
        (start, -dy * PARTS, dx * PARTS, i64::from(!owns))
    };
    let edges = [edge(0), edge(1), edge(2)];
    let area = sign * area;
    let mut row = edges.map(|e| e.0);
    for y in y0..=y1 {
        let mut value = row;
        if x1 - x0 < WIDE {
            let mut entered = false;
            for x in x0..=x1 {
                if (0..3).all(|i| value[i] >= edges[i].3) {
                    at(x as u32, y as u32, value, area);
                    entered = true;
                } else if entered {
                    // A row goes in and out once.
                    break;
                }
                (0..3).for_each(|i| value[i] += edges[i].1);
            }
        } else if let Some((first, last)) = inside(row, edges.map(|e| (e.1, e.3)), x1 - x0) {
            (0..3).for_each(|i| value[i] += first * edges[i].1);
            for x in x0 + first..=x0 + last {
                at(x as u32, y as u32, value, area);
                (0..3).for_each(|i| value[i] += edges[i].1);
            }
        }
        (0..3).for_each(|i| row[i] += edges[i].2);
    }
}

/// The first and last of `most` steps at which all three values are large enough.
fn inside(row: [i64; 3], edges: [(i64, i64); 3], most: i64) -> Option<(i64, i64)> {
    let (mut first, mut last) = (0, most);
    for (value, (step, least)) in row.into_iter().zip(edges) {
        let lack = least - value;
        match step.signum() {
            1 => first = first.max((lack + step - 1).div_euclid(step)),
            -1 => last = last.min((-lack).div_euclid(-step)),
            _ if lack > 0 => return None,
            _ => {}
        }
    }
    (first <= last).then_some((first, last))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fans around a point in all positions: each pixel of the square exactly once.
    #[test]
    fn fans_cover_once() {
        let size = 16u32;
        for (px, py) in [(7 * 256 + 128, 8 * 256 + 128), (1000, 3000), (2048, 2048), (128, 128), (4000, 77)] {
            let n = 16 * PARTS;
            let ring = [[0, 0], [1234, 0], [n, 0], [n, 128], [n, n], [2000, n], [0, n], [0, 384]];
            let mut count = vec![0u8; 256];
            for i in 0..ring.len() {
                let mut t = [[px, py], ring[i], ring[(i + 1) % ring.len()]];
                if i % 2 == 0 {
                    t.swap(0, 1);
                }
                cover(&t, [size; 2], |x, y, w| {
                    count[(y * size + x) as usize] += 1;
                    let sum: f64 = w.iter().sum();
                    assert!((sum - 1.0).abs() < 1e-12 && w.iter().all(|&w| w >= 0.0));
                    for k in 0..2 {
                        let place: f64 = (0..3).map(|c| w[c] * t[c][k] as f64).sum();
                        assert!((place - f64::from([x, y][k]) * 256.0 - 128.0).abs() < 1e-6);
                    }
                });
            }
            assert!(count.iter().all(|&c| c == 1), "around {px}, {py}");
        }
    }

    /// Long rows give what a look at each pixel gives.
    #[test]
    fn long_rows() {
        let corner = |i: i64| [i * 7919 % 40_000 - 10_000, i * 104_729 % 30_000 - 8_000];
        for i in 0..300 {
            let t = [corner(i), corner(i + 1), if i % 3 == 0 { [corner(i)[0], 9_000] } else { corner(3 * i + 2) }];
            let mut found = Vec::new();
            values(&t, [100, 90], |x, y, values, area| found.push((x, y, values, area)));
            let area = doubled_area(&t);
            let owned = |i: usize| {
                let (a, b) = (t[(i + 1) % 3], t[(i + 2) % 3]);
                let (dx, dy) = (area.signum() * (b[0] - a[0]), area.signum() * (b[1] - a[1]));
                dy < 0 || dy == 0 && dx > 0
            };
            let is_in = |v: [i64; 3]| (0..3).all(|i| v[i] > 0 || v[i] == 0 && owned(i));
            let all = (0..90).flat_map(|y| (0..100).map(move |x| (x, y)));
            let every: Vec<_> = all
                .map(|(x, y)| (x, y, value_at(&t, [x, y])))
                .map(|(x, y, (v, a))| (x, y, v, a))
                .filter(|p| is_in(p.2))
                .collect();
            assert_eq!(found, every, "{t:?}");
        }
    }

    #[test]
    fn nothing_and_far_away() {
        cover(&[[0, 0], [256, 256], [512, 512]], [4; 2], |_, _, _| panic!("no area"));
        cover(&[[5000, 0], [6000, 0], [5000, 900]], [4; 2], |_, _, _| panic!("beside"));
        let mut n = 0;
        cover(&[[-MOST, -MOST], [MOST, -MOST], [-MOST, MOST]], [4; 2], |_, _, _| n += 1);
        // The long edge goes through the canvas' upper left corner.
        assert_eq!(n, 0);
    }
}
