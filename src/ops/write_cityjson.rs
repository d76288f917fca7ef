//! Write buildings, and blocks that stand for clusters of them, as CityJSON 2.0.
//!
//! In:     buildings; a mesh of `extrude`. Where the mesh has clusters, also the footprints and the dendrogram that
//!         they come from, which say whose children they are.
//! Out:    one file in the input's system. `.jsonl`: CityJSONSeq, a building a line; else one CityJSON object, in
//!         which a block of one building is a further geometry of it, and a cluster a CityObjectGroup with
//!         `children` and a geometry. Closed shells are Solids, others MultiSurfaces; both with semantics.
//! Levels: only those that CityJSON 2.0 has a name for, 0 to 3 and 0.0 to 3.3. Geometries of others, or of none, are
//!         left out, told by the building's id; a building that has no other, no block and no cluster is left out as
//!         a whole, a reject.
//! Errors: no building left, a level that a building already has, a feature of the mesh that is no building's, clusters in a `.jsonl`
//!         (a feature cannot hold a group of others), clusters without footprints and dendrogram.
//! Cost:   near O(n log n); the file in memory.

use std::collections::BTreeMap;

use crate::artifact::buildings::{GROUND, OTHER, ROOF, WALL};
use crate::artifact::files::{self, File};
use crate::artifact::{Buildings, Dendrogram, Files, Footprints, Mesh};
use crate::diag::{Diagnostic, Note, Report, Result};
use crate::geom::Point;
use crate::geom::frame::Frame;
use crate::io::cityjson::{self, Form, Piece};
use crate::op::{Ctx, Mistake, Op};
use crate::{inputs, params};

params! {
    /// Buildings and blocks as CityJSON.
    pub struct WriteCityjson {
        /// The file, below the output folder: `.city.json`, or `.city.jsonl` for CityJSONSeq.
        #[schemars(extend("x-required" = true, "x-output" = "file"))]
        pub path: String = String::new(),
        /// Level of detail of the mesh's blocks.
        pub lod: String = "1.0".into(),
    }
}

inputs! {
    /// Buildings with all their levels.
    buildings: Buildings,
    /// Blocks of buildings and clusters.
    mesh: Option<Mesh>,
    /// Footprints that are the dendrogram's leaves.
    footprints: Option<Footprints>,
    /// Merge tree that says which buildings a cluster has.
    dendrogram: Option<Dendrogram>,
}

impl Op for WriteCityjson {
    const NAME: &'static str = "write-cityjson";
    const VERSION: u32 = 3;
    type In = In;
    type Out = Files;

    fn check(&self) -> Vec<Mistake> {
        // The levels that CityJSON has names for.
        if cityjson::is_level(&self.lod) {
            return Vec::new();
        }
        let known = "0 to 3, or 0.0 to 3.3 with a second digit of 0 to 3";
        vec![Mistake {
            param: "lod",
            message: format!("`lod` must be one of CityJSON's levels, {known}, got {:?}", self.lod),
        }]
    }

    fn run(&self, ctx: &Ctx, input: In) -> Result<Files> {
        let mut pieces: Vec<Piece> = cityjson::pieces(&input.buildings).collect();
        let odd = odd_levels(&mut pieces, ctx.report);
        let mut groups = Vec::new();
        if let Some(mesh) = &input.mesh {
            let tree = input.footprints.as_deref().zip(input.dendrogram.as_deref());
            groups = blocks(mesh, &input.buildings.frame, &self.lod, tree, &mut pieces)?;
        }
        let frame = &input.buildings.frame;
        let sequence = self.path.ends_with(".jsonl");
        if sequence && !groups.is_empty() {
            let message = "CityJSONSeq cannot hold clusters: a feature has no room for a group of other features";
            return Err(Diagnostic::error("no-groups", message).value(&self.path).help("write a `.city.json`"));
        }
        ctx.check()?;
        let mut pieces = with_something_left(pieces, &odd, ctx.report)?;
        pieces.append(&mut groups);
        let bytes = if sequence { cityjson::sequence(frame, &pieces)? } else { cityjson::model(frame, &pieces)? };
        let blob = ctx.blobs.put(&bytes).map_err(|e| Diagnostic::error("io", format!("cannot keep the file: {e}")))?;
        Ok(Files { files: vec![File { path: files::below(&self.path, ""), blob, last: false }] })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        // Every ring and every object's text by itself, then the file.
        (4 << 20) + 6 * input_bytes
    }
}

