//! One broken pipeline per kind of mistake, and what lodge says of it. `# set: k=v` lines are `--set`.

mod toys;

use std::path::{Path, PathBuf};

use lodge::cli::render::{self, Style};
use lodge::graph::Graph;

fn corpus() -> Vec<PathBuf> {
    let folder = std::fs::read_dir("tests/diagnostics").unwrap();
    let mut all: Vec<_> =
        folder.map(|f| f.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "toml")).collect();
    all.sort();
    all
}

fn load(file: &Path) -> Result<Graph, lodge::diag::Diagnostics> {
    let text = String::from_utf8(std::fs::read(file).unwrap()).unwrap();
    let sets: Vec<_> = text.lines().filter_map(|l| l.strip_prefix("# set: ")).map(String::from).collect();
    Graph::load(file, &sets, &toys::TOYS)
}

#[test]
fn every_mistake_has_its_sentence() {
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("diagnostics");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| {
        for file in corpus() {
            let name = file.file_stem().unwrap().to_str().unwrap();
            let wrong = load(&file).map(|_| panic!("{name} should be wrong")).unwrap_err();
            insta::assert_snapshot!(name, render::text(&wrong, Style::Plain));
        }
    });
}

#[test]
fn every_diagnostic_can_be_shown_in_both_forms() {
    for file in corpus() {
        for d in load(&file).err().unwrap() {
            let json = render::json(&d);
            assert!(json["message"].as_str().is_some_and(|m| !m.is_empty()));
            assert!(json["line"].is_u64() || d.code == "no-nodes", "{json}");
            assert!(!d.message.ends_with('.') && !d.message.starts_with(char::is_uppercase), "{}", d.message);
            render::one(&d, Style::Colour);
        }
    }
}

#[test]
fn what_is_no_utf8_says_where() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("latin.toml");
    std::fs::write(&file, b"description = \"a\"\n# caf\xe9\n").unwrap();
    let wrong = Graph::load(&file, &[], &toys::TOYS).unwrap_err();
    assert_eq!((wrong.len(), wrong[0].code), (1, "bad-text"));
    assert_eq!((&render::json(&wrong[0])["line"], &render::json(&wrong[0])["column"]), (&2.into(), &6.into()));
    let wrong = Graph::load(folder.path(), &[], &toys::TOYS).unwrap_err();
    assert_eq!(wrong[0].code, "missing-file");
}

/// A text with pieces cut out, doubled, replaced by other pieces of it or by odd ones.
fn mutated(text: &str, edits: &[(usize, usize, usize, u8)]) -> Vec<u8> {
    const ODD: [&str; 24] = [
        "",
        "\n",
        "=",
        "[",
        "]",
        "{",
        "}",
        "\"",
        "'''",
        ".",
        ",",
        "${",
        "}",
        "$",
        "nan",
        "-1",
        "1e999",
        "0x",
        "\u{feff}",
        "ä",
        "\0",
        "node",
        "[node.x]\n",
        "matrix.keep = [1, 1.0]\n",
    ];
    let mut bytes = text.as_bytes().to_vec();
    for &(at, length, from, kind) in edits {
        let at = at % (bytes.len() + 1);
        let end = (at + length % 12).min(bytes.len());
        let from = from % (bytes.len() + 1);
        let piece = match kind as usize {
            k if k < ODD.len() => ODD[k].as_bytes().to_vec(),
            k if k < 60 => bytes[from..(from + k).min(bytes.len())].to_vec(),
            k => vec![k as u8],
        };
        bytes.splice(at..end, piece);
    }
    bytes
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config { cases: 400, failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_text_makes_it_panic(
        pick in 0usize..1000,
        edits in proptest::collection::vec((0usize..4000, 0usize..40, 0usize..4000, 0u8..=255), 1..6),
        sets in proptest::collection::vec("(node\\.)?[a-z.]{0,8}=?[0-9a-z\\[\\]{}\"$.]{0,6}", 0..2),
    ) {
        let corpus = corpus();
        let file = &corpus[pick % corpus.len()];
        let folder = tempfile::tempdir().unwrap();
        let broken = folder.path().join("broken.toml");
        std::fs::write(&broken, mutated(&std::fs::read_to_string(file).unwrap(), &edits)).unwrap();
        match Graph::load(&broken, &sets, &toys::TOYS) {
            Ok(graph) => {
                for (i, node) in graph.nodes.iter().enumerate() {
                    assert!(node.inputs.iter().flatten().all(|&j| j < i));
                }
            }
            Err(all) => {
                assert!(!all.is_empty());
                render::text(&all, Style::Plain);
                render::all_json(&all);
            }
        }
    }
}
