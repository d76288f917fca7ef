//! `lodge graph FILE`: the graph as Mermaid, DOT or SVG. A node of the file is one box, whatever its variants;
//! `--variants` draws them apart.

mod layout;
mod svg;

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::ValueEnum;
use serde_json::json;

use super::{Exit, Globals, Outcome, Stop, Target};
use crate::diag::Diagnostic;
use crate::graph::{Graph, port_name};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
    /// Form of the drawing [default: by the ending of --output, else mermaid]
    #[arg(long, value_name = "FORM")]
    format: Option<Format>,
    /// Write to a file (.mmd, .dot or .svg)
    #[arg(short, long, value_name = "PATH")]
    output: Option<PathBuf>,
    /// One box for each variant
    #[arg(long)]
    variants: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Mermaid,
    Dot,
    Svg,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let graph = self.target.load()?;
        let format = self.format.unwrap_or_else(|| {
            match self.output.as_ref().and_then(|p| p.extension()).and_then(|e| e.to_str()) {
                Some("svg") => Format::Svg,
                Some("dot" | "gv") => Format::Dot,
                _ => Format::Mermaid,
            }
        });
        let drawing = Drawing::of(&graph, self.variants, &state::of(&graph, globals, &self.target.file));
        let text = match format {
            Format::Mermaid => drawing.mermaid(),
            Format::Dot => drawing.dot(),
            Format::Svg => svg::draw(&drawing),
        };
        if let Some(path) = &self.output {
            std::fs::write(path, &text).map_err(|e| {
                let sentence = format!("cannot write {}: {}", path.display(), crate::spec::why(&e));
                Stop::from(Diagnostic::error("cannot-write", sentence))
            })?;
        }
        if globals.json {
            super::print(&json!({"ok": true, "format": format!("{format:?}").to_lowercase(), "text": text}));
        } else if self.output.is_none() {
            super::say(&text);
        }
        Ok(Exit::Done)
    }
}

/// What is known of a node from earlier runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mark {
    /// `cached`, `run`, `may-run`; empty where nothing is known.
    pub state: &'static str,
    /// What it took when it last ran.
    pub seconds: Option<f64>,
}

mod state {
    use std::path::Path;

    use super::{Globals, Graph, Mark};
    use crate::cli::engine::{Place, look};
    use crate::run::forecast::{Fate, forecast};

    /// A mark for each node; empty ones where there is no cache yet (drawing makes none).
    pub fn of(graph: &Graph, globals: &Globals, file: &Path) -> Vec<Mark> {
        let mut marks = vec![Mark::default(); graph.nodes.len()];
        let place = Place::of(globals, file);
        if !place.cache.is_dir() {
            return marks;
        }
        let Ok(store) = look(&place) else { return marks };
        for f in forecast(graph, &[], &store) {
            marks[f.index] = match f.fate {
                Fate::Cached(record) => Mark { state: "cached", seconds: Some(record.seconds) },
                Fate::Runs => Mark { state: "run", seconds: None },
                Fate::MayRun(_) => Mark { state: "may-run", seconds: None },
                Fate::Fails(_) => Mark::default(),
            };
        }
        marks
    }
}

/// Boxes and arrows, before any form.
pub struct Drawing {
    title: String,
    boxes: Vec<Box>,
    arrows: Vec<Arrow>,
}

struct Box {
    name: String,
    operator: String,
    kind: &'static str,
    /// `3 variants`, `cached, 1.2 s`.
    notes: Vec<String>,
    /// `cached`, `run`, `may-run` or empty.
    state: &'static str,
    /// The published path, of a writer.
    output: Option<String>,
}

#[derive(PartialEq, PartialOrd, Eq, Ord)]
struct Arrow {
    from: usize,
    to: usize,
    /// Ports, joined by commas.
    port: String,
}

impl Drawing {
    fn of(graph: &Graph, variants: bool, marks: &[Mark]) -> Self {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let mut group_of = vec![0; graph.nodes.len()];
        let mut by_name: BTreeMap<&str, usize> = BTreeMap::new();
        for (i, node) in graph.nodes.iter().enumerate() {
            let name = if variants { &node.name } else { &node.base };
            group_of[i] = *by_name.entry(name).or_insert_with(|| {
                groups.push(Vec::new());
                groups.len() - 1
            });
            groups[group_of[i]].push(i);
        }
        let boxes = groups.iter().map(|group| of_group(graph, group, variants, marks)).collect();
        let mut ports: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
        for (i, node) in graph.nodes.iter().enumerate() {
            for (port, from) in node.entry.ports.iter().zip(&node.inputs) {
                for &from in from {
                    let names = ports.entry((group_of[from], group_of[i])).or_default();
                    if !names.contains(&port_name(port)) {
                        names.push(port_name(port));
                    }
                }
            }
        }
        let arrows = ports.into_iter().map(|((from, to), names)| Arrow { from, to, port: names.join(", ") }).collect();
        let title = if graph.description.is_empty() { graph.name.clone() } else { graph.description.clone() };
        Self { title, boxes, arrows }
    }

