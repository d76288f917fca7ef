//! `tileset.json` of 3D Tiles 1.1: explicit tiling, boxes, a metadata entity on every tile.
//!
//! Only what lodge writes. Keys come in this order, numbers in their shortest text.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

/// The file; its tiles are a list, so that no depth of the tree is too deep.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Tileset {
    pub asset: Asset,
    /// What is missed when nothing is drawn, metres.
    pub geometric_error: f64,
    pub schema: Schema,
    #[serde(skip_serializing_if = "Value::is_null")]
    pub extras: Value,
    /// Parents before children, the root first.
    #[serde(skip)]
    pub tiles: Vec<Tile>,
}

impl Tileset {
    /// The file's bytes. Brothers come in the order of the list.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut children: Vec<Vec<usize>> = vec![Vec::new(); self.tiles.len()];
        for (t, tile) in self.tiles.iter().enumerate() {
            if let Some(parent) = tile.parent {
                children[parent].push(t);
            }
        }
        let mut out = Vec::new();
        open(&mut out, self);
        out.extend_from_slice(b",\"root\":");
        open(&mut out, &self.tiles[0]);
        // Tiles that are open, and how many of their children are written.
        let mut stack = vec![(0, 0)];
        while let Some((tile, done)) = stack.last_mut() {
            let Some(&child) = children[*tile].get(*done) else {
                out.extend_from_slice(if *done > 0 { b"]}" } else { b"}" });
                stack.pop();
                continue;
            };
            out.extend_from_slice(if *done > 0 { b"," } else { b",\"children\":[" });
            *done += 1;
            open(&mut out, &self.tiles[child]);
            stack.push((child, 0));
        }
        out.push(b'}');
        out
    }
}

/// Appends an object that is not yet closed.
fn open(out: &mut Vec<u8>, object: &impl Serialize) {
    serde_json::to_writer(&mut *out, object).expect("a tileset is plain data");
    out.pop();
}

#[derive(Clone, Debug, Serialize)]
pub struct Asset {
    pub version: String,
    pub generator: String,
}

#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Tile {
    /// Place in the list; none of the root.
    #[serde(skip)]
    pub parent: Option<usize>,
    pub bounding_volume: Volume,
    /// What is missed when this tile is drawn and its children are not, metres.
    pub geometric_error: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine: Option<Refine>,
    /// Column-major, to the parent's axes; left out where it changes nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transform: Option<[f64; 16]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub content: Option<Content>,
    pub metadata: Metadata,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Refine {
    Add,
    Replace,
}

/// Middle, then the half axes.
#[derive(Clone, Debug, Serialize)]
pub struct Volume {
    #[serde(rename = "box")]
    pub bounds: [f64; 12],
}

impl Volume {
    /// The box between two corners.
    pub fn between(low: [f64; 3], high: [f64; 3]) -> Self {
        let [x, y, z] = [0, 1, 2].map(|k| (low[k] + high[k]) / 2.0);
        let [a, b, c] = [0, 1, 2].map(|k| (high[k] - low[k]) / 2.0);
        Self { bounds: [x, y, z, a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0, c] }
    }

    /// The eight corners.
    pub fn corners(&self) -> [[f64; 3]; 8] {
        let b = &self.bounds;
        std::array::from_fn(|i| {
            let s = [i & 1, i >> 1 & 1, i >> 2].map(|bit| bit as f64 * 2.0 - 1.0);
            [0, 1, 2].map(|k| b[k] + s[0] * b[3 + k] + s[1] * b[6 + k] + s[2] * b[9 + k])
        })
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct Content {
    pub uri: String,
    #[serde(skip_serializing_if = "Value::is_null")]
    pub extras: Value,
}

/// What the properties of metadata entities are.
#[derive(Clone, Debug, Serialize)]
pub struct Schema {
    pub id: String,
    pub classes: BTreeMap<String, Value>,
}

/// Values of one entity.
#[derive(Clone, Debug, Serialize)]
pub struct Metadata {
    pub class: String,
    pub properties: BTreeMap<String, Value>,
}
