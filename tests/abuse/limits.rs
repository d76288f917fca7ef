//! The limits of "unchanged", as README tells them: each is shown here, with what finds it all the same.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::{FileExt, MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::{Command, Stdio};

use lodge::run::Outcome;
use lodge::run::event::Status;
use lodge::run::published;
use lodge::run::store::Store;
use lodge::run::verify::verify;
use serde_json::json;

use super::support::Place;
use super::toy::{Yard, tree};
use super::{lodge, names};

pub const SQUARES: &str = r#"{"type": "FeatureCollection", "features": [
{"type": "Feature", "id": "a", "properties": {"height": 5}, "geometry": {"type": "Polygon", "coordinates": [[[5.7, 53.8], [5.7001, 53.8], [5.7001, 53.8001], [5.7, 53.8001], [5.7, 53.8]]]}},
{"type": "Feature", "id": "b", "properties": {"height": 7}, "geometry": {"type": "Polygon", "coordinates": [[[5.7003, 53.8], [5.7004, 53.8], [5.7004, 53.8001], [5.7003, 53.8001], [5.7003, 53.8]]]}}]}"#;

/// One published file.
fn small() -> Place {
    let place = Place::new();
    place.write("in.geojson", SQUARES);
    let text = "[node.read]\nop = \"read-geojson\"\npath = \"in.geojson\"\n[node.out]\nop = \"write-geojson\"\nin.layer = \"read\"\npath = \"out.geojson\"\n";
    place.write("p.toml", text);
    place
}

/// A program that has the file mapped and writes single bytes of it where it is told to.
const MAPPER: &str = r#"
import mmap, sys
with open(sys.argv[1], "r+b") as file:
    map = mmap.mmap(file.fileno(), 0)
print("mapped", flush=True)
for line in sys.stdin:
    at, byte = line.split()
    map[int(at)] = int(byte)
    print("written", flush=True)
"#;

#[test]
fn an_output_that_a_program_keeps_mapped_writable() {
    let place = small();
    place.lodge_json(&["run", "p.toml"]);
    let path = place.path("out/p/out.geojson");
    let right = fs::read(&path).unwrap();
    for found_by in ["verify", "run"] {
        let mut python = Command::new("python3");
        python.arg("-c").arg(MAPPER).arg(&path).stdin(Stdio::piped()).stdout(Stdio::piped());
        let Ok(mut mapper) = python.spawn() else { return println!("skipped: no python3") };
        let mut said = BufReader::new(mapper.stdout.take().unwrap()).lines();
        let mut write = |at: usize, byte: u8| {
            writeln!(mapper.stdin.as_mut().unwrap(), "{at} {byte}").unwrap();
            said.next().unwrap().unwrap()
        };
        // The first write to a page changes ctime: it is noticed, and is no change.
        write(0, right[0]);
        assert_eq!(names(&place.lodge_json(&["run", "p.toml"]), "ran"), [""; 0]);
        // Older than the margin; and noted, so that no stamp of before tells anything.
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!(place.lodge(&["run", "p.toml", "--verify"]).status.success());
        // The second one may not, until the kernel has written the page to the disk.
        write(1, right[1] ^ 1);
        write(2, right[2] ^ 1);
        let null = place.lodge_json(&["run", "p.toml"]);
        let missed = fs::read(&path).unwrap() != right;
        println!("a null rerun {} it", if missed { "misses" } else { "notices" });
        assert_eq!(null["files"][0]["written"], !missed);
        // Whoever reads the file notices.
        if found_by == "verify" {
            let verify = place.lodge_json(&["cache", "verify"]);
            let found = ["repaired", "changed"].map(|k| verify[k].as_array().unwrap().len());
            assert_eq!(found.iter().sum::<usize>(), usize::from(missed), "{verify}");
        }
        let run = place.lodge_json(&["run", "p.toml", "--verify"]);
        assert_eq!(names(&run, "ran"), [""; 0]);
        assert!(found_by == "verify" || run["files"][0]["written"] == missed, "{run}");
        assert!(fs::read(&path).unwrap() == right);
        drop(mapper.stdin.take());
        mapper.wait().unwrap();
        assert!(fs::read(&path).unwrap() == right, "the map is of the file that was there before");
    }
}

