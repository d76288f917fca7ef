//! The local frame: millimetres around an origin, and the origin's place on the globe.

use serde::{Deserialize, Serialize};

/// What the local coordinates were before their origin was taken off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Projection {
    /// Metres of an unknown system.
    Local { origin: [f64; 2] },
    /// Metres of the projected `crs`, shifted by `origin` (whole kilometres).
    Projected { origin: [f64; 2] },
    /// Transverse Mercator on WGS 84 (ellipsoidal, k = 1) around `origin` = lon, lat in degrees.
    TransverseMercator { origin: [f64; 2] },
}

/// Local metres = source coordinates by `projection`. Stored with every artifact that has coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// `"EPSG:28992"`, `"OGC:CRS84"`; empty where unknown.
    pub crs: String,
    pub projection: Projection,
}

impl Frame {
    /// A frame without a place on the globe.
    pub fn local() -> Self {
        Self { crs: String::new(), projection: Projection::Local { origin: [0.0, 0.0] } }
    }
}
