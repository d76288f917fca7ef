//! Faces of any number of corners, to triangles.

use super::{Draft, Files, reject};
use crate::geom::triangulate::Triangulator;
use crate::io::ledger::Ledger;

/// Buffers to use again from face to face.
#[derive(Default)]
pub struct Faces {
    triangulator: Triangulator,
    ring: Vec<[i32; 3]>,
    out: Vec<[u32; 3]>,
}

/// Corners of a face that are cut by ears; more become a fan.
const MOST_CORNERS: usize = 1 << 16;
/// Of a face's box in parts of its side: exact in the triangulator.
const PARTS: f64 = 268_435_456.0;

impl Faces {
    /// Adds the triangles of a face whose corners are vertices of the draft. A face that has no area, or too many
    /// corners, becomes a fan.
    pub fn add(
        &mut self,
        corners: &[u64],
        draft: &mut Draft,
        files: &Files,
        ledger: &mut Ledger,
        place: &dyn Fn() -> String,
    ) {
        let n = draft.positions.len() as u64;
        if corners.len() < 3 {
            return reject(ledger, files, "fewer than three corners", place);
        }
        if corners.len() == 3 {
            return draft.triangle([corners[0], corners[1], corners[2]], files, ledger, place);
        }
        let sound = |&c: &u64| c < n && draft.positions[c as usize].iter().all(|v| v.is_finite());
        if corners.iter().all(sound) && corners.len() <= MOST_CORNERS && self.cut(corners, draft) {
            for t in std::mem::take(&mut self.out) {
                draft.triangle(t.map(|c| corners[c as usize]), files, ledger, place);
            }
            return;
        }
        for i in 2..corners.len() {
            draft.triangle([corners[0], corners[i - 1], corners[i]], files, ledger, place);
        }
    }

    fn cut(&mut self, corners: &[u64], draft: &Draft) -> bool {
        let at = |c: &u64| draft.positions[*c as usize];
        let (mut low, mut high) = (at(&corners[0]), at(&corners[0]));
        for p in corners.iter().map(at) {
            for k in 0..3 {
                (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
            }
        }
        let side = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        if !(side.is_normal()) {
            return false;
        }
        self.ring.clear();
        self.ring
            .extend(corners.iter().map(at).map(|p| [0, 1, 2].map(|k| ((p[k] - low[k]) / side * PARTS).round() as i32)));
        self.out.clear();
        self.triangulator.space([&self.ring[..]], &mut self.out);
        !self.out.is_empty()
    }
}
