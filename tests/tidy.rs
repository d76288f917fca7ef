//! The house rules that a compiler does not know: who imports whom, how an operator's file is built, how long files
//! may grow. ARCHITECTURE.md says why; a new arrow is a design change and is made in both places.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What each module may import. `cli`, `main` and `lib` join everything.
const ARROWS: &[(&str, &[&str])] = &[
    ("diag", &[]),
    ("digest", &[]),
    ("geom", &[]),
    ("artifact", &["geom", "digest", "diag"]),
    ("op", &["artifact", "digest", "diag"]),
    ("io", &["artifact", "geom", "diag"]),
    ("ops", &["op", "io", "artifact", "geom", "diag"]),
    ("spec", &["diag"]),
    ("graph", &["spec", "op", "artifact", "diag"]),
    ("run", &["graph", "op", "artifact", "digest", "diag"]),
    ("view", &["run", "io", "artifact", "diag"]),
];

/// Lines that a file may have above its tests.
const LONGEST: usize = 450;

struct File {
    /// Below `src/`, with `/`.
    path: String,
    /// Everything above the tests, without comments.
    code: String,
    text: String,
}

impl File {
    fn module(&self) -> &str {
        self.path.split('/').next().unwrap().trim_end_matches(".rs")
    }
    fn lines_above_tests(&self) -> usize {
        above_tests(&self.text).lines().count()
    }
}

fn above_tests(text: &str) -> &str {
    text.find("\n#[cfg(test)]\nmod tests").map_or(text, |at| &text[..at])
}

fn files() -> Vec<File> {
    fn walk(folder: &Path, out: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                walk(&path, out);
            } else if path.extension().is_some_and(|e| e == "rs") {
                out.push(path);
            }
        }
    }
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    walk(&src, &mut paths);
    paths.sort();
    let read = |path: PathBuf| {
        let text = std::fs::read_to_string(&path).unwrap();
        let path = path.strip_prefix(&src).unwrap().to_str().unwrap().replace('\\', "/");
        let code: Vec<&str> = above_tests(&text).lines().filter(|l| !l.trim_start().starts_with("//")).collect();
        File { path, code: code.join("\n"), text }
    };
    paths.into_iter().map(read).collect()
}

/// The first names of all paths `crate::name` and `crate::{name, ..}`; of a macro, the module that has it.
fn imports(code: &str, macros: &BTreeMap<String, String>) -> Vec<String> {
    let name = |text: &str| text.chars().take_while(|&c| c.is_alphanumeric() || c == '_').collect::<String>();
    let mut out = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        if code[..at].ends_with(|c: char| c == '$' || c == '_' || c.is_alphanumeric()) {
            continue;
        }
        let rest = &code[at + "crate::".len()..];
        let Some(group) = rest.strip_prefix('{') else {
            out.push(name(rest));
            continue;
        };
        let mut depth = 1;
        let mut start = 0;
        for (i, c) in group.char_indices() {
            depth += i32::from(c == '{') - i32::from(c == '}');
            if depth == 0 || (depth == 1 && c == ',') {
                out.push(name(group[start..i].trim_start()));
                start = i + 1;
            }
            if depth == 0 {
                break;
            }
        }
    }
    out.retain(|n| !n.is_empty());
    out.into_iter().map(|n| macros.get(&n).cloned().unwrap_or(n)).collect()
}

