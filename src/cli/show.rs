//! `lodge show FILE NODE`: the summary of a node's result. Runs what is missing.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use serde_json::{Map, Value, json};

use super::engine::{self, Place};
use super::run::size;
use super::{Globals, Outcome, Target};
use crate::io::csv;
use crate::run::NodeOutcome;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
    /// Node, or one variant of it
    node: String,
    /// Write a table with a row for each variant
    #[arg(short, long, value_name = "TABLE.csv")]
    output: Option<PathBuf>,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let graph = Arc::new(self.target.load()?);
        let asked = engine::pick(&graph, std::slice::from_ref(&self.node))?;
        let outcome =
            engine::run_silently(&graph, &asked, globals, &Place::of(globals, &self.target.file), &BTreeSet::new());
        let exit = super::run::exit(&outcome);
        let nodes: Vec<&NodeOutcome> =
            outcome.nodes.iter().filter(|n| asked.contains(&n.index) && n.record.is_some()).collect();
        if nodes.len() < asked.len() {
            return Err(engine::failure(&outcome, exit));
        }
        if let Some(path) = &self.output {
            engine::write_file(path, table(&nodes))?;
        }
        if globals.json {
            let mut all: Vec<Value> = nodes.iter().map(|n| to_json(n)).collect();
            match all.len() {
                1 => super::print(&all.remove(0)),
                _ => super::print(&json!({"name": self.node, "variants": all})),
            }
        } else if self.output.is_none() {
            nodes.iter().for_each(|n| super::say(&text(n)));
        }
        Ok(exit)
    }
}

fn to_json(node: &NodeOutcome) -> Value {
    let record = node.record.as_ref().expect("looked at before");
    let frame: Value = serde_json::from_str(&record.frame).unwrap_or_default();
    json!({"name": node.name, "op": node.op, "kind": record.kind, "digest": record.digest,
        "bytes": record.bytes + record.blob_bytes, "frame": frame, "summary": record.summary()})
}

fn text(node: &NodeOutcome) -> String {
    let record = node.record.as_ref().expect("looked at before");
    let summary = record.summary();
    let bytes = size(record.bytes + record.blob_bytes);
    let mut out = format!("{}: {} by {}, {bytes}, {}\n", node.name, record.kind, node.op, record.digest.short(6));
    let width = summary.keys().map(String::len).max().unwrap_or(0);
    for (key, value) in &summary {
        match rows_of(value) {
            Some(rows) => out += &format!("  {key}\n{}", columns(&rows)),
            None => out += &format!("  {key:width$}  {}\n", cell(value)),
        }
    }
    for warning in &node.warnings {
        out += &format!("  warning: {warning}\n");
    }
    out
}

/// A list of objects is shown as a table.
fn rows_of(value: &Value) -> Option<Vec<&Map<String, Value>>> {
    let rows = value.as_array().filter(|a| !a.is_empty())?;
    rows.iter().map(Value::as_object).collect()
}

fn columns(rows: &[&Map<String, Value>]) -> String {
    let header: Vec<&String> = rows[0].keys().collect();
    let mut cells: Vec<Vec<String>> = vec![header.iter().map(|h| h.to_string()).collect()];
    cells.extend(rows.iter().map(|r| header.iter().map(|h| r.get(*h).map_or(String::new(), cell)).collect()));
    let widths: Vec<usize> = (0..header.len())
        .map(|c| cells.iter().map(|row: &Vec<String>| row[c].chars().count()).max().unwrap_or(0))
        .collect();
    let line = |row: &Vec<String>| {
        let cells: Vec<String> = row.iter().zip(&widths).map(|(cell, &w)| format!("{cell:>w$}")).collect();
        format!("    {}\n", cells.join("  "))
    };
    cells.iter().map(line).collect()
}

fn cell(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => String::new(),
        other => other.to_string(),
    }
}

/// A row for each variant: its axes and every plain value of its summary.
fn table(nodes: &[&NodeOutcome]) -> Vec<u8> {
    let rows: Vec<Vec<(String, String)>> = nodes.iter().map(|n| flat(n)).collect();
    let mut header: Vec<&str> = Vec::new();
    for (name, _) in rows.iter().flatten() {
        if !header.contains(&&**name) {
            header.push(name);
        }
    }
    let find =
        |row: &Vec<(String, String)>, h: &str| row.iter().find(|(n, _)| n == h).map_or(String::new(), |c| c.1.clone());
    csv::table(&header, rows.iter().map(|row| header.iter().map(|h| find(row, h)).collect()))
}

fn flat(node: &NodeOutcome) -> Vec<(String, String)> {
    let record = node.record.as_ref().expect("looked at before");
    let mut out = vec![("name".to_string(), node.name.clone())];
    let axes = node.name.split_once('[').map_or("", |(_, rest)| rest.trim_end_matches(']'));
    out.extend(axes.split(',').filter_map(|a| a.split_once('=')).map(|(k, v)| (k.to_string(), v.to_string())));
    out.push(("bytes".to_string(), (record.bytes + record.blob_bytes).to_string()));
    out.push(("seconds".to_string(), record.seconds.to_string()));
    fn add(name: String, value: &Value, out: &mut Vec<(String, String)>) {
        match value {
            Value::Object(all) => all.iter().for_each(|(k, v)| add(format!("{name}.{k}"), v, out)),
            Value::Array(_) => {}
            plain => out.push((name, cell(plain))),
        }
    }
    record.summary().iter().for_each(|(k, v)| add(k.clone(), v, &mut out));
    out
}
