//! Write a mesh or impostors as one GLB.
//!
//! In:     triangles with a feature number on every vertex, or quads with an atlas: these come out unlit, with their
//!         picture inside, `extras` of the scene say how far off they may be and from where that is below a pixel.
//! Out:    one file: y up, a primitive and a quiet colour for each part of the mesh, features by EXT_mesh_features,
//!         their `id` and attributes by EXT_structural_metadata. No normals: vertices stay shared, so what is
//!         watertight stays so, and viewers shade flat. Positions are f32 around the middle of the mesh in whole
//!         kilometres, which is the node's translation.
//! Errors: more than 4 GiB, which GLB cannot say. Cost: O(vertices), the file in memory.
//! Source: glTF 2.0 and the two extensions.

use crate::artifact::files::{self, File};
use crate::artifact::{Files, Impostors, Mesh};
use crate::diag::{Diagnostic, Result};
use crate::io::gltf;
use crate::op::{Ctx, Op};

crate::params! {
    /// One GLB with feature ids.
    pub struct WriteGlb {
        /// The file, below the output folder.
        #[schemars(extend("x-required" = true, "x-output" = "file"))]
        pub path: String = String::new(),
    }
}

crate::one_of! {
    /// What has a model.
    pub enum Model { Mesh, Impostors }
}

crate::inputs! {
    /// What to write.
    model: Model,
}

impl Op for WriteGlb {
    const NAME: &'static str = "write-glb";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Files;

    fn run(&self, ctx: &Ctx, input: In) -> Result<Files> {
        let bytes = match &input.model {
            Model::Mesh(mesh) => gltf::mesh(mesh)?,
            Model::Impostors(quads) => gltf::impostors::glb(quads)?,
        };
        let blob = ctx.blobs.put(&bytes).map_err(|e| Diagnostic::error("io", format!("cannot keep the file: {e}")))?;
        Ok(Files { files: vec![File { path: files::below(&self.path, ""), blob, last: false }] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::mesh::Primitive;
    use crate::geom::frame::Frame;
    use crate::op::Bench;
    use std::sync::Arc;

    #[test]
    fn one_file_under_its_path() {
        let mesh = Mesh {
            frame: Frame::local(),
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            features: vec![0; 3],
            primitives: vec![Primitive { name: "roof".into(), first_triangle: 0, triangles: 1, material: None }],
            feature_ids: ["a"].into_iter().collect(),
            attributes: Default::default(),
            surface: Default::default(),
        };
        let bench = Bench::default();
        let op = WriteGlb { path: "./a//b.glb".into() };
        let files = op.run(&bench.ctx(), In { model: Model::Mesh(Arc::new(mesh)) }).unwrap();
        assert_eq!(files.files.len(), 1);
        assert_eq!(files.files[0].path, "a/b.glb");
        let bytes = &bench.blobs.0.lock().unwrap()[&files.files[0].blob.digest];
        assert_eq!(&bytes[..4], b"glTF");
    }
}
