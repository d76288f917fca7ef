//! Bytes to artifacts and back, in the formats' own words.

pub mod gltf;
pub mod tiles3d;
pub mod geojson;
pub mod json;
pub mod ledger;
pub mod pick;
pub mod place;
pub mod stream;
