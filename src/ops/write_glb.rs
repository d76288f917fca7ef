//! Write a mesh or impostors as one GLB.
//!
//! In:     triangles with a feature number on every vertex, with or without looks; or quads with an atlas.
//! Out:    one file, y up. Positions are f32 around the middle of the mesh in whole kilometres, which is the translation.
//!         A mesh without looks: a primitive and a quiet colour for each part, features by EXT_mesh_features, their `id`
//!         and attributes by EXT_structural_metadata. No normals: vertices stay shared, so what is watertight stays so,
//!         and viewers shade flat.
//!         A mesh with looks: a node for each feature; materials (base colour, alpha, both sides), pictures byte for byte
//!         (WebP by EXT_texture_webp), wrapping, colours, normals and picture places of vertices. `read-mesh` makes
//!         the same mesh of it. Attributes, where there are any, as above. A part without a material gets a quiet one.
//!         Impostors: unlit, or matt where they have a normal map; with their atlas inside, PNG or WebP; `extras` of the
//!         scene say how far off they may be (`error`, metres) and from where that is below a pixel (`distance`).
//! Errors: more than 4 GiB, which GLB cannot say. Told: numbers that are none, normals of a part of a triangle's corners.
//! Cost: O(vertices), the file in memory.
//! Source: glTF 2.0 and the three extensions.

use serde::{Deserialize, Serialize};

use crate::artifact::files::{self, File};
use crate::artifact::{Files, Impostors, Mesh};
use crate::diag::{Diagnostic, Result};
use crate::io::gltf;
use crate::op::{Ctx, Op};

/// How an atlas is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Packing {
    /// Every viewer reads it.
    Png,
    /// Without loss, about a third smaller; EXT_texture_webp.
    Webp,
}

crate::params! {
    /// One GLB with looks and feature ids.
    pub struct WriteGlb {
        /// The file, below the output folder.
        #[schemars(extend("x-required" = true, "x-output" = "file"))]
        pub path: String = String::new(),
        /// How an impostor's atlas is packed. A mesh's pictures stay as they came.
        pub atlas: Packing = Packing::Png,
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
    const VERSION: u32 = 4;
    type In = In;
    type Out = Files;

    fn run(&self, ctx: &Ctx, input: In) -> Result<Files> {
        let written = match &input.model {
            Model::Mesh(mesh) => gltf::mesh(mesh)?,
            Model::Impostors(quads) => {
                let packing = match self.atlas {
                    Packing::Png => gltf::impostors::Packing::Png,
                    Packing::Webp => gltf::impostors::Packing::Webp,
                };
                gltf::impostors::glb(quads, packing)?.into()
            }
        };
        written.told.iter().for_each(|sentence| ctx.report.warn(sentence.clone()));
        let blob =
            ctx.blobs.put(&written.bytes).map_err(|e| Diagnostic::error("io", format!("cannot keep the file: {e}")))?;
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
        let op = WriteGlb { path: "./a//b.glb".into(), ..WriteGlb::default() };
        let files = op.run(&bench.ctx(), In { model: Model::Mesh(Arc::new(mesh)) }).unwrap();
        assert_eq!(files.files.len(), 1);
        assert_eq!(files.files[0].path, "a/b.glb");
        let bytes = &bench.blobs.0.lock().unwrap()[&files.files[0].blob.digest];
        assert_eq!(&bytes[..4], b"glTF");
    }
}
