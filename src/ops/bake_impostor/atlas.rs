//! Where pieces lie in the atlas, and their texels with what is bled around them.

use guillotiere::{SimpleAtlasAllocator, size2};
use rayon::prelude::*;

use super::canvas::{Texel, neighbours};
use super::pieces::Piece;
use crate::io::picture::Level;

/// Texels around each piece: as many smaller copies as [`COPIES`] stay clean.
pub const GUTTER: u32 = 8;
/// Smaller copies that are looked after, each half the size of the one before.
pub const COPIES: usize = 4;
/// Sides of the atlas are multiples of this, so that each texel of the last copy has whole ones under it.
const STEP: u32 = 1 << COPIES;

pub struct Packed {
    pub size: [u32; 2],
    /// Left upper texel of each piece, without its gutter.
    pub places: Vec<[u32; 2]>,
}

/// Into the smallest square, cut off below what is used; none where `most` is too small.
pub fn pack(sizes: &[[u32; 2]], most: u32) -> Option<Packed> {
    let padded: Vec<[u32; 2]> = sizes.iter().map(|s| s.map(|s| s + 2 * GUTTER)).collect();
    let longest = padded.iter().flatten().copied().max().unwrap_or(STEP);
    let area: u64 = padded.iter().map(|s| u64::from(s[0]) * u64::from(s[1])).sum();
    let most = most / STEP * STEP;
    if longest > most || area > u64::from(most) * u64::from(most) {
        return None;
    }
    let mut order: Vec<usize> = (0..padded.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(padded[i][1].max(padded[i][0])), std::cmp::Reverse(padded[i]), i));
    let mut side = longest.max((area as f64).sqrt() as u32).next_multiple_of(STEP).max(STEP);
    while side <= most {
        if let Some(places) = try_side(&padded, &order, side) {
            let lowest = |i: usize| places[i][1] + padded[i][1] - GUTTER;
            let height = (0..padded.len()).map(lowest).max().unwrap_or(STEP).next_multiple_of(STEP);
            return Some(Packed { size: [side, height], places });
        }
        // By about one part in fifty: some hundred tries at most.
        side = (side + side / 50).next_multiple_of(STEP).max(side + STEP);
    }
    None
}

fn try_side(padded: &[[u32; 2]], order: &[usize], side: u32) -> Option<Vec<[u32; 2]>> {
    let mut free = SimpleAtlasAllocator::new(size2(side as i32, side as i32));
    let mut places = vec![[0; 2]; padded.len()];
    for &i in order {
        let [w, h] = padded[i].map(|s| s as i32);
        let place = free.allocate(size2(w, h))?;
        places[i] = [place.min.x as u32 + GUTTER, place.min.y as u32 + GUTTER];
    }
    Some(places)
}

pub struct Atlas {
    pub colour: Level,
    /// Normals along right, up and outside of each quad, 0 to 255 for -1 to 1; where they were asked for.
    pub normals: Option<Level>,
    /// Share of texels that are drawn.
    pub filled: f64,
    /// Of each smaller copy the area that is drawn, of that of the atlas itself.
    pub coverage: [f64; COPIES],
}

/// A piece with its gutter.
struct Patch {
    size: [usize; 2],
    colour: Vec<[u8; 3]>,
    normals: Option<Vec<[u8; 3]>>,
    alpha: Vec<u8>,
}

impl Atlas {
    pub fn fill(pieces: &[Piece], packed: &Packed, with_normals: bool) -> Self {
        let patches: Vec<Patch> = pieces.par_iter().map(|p| Patch::new(p, with_normals)).collect();
        let [width, height] = packed.size;
        let level = |of: [u8; 4]| Level { width, height, texels: vec![of; (width * height) as usize] };
        let (mut colour, mut normals) = (level([0; 4]), with_normals.then(|| level([128, 128, 255, 255])));
        for (patch, [left, top]) in patches.iter().zip(&packed.places) {
            for i in 0..patch.alpha.len() {
                let (x, y) = (left - GUTTER + (i % patch.size[0]) as u32, top - GUTTER + (i / patch.size[0]) as u32);
                let at = (y * width + x) as usize;
                let with = |[r, g, b]: [u8; 3], alpha: u8| [r, g, b, alpha];
                colour.texels[at] = with(patch.colour[i], patch.alpha[i]);
                if let (Some(all), Some(own)) = (&mut normals, &patch.normals) {
                    all.texels[at] = with(own[i], OPAQUE);
                }
            }
        }
        let alpha: Vec<u8> = colour.texels.iter().map(|t| t[3]).collect();
        let filled = alpha.iter().filter(|&&a| a == OPAQUE).count();
        let coverage = covered(&alpha, packed.size.map(|s| s as usize)).map(|n| n / filled.max(1) as f64);
        let filled = filled as f64 / (f64::from(width) * f64::from(height));
        Self { colour, normals, filled, coverage }
    }
}

