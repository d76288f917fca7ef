//! What a person, a log or a file hears while a run goes on: a bar on a terminal, plain lines elsewhere, `--events`
//! as JSON lines, and everything through `tracing` for `-v` and `--log-format json`.

use std::fs::File;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant, UNIX_EPOCH};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;
use tracing::Level;

use super::run::time;
use super::{Globals, LogFormat};
use crate::run::event::{Event, Status};

/// Sends `tracing` to standard error, as far as the flags want it.
pub fn log(globals: &Globals) {
    let level = match (globals.log_format, globals.quiet, globals.verbose) {
        (_, true, _) => Level::ERROR,
        (LogFormat::Text, _, 0) => return,
        (LogFormat::Json, _, 0) | (_, _, 1) => Level::INFO,
        (_, _, 2) => Level::DEBUG,
        _ => Level::TRACE,
    };
    // It would tell standard error that standard error cannot be written, and panic.
    let log = tracing_subscriber::fmt().with_max_level(level).with_writer(std::io::stderr).log_internal_errors(false);
    // A second subscriber in one process is refused: the first one stays.
    let _ = match globals.log_format {
        LogFormat::Json => tracing::subscriber::set_global_default(log.json().finish()),
        LogFormat::Text => {
            tracing::subscriber::set_global_default(log.with_ansi(std::io::stderr().is_terminal()).finish())
        }
    };
}

pub struct Teller {
    started: Instant,
    events: Option<File>,
    /// Lines or a bar for people.
    quiet: bool,
    bar: Option<ProgressBar>,
    running: Vec<String>,
}

impl Teller {
    pub fn new(globals: &Globals) -> Self {
        let events = globals.events.as_ref().and_then(|path| match File::create(path) {
            Ok(file) => Some(file),
            Err(error) => {
                super::warn(&format!("cannot write events to `{}`: {error}", path.display()));
                None
            }
        });
        let quiet = globals.quiet || globals.log_format == LogFormat::Json;
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(10));
            let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {wide_msg}").expect("a valid template");
            bar.set_style(style);
            bar
        });
        Self { started: Instant::now(), events, quiet, bar, running: Vec::new() }
    }

    pub fn hear(&mut self, event: &Event) {
        self.write(event);
        match event {
            Event::Started { nodes, pipeline } => {
                tracing::info!(pipeline, nodes, "started");
                if let Some(bar) = &self.bar {
                    bar.reset();
                    bar.set_length(*nodes as u64);
                    bar.enable_steady_tick(Duration::from_millis(200));
                }
            }
            Event::NodeStarted { node, op } => {
                tracing::debug!(node, op, "node started");
                self.running.push(node.clone());
                self.tick(0);
            }
            Event::NodeDone { node, status, seconds, .. } => {
                tracing::info!(node, status = status.name(), seconds, "node done");
                self.running.retain(|n| n != node);
                if matches!(status, Status::Ran | Status::Failed) {
                    self.line(&format!("{node}: {}, {}", status.name(), time(*seconds)), false);
                }
                self.tick(1);
            }
            Event::Waiting { what, on } => {
                let on = if *on > 0 { format!("process {on}") } else { "another run".to_string() };
                tracing::info!(what, on, "waiting");
                self.line(&format!("{what}: waiting for {on}"), true);
            }
            Event::Warning { node: None, text } => {
                tracing::warn!("{text}");
                self.line(&format!("warning: {text}"), true);
            }
            // In the table.
            Event::Warning { node: Some(node), text } => tracing::warn!(node, "{text}"),
            Event::Published { path, bytes } => tracing::debug!(path, bytes, "published"),
            Event::Removed { path } => tracing::debug!(path, "removed"),
            Event::Done { ok, seconds, .. } => {
                tracing::info!(ok, seconds, "done");
                if let Some(bar) = &self.bar {
                    bar.finish_and_clear();
                }
            }
        }
    }

    fn tick(&self, done: u64) {
        if let Some(bar) = &self.bar {
            bar.inc(done);
            bar.set_message(self.running.join(", "));
        }
    }

    /// Beside a bar only what is `important`.
    fn line(&self, text: &str, important: bool) {
        match &self.bar {
            _ if self.quiet => {}
            Some(bar) if important => bar.suspend(|| super::say_aside(&format!("{text}\n"))),
            Some(_) => {}
            None => super::say_aside(&format!("{text}\n")),
        }
    }

    /// One line of `--events`, at once: whoever follows the file sees it.
    fn write(&mut self, event: &Event) {
        let Some(file) = &mut self.events else { return };
        let mut line = event.to_json();
        line["at"] = json!(UNIX_EPOCH.elapsed().map_or(0.0, |d| d.as_secs_f64()));
        line["after"] = json!(self.started.elapsed().as_secs_f64());
        // In one piece: a run that is killed leaves whole lines.
        if let Err(error) = file.write_all(format!("{line}\n").as_bytes()) {
            super::warn(&format!("cannot write events: {error}"));
            self.events = None;
        }
    }
}
