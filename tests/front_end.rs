//! No text and no `--set` makes the front end panic, hang or overflow its stack: pipelines and broken files, mutated.
//!
//! `cargo test` tries 3,000 of them from a fixed seed. The long form, a million:
//! `LODGE_LONG=1 cargo test --release --test front_end -- --nocapture` (LODGE_SEED for others, LODGE_FUZZ for as many). What
//! fails is written to `target/tmp/front-end-SEED.toml`.

mod toys;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use lodge::cli::render::{self, Style};
use lodge::graph::Graph;
use lodge::op::Registry;

/// The same numbers each time (splitmix64).
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    fn one_of<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }
}

/// What is put in: words of pipeline files, and what breaks parsers.
const WORDS: [&str; 72] = [
    "",
    "\n",
    "\r\n",
    "\r",
    " ",
    "\t",
    "=",
    "[",
    "]",
    "[[",
    "]]",
    "{",
    "}",
    "\"",
    "'",
    "\"\"\"",
    "'''",
    ".",
    ",",
    "#",
    "\\",
    "${",
    "}",
    "$",
    "$${",
    "${keep}",
    "${columns}",
    "nan",
    "-inf",
    "-1",
    "-0.0",
    "1e999",
    "1e308",
    "5e-324",
    "0x",
    "0xFFFFFFFFFFFFFFFFFF",
    "9223372036854775808",
    "1_000",
    "1979-05-27",
    "07:32:00",
    "true",
    "false",
    "\u{feff}",
    "ä",
    "\u{10ffff}",
    "\0",
    "\u{1b}[31m",
    "node",
    "[node.x]\n",
    "[params]\n",
    "[node]\n",
    "op",
    "op = \"cluster\"\n",
    "in",
    "in.footprints = \"read\"\n",
    "matrix.keep = [1, 1.0]\n",
    "matrix",
    "variants = [{ keep = 1 }]\n",
    "variants",
    "snapshot",
    "snapshot.abs = 1\n",
    "on-error = \"fail\"\n",
    "extends = \"base.toml\"\n",
    "extends",
    "description",
    "path = \"../x\"\n",
    "path = \"a/b\"\n",
    "path = \"*.toml\"\n",
    "read[keep=1]",
    "node.x = false\n",
    "..",
    "/",
];

/// Letters and digits together, everything else alone.
fn tokens(text: &[u8]) -> Vec<&[u8]> {
    let word = |b: u8| b.is_ascii_alphanumeric() || b >= 0x80;
    text.chunk_by(|a, b| word(*a) && word(*b)).collect()
}

fn mutated(dice: &mut Dice, texts: &[Vec<u8>]) -> Vec<u8> {
    let mut out = dice.one_of(texts).clone();
    for _ in 0..1 + dice.below(6) {
        let at = dice.below(out.len() + 1);
        let end = (at + dice.below(20)).min(out.len());
        match dice.below(12) {
            0 if !out.is_empty() => out[at.min(end.max(1) - 1)] ^= 1 << dice.below(8),
            1 => drop(out.splice(at..end, [])),
            2 | 3 => drop(out.splice(at..at, dice.one_of(&WORDS).bytes())),
            4 => drop(out.splice(at..end, dice.one_of(&WORDS).bytes())),
            // Tokens of this or another text, exchanged, doubled, taken away.
            5..=7 => {
                let other = dice.one_of(texts).clone();
                let (mut mine, theirs) = (tokens(&out), tokens(&other));
                let (i, j) = (dice.below(mine.len()), dice.below(theirs.len()));
                let n = (1 + dice.below(6)).min(mine.len() - i.min(mine.len()));
                let m = (dice.below(12)).min(theirs.len() - j.min(theirs.len()));
                mine.splice(i..i + n, theirs[j..j + m].to_vec());
                out = mine.concat();
            }
            // Lines of this or another text.
            8 | 9 => {
                let other = dice.one_of(texts).clone();
                let mut mine: Vec<&[u8]> = out.split_inclusive(|b| *b == b'\n').collect();
                let theirs: Vec<&[u8]> = other.split_inclusive(|b| *b == b'\n').collect();
                let (i, j) = (dice.below(mine.len() + 1), dice.below(theirs.len()));
                let n = dice.below(3).min(mine.len() - i);
                let m = dice.below(5).min(theirs.len() - j.min(theirs.len()));
                mine.splice(i..i + n, theirs[j..j + m].to_vec());
                out = mine.concat();
            }
            // Much of the same.
            10 => {
                let piece = match dice.below(3) {
                    0 => dice.one_of(&WORDS).as_bytes().to_vec(),
                    1 => dice.one_of(&[&b"a."[..], b"[", b"{a=", b"{a.a.a.a.a.a.a.a=", b"[[", b"\"${", b"]"]).to_vec(),
                    _ => out[at..end].to_vec(),
                };
                let times = 1 << dice.below(9);
                drop(out.splice(at..at, piece.repeat(times)));
            }
            _ => out.truncate(at),
        }
        out.truncate(100_000);
    }
    out
}

