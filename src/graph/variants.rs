//! `matrix` and `variants`: what variants a node has of its own, and how those of its inputs meet.

use super::wires::Draft;
use crate::diag::{Diagnostic, Diagnostics};
use crate::spec::{Data, Key, Scope, Table, Val};

/// A value of an axis; the axis belongs to the node that declares it.
#[derive(Clone, Debug)]
pub struct Axis {
    pub owner: usize,
    pub name: String,
    pub value: Val,
}

impl Axis {
    fn label(&self) -> String {
        self.value.data.label()
    }
}

/// One combination: the axes, and for each port the instances it takes.
#[derive(Clone, Debug, Default)]
pub struct Combination {
    pub axes: Vec<Axis>,
    pub inputs: Vec<Vec<usize>>,
}

/// More variants of one node than this are a mistake rather than a wish.
const MOST: usize = 10_000;

/// The assignments that `matrix` and `variants` make, in order; one empty one without them.
pub fn own(me: usize, draft: &Draft, scope: &Scope, wrong: &mut Diagnostics) -> Vec<Vec<Axis>> {
    let mut out: Vec<Vec<Axis>> = vec![Vec::new()];
    for (key, values) in matrix(draft.table, scope, wrong) {
        check_axis(key, draft.table, scope, wrong);
        let values: Vec<_> = values.into_iter().map(|v| vec![axis(me, key, v)]).collect();
        out = times(&out, &values, key, wrong);
    }
    if let Some((key, value)) = draft.table.entry("variants") {
        let rows = variants(me, draft.table, value, scope, wrong);
        if !rows.is_empty() {
            out = times(&out, &rows, key, wrong);
        }
    }
    out
}

fn axis(owner: usize, key: &Key, value: Val) -> Axis {
    Axis { owner, name: key.name.clone(), value }
}

fn times(left: &[Vec<Axis>], right: &[Vec<Axis>], key: &Key, wrong: &mut Diagnostics) -> Vec<Vec<Axis>> {
    if left.len() * right.len() > MOST {
        wrong.push(too_many(key, left.len() * right.len()));
        return left.to_vec();
    }
    left.iter().flat_map(|l| right.iter().map(move |r| l.iter().chain(r).cloned().collect())).collect()
}

fn too_many(key: &Key, n: usize) -> Box<Diagnostic> {
    let d = Diagnostic::error("too-many-variants", format!("{n} variants of one node; at most {MOST} are possible"));
    d.at(key.span.clone())
}

/// The keys of `matrix`, each with its values; where something is wrong with those, a stand-in.
fn matrix<'a>(table: &'a Table, scope: &Scope, wrong: &mut Diagnostics) -> Vec<(&'a Key, Vec<Val>)> {
    let Some(value) = table.get("matrix") else { return Vec::new() };
    let Some(keys) = value.table() else {
        let sentence = format!("`matrix` must be a table of lists, got {}", value.found());
        let d = Diagnostic::error("wrong-type", sentence).at(value.span.clone()).value(value.written());
        wrong.push(d.help("write `matrix.parameter = [..]`"));
        return Vec::new();
    };
    let mut out = Vec::new();
    for (key, value) in keys.iter() {
        let filled = scope.fill(value, wrong);
        let mut values: Vec<Val> = Vec::new();
        match &filled.data {
            Data::List(list) if list.is_empty() => {
                let d = Diagnostic::error("empty-matrix", format!("`matrix.{}` has no values", key.name));
                wrong.push(d.at(value.span.clone()).value("[]"));
            }
            Data::List(list) => {
                for v in list {
                    if !is_scalar(v) {
                        wrong.push(not_scalar(&key.name, v));
                    } else if values.iter().any(|w| w.data.label() == v.data.label() && !v.is_bad()) {
                        let sentence = format!("`matrix.{}` has {} twice", key.name, v.data.label());
                        let d = Diagnostic::error("equal-values", sentence).at(v.span.clone()).value(v.written());
                        wrong.push(same_number(d, [v]));
                    } else {
                        values.push(v.clone());
                    }
                }
            }
            Data::Bad => {}
            _ => {
                let sentence = format!("`matrix.{}` must be a list of values, got {}", key.name, filled.found());
                wrong.push(Diagnostic::error("wrong-type", sentence).at(filled.span.clone()).value(filled.written()));
            }
        }
        if values.is_empty() {
            values.push(Val { data: Data::Bad, ..value.clone() });
        }
        out.push((key, values));
    }
    out
}