#[test]
fn imports_run_one_way() {
    let files = files();
    let macros: BTreeMap<String, String> = files
        .iter()
        .flat_map(|f| {
            f.code
                .split("macro_rules! ")
                .skip(1)
                .map(|rest| (rest.split([' ', '{']).next().unwrap().to_string(), f.module().to_string()))
        })
        .collect();
    let mut wrong = Vec::new();
    for file in &files {
        let module = file.module();
        if ["cli", "main", "lib"].contains(&module) {
            continue;
        }
        let Some((_, allowed)) = ARROWS.iter().find(|(m, _)| *m == module) else {
            wrong.push(format!("src/{}: module `{module}` is not in the table", file.path));
            continue;
        };
        for import in imports(&file.code, &macros) {
            if import != module && !allowed.contains(&import.as_str()) {
                wrong.push(format!("src/{}: {module} imports {import}", file.path));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_reader_of_imports_reads() {
    let macros = [("inputs".to_string(), "op".to_string())].into();
    let found = imports("use crate::{a::{b, c}, d, inputs};\ncrate::e::f(); $crate::g; crate::inputs! {}", &macros);
    assert_eq!(found, ["a", "d", "op", "e", "op"]);
}

#[test]
fn no_operator_knows_another() {
    for file in files().iter().filter(|f| f.module() == "ops" && f.path != "ops/mod.rs") {
        let up = if file.path.matches('/').count() == 1 { "super::" } else { "super::super::" };
        for (way, what) in [("crate::ops", "crate::ops"), (up, up)] {
            assert!(!file.code.contains(way), "src/{} reaches for another operator: {what}", file.path);
        }
    }
}

#[test]
fn files_are_short() {
    let long: Vec<String> = files()
        .iter()
        .filter(|f| f.lines_above_tests() > LONGEST)
        .map(|f| format!("src/{}: {} lines above its tests", f.path, f.lines_above_tests()))
        .collect();
    assert!(long.is_empty(), "look for a part that belongs elsewhere:\n{}", long.join("\n"));
}

#[test]
fn hash_tables_say_why() {
    for file in files() {
        let used = ["HashMap", "HashSet"].iter().any(|t| file.code.contains(t));
        assert!(!used || file.code.contains("reason = \""), "src/{}: a hash table without a reason", file.path);
    }
}

#[test]
fn operators_are_listed_in_order() {
    let names: Vec<&str> = lodge::ops::ALL.0.iter().map(|e| e.name).collect();
    assert!(names.windows(2).all(|w| w[0] < w[1]), "not alphabetical, or twice: {names:?}");
    let list = files().into_iter().find(|f| f.path == "ops/mod.rs").unwrap();
    let mods: Vec<&str> = list.code.lines().filter(|l| l.contains("mod ")).collect();
    let bare: Vec<&str> = mods.iter().map(|l| l.rsplit(' ').next().unwrap().trim_end_matches(';')).collect();
    assert!(bare.windows(2).all(|w| w[0] < w[1]), "not alphabetical, or twice: {bare:?}");
    let from_names: Vec<String> = names.iter().map(|n| n.replace('-', "_")).collect();
    assert_eq!(bare, from_names, "one operator, one file of its name");
}

#[test]
fn an_operator_has_five_parts_in_order() {
    let files = files();
    for entry in lodge::ops::ALL.0 {
        let stem = entry.name.replace('-', "_");
        let paths = [format!("ops/{stem}.rs"), format!("ops/{stem}/mod.rs")];
        let file = files.iter().find(|f| paths.contains(&f.path)).unwrap();
        let place =
            |what: &str| file.text.find(what).unwrap_or_else(|| panic!("src/{}: no `{}`", file.path, what.trim()));
        assert!(file.text.starts_with("//! "), "src/{}: the page comes first", file.path);
        let page: String = file.text.lines().take_while(|l| l.starts_with("//!")).collect();
        for head in ["In:", "Out:", "Errors:", "Cost:"] {
            assert!(page.contains(head), "src/{}: the page does not say `{head}`", file.path);
        }
        let parts = [place("params! {"), place("inputs! {"), place("impl Op for ")];
        assert!(parts.is_sorted(), "src/{}: page, parameters, signature, method, tests: in this order", file.path);
        if let Some(tests) = file.text.find("\n#[cfg(test)]\nmod tests") {
            assert!(parts[2] < tests, "src/{}: the tests come last", file.path);
        }
        // Functions follow their first caller, `run`.
        let early = file.text[..parts[2]].lines().find(|l| l.starts_with("fn ") || l.starts_with("pub fn "));
        assert_eq!(early, None, "src/{}: the method comes after the signature", file.path);
    }
}

#[test]
fn every_parameter_and_port_is_explained() {
    for entry in lodge::ops::ALL.0 {
        assert!(entry.ports.iter().all(|p| !p.doc.trim().is_empty()), "{}", entry.name);
        let schema = (entry.schema)();
        for (name, property) in schema["properties"].as_object().into_iter().flatten() {
            assert!(property["description"].is_string(), "{}: `{name}` has no doc comment", entry.name);
        }
    }
}