const OPAQUE: u8 = 255;
/// What lies around a piece may have one of these: less than the half that is drawn.
const AROUND: [u8; 7] = [0, 16, 32, 48, 64, 80, 96];

impl Patch {
    fn new(piece: &Piece, with_normals: bool) -> Self {
        let [w, h] = piece.window.size.map(|s| s as usize);
        let gutter = GUTTER as usize;
        let size = [w + 2 * gutter, h + 2 * gutter];
        let shown = || piece.texels.iter().enumerate().filter_map(|(i, t)| Some((i, t.as_ref()?)));
        let at = |i: usize| (i / w + gutter) * size[0] + i % w + gutter;
        let all = |of: fn(&Texel) -> [u8; 3]| {
            let mut out = vec![None; size[0] * size[1]];
            shown().for_each(|(i, texel)| out[at(i)] = Some(of(texel)));
            bled(out, size.map(|s| s as u32))
        };
        let mut alpha = vec![0; size[0] * size[1]];
        shown().for_each(|(i, _)| alpha[at(i)] = OPAQUE);
        // Thin parts would be lost in smaller copies: what lies around gets the alpha that keeps their area best.
        let losses = losses(&alpha, size).into_iter().zip(AROUND);
        let around = losses.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, a)| a);
        alpha.iter_mut().filter(|a| **a == 0).for_each(|a| *a = around);
        let normal = |t: &Texel| t.normal.map(|c| (c.clamp(-1.0, 1.0) * 127.0 + 128.0).round() as u8);
        Self { size, colour: all(|t| t.colour), normals: with_normals.then(|| all(normal)), alpha }
    }
}

/// How far the area drawn of smaller copies, and of one twice as large, is off where the surroundings have each alpha of
/// [`AROUND`].
fn losses(alpha: &[u8], size: [usize; 2]) -> [f64; AROUND.len()] {
    let whole = alpha.iter().filter(|&&a| a == OPAQUE).count() as f64;
    let doubled = doubled(alpha, size);
    AROUND.map(|around| {
        let given: Vec<u8> = alpha.iter().map(|&a| if a == OPAQUE { a } else { around }).collect();
        let copies: f64 = covered(&given, size).iter().map(|n| (n - whole).abs()).sum();
        let mixed = |k: usize| k * usize::from(OPAQUE) + (16 - k) * usize::from(around);
        let shown = (0..=16).filter(|&k| 2 * mixed(k) >= 16 * usize::from(OPAQUE));
        let twice = shown.map(|k| doubled[k]).sum::<usize>() as f64 / 4.0;
        copies + 2.0 * (twice - whole).abs()
    })
}

/// Texels of the picture under those of each smaller copy (means of 2 x 2) that are drawn.
fn covered(alpha: &[u8], size: [usize; 2]) -> [f64; COPIES] {
    let mut sums: Vec<u32> = alpha.iter().map(|&a| u32::from(a)).collect();
    let mut size = size;
    let mut under = 1u32;
    [(); COPIES].map(|()| {
        let half = size.map(|s| s.div_ceil(2));
        let at = |x: usize, y: usize| if x < size[0] && y < size[1] { sums[y * size[0] + x] } else { 0 };
        let four = |x: usize, y: usize| at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1);
        sums = (0..half[0] * half[1]).map(|i| four(i % half[0] * 2, i / half[0] * 2)).collect();
        (size, under) = (half, under * 4);
        let drawn = sums.iter().filter(|&&s| 2 * s >= u32::from(OPAQUE) * under).count();
        drawn as f64 * f64::from(under)
    })
}

