//! The drawing as SVG: boxes in columns, arrows as curves. Readable on light and dark pages.

use super::Drawing;
use super::layout::{Layout, layout};

/// Fill of each state.
pub const STATES: [(&str, &str); 3] = [("cached", "#d9ead3"), ("run", "#fce5cd"), ("may-run", "#fff2cc")];

pub fn fill(state: &str) -> Option<&'static str> {
    STATES.iter().find(|(name, _)| *name == state).map(|(_, fill)| *fill)
}

const CHAR: f64 = 7.3;
const LINE: f64 = 17.0;
const GAP: f64 = 26.0;
const TOP: f64 = 40.0;
const EDGE: f64 = 16.0;
/// Between two arrows that arrive at one box.
const SPREAD: f64 = 15.0;

pub fn draw(drawing: &Drawing) -> String {
    let arrows: Vec<_> = drawing.arrows.iter().map(|a| (a.from, a.to)).collect();
    let plan = layout(drawing.boxes.len(), &arrows);
    let lines: Vec<Vec<String>> = drawing.boxes.iter().map(super::Box::lines).collect();
    let users = |i: usize| drawing.arrows.iter().filter(|a| a.to == i).count() as f64;
    let most = (0..lines.len()).map(users).fold(0.0, f64::max);
    let high = (lines.iter().map(Vec::len).max().unwrap_or(1) as f64 * LINE + 14.0).max(most * SPREAD);

    // Columns as wide as their widest box, gaps as wide as the longest label on an arrow that ends behind them.
    let wide = |texts: &[String]| texts.iter().map(|l| l.chars().count()).max().unwrap_or(0) as f64 * CHAR + 20.0;
    let mut widths = vec![60.0f64; plan.columns];
    let mut gaps = vec![50.0f64; plan.columns + 1];
    for (b, texts) in plan.boxes.iter().zip(&lines) {
        widths[b.0] = widths[b.0].max(wide(texts));
    }
    for a in &drawing.arrows {
        let gap = &mut gaps[plan.boxes[a.to].0];
        *gap = gap.max(a.port.chars().count() as f64 * CHAR * 0.8 + 56.0);
    }
    let mut left = vec![EDGE];
    for c in 1..=plan.columns {
        let before = left[c - 1] + widths[c - 1];
        left.push(before + if c < plan.columns { gaps[c] } else { EDGE });
    }
    let middle = |row: f64| TOP + row * (high + GAP) + high / 2.0;
    let total_wide = left[plan.columns].max(drawing.title.chars().count() as f64 * CHAR * 1.1 + 2.0 * EDGE);
    let total_high = TOP + plan.rows * (high + GAP);

    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {total_wide:.0} {total_high:.0}\" width=\"{total_wide:.0}\" height=\"{total_high:.0}\" role=\"img\">\n\
         <style>\n\
         text {{ font: 12px ui-monospace, monospace; fill: #222 }}\n\
         .title {{ font: bold 14px sans-serif; fill: #777 }}\n\
         .name {{ font-weight: bold }}\n\
         .port {{ font-size: 10px; fill: #777; text-anchor: end }}\n\
         .arrow {{ fill: none; stroke: #888; stroke-width: 1.3 }}\n\
         rect {{ fill: #f6f6f6; stroke: #666 }}\n\
         {}</style>\n\
         <defs><marker id=\"head\" viewBox=\"0 0 8 8\" refX=\"8\" refY=\"4\" markerWidth=\"7\" markerHeight=\"7\" orient=\"auto\">\
         <path d=\"M0 0 8 4 0 8z\" fill=\"#888\"/></marker></defs>\n\
         <text class=\"title\" x=\"{EDGE}\" y=\"22\">{}</text>\n",
        STATES.map(|(state, fill)| format!("rect.{state} {{ fill: {fill} }}\n")).concat(),
        escaped(&drawing.title),
    );
    let arrivals = arrivals(&arrows, &plan);
    for ((arrow, way), arrival) in drawing.arrows.iter().zip(&plan.ways).zip(arrivals) {
        let (from, to) = (plan.boxes[arrow.from], plan.boxes[arrow.to]);
        let mut at = (left[from.0] + wide(&lines[arrow.from]), middle(from.1));
        let mut path = format!("M{:.1} {:.1}", at.0, at.1);
        for &(c, row) in way {
            path += &curve(at, (left[c], middle(row)));
            at = (left[c] + widths[c], middle(row));
            path += &format!(" L{:.1} {:.1}", at.0, at.1);
        }
        let end = (left[to.0], middle(to.1) + arrival * SPREAD);
        path += &curve(at, end);
        out += &format!("<path class=\"arrow\" d=\"{path}\" marker-end=\"url(#head)\"/>\n");
        let (x, y) = (end.0 - 10.0, end.1 - 4.0);
        out += &format!("<text class=\"port\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>\n", escaped(&arrow.port));
    }
    for ((b, place), texts) in drawing.boxes.iter().zip(&plan.boxes).zip(&lines) {
        let (x, w) = (left[place.0], wide(texts));
        let h = texts.len() as f64 * LINE + 14.0;
        let y = middle(place.1) - h / 2.0;
        let round = if b.output.is_some() { 0 } else { 6 };
        out += &format!("<g><title>{}</title>\n", escaped(&format!("{} gives {}", b.operator, b.kind)));
        out += &format!(
            "<rect class=\"{}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" rx=\"{round}\"/>\n",
            b.state
        );
        for (i, text) in texts.iter().enumerate() {
            let class = if i == 0 { " class=\"name\"" } else { "" };
            let base = y + 7.0 + LINE * i as f64 + 12.0;
            out += &format!("<text{class} x=\"{:.1}\" y=\"{base:.1}\">{}</text>\n", x + 10.0, escaped(text));
        }
        out += "</g>\n";
    }
    out + "</svg>\n"
}

/// How far above or below its box's middle each arrow arrives, in steps: in the order of where they come from.
fn arrivals(arrows: &[(usize, usize)], plan: &Layout) -> Vec<f64> {
    let mut at: Vec<Vec<(f64, usize)>> = vec![Vec::new(); plan.boxes.len()];
    for (i, &(from, to)) in arrows.iter().enumerate() {
        let row = plan.ways[i].last().map_or(plan.boxes[from].1, |last| last.1);
        at[to].push((row, i));
    }
    let mut out = vec![0.0; arrows.len()];
    for mut here in at {
        here.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (place, &(_, i)) in here.iter().enumerate() {
            out[i] = place as f64 - (here.len() as f64 - 1.0) / 2.0;
        }
    }
    out
}

/// A curve that leaves and arrives level.
fn curve(from: (f64, f64), to: (f64, f64)) -> String {
    let half = (from.0 + to.0) / 2.0;
    format!(" C{half:.1} {:.1} {half:.1} {:.1} {:.1} {:.1}", from.1, to.1, to.0, to.1)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
