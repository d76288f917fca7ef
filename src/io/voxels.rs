//! Voxels for other programs: a NumPy array of black nodes, and what stands beside it as JSON.
//!
//! Source: NumPy's `numpy.lib.format`, version 1.0.

use serde_json::{Value, json};

use crate::artifact::voxels::{STEPS, stick_of};
use crate::artifact::{Artifact, Voxels};
use crate::diag::Result;

/// A `.npy` of booleans, true is black: `a[x, y, z]`, each axis as long as the grid has nodes. In the file x runs fastest
/// (Fortran's order, which NumPy hides).
pub fn npy(of: &Voxels) -> Result<Vec<u8>> {
    let side = of.lattice.side();
    let head = format!("{{'descr': '|b1', 'fortran_order': True, 'shape': ({side}, {side}, {side}), }}");
    // Ten bytes before it; data begin at a multiple of 64, after a line's end.
    let length = (10 + head.len() + 1).next_multiple_of(64) - 10;
    let mut out = Vec::with_capacity(10 + length + side * side * side);
    out.extend_from_slice(b"\x93NUMPY\x01\x00");
    out.extend_from_slice(&(length as u16).to_le_bytes());
    out.extend_from_slice(head.as_bytes());
    out.resize(10 + length - 1, b' ');
    out.push(b'\n');
    for (z, y) in (0..side).flat_map(|z| (0..side).map(move |y| (z, y))) {
        let row = of.row(y, z);
        out.extend((0..side).map(|x| (row[x / 64] >> (x % 64) & 1) as u8));
    }
    Ok(out)
}

/// The summary, and the membrane's sticks as numbers of nodes, black then white. Node i, j, k stands at
/// `origin_m` + `cell_m` (i, j, k): metres, z up.
pub fn json(of: &Voxels) -> Result<Vec<u8>> {
    let stick = |&number: &u64| {
        let (black, direction) = stick_of(number);
        let black = black.map(i32::from);
        let step = STEPS[usize::from(direction)];
        let white: [i32; 3] = std::array::from_fn(|k| black[k] + step[k]);
        json!([black, white])
    };
    let mut out = of.summary();
    out.insert("membrane".into(), Value::Array(of.membrane.iter().map(stick).collect()));
    Ok(Value::Object(out).to_string().into_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::voxels::stick_number;
    use crate::geom::frame::Frame;
    use crate::geom::lattice::Lattice;

    #[test]
    fn an_array_as_numpy_reads_it() {
        let mut of = Voxels::new(Frame::local(), Lattice { cells: 69, origin: [1.0, 2.0, 3.0], cell: 0.5 });
        let black = [[0, 0, 0], [69, 1, 2], [64, 69, 69], [3, 5, 7]];
        black.iter().for_each(|&p| of.set(p));
        of.membrane = vec![stick_number([3, 5, 7], 5)];
        let bytes = npy(&of).unwrap();
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!((10 + length) % 64, 0);
        let head = std::str::from_utf8(&bytes[10..10 + length]).unwrap();
        assert!(
            head.starts_with("{'descr': '|b1', 'fortran_order': True, 'shape': (70, 70, 70), }")
                && head.ends_with('\n')
        );
        let data = &bytes[10 + length..];
        assert_eq!(data.len(), 70 * 70 * 70);
        let mut found: Vec<[usize; 3]> =
            (0..data.len()).filter(|&i| data[i] == 1).map(|i| [i % 70, i / 70 % 70, i / 4900]).collect();
        let mut want = black.to_vec();
        found.sort();
        want.sort();
        assert_eq!(found, want);
        assert!(data.iter().all(|&b| b < 2));

        let value: Value = serde_json::from_slice(&json(&of).unwrap()).unwrap();
        assert_eq!((&value["nodes"], &value["cell_m"]), (&json!(70), &json!(0.5)));
        assert_eq!((&value["origin_m"], &value["black"]), (&json!([1.0, 2.0, 3.0]), &json!(4)));
        assert_eq!(value["membrane"], json!([[[3, 5, 7], [3, 5, 6]]]));
    }
}
