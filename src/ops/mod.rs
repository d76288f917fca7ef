//! The list of operators, alphabetical. One operator, one file, one manual page; two lines here each.

pub mod cluster;

use crate::op::{Entry, Registry};

pub mod extrude;
pub mod landmarks;

/// Every operator, sorted by name.
pub static ALL: Registry = Registry(LIST);
static LIST: &[Entry] = &[Entry::of::<extrude::Extrude>(), Entry::of::<landmarks::FindLandmarks>()];
static LIST: &[Entry] = &[Entry::of::<cluster::Cluster>()];
