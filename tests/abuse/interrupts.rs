//! Ctrl-C where no node is at work: while `export` makes a long output, and while it writes one.

use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};

use nix::libc;

use super::support::{Place, interrupt};
use super::{is_empty, lodge};

/// A surface, and its grid, which is written as 134 million bytes.
fn surface(side: usize) -> Place {
    let place = Place::new();
    let height = |i: usize| ((i % side * 7 + i / side * 5) % 11) as f64 / 4.0;
    let mut mesh: String = (0..side * side).map(|i| format!("v {} {} {}\n", i % side, i / side, height(i))).collect();
    for i in (1..=side * (side - 1)).filter(|i| i % side > 0) {
        mesh += &format!("f {i} {} {}\nf {i} {} {}\n", i + 1, i + side + 1, i + side + 1, i + side);
    }
    place.write("m.obj", mesh);
    let text = "[node.mesh]\nop = \"read-mesh\"\npath = \"m.obj\"\n\
        [node.grid]\nop = \"voxelize\"\nin.mesh = \"mesh\"\nresolution = 512\nfill = \"surface\"\n";
    place.write("p.toml", text);
    place.lodge_json(&["run", "p.toml"]);
    std::fs::create_dir(place.path("to")).unwrap();
    place
}

fn export(place: &Place, node: &str, to: &str) -> Child {
    assert!(is_empty(&place.path("cache/tmp")));
    lodge(place, &["export", "p.toml", node, "-o", to]).spawn().unwrap()
}

/// Waits for something, or for the end of the process: whether it came.
fn until(child: &mut Child, mut ready: impl FnMut() -> bool) -> bool {
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        if ready() {
            return true;
        }
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        assert!(Instant::now() < end, "nothing happens");
        std::thread::sleep(Duration::from_micros(200));
    }
}

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn an_output_that_is_being_made() {
    let place = surface(700);
    let started = Instant::now();
    assert!(export(&place, "mesh", "to/views.png").wait().unwrap().success());
    let whole = started.elapsed();
    std::fs::remove_file(place.path("to/views.png")).unwrap();
    let mut child = export(&place, "mesh", "to/views.png");
    // It has opened the cache, so it listens.
    assert!(until(&mut child, || !is_empty(&place.path("cache/tmp"))));
    std::thread::sleep(Duration::from_millis(100));
    let (code, took) = interrupt(&mut child);
    println!("{whole:?} without Ctrl-C, {took:?} after it");
    assert!(code == Some(130) && took < SECOND, "{code:?} {took:?}");
    assert!(is_empty(&place.path("to")) && is_empty(&place.path("cache/tmp")));
}

#[test]
fn a_file_that_is_being_written() {
    let place = surface(50);
    let to = place.path("to/grid.npy");
    assert!(export(&place, "grid", "to/grid.npy").wait().unwrap().success());
    let bytes = std::fs::metadata(&to).unwrap().len();
    assert!(bytes > 100_000_000);
    // Once over nothing, once over the file of before.
    let mut heard = [0, 0];
    for round in 0..40 {
        let before = round % 2 == 1;
        std::fs::write(&to, "before").unwrap();
        if !before {
            std::fs::remove_file(&to).unwrap();
        }
        let mut child = export(&place, "grid", "to/grid.npy");
        let files = || std::fs::read_dir(place.path("to")).unwrap().count();
        let (code, took) = match until(&mut child, || files() > usize::from(before)) {
            true => interrupt(&mut child),
            false => (child.wait().unwrap().code(), Duration::ZERO),
        };
        assert!(took < SECOND, "{took:?}");
        // It may have been done before it heard.
        if code == Some(0) {
            assert_eq!((files(), std::fs::metadata(&to).unwrap().len()), (1, bytes));
            continue;
        }
        assert_eq!(code, Some(130));
        assert_eq!(files(), usize::from(before), "what was begun is gone");
        assert!(!before || std::fs::read(&to).unwrap() == b"before");
        heard[usize::from(before)] += 1;
        if heard == [3, 3] {
            break;
        }
    }
    println!("{heard:?} heard in the middle of the file");
    assert!(heard[0] > 0 && heard[1] > 0);
}

#[test]
fn a_pipe_that_nobody_reads_any_more() {
    let place = surface(50);
    nix::unistd::mkfifo(&place.path("to/grid.npy"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    let open = |path: &Path| std::fs::File::options().read(true).custom_flags(libc::O_NONBLOCK).open(path).unwrap();
    let mut reader = open(&place.path("to/grid.npy"));
    let mut child = export(&place, "grid", "to/grid.npy");
    assert!(until(&mut child, || reader.read(&mut [0]).is_ok_and(|n| n == 1)));
    std::thread::sleep(Duration::from_millis(100));
    assert!(child.try_wait().unwrap().is_none());
    let (code, took) = interrupt(&mut child);
    assert!(code == Some(130) && took < SECOND, "{code:?} {took:?}");
}
