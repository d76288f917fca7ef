//! What is checked in is what its generator makes.

#[allow(dead_code)]
#[path = "../fixtures/town/generate.rs"]
mod town;

#[test]
fn the_town_is_what_its_generator_makes() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/town");
    for (name, text) in town::files() {
        let found = std::fs::read_to_string(folder.join(name)).unwrap();
        assert!(found == text, "{name} differs: run `cargo run --example make-town`");
        assert!(text.len() < 700_000, "{name} is to stay small: {} bytes", text.len());
    }
}
