//! CityJSON 1.1 and 2.0, and CityJSONSeq: city objects in, buildings out.

mod read;
mod write;

pub use read::{Boundary, GROUND_TYPES, Model, Object, Transform, read};
pub use write::{Form, Piece, attributes, buildings, is_level, model, pieces, sequence};
