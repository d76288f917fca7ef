//! Who takes what from whom: ports, kinds, cycles, order.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};

use crate::diag::{Diagnostic, Diagnostics, did_you_mean};
use crate::op::{Entry, PortDecl};
use crate::spec::{Data, Key, Table, Val};

/// A node of the file whose operator has been looked up.
pub struct Draft<'a> {
    pub key: &'a Key,
    pub table: &'a Table,
    /// `None`: unknown operator, said already.
    pub entry: Option<&'static Entry>,
    /// For each port of the operator; of an unknown one, for each port that is given.
    pub wires: Vec<Vec<Wire<'a>>>,
    /// Something about its inputs is wrong: what axes reach it is not known.
    pub vague: bool,
}

/// One name in `in.port`.
pub struct Wire<'a> {
    pub from: usize,
    /// `roof[columns=32]`, where one variant is named.
    pub variant: Option<&'a str>,
    pub value: &'a Val,
}

/// A port's name in pipeline files.
pub fn port_name(port: &PortDecl) -> String {
    port.name.replace('_', "-")
}

/// Reads every node's `in`. Mistakes: unknown ports and nodes, wrong kinds, missing ports.
pub fn connect(drafts: &mut [Draft], wrong: &mut Diagnostics) {
    let index: BTreeMap<&str, usize> = drafts.iter().enumerate().map(|(i, d)| (d.key.name.as_str(), i)).collect();
    for at in 0..drafts.len() {
        let Draft { key, table, entry, .. } = drafts[at];
        let mut found = Vec::new();
        let mut wires = Vec::new();
        let ports = ports_of(table, &mut found);
        let vague = if let Some(entry) = entry {
            wires.resize_with(entry.ports.len(), Vec::new);
            let mut meant: Vec<String> = Vec::new();
            for (name, value) in ports {
                let Some(port) = entry.ports.iter().position(|p| port_name(p) == name.name) else {
                    let d = unknown_port(entry, name);
                    meant.push(d.suggestion.clone().unwrap_or_default());
                    found.push(d);
                    continue;
                };
                wires[port] = names(Some(&entry.ports[port]), name, value, &index, &mut found);
                for wire in &wires[port] {
                    check_kind(&entry.ports[port], &drafts[wire.from], wire, &mut found);
                }
            }
            let is_given = |name: &str| ports.iter().any(|(k, _)| k.name == name);
            let is_meant = |name: &str| meant.iter().any(|m| m.contains(&format!("mean `{name}`")));
            let lacks = |p: &&PortDecl| !p.optional && !is_given(&port_name(p)) && !is_meant(&port_name(p));
            let is_shaped = found.iter().all(|d| d.code != "wrong-type" || !d.message.starts_with("`in` "));
            for port in entry.ports.iter().filter(lacks).filter(|_| is_shaped) {
                let sentence = format!("port `{}` of `{}` is not connected", port_name(port), entry.name);
                let help = format!("it takes {}: add `in.{} = \"..\"`", kinds(port), port_name(port));
                found.push(Diagnostic::error("missing-port", sentence).at(key.span.clone()).help(help));
            }
            !found.is_empty()
        } else {
            wires.extend(ports.iter().map(|(name, value)| names(None, name, value, &index, &mut found)));
            true
        };
        wrong.extend(found.into_iter().map(|d| d.node(&key.name)));
        drafts[at].wires = wires;
        drafts[at].vague = vague;
    }
}

fn ports_of<'a>(table: &'a Table, found: &mut Diagnostics) -> &'a [(Key, Val)] {
    match table.get("in") {
        None => &[],
        Some(Val { data: Data::Table(ports), .. }) => &ports.0,
        Some(other) => {
            let sentence = format!("`in` must be a table of ports, got {}", other.found());
            let d = Diagnostic::error("wrong-type", sentence).at(other.span.clone()).value(other.written());
            found.push(d.help("write `in.port = \"node\"`"));
            &[]
        }
    }
}