fn overrides(dice: &mut Dice, texts: &[Vec<u8>]) -> Vec<String> {
    let word = |dice: &mut Dice| match dice.below(4) {
        0 => dice.one_of(&WORDS).to_string(),
        1 => "a.".repeat(1 << dice.below(14)),
        _ => {
            let text = dice.one_of(texts).clone();
            let all = tokens(&text);
            let at = dice.below(all.len());
            String::from_utf8_lossy(&all[at..(at + 1 + dice.below(3)).min(all.len())].concat()).into_owned()
        }
    };
    let mut one = |_| {
        let head = *dice.one_of(&["node.", "node.hulls.", "keep", "node.read.", "buildings", ""]);
        let mut out = head.to_string() + &word(dice);
        for _ in 0..dice.below(3) {
            out += *dice.one_of(&["=", ".", "=", ""]);
            out += &word(dice);
        }
        out
    };
    let many = [0, 0, 1, 2];
    (0..many[one(0).len() % 4]).map(&mut one).collect()
}

/// Where mutated files lie: their neighbours are there, so that some of them are good.
struct Field {
    _dir: tempfile::TempDir,
    file: PathBuf,
    registry: &'static Registry,
    texts: Vec<Vec<u8>>,
}

impl Field {
    fn shipped(project: &Path) -> Self {
        let dir = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink(project.join("fixtures"), dir.path().join("fixtures")).unwrap();
        let folder = dir.path().join("pipelines");
        std::fs::create_dir(&folder).unwrap();
        let texts = texts(&project.join("pipelines"));
        for (name, text) in &texts {
            std::fs::write(folder.join(name), text).unwrap();
        }
        let texts = texts.into_values().collect();
        Self { file: folder.join("broken.toml"), _dir: dir, registry: &lodge::ops::ALL, texts }
    }

    fn corpus(project: &Path) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let from = project.join("tests/diagnostics");
        std::os::unix::fs::symlink(from.join("data"), dir.path().join("data")).unwrap();
        std::fs::copy(from.join("data/base.toml"), dir.path().join("base.toml")).unwrap();
        let texts = texts(&from).into_values().collect();
        Self { file: dir.path().join("broken.toml"), _dir: dir, registry: &toys::TOYS, texts }
    }

    /// Whether it was good, and how many mistakes it has.
    fn try_one(&self, text: &[u8], sets: &[String]) -> Option<usize> {
        std::fs::write(&self.file, text).unwrap();
        match Graph::load(&self.file, sets, self.registry) {
            Ok(graph) => {
                for (i, node) in graph.nodes.iter().enumerate() {
                    assert!(node.inputs.iter().flatten().all(|&j| j < i));
                    if let Some((path, _)) = &node.output {
                        assert!(
                            !path.starts_with('/') && path.split('/').all(|p| p != ".." && !p.is_empty()),
                            "{path}"
                        );
                    }
                }
                None
            }
            Err(all) => {
                assert!(!all.is_empty());
                for d in all.iter().filter_map(|d| d.span.as_ref()) {
                    assert!(d.range.start <= d.range.end && d.range.start <= d.file.text.len());
                }
                let text = render::text(&all, Style::Plain);
                assert!(!text.contains(['\0', '\u{1b}']), "a control character goes to the terminal");
                assert_eq!(render::all_json(&all).as_array().unwrap().len(), all.len());
                Some(all.len())
            }
        }
    }
}

fn texts(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path());
    let toml = files.filter(|p| p.is_file() && p.extension().is_some_and(|e| e == "toml"));
    toml.map(|p| (p.file_name().unwrap().to_str().unwrap().to_string(), std::fs::read(&p).unwrap())).collect()
}

