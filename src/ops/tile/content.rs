//! The geometry of features: plans to be raised, or surfaces of their own.

use super::build::Drawn;
use super::city::City;
use super::forms::{self, Pen, Shape};
use super::originals::Originals;
use crate::artifact::{Shapes, buildings};

/// Features in order: one shape each in `plans` and in `solids`, one of them empty.
#[derive(Default)]
pub struct Content {
    pub plans: Shapes<[i32; 2]>,
    pub solids: Shapes<[i32; 3]>,
    /// Meaning of each polygon of `solids`.
    pub semantics: Vec<u8>,
}

impl Content {
    /// Puts a cluster behind the others by a ring that is known.
    pub fn draw_ring(&mut self, ring: &[[i32; 2]]) {
        self.plans.push_ring(ring);
        self.plans.end_polygon();
        self.plans.end_shape();
        self.solids.end_shape();
    }

    /// Puts a feature behind the others. Of solids the ground is left out, as of plans.
    pub fn draw(&mut self, city: &City, d: &Drawn, pen: &mut Pen) {
        match d.shape {
            Shape::Original => self.draw_original(&city.originals, city.first(d.node)),
            Shape::Footprint => self.draw_footprint(&city.originals, city.first(d.node)),
            shape => self.draw_ring(forms::plan(city, d.node, shape, pen)),
        }
    }

    /// Puts a building behind the others as it is: in its highest level of detail, if there is any.
    pub fn draw_original(&mut self, originals: &Originals, place: usize) {
        let Some((all, geometry)) = originals.solid(place) else { return self.draw_footprint(originals, place) };
        let surfaces = &all.surfaces;
        for p in surfaces.polygons_of(geometry).filter(|&p| all.semantics[p] != buildings::GROUND) {
            surfaces.rings_of(p).for_each(|r| self.solids.push_ring(surfaces.ring(r)));
            self.solids.end_polygon();
            self.semantics.push(all.semantics[p]);
        }
        self.plans.end_shape();
        self.solids.end_shape();
    }

    fn draw_footprint(&mut self, originals: &Originals, place: usize) {
        let polygons = &originals.footprints.polygons;
        for p in polygons.polygons_of(originals.order[place] as usize) {
            polygons.rings_of(p).for_each(|r| self.plans.push_ring(polygons.ring(r)));
            self.plans.end_polygon();
        }
        self.plans.end_shape();
        self.solids.end_shape();
    }
}
