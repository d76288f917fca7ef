//! Plan views as SVG: whole decimetres in a fixed number of classes, so that equal layers give equal bytes and small
//! edits small differences. Buildings are shaded by height: thresholds are fixed, not drawn from the data.

use std::collections::BTreeMap;
use std::io::Write;

use crate::artifact::{Footprints, Hulls, Lines};
use crate::diag::Result;
use crate::geom::Point;

/// Upper bounds of the classes in metres; the last class is open.
const HEIGHTS: [f64; 8] = [4.0, 7.0, 10.0, 14.0, 20.0, 30.0, 50.0, 90.0];
/// From sand to ink.
const SHADES: [&str; 9] =
    ["#e3d9c6", "#d8c3a0", "#cba679", "#bd8658", "#a96544", "#8c4a3c", "#6b3439", "#492437", "#2a1733"];
const PAPER: &str = "#faf7f1";
const INK: &str = "#5b4a42";
/// Width of the picture in pixels.
const WIDTH: i64 = 1200;

/// Buildings with their courtyards.
pub fn footprints(layer: &Footprints) -> Result<Vec<u8>> {
    let mut view = View::around(&layer.polygons.points);
    let mut classes: BTreeMap<usize, Vec<u8>> = BTreeMap::new();
    for i in 0..layer.len() {
        let path = classes.entry(class(layer.top[i] - layer.base[i])).or_default();
        for p in layer.polygons.polygons_of(i) {
            for r in layer.polygons.rings_of(p) {
                view.path(path, layer.polygons.ring(r).iter().copied(), true);
            }
        }
    }
    for (class, path) in classes {
        view.shape(&path, &format!("fill=\"{}\"", SHADES[class]));
    }
    Ok(view.finish("fill-rule=\"evenodd\" stroke=\"#faf7f1\" stroke-linejoin=\"round\""))
}

/// Rings, large ones below: of all nodes each cluster lies on its parent.
pub fn hulls(layer: &Hulls) -> Result<Vec<u8>> {
    let mut view = View::around(&layer.vertices);
    let mut order: Vec<usize> = (0..layer.len()).filter(|&i| !layer.ring(i).is_empty()).collect();
    order.sort_by(|&a, &b| layer.area_m2[b].total_cmp(&layer.area_m2[a]).then(layer.cluster[b].cmp(&layer.cluster[a])));
    for i in order {
        let mut path = Vec::new();
        view.path(&mut path, layer.points(i), true);
        view.shape(&path, &format!("fill=\"{}\"", SHADES[class(layer.height[i])]));
    }
    Ok(view.finish("stroke=\"#faf7f1\" stroke-linejoin=\"round\""))
}

pub fn lines(layer: &Lines) -> Result<Vec<u8>> {
    let mut view = View::around(&layer.points);
    let mut path = Vec::new();
    for i in 0..layer.len() {
        view.path(&mut path, layer.line(i).iter().copied(), false);
    }
    view.shape(&path, "");
    Ok(view.finish(&format!("fill=\"none\" stroke=\"{INK}\" stroke-linejoin=\"round\" stroke-linecap=\"round\"")))
}

fn class(height: f64) -> usize {
    HEIGHTS.iter().position(|&h| height < h).unwrap_or(HEIGHTS.len())
}

/// A picture in decimetres, y down, with a margin.
struct View {
    /// West and north edge.
    corner: [i64; 2],
    size: [i64; 2],
    body: Vec<u8>,
}

/// Millimetres to whole decimetres, halves up.
fn decimetres(v: i32) -> i64 {
    (i64::from(v) + 50).div_euclid(100)
}

impl View {
    fn around(points: &[Point]) -> Self {
        let first = points.first().copied().unwrap_or_default();
        let (low, high) = points
            .iter()
            .fold((first, first), |(l, h), p| ([l[0].min(p[0]), l[1].min(p[1])], [h[0].max(p[0]), h[1].max(p[1])]));
        let [x0, y0, x1, y1] = [low[0], low[1], high[0], high[1]].map(decimetres);
        let margin = ((x1 - x0).max(y1 - y0) / 40).max(10);
        Self {
            corner: [x0 - margin, y1 + margin],
            size: [x1 - x0 + 2 * margin, y1 - y0 + 2 * margin],
            body: Vec::new(),
        }
    }

