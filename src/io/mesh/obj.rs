//! OBJ with its material libraries: polygons, groups, base colours and pictures.
//!
//! A feature is an object (`o`), in files without any a group (`g`). Colours (`Kd`, of vertices) are those of a screen,
//! as most programs write them. Backs are seen: nothing in the format says that they are not.
//! Source: Wavefront's appendix B; the MTL page of the same.

use std::collections::BTreeMap;
use std::io::{BufRead, Read};

use super::mtl::{Looks, forward};
use super::polygon::Faces;
use super::{Draft, Files, MOST, linear};
use crate::diag::Result;
use crate::io::ledger::Ledger;

/// Words that begin lines of shapes, groups or materials.
const KNOWN: &[&str] = &["v", "vt", "vn", "vp", "f", "fo", "o", "g", "s", "usemtl", "mtllib", "mg", "l", "p", "lod"];

/// Whether the head of a file looks like one.
pub fn is_likely(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let mut words = text.lines().filter_map(|l| l.split_ascii_whitespace().next()).filter(|w| !w.starts_with('#'));
    match words.next() {
        Some(word) => KNOWN.contains(&word),
        None => head.starts_with(b"#"),
    }
}

/// Material libraries that are named before the first face: a later one is of no use to it.
pub fn libraries(read: &mut dyn BufRead) -> Vec<String> {
    let mut out = Vec::new();
    let mut line = Vec::new();
    while matches!(Read::take(&mut *read, 1 << 16).read_until(b'\n', &mut line), Ok(n) if n > 0) {
        let text = String::from_utf8_lossy(&line);
        let text = text.trim();
        if let Some(rest) = text.strip_prefix("mtllib").filter(|r| r.starts_with([' ', '\t'])) {
            out.extend(names(rest));
        }
        if text.starts_with("f ") {
            break;
        }
        line.clear();
    }
    out
}

/// One name, spaces and all, if it ends as libraries do; else one a word.
fn names(rest: &str) -> Vec<String> {
    let rest = rest.trim();
    let one = rest.to_ascii_lowercase().matches(".mtl").count() <= 1;
    if one { vec![forward(rest)] } else { rest.split_ascii_whitespace().map(forward).collect() }
}

/// Corners of faces become vertices once for each feature, picture place and normal.
struct Vertices {
    /// Of each place the last entry of its chain.
    heads: Vec<u32>,
    /// (picture place + 1, normal + 1, feature, vertex, the entry before).
    entries: Vec<(u32, u32, u32, u32, u32)>,
    /// What is further back than that in a long chain: (place, picture place + 1, normal + 1, feature) to the vertex.
    far: BTreeMap<(u32, u32, u32, u32), u32>,
}

/// Longer chains are not searched: a tip may belong to a million faces.
const MOST_LINKS: usize = 32;

/// What faces refer to.
#[derive(Default)]
struct Lists {
    v: Vec<[f64; 3]>,
    colours: Vec<[f32; 4]>,
    vt: Vec<[f32; 2]>,
    vn: Vec<[f32; 3]>,
}

