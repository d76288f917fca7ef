//! Bytes to artifacts and back, in the formats' own words.

pub mod cityjson;
pub mod csv;
pub mod geojson;
pub mod gltf;
pub mod json;
pub mod ledger;
pub mod mesh;
pub mod paint;
pub mod pick;
pub mod picture;
pub mod place;
pub mod plane_tiles;
pub mod reader;
pub mod stream;
pub mod svg;
pub mod tiles3d;
pub mod views;
pub mod voxels;
