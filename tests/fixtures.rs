//! What is checked in is what its generator makes.

use std::path::{Path, PathBuf};

#[allow(dead_code)]
#[path = "../fixtures/pavilion/generate.rs"]
mod pavilion;
#[allow(dead_code)]
#[path = "../fixtures/town/generate.rs"]
mod town;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

#[test]
fn the_town_is_what_its_generator_makes() {
    for (name, text) in town::files() {
        let found = std::fs::read_to_string(folder("town").join(name)).unwrap();
        assert!(found == text, "{name} differs: run `cargo run --example make-town`");
        assert!(text.len() < 700_000, "{name} is to stay small: {} bytes", text.len());
    }
}

#[test]
fn the_pavilion_is_what_its_generator_makes() {
    for (name, bytes) in pavilion::files() {
        let found = std::fs::read(folder("pavilion").join(name)).unwrap();
        assert!(found == bytes, "{name} differs: run `cargo run --example make-pavilion`");
        assert!(bytes.len() < 200_000, "{name} is to stay small: {} bytes", bytes.len());
    }
}
