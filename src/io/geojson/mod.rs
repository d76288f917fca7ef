//! GeoJSON: features in (RFC 7946, newline-delimited or not), layers out.

mod read;
mod write;

pub use read::{Feature, Geometry, GeometryKind, Header, read};
pub use write::{footprints, hulls, lines};
