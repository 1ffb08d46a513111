//! Fill-reducing elimination order by coordinates (George, SIAM Journal on Numerical Analysis 10, 1973): halve the
//! largest extent, eliminate the halves first and their separator last, and recurse within each half.

/// Maximum size of a part that is not divided further, in unknowns.
const LEAF: usize = 8;

/// Nested dissection: forward and inverse permutation (new to old, old to new).
pub(super) fn dissect(
    coordinates: &[[f64; 3]],
    last: &[u32],
    column_start: &[u32],
    rows: &[u32],
) -> (Vec<u32>, Vec<u32>) {
    let size = coordinates.len();
    let adjacency = Adjacency::new(size, column_start, rows);
    let mut side = vec![0_u8; size];
    let mut order = Vec::with_capacity(size);
    let mut is_last = vec![false; size];
    last.iter().for_each(|&unknown| is_last[unknown as usize] = true);
    let mut nodes: Vec<u32> = (0..size as u32).filter(|&node| !is_last[node as usize]).collect();
    split(&mut nodes, coordinates, &adjacency, &mut side, &mut order);
    for &unknown in last {
        if std::mem::take(&mut is_last[unknown as usize]) {
            order.push(unknown);
        }
    }
    let mut inverse = vec![0_u32; size];
    for (new, &old) in order.iter().enumerate() {
        inverse[old as usize] = new as u32;
    }
    (order, inverse)
}

struct Adjacency {
    start: Vec<u32>,
    others: Vec<u32>,
}

impl Adjacency {
    fn new(size: usize, column_start: &[u32], rows: &[u32]) -> Self {
        let pairs = || {
            (0..size).flat_map(|column| {
                let range = column_start[column] as usize..column_start[column + 1] as usize;
                rows[range].iter().map(move |&row| (column as u32, row)).filter(|pair| pair.0 != pair.1)
            })
        };
        let mut start = vec![0_u32; size + 1];
        for (a, b) in pairs() {
            start[a as usize + 1] += 1;
            start[b as usize + 1] += 1;
        }
        for node in 0..size {
            start[node + 1] += start[node];
        }
        let mut fill = start.clone();
        let mut others = vec![0_u32; start[size] as usize];
        for (a, b) in pairs() {
            for (from, to) in [(a, b), (b, a)] {
                others[fill[from as usize] as usize] = to;
                fill[from as usize] += 1;
            }
        }
        Self { start, others }
    }

    fn of(&self, node: u32) -> &[u32] {
        &self.others[self.start[node as usize] as usize..self.start[node as usize + 1] as usize]
    }
}

fn split(nodes: &mut [u32], xyz: &[[f64; 3]], adjacency: &Adjacency, side: &mut [u8], order: &mut Vec<u32>) {
    if nodes.len() <= LEAF {
        order.extend_from_slice(nodes);
        return;
    }
    let extent = |axis: usize| {
        let values = nodes.iter().map(|&node| xyz[node as usize][axis]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    let extents = [extent(0), extent(1), extent(2)];
    let axis = (0..3).max_by(|&a, &b| extents[a].total_cmp(&extents[b])).unwrap_or(0);
    let middle = nodes.len() / 2;
    nodes.select_nth_unstable_by(middle, |&a, &b| {
        xyz[a as usize][axis].total_cmp(&xyz[b as usize][axis]).then(a.cmp(&b))
    });
    for (position, &node) in nodes.iter().enumerate() {
        side[node as usize] = if position < middle { 1 } else { 2 };
    }
    // The separator: nodes of the left half with neighbours in the right half.
    let mut left = Vec::with_capacity(middle);
    let mut separator = Vec::new();
    for &node in &nodes[..middle] {
        if adjacency.of(node).iter().any(|&other| side[other as usize] == 2) {
            separator.push(node);
        } else {
            left.push(node);
        }
    }
    let mut right = nodes[middle..].to_vec();
    for &node in nodes.iter() {
        side[node as usize] = 0;
    }
    if left.is_empty() {
        order.extend_from_slice(&right);
        order.extend_from_slice(&separator);
        return;
    }
    split(&mut left, xyz, adjacency, side, order);
    split(&mut right, xyz, adjacency, side, order);
    order.extend_from_slice(&separator);
}
