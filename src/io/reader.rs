//! What all readers share: the parameters, their check, and the account of what was read.

use super::ledger::{Ledger, Needed};
use crate::diag::{Report, Result};
use crate::geom::crs::Crs;

/// [`params!`](crate::params) of a reader: `path`, its own ones, then `crs`, `origin` and `max-rejected`.
#[macro_export]
macro_rules! reader_params {
    ($(#[$meta:meta])* pub struct $name:ident { $($own:tt)* }) => {
        $crate::params! {
            $(#[$meta])*
            pub struct $name {
                /// A file, or several by a glob; `.gz` of any.
                #[schemars(extend("x-file" = true, "x-required" = true))]
                pub path: String = String::new(),
                $($own)*
                /// The coordinate reference system, `"EPSG:28992"`; empty: as the file says, else lon/lat for GeoJSON
                /// and local metres for CityJSON.
                pub crs: String = String::new(),
                /// Pins the origin of the local frame: x, y in the input's coordinates.
                pub origin: Option<[f64; 2]> = None,
                /// Largest share of features that may be rejected.
                #[schemars(range(min = 0.0, max = 1.0))]
                pub max_rejected: f64 = 0.5,
            }
        }
    };
}

/// What is wrong with a `crs` parameter; empty is right.
pub fn crs_mistake(text: &str) -> Option<String> {
    if text.is_empty() { None } else { Crs::parse(text).err().map(|e| e.message) }
}

/// What a path says of the file's size in memory.
pub fn is_packed(path: &str) -> bool {
    path.ends_with(".gz")
}

/// Runs `read`, then closes the account that it kept: counts as facts, an error where too few of `what` are left.
pub fn account<T>(
    report: &Report,
    what: &str,
    needed: Needed,
    read: impl FnOnce(&mut Ledger) -> Result<T>,
) -> Result<T> {
    let mut ledger = Ledger::new(report);
    let out = read(&mut ledger)?;
    ledger.finish(what, needed)?;
    Ok(out)
}
