//! From the local frame to the globe: WGS 84 lon/lat, and earth-centred metres.

use super::crs::Crs;
use super::mercator::{FLATTENING, MAJOR, Mercator};

/// A frame's place on the globe: `Frame::globe`.
#[derive(Clone, Debug)]
pub struct Globe(pub(super) Way);

#[derive(Clone, Debug)]
pub(super) enum Way {
    Mercator(Mercator),
    /// Local metres + origin = metres of the system; with metres a unit.
    Projected {
        crs: Crs,
        origin: [f64; 2],
        unit: f64,
    },
}

impl Globe {
    /// Lon, lat in degrees of local metres. NaN where the projection does not reach.
    pub fn lonlat(&self, x: f64, y: f64) -> [f64; 2] {
        match &self.0 {
            Way::Mercator(m) => m.inverse([x, y]),
            Way::Projected { crs, origin, unit } => {
                crs.lonlat([(x + origin[0]) / unit, (y + origin[1]) / unit]).unwrap_or([f64::NAN; 2])
            }
        }
    }

    /// Earth-centred, earth-fixed metres of local metres; heights are taken as ellipsoidal.
    pub fn ecef(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [lon, lat] = self.lonlat(x, y);
        ecef([lon, lat], z)
    }
}

/// Earth-centred metres of lon, lat in degrees and an ellipsoidal height in metres.
pub fn ecef([lon, lat]: [f64; 2], height: f64) -> [f64; 3] {
    let e2 = FLATTENING * (2.0 - FLATTENING);
    let (sin_lon, cos_lon) = libm::sincos(lon.to_radians());
    let (sin_lat, cos_lat) = libm::sincos(lat.to_radians());
    let n = MAJOR / (1.0 - e2 * sin_lat * sin_lat).sqrt();
    [(n + height) * cos_lat * cos_lon, (n + height) * cos_lat * sin_lon, (n * (1.0 - e2) + height) * sin_lat]
}

/// Lon, lat in degrees and the ellipsoidal height in metres of earth-centred metres (Bowring's form, repeated: exact
/// to a nanometre near the surface).
pub fn geodetic([x, y, z]: [f64; 3]) -> [f64; 3] {
    let e2 = FLATTENING * (2.0 - FLATTENING);
    let minor = MAJOR * (1.0 - FLATTENING);
    let p = (x * x + y * y).sqrt();
    // Tangent of the reduced latitude.
    let mut t = z * MAJOR / (p * minor);
    let mut tan = t;
    for _ in 0..3 {
        let cos = 1.0 / (1.0 + t * t).sqrt();
        let sin = t * cos;
        let second = e2 / (1.0 - e2);
        tan = (z + second * minor * sin * sin * sin) / (p - e2 * MAJOR * cos * cos * cos);
        t = tan * (1.0 - FLATTENING);
    }
    let lat = if p == 0.0 { z.signum() * std::f64::consts::FRAC_PI_2 } else { libm::atan(tan) };
    let (sin, cos) = libm::sincos(lat);
    let n = MAJOR / (1.0 - e2 * sin * sin).sqrt();
    let height = p * cos + z * sin - MAJOR * MAJOR / n;
    [libm::atan2(y, x).to_degrees(), lat.to_degrees(), height]
}

/// The matrix that takes metres east, north and up of a place to earth-centred metres; by columns, as 3D Tiles and
/// glTF write it: east, north, up, the place itself.
pub fn enu(place: [f64; 3]) -> [[f64; 4]; 4] {
    let [lon, lat, _] = geodetic(place);
    let (sin_lon, cos_lon) = libm::sincos(lon.to_radians());
    let (sin_lat, cos_lat) = libm::sincos(lat.to_radians());
    [
        [-sin_lon, cos_lon, 0.0, 0.0],
        [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat, 0.0],
        [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat, 0.0],
        [place[0], place[1], place[2], 1.0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_places() {
        assert_eq!(ecef([0.0, 0.0], 0.0), [MAJOR, 0.0, 0.0]);
        let pole = ecef([0.0, 90.0], 100.0);
        assert!((pole[2] - 6_356_852.314_245).abs() < 1e-3 && pole[0].abs() < 1e-6);
        // Geodetic to earth-centred and back.
        for p in [[139.65, 35.65, 40.0], [-71.1, 42.4, -3.0], [5.4, 52.2, 0.0], [0.0, 0.0, 0.0], [120.0, -89.9, 900.0]]
        {
            let q = geodetic(ecef([p[0], p[1]], p[2]));
            assert!((0..2).all(|k| (q[k] - p[k]).abs() < 1e-11) && (q[2] - p[2]).abs() < 1e-6, "{p:?} {q:?}");
        }
    }

    #[test]
    fn east_north_up_is_a_turn() {
        let m = enu(ecef([139.65, 35.65], 10.0));
        let dot = |a: [f64; 4], b: [f64; 4]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        for i in 0..3 {
            for j in 0..3 {
                assert!((dot(m[i], m[j]) - f64::from(u8::from(i == j))).abs() < 1e-15);
            }
        }
        // One metre up is one metre of height.
        let up: [f64; 3] = std::array::from_fn(|k| m[3][k] + m[2][k]);
        assert!((geodetic(up)[2] - 11.0).abs() < 1e-6);
    }
}
