//! Whole processes: wall and processor time, peak memory, medians of pairs.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};
use std::time::Instant;

use nix::sys::resource::{UsageWho, getrusage};

/// What one process took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Milliseconds.
    pub wall: f64,
    /// Of all its threads, user and system.
    pub cpu: f64,
    /// Of that, outside the kernel.
    pub user: f64,
    /// Most resident memory, in MiB.
    pub peak: f64,
}

/// The word by which this program knows that it should run another and tell what that took.
pub const WATCH: &str = "--watch-one";

/// Runs a command in `folder`, which must end well. A small process of its own watches it: the system tells the peak of
/// its largest child only, and counts in it the memory of whoever started that.
pub fn cost<S: AsRef<OsStr>>(folder: &Path, command: &[S]) -> Cost {
    let us = std::env::current_exe().expect("it runs");
    let mut watch = Command::new(us);
    watch.arg(WATCH).args(command).current_dir(folder).env_remove("LODGE_CACHE");
    let out = watch.stderr(Stdio::inherit()).output().expect("it starts");
    let text = String::from_utf8_lossy(&out.stdout);
    let numbers: Vec<f64> = text.split_whitespace().filter_map(|n| n.parse().ok()).collect();
    let shown: Vec<_> = command.iter().map(AsRef::as_ref).collect();
    assert!(out.status.success() && numbers.len() == 4, "{shown:?} failed");
    Cost { wall: numbers[0], cpu: numbers[1], user: numbers[2], peak: numbers[3] }
}

/// The process between: runs `command`, prints its four numbers.
pub fn watch(command: &[OsString]) -> ExitCode {
    let started = Instant::now();
    let mut child = Command::new(&command[0]);
    child.args(&command[1..]).stdin(Stdio::null()).stdout(Stdio::null());
    let status = child.stderr(Stdio::null()).status();
    let wall = started.elapsed().as_secs_f64() * 1e3;
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN).expect("the system counts");
    let ms = |t: nix::sys::time::TimeVal| t.tv_sec() as f64 * 1e3 + t.tv_usec() as f64 / 1e3;
    let (user, system) = (ms(usage.user_time()), ms(usage.system_time()));
    println!("{wall} {} {user} {}", user + system, usage.max_rss() as f64 / 1024.0);
    ExitCode::from(!status.is_ok_and(|s| s.success()) as u8)
}

pub fn median(all: impl IntoIterator<Item = f64>) -> f64 {
    let mut all: Vec<f64> = all.into_iter().collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// Many costs of the same thing.
pub struct Costs(pub Vec<Cost>);

impl Costs {
    pub fn of(rounds: usize, mut one: impl FnMut() -> Cost) -> Self {
        Self((0..rounds).map(|_| one()).collect())
    }

    /// Two things in turns, each first every other time.
    pub fn pairs(rounds: usize, mut a: impl FnMut() -> Cost, mut b: impl FnMut() -> Cost) -> [Self; 2] {
        let mut out = [Self(Vec::new()), Self(Vec::new())];
        for round in 0..rounds {
            let (x, y) = if round % 2 == 0 {
                let x = a();
                (x, b())
            } else {
                let y = b();
                (a(), y)
            };
            out[0].0.push(x);
            out[1].0.push(y);
        }
        out
    }

    pub fn wall(&self) -> f64 {
        median(self.0.iter().map(|c| c.wall))
    }

    pub fn cpu(&self) -> f64 {
        median(self.0.iter().map(|c| c.cpu))
    }

    pub fn user(&self) -> f64 {
        median(self.0.iter().map(|c| c.user))
    }

    pub fn peak(&self) -> f64 {
        median(self.0.iter().map(|c| c.peak))
    }

    /// The median of the ratios of the pairs, of wall and of processor time.
    pub fn to(&self, other: &Self) -> [f64; 2] {
        let ratio = |of: fn(&Cost) -> f64| median(self.0.iter().zip(&other.0).map(|(a, b)| of(a) / of(b)));
        [ratio(|c| c.wall), ratio(|c| c.cpu)]
    }

    pub fn line(&self, name: &str) {
        let least = self.0.iter().map(|c| c.wall).fold(f64::INFINITY, f64::min);
        let most = self.0.iter().map(|c| c.wall).fold(0.0, f64::max);
        println!(
            "  {name:30} wall {:9.2} ms [{least:.2}..{most:.2}], cpu {:9.2} ms (user {:.2}), peak {:.1} MiB",
            self.wall(),
            self.cpu(),
            self.user(),
            self.peak()
        );
    }
}
