//! GeoJSON: features in (RFC 7946, newline-delimited or not), layers out.

mod read;
mod write;

use crate::geom::crs::{Crs, CrsError};

pub use read::{Feature, Geometry, GeometryKind, Header, read};
pub use write::{footprints, hulls, lines};

/// A `crs` parameter: empty is none.
pub fn crs_or_empty(text: &str) -> Result<Option<Crs>, CrsError> {
    if text.is_empty() { Ok(None) } else { Crs::parse(text).map(Some) }
}
