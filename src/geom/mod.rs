//! Numbers in, numbers out. Plan geometry is exact: whole millimetres in `i32` (below 2^29), signs in `i64`.

pub mod bounds;
mod bridge;
pub mod chart;
pub mod cover;
pub mod crs;
pub mod distinct;
pub mod erode;
pub mod exchange;
pub mod extremes;
pub mod faces;
pub mod forms;
pub mod frame;
pub mod gap;
pub mod globe;
pub mod lattice;
pub mod mercator;
pub mod merge_rings;
pub mod near_boxes;
pub mod nearest;
pub mod outer_hull;
pub mod outline;
pub mod overlaps;
pub mod predicates;
pub mod raster;
pub mod repair;
pub mod ring;
pub mod scatter;
pub mod segment_grid;
pub mod segments;
pub mod space;
pub mod tree_cut;
pub mod triangulate;
pub mod union;
pub mod union_area;
pub mod vertex_grid;
pub mod wide;

/// A point in the plan, millimetres in the local frame.
pub type Point = [i32; 2];

/// Largest coordinate of a frame: 2^29 mm, so that doubled areas of triangles fit in `i64`.
pub const LIMIT_MM: i32 = 1 << 29;
