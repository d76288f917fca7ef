//! Reads a tileset back and holds it against the tree that it was written from. Knows nothing of the writer: only
//! 3D Tiles, glTF and the two metadata extensions.

use std::collections::BTreeMap;

use lodge::artifact::{Files, TileTree, Values};
use lodge::digest::Digest;
use lodge::op::MemoryBlobs;
use serde_json::Value;

pub type Published = BTreeMap<String, Vec<u8>>;
type Point = [f64; 3];

/// What `lodge run` would publish below `folder`.
pub fn publish(folder: &str, files: &Files, blobs: &MemoryBlobs) -> Published {
    let blobs = blobs.0.lock().unwrap();
    let sorted = files.files.windows(2).all(|w| w[0].path < w[1].path);
    assert!(sorted, "files are sorted and named once");
    let name = |path: &str| path.strip_prefix(folder).unwrap().strip_prefix('/').unwrap().to_string();
    files.files.iter().map(|f| (name(&f.path), blobs[&f.blob.digest].clone())).collect()
}

/// Counts of what was checked.
#[derive(Debug, Default, PartialEq)]
pub struct Seen {
    pub tiles: usize,
    pub leaves: usize,
    pub triangles: usize,
    pub most_triangles: usize,
    pub most_bytes: usize,
    pub buildings: usize,
    /// Largest distance of a vertex from where the tree has it, metres.
    pub worst_position: f64,
}

/// Panics where the tileset breaks a rule. `ecef` is the way of a local point to the globe.
pub fn check(published: &Published, tree: &TileTree, ecef: &dyn Fn(Point) -> Point) -> Seen {
    let tileset: Value = serde_json::from_slice(&published["tileset.json"]).unwrap();
    assert_eq!(tileset["asset"]["version"], "1.1");
    let root = &tileset["root"];
    assert_eq!(root["refine"], "REPLACE");
    assert!(tileset["geometricError"].as_f64() >= root["geometricError"].as_f64());
    let mut all =
        Walk { published, tree, ecef, seen: Seen::default(), used: vec!["tileset.json".into()], ids: Vec::new() };
    all.tile(root, &mut Vec::new());
    all.used.sort();
    all.used.dedup();
    assert!(all.used.iter().eq(published.keys()), "every file is named by the tileset, and every name is a file");
    let order: Vec<&str> = tree.ids.iter().collect();
    assert_eq!(all.ids, order, "every building in exactly one leaf, in leaf order");
    all.seen
}

struct Walk<'a> {
    published: &'a Published,
    tree: &'a TileTree,
    ecef: &'a dyn Fn(Point) -> Point,
    seen: Seen,
    used: Vec<String>,
    ids: Vec<String>,
}

/// One tile above another: its way to the outermost axes and its box there.
struct Above {
    matrix: [f64; 16],
    bounds: Vec<f64>,
}

