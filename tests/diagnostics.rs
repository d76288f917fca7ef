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
    // One of them is a folder, some are no text.
    let text = String::from_utf8_lossy(&std::fs::read(file).unwrap_or_default()).into_owned();
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
        let corpus = corpus();
        assert!(corpus.len() >= 60, "{}", corpus.len());
        for file in corpus {
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
            assert!(json["line"].is_u64() || d.code == "no-nodes" || file.is_dir(), "{json}");
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

/// What a text made here is told.
fn told(name: &str, text: &str) -> (lodge::diag::Diagnostics, String) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(name);
    std::fs::write(&file, text).unwrap();
    let wrong = Graph::load(&file, &[], &toys::TOYS).unwrap_err();
    let said = render::text(&wrong, Style::Plain).replace(&file.display().to_string(), name);
    (wrong, said)
}

/// Ten thousand mistakes of a kind, each with its place and its nearest name.
#[test]
fn ten_thousand_mistakes_are_all_told() {
    let many = |line: fn(usize) -> String| (0..10_000).map(line).collect::<String>();
    let nodes = many(|i| format!("[node.n{i}]\nop = \"clustre\"\nin.footprints = \"m{i}\"\n"));
    let (wrong, said) = told("nodes.toml", &nodes);
    assert_eq!(wrong.iter().filter(|d| d.code == "unknown-operator").count(), 10_000);
    assert_eq!(wrong.iter().filter(|d| d.code == "unknown-node").count(), 10_000);
    assert!(said.contains("there is no node `m9999`\n     --> nodes.toml:30000:17\n"), "{}", &said[said.len() - 400..]);
    assert!(said.ends_with("= help: did you mean `n9999`?\n\n"), "{}", &said[said.len() - 400..]);
    let keys = "[node.x]\nop = \"cluster\"\n".to_string() + &many(|i| format!("min-distence{i} = {i}\n"));
    let (wrong, said) = told("keys.toml", &keys);
    assert_eq!(wrong.len(), 10_001);
    assert!(said.contains("`cluster` has no parameter `min-distence9999`\n     --> keys.toml:10002:1\n"));
    let (wrong, said) = told("syntax.toml", &many(|i| format!("k{i} = = {i}\n")));
    assert_eq!(wrong.len(), 10_000);
    assert!(said.contains(" --> syntax.toml:10000:9\n"), "{}", &said[said.len() - 200..]);
}

#[test]
fn a_line_of_a_megabyte_is_told_in_a_few() {
    let x = "x".repeat(1 << 20);
    for (text, column) in [
        (format!("[node.r]\nop = \"{x}\"\n"), 6),
        (format!("[node.r]\nop = \"cluster\"\nin.footprints = \"{x}\"\n"), 17),
        (format!("[node.{x}]\nop = \"clustre\"\n"), 6),
        (format!("[node.r]\nop = \"read-geojson\"\npath = \"{x}\"\n"), 8),
        (format!("[node.r]\nop = \"read-lines\"\npath = [{}3]\n", "\"a\", ".repeat(1 << 18)), 8 + (5 << 18) + 1),
        (format!("[node.r]\n{x} = = 3\n"), (1 << 20) + 4),
        (format!("{x} = 3\n"), 1),
    ] {
        let (wrong, said) = told("line.toml", &text);
        assert!(said.len() < 2_000 * wrong.len(), "{}", said.len());
        let at = |d: &lodge::diag::Diagnostic| render::json(d)["column"].as_u64().unwrap() as usize;
        assert!(
            wrong.iter().any(|d| at(d) == column),
            "{column} {:?}",
            wrong.iter().map(|d| at(d)).collect::<Vec<_>>()
        );
    }
}

/// Pipes and devices would never end: neither as a pipeline nor as an input.
#[cfg(unix)]
#[test]
fn what_is_no_file_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let [pipe, file] = ["pipe.toml", "p.toml"].map(|n| folder.path().join(n));
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let reader = "[node.r]\nop = \"read-lines\"\npath = [\"pipe.toml\", \"/dev/zero\"]\n";
    let cases = [("extends = \"pipe.toml\"\n", 1), ("extends = \"/dev/zero\"\n", 1), (reader, 2)];
    let of = |file: &Path| Graph::load(file, &[], &toys::TOYS).unwrap_err();
    let mut all = vec![of(&pipe), of(Path::new("/dev/zero"))];
    for (text, mistakes) in cases {
        std::fs::write(&file, text).unwrap();
        all.push(of(&file));
        assert_eq!(all.last().unwrap().len(), mistakes);
    }
    for d in all.iter().flatten() {
        assert!(d.code == "missing-file" && d.message.contains("no regular file"), "{d}");
    }
    // Larger than any pipeline; no byte of it is read.
    std::fs::File::create(&file).unwrap().set_len(1 << 40).unwrap();
    assert!(of(&file)[0].message.contains("larger than 64 MiB"));
}