/// The entries of `variants`: tables with the same keys.
fn variants(me: usize, table: &Table, value: &Val, scope: &Scope, wrong: &mut Diagnostics) -> Vec<Vec<Axis>> {
    let mut say = |code, sentence: String, v: &Val| {
        wrong.push(Diagnostic::error(code, sentence).at(v.span.clone()).value(v.written()));
    };
    let list = match value.list() {
        Some([]) => {
            say("empty-matrix", "`variants` has no entries".into(), value);
            return Vec::new();
        }
        Some(list) => list,
        None => {
            say("wrong-type", format!("`variants` must be a list of tables, got {}", value.found()), value);
            return Vec::new();
        }
    };
    let Some(first) = list[0].table().filter(|t| !t.0.is_empty()) else {
        say("wrong-type", "an entry of `variants` must be a table with at least one parameter".into(), &list[0]);
        return Vec::new();
    };
    for (key, _) in first.iter() {
        check_axis(key, table, scope, wrong);
        if table.get("matrix").and_then(Val::table).is_some_and(|m| m.get(&key.name).is_some()) {
            let sentence = format!("`{}` is given both in `matrix` and in `variants`", key.name);
            wrong.push(Diagnostic::error("given-twice", sentence).at(key.span.clone()).value(&key.name));
        }
    }
    let mut rows: Vec<Vec<Axis>> = Vec::new();
    let mut labels: Vec<Vec<String>> = Vec::new();
    for entry in list {
        let mut say = |code, sentence: String| {
            wrong.push(Diagnostic::error(code, sentence).at(entry.span.clone()).value(entry.written()));
        };
        let Some(keys) = entry.table() else {
            say("wrong-type", format!("an entry of `variants` must be a table, got {}", entry.found()));
            continue;
        };
        if let Some((key, _)) = keys.iter().find(|(k, _)| first.get(&k.name).is_none()) {
            say("uneven-variants", format!("this entry of `variants` has `{}`, the first has not", key.name));
        }
        let mut row = Vec::new();
        for (key, _) in first.iter() {
            match keys.get(&key.name).map(|v| scope.fill(v, wrong)) {
                Some(v) if is_scalar(&v) => row.push(axis(me, key, v)),
                Some(v) => wrong.push(not_scalar(&key.name, &v)),
                None => {
                    let sentence = format!("this entry of `variants` lacks `{}`, which the first has", key.name);
                    let d = Diagnostic::error("uneven-variants", sentence);
                    wrong.push(d.at(entry.span.clone()).value(entry.written()));
                }
            }
        }
        let label: Vec<_> = row.iter().map(Axis::label).collect();
        if labels.contains(&label) {
            let d = Diagnostic::error("equal-values", "this entry of `variants` stands there twice");
            let d = d.at(entry.span.clone()).value(entry.written());
            wrong.push(same_number(d, row.iter().map(|axis| &axis.value)));
        } else if row.len() == first.0.len() {
            labels.push(label);
            rows.push(row);
        }
    }
    if rows.is_empty() {
        let bad = |(key, v): &(Key, Val)| axis(me, key, Val { data: Data::Bad, ..v.clone() });
        rows.push(first.iter().map(bad).collect());
    }
    rows
}

fn is_scalar(v: &Val) -> bool {
    !matches!(v.data, Data::List(_) | Data::Table(_) | Data::Date(_))
}

fn not_scalar(name: &str, v: &Val) -> Box<Diagnostic> {
    let sentence = format!("a variant's `{name}` must be a number, a text, or true or false; got {}", v.found());
    Diagnostic::error("wrong-type", sentence).at(v.span.clone()).value(v.written())
}

/// An axis is neither a plain key of the node nor a param.
fn check_axis(key: &Key, table: &Table, scope: &Scope, wrong: &mut Diagnostics) {
    if let Some((plain, _)) = table.entry(&key.name) {
        let sentence = format!("`{}` is given both plainly and as an axis of variants", key.name);
        wrong.push(Diagnostic::error("given-twice", sentence).at(plain.span.clone()).value(&key.name));
    }
    if scope.params.get(&key.name).is_some() {
        let sentence = format!("`{}` is both a param and an axis of variants", key.name);
        let d = Diagnostic::error("param-and-axis", sentence).at(key.span.clone()).value(&key.name);
        wrong.push(d.help("rename the param"));
    }
}