/// Something that is mounted, until this goes.
struct Mounted<'a>(&'a Path);

impl<'a> Mounted<'a> {
    /// None where this user, or this system, cannot.
    fn new(at: &'a Path, args: &[&str]) -> Option<Self> {
        fs::create_dir_all(at).unwrap();
        let done = Command::new("mount").args(args).arg(at).output();
        done.is_ok_and(|done| done.status.success()).then_some(Self(at))
    }
}

impl Drop for Mounted<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0).status();
    }
}

/// As bit rot and raw writes do it: outputs lie on a file system in a file, and a bit of that file changes.
#[test]
fn bytes_that_change_below_the_file_system() {
    let place = small();
    let (image, out) = (place.path("disk"), place.path("out"));
    fs::File::create(&image).unwrap().set_len(16 << 20).unwrap();
    if !Command::new("mkfs.ext4").args(["-q", "-F"]).arg(&image).status().is_ok_and(|s| s.success()) {
        return println!("skipped: no mkfs.ext4");
    }
    let Some(_mounted) = Mounted::new(&out, &["-o", "loop", image.to_str().unwrap()]) else {
        return println!("skipped: this user cannot mount a file");
    };
    assert_eq!(names(&place.lodge_json(&["run", "p.toml"]), "ran"), ["read", "out"]);
    let path = out.join("p/out.geojson");
    let right = fs::read(&path).unwrap();
    // To the disk, there another bit, and nothing of it left in memory.
    let rot = || {
        fs::File::open(&path).unwrap().sync_all().unwrap();
        let disk = fs::File::options().read(true).write(true).open(&image).unwrap();
        let bytes = fs::read(&image).unwrap();
        let places: Vec<usize> = bytes.windows(right.len()).enumerate().filter(|w| w.1 == right).map(|w| w.0).collect();
        // What was there before the file came back may lie there, too.
        assert!(!places.is_empty());
        places.iter().for_each(|&at| disk.write_all_at(&[right[1] ^ 4], at as u64 + 1).unwrap());
        let mut forget = Command::new("dd");
        forget.arg(format!("if={}", path.display())).args(["iflag=nocache", "count=0", "status=none"]);
        assert!(forget.status().unwrap().success());
        fs::read(&path).unwrap() != right
    };
    let null = || {
        let run = place.lodge_json(&["run", "p.toml"]);
        (names(&run, "ran").len(), run["files"][0]["written"].as_bool().unwrap())
    };
    // Older than the margin, and noted.
    std::thread::sleep(std::time::Duration::from_millis(50));
    assert!(place.lodge(&["run", "p.toml", "--verify"]).status.success());
    assert_eq!(null(), (0, false));
    for found_by in ["run", "verify"] {
        if !rot() {
            return println!("skipped: the kernel still knows what was there");
        }
        assert_eq!(null(), (0, false), "a rerun does not read what has its stamp");
        assert!(fs::read(&path).unwrap() != right);
        if found_by == "verify" {
            let verify = place.lodge_json(&["cache", "verify"]);
            assert_eq!((verify["repaired"].as_array().unwrap().len(), &verify["changed"]), (1, &json!([])), "{verify}");
        } else {
            let run = place.lodge_json(&["run", "p.toml", "--verify"]);
            assert_eq!((names(&run, "ran").len(), &run["files"][0]["written"]), (0, &json!(true)));
        }
        assert!(fs::read(&path).unwrap() == right, "{found_by}");
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!(place.lodge(&["run", "p.toml", "--verify"]).status.success());
        null();
    }
}

/// Where the clock of files ticks, it is not taken for a fine one.
#[test]
fn a_clock_that_ticks_is_found_out() {
    let place = Place::new();
    let disk = place.path("disk");
    let Some(_mounted) = Mounted::new(&disk, &["-t", "ramfs", "ramfs"]) else {
        return println!("skipped: this user cannot mount a ramfs");
    };
    // Two looks with a change between, and one time.
    let mut file = fs::File::create(disk.join("a")).unwrap();
    let mut tick = || {
        file.write_all(b"x").unwrap();
        let meta = file.metadata().unwrap();
        (meta.ctime(), meta.ctime_nsec())
    };
    if (0..1000).all(|_| tick() != tick()) {
        return println!("skipped: the clock of this ramfs is fine");
    }
    assert_eq!(lodge::run::stamp::grain(&disk.join("b")), None);
    assert!(!disk.join("b").exists());
}

