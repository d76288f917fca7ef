//! A layered layout: each box one column behind its farthest input, long arrows led through empty places, the order
//! in a column by the mean of the neighbours, a few sweeps forth and back. Deterministic; ties keep their order.

/// Where each box goes, and the places that each arrow passes between its ends.
pub struct Layout {
    /// Column and row of each box; rows are whole or half numbers.
    pub boxes: Vec<(usize, f64)>,
    /// For each arrow its way: (column, row) of the empty places that it passes.
    pub ways: Vec<Vec<(usize, f64)>>,
    pub columns: usize,
    pub rows: f64,
}

/// `arrows` are (from, to) and go from lower to higher numbers.
pub fn layout(boxes: usize, arrows: &[(usize, usize)]) -> Layout {
    // (1) columns
    let mut column = vec![0; boxes];
    let (sources, users) = neighbours(boxes, arrows);
    for to in 0..boxes {
        column[to] = sources[to].iter().map(|&from| column[from] + 1).max().unwrap_or(0);
    }
    // A source stands right before its first user.
    for (from, place) in column.clone().into_iter().enumerate().rev() {
        if place == 0 {
            let first = users[from].iter().map(|&to| column[to]).min();
            column[from] = first.map_or(0, |c| c.max(1) - 1);
        }
    }
    let columns = column.iter().max().map_or(0, |m| m + 1);

    // (2) points: the boxes, then the empty places of long arrows
    let mut at = column.clone();
    let mut links: Vec<(usize, usize)> = Vec::new();
    let mut ways: Vec<Vec<usize>> = Vec::new();
    for &(from, to) in arrows {
        let mut way = Vec::new();
        let mut last = from;
        for c in column[from] + 1..column[to] {
            at.push(c);
            links.push((last, at.len() - 1));
            last = at.len() - 1;
            way.push(last);
        }
        links.push((last, to));
        ways.push(way);
    }
    let mut order: Vec<Vec<usize>> = vec![Vec::new(); columns];
    at.iter().enumerate().for_each(|(point, &c)| order[c].push(point));

    // (3) order within columns
    let mut row = vec![0.0; at.len()];
    let number = |order: &[Vec<usize>], row: &mut [f64]| {
        let tallest = order.iter().map(Vec::len).max().unwrap_or(0) as f64;
        for points in order {
            let start = (tallest - points.len() as f64) / 2.0;
            points.iter().enumerate().for_each(|(i, &p)| row[p] = start + i as f64);
        }
        tallest
    };
    let mut rows = number(&order, &mut row);
    let (before, behind) = neighbours(at.len(), &links);
    for sweep in 0..8 {
        let forth = sweep % 2 == 0;
        for step in 1..columns {
            let c = if forth { step } else { columns - 1 - step };
            let mean = |point: usize| {
                let near = if forth { &before[point] } else { &behind[point] };
                let sum: f64 = near.iter().map(|&p| row[p]).sum();
                if near.is_empty() { row[point] } else { sum / near.len() as f64 }
            };
            let mut keyed: Vec<(f64, usize)> = order[c].iter().map(|&p| (mean(p), p)).collect();
            keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
            order[c] = keyed.into_iter().map(|(_, p)| p).collect();
            rows = number(&order, &mut row);
        }
    }
    Layout {
        boxes: (0..boxes).map(|i| (column[i], row[i])).collect(),
        ways: ways.into_iter().map(|way| way.into_iter().map(|p| (at[p], row[p])).collect()).collect(),
        columns,
        rows,
    }
}

/// For each point those before and those behind it.
fn neighbours(points: usize, links: &[(usize, usize)]) -> (Vec<Vec<usize>>, Vec<Vec<usize>>) {
    let (mut before, mut behind) = (vec![Vec::new(); points], vec![Vec::new(); points]);
    for &(from, to) in links {
        before[to].push(from);
        behind[from].push(to);
    }
    (before, behind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_arrow_gets_a_place_of_its_own() {
        let l = layout(3, &[(0, 1), (1, 2), (0, 2)]);
        assert_eq!(l.boxes.iter().map(|b| b.0).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(l.ways[2].len(), 1);
        assert_ne!(l.ways[2][0].1, l.boxes[1].1);
        assert_eq!((l.columns, l.rows), (3, 2.0));
    }

    #[test]
    fn no_two_boxes_share_a_place() {
        let arrows: Vec<_> = (1..40).flat_map(|to| [(to / 2, to), (to / 3, to)]).filter(|(a, b)| a < b).collect();
        let l = layout(40, &arrows);
        for i in 0..40 {
            for j in 0..i {
                assert!(l.boxes[i].0 != l.boxes[j].0 || (l.boxes[i].1 - l.boxes[j].1).abs() >= 1.0);
            }
        }
        for &(from, to) in &arrows {
            assert!(l.boxes[from].0 < l.boxes[to].0);
        }
        assert_eq!(layout(0, &[]).columns, 0);
        assert_eq!(layout(2, &[]).boxes.iter().map(|b| b.0).max(), Some(0));
    }
}
