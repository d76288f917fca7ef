//! STL, binary and as text. Corners that are equal to the bit become one vertex; the normals of facets are not read.

use super::{Draft, Files, MOST, weld::weld};
use crate::diag::{Diagnostic, Result};
use crate::io::ledger::Ledger;

/// Header and count, then 50 bytes a triangle.
const HEAD: usize = 84;
const FACET: usize = 50;

/// Whether the length is the one that the count asks for; of the head of a file whether it can be.
pub fn is_binary(bytes: &[u8]) -> bool {
    bytes.len() >= HEAD && HEAD as u64 + FACET as u64 * count(bytes) == bytes.len() as u64
}

/// Whether it calls itself one and is no text.
pub fn is_named(files: &Files) -> bool {
    let name = files.name.to_ascii_lowercase();
    (name.ends_with(".stl") || name.ends_with(".stl.gz")) && files.bytes.contains(&0)
}

/// What is wrong with one whose length is not what its count asks for.
pub fn wrong_count(files: &Files) -> Box<Diagnostic> {
    let n = files.bytes.len();
    if n < HEAD {
        return files.broken(format!("a binary STL has {HEAD} bytes before its triangles, this has {n}"));
    }
    let (count, room) = (count(files.bytes), (n - HEAD) / FACET);
    files
        .broken(format!("its header promises {count} triangles, but there is room for {room}"))
        .help("the file was cut off or its writer has a bug; fetch or write it again")
}

fn count(bytes: &[u8]) -> u64 {
    u64::from(u32::from_le_bytes(bytes[80..HEAD].try_into().expect("four bytes")))
}

pub fn read(files: &Files, draft: &mut Draft, ledger: &mut Ledger) -> Result<()> {
    let mut corners: Vec<[f64; 3]> = Vec::new();
    // Of each solid its name and its first facet.
    let mut solids: Vec<(String, usize)> = Vec::new();
    if is_binary(files.bytes) {
        solids.push(("mesh".into(), 0));
        let value = |b: &[u8]| f64::from(f32::from_le_bytes(b.try_into().expect("four bytes")));
        for facet in files.bytes[HEAD..].chunks_exact(FACET) {
            for c in 0..3 {
                corners.push([0, 1, 2].map(|k| value(&facet[12 + 12 * c + 4 * k..][..4])));
            }
        }
    } else {
        text(files, &mut corners, &mut solids)?;
    }
    if corners.len() as u64 > 3 * MOST {
        return Err(files.broken(format!("{} triangles are more than the {MOST} that are read", corners.len() / 3)));
    }
    // -0 is 0.
    let keys: Vec<([u64; 3], u32)> = {
        let mut solid = 0;
        let key = |(i, p): (usize, &[f64; 3])| {
            while solids.get(solid + 1).is_some_and(|s| s.1 <= i / 3) {
                solid += 1;
            }
            (p.map(|v| (v + 0.0).to_bits()), solid as u32)
        };
        corners.iter().enumerate().map(key).collect()
    };
    let (number, firsts) = weld(&keys);
    draft.positions = firsts.iter().map(|&i| corners[i as usize].map(|v| v + 0.0)).collect();
    draft.features = firsts.iter().map(|&i| keys[i as usize].1).collect();
    for (s, (name, first)) in solids.iter().enumerate() {
        draft.feature(name);
        let end = solids.get(s + 1).map_or(number.len() / 3, |s| s.1);
        let before = draft.triangles.len();
        for t in *first..end {
            let of = [0, 1, 2].map(|c| u64::from(number[3 * t + c]));
            draft.triangle(of, files, ledger, &|| format!("facet {t}"));
        }
        draft.primitive(name, before, None);
    }
    Ok(())
}

/// `solid NAME`, `facet normal ..`, `outer loop`, three `vertex X Y Z`, `endloop`, `endfacet`, `endsolid`.
fn text(files: &Files, corners: &mut Vec<[f64; 3]>, solids: &mut Vec<(String, usize)>) -> Result<()> {
    let text = String::from_utf8_lossy(files.bytes);
    let mut ended = false;
    for (n, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let wrong = |what: &str| files.broken(format!("line {}: {what}", n + 1));
        let mut words = line.split_ascii_whitespace();
        match words.next().map(str::to_ascii_lowercase).as_deref() {
            Some("vertex") => {
                let mut place = [0.0; 3];
                for v in &mut place {
                    let word = words.next().ok_or_else(|| wrong("a vertex of fewer than three numbers"))?;
                    *v = word.parse().map_err(|_| wrong(&format!("`{word}` is no number")))?;
                }
                corners.push(place);
            }
            Some("solid") => {
                let name = line.trim()[5..].trim();
                solids.push((if name.is_empty() { "mesh".into() } else { name.to_string() }, corners.len() / 3));
                ended = false;
            }
            Some("endfacet") if !corners.len().is_multiple_of(3) => {
                return Err(wrong("a facet that has not three corners"));
            }
            Some("endsolid") => ended = true,
            None | Some("facet" | "outer" | "endloop" | "endfacet") => {}
            Some(other) if n == 0 || corners.is_empty() => {
                // A binary file may begin with `solid` too.
                let shown: String = other.chars().take(20).collect();
                return Err(wrong(&format!("`{}` is no word of STL", shown.escape_debug()))
                    .help("a binary STL has exactly 84 + 50 x triangles bytes: was this one cut off?"));
            }
            Some(other) => {
                let shown: String = other.chars().take(20).collect();
                return Err(wrong(&format!("`{}` is no word of STL", shown.escape_debug())));
            }
        }
    }
    if !ended || !corners.len().is_multiple_of(3) {
        return Err(files.broken("the file ends before its `endsolid`").help("the file was cut off; fetch it again"));
    }
    Ok(())
}
