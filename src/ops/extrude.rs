//! Blocks: every hull a closed prism from its ground to its roof, every single building its own ground polygons.
//!
//! In:     hulls (all nodes, or a cut), footprints that they stand for.
//! Out:    one feature per hull. A cluster is its ring between ground and ground + height, a leaf its ground
//!         polygons, courtyards included, between its own base and top. Walls, roofs and grounds are three
//!         primitives over shared vertices: closed, each edge in two triangles, once each way.
//! Errors: a cluster number beyond the footprints' tree. Hulls without a ring give a feature without triangles.
//! Cost:   near O(edges log edges) of the largest ring. A ring of k edges gives 4k - 4 triangles.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 6.

use rayon::prelude::*;

use crate::artifact::mesh::Primitive;
use crate::artifact::{Attributes, Column, Footprints, Hulls, Mesh, Values};
use crate::diag::{Diagnostic, Result};
use crate::geom::Point;
use crate::geom::triangulate::Triangulator;
use crate::op::{Ctx, Op};

crate::params! {
    /// Blocks from rings and heights.
    pub struct Extrude {}
}

crate::inputs! {
    /// Rings with ground and height.
    hulls: Hulls,
    /// The buildings below them.
    footprints: Footprints,
}

impl Op for Extrude {
    const NAME: &'static str = "extrude";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Mesh;

    fn run(&self, _: &Ctx, input: In) -> Result<Mesh> {
        let clusters = 2 * input.footprints.len();
        if let Some(c) = input.hulls.cluster.iter().find(|&&c| c as usize >= clusters) {
            let message = format!("cluster {c} is beyond the tree over {} footprints", input.footprints.len());
            return Err(Diagnostic::error("inputs-differ", message));
        }
        Ok(extrude(&input.hulls, &input.footprints))
    }

    fn estimate_of(&self, ports: &[u64], _: u64) -> u64 {
        // The prisms are some eight times the hulls, and are there twice; the footprints are only read.
        (1 << 20) + 16 * ports[0] + 5 * ports[1] / 4
    }
}

/// One prism per hull, in order.
pub fn extrude(hulls: &Hulls, footprints: &Footprints) -> Mesh {
    let prisms: Vec<Prism> =
        (0..hulls.len()).into_par_iter().map_init(Triangulator::new, |t, i| prism(hulls, footprints, i, t)).collect();

    let mut mesh = Mesh {
        frame: hulls.frame.clone(),
        positions: Vec::with_capacity(prisms.iter().map(|p| p.positions.len()).sum()),
        triangles: Vec::with_capacity(prisms.iter().map(|p| 2 * p.positions.len()).sum()),
        features: Vec::new(),
        primitives: Vec::new(),
        feature_ids: (0..hulls.len()).map(|i| name(hulls, footprints, i)).collect(),
        attributes: attributes(hulls),
        surface: Default::default(),
    };
    for name in ["wall", "roof", "ground"] {
        let (first_triangle, mut base) = (mesh.triangles.len() as u32, 0);
        for p in &prisms {
            let part = match name {
                "wall" => &p.walls,
                "roof" => &p.roof,
                _ => &p.ground,
            };
            mesh.triangles.extend(part.iter().map(|t| t.map(|v| v + base)));
            base += p.positions.len() as u32;
        }
        let triangles = mesh.triangles.len() as u32 - first_triangle;
        mesh.primitives.push(Primitive { name: name.into(), first_triangle, triangles, material: None });
    }
    for (i, p) in prisms.into_iter().enumerate() {
        mesh.features.resize(mesh.features.len() + p.positions.len(), i as u32);
        mesh.positions.extend(p.positions);
    }
    mesh
}

/// One feature's part of the mesh: of each ring first the feet, then the heads.
#[derive(Default)]
struct Prism {
    positions: Vec<[f64; 3]>,
    walls: Vec<[u32; 3]>,
    roof: Vec<[u32; 3]>,
    ground: Vec<[u32; 3]>,
}

fn prism(hulls: &Hulls, footprints: &Footprints, i: usize, triangulator: &mut Triangulator) -> Prism {
    let mut out = Prism::default();
    let cluster = hulls.cluster[i] as usize;
    if cluster < footprints.len() {
        let polygons = &footprints.polygons;
        for p in polygons.polygons_of(cluster) {
            let rings: Vec<&[Point]> = polygons.rings_of(p).map(|r| polygons.ring(r)).collect();
            out.raise(&rings, footprints.base[cluster], footprints.top[cluster], triangulator);
        }
    } else {
        let ring: Vec<Point> = hulls.points(i).collect();
        out.raise(&[&ring], hulls.ground[i], hulls.ground[i] + hulls.height[i], triangulator);
    }
    out
}

