//! The geometry of features: plans to be raised, or surfaces of their own.

use super::build::Drawn;
use super::city::City;
use super::forms::{self, Pen, Shape};
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
        let place = city.first(d.node);
        match (d.shape, city.originals.solid(place)) {
            (Shape::Original, Some((all, geometry))) => {
                let surfaces = &all.surfaces;
                for p in surfaces.polygons_of(geometry).filter(|&p| all.semantics[p] != buildings::GROUND) {
                    surfaces.rings_of(p).for_each(|r| self.solids.push_ring(surfaces.ring(r)));
                    self.solids.end_polygon();
                    self.semantics.push(all.semantics[p]);
                }
            }
            (Shape::Original | Shape::Footprint, _) => {
                let polygons = &city.footprints.polygons;
                for p in polygons.polygons_of(city.building(place)) {
                    polygons.rings_of(p).for_each(|r| self.plans.push_ring(polygons.ring(r)));
                    self.plans.end_polygon();
                }
            }
            (shape, _) => {
                self.plans.push_ring(forms::plan(city, d.node, shape, pen));
                self.plans.end_polygon();
            }
        }
        self.plans.end_shape();
        self.solids.end_shape();
    }
}
