//! CityJSON 1.1 and 2.0, and CityJSONSeq: city objects in, buildings out.

mod read;

pub use read::{Boundary, GROUND_TYPES, Model, Object, Transform, read};