/// A file system without ctime, and a clock set back to the nanosecond: bytes change, and the stamp does not. No test can
/// set the kernel's clock, and no file system without a ctime is at hand: so it is made the other way round, the note of
/// the last run gets the stamp of the changed file. It stands for raw writes and bit rot as well, where no file can be
/// mounted for the test above.
#[test]
fn bytes_that_change_under_an_unchanged_stamp() {
    let home = tempfile::tempdir().unwrap();
    let yard = Yard::diamond(home.path());
    yard.ran();
    let right = tree(&yard.out());
    let path = yard.out().join("files/n/1.txt");
    let rot = || {
        let mut bytes = fs::read(&path).unwrap();
        bytes[3] ^= 4;
        fs::write(&path, bytes).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(30));
        let store = Store::open(&home.path().join(".lodge")).unwrap();
        let (name, folder) = published::all(&store).into_iter().next().unwrap();
        let stamp = lodge::run::stamp::Stamp::of_output(&path).unwrap();
        let files = folder.files.into_iter().map(|(mut file, _)| {
            if file.path.ends_with("n/1.txt") {
                file.stamp = stamp;
            }
            file
        });
        let files: Vec<published::Published> = files.collect();
        let all = files.iter().map(|f| (&*f.path, f)).collect();
        let state = published::write_state(&yard.graph(), &yard.out(), &all, std::iter::empty());
        store.put_state("published", &name, &state).unwrap();
    };
    let written = |outcome: &Outcome| {
        assert!(outcome.ok() && yard.names(outcome, Status::Ran).is_empty());
        outcome.files.iter().filter(|f| f.written).count()
    };
    rot();
    assert_eq!(written(&yard.run()), 0, "a rerun does not read what has its stamp");
    assert!(tree(&yard.out()) != right);
    let mut options = yard.options();
    options.verify = true;
    assert_eq!(written(&yard.run_with(&options)), 1, "`run --verify` does");
    assert!(tree(&yard.out()) == right);
    rot();
    let found = verify(&Store::open(&home.path().join(".lodge")).unwrap());
    assert_eq!((found.repaired.len(), found.changed.len()), (1, 0), "`cache verify` does: {found:?}");
    assert!(tree(&yard.out()) == right);
}

/// An input is one that changed, whatever its times say; one that only looks changed is not.
#[test]
fn times_of_inputs_that_are_put_back() {
    let place = small();
    place.lodge_json(&["run", "p.toml"]);
    let path = place.path("in.geojson");
    let before = fs::metadata(&path).unwrap().modified().unwrap();
    let back = |text: &str| {
        place.write("in.geojson", text);
        fs::File::options().write(true).open(&path).unwrap().set_modified(before).unwrap();
    };
    back(&SQUARES.replace("\"height\": 5", "\"height\": 6"));
    assert_eq!(names(&place.lodge_json(&["run", "p.toml"]), "ran"), ["read", "out"]);
    back(SQUARES);
    assert_eq!(names(&place.lodge_json(&["run", "p.toml"]), "ran"), [""; 0]);
    // Modes and names are not contents.
    fs::set_permissions(&path, PermissionsExt::from_mode(0o600)).unwrap();
    fs::rename(&path, place.path("moved.geojson")).unwrap();
    std::os::unix::fs::symlink(place.path("moved.geojson"), &path).unwrap();
    assert_eq!(names(&place.lodge_json(&["run", "p.toml"]), "ran"), [""; 0]);
}