impl Prism {
    /// Adds a polygon between two heights; nothing where it has no area. Shells turn left, holes right.
    fn raise(&mut self, rings: &[&[Point]], base: f64, top: f64, triangulator: &mut Triangulator) {
        let mut flat = Vec::new();
        triangulator.plan(rings.iter().copied(), &mut flat);
        if flat.is_empty() {
            return;
        }
        let count = rings.iter().map(|r| r.len() as u32).sum::<u32>();
        let feet = self.positions.len() as u32;
        let heads = feet + count;
        for z in [base, top] {
            let points = rings.iter().flat_map(|r| r.iter());
            self.positions.extend(points.map(|p| [f64::from(p[0]) / 1000.0, f64::from(p[1]) / 1000.0, z]));
        }
        let mut start = 0;
        for ring in rings {
            let n = ring.len() as u32;
            for k in 0..n {
                let (a, b) = (start + k, start + (k + 1) % n);
                self.walls.extend([[feet + a, feet + b, heads + b], [feet + a, heads + b, heads + a]]);
            }
            start += n;
        }
        self.roof.extend(flat.iter().map(|t| t.map(|v| heads + v)));
        self.ground.extend(flat.iter().map(|t| [feet + t[0], feet + t[2], feet + t[1]]));
    }
}

/// A building's id, or `cluster-17`.
fn name(hulls: &Hulls, footprints: &Footprints, i: usize) -> String {
    let cluster = hulls.cluster[i] as usize;
    if cluster < footprints.len() { footprints.ids.get(cluster).to_string() } else { format!("cluster-{cluster}") }
}

/// What a reader of the mesh wants to know of each block; columns sorted by name.
fn attributes(hulls: &Hulls) -> Attributes {
    let column = |name: &str, values: Values| Column { name: name.into(), present: vec![true; values.len()], values };
    Attributes {
        columns: vec![
            column("area_m2", Values::F64(hulls.area_m2.clone())),
            column("buildings", Values::U32(hulls.buildings.clone())),
            column("height", Values::F64(hulls.height.clone())),
            column("negative_space_m2", Values::F64(hulls.negative_space_m2.clone())),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::Shapes;
    use crate::artifact::hulls::HullState;
    use crate::geom::frame::Frame;

    /// A square with a courtyard, a triangle beside it, and the cluster of both.
    fn two() -> (Hulls, Footprints) {
        let mut polygons = Shapes::default();
        polygons.push_ring(&[[0, 0], [9000, 0], [9000, 9000], [0, 9000]]);
        polygons.push_ring(&[[3000, 3000], [3000, 6000], [6000, 6000], [6000, 3000]]);
        polygons.end_polygon();
        polygons.end_shape();
        polygons.push_ring(&[[10000, 0], [12000, 0], [11000, 4000]]);
        polygons.end_polygon();
        polygons.end_shape();
        let footprints = Footprints {
            frame: Frame::local(),
            ids: ["a", "b"].into_iter().collect(),
            polygons,
            base: vec![1.0, 2.0],
            top: vec![11.0, 6.0],
            attributes: Attributes::default(),
        };
        let vertices = vec![[0, 0], [0, 9000], [9000, 0], [9000, 9000], [10000, 0], [11000, 4000], [12000, 0]];
        let hulls = Hulls {
            frame: Frame::local(),
            state: HullState::Simplified,
            vertices,
            starts: vec![0, 4, 7, 11],
            rings: vec![0, 2, 3, 1, 4, 6, 5, 0, 6, 3, 1],
            cluster: vec![0, 1, 2],
            parent: vec![2, 2, u32::MAX],
            buildings: vec![1, 1, 2],
            merged_edges: vec![4, 3, 4],
            area_m2: vec![81.0, 4.0, 94.5],
            negative_space_m2: vec![9.0, 0.0, 18.5],
            ground: vec![1.0, 2.0, 1.1],
            height: vec![10.0, 4.0, 9.0],
        };
        (hulls, footprints)
    }

    /// Six times the volume of one feature, and that its edges pair up.
    fn closed_volume(mesh: &Mesh, feature: u32) -> f64 {
        let mine = |t: &&[u32; 3]| mesh.features[t[0] as usize] == feature;
        let mut edges: Vec<(u32, u32)> = Vec::new();
        let mut volume = 0.0;
        for t in mesh.triangles.iter().filter(mine) {
            edges.extend([(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
            volume += cross[0] * c[0] + cross[1] * c[1] + cross[2] * c[2];
        }
        edges.sort_unstable();
        assert!(edges.windows(2).all(|w| w[0] != w[1]), "an edge twice the same way");
        assert!(edges.iter().all(|&(a, b)| edges.binary_search(&(b, a)).is_ok()), "an open edge");
        volume / 6.0
    }

    #[test]
    fn prisms_are_closed_and_face_outwards() {
        let (hulls, footprints) = two();
        let mesh = extrude(&hulls, &footprints);
        assert!((closed_volume(&mesh, 0) - 72.0 * 10.0).abs() < 1e-9);
        assert!((closed_volume(&mesh, 1) - 4.0 * 4.0).abs() < 1e-9);
        assert!((closed_volume(&mesh, 2) - 94.5 * 9.0).abs() < 1e-9);
        assert_eq!(mesh.feature_ids.iter().collect::<Vec<_>>(), ["a", "b", "cluster-2"]);
        let names: Vec<_> = mesh.primitives.iter().map(|p| (p.name.as_str(), p.triangles)).collect();
        assert_eq!(names, [("wall", 16 + 6 + 8), ("roof", 8 + 1 + 2), ("ground", 11)]);
    }

    #[test]
    fn a_hull_without_a_ring_is_an_empty_feature() {
        let (mut hulls, footprints) = two();
        hulls.starts = vec![0, 4, 7, 7];
        let mesh = extrude(&hulls, &footprints);
        assert_eq!(mesh.feature_ids.len(), 3);
        assert!(!mesh.features.contains(&2));
    }
}