pub fn read(files: &Files, draft: &mut Draft, ledger: &mut Ledger) -> Result<()> {
    let text = String::from_utf8_lossy(files.bytes);
    let lists = lists(files, &text)?;
    if lists.v.len() as u64 > MOST {
        return Err(files.broken(format!("{} vertices are more than the {MOST} that are read", lists.v.len())));
    }
    let objects = lines(&text).any(|(_, word, _)| word == "o");
    let mut looks = Looks::default();
    let mut vertices = Vertices { heads: vec![u32::MAX; lists.v.len()], entries: Vec::new(), far: BTreeMap::new() };
    let (mut v, mut vt, mut vn) = (0i64, 0i64, 0i64);
    let (mut feature, mut known) = (None, BTreeMap::<String, u32>::new());
    let mut material = None;
    let (mut name, mut first) = (String::from("mesh"), 0);
    let mut faces = Faces::default();
    let mut corners: Vec<u64> = Vec::new();
    let mut odd = BTreeMap::<String, u64>::new();
    for (n, word, rest) in lines(&text) {
        match word {
            "v" => v += 1,
            "vt" => vt += 1,
            "vn" => vn += 1,
            "f" | "fo" => {
                let feature = *feature.get_or_insert_with(|| {
                    let new = draft.feature(&name);
                    known.insert(name.clone(), new);
                    new
                });
                corners.clear();
                for corner in words(rest) {
                    let wrong = || files.broken(format!("line {n}: `{corner}` is no corner of a face"));
                    let mut parts = corner.split('/');
                    let mut index = |count: i64| -> Result<Option<i64>> {
                        match parts.next() {
                            None | Some("") => Ok(None),
                            Some(part) => {
                                let i: i64 = part.parse().map_err(|_| wrong())?;
                                // From 1, or back from the last.
                                Ok(Some(if i < 0 { count + i } else { i - 1 }))
                            }
                        }
                    };
                    let place = index(v)?.ok_or_else(wrong)?;
                    let (at, normal) = (index(vt)?, index(vn)?);
                    corners.push(vertices.of(place, at, normal, feature, &lists, draft));
                }
                let place = || n.to_string();
                if draft.triangles.len() as u64 > MOST {
                    return Err(files.broken(format!("more than the {MOST} triangles that are read")));
                }
                faces.add(&corners, draft, files, ledger, &place);
            }
            "o" | "g" => {
                if word == "o" || !objects {
                    name = if rest.is_empty() { "mesh".into() } else { rest.to_string() };
                    // Names that come again are the same feature.
                    feature = known.get(&name).copied();
                }
            }
            "usemtl" => {
                draft.primitive(material.map_or("mesh", |m: u32| &looks.names[m as usize]), first, material);
                first = draft.triangles.len();
                material = Some(looks.material(rest, files, draft));
            }
            "mtllib" => names(rest).iter().for_each(|name| looks.library(name, files)),
            "l" | "p" => {
                ledger.read += 1;
                ledger.filter_type(if word == "l" { "lines" } else { "points" });
            }
            "s" | "mg" | "vp" | "lod" | "" => {}
            _ => *odd.entry(word.chars().take(20).collect()).or_default() += 1,
        }
    }
    draft.primitive(material.map_or("mesh", |m| &looks.names[m as usize]), first, material);
    if !odd.is_empty() {
        let all: Vec<String> = odd.iter().take(8).map(|(w, n)| format!("{} ({n})", w.escape_debug())).collect();
        files.warn(format!("lines that begin with these words are not read: {}", all.join(", ")));
    }
    Ok(())
}

/// Lines with their numbers, joined where one ends with a backslash: the first word and the rest.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str, &str)> {
    // A line that goes on is rare: its pieces are one slice, the backslash is a word that parses as nothing.
    let mut rest = text.trim_start_matches('\u{feff}');
    let mut number = 0;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        number += 1;
        let first = number;
        let mut end = rest.find('\n').unwrap_or(rest.len());
        while rest[..end].trim_end_matches('\r').ends_with('\\') && end < rest.len() {
            number += 1;
            end = rest[end + 1..].find('\n').map_or(rest.len(), |e| end + 1 + e);
        }
        let line = &rest[..end];
        rest = rest.get(end + 1..).unwrap_or("");
        let (word, after) = line.trim().split_once([' ', '\t']).unwrap_or((line.trim(), ""));
        // Names may hold the sign of comments.
        let numbers = matches!(word, "v" | "vt" | "vn" | "f");
        let after = if numbers { after.split('#').next().unwrap_or("") } else { after };
        Some((first, if word.starts_with('#') { "" } else { word }, after.trim()))
    })
}

