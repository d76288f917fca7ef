//! The figures of the engine: whole processes of the release binary on pipelines of trivial nodes, beside ninja.
//!
//!     cargo bench --bench engine [-- PART..]      (ninja: on the path, or NINJA=..)
//!
//! Parts: null null-all edit small cold verify large parallel side; without any, all. Times are medians; against ninja
//! medians of the ratios of interleaved pairs. `goal` is what we want, `must` what has to hold. On a busy machine
//! processor time and ratios can be trusted, wall time cannot.

mod parts;
mod process;
mod yard;

use std::process::ExitCode;

fn main() -> ExitCode {
    let args: Vec<std::ffi::OsString> = std::env::args_os().skip(1).collect();
    if args.first().is_some_and(|a| a == process::WATCH) {
        return process::watch(&args[1..]);
    }
    let wanted: Vec<String> =
        args.iter().filter_map(|a| a.to_str()).filter(|a| *a != "--bench").map(String::from).collect();
    let known = |name: &String| parts::ALL.iter().any(|p| p.0 == name);
    if let Some(bad) = wanted.iter().find(|w| !known(w)) {
        eprintln!("there is no part `{bad}`: {}", parts::ALL.map(|p| p.0).join(" "));
        return ExitCode::FAILURE;
    }
    for (name, part) in parts::ALL {
        if wanted.is_empty() || wanted.iter().any(|w| w == name) {
            println!("{name}");
            part();
        }
    }
    ExitCode::SUCCESS
}