#[test]
fn no_text_makes_it_panic() {
    let number = |name: &str| std::env::var(name).ok().map(|n| n.replace('_', "").parse::<u64>().expect("a number"));
    let long = std::env::var("LODGE_LONG").is_ok_and(|v| !["", "0"].contains(&v.as_str()));
    let many = number("LODGE_FUZZ").unwrap_or(if long { 1_000_000 } else { 3_000 });
    let seed = number("LODGE_SEED").unwrap_or(1);
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));
    let next = AtomicU64::new(0);
    let (failed, slowest, found) = (Mutex::new(None), Mutex::new((Duration::ZERO, 0)), Mutex::new([0u64; 2]));
    let began = Instant::now();
    let worker = || {
        let fields = [Field::shipped(project), Field::corpus(project)];
        let (mut counts, mut slow) = ([0; 2], (Duration::ZERO, 0));
        loop {
            let n = next.fetch_add(1, Ordering::Relaxed);
            if n >= many || failed.lock().unwrap().is_some() {
                break;
            }
            let mut dice = Dice(seed.wrapping_mul(1_000_003).wrapping_add(n));
            let field = &fields[dice.below(4).min(1)];
            let text = mutated(&mut dice, &field.texts);
            let sets = overrides(&mut dice, &field.texts);
            let one = Instant::now();
            match std::panic::catch_unwind(|| field.try_one(&text, &sets)) {
                Ok(mistakes) => counts[usize::from(mistakes.is_some())] += 1,
                Err(_) => {
                    let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("front-end-{seed}.toml"));
                    std::fs::write(&kept, &text).unwrap();
                    *failed.lock().unwrap() =
                        Some(format!("input {n} of seed {seed}, {}, with {sets:?}", kept.display()));
                }
            }
            slow = slow.max((one.elapsed(), n));
        }
        let mut all = found.lock().unwrap();
        (0..2).for_each(|i| all[i] += counts[i]);
        let mut most = slowest.lock().unwrap();
        *most = slow.max(*most);
    };
    std::thread::scope(|scope| {
        (0..2).for_each(|_| drop(scope.spawn(worker)));
    });
    assert_eq!(failed.into_inner().unwrap(), None);
    let ([good, bad], (slow, at)) = (found.into_inner().unwrap(), slowest.into_inner().unwrap());
    println!(
        "{many} inputs in {:.0} s: {bad} with mistakes, {good} good; the slowest, {at}, took {slow:.1?}",
        began.elapsed().as_secs_f64()
    );
    assert!(bad > many / 2 && good > many / 1000, "{good} {bad}");
}

/// Depth in every form that the text or an override can give it, and in all of them at once.
#[test]
fn nothing_is_too_deep() {
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));
    let field = Field::corpus(project);
    let key = vec!["a"; 79].join(".");
    let braces = |n: usize| format!("{} 1{}", format!("{{{key} = ").repeat(n), "}".repeat(n));
    let lists = |n: usize| "[".repeat(n) + &"]".repeat(n);
    let long = vec!["a"; 100_000].join(".");
    let texts = [
        format!("[params]\np = {}\n[node.r]\nop = \"read-lines\"\npath = \"${{p}}\"\n", braces(79)),
        format!("[node.r]\nop = \"read-geojson\"\npath = \"data/one.geojson\"\nwhere = {}\n", braces(75)),
        format!("[node.r]\nop = \"cluster\"\nin = {}\nmatrix = {}\n", braces(75), braces(75)),
        format!("[node.r]\nop = \"cluster\"\nvariants = {}\nsnapshot = {}\n", lists(75), braces(75)),
        format!("node.r.op = {}\n", lists(100_000)),
        format!("{long} = 1\n"),
        format!("[node.{long}]\nop = 1\n"),
        format!("[[{long}]]\n"),
        format!("extends = \"{}\"\n", "a/".repeat(100_000)),
    ];
    let plain = "[params]\np = 1\n[node.r]\nop = \"read-lines\"\npath = \"${p}\"\n";
    for text in &texts {
        assert!(field.try_one(text.as_bytes(), &[]).is_some());
    }
    for set in
        [format!("node.r.{long}=1"), format!("p={}", braces(79)), format!("p={}", lists(100_000)), format!("{long}=1")]
    {
        assert!(field.try_one(plain.as_bytes(), &[set]).is_some());
    }
    // A file that extends one that extends one ..
    let folder = field.file.parent().unwrap();
    for i in 0..3_000 {
        std::fs::write(folder.join(format!("{i}.toml")), format!("extends = \"{}.toml\"\n", i + 1)).unwrap();
    }
    std::fs::write(folder.join("3000.toml"), plain).unwrap();
    assert_eq!(field.try_one(b"extends = \"0.toml\"\n", &[]), Some(1));
}
