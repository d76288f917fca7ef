//! GLB files whose buffer views are packed by EXT_meshopt_compression or KHR_meshopt_compression, as gltfpack makes them.

use std::collections::BTreeMap;

use meshoptimizer_rs::{Workspace, codec};
use serde_json::{Value, json};

pub const EXT: &str = "EXT_meshopt_compression";
pub const KHR: &str = "KHR_meshopt_compression";

/// Text and chunk of a GLB.
pub fn parts(glb: &[u8]) -> (Value, Vec<u8>) {
    let end = 20 + u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&glb[20..end]).unwrap(), glb[end + 8..].to_vec())
}

/// And together again.
pub fn whole(root: &Value, chunk: &[u8]) -> Vec<u8> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut chunk = chunk.to_vec();
    chunk.resize(chunk.len().next_multiple_of(4), 0);
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend(((28 + text.len() + chunk.len()) as u32).to_le_bytes());
    for (kind, body) in [(b"JSON", &text), (b"BIN\0", &chunk)] {
        out.extend((body.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(body);
    }
    out
}

/// Elements of `stride` bytes as a stream, as the extension of that name has them.
pub fn attributes(name: &str, bytes: &[u8], stride: usize) -> Vec<u8> {
    let how = codec::VertexEncoding::new(u8::from(name == KHR), 2).unwrap();
    codec::encode_vertex_buffer(bytes, bytes.len() / stride, stride, how, &mut Workspace::default()).unwrap()
}

pub fn triangles(indices: &[u32]) -> Vec<u8> {
    let how = codec::IndexEncoding::DEFAULT;
    codec::encode_index_buffer(indices, how, &mut Workspace::default()).unwrap()
}

pub fn sequence(indices: &[u32]) -> Vec<u8> {
    let how = codec::IndexEncoding::DEFAULT;
    codec::encode_index_sequence(indices, how, &mut Workspace::default()).unwrap()
}

/// A glTF in the making: packed views, plain ones, and the room that the packed ones would take.
pub struct Packed {
    pub name: &'static str,
    chunk: Vec<u8>,
    pub views: Vec<Value>,
    plain: usize,
}

impl Packed {
    pub fn new(name: &'static str) -> Self {
        Self { name, chunk: Vec::new(), views: Vec::new(), plain: 0 }
    }

    fn append(&mut self, bytes: &[u8]) -> usize {
        self.chunk.resize(self.chunk.len().next_multiple_of(4), 0);
        self.chunk.extend(bytes);
        self.chunk.len() - bytes.len()
    }

    pub fn plain(&mut self, bytes: &[u8]) -> usize {
        let at = self.append(bytes);
        self.views.push(json!({"buffer": 0, "byteOffset": at, "byteLength": bytes.len()}));
        self.views.len() - 1
    }

    /// So many elements, each of so many bytes, as a stream of this mode and filter.
    pub fn view(&mut self, mode: &str, filter: Option<&str>, count: usize, stride: usize, stream: &[u8]) -> usize {
        let at = self.append(stream);
        let mut said = json!({"buffer": 0, "byteOffset": at, "byteLength": stream.len(), "byteStride": stride,
            "count": count, "mode": mode});
        if let Some(filter) = filter {
            said["filter"] = filter.into();
        }
        let mut view = json!({"buffer": 1, "byteOffset": self.plain, "byteLength": count * stride,
            "extensions": {self.name: said}});
        if mode == "ATTRIBUTES" {
            view["byteStride"] = stride.into();
        }
        self.plain += (count * stride).next_multiple_of(4);
        self.views.push(view);
        self.views.len() - 1
    }

    pub fn finish(self, mut root: Value) -> Vec<u8> {
        let name = self.name;
        root["asset"] = json!({"version": "2.0"});
        root["bufferViews"] = self.views.into();
        root["buffers"] = json!([{"byteLength": self.chunk.len()},
            {"byteLength": self.plain, "extensions": {name: {"fallback": true}}}]);
        for list in ["extensionsUsed", "extensionsRequired"] {
            let mut all = root[list].as_array().cloned().unwrap_or_default();
            all.push(name.into());
            root[list] = all.into();
        }
        whole(&root, &self.chunk)
    }
}

/// Bytes of a component, and components of an element.
fn layout(accessor: &Value) -> (usize, usize) {
    let size = match accessor["componentType"].as_u64().unwrap() {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        _ => 4,
    };
    let width = match accessor["type"].as_str().unwrap() {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" => 4,
        _ => 16,
    };
    (size, width)
}

/// A GLB with every view packed that accessors use. Indices of triangles are packed as such where `lists` says so, which
/// turns triangles' corners on; all others as sequences. Elements grow to multiples of four bytes.
pub fn packed(glb: &[u8], name: &'static str, lists: bool) -> Vec<u8> {
    let (root, chunk) = parts(glb);
    let all = |list: &str| root[list].as_array().cloned().unwrap_or_default();
    let mut indices = BTreeMap::new();
    for p in all("meshes").iter().flat_map(|m| m["primitives"].as_array().unwrap()) {
        if let Some(i) = p["indices"].as_u64() {
            indices.insert(i as usize, lists && p["mode"].as_u64().unwrap_or(4) == 4);
        }
    }
    let mut out = Packed::new(name);
    for (v, view) in all("bufferViews").iter().enumerate() {
        let number = |key: &str| view[key].as_u64().map(|n| n as usize);
        let bytes = &chunk[number("byteOffset").unwrap_or(0)..][..number("byteLength").unwrap()];
        let Some((i, user)) = all("accessors").into_iter().enumerate().find(|(_, a)| a["bufferView"] == v) else {
            out.plain(bytes);
            continue;
        };
        let (size, width) = layout(&user);
        match indices.get(&i) {
            Some(_) if size == 1 => out.plain(bytes),
            Some(&list) => {
                let word = |b: &[u8]| b.iter().rev().fold(0u32, |w, &b| w << 8 | u32::from(b));
                let corners: Vec<u32> = bytes.chunks(size).map(word).collect();
                let (mode, stream) =
                    if list { ("TRIANGLES", triangles(&corners)) } else { ("INDICES", sequence(&corners)) };
                out.view(mode, None, corners.len(), size, &stream)
            }
            None => {
                let stride = number("byteStride").unwrap_or(size * width);
                let mut padded = Vec::new();
                for row in bytes.chunks(stride) {
                    padded.extend(row);
                    padded.resize(padded.len().next_multiple_of(4), 0);
                }
                let stride = stride.next_multiple_of(4);
                padded.resize(padded.len().next_multiple_of(stride), 0);
                out.view("ATTRIBUTES", None, padded.len() / stride, stride, &attributes(name, &padded, stride))
            }
        };
    }
    out.finish(root)
}