/// Takes out the geometries of levels that CityJSON has no name for; gives the buildings that had some.
fn odd_levels(pieces: &mut [Piece], report: &Report) -> Vec<usize> {
    let mut odd = Vec::new();
    let mut names: BTreeMap<String, u64> = BTreeMap::new();
    for (i, piece) in pieces.iter_mut().enumerate() {
        let before = piece.forms.len();
        piece.forms.retain(|form| {
            let known = cityjson::is_level(&form.lod);
            if !known {
                *names.entry(format!("{:?}", form.lod)).or_default() += 1;
            }
            known
        });
        if piece.forms.len() < before {
            odd.push(i);
        }
    }
    if !names.is_empty() {
        let names: Vec<String> = names.iter().map(|(name, n)| format!("{name} ({n})")).collect();
        let names = names.join(", ");
        report.warn(format!("geometries of levels that CityJSON 2.0 has no name for are left out: {names}"));
    }
    odd
}

/// The buildings but those that lost every geometry and are in no cluster; those with odd levels are told.
fn with_something_left(pieces: Vec<Piece>, odd: &[usize], report: &Report) -> Result<Vec<Piece>> {
    let some_are_odd = !odd.is_empty();
    let mut odd = odd.iter().copied().peekable();
    let mut out = Vec::with_capacity(pieces.len());
    for (i, piece) in pieces.into_iter().enumerate() {
        if odd.next_if_eq(&i).is_none() {
            out.push(piece);
            continue;
        }
        let note = |cause: &str| Note {
            row: i as u64,
            id: piece.id.clone(),
            place: format!("building {i}"),
            cause: cause.to_string(),
        };
        if piece.forms.is_empty() && piece.parents.is_empty() {
            report.reject(note("no level of detail that CityJSON has a name for"));
            continue;
        }
        report.repair(note("a level of detail that CityJSON has no name for was left out"));
        out.push(piece);
    }
    if out.is_empty() && some_are_odd {
        let message = "no building has a level of detail that CityJSON 2.0 has a name for";
        return Err(Diagnostic::error("no-features", message).help("its levels are 0 to 3, and 0.0 to 3.3"));
    }
    Ok(out)
}

