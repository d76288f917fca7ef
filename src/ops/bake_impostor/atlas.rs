//! Where pieces lie in the atlas, and their texels with what is bled around them.

use super::canvas::{Canvas, Piece};
use crate::io::picture::{Level, screen};

/// Texels around each piece: four smaller copies stay clean.
pub const GUTTER: u32 = 8;

pub struct Packed {
    pub width: u32,
    pub height: u32,
    /// Left upper texel of each piece, without its gutter.
    pub places: Vec<[u32; 2]>,
}

/// On shelves, the highest pieces first, into the smallest sheet of powers of two; none where `most` is too small.
pub fn pack(pieces: &[(usize, Piece)], most: u32) -> Option<Packed> {
    let mut order: Vec<usize> = (0..pieces.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(pieces[i].1.height()), std::cmp::Reverse(pieces[i].1.width()), i));
    let sides: Vec<u32> = (4..=14).map(|p| 1 << p).filter(|&s| s <= most).collect();
    let mut sheets: Vec<(u32, u32)> = sides.iter().flat_map(|&w| sides.iter().map(move |&h| (w, h))).collect();
    // By area, then the squarest, then the wider.
    sheets.sort_by_key(|&(w, h)| (w as u64 * h as u64, w.max(h), h));
    sheets.into_iter().find_map(|(width, height)| {
        let mut places = vec![[0; 2]; pieces.len()];
        let (mut x, mut y, mut shelf) = (0, 0, 0);
        for &i in &order {
            let (w, h) = (pieces[i].1.width() + 2 * GUTTER, pieces[i].1.height() + 2 * GUTTER);
            if x + w > width {
                (x, y, shelf) = (0, y + shelf, 0);
            }
            if w > width || y + h > height {
                return None;
            }
            places[i] = [x + GUTTER, y + GUTTER];
            x += w;
            shelf = shelf.max(h);
        }
        Some(Packed { width, height, places })
    })
}

pub struct Atlas {
    pub level: Level,
    /// Share of texels that are drawn.
    pub filled: f64,
}

impl Atlas {
    pub fn fill(canvases: &[Canvas], pieces: &[(usize, Piece)], packed: &Packed) -> Self {
        let (width, height) = (packed.width, packed.height);
        let mut texels = vec![[0u8; 4]; (width * height) as usize];
        let mut filled = 0u64;
        for ((k, piece), [left, top]) in pieces.iter().zip(&packed.places) {
            let (w, h) = ((piece.width() + 2 * GUTTER) as usize, (piece.height() + 2 * GUTTER) as usize);
            // (1) Its own texels.
            let mut own: Vec<Option<[u8; 3]>> = vec![None; w * h];
            let mut edge = Vec::new();
            for y in 0..piece.height() {
                for x in 0..piece.width() {
                    if let Some(light) = canvases[*k].at(piece.low[0] + x, piece.low[1] + y) {
                        let i = (y + GUTTER) as usize * w + (x + GUTTER) as usize;
                        own[i] = Some(light.map(screen));
                        edge.push(i);
                    }
                }
            }
            filled += edge.len() as u64;
            let opaque = own.clone();
            // (2) Bled over the whole rectangle, ring by ring: the mean of what is there already.
            while !edge.is_empty() {
                let mut ring = Vec::new();
                for &i in &edge {
                    for j in around(i, w, h) {
                        if own[j].is_none() {
                            ring.push(j);
                        }
                    }
                }
                ring.sort_unstable();
                ring.dedup();
                let mean = |j: &usize| {
                    let (mut sum, mut n) = ([0u32; 3], 0);
                    for c in around(*j, w, h).filter_map(|i| own[i]) {
                        (0..3).for_each(|k| sum[k] += u32::from(c[k]));
                        n += 1;
                    }
                    sum.map(|s| ((s + n / 2) / n) as u8)
                };
                let colours: Vec<[u8; 3]> = ring.iter().map(mean).collect();
                ring.iter().zip(colours).for_each(|(&j, c)| own[j] = Some(c));
                edge = ring;
            }
            // (3) Into the sheet.
            for (i, colour) in own.iter().enumerate() {
                let (x, y) = (left - GUTTER + (i % w) as u32, top - GUTTER + (i / w) as u32);
                let [r, g, b] = colour.unwrap_or_default();
                let alpha = if opaque[i].is_some() { 255 } else { 0 };
                texels[(y * width + x) as usize] = [r, g, b, alpha];
            }
        }
        let filled = filled as f64 / (f64::from(width) * f64::from(height));
        Self { level: Level { width, height, texels }, filled }
    }
}

/// Up to eight neighbours.
fn around(i: usize, w: usize, h: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % w, i / w);
    let rows = y.saturating_sub(1)..=(y + 1).min(h - 1);
    rows.flat_map(move |v| (x.saturating_sub(1)..=(x + 1).min(w - 1)).map(move |u| v * w + u)).filter(move |&j| j != i)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_overlaps() {
        let piece = |w: u32, h: u32| (0, Piece { low: [3, 5], high: [2 + w, 4 + h], texels: 4, two_sided: 0 });
        let pieces: Vec<_> = (1..40u32).map(|i| piece(i * 7 % 50 + 1, i * 13 % 30 + 1)).collect();
        let packed = pack(&pieces, 512).unwrap();
        let mut seen = vec![false; (packed.width * packed.height) as usize];
        for ((_, p), [x, y]) in pieces.iter().zip(&packed.places) {
            for v in y - GUTTER..y + p.height() + GUTTER {
                for u in x - GUTTER..x + p.width() + GUTTER {
                    assert!(!std::mem::replace(&mut seen[(v * packed.width + u) as usize], true));
                }
            }
        }
        assert!(pack(&pieces, 128).is_none());
        assert_eq!(pack(&[], 64).unwrap().width, 16);
    }
}
