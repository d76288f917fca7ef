//! What is measured.

use std::borrow::Cow;
use std::cell::RefCell;
use std::fs;
use std::path::Path;
use std::time::Instant;

use lodge::artifact::{AnyArtifact, Landmarks, sections::Encoder};
use lodge::run::executor::decode;
use lodge::run::store::Store;

use crate::process::{Cost, Costs, cost, median};
use crate::yard::{Publish, Yard, ninja};

pub const ALL: [(&str, fn()); 9] = [
    ("null", null),
    ("null-all", null_all),
    ("edit", edit),
    ("small", small),
    ("cold", cold),
    ("verify", verify),
    ("large", large),
    ("parallel", parallel),
    ("side", side),
];

const LODGE: &str = env!("CARGO_BIN_EXE_lodge");

/// `lodge run` in a yard, as a person types it.
fn run(yard: &Yard, more: &[&str]) -> Cost {
    cost(&yard.home, &[&[LODGE, "run", "p.toml"], more].concat())
}

/// A yard after a cold run, and one that brought the stamps up to date.
fn warm(nodes: usize, publish: Publish) -> Yard {
    let yard = Yard::lodge(nodes, publish);
    (0..3).for_each(|_| _ = run(&yard, &[]));
    yard
}

fn goal(what: &str, found: f64, unit: &str, goal: f64, must: f64, least: bool) {
    let holds = |limit: f64| if least { found >= limit } else { found <= limit };
    let verdict = if holds(goal) {
        "goal met"
    } else if holds(must) {
        "must met"
    } else {
        "MISSED"
    };
    println!("  -> {what}: {found:.3}{unit} (goal {goal}, must {must}): {verdict}");
}

/// A null rerun of 10,000 nodes beside ninja's of as many tasks.
fn beside_ninja(publish: Publish, [want, must]: [f64; 2], name: &str) {
    let mine = warm(10_000, publish);
    let theirs = ninja().map(|program| (Yard::ninja(10_000), program));
    let Some((theirs, program)) = theirs else {
        println!("  skipped: no ninja");
        return Costs::of(21, || run(&mine, &[])).line("lodge");
    };
    let ninja = || cost(&theirs.home, &[program.as_os_str()]);
    (0..2).for_each(|_| _ = ninja());
    let [a, b] = Costs::pairs(31, || run(&mine, &[]), ninja);
    a.line("lodge");
    b.line("ninja");
    let [wall, cpu] = a.to(&b);
    goal(&format!("{name}, wall"), wall, "x ninja", want, must, false);
    goal(&format!("{name}, cpu"), cpu, "x ninja", want, must, false);
    if publish == Publish::Last {
        goal("peak memory", a.peak(), " MiB", 16.0, 32.0, false);
    }
}

fn null() {
    beside_ninja(Publish::Last, [0.15, 0.3], "10,000 nodes, 1,000 in, 1,000 published");
}

fn null_all() {
    beside_ninja(Publish::All, [0.45, 0.8], "10,000 nodes, 1,000 in, 10,000 published");
}

/// A comment is edited before each run.
fn edit() {
    let yard = warm(10_000, Publish::Last);
    let mut number = 0;
    let costs = Costs::of(21, || {
        number += 1;
        yard.edit(number);
        run(&yard, &[])
    });
    costs.line("an edited comment, 10,000 nodes");
    goal("an edited comment, cpu", costs.cpu(), " ms", 100.0, 200.0, false);
}

/// Small pipelines, the whole process.
fn small() {
    Costs::of(51, || cost(Path::new("."), &[LODGE, "--version"])).line("--version");
    for (nodes, want, must) in [(100, 2.0, 5.0), (1_000, 3.0, 8.0)] {
        let yard = warm(nodes, Publish::Last);
        let costs = Costs::of(51, || run(&yard, &[]));
        costs.line(&format!("{nodes} nodes"));
        goal(&format!("null rerun of {nodes} nodes, wall"), costs.wall(), " ms", want, must, false);
    }
}

/// Cold runs in which every node publishes a file. What a node costs is what a pipeline takes beyond that of ten. Nothing
/// is deleted on the way: after that ext4 is slow to create files for minutes.
fn cold() {
    let yards = RefCell::new(Vec::new());
    let cold = |nodes: usize| {
        let yard = Yard::lodge(nodes, Publish::All);
        let cost = run(&yard, &[]);
        assert_eq!(fs::read_dir(yard.out()).expect("it published").count(), nodes);
        yards.borrow_mut().push(yard);
        cost
    };
    // Each in turns with ten: the disk, which is waited for at the end of a run, takes as long as a hundred nodes.
    let sizes = [(100, 61), (1_000, 15), (10_000, 5)].map(|(nodes, rounds)| {
        let [base, costs] = Costs::pairs(rounds, || cold(10), || cold(nodes));
        base.line("10 nodes, cold");
        costs.line(&format!("{nodes} nodes, cold"));
        let more = |of: fn(&Cost) -> f64| median(costs.0.iter().zip(&base.0).map(|(a, b)| of(a) - of(b)));
        let more = [more(|c| c.wall), more(|c| c.cpu), more(|c| c.user)];
        (nodes, more.map(|ms| ms / (nodes - 10) as f64))
    });
    for (nodes, [wall, cpu, user]) in sizes {
        println!(
            "  {nodes} nodes: {:.1} us wall, {:.1} us cpu, {:.1} us user a node",
            1e3 * wall,
            1e3 * cpu,
            1e3 * user
        );
    }
    let [(_, few), (_, some), (_, many)] = sizes;
    goal("cold, a node of 10,000, wall", many[0], " ms", 0.08, 0.25, false);
    goal("cold, a node of 10,000, cpu", many[1], " ms", 0.08, 0.25, false);
    for (of, k) in [("wall", 0), ("cpu", 1), ("user", 2)] {
        for (than, other) in [(100, few), (1_000, some)] {
            let name = format!("cold, a node of 10,000 against one of {than}, {of}");
            match other[k] > 0.0 {
                true => goal(&name, many[k] / other[k], "x", 1.2, 1.5, false),
                false => println!("  -> {name}: not measured, ten nodes took as long as {than}"),
            }
        }
    }
    floor();
    if let Some(program) = ninja() {
        let costs = Costs::of(3, || {
            let yard = Yard::ninja(1_000);
            let cost = cost(&yard.home, &[program.as_os_str()]);
            yards.borrow_mut().push(yard);
            cost
        });
        costs.line("ninja, 1,000 tasks, cold");
    }
}