impl Walk<'_> {
    fn tile(&mut self, tile: &Value, above: &mut Vec<Above>) {
        self.seen.tiles += 1;
        let numbers = |v: &Value| v.as_array().map(|a| a.iter().map(|x| x.as_f64().unwrap()).collect::<Vec<f64>>());
        let own: [f64; 16] = numbers(&tile["transform"]).map_or(IDENTITY, |m| m.try_into().unwrap());
        let matrix = above.last().map_or(own, |a| times(&a.matrix, &own));
        let bounds = numbers(&tile["boundingVolume"]["box"]).unwrap();
        for p in corners(&bounds).map(|c| apply(&matrix, c)) {
            above.iter().for_each(|a| inside(a, p, "a child's box"));
        }
        above.push(Above { matrix, bounds });

        let error = tile["geometricError"].as_f64().unwrap();
        let data = &tile["metadata"]["properties"];
        let [first, count] = ["source_first", "source_count"].map(|k| data[k].as_u64().unwrap());
        assert!(data["error_negative_space"].as_f64().unwrap() <= error + 1e-9);
        assert!(data["error_height"].as_f64().unwrap() <= error + 1e-9);
        let none = Vec::new();
        let children = tile["children"].as_array().unwrap_or(&none);
        let mut next = first;
        for child in children {
            assert!(child["geometricError"].as_f64().unwrap() <= error, "errors grow up the tree");
            assert_eq!(child["metadata"]["properties"]["source_first"], next, "children take up their parent's range");
            next += child["metadata"]["properties"]["source_count"].as_u64().unwrap();
        }
        let leaf = children.is_empty();
        assert!(leaf || next == first + count, "children cover their parent's range");
        assert!(!leaf || error == 0.0, "leaves are the originals");
        self.content(&tile["content"], leaf, first as usize, count as usize, above);
        children.iter().for_each(|c| self.tile(c, above));
        above.pop();
    }

    fn content(&mut self, content: &Value, leaf: bool, first: usize, count: usize, above: &[Above]) {
        let uri = content["uri"].as_str().expect("every tile has content");
        self.used.push(uri.into());
        let bytes = &self.published[uri];
        let name = uri.strip_prefix("t/").and_then(|n| n.strip_suffix(".glb")).unwrap();
        assert!(Digest::of(bytes).to_string().starts_with(name), "contents are named by their digest");
        let glb = Glb::read(bytes);
        self.seen.triangles += glb.triangles;
        self.seen.most_triangles = self.seen.most_triangles.max(glb.triangles);
        self.seen.most_bytes = self.seen.most_bytes.max(bytes.len());

        // Sources: every one in one range, landmarks of inner tiles again beside them.
        let firsts: Vec<u32> = glb.numbers("source_first", u32::from_le_bytes);
        let counts: Vec<u32> = glb.numbers("source_count", u32::from_le_bytes);
        let landmark = glb.flags("landmark");
        let mut hits = vec![0; count];
        for f in 0..glb.features {
            let range = firsts[f] as usize..(firsts[f] + counts[f]) as usize;
            assert!(leaf || !landmark[f] || counts[f] == 1, "a landmark is one building");
            if leaf || !landmark[f] {
                hits[range].iter_mut().for_each(|h| *h += 1);
            } else {
                assert!(range.end <= count);
            }
        }
        assert!(hits.iter().all(|&h| h == 1), "every source in exactly one range: {hits:?}");
        for key in ["footprint_area_m2", "height_min", "height_max", "negative_space_m2"] {
            assert!(glb.numbers(key, f64::from_le_bytes).iter().all(|v| v.is_finite()));
        }

        if leaf {
            self.seen.leaves += 1;
            self.seen.buildings += count;
            let path = uri.replace(".glb", ".ids.json");
            assert_eq!(content["extras"]["ids"], path.as_str());
            let ids: Value = serde_json::from_slice(&self.published[&path]).unwrap();
            self.used.push(path);
            let ids: Vec<&str> = ids["ids"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
            assert_eq!(ids.len(), count);
            let own = glb.texts("id");
            for f in 0..glb.features {
                assert_eq!(own[f], ids[firsts[f] as usize]);
            }
            self.attributes(&glb, &firsts, first);
            self.ids.extend(ids.iter().map(|s| s.to_string()));
        } else {
            assert!(glb.property("id").is_none());
        }
        self.places(&glb, &firsts, &counts, &landmark, leaf, first, above);
    }

    /// Source attributes, gaps included.
    fn attributes(&self, glb: &Glb, firsts: &[u32], first: usize) {
        for column in &self.tree.attributes.columns {
            let Some((key, property)) = glb.property_named(&column.name) else {
                assert!(firsts.iter().all(|&f| !column.present[first + f as usize]), "`{}` is lost", column.name);
                continue;
            };
            let free = &property["noData"];
            let rows: Vec<usize> = firsts.iter().map(|&f| first + f as usize).collect();
            let got: Vec<Value> = match property["type"].as_str().unwrap() {
                "STRING" => glb.texts(&key).into_iter().map(Value::from).collect(),
                "BOOLEAN" => glb.flags(&key).into_iter().map(Value::from).collect(),
                _ => match property["componentType"].as_str().unwrap() {
                    "UINT32" => glb.numbers(&key, u32::from_le_bytes).into_iter().map(Value::from).collect(),
                    "INT32" => glb.numbers(&key, i32::from_le_bytes).into_iter().map(Value::from).collect(),
                    _ => glb.numbers(&key, f64::from_le_bytes).into_iter().map(Value::from).collect(),
                },
            };
            for (f, &row) in rows.iter().enumerate() {
                let want = match &column.values {
                    Values::U32(v) => Value::from(v[row]),
                    Values::I32(v) => Value::from(v[row]),
                    Values::F64(v) => Value::from(v[row]),
                    Values::Bool(v) if property["type"] == "STRING" => Value::from(v[row].to_string()),
                    Values::Bool(v) => Value::from(v[row]),
                    Values::Text(v) => Value::from(v.get(row)),
                };
                match column.present[row] {
                    true => assert!(got[f] == want && got[f] != *free, "`{}`: {} {want}", column.name, got[f]),
                    false => assert_eq!(&got[f], free, "`{}` of {row} is a gap", column.name),
                }
            }
        }
    }

    /// Every vertex in the boxes of its tile and of all above; every vertex where the tree has a corner of that
    /// feature, and every corner of the plan with a vertex.
    #[allow(clippy::too_many_arguments)]
    fn places(
        &mut self,
        glb: &Glb,
        firsts: &[u32],
        counts: &[u32],
        landmark: &[bool],
        leaf: bool,
        first: usize,
        above: &[Above],
    ) {
        let tree = self.tree;
        let matrix = above.last().unwrap().matrix;
        let mut got: Vec<Vec<Point>> = vec![Vec::new(); glb.features];
        for (p, f) in &glb.corners {
            // 3D Tiles turns glTF's y up to z up.
            let p = apply(&matrix, [p[0], -p[2], p[1]]);
            above.iter().for_each(|a| inside(a, p, "a vertex"));
            got[*f as usize].push(p);
        }
        // The tree's tile that this is, by what it covers and draws.
        let t = (0..tree.len())
            .find(|&t| {
                let own = tree.features_of(t);
                tree.source_first[t] as usize == first
                    && tree.is_leaf[t] == leaf
                    && own.len() == firsts.len()
                    && own.clone().zip(0..).all(|(f, i)| {
                        tree.feature_first[f] as usize == first + firsts[i] as usize
                            && tree.feature_count[f] == counts[i]
                            && tree.landmark[f] == landmark[i]
                    })
            })
            .expect("the tile is in the tree");
        for (f, got) in tree.features_of(t).zip(&got) {
            let metres = |v: i32| f64::from(v) / 1000.0;
            let mut want: Vec<Point> = Vec::new();
            for r in tree.plans.polygons_of(f).flat_map(|p| tree.plans.rings_of(p)) {
                let ring = tree.plans.ring(r);
                want.extend(ring.iter().map(|p| [metres(p[0]), metres(p[1]), tree.top[f]]));
                if tree.top[f] > tree.base[f] {
                    want.extend(ring.iter().map(|p| [metres(p[0]), metres(p[1]), tree.base[f]]));
                }
            }
            for r in tree.solids.polygons_of(f).flat_map(|p| tree.solids.rings_of(p)) {
                want.extend(tree.solids.ring(r).iter().map(|p| p.map(metres)));
            }
            let want: Vec<Point> = want.into_iter().map(|p| (self.ecef)(p)).collect();
            for (from, to) in [(got, &want), (&want, got)] {
                for p in from {
                    let d = |q: &Point| (0..3).map(|k| (p[k] - q[k]) * (p[k] - q[k])).sum::<f64>();
                    let near = to.iter().map(d).fold(f64::INFINITY, f64::min).sqrt();
                    assert!(near < 0.01, "feature {f} of tile {t} is off by {near} m");
                    self.seen.worst_position = self.seen.worst_position.max(near);
                }
            }
        }
    }
}