    fn mermaid(&self) -> String {
        let text = |t: &str| t.replace('#', "#35;").replace('"', "#quot;").replace('<', "#lt;").replace('>', "#gt;");
        let mut out = String::from("flowchart LR\n");
        for (i, b) in self.boxes.iter().enumerate() {
            let lines: Vec<_> = b.lines().iter().map(|l| text(l)).collect();
            let (open, close) = if b.output.is_some() { ("[/\"", "\"/]") } else { ("[\"", "\"]") };
            out += &format!("  n{i}{open}{}{close}\n", lines.join("<br/>"));
            if !b.state.is_empty() {
                out += &format!("  class n{i} {}\n", b.state.replace('-', ""));
            }
        }
        for a in &self.arrows {
            out += &format!("  n{} -->|{}| n{}\n", a.from, text(&a.port), a.to);
        }
        if self.boxes.iter().any(|b| !b.state.is_empty()) {
            for (state, fill) in svg::STATES {
                out += &format!("  classDef {} fill:{fill}\n", state.replace('-', ""));
            }
        }
        out
    }

    fn dot(&self) -> String {
        let text = |t: &str| t.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
        let mut out = format!(
            "digraph \"{}\" {{\n  rankdir = LR\n  node [shape = box, style = filled, fillcolor = white]\n",
            text(&self.title)
        );
        for (i, b) in self.boxes.iter().enumerate() {
            let lines: Vec<_> = b.lines().iter().map(|l| text(l)).collect();
            let fill = svg::fill(b.state).map(|f| format!(", fillcolor = \"{f}\"")).unwrap_or_default();
            let shape = if b.output.is_some() { ", shape = note" } else { "" };
            out += &format!("  n{i} [label = \"{}\"{fill}{shape}]\n", lines.join("\\n"));
        }
        for a in &self.arrows {
            out += &format!("  n{} -> n{} [label = \"{}\"]\n", a.from, a.to, text(&a.port));
        }
        out + "}\n"
    }
}

impl Box {
    fn lines(&self) -> Vec<String> {
        let mut out = vec![self.name.clone()];
        if self.operator != self.name {
            out.push(self.operator.clone());
        }
        out.extend(self.output.clone());
        out.extend(self.notes.iter().cloned());
        out
    }
}

fn of_group(graph: &Graph, group: &[usize], variants: bool, marks: &[Mark]) -> Box {
    let node = &graph.nodes[group[0]];
    let mut notes = Vec::new();
    if !variants && node.name != node.base {
        notes.push(format!("{} variant{}", group.len(), if group.len() == 1 { "" } else { "s" }));
    }
    let worst = |s: &str| ["", "cached", "may-run", "run"].iter().position(|o| *o == s).unwrap_or(0);
    let state = group.iter().map(|&i| marks[i].state).max_by_key(|s| worst(s)).unwrap_or("");
    let seconds = group.iter().filter_map(|&i| marks[i].seconds).reduce(|a, b| a + b);
    let words = [state.to_string(), seconds.map(|s| format!("{s:.2} s")).unwrap_or_default()];
    let words: Vec<_> = words.into_iter().filter(|w| !w.is_empty()).collect();
    if !words.is_empty() {
        notes.push(words.join(", "));
    }
    let output = match group {
        [one] => graph.nodes[*one]
            .output
            .as_ref()
            .map(|(path, folder)| if *folder { format!("{path}/") } else { path.clone() }),
        _ => node.output.as_ref().map(|_| format!("{} outputs", group.len())),
    };
    Box {
        name: if variants { node.name.clone() } else { node.base.clone() },
        operator: node.entry.name.to_string(),
        kind: node.entry.output.name,
        notes,
        state,
        output,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub fn diamond() -> Drawing {
        let node = |name: &str, state| Box {
            name: name.into(),
            operator: "op<\"x\">".into(),
            kind: "Mesh",
            notes: Vec::new(),
            state,
            output: None,
        };
        let arrow = |from, to| Arrow { from, to, port: "in".into() };
        Drawing {
            title: "a & b".into(),
            boxes: vec![node("a", "cached"), node("b", ""), node("c", "run"), node("d", "")],
            arrows: vec![arrow(0, 1), arrow(0, 2), arrow(1, 3), arrow(2, 3), arrow(0, 3)],
        }
    }

    #[test]
    fn text_is_escaped_in_every_form() {
        let d = diamond();
        assert!(d.mermaid().contains("n0[\"a<br/>op#lt;#quot;x#quot;#gt;\"]"), "{}", d.mermaid());
        assert!(d.dot().contains(r#"n0 [label = "a\nop<\"x\">", fillcolor"#), "{}", d.dot());
        let svg = svg::draw(&d);
        assert!(svg.contains("op&lt;&quot;x&quot;&gt;") && svg.contains("a &amp; b"), "{svg}");
        assert_eq!(svg.matches("<rect").count(), 4);
        assert_eq!(svg.matches("<path class=\"arrow\"").count(), 5);
    }
}
