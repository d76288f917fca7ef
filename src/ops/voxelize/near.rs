//! Nodes near a mesh: `surface`.

use rayon::prelude::*;

use super::crossings::{Snapped, UNIT, key_of};
use crate::geom::space::{dot, doubled_area, sub};

/// Nodes within half a cell of a triangle.
pub fn near(mesh: &Snapped) -> Vec<u64> {
    let parts: Vec<Vec<u64>> = mesh
        .triangles
        .par_chunks(2048)
        .map(|triangles| {
            let mut out = Vec::new();
            for t in triangles {
                near_one(&t.map(|v| mesh.vertices[v as usize].map(|c| f64::from(c) / UNIT as f64)), &mut out);
            }
            out.sort_unstable();
            out.dedup();
            out
        })
        .collect();
    parts.concat()
}

fn near_one(t: &[[f64; 3]; 3], out: &mut Vec<u64>) {
    let n = doubled_area(*t);
    let main = (0..3).max_by(|&i, &j| n[i].abs().total_cmp(&n[j].abs())).expect("three axes");
    let (iu, iv) = ((main + 1) % 3, (main + 2) % 3);
    let range = |k: usize| {
        let (low, high) = t.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[k]), h.max(p[k])));
        ((low - 0.5).ceil(), (high + 0.5).floor())
    };
    let [(u0, u1), (v0, v1), (m0, m1)] = [range(iu), range(iv), range(main)];
    let mut v = v0;
    while v <= v1 {
        let mut u = u0;
        while u <= u1 {
            // Along the main axis the plane rises by at most one for one: nodes near the triangle are near its plane.
            let height = if n[main] == 0.0 {
                None
            } else {
                Some(t[0][main] - (n[iu] * (u - t[0][iu]) + n[iv] * (v - t[0][iv])) / n[main])
            };
            let (mut m, end) = height.map_or((m0, m1), |h| ((h - 2.0).ceil().max(m0), (h + 2.0).floor().min(m1)));
            while m <= end {
                let mut p = [0.0; 3];
                (p[iu], p[iv], p[main]) = (u, v, m);
                let off = sub(p, closest(t, p));
                if dot(off, off) <= 0.25 {
                    out.push(key_of(p.map(|c| c as usize)));
                }
                m += 1.0;
            }
            u += 1.0;
        }
        v += 1.0;
    }
}

/// The point of a triangle that is closest to p. Source: Ericson, Real-time collision detection, section 5.1.5.
fn closest(t: &[[f64; 3]; 3], p: [f64; 3]) -> [f64; 3] {
    let along = |a: [f64; 3], d: [f64; 3], s: f64| [a[0] + s * d[0], a[1] + s * d[1], a[2] + s * d[2]];
    let [a, b, c] = *t;
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return along(a, ab, d1 / (d1 - d3));
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return along(a, ac, d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return along(b, sub(c, b), (d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum == 0.0 {
        return a;
    }
    along(along(a, ab, vb / sum), ac, vc / sum)
}