const IDENTITY: [f64; 16] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

fn times(a: &[f64; 16], b: &[f64; 16]) -> [f64; 16] {
    std::array::from_fn(|i| (0..4).map(|k| a[i % 4 + 4 * k] * b[i / 4 * 4 + k]).sum())
}

fn apply(m: &[f64; 16], p: Point) -> Point {
    [0, 1, 2].map(|k| m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k])
}

fn corners(b: &[f64]) -> [Point; 8] {
    std::array::from_fn(|i| {
        let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        [0, 1, 2].map(|k| b[k] + sign(0) * b[3 + k] + sign(1) * b[6 + k] + sign(2) * b[9 + k])
    })
}

/// `p`, in the outermost axes, lies in the tile's box (no slack but rounding on the way there: 1 micrometre).
fn inside(tile: &Above, p: Point, what: &str) {
    let (m, b) = (&tile.matrix, &tile.bounds);
    let d = [0, 1, 2].map(|k| p[k] - m[12 + k]);
    let own = [0, 1, 2].map(|k| (0..3).map(|j| m[4 * k + j] * d[j]).sum::<f64>());
    for k in 0..3 {
        let (axis, at) = (&b[3 + 3 * k..6 + 3 * k], [0, 1, 2].map(|j| own[j] - b[j]));
        let size = axis.iter().map(|v| v * v).sum::<f64>();
        let along = (0..3).map(|j| axis[j] * at[j]).sum::<f64>() / size.sqrt();
        assert!(along.abs() <= size.sqrt() + 1e-6, "{what} sticks out by {} m", along.abs() - size.sqrt());
    }
}

/// What a GLB says, read by the `gltf` crate and the extensions' texts.
struct Glb {
    json: Value,
    bytes: Vec<u8>,
    features: usize,
    triangles: usize,
    corners: Vec<(Point, u32)>,
}

