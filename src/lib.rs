//! lodge makes coarser versions of 3-D models that still read as what they are.
//!
//! Two towers and one bridge. The engine (`spec`, `graph`, `run`) moves results and does not know what a building
//! is; the domain (`geom`, `artifact`, `io`, `ops`) knows buildings and does not know who runs it. They touch in
//! [`op`] and are joined in [`cli`].

pub mod diag;
pub mod digest;

pub mod artifact;
pub mod geom;
pub mod io;

pub mod op;
pub mod ops;

pub mod graph;
pub mod run;
pub mod spec;

pub mod cli;