fn unknown_port(entry: &Entry, name: &Key) -> Box<Diagnostic> {
    let names: Vec<_> = entry.ports.iter().map(port_name).collect();
    let d = Diagnostic::error("unknown-port", format!("`{}` has no port `{}`", entry.name, name.name));
    let d = d.at(name.span.clone()).value(&name.name);
    match did_you_mean(&name.name, names.iter().map(String::as_str)) {
        near @ Some(_) => d.help_nearest(near),
        None if names.is_empty() => d.help("it takes no inputs"),
        None => {
            d.help(format!("its ports are {}", names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")))
        }
    }
}

/// The nodes that a port names; of an operator that nobody knows, any port may take many.
fn names<'a>(
    port: Option<&PortDecl>,
    key: &Key,
    value: &'a Val,
    index: &BTreeMap<&str, usize>,
    found: &mut Diagnostics,
) -> Vec<Wire<'a>> {
    let (many, optional) = port.map_or((true, true), |p| (p.many, p.optional));
    let list = match &value.data {
        Data::List(list) if many => &list[..],
        Data::List(list) if list.is_empty() && optional => return Vec::new(),
        Data::List(_) => {
            let sentence = format!("port `{}` takes one node, got a list", key.name);
            found.push(Diagnostic::error("wrong-type", sentence).at(value.span.clone()).value(value.written()));
            return Vec::new();
        }
        _ => std::slice::from_ref(value),
    };
    let mut wires: Vec<Wire> = Vec::new();
    for value in list {
        let Some(text) = value.text() else {
            if !value.is_bad() {
                let wanted = if many { "a node's name, or a list of names" } else { "a node's name" };
                let sentence = format!("port `{}` must be {wanted}, got {}", key.name, value.found());
                found.push(Diagnostic::error("wrong-type", sentence).at(value.span.clone()).value(value.written()));
            }
            continue;
        };
        let (base, variant) = match text.find('[') {
            Some(at) => (&text[..at], Some(text)),
            None => (text, None),
        };
        let Some(&from) = index.get(base) else {
            let d = Diagnostic::error("unknown-node", format!("there is no node `{base}`"));
            let d = d.at(value.span.clone()).value(text);
            found.push(if text.contains("${") {
                d.help("`${name}` works in parameters only")
            } else {
                d.help_nearest(did_you_mean(base, index.keys().copied()))
            });
            continue;
        };
        if wires.iter().any(|w| w.from == from && w.variant == variant) {
            let d = Diagnostic::error("same-input", format!("port `{}` takes `{text}` twice", key.name));
            found.push(d.at(value.span.clone()).value(text));
            continue;
        }
        wires.push(Wire { from, variant, value });
    }
    wires
}

fn check_kind(port: &PortDecl, from: &Draft, wire: &Wire, found: &mut Diagnostics) {
    let Some(entry) = from.entry else { return };
    if !port.kinds.contains(&entry.output) {
        let (name, gives) = (&from.key.name, entry.output.name);
        let sentence = format!("`{name}` gives {gives}, port `{}` takes {}", port_name(port), kinds(port));
        found.push(Diagnostic::error("wrong-kind", sentence).at(wire.value.span.clone()).value(name));
    }
}

/// `Footprints`, `Footprints, Hulls or Lines`.
pub fn kinds(port: &PortDecl) -> String {
    let names: Vec<_> = port.kinds.iter().map(|k| k.name).collect();
    match names.split_last() {
        Some((last, [])) => (*last).to_string(),
        Some((last, first)) => format!("{} or {last}", first.join(", ")),
        None => String::new(),
    }
}

/// Inputs before users, file order among equals. Nodes in or behind a cycle come last, as vague.
pub fn order(drafts: &mut [Draft], wrong: &mut Diagnostics) -> Vec<usize> {
    let mut graph = DiGraph::<(), ()>::with_capacity(drafts.len(), drafts.len());
    let nodes: Vec<NodeIndex> = drafts.iter().map(|_| graph.add_node(())).collect();
    for (user, draft) in drafts.iter().enumerate() {
        for wire in draft.wires.iter().flatten() {
            graph.update_edge(nodes[wire.from], nodes[user], ());
        }
    }
    let mut cycles: Vec<Vec<usize>> = tarjan_scc(&graph)
        .into_iter()
        .filter(|part| part.len() > 1 || graph.contains_edge(part[0], part[0]))
        .map(|part| part.into_iter().map(NodeIndex::index).collect())
        .collect();
    cycles.iter_mut().for_each(|c| c.sort_unstable());
    cycles.sort();
    cycles.iter().for_each(|c| wrong.push(cycle(drafts, c)));

    let mut waits: Vec<usize> =
        nodes.iter().map(|&n| graph.neighbors_directed(n, petgraph::Incoming).count()).collect();
    let mut ready: BinaryHeap<_> = (0..drafts.len()).filter(|&i| waits[i] == 0).map(Reverse).collect();
    let mut out = Vec::with_capacity(drafts.len());
    while let Some(Reverse(next)) = ready.pop() {
        out.push(next);
        drafts[next].vague |= drafts[next].wires.iter().flatten().any(|w| drafts[w.from].vague);
        for user in graph.neighbors(nodes[next]) {
            waits[user.index()] -= 1;
            if waits[user.index()] == 0 {
                ready.push(Reverse(user.index()));
            }
        }
    }
    for i in (0..drafts.len()).filter(|&i| waits[i] > 0) {
        drafts[i].vague = true;
        out.push(i);
    }
    out
}

/// A way round through a strongly connected part, from its first node in the file.
fn cycle(drafts: &[Draft], part: &[usize]) -> Box<Diagnostic> {
    let input =
        |of: usize| drafts[of].wires.iter().flatten().find(|w| part.contains(&w.from)).expect("it is in a cycle");
    let mut way = vec![part[0]];
    let start = loop {
        let next = input(way[way.len() - 1]).from;
        if let Some(start) = way.iter().position(|&i| i == next) {
            break start;
        }
        way.push(next);
    };
    let mut way = way.split_off(start);
    let first = way.iter().enumerate().min_by_key(|(_, i)| **i).map_or(0, |(at, _)| at);
    way.rotate_left(first);
    let names: Vec<_> = way.iter().chain(&way[..1]).map(|&i| format!("`{}`", drafts[i].key.name)).collect();
    let sentence = format!("the nodes form a cycle: {}", names.join(" takes "));
    Diagnostic::error("cycle", sentence).at(input(way[0]).value.span.clone()).node(&drafts[way[0]].key.name)
}