impl Glb {
    fn read(bytes: &[u8]) -> Self {
        let file = gltf::Glb::from_slice(bytes).unwrap();
        let json: Value = serde_json::from_slice(&file.json).unwrap();
        let blob = file.bin.unwrap().into_owned();
        let document = gltf::Gltf::from_slice_without_validation(bytes).unwrap().document;
        let features = json["extensions"]["EXT_structural_metadata"]["propertyTables"][0]["count"].as_u64().unwrap();
        let mut out = Self { features: features as usize, triangles: 0, corners: Vec::new(), json, bytes: blob };
        for (m, mesh) in document.meshes().enumerate() {
            for (p, primitive) in mesh.primitives().enumerate() {
                let ext = &out.json["meshes"][m]["primitives"][p]["extensions"]["EXT_mesh_features"]["featureIds"][0];
                assert_eq!(ext["featureCount"], features);
                assert_eq!(ext["propertyTable"], 0);
                let reader = primitive.reader(|_| Some(&out.bytes));
                let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
                let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
                let accessor = &out.json["meshes"][m]["primitives"][p]["attributes"]["_FEATURE_ID_0"];
                let ids = out.accessor(accessor.as_u64().unwrap() as usize);
                assert!(indices.iter().all(|&i| (i as usize) < positions.len()));
                assert_eq!(ids.len(), positions.len());
                assert!(ids.iter().all(|&f| u64::from(f) < features));
                out.triangles += indices.len() / 3;
                out.corners.extend(positions.iter().zip(ids).map(|(p, f)| (p.map(f64::from), f)));
            }
        }
        out
    }

    /// A scalar accessor of u16 or f32.
    fn accessor(&self, i: usize) -> Vec<u32> {
        let a = &self.json["accessors"][i];
        let view = &self.json["bufferViews"][a["bufferView"].as_u64().unwrap() as usize];
        let n = |v: &Value| v.as_u64().unwrap_or(0) as usize;
        let (start, stride) = (n(&view["byteOffset"]) + n(&a["byteOffset"]), n(&view["byteStride"]));
        let cell = |i: usize| &self.bytes[start + i * stride..];
        let read = |c: &[u8]| match a["componentType"].as_u64().unwrap() {
            5123 => u32::from(u16::from_le_bytes([c[0], c[1]])),
            5126 => f32::from_le_bytes([c[0], c[1], c[2], c[3]]) as u32,
            other => panic!("feature ids of type {other}"),
        };
        (0..n(&a["count"])).map(|i| read(cell(i))).collect()
    }

    fn property(&self, key: &str) -> Option<&Value> {
        let metadata = &self.json["extensions"]["EXT_structural_metadata"];
        let class = metadata["propertyTables"][0]["class"].as_str()?;
        metadata["schema"]["classes"][class]["properties"].get(key)
    }

    /// A property by the name that it has in the source.
    fn property_named(&self, name: &str) -> Option<(String, &Value)> {
        let metadata = &self.json["extensions"]["EXT_structural_metadata"];
        let class = metadata["propertyTables"][0]["class"].as_str()?;
        let all = metadata["schema"]["classes"][class]["properties"].as_object()?;
        let named = all.iter().find(|(_, p)| p["name"] == name);
        let (key, property) = named.or_else(|| all.iter().find(|(k, p)| *k == name && p.get("name").is_none()))?;
        Some((key.clone(), property))
    }

    fn view(&self, property: &str, part: &str) -> &[u8] {
        let table = &self.json["extensions"]["EXT_structural_metadata"]["propertyTables"][0];
        let view = table["properties"][property][part].as_u64().unwrap() as usize;
        let view = &self.json["bufferViews"][view];
        let [start, size] = ["byteOffset", "byteLength"].map(|k| view[k].as_u64().unwrap() as usize);
        assert_eq!(start % 8, 0);
        &self.bytes[start..start + size]
    }

    fn numbers<T, const N: usize>(&self, property: &str, read: fn([u8; N]) -> T) -> Vec<T> {
        let bytes = self.view(property, "values");
        assert_eq!(bytes.len(), N * self.features);
        bytes.as_chunks::<N>().0.iter().map(|c| read(*c)).collect()
    }

    fn flags(&self, property: &str) -> Vec<bool> {
        let bytes = self.view(property, "values");
        assert_eq!(bytes.len(), self.features.div_ceil(8));
        (0..self.features).map(|i| bytes[i / 8] >> (i % 8) & 1 == 1).collect()
    }

    fn texts(&self, property: &str) -> Vec<String> {
        let ends = self.view(property, "stringOffsets");
        let table = &self.json["extensions"]["EXT_structural_metadata"]["propertyTables"][0];
        let width = match table["properties"][property]["stringOffsetType"].as_str() {
            Some("UINT8") => 1,
            Some("UINT16") => 2,
            Some("UINT32") => 4,
            other => panic!("{other:?}"),
        };
        let number = |c: &[u8]| c.iter().rev().fold(0, |sum, &b| sum << 8 | usize::from(b));
        let ends: Vec<usize> = ends.chunks(width).map(number).collect();
        assert_eq!(ends.len(), self.features + 1);
        let bytes = self.view(property, "values");
        ends.windows(2).map(|w| String::from_utf8(bytes[w[0]..w[1]].to_vec()).unwrap()).collect()
    }
}