/// Gives every building its block, and a group for every cluster, in the mesh's order.
fn blocks(
    mesh: &Mesh,
    frame: &Frame,
    lod: &str,
    tree: Option<(&Footprints, &Dendrogram)>,
    pieces: &mut [Piece],
) -> Result<Vec<Piece>> {
    if mesh.frame != *frame {
        let message = "the mesh lies in another frame than the buildings";
        return Err(Diagnostic::error("inputs-differ", message).help("make it from footprints of the same buildings"));
    }
    let index: BTreeMap<String, usize> = pieces.iter().enumerate().map(|(i, p)| (p.id.clone(), i)).collect();
    let order = tree.map(|(_, tree)| tree.leaf_order());
    let mut groups = Vec::new();
    for (f, form) in forms(mesh, lod)?.into_iter().enumerate() {
        let id = mesh.feature_ids.get(f);
        if let Some(&i) = index.get(id) {
            if form.surfaces.is_empty() {
                continue;
            }
            if pieces[i].forms.iter().any(|g| g.lod == lod) {
                let message = format!("building `{id}` already has the level of detail `{lod}`");
                return Err(Diagnostic::error("lod-taken", message).value(lod).help("say another `lod`"));
            }
            pieces[i].forms.push(form);
            continue;
        }
        let unknown =
            || Diagnostic::error("unknown-building", format!("no building is called `{id}`, as the mesh says"));
        let cluster: u32 = id.strip_prefix("cluster-").and_then(|c| c.parse().ok()).ok_or_else(unknown)?;
        let Some(((footprints, tree), (order, first))) = tree.zip(order.as_ref()) else {
            let message = "the mesh has clusters, but nothing says which buildings they have";
            return Err(Diagnostic::error("missing-input", message).help("connect `in.footprints` and `in.dendrogram`"));
        };
        if cluster as usize >= tree.cluster_count() || tree.leaf_count() != footprints.len() {
            let message = format!("cluster {cluster} is not one of the dendrogram over {} leaves", tree.leaf_count());
            return Err(Diagnostic::error("inputs-differ", message));
        }
        let start = first[cluster as usize] as usize;
        let mut leaves = order[start..start + tree.size_of(cluster) as usize].to_vec();
        leaves.sort_unstable();
        let children: Vec<String> = leaves.iter().map(|&l| footprints.ids.get(l as usize).to_string()).collect();
        for child in &children {
            let i = *index.get(child).ok_or_else(unknown)?;
            pieces[i].parents.push(id.to_string());
        }
        let attributes = cityjson::attributes(&mesh.attributes, f);
        let forms = if form.surfaces.is_empty() { Vec::new() } else { vec![form] };
        groups.push(Piece {
            id: id.to_string(),
            kind: "CityObjectGroup",
            attributes,
            children,
            forms,
            ..Piece::default()
        });
    }
    Ok(groups)
}