/// Mounted so that nobody can write there, root included.
#[test]
fn a_cache_that_became_read_only_is_read_and_says_so() {
    let place = small();
    let disk = place.path("disk");
    let Some(_mounted) = Mounted::new(&disk, &["-t", "tmpfs", "-o", "size=64m", "tmpfs"]) else {
        return println!("skipped: this user cannot mount a tmpfs");
    };
    let cache = disk.join("cache").to_str().unwrap().to_string();
    let run = |args: &[&str]| place.lodge_json(&[&["run", "p.toml", "--cache", &cache], args].concat());
    run(&[]);
    // One whose result is large, and so has a file of its own.
    let side = 450;
    let mut mesh: String = (0..side * side).map(|i| format!("v {} {} 0\n", i % side, i / side)).collect();
    for i in (1..=side * (side - 1)).filter(|i| i % side > 0) {
        mesh += &format!("f {i} {} {}\nf {i} {} {}\n", i + 1, i + side + 1, i + side + 1, i + side);
    }
    place.write("m.obj", mesh);
    let file = "[node.read]\nop = \"read-mesh\"\npath = \"m.obj\"\n[node.out]\nop = \"write-glb\"\nin.model = \"read\"\npath = \"m.glb\"\n";
    place.write("m.toml", file);
    let large = || place.lodge_json(&["run", "m.toml", "--cache", &cache]);
    assert_eq!(names(&large(), "ran"), ["read", "out"]);
    assert!(fs::metadata(place.path("out/m/m.glb")).unwrap().len() > lodge::run::store::SMALL);
    let right = tree(&place.path("out"));
    assert!(Command::new("mount").args(["-o", "remount,ro"]).arg(&disk).status().unwrap().success());
    // What is there is used, what is not is computed and not kept.
    fs::remove_dir_all(place.path("out")).unwrap();
    for _ in 0..2 {
        let all = run(&["--verify"]);
        assert_eq!((names(&all, "ran"), names(&large(), "ran")), (vec![], vec![]));
        assert!(tree(&place.path("out")) == right);
        let other = run(&["--set", "node.read.height=9"]);
        assert_eq!(names(&other, "ran"), ["read", "out"]);
        for run in [all, other] {
            assert_eq!(run["warnings"].as_array().unwrap().len(), 1, "{run}");
            assert!(run["warnings"][0].as_str().unwrap().contains("cannot be written"), "{run}");
        }
    }
    let gc = place.lodge(&["cache", "gc", "--cache", &cache]);
    assert_eq!(gc.status.code(), Some(1), "{gc:?}");
    assert!(String::from_utf8_lossy(&gc.stderr).contains("cannot be written"), "{gc:?}");
    assert_eq!(place.lodge(&["cache", "gc", "--dry-run", "--cache", &cache]).status.code(), Some(0));
    assert_eq!(place.lodge(&["cache", "verify", "--cache", &cache]).status.code(), Some(0));
}

/// A file larger than the process may write: as on a full disk, where nobody may mount one.
#[test]
fn a_limit_on_the_size_of_files_fails_the_node_and_keeps_nothing_bad() {
    let place = Place::new();
    place.write("in.geojson", SQUARES);
    place.write("v.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
    // The voxels do not fit, the squares do.
    let text = "[node.mesh]\nop = \"read-mesh\"\npath = \"v.obj\"\n[node.voxels]\nop = \"voxelize\"\nin.mesh = \"mesh\"\nresolution = 200\n\
        [node.read]\nop = \"read-geojson\"\npath = \"in.geojson\"\n[node.out]\nop = \"write-geojson\"\nin.layer = \"read\"\npath = \"out.geojson\"\n";
    place.write("p.toml", text);
    let run = lodge(&place, &["run", "p.toml", "--json"]);
    let mut limited = Command::new("sh");
    limited.args(["-c", "trap '' XFSZ; ulimit -f 128; exec \"$@\"", "sh"]).arg(run.get_program()).args(run.get_args());
    limited.current_dir(place.dir.path()).env("LODGE_CACHE", place.path("cache"));
    let done = limited.output().unwrap();
    assert_eq!(done.status.code(), Some(1), "{done:?}");
    let run: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(names(&run, "failed"), ["voxels"], "{run}");
    let error = super::support::node(&run, "voxels")["error"].as_str().unwrap().to_string();
    assert!(error.contains("cannot keep the result") && error.contains("too large"), "{error}");
    assert_eq!(names(&run, "ran"), ["mesh", "read", "out"]);
    let verify = place.lodge_json(&["cache", "verify"]);
    assert_eq!((&verify["evicted"], &verify["missing"]), (&json!([]), &json!([])));
    assert_eq!(names(&place.lodge_json(&["run", "p.toml"]), "ran"), ["voxels"]);
}