/// What the file system takes for it alone: 10,000 files created and renamed, on one thread.
fn floor() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: String| folder.path().join(name);
    let started = Instant::now();
    for i in 0..10_000 {
        fs::write(at("new".into()), format!("{i:064}\n"))
            .and_then(|()| fs::rename(at("new".into()), at(i.to_string())))
            .expect("room");
    }
    println!("  a file created and renamed, by itself: {:.1} us", started.elapsed().as_secs_f64() * 1e2);
}

/// `cache verify` over large objects, and over many small ones.
fn verify() {
    let fill = |objects: usize, bytes: usize| {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(folder.path()).expect("a cache");
        for i in 0..objects {
            let body: Vec<u8> = (0..bytes as u64).map(|k| (k ^ (k >> 8) ^ i as u64) as u8).collect();
            store.put(&[Cow::Borrowed(&i.to_le_bytes()[..]), body.into()]).expect("room");
        }
        folder
    };
    let check = |folder: &tempfile::TempDir| cost(folder.path(), &[LODGE, "cache", "verify", "--cache", "."]);
    let large = fill(16, 1 << 26);
    let costs = Costs::of(5, || check(&large));
    costs.line("verify of 16 objects of 64 MiB");
    let gb = 16.0 * f64::from(1 << 26) / 1e9;
    goal("verify, a core", gb / (costs.cpu() / 1e3), " GB/s", 2.0, 1.0, true);
    println!("  {:.2} GB/s wall", gb / (costs.wall() / 1e3));
    let small = fill(10_000, 300);
    let costs = Costs::of(11, || check(&small));
    costs.line("verify of 10,000 objects, 308 B");
    goal("verify of 10,000 small objects, wall", costs.wall() / 1e3, " s", 0.15, 0.3, false);
}

/// One artifact of 256 MiB to the cache and back, in this process: encoded and hashed, written; read and hashed, decoded.
fn large() {
    let n: usize = 1 << 22;
    let numbers = || (0..n as u64).map(|k| k.wrapping_mul(0x9e37_79b9_7f4a_7c15) as f64).collect::<Vec<f64>>();
    let none = Vec::new;
    let artifact = Landmarks {
        order: none(),
        first: none(),
        size: none(),
        cluster_height: numbers(),
        height: [numbers(), numbers(), numbers()].concat(),
        maxima: [numbers(), numbers(), numbers(), numbers()].concat(),
    };
    let gb = (8 * n * 8) as f64 / 1e9;
    let (mut put, mut get) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(folder.path()).expect("a cache");
        let started = Instant::now();
        let mut encoder = Encoder::new("Landmarks");
        AnyArtifact::encode(&artifact, &mut encoder);
        let blob = store.put(&encoder.pieces()).expect("room");
        put.push(gb / started.elapsed().as_secs_f64());
        let started = Instant::now();
        let back = decode(&store, "Landmarks", &blob.digest).expect("just put");
        get.push(gb / started.elapsed().as_secs_f64());
        assert!(back.as_any().downcast_ref::<Landmarks>().is_some_and(|b| b.maxima.len() == artifact.maxima.len()));
    }
    goal("an artifact of 268 MB stored", median(put), " GB/s", 1.0, 0.6, true);
    goal("the same read", median(get), " GB/s", 1.7, 1.2, true);
}

/// 64 equal nodes with nothing but work to do, on one worker and on two.
fn parallel() {
    let on = |jobs: &str| run(&Yard::work(64, 150), &["-j", jobs]);
    let [one, two] = Costs::pairs(7, || on("1"), || on("2"));
    one.line("64 nodes, -j 1");
    two.line("64 nodes, -j 2");
    goal("2 workers against 1, wall", one.to(&two)[0], "x", 1.95, 1.8, true);
}

/// What other ways of a null rerun cost beside the plain one.
fn side() {
    let yard = warm(10_000, Publish::Last);
    for flags in [&["-q"][..], &["--json"], &["--events", "events.jsonl"], &["--verify"]] {
        let [plain, other] = Costs::pairs(11, || run(&yard, &[]), || run(&yard, flags));
        other.line(&format!("null rerun {}", flags[0]));
        let [wall, cpu] = other.to(&plain);
        println!("  -> {}: {wall:.2}x wall, {cpu:.2}x cpu of the plain one", flags[0]);
    }
}
