//! Bytes to artifacts and back, in the formats' own words.

pub mod gltf;
pub mod tiles3d;
