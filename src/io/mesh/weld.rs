//! Equal vertices become one.

/// Numbers keys by their first appearance: (number of each, place of the first of each number).
pub fn weld<K: Ord + Copy + Sync>(keys: &[K]) -> (Vec<u32>, Vec<u32>) {
    use rayon::prelude::*;
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    order.par_sort_unstable_by_key(|&i| (keys[i as usize], i));
    // Each to the first of its kind.
    let mut first = vec![0u32; keys.len()];
    let mut head = 0;
    for (n, &i) in order.iter().enumerate() {
        if n == 0 || keys[order[n - 1] as usize] != keys[i as usize] {
            head = i;
        }
        first[i as usize] = head;
    }
    let mut firsts = Vec::new();
    let mut number = vec![0u32; keys.len()];
    for i in 0..keys.len() {
        if first[i] as usize == i {
            number[i] = firsts.len() as u32;
            firsts.push(i as u32);
        } else {
            number[i] = number[first[i] as usize];
        }
    }
    (number, firsts)
}

/// Triangles that say nothing new: the same material and corners, the same way round, as `most` earlier ones. `corners`
/// are numbers of what a viewer cannot tell apart.
pub fn repeated(corners: &[[u32; 3]], material: impl Fn(usize) -> u32, most: u32) -> Vec<bool> {
    let keys: Vec<[u32; 4]> = corners
        .iter()
        .enumerate()
        .map(|(t, &[a, b, c])| {
            let [a, b, c] = if a <= b && a <= c {
                [a, b, c]
            } else if b <= c {
                [b, c, a]
            } else {
                [c, a, b]
            };
            [material(t), a, b, c]
        })
        .collect();
    let (number, firsts) = weld(&keys);
    let mut count = vec![0u32; firsts.len()];
    let again = |&n: &u32| {
        count[n as usize] += 1;
        count[n as usize] > most
    };
    number.iter().map(again).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn by_first_appearance() {
        assert_eq!(super::weld(&[7, 3, 7, 9, 3]), (vec![0, 1, 0, 2, 1], vec![0, 1, 3]));
        assert_eq!(super::weld::<u8>(&[]), (vec![], vec![]));
        let all = [[1, 2, 3], [3, 1, 2], [3, 2, 1], [1, 2, 3], [2, 3, 1]];
        assert_eq!(super::repeated(&all, |t| t as u32 / 3, 1), [false, true, false, false, true]);
    }
}
