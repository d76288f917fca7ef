//! The list of operators, alphabetical. One operator, one file, one manual page; two lines here each.

use crate::op::{Entry, Registry};

/// Every operator, sorted by name.
pub static ALL: Registry = Registry(LIST);
static LIST: &[Entry] = &[];