/// Words of a line, without the backslashes at the ends of its pieces.
fn words(rest: &str) -> impl Iterator<Item = &str> {
    rest.split_ascii_whitespace().map(|w| w.trim_end_matches('\\')).filter(|w| !w.is_empty())
}

fn lists(files: &Files, text: &str) -> Result<Lists> {
    let mut out = Lists::default();
    let mut numbers: Vec<f64> = Vec::new();
    for (n, word, rest) in lines(text) {
        if !matches!(word, "v" | "vt" | "vn") {
            continue;
        }
        numbers.clear();
        for word in words(rest) {
            numbers.push(word.parse().map_err(|_| files.broken(format!("line {n}: `{word}` is no number")))?);
        }
        let least = if word == "vt" { 1 } else { 3 };
        if numbers.len() < least {
            return Err(files.broken(format!("line {n}: `{word}` of fewer than {least} numbers")));
        }
        match word {
            "v" => {
                out.v.push([numbers[0], numbers[1], numbers[2]]);
                if numbers.len() >= 6 {
                    out.colours.resize(out.v.len() - 1, [1.0; 4]);
                    let c = [3, 4, 5].map(|k| linear(numbers[k]));
                    out.colours.push([c[0], c[1], c[2], 1.0]);
                }
            }
            // Up in the file, down here.
            "vt" => out.vt.push([numbers[0] as f32, (1.0 - numbers.get(1).unwrap_or(&0.0)) as f32]),
            _ => out.vn.push(unit([numbers[0], numbers[1], numbers[2]])),
        }
    }
    if !out.colours.is_empty() {
        out.colours.resize(out.v.len(), [1.0; 4]);
    }
    Ok(out)
}

/// Of length one, or 0, 0, 0 where it has no direction.
pub fn unit(v: [f64; 3]) -> [f32; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if length.is_normal() { v.map(|c| (c / length) as f32) } else { [0.0; 3] }
}

impl Vertices {
    /// The vertex of a corner; none of the draft's where an index is wrong.
    fn of(
        &mut self,
        place: i64,
        at: Option<i64>,
        normal: Option<i64>,
        feature: u32,
        lists: &Lists,
        draft: &mut Draft,
    ) -> u64 {
        let within = |i: i64, n: usize| i >= 0 && (i as u64) < n as u64;
        let fits = |i: Option<i64>, n: usize| i.is_none_or(|i| within(i, n));
        if !within(place, lists.v.len()) || !fits(at, lists.vt.len()) || !fits(normal, lists.vn.len()) {
            return u64::MAX;
        }
        let number = |i: Option<i64>| i.map_or(0, |i| i as u32 + 1);
        let (at, normal) = (number(at), number(normal));
        let head = self.heads[place as usize];
        let (mut next, mut links) = (head, 0);
        while let Some(&(a, n, f, vertex, before)) = self.entries.get(next as usize) {
            if (a, n, f) == (at, normal, feature) {
                return u64::from(vertex);
            }
            next = before;
            links += 1;
        }
        let key = (place as u32, at, normal, feature);
        if links >= MOST_LINKS
            && let Some(&vertex) = self.far.get(&key)
        {
            return u64::from(vertex);
        }
        let vertex = draft.positions.len() as u32;
        draft.positions.push(lists.v[place as usize]);
        draft.features.push(feature);
        let all = &mut draft.surface;
        if at > 0 {
            all.uvs.resize(vertex as usize, [0.0; 2]);
            all.uvs.push(lists.vt[at as usize - 1]);
        }
        if normal > 0 {
            all.normals.resize(vertex as usize, [0.0; 3]);
            all.normals.push(lists.vn[normal as usize - 1]);
        }
        if let Some(colour) = lists.colours.get(place as usize) {
            all.colours.push(*colour);
        }
        if links >= MOST_LINKS {
            self.far.insert(key, vertex);
        } else {
            self.heads[place as usize] = self.entries.len() as u32;
            self.entries.push((at, normal, feature, vertex, head));
        }
        u64::from(vertex)
    }
}
