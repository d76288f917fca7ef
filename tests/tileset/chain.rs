//! From a file to a tile tree, by the operators with their defaults: what `pipelines/city.toml` does.

use std::sync::Arc;

use lodge::artifact::{AnyArtifact, TileTree};
use lodge::op::{Bench, Source, cast};
use lodge::ops::ALL;
use serde_json::{Value, json};

pub type Any = Arc<dyn AnyArtifact>;

/// Runs an operator by its name.
pub fn run(name: &str, params: Value, source: Option<Source>, inputs: &[(&str, &Any)]) -> Any {
    let entry = ALL.get(name).unwrap_or_else(|| panic!("no operator `{name}`"));
    let op = (entry.build)(params).unwrap();
    let mut bench = Bench::default();
    bench.sources.extend(source);
    let of = |port: &str| inputs.iter().filter(|(p, _)| *p == port).map(|(_, a)| (*a).clone()).collect();
    op.run(&bench.ctx(), entry.ports.iter().map(|p| of(p.name)).collect()).unwrap()
}

/// Footprints to tiles. `buildings` keep their own geometry in leaves.
pub fn tiles(footprints: &Any, buildings: Option<&Any>) -> Arc<TileTree> {
    let plan = ("footprints", footprints);
    let blocks = run("cluster", json!({}), None, &[plan]);
    let tree = ("dendrogram", &blocks);
    let hulls = run("merge-hulls", json!({ "height": "median" }), None, &[plan, tree]);
    let landmarks = run("landmarks", json!({}), None, &[plan, tree]);
    let mut inputs = vec![plan, tree, ("hulls", &hulls), ("landmarks", &landmarks)];
    inputs.extend(buildings.map(|b| ("buildings", b)));
    cast(run("tile", json!({}), None, &inputs))
}

pub fn geojson(name: &str, bytes: Vec<u8>, filter: Value) -> Any {
    let params = json!({ "path": name, "where": filter });
    run("read-geojson", params, Some(Source::of_bytes(name, bytes)), &[])
}

/// The buildings and their footprints.
pub fn cityjson(name: &str, bytes: Vec<u8>) -> (Any, Any) {
    let buildings = run("read-cityjson", json!({ "path": name }), Some(Source::of_bytes(name, bytes)), &[]);
    let footprints = run("footprint", json!({}), None, &[("buildings", &buildings)]);
    (buildings, footprints)
}
