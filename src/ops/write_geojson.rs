//! Write a layer as GeoJSON, for any GIS.
//!
//! In:     footprints, lines or hulls.
//! Out:    one FeatureCollection, a feature a line, in the input's system within 2 mm of the input's coordinates.
//!         Footprints have `id`, `base`, `height` and their attributes; lines `id`; hulls `cluster`, `parent`,
//!         `buildings`, `edges`, `merged_edges`, `area_m2`, `negative_space_m2`, `ground`, `height`. A layer in a
//!         projected system says so by a `crs` member (GeoJSON 2008, which QGIS and GDAL read).
//! Errors: none but of the disk. Cost: linear, the file in memory.

use crate::artifact::files::{self, File};
use crate::artifact::{Files, Footprints, Hulls, Lines};
use crate::diag::{Diagnostic, Result};
use crate::io::geojson;
use crate::op::{Ctx, Op};
use crate::{inputs, one_of, params};

params! {
    /// A layer as GeoJSON.
    pub struct WriteGeojson {
        /// The file, below the output folder.
        #[schemars(extend("x-required" = true, "x-output" = "file"))]
        pub path: String = String::new(),
    }
}

one_of! {
    /// What can be drawn on a plan.
    pub enum Layer { Footprints, Lines, Hulls }
}

inputs! {
    /// What to write.
    layer: Layer,
}

impl Op for WriteGeojson {
    const NAME: &'static str = "write-geojson";
    const VERSION: u32 = 1;
    type In = In;
    type Out = Files;

    fn run(&self, ctx: &Ctx, input: In) -> Result<Files> {
        let bytes = match &input.layer {
            Layer::Footprints(layer) => geojson::footprints(layer)?,
            Layer::Lines(layer) => geojson::lines(layer)?,
            Layer::Hulls(layer) => geojson::hulls(layer)?,
        };
        let blob = ctx.blobs.put(&bytes).map_err(|e| Diagnostic::error("io", format!("cannot keep the file: {e}")))?;
        Ok(Files { files: vec![File { path: files::below(&self.path, ""), blob, last: false }] })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        // The text: of rings, whose vertices are shared here, much longer.
        (4 << 20) + 7 * input_bytes
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geom::frame::Frame;
    use crate::op::Bench;

    #[test]
    fn one_file() {
        let bench = Bench::default();
        let lines = Lines {
            frame: Frame::local(),
            ids: ["a"].iter().collect(),
            starts: vec![0, 2],
            points: vec![[0, 0], [1, 2]],
        };
        let op = WriteGeojson { path: "a.geojson".into() };
        let files = op.run(&bench.ctx(), In { layer: Layer::Lines(Arc::new(lines)) }).unwrap();
        let bytes = &bench.blobs.0.lock().unwrap()[&files.files[0].blob.digest];
        assert!(String::from_utf8_lossy(bytes).contains("[[0,0],[0.001,0.002]]"));
    }
}
