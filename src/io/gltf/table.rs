//! A table of features as EXT_structural_metadata: a class that says what each property is, and its values.
//!
//! Types are those of the columns: UINT32, INT32, FLOAT64, BOOLEAN, STRING. Our own properties are required. Those of
//! the source have a `noData`, a value that no feature of the file has, which stands in gaps. Booleans can have none,
//! so with gaps they become the strings `true` and `false`. A column that no feature has is left out: nothing in a
//! file depends on what others hold.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use super::Builder;
use crate::artifact::{Column, Strings, Values};

/// The name of the one class, in files and in their tables.
const CLASS: &str = "feature";

/// Appends the columns' bytes and gives the extension's object; none without features or columns.
pub fn write(file: &mut Builder, features: usize, own: &[Column], attributes: &[Column]) -> Option<Value> {
    if features == 0 {
        return None;
    }
    let (mut class, mut values) = (Map::new(), Map::new());
    let mut taken = BTreeSet::new();
    let named = |c: &&Column| c.present.contains(&true);
    let all = own.iter().map(|c| (c, true)).chain(attributes.iter().filter(named).map(|c| (c, false)));
    for (column, required) in all {
        let key = key(&column.name, &mut taken);
        let (mut property, cells) = match &column.values {
            Values::Bool(v) if column.present.contains(&false) => {
                let text = Values::Text(v.iter().map(|b| if *b { "true" } else { "false" }).collect());
                put(file, &text, &column.present, required)
            }
            all => put(file, all, &column.present, required),
        };
        if key != column.name {
            property["name"] = json!(column.name);
        }
        class.insert(key.clone(), property);
        values.insert(key, cells);
    }
    if class.is_empty() {
        return None;
    }
    Some(json!({
        "schema": { "id": "lodge", "classes": { CLASS: { "properties": class } } },
        "propertyTables": [{ "class": CLASS, "count": features, "properties": values }],
    }))
}

/// A property's description and its values' buffer views.
fn put(file: &mut Builder, values: &Values, present: &[bool], whole: bool) -> (Value, Value) {
    match values {
        Values::U32(v) => {
            let free = (!whole).then(|| (0..=u32::MAX).rev().find(|x| !has(v, present, x)).unwrap_or(0));
            (number("UINT32", free.map(|x| json!(x))), cells(file, v, present, free, |x| x.to_le_bytes()))
        }
        Values::I32(v) => {
            let free = (!whole).then(|| (i32::MIN..=i32::MAX).find(|x| !has(v, present, x)).unwrap_or(0));
            (number("INT32", free.map(|x| json!(x))), cells(file, v, present, free, |x| x.to_le_bytes()))
        }
        Values::F64(v) => {
            let mut free = (!whole).then_some(f64::MIN);
            while free.is_some_and(|x| has(v, present, &x)) {
                free = free.map(f64::next_up);
            }
            (number("FLOAT64", free.map(|x| json!(x))), cells(file, v, present, free, |x| x.to_le_bytes()))
        }
        Values::Bool(v) => {
            let bits = v.chunks(8).map(|c| c.iter().enumerate().fold(0, |b, (i, &x)| b | u8::from(x) << i));
            let view = file.view(&[], bits.collect::<Vec<u8>>());
            (json!({ "type": "BOOLEAN", "required": true }), json!({ "values": view }))
        }
        Values::Text(v) => text(file, v, present, whole),
    }
}

fn has<T: PartialEq>(values: &[T], present: &[bool], x: &T) -> bool {
    values.iter().zip(present).any(|(v, p)| *p && v == x)
}

fn number(component: &str, free: Option<Value>) -> Value {
    match free {
        Some(free) => json!({ "type": "SCALAR", "componentType": component, "noData": free }),
        None => json!({ "type": "SCALAR", "componentType": component, "required": true }),
    }
}

fn cells<T: Copy, const N: usize>(
    file: &mut Builder,
    values: &[T],
    present: &[bool],
    free: Option<T>,
    bytes: impl Fn(T) -> [u8; N],
) -> Value {
    let mut all = Vec::with_capacity(N * values.len());
    for (&v, &p) in values.iter().zip(present) {
        all.extend_from_slice(&bytes(if p { v } else { free.unwrap_or(v) }));
    }
    let view = file.view(&[], all);
    json!({ "values": view })
}

fn text(file: &mut Builder, values: &Strings, present: &[bool], whole: bool) -> (Value, Value) {
    let mut free = String::new();
    while !whole && values.iter().zip(present).any(|(v, p)| *p && v == free) {
        free.push('-');
    }
    let (mut all, mut ends) = (Vec::new(), vec![0]);
    for (i, &p) in present.iter().enumerate() {
        all.extend_from_slice(if p { values.get(i) } else { &free }.as_bytes());
        ends.push(all.len() as u32);
    }
    // Offsets in the narrowest type.
    let (kind, ends): (&str, Vec<u8>) = match all.len() {
        0..=0xff => ("UINT8", ends.iter().map(|&e| e as u8).collect()),
        0x100..=0xffff => ("UINT16", ends.iter().flat_map(|&e| (e as u16).to_le_bytes()).collect()),
        _ => ("UINT32", ends.iter().flat_map(|e| e.to_le_bytes()).collect()),
    };
    // A view of no bytes is no view: a lone zero stands in where all strings are empty.
    if all.is_empty() {
        all.push(0);
    }
    let view = file.view(&[], all);
    let offsets = file.view(&[], ends);
    let property = match whole {
        true => json!({ "type": "STRING", "required": true }),
        false => json!({ "type": "STRING", "noData": free }),
    };
    (property, json!({ "values": view, "stringOffsets": offsets, "stringOffsetType": kind }))
}

/// A property's key: letters, digits and `_` of its name, not a digit first, and not one that is taken.
fn key(name: &str, taken: &mut BTreeSet<String>) -> String {
    let mut key: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !key.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
        key.insert(0, '_');
    }
    while !taken.insert(key.clone()) {
        key.push('_');
    }
    key
}
