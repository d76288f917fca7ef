//! CSV: tables with a header, RFC 4180 quoting, `\n` line ends.

use std::fmt::Write;

use crate::artifact::{Dendrogram, Landmarks};
use crate::diag::{Note, Result};

/// `left,right,distance,cost,size,crosses_barrier`: one merge a line, in merge order. Leaves are 0..n-1 in input
/// order, merge i is cluster n + i. Distances in metres.
pub fn dendrogram(tree: &Dendrogram) -> Result<Vec<u8>> {
    let mut out = String::from("left,right,distance,cost,size,crosses_barrier\n");
    for i in 0..tree.left.len() {
        let (left, right, size) = (tree.left[i], tree.right[i], tree.size[i]);
        let (distance, cost, crosses) = (tree.distance[i], tree.cost[i], tree.crosses_barrier[i]);
        writeln!(out, "{left},{right},{distance},{cost},{size},{crosses}").expect("memory takes all");
    }
    Ok(out.into_bytes())
}

/// `cluster,buildings,height,tallest,tallest_height`: one cluster a line (leaves first, as in the dendrogram), its
/// mean height, and its tallest building (input row; of equals the first in leaf order). Heights in metres.
pub fn landmarks(all: &Landmarks) -> Result<Vec<u8>> {
    let mut out = String::from("cluster,buildings,height,tallest,tallest_height\n");
    for cluster in 0..all.first.len() {
        let (first, size) = (all.first[cluster] as usize, all.size[cluster]);
        let height = all.cluster_height[cluster];
        match tallest(all, first..first + size as usize) {
            Some(at) => writeln!(out, "{cluster},{size},{height},{},{}", all.order[at], all.height[at]),
            None => writeln!(out, "{cluster},{size},{height},,"),
        }
        .expect("memory takes all");
    }
    Ok(out.into_bytes())
}

/// Place of the largest height in a range; of equals the first. Cost O(log n), by the tree of maxima.
fn tallest(all: &Landmarks, range: std::ops::Range<usize>) -> Option<usize> {
    let width = all.maxima.len() / 2;
    // The maximum first, then the first place that has it.
    let mut most = f64::NEG_INFINITY;
    let (mut low, mut high) = (range.start + width, range.end + width);
    while low < high {
        if low % 2 == 1 {
            most = most.max(all.maxima[low]);
            low += 1;
        }
        if high % 2 == 1 {
            high -= 1;
            most = most.max(all.maxima[high]);
        }
        (low, high) = (low / 2, high / 2);
    }
    let mut stack = vec![(1usize, 0usize, width)];
    while let Some((node, from, to)) = stack.pop() {
        if to <= range.start || range.end <= from || all.maxima.get(node).is_none_or(|&m| m < most) {
            continue;
        }
        if node >= width {
            return Some(from);
        }
        let middle = (from + to) / 2;
        stack.push((2 * node + 1, middle, to));
        stack.push((2 * node, from, middle));
    }
    None
}

/// `id,place,cause`: features that were left out, in input order.
pub fn rejects(notes: &[Note]) -> Vec<u8> {
    let rows = notes.iter().map(|n| vec![n.id.clone(), n.place.clone(), n.cause.clone()]);
    table(&["id", "place", "cause"], rows)
}

/// A table of texts.
pub fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> Vec<u8> {
    let mut out = String::new();
    let mut line = |cells: &mut dyn Iterator<Item = &str>| {
        for (i, cell) in cells.enumerate() {
            out.push_str(if i == 0 { "" } else { "," });
            match cell.contains([',', '"', '\n', '\r']) {
                true => write!(out, "\"{}\"", cell.replace('"', "\"\"")).expect("memory takes all"),
                false => out.push_str(cell),
            }
        }
        out.push('\n');
    };
    line(&mut header.iter().copied());
    rows.into_iter().for_each(|row| line(&mut row.iter().map(String::as_str)));
    out.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_where_needed() {
        let rows = [vec!["a,b".to_string(), "say \"x\"".to_string()], vec!["plain".to_string(), String::new()]];
        assert_eq!(table(&["id", "place"], rows), b"id,place\n\"a,b\",\"say \"\"x\"\"\"\nplain,\n");
    }

    #[test]
    fn merges_are_lines() {
        let tree = Dendrogram {
            left: vec![0],
            right: vec![1],
            distance: vec![2.5],
            cost: vec![10.0],
            size: vec![2],
            crosses_barrier: vec![true],
            leaves: vec![2],
        };
        let text = String::from_utf8(dendrogram(&tree).unwrap()).unwrap();
        assert_eq!(text, "left,right,distance,cost,size,crosses_barrier\n0,1,2.5,10,2,true\n");
    }

    #[test]
    fn the_tallest_of_a_range_is_the_scan_s() {
        let height: Vec<f64> = (0..13).map(|i| f64::from(i * 7 % 5)).collect();
        let maxima = Landmarks::maxima_of(&height);
        let all = Landmarks {
            order: (0..13).collect(),
            first: vec![],
            size: vec![],
            cluster_height: vec![],
            height: height.clone(),
            maxima,
        };
        for from in 0..13 {
            for to in from..=13 {
                let mut best = None;
                for i in from..to {
                    if best.is_none_or(|b: usize| height[i] > height[b]) {
                        best = Some(i);
                    }
                }
                assert_eq!(tallest(&all, from..to), best, "{from}..{to}");
            }
        }
    }
}
