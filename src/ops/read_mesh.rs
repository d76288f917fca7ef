//! Read a mesh from glTF, GLB, OBJ, PLY or STL.
//!
//! In:     one file, plain or gzipped; its bytes say what it is. Files beside it that it names are read as well:
//!         buffers, material libraries, pictures of base colours.
//! Out:    triangles, z up, in the file's unit (metres, one hopes), around its own origin; base colours, pictures as they
//!         came, colours and normals of vertices. A feature is a node of glTF, an object or group of OBJ, a solid of STL.
//!         Polygons are cut into triangles; points and lines are filtered. Vertices of no triangle are left out, equal
//!         corners of STL become one. Skinned meshes stand as their joints do, morphed ones have no weights.
//! Errors: a file that is none of these, ends early, or contradicts itself; Draco, meshopt and KTX2, with a remedy; more
//!         than 2^26 vertices or triangles; no triangle left, too many rejects. Triangles with an index beyond the
//!         vertices or a corner that is no finite number are rejected and counted. A library or picture that is not
//!         there is told, and what it paints is white.
//! Facts:  read, accepted, rejected, filtered: triangles (of what is filtered whole points, lines or primitives);
//!         filtered_by_type, rejected_by_cause, repaired_by_cause.
//! Cost:   linear; the file and the mesh in memory.
//! Source: glTF 2.0; Wavefront's OBJ and MTL; Turk's PLY; 3D Systems' STL.

use std::io::BufReader;

use serde::{Deserialize, Serialize};

use crate::artifact::Mesh;
use crate::diag::{Diagnostic, Result};
use crate::io::ledger::{self, Ledger, Needed};
use crate::io::mesh::{self, Files, Up};
use crate::io::reader::{account, is_packed};
use crate::io::stream::unpacked;
use crate::op::{Ctx, Op, Source};

/// Which way is up in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Upward {
    Y,
    Z,
}

crate::params! {
    /// A mesh from a file of one of the common formats.
    pub struct ReadMesh {
        /// The file: .gltf, .glb, .obj, .ply or .stl; `.gz` of any.
        #[schemars(extend("x-file" = true, "x-required" = true))]
        pub path: String = String::new(),
        /// Which way is up in the file: `y` if not said in OBJ, `z` in PLY and STL. glTF is always y up.
        pub up: Option<Upward> = None,
        /// Largest share of triangles that may be rejected.
        #[schemars(range(min = 0.0, max = 1.0))]
        pub max_rejected: f64 = 0.5,
    }
}

crate::inputs! {}

impl Op for ReadMesh {
    const NAME: &'static str = "read-mesh";
    const VERSION: u32 = 1;
    type In = In;
    type Out = Mesh;
    const FACTS: &'static [(&'static str, &'static str)] = &FACTS;

    fn beside(source: &Source) -> Vec<String> {
        let Ok(read) = (source.open)().and_then(unpacked) else { return Vec::new() };
        let name = source.name.strip_suffix(".gz").unwrap_or(&source.name);
        mesh::beside(name, &mut BufReader::new(read))
    }

    fn run(&self, ctx: &Ctx, _: In) -> Result<Mesh> {
        account(ctx.report, "triangles", Needed::One { max_rejected: self.max_rejected }, |ledger| {
            read_mesh(self, ctx, ledger)
        })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (16 << 20) + if is_packed(&self.path) { 24 * input_bytes } else { 8 * input_bytes }
    }
}

const FACTS: [(&str, &str); 6] = {
    let mut all = ledger::facts::<1, 7>([ledger::BY_TYPE]);
    all[0].1 = "triangles in the file, and primitives of other kinds: accepted + rejected + filtered";
    all[1].1 = "triangles in the result";
    all[2].1 = "triangles left out because something is wrong with them; listed with place and cause";
    all[3].1 = "points, lines, or primitives of them";
    all[4].1 = "rejected triangles of each cause";
    // No rule repairs.
    [all[0], all[1], all[2], all[3], all[4], all[6]]
};

pub fn read_mesh(how: &ReadMesh, ctx: &Ctx, ledger: &mut Ledger) -> Result<Mesh> {
    let mut main = ctx.sources.iter().filter(|s| !s.beside);
    let (Some(source), None) = (main.next(), main.next()) else {
        let count = ctx.sources.iter().filter(|s| !s.beside).count();
        return Err(Diagnostic::error("bad-mesh", format!("one file is read at a time, got {count}")).value(&how.path));
    };
    let unread =
        |name: &str, e: std::io::Error| Diagnostic::error("unreadable-file", format!("cannot read `{name}`: {e}"));
    let mut bytes = Vec::new();
    let mut packed = (source.open)().and_then(unpacked).map_err(|e| unread(&source.name, e))?;
    packed.read_to_end(&mut bytes).map_err(|e| unread(&source.name, e))?;
    ctx.check()?;
    let beside = |name: &str| {
        let source = ctx.sources.iter().find(|s| s.beside && s.name == name)?;
        let mut bytes = Vec::new();
        let done = (source.open)().and_then(|mut r| r.read_to_end(&mut bytes));
        Some(done.map(|_| bytes).map_err(|e| unread(name, e)))
    };
    let files =
        Files { name: &source.name, bytes: &bytes, beside: &beside, warn: &|sentence| ctx.report.warn(sentence) };
    let up = how.up.map(|up| match up {
        Upward::Y => Up::Y,
        Upward::Z => Up::Z,
    });
    mesh::read(&files, up, ledger)
}
