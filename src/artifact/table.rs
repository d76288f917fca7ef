//! Attributes in the making: values come row by row, each column takes the narrowest type that holds them all.

use std::collections::BTreeMap;

use super::attributes::{Attributes, Column, Strings, Values};

/// A value of one cell. Numbers are finite.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell<'a> {
    Bool(bool),
    Number(f64),
    Text(&'a str),
}

/// Columns that grow row by row. Values of mixed types become text; numbers that are all whole and fit become `u32`
/// or `i32`.
#[derive(Debug, Default)]
pub struct Table {
    names: Vec<String>,
    columns: Vec<Growing>,
    index: BTreeMap<String, usize>,
    /// Features of one file mostly have the same keys in the same order.
    next: usize,
}

#[derive(Debug, Default)]
struct Growing {
    present: Vec<bool>,
    cells: Cells,
}

#[derive(Debug, Default)]
enum Cells {
    #[default]
    None,
    Bools(Vec<bool>),
    Numbers(Vec<f64>),
    Text(Strings),
}

impl Table {
    /// The column of that name.
    #[inline]
    pub fn column(&mut self, name: &str) -> usize {
        let guess = if self.next < self.names.len() { self.next } else { 0 };
        let found = if self.names.get(guess).is_some_and(|n| n == name) {
            guess
        } else if let Some(&i) = self.index.get(name) {
            i
        } else {
            self.names.push(name.to_string());
            self.columns.push(Growing::default());
            self.index.insert(name.to_string(), self.names.len() - 1);
            self.names.len() - 1
        };
        self.next = found + 1;
        found
    }

    /// Every name that was ever asked for, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.index.keys().map(String::as_str)
    }

    /// Rows rise. Of two values for one cell the first stays.
    pub fn set(&mut self, row: usize, column: usize, cell: Cell) {
        let c = &mut self.columns[column];
        if c.present.len() > row {
            return;
        }
        c.pad(row);
        c.present.push(true);
        match (&mut c.cells, cell) {
            (Cells::Bools(v), Cell::Bool(b)) => v.push(b),
            (Cells::Numbers(v), Cell::Number(x)) => v.push(x),
            (Cells::Text(v), Cell::Text(t)) => v.push(t),
            (cells @ Cells::None, cell) => {
                *cells = match cell {
                    Cell::Bool(b) => Cells::Bools([vec![false; row], vec![b]].concat()),
                    Cell::Number(x) => Cells::Numbers([vec![0.0; row], vec![x]].concat()),
                    Cell::Text(t) => {
                        let mut v: Strings = std::iter::repeat_n("", row).collect();
                        v.push(t);
                        Cells::Text(v)
                    }
                }
            }
            (cells, cell) => {
                let mut text = cells.as_text(&c.present[..row]);
                match cell {
                    Cell::Bool(b) => text.push(&b.to_string()),
                    Cell::Number(x) => text.push(&x.to_string()),
                    Cell::Text(t) => text.push(t),
                }
                *cells = Cells::Text(text);
            }
        }
    }

    /// The table of `rows` features; columns without any value are left out.
    pub fn finish(mut self, rows: usize) -> Attributes {
        let mut columns = Vec::new();
        for (name, i) in std::mem::take(&mut self.index) {
            let mut c = std::mem::take(&mut self.columns[i]);
            c.pad(rows);
            let values = match c.cells {
                Cells::None => continue,
                Cells::Bools(v) => Values::Bool(v),
                Cells::Text(v) => Values::Text(v),
                Cells::Numbers(v) => narrow(v),
            };
            columns.push(Column { name, values, present: c.present });
        }
        Attributes { columns }
    }
}

impl Growing {
    fn pad(&mut self, rows: usize) {
        self.present.resize(rows, false);
        match &mut self.cells {
            Cells::None => {}
            Cells::Bools(v) => v.resize(rows, false),
            Cells::Numbers(v) => v.resize(rows, 0.0),
            Cells::Text(v) => (v.len()..rows).for_each(|_| v.push("")),
        }
    }
}

impl Cells {
    fn as_text(&self, present: &[bool]) -> Strings {
        let gaps = present.iter().enumerate();
        match self {
            Self::None => Strings::default(),
            Self::Bools(v) => gaps.map(|(i, &p)| if p { v[i].to_string() } else { String::new() }).collect(),
            Self::Numbers(v) => gaps.map(|(i, &p)| if p { v[i].to_string() } else { String::new() }).collect(),
            Self::Text(v) => v.clone(),
        }
    }
}

fn narrow(v: Vec<f64>) -> Values {
    let whole = v.iter().all(|x| x.fract() == 0.0);
    let (low, high) = v.iter().fold((0.0f64, 0.0f64), |(l, h), &x| (l.min(x), h.max(x)));
    if whole && low >= 0.0 && high <= f64::from(u32::MAX) {
        Values::U32(v.iter().map(|&x| x as u32).collect())
    } else if whole && low >= f64::from(i32::MIN) && high <= f64::from(i32::MAX) {
        Values::I32(v.iter().map(|&x| x as i32).collect())
    } else {
        Values::F64(v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(rows: &[&[(&str, Cell)]]) -> Attributes {
        let mut t = Table::default();
        for (row, cells) in rows.iter().enumerate() {
            for (name, cell) in *cells {
                let c = t.column(name);
                t.set(row, c, cell.clone());
            }
        }
        t.finish(rows.len())
    }

    #[test]
    fn narrowest_types() {
        use Cell::*;
        let a = filled(&[
            &[("b", Number(1.0)), ("a", Number(-1.0)), ("f", Number(0.5))],
            &[("t", Text("x")), ("flag", Bool(true))],
            &[("b", Number(4294967295.0)), ("t", Number(2.5)), ("flag", Bool(false)), ("b", Number(7.0))],
            &[("f", Bool(true))],
        ]);
        let names: Vec<&str> = a.columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "f", "flag", "t"]);
        assert_eq!(a.columns[0].values, Values::I32(vec![-1, 0, 0, 0]));
        assert_eq!(a.columns[1].values, Values::U32(vec![1, 0, 4294967295, 0]));
        assert_eq!(a.columns[2].values, Values::Text(["0.5", "", "", "true"].iter().collect()));
        assert_eq!(a.columns[3].values, Values::Bool(vec![false, true, false, false]));
        assert_eq!(a.columns[4].values, Values::Text(["", "x", "2.5", ""].iter().collect()));
        assert_eq!(a.columns[4].present, [false, true, true, false]);
        assert!(a.columns.iter().all(|c| c.values.len() == 4 && c.present.len() == 4));
    }

    #[test]
    fn a_column_without_values_is_none() {
        let mut t = Table::default();
        t.column("a");
        assert_eq!(t.names().collect::<Vec<_>>(), ["a"]);
        assert_eq!(t.finish(3), Attributes::default());
    }
}
