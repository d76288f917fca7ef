//! The list of operators, alphabetical. One operator, one file, one manual page; two lines here each.

use crate::op::{Entry, Registry};

pub mod bake_impostor;
pub mod cluster;
pub mod concat;
pub mod cut;
pub mod extrude;
pub mod footprint;
pub mod landmarks;
pub mod merge_hulls;
pub mod read_cityjson;
pub mod read_geojson;
pub mod read_lines;
pub mod read_mesh;
pub mod simplify_footprints;
pub mod simplify_polyline;
pub mod tile;
pub mod vote_tile;
pub mod voxelize;
pub mod write_cityjson;
pub mod write_geojson;
pub mod write_glb;
pub mod write_tileset;

/// Every operator, sorted by name.
pub static ALL: Registry = Registry(LIST);
static LIST: &[Entry] = &[
    // One a line, so that additions merge.
    Entry::of::<bake_impostor::BakeImpostor>(),
    Entry::of::<cluster::Cluster>(),
    Entry::of::<concat::Concat>(),
    Entry::of::<cut::Cut>(),
    Entry::of::<extrude::Extrude>(),
    Entry::of::<footprint::Footprint>(),
    Entry::of::<landmarks::FindLandmarks>(),
    Entry::of::<merge_hulls::MergeHulls>(),
    Entry::of::<read_cityjson::ReadCityjson>(),
    Entry::of::<read_geojson::ReadGeojson>(),
    Entry::of::<read_lines::ReadLines>(),
    Entry::of::<read_mesh::ReadMesh>(),
    Entry::of::<simplify_footprints::SimplifyFootprints>(),
    Entry::of::<simplify_polyline::SimplifyPolyline>(),
    Entry::of::<tile::Tile>(),
    Entry::of::<vote_tile::VoteTile>(),
    Entry::of::<voxelize::Voxelize>(),
    Entry::of::<write_cityjson::WriteCityjson>(),
    Entry::of::<write_geojson::WriteGeojson>(),
    Entry::of::<write_glb::WriteGlb>(),
    Entry::of::<write_tileset::WriteTileset>(),
];
