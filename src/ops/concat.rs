//! Join digests: an operator that does next to nothing, so that benches and tests see the engine alone. Not in the
//! manual, and not offered to editors.
//!
//! In:     any number of files, which may come from nodes like this one.
//! Out:    one file: 64 hexadecimal digits and a new line, the hash of `text`, of what is read and of what `parts` hold.
//! Errors: a file that cannot be read. Cost: linear in the bytes read; a thousand hashes of 64 bytes for each `work`.

use std::io::Read;

use crate::artifact::Files;
use crate::artifact::files::{self, File};
use crate::diag::{Diagnostic, Result};
use crate::op::{Ctx, Op};
use crate::{inputs, params};

params! {
    /// Join digests.
    pub struct Concat {
        /// Files to read.
        #[schemars(extend("x-file" = true))]
        pub path: Vec<String> = Vec::new(),
        /// Anything that tells this node from others.
        pub text: String = String::new(),
        /// Thousands of hashes to compute on the way.
        pub work: u64 = 0,
        /// The file, below the output folder; without it nothing is published.
        #[schemars(extend("x-output" = "file"))]
        pub publish: Option<String> = None,
    }
}

inputs! {
    /// What comes before.
    parts: Vec<Files>,
}

impl Op for Concat {
    const NAME: &'static str = "concat";
    const VERSION: u32 = 1;
    const HIDDEN: bool = true;
    type In = In;
    type Out = Files;

    fn run(&self, ctx: &Ctx, input: In) -> Result<Files> {
        let io = |e: std::io::Error| Diagnostic::error("io", e.to_string());
        let mut all = self.text.clone().into_bytes();
        for source in ctx.sources {
            (source.open)().map_err(io)?.read_to_end(&mut all).map_err(io)?;
        }
        input.parts.iter().flat_map(|p| &p.files).for_each(|f| all.extend(f.blob.digest.0));
        let text = format!("{}\n", concat(&all, self.work, ctx)?.to_hex());
        let blob = ctx.blobs.put(text.as_bytes()).map_err(io)?;
        let path = files::below(self.publish.as_deref().unwrap_or("concat"), "");
        Ok(Files { files: vec![File { path, blob, last: false }] })
    }
}

/// The hash of `bytes`, hashed on so many thousand times.
fn concat(bytes: &[u8], thousands: u64, ctx: &Ctx) -> Result<blake3::Hash> {
    let mut hash = blake3::hash(bytes);
    for _ in 0..thousands {
        ctx.check()?;
        hash = (0..1000).fold(hash, |h, _| blake3::hash(h.to_hex().as_bytes()));
    }
    Ok(hash)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::op::{Bench, Source};

    #[test]
    fn every_input_counts() {
        let mut bench = Bench::default();
        bench.sources = vec![Source::of_bytes("a", b"1".to_vec())];
        let one = |op: &Concat, parts| op.run(&bench.ctx(), In { parts }).unwrap().files[0].clone();
        let op = Concat { publish: Some("a/./b".into()), ..Concat::default() };
        let first = one(&op, Vec::new());
        assert_eq!((&*first.path, first.blob.bytes), ("a/b", 65));
        assert_eq!(one(&Concat { work: 0, ..op.clone() }, Vec::new()), first);
        let others = [
            one(&Concat { text: "x".into(), ..op.clone() }, Vec::new()),
            one(&Concat { work: 1, ..op.clone() }, Vec::new()),
            one(&op, vec![Arc::new(Files { files: vec![first.clone()] })]),
            Concat::default().run(&Bench::default().ctx(), In { parts: Vec::new() }).unwrap().files[0].clone(),
        ];
        assert!(others.iter().all(|o| o.blob != first.blob));
        assert!(Concat { work: 1, ..op }.run(&Bench::interrupted().ctx(), In { parts: Vec::new() }).is_err());
    }
}