/// What a node's inputs give it: every combination in which shared axes agree. `instances` are those of each draft,
/// with their axes and names; a port that takes many gets all of them and passes no axes on, nor does a named variant,
/// nor any port of an unknown operator.
pub fn meet(
    draft: &Draft,
    instances: &[Vec<usize>],
    axes: &[Vec<Axis>],
    names: &[String],
    wrong: &mut Diagnostics,
) -> Vec<Combination> {
    let ports = draft.entry.map_or(&[][..], |e| e.ports);
    let mut out = vec![Combination::default()];
    for (port, wires) in draft.wires.iter().enumerate() {
        let many = ports.get(port).is_none_or(|p| p.many);
        let mut fixed = Vec::new();
        let mut free: Option<&[usize]> = None;
        for wire in wires {
            let all = &instances[wire.from];
            match wire.variant {
                Some(name) => match all.iter().find(|&&i| names[i] == name) {
                    Some(&one) => fixed.push(one),
                    None if all.is_empty() => {} // in a cycle, or its own variants are wrong: that is told
                    None => wrong.push(unknown_variant(name, wire.value, all, names).node(&draft.key.name)),
                },
                None if many || all.is_empty() || axes[all[0]].is_empty() => fixed.extend(all),
                None => free = Some(all),
            }
        }
        let Some(free) = free else {
            out.iter_mut().for_each(|c| c.inputs.push(fixed.clone()));
            continue;
        };
        let mut next = Vec::new();
        for c in &out {
            for &one in free {
                if next.len() > MOST {
                    break;
                }
                if agree(&c.axes, &axes[one]) {
                    let mut c = c.clone();
                    let new =
                        axes[one].iter().filter(|a| c.axes.iter().all(|b| b.owner != a.owner || b.name != a.name));
                    let new: Vec<_> = new.cloned().collect();
                    c.axes.extend(new);
                    c.inputs.push(vec![one]);
                    next.push(c);
                }
            }
        }
        if next.len() > MOST {
            wrong.push(too_many(draft.key, next.len()).node(&draft.key.name));
            next.truncate(1);
        }
        out = next;
    }
    out
}

fn agree(left: &[Axis], right: &[Axis]) -> bool {
    right.iter().all(|r| left.iter().all(|l| l.owner != r.owner || l.name != r.name || l.label() == r.label()))
}

/// Of two equal numbers one may not see that they are.
fn same_number<'a>(d: Box<Diagnostic>, values: impl IntoIterator<Item = &'a Val>) -> Box<Diagnostic> {
    let is_number = |v: &Val| matches!(v.data, Data::Int(_) | Data::Float(_));
    if values.into_iter().any(is_number) { d.help("1 and 1.0 are the same number") } else { d }
}

fn unknown_variant(name: &str, value: &Val, all: &[usize], names: &[String]) -> Box<Diagnostic> {
    let d =
        Diagnostic::error("unknown-node", format!("there is no variant `{name}`")).at(value.span.clone()).value(name);
    let near = crate::diag::did_you_mean(name, all.iter().map(|&i| names[i].as_str()));
    match near {
        Some(_) => d.help_nearest(near),
        None => {
            let first: Vec<_> = all.iter().take(3).map(|&i| format!("`{}`", names[i])).collect();
            d.help(format!(
                "there {} {}{}",
                if all.len() == 1 { "is" } else { "are" },
                first.join(", "),
                if all.len() > 3 { ", .." } else { "" }
            ))
        }
    }
}

/// A node's own assignments times what meets at its inputs, a mistake where two axes have one name.
pub fn combine(
    draft: &Draft,
    inputs: Vec<Combination>,
    own: &[Vec<Axis>],
    owner_name: impl Fn(usize) -> String,
    wrong: &mut Diagnostics,
) -> Vec<Combination> {
    if let (Some(first), Some(mine)) = (inputs.first(), own.first()) {
        let all: Vec<_> = first.axes.iter().chain(mine).collect();
        for (i, a) in all.iter().enumerate() {
            if let Some(b) = all[..i].iter().find(|b| b.name == a.name && b.owner != a.owner) {
                let (x, y) = (owner_name(b.owner), owner_name(a.owner));
                let sentence = format!("two axes `{}` meet here, one of `{x}` and one of `{y}`", a.name);
                let d = Diagnostic::error("same-axis", sentence).at(draft.key.span.clone()).value(&a.name);
                wrong.push(d.node(&draft.key.name).help("name one variant, or give one of the two plainly"));
            }
        }
    }
    if inputs.len() * own.len() > MOST {
        wrong.push(too_many(draft.key, inputs.len() * own.len()).node(&draft.key.name));
        return inputs.into_iter().take(1).collect();
    }
    let both = |c: &Combination, mine: &Vec<Axis>| {
        let axes = c.axes.iter().chain(mine).cloned().collect();
        Combination { axes, inputs: c.inputs.clone() }
    };
    inputs.iter().flat_map(|c| own.iter().map(move |mine| both(c, mine))).collect()
}

/// `roof[columns=32,morph=0]`, keys sorted.
pub fn name(base: &str, axes: &[Axis]) -> String {
    if axes.is_empty() {
        return base.to_string();
    }
    let mut sorted: Vec<_> = axes.iter().collect();
    sorted.sort_by(|a, b| a.name.cmp(&b.name));
    let parts: Vec<_> = sorted.into_iter().map(|a| format!("{}={}", a.name, a.label())).collect();
    format!("{base}[{}]", parts.join(","))
}
