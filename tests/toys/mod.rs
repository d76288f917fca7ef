//! A registry of operators that do nothing, with every form that parameters and ports can take: the front end is
//! tested against it, so that its tests do not change with the real operators.

use lodge::artifact::{Dendrogram, Files, Footprints, Hulls, Lines};
use lodge::diag::Result;
use lodge::op::{Ctx, Entry, Mistake, Op, Registry};
use lodge::{inputs, one_of, params};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub static TOYS: Registry = Registry(TOY_LIST);
static TOY_LIST: &[Entry] = &[
    Entry::of::<cluster::Cluster>(),
    Entry::of::<cut::Cut>(),
    Entry::of::<hulls::MergeHulls>(),
    Entry::of::<read::Read>(),
    Entry::of::<lines::ReadLines>(),
    Entry::of::<write::Write>(),
    Entry::of::<tiles::WriteTiles>(),
];

macro_rules! toy {
    ($op:ident, $name:literal, $out:ty $(, $check:item)?) => {
        impl Op for $op {
            const NAME: &'static str = $name;
            const VERSION: u32 = 1;
            type In = In;
            type Out = $out;
            $($check)?
            fn run(&self, _: &Ctx, _: In) -> Result<$out> {
                unimplemented!("toys do not run")
            }
        }
    };
}

/// Text, or several of them.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum OneOrMany {
    One(String),
    Many(Vec<String>),
}

/// An attribute's name, several, or metres.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Height {
    Metres(f64),
    Attribute(String),
    First(Vec<String>),
}

pub mod read {
    use super::*;
    use std::collections::BTreeMap;

    params! {
        /// Polygons from a file.
        pub struct Read {
            /// The file to read, or several.
            #[schemars(extend("x-file" = true, "x-required" = true))]
            pub path: Option<OneOrMany> = None,
            /// Attribute that holds the height.
            pub height: Height = Height::First(vec!["height".into()]),
            /// Height of what has none.
            #[schemars(extend("x-unit" = "m", "exclusiveMinimum" = 0.0))]
            pub default_height: f64 = 3.0,
            /// Rows to keep.
            #[serde(rename = "where")]
            pub filter: BTreeMap<String, OneOrMany> = BTreeMap::new(),
            /// Largest share of rejected rows.
            #[schemars(range(min = 0.0, max = 1.0))]
            pub max_rejected: f64 = 0.5,
            pub crs: Option<String> = None,
            /// Pins the frame.
            #[schemars(extend("x-unit" = "m"))]
            pub origin: Option<[f64; 2]> = None,
        }
    }
    inputs! {}
    toy!(Read, "read-geojson", Footprints);
}

pub mod lines {
    use super::*;
    params! {
        /// Lines from a file.
        pub struct ReadLines {
            #[schemars(extend("x-file" = true, "x-required" = true))]
            pub path: Option<OneOrMany> = None,
        }
    }
    inputs! {}
    toy!(ReadLines, "read-lines", Lines);
}

pub mod cluster {
    use super::*;
    /// Between what.
    #[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
    #[serde(rename_all = "kebab-case")]
    pub enum Distance {
        Boundary,
        Centroid,
    }
    params! {
        /// A merge tree.
        pub struct Cluster {
            pub distance: Distance = Distance::Boundary,
            #[schemars(range(min = 0.0), extend("x-unit" = "m"))]
            pub min_distance: f64 = 0.0,
        }
    }
    inputs! {
        /// Polygons.
        footprints: Footprints,
        /// Lines that no cluster crosses.
        barriers: Vec<Lines>,
    }
    toy!(Cluster, "cluster", Dendrogram);
}

pub mod hulls {
    use super::*;
    /// How rings are merged.
    #[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
    #[serde(rename_all = "kebab-case")]
    pub enum Merge {
        /// Smallest added area.
        Least,
        /// Every pair.
        Exact,
    }
    params! {
        /// A ring around every node.
        pub struct MergeHulls {
            /// Share of edges kept.
            #[schemars(range(min = 0.01, max = 1.0))]
            pub keep: f64 = 0.666666,
            pub merge: Merge = Merge::Least,
            /// Pairs tried.
            pub pairs: u32 = 10_000,
            /// Fewest vertices.
            #[schemars(range(min = 3, max = 100))]
            pub floor: Option<u8> = None,
        }
    }
    inputs! {
        /// Polygons.
        footprints: Footprints,
        /// Their merge tree.
        dendrogram: Dendrogram,
    }
    toy!(MergeHulls, "merge-hulls", Hulls);
}

pub mod cut {
    use super::*;
    params! {
        /// Some of the rings.
        pub struct Cut {
            /// How many.
            #[schemars(range(min = 1))]
            pub clusters: Option<u32> = None,
            #[schemars(range(min = 0.0), extend("x-unit" = "m"))]
            pub max_error: Option<f64> = None,
        }
    }
    inputs! {
        /// Rings.
        hulls: Hulls,
        /// Other rings to compare with.
        base_hulls: Option<Hulls>,
    }
    toy!(
        Cut,
        "cut",
        Hulls,
        fn check(&self) -> Vec<Mistake> {
            match (self.clusters, self.max_error) {
                (Some(_), None) | (None, Some(_)) => Vec::new(),
                (None, None) => {
                    vec![Mistake { param: "", message: "give exactly one of `clusters` and `max-error`".into() }]
                }
                _ => vec![Mistake {
                    param: "max_error",
                    message: "give exactly one of `clusters` and `max-error`".into(),
                }],
            }
        }
    );
}

pub mod write {
    use super::*;
    one_of! {
        /// Anything flat.
        pub enum Layer { Footprints, Hulls, Lines }
    }
    params! {
        /// One file.
        pub struct Write {
            #[schemars(extend("x-output" = "file"))]
            pub path: String = "layer.geojson".into(),
        }
    }
    inputs! {
        /// What to write.
        layer: Layer,
    }
    toy!(Write, "write-geojson", Files);
}

pub mod tiles {
    use super::*;
    params! {
        /// A folder.
        pub struct WriteTiles {
            #[schemars(extend("x-output" = "folder", "x-required" = true), length(min = 1, max = 40))]
            pub path: String = String::new(),
        }
    }
    inputs! {
        /// What to write.
        hulls: Vec<Hulls>,
    }
    toy!(WriteTiles, "write-tiles", Files);
}
