//! The rings of all clusters, from subtrees' in postorder to the order of the clusters.

use rayon::prelude::*;

use super::leaves::Leaves;
use super::nodes::Part;
use super::walk::Walk;

/// Columns of `Hulls`.
pub struct Rings {
    pub starts: Vec<u32>,
    pub rings: Vec<u32>,
    pub merged_edges: Vec<u32>,
    /// Doubled square millimetres.
    pub area: Vec<f64>,
}

/// Clusters that are one piece of work.
const MANY: usize = 1 << 12;

impl Rings {
    pub fn new(walk: &Walk, leaves: &Leaves, parts: Vec<Part>) -> Self {
        let count = walk.postorder.len();
        let mut places = vec![(0u32, 0u32); count];
        let all = parts.iter().zip(0u32..).flat_map(|(part, p)| (0..part.len() as u32).map(move |i| (p, i)));
        walk.postorder.iter().zip(all).for_each(|(&cluster, place)| places[cluster as usize] = place);
        let part = |place: (u32, u32)| (&parts[place.0 as usize], place.1 as usize);
        let n = walk.tree.leaf_count();
        let ring = |cluster: usize| {
            let (part, i) = part(places[cluster]);
            if cluster < n { leaves.ring(cluster as u32) } else { part.ring(i) }
        };
        let mut starts = vec![0u32; count + 1];
        starts[1..].par_iter_mut().enumerate().for_each(|(c, length)| *length = ring(c).len() as u32);
        for c in 0..count {
            starts[c + 1] += starts[c];
        }
        // Each piece of work fills its own stretch.
        let mut rings = vec![0u32; starts[count] as usize];
        let mut rest = &mut rings[..];
        let mut stretches = Vec::new();
        for from in (0..count).step_by(MANY) {
            let to = count.min(from + MANY);
            let (mine, others) = rest.split_at_mut((starts[to] - starts[from]) as usize);
            stretches.push((from..to, mine));
            rest = others;
        }
        stretches.into_par_iter().for_each(|(clusters, mut out)| {
            for cluster in clusters {
                let ring = ring(cluster);
                let (mine, others) = out.split_at_mut(ring.len());
                mine.copy_from_slice(ring);
                out = others;
            }
        });
        let merged_edges = places.par_iter().map(|&p| part(p).0.merged_edges[part(p).1]).collect();
        let area = places.par_iter().map(|&p| part(p).0.area[part(p).1]).collect();
        Self { starts, rings, merged_edges, area }
    }
}