    /// Adds a line or ring in relative steps; steps of nothing are left out.
    fn path(&self, out: &mut Vec<u8>, points: impl Iterator<Item = Point>, closed: bool) {
        let mut last: Option<[i64; 2]> = None;
        for p in points {
            let q = [decimetres(p[0]) - self.corner[0], self.corner[1] - decimetres(p[1])];
            match last {
                None => write!(out, "M{} {}l", q[0], q[1]).expect("memory"),
                Some(l) if l == q => continue,
                Some(l) => {
                    let (dx, dy) = (q[0] - l[0], q[1] - l[1]);
                    if !out.ends_with(b"l") && dx >= 0 {
                        out.push(b' ');
                    }
                    write!(out, "{dx}{}{dy}", if dy >= 0 { " " } else { "" }).expect("memory");
                }
            }
            last = Some(q);
        }
        if out.ends_with(b"l") {
            out.extend(b"0 0");
        }
        if closed && last.is_some() {
            out.push(b'z');
        }
    }

    fn shape(&mut self, path: &[u8], style: &str) {
        if !path.is_empty() {
            let space = if style.is_empty() { "" } else { " " };
            write!(self.body, "<path{space}{style} d=\"").expect("memory");
            self.body.extend(path);
            self.body.extend(b"\"/>\n");
        }
    }

    fn finish(self, style: &str) -> Vec<u8> {
        let [w, h] = self.size;
        let pixels = (WIDTH * h + w / 2) / w;
        let mut out = Vec::with_capacity(self.body.len() + 1000);
        let line = (w / 2400).max(1);
        writeln!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{pixels}\" viewBox=\"0 0 {w} {h}\">\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"{PAPER}\"/>\n<g {style} stroke-width=\"{line}\">"
        )
        .expect("memory");
        out.extend(&self.body);
        // A scale of 1, 2 or 5 times a power of ten metres, below a fifth of the width.
        let mut bar = 10;
        while let Some(longer) = [2, 5, 10].map(|k| k * bar).into_iter().rev().find(|&b| b <= w / 5) {
            bar = longer;
            if w / 5 < 2 * bar {
                break;
            }
        }
        let (x, y, text) = (w / 40, h - h / 40, w / 60);
        let name = if bar >= 10_000 { format!("{} km", bar / 10_000) } else { format!("{} m", bar / 10) };
        writeln!(
            out,
            "</g>\n<g fill=\"{INK}\" font-family=\"sans-serif\" font-size=\"{text}\">\
             <rect x=\"{x}\" y=\"{}\" width=\"{bar}\" height=\"{}\"/><text x=\"{x}\" y=\"{}\">{name}</text></g>\n</svg>",
            y - text / 5,
            (text / 5).max(1),
            y - text / 2
        )
        .expect("memory");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::{Attributes, Shapes};
    use crate::geom::frame::Frame;

    #[test]
    fn one_house_with_a_yard() {
        let mut polygons = Shapes::default();
        polygons.push_ring(&[[0, 0], [10_000, 0], [10_000, 10_000], [0, 10_000]]);
        polygons.push_ring(&[[2_000, 2_000], [2_000, 4_000], [4_000, 4_000]]);
        polygons.end_polygon();
        polygons.end_shape();
        let layer = Footprints {
            frame: Frame::local(),
            ids: ["a"].iter().collect(),
            polygons,
            base: vec![0.0],
            top: vec![8.0],
            attributes: Attributes::default(),
        };
        let text = String::from_utf8(footprints(&layer).unwrap()).unwrap();
        assert!(text.contains("viewBox=\"0 0 120 120\""), "{text}");
        assert!(text.contains("<path fill=\"#cba679\" d=\"M10 110l100 0 0-100-100 0zM30 90l0-20 20 0z\"/>"), "{text}");
        assert!(text.contains(">2 m</text>"), "{text}");
    }

    #[test]
    fn nothing_is_a_picture_too() {
        let layer = Lines { frame: Frame::local(), ids: Default::default(), starts: vec![0], points: Vec::new() };
        let text = String::from_utf8(lines(&layer).unwrap()).unwrap();
        assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
        // A line of one point is drawn as a dot, not as a mistake.
        let layer = Lines { starts: vec![0, 2], points: vec![[5, 5], [5, 5]], ids: ["a"].iter().collect(), ..layer };
        assert!(String::from_utf8(lines(&layer).unwrap()).unwrap().contains("M10 10l0 0"));
    }

    #[test]
    fn classes() {
        assert_eq!([0.0, 3.99, 4.0, 89.0, 90.0, 500.0].map(class), [0, 0, 1, 7, 8, 8]);
    }
}