/// The triangles of each feature as surfaces, named by their primitive.
fn forms(mesh: &Mesh, lod: &str) -> Result<Vec<Form>> {
    let mut out = vec![Form { lod: lod.to_string(), ..Form::default() }; mesh.feature_ids.len()];
    for part in &mesh.primitives {
        let kind = match part.name.as_str() {
            "ground" => GROUND,
            "wall" => WALL,
            "roof" => ROOF,
            _ => OTHER,
        };
        let from = part.first_triangle as usize;
        for t in &mesh.triangles[from..from + part.triangles as usize] {
            let corner = |v: u32| -> Option<[i32; 3]> {
                let p = mesh.positions[v as usize];
                let [x, y]: Point = crate::geom::frame::grid([p[0], p[1]])?;
                Some([x, y, crate::geom::frame::grid([p[2], 0.0])?[0]])
            };
            let corners: Option<Vec<[i32; 3]>> = t.iter().map(|&v| corner(v)).collect();
            let corners = corners.ok_or_else(|| Diagnostic::error("too-far", "the mesh reaches beyond 2^29 mm"))?;
            let form = &mut out[mesh.features[t[0] as usize] as usize];
            form.surfaces.push(vec![corners]);
            form.semantics.push(kind);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use serde_json::Value;

    use super::*;
    use crate::artifact::mesh::Primitive;
    use crate::artifact::{Attributes, Shapes};
    use crate::op::Bench;

    fn buildings() -> Buildings {
        let mut surfaces = Shapes::default();
        for at in [0, 10_000] {
            surfaces.push_ring(&[[at, 0, 0], [at + 1000, 0, 0], [at, 1000, 0]]);
            surfaces.end_polygon();
            surfaces.end_shape();
        }
        Buildings {
            frame: Frame::local(),
            ids: ["a", "b"].iter().collect(),
            attributes: Attributes::default(),
            starts: vec![0, 1, 2],
            lods: ["0", "0"].iter().collect(),
            surfaces,
            semantics: vec![GROUND; 2],
        }
    }

    /// A tetrahedron for each name.
    fn mesh(names: &[&str]) -> Mesh {
        let mut out = Mesh {
            frame: Frame::local(),
            positions: Vec::new(),
            triangles: Vec::new(),
            features: Vec::new(),
            primitives: Vec::new(),
            feature_ids: names.iter().collect(),
            attributes: Attributes::default(),
            surface: Default::default(),
        };
        for f in 0..names.len() as u32 {
            let v = 4 * f;
            out.positions.extend([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
            out.triangles.extend([[v, v + 2, v + 1], [v, v + 1, v + 3], [v + 1, v + 2, v + 3], [v + 2, v, v + 3]]);
            out.features.extend([f; 4]);
        }
        out.primitives.push(Primitive {
            name: "roof".into(),
            first_triangle: 0,
            triangles: out.triangles.len() as u32,
            material: None,
        });
        out
    }

    fn run(params: &str, mesh: Option<Mesh>, with_tree: bool) -> Result<Value> {
        let bench = Bench::default();
        let op: WriteCityjson = toml::from_str(params).unwrap();
        let tree = Dendrogram {
            left: vec![0],
            right: vec![1],
            distance: vec![1.0],
            cost: vec![1.0],
            size: vec![2],
            crosses_barrier: vec![false],
            leaves: vec![2],
        };
        let footprints = Footprints {
            frame: Frame::local(),
            ids: ["a", "b"].iter().collect(),
            polygons: Shapes::default(),
            base: vec![0.0; 2],
            top: vec![1.0; 2],
            attributes: Attributes::default(),
        };
        let files = op.run(
            &bench.ctx(),
            In {
                buildings: Arc::new(buildings()),
                mesh: mesh.map(Arc::new),
                footprints: with_tree.then(|| Arc::new(footprints)),
                dendrogram: with_tree.then(|| Arc::new(tree)),
            },
        )?;
        let blobs = bench.blobs.0.lock().unwrap();
        let text = std::str::from_utf8(&blobs[&files.files[0].blob.digest]).unwrap();
        Ok(text.lines().map(|l| serde_json::from_str(l).unwrap()).next_back().unwrap())
    }

    #[test]
    fn clusters_are_groups() {
        let out = run("path = 'a.city.json'", Some(mesh(&["a", "b", "cluster-2"])), true).unwrap();
        let objects = &out["CityObjects"];
        assert_eq!(objects["cluster-2"]["type"], "CityObjectGroup");
        assert_eq!(objects["cluster-2"]["children"], serde_json::json!(["a", "b"]));
        assert_eq!(objects["cluster-2"]["geometry"][0]["type"], "Solid");
        assert_eq!(objects["cluster-2"]["geometry"][0]["lod"], "1.0");
        assert_eq!(objects["a"]["parents"], serde_json::json!(["cluster-2"]));
        assert_eq!(objects["a"]["geometry"].as_array().unwrap().len(), 2);
        assert_eq!(objects["a"]["geometry"][1]["semantics"]["surfaces"][0]["type"], "RoofSurface");
    }

    #[test]
    fn a_sequence_of_buildings() {
        let last = run("path = 'a.city.jsonl'", Some(mesh(&["b"])), false).unwrap();
        assert_eq!((&last["type"], &last["id"]), (&"CityJSONFeature".into(), &"b".into()));
        assert_eq!(last["CityObjects"]["b"]["geometry"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn levels_that_cityjson_knows() {
        let wrong = |lod: &str| !WriteCityjson { lod: lod.into(), ..WriteCityjson::default() }.check().is_empty();
        assert!(["0", "3", "0.1", "3.3"].iter().all(|lod| !wrong(lod)));
        assert!(["", "4", "1.4", "0.5", "1.", "LoD1", "2.21"].iter().all(|lod| wrong(lod)));
    }

    #[test]
    fn mistakes() {
        let code = |params: &str, names: &[&str], tree: bool| run(params, Some(mesh(names)), tree).unwrap_err().code;
        assert_eq!(code("path = 'a.json'\nlod = '0'", &["a"], false), "lod-taken");
        assert_eq!(code("path = 'a.json'", &["c"], false), "unknown-building");
        assert_eq!(code("path = 'a.json'", &["cluster-2"], false), "missing-input");
        assert_eq!(code("path = 'a.json'", &["cluster-9"], true), "inputs-differ");
        assert_eq!(code("path = 'a.jsonl'", &["cluster-2"], true), "no-groups");
    }
}