/// Seen at twice its size, in how many texels the drawn ones of the picture have each number of sixteenths.
fn doubled(alpha: &[u8], size: [usize; 2]) -> [usize; 17] {
    let drawn = |row: usize, x: usize| usize::from(alpha[row * size[0] + x] == OPAQUE);
    let mut out = [0; 17];
    for y in 0..size[1] {
        let [above, below] = [y.saturating_sub(1), (y + 1).min(size[1] - 1)];
        // Of three columns the rows above, here and below.
        let column = |x: usize| [above, y, below].map(|row| drawn(row, x));
        let (mut left, mut here) = (column(0), column(0));
        for x in 0..size[0] {
            let right = column((x + 1).min(size[0] - 1));
            for [a, b, c] in [left, right].map(|side| [0, 1, 2].map(|k| 3 * here[k] + side[k])) {
                out[3 * b + a] += 1;
                out[3 * b + c] += 1;
            }
            (left, here) = (here, right);
        }
    }
    out
}

/// Ring by ring: the mean of what is there already.
fn bled(mut own: Vec<Option<[u8; 3]>>, size: [u32; 2]) -> Vec<[u8; 3]> {
    let mut edge: Vec<usize> = (0..own.len()).filter(|&i| own[i].is_some()).collect();
    let mut known: Vec<bool> = own.iter().map(Option::is_some).collect();
    while !edge.is_empty() {
        let is_new = |j: &usize| !std::mem::replace(&mut known[*j], true);
        let ring: Vec<usize> = edge.iter().flat_map(|&i| neighbours(i, size)).filter(is_new).collect();
        let mean = |j: &usize| {
            let (mut sum, mut n) = ([0u32; 3], 0);
            for c in neighbours(*j, size).filter_map(|i| own[i]) {
                (0..3).for_each(|k| sum[k] += u32::from(c[k]));
                n += 1;
            }
            sum.map(|s| ((s + n / 2) / n) as u8)
        };
        let colours: Vec<[u8; 3]> = ring.iter().map(mean).collect();
        ring.iter().zip(colours).for_each(|(&j, c)| own[j] = Some(c));
        edge = ring;
    }
    own.into_iter().map(Option::unwrap_or_default).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_overlaps() {
        let sizes: Vec<[u32; 2]> = (1..40u32).map(|i| [i * 7 % 50 + 1, i * 13 % 30 + 1]).collect();
        let packed = pack(&sizes, 512).unwrap();
        let mut seen = vec![false; (packed.size[0] * packed.size[1]) as usize];
        for ([w, h], [x, y]) in sizes.iter().zip(&packed.places) {
            for v in y - GUTTER..y + h + GUTTER {
                for u in x - GUTTER..x + w + GUTTER {
                    assert!(!std::mem::replace(&mut seen[(v * packed.size[0] + u) as usize], true));
                }
            }
        }
        let used = seen.iter().filter(|&&s| s).count() as f64 / seen.len() as f64;
        assert!(used > 0.6, "{used}");
        assert!(pack(&sizes, 128).is_none());
        assert_eq!(pack(&[], 64).unwrap().size, [16, 16]);
    }

    /// Bars of five texels, sixteen apart, keep about their area in all copies; a square keeps sharp edges.
    #[test]
    fn thin_parts_stay() {
        let size = [64, 64];
        let picture = |drawn: &dyn Fn(usize, usize) -> bool| -> Vec<u8> {
            (0..64 * 64).map(|i| if drawn(i % 64, i / 64) { OPAQUE } else { 0 }).collect()
        };
        let best = |alpha: &[u8]| {
            let all = losses(alpha, size).into_iter().zip(AROUND);
            all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
        };
        let bars = picture(&|x, _| (5..10).contains(&(x % 16)));
        assert_eq!(covered(&bars, size)[2..], [0.0; 2]);
        let (least, around) = best(&bars);
        assert!(around > 0 && least < losses(&bars, size)[0], "{around}: {least}");
        let square = picture(&|x, y| (16..48).contains(&x) && (16..48).contains(&y));
        assert_eq!(covered(&square, size), [1024.0; COPIES]);
        assert_eq!(best(&square).1, 0);
    }
}
