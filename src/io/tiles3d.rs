//! `tileset.json` of 3D Tiles 1.1: explicit tiling, boxes, a metadata entity on every tile.
//!
//! Only what lodge writes; read back, other members are passed over. Keys come in this order, numbers in their
//! shortest text.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Tileset {
    pub asset: Asset,
    /// What is missed when nothing is drawn, metres.
    pub geometric_error: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub schema: Option<Schema>,
    pub root: Tile,
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub extras: Value,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Asset {
    pub version: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub generator: String,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Tile {
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
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metadata: Option<Metadata>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub children: Vec<Tile>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Refine {
    Add,
    Replace,
}

/// Middle, then the half axes.
#[derive(Clone, Debug, Serialize, Deserialize)]
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

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Content {
    pub uri: String,
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub extras: Value,
}

/// What the properties of metadata entities are.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Schema {
    pub id: String,
    pub classes: BTreeMap<String, Value>,
}

/// Values of one entity.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Metadata {
    pub class: String,
    pub properties: BTreeMap<String, Value>,
}
