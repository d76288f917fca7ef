//! Ground, height and built area of every cluster, from its buildings': one sweep up the tree, subtrees in parallel.

use super::Height;
use super::walk::{GRAIN, Walk};

/// A building's height and what it weighs.
type Item = (f64, f64);

/// What a cluster hands to its parent: sums over its buildings. Areas in doubled square millimetres.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Area, and area times ground and height.
    weighted: [f64; 3],
    /// Ground and height: members without any area weigh alike.
    plain: [f64; 2],
    /// Area of the union.
    union: f64,
}

/// Of one inner node.
#[derive(Clone, Copy, Default)]
pub struct Row {
    pub ground: f64,
    pub height: f64,
    /// Doubled area of the union of its buildings.
    pub union: f64,
}

pub struct Sweep<'a> {
    pub walk: &'a Walk<'a>,
    pub how: Height,
    /// By building.
    pub base: &'a [f64],
    pub above: &'a [f64],
    pub own: &'a [f64],
    /// By cluster: what its children's unions cover both.
    pub twice: &'a [f64],
}

impl Sweep<'_> {
    /// Of all inner nodes, in postorder.
    pub fn rows(&self) -> Vec<Row> {
        let Some(root) = self.walk.root() else { return Vec::new() };
        let mut rows = vec![Row::default(); self.walk.tree.left.len()];
        let leaves = if self.how == Height::Median { self.walk.tree.leaf_count() } else { 0 };
        let (mut items, mut spare) = (vec![Item::default(); leaves], vec![Item::default(); leaves]);
        self.subtree(root, &mut items, &mut spare, &mut rows);
        rows
    }

    /// The subtree at a place of the postorder; `items` (none unless they are asked for) end sorted by height.
    fn subtree(&self, top: usize, items: &mut [Item], spare: &mut [Item], rows: &mut [Row]) -> Sums {
        let Some(([left, right], [a, _])) = self.walk.children(top).filter(|_| rows.len() as u32 >= GRAIN) else {
            return self.sequential(top, items, spare, rows);
        };
        let middle = (a as usize).min(items.len());
        let (row, rows) = rows.split_last_mut().expect("a row an inner node");
        let (sums_l, sums_r) = {
            let ((items_l, items_r), (spare_l, spare_r)) = (items.split_at_mut(middle), spare.split_at_mut(middle));
            let (rows_l, rows_r) = rows.split_at_mut(a as usize - 1);
            rayon::join(
                || self.subtree(left, items_l, spare_l, rows_l),
                || self.subtree(right, items_r, spare_r, rows_r),
            )
        };
        let (sums, own) = self.node(top, sums_l, sums_r, items, middle, spare);
        *row = own;
        sums
    }

    fn sequential(&self, top: usize, items: &mut [Item], spare: &mut [Item], rows: &mut [Row]) -> Sums {
        let n = self.walk.tree.leaf_count();
        let mut done: Vec<(Sums, usize)> = Vec::new();
        let (mut leaf, mut inner) = (0, 0);
        for place in self.walk.subtree(top) {
            let cluster = self.walk.postorder[place] as usize;
            if cluster < n {
                let (own, ground, height) = (self.own[cluster], self.base[cluster], self.above[cluster]);
                if let Some(item) = items.get_mut(leaf) {
                    *item = (height, own);
                }
                let weighted = [own, own * ground, own * height];
                done.push((Sums { weighted, plain: [ground, height], union: own }, leaf));
                leaf += 1;
                continue;
            }
            let ((r, middle), (l, from)) = (done.pop().expect("two children"), done.pop().expect("two children"));
            let all = items.len();
            let mine = &mut items[from.min(all)..leaf.min(all)];
            let (sums, row) = self.node(place, l, r, mine, middle - from, spare);
            rows[inner] = row;
            inner += 1;
            done.push((sums, from));
        }
        done.pop().expect("the top").0
    }

    fn node(
        &self,
        place: usize,
        l: Sums,
        r: Sums,
        items: &mut [Item],
        middle: usize,
        spare: &mut [Item],
    ) -> (Sums, Row) {
        let cluster = self.walk.postorder[place];
        let sums = Sums {
            weighted: [0, 1, 2].map(|k| l.weighted[k] + r.weighted[k]),
            plain: [0, 1].map(|k| l.plain[k] + r.plain[k]),
            union: l.union + r.union - self.twice[cluster as usize],
        };
        let [area, ..] = sums.weighted;
        let size = f64::from(self.walk.size(place));
        let mean = |k: usize| if area > 0.0 { sums.weighted[k + 1] / area } else { sums.plain[k] / size };
        let height = if items.is_empty() {
            mean(1)
        } else {
            merge(items, middle, spare);
            median(items)
        };
        (sums, Row { ground: mean(0), height, union: sums.union })
    }
}

/// Two sorted runs into one; of equal heights the left run's first.
fn merge(items: &mut [Item], middle: usize, spare: &mut [Item]) {
    if items[middle - 1].0 <= items[middle].0 {
        return;
    }
    let left = &mut spare[..middle];
    left.copy_from_slice(&items[..middle]);
    let (mut i, mut j) = (0, middle);
    for k in 0..items.len() {
        if i == middle {
            break;
        }
        if j == items.len() || left[i].0 <= items[j].0 {
            items[k] = left[i];
            i += 1;
        } else {
            items[k] = items[j];
            j += 1;
        }
    }
}

/// The smallest height that half of the weight does not exceed.
fn median(sorted: &[Item]) -> f64 {
    let total: f64 = sorted.iter().map(|i| i.1).sum();
    let even = total <= 0.0;
    let half = if even { sorted.len() as f64 } else { total } / 2.0;
    let mut below = 0.0;
    for &(height, weight) in sorted {
        below += if even { 1.0 } else { weight };
        if below >= half {
            return height;
        }
    }
    sorted.last().map_or(0.0, |i| i.0)
}
