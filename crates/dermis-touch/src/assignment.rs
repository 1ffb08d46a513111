//! The cheapest one-to-one assignment of rows to columns, by shortest augmenting paths with potentials.
//!
//! The method of Kuhn and Munkres in the form of Jonker and Volgenant (Computing 38 (1987) 325), O(rows^2 columns). A
//! row may also stay unassigned at a given cost, so infeasible pairs need no finite stand-in beyond that cost.

/// Cost of a pair that must not be formed.
pub(crate) const FORBIDDEN: f64 = f64::INFINITY;

/// Working memory of the solver.
#[derive(Debug, Clone, Default)]
pub(crate) struct Assignment {
    row_potential: Vec<f64>,
    column_potential: Vec<f64>,
    /// Row (counted from 1) that holds each column (counted from 1); 0 = free. Column 0 holds the row being placed.
    holder: Vec<usize>,
    came_from: Vec<usize>,
    shortest: Vec<f64>,
    visited: Vec<bool>,
    /// Column of each row, or `None`.
    result: Vec<Option<usize>>,
}

impl Assignment {
    /// Assigns each of `rows` to one of `columns`, or to none, at the least total cost.
    ///
    /// `cost` gives the cost of a pair. Return [`FORBIDDEN`], or any value at or above `alone`, for pairs that must
    /// not be formed. `alone` is the cost of leaving a row unassigned, finite and not negative. Ties are broken the
    /// same way every time.
    pub(crate) fn solve(
        &mut self,
        rows: usize,
        columns: usize,
        alone: f64,
        cost: impl Fn(usize, usize) -> f64,
    ) -> &[Option<usize>] {
        // Every row also gets a private column that costs `alone`. All other forbidden pairs cost `barred`, which no
        // optimal solution pays because the private column is always free.
        let total = columns + rows;
        let barred = (alone + 1.0) * (rows as f64 + 1.0) * 4.0;
        let price = |row: usize, column: usize| {
            if column < columns {
                let cost = cost(row, column);
                if cost < alone { cost } else { barred }
            } else if column - columns == row {
                alone
            } else {
                barred
            }
        };
        self.prepare(rows, total);
        for row in 1..=rows {
            self.place(row, total, &price);
        }
        for column in 1..=columns {
            let row = self.holder[column];
            if row > 0 && cost(row - 1, column - 1) < alone {
                self.result[row - 1] = Some(column - 1);
            }
        }
        &self.result
    }

    fn prepare(&mut self, rows: usize, total: usize) {
        refill(&mut self.row_potential, rows + 1, 0.0);
        refill(&mut self.column_potential, total + 1, 0.0);
        refill(&mut self.holder, total + 1, 0);
        refill(&mut self.came_from, total + 1, 0);
        refill(&mut self.shortest, total + 1, 0.0);
        refill(&mut self.visited, total + 1, false);
        refill(&mut self.result, rows, None);
    }

    fn place(&mut self, row: usize, total: usize, price: &impl Fn(usize, usize) -> f64) {
        self.holder[0] = row;
        self.shortest.fill(f64::INFINITY);
        self.visited.fill(false);
        let mut column = 0;
        while self.holder[column] != 0 {
            column = self.extend(column, total, price);
        }
        while column != 0 {
            let before = self.came_from[column];
            self.holder[column] = self.holder[before];
            column = before;
        }
    }

    /// Takes `column` into the tree and returns the nearest column outside it.
    fn extend(&mut self, column: usize, total: usize, price: &impl Fn(usize, usize) -> f64) -> usize {
        self.visited[column] = true;
        let row = self.holder[column];
        let mut nearest = (f64::INFINITY, 0);
        for next in 1..=total {
            if self.visited[next] {
                continue;
            }
            let reduced = price(row - 1, next - 1) - self.row_potential[row] - self.column_potential[next];
            if reduced < self.shortest[next] {
                self.shortest[next] = reduced;
                self.came_from[next] = column;
            }
            if self.shortest[next] < nearest.0 {
                nearest = (self.shortest[next], next);
            }
        }
        for other in 0..=total {
            if self.visited[other] {
                self.row_potential[self.holder[other]] += nearest.0;
                self.column_potential[other] -= nearest.0;
            } else {
                self.shortest[other] -= nearest.0;
            }
        }
        nearest.1
    }
}

fn refill<T: Clone>(values: &mut Vec<T>, length: usize, value: T) {
    values.clear();
    values.resize(length, value);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn total(cost: &[Vec<f64>], alone: f64, result: &[Option<usize>]) -> f64 {
        result.iter().enumerate().map(|(row, column)| column.map_or(alone, |column| cost[row][column])).sum()
    }

    fn cheapest_by_trying_all(cost: &[Vec<f64>], alone: f64, row: usize, used: u32) -> f64 {
        if row == cost.len() {
            return 0.0;
        }
        let mut best = alone + cheapest_by_trying_all(cost, alone, row + 1, used);
        for (column, &price) in cost[row].iter().enumerate() {
            if used & (1 << column) == 0 && price < alone {
                best = best.min(price + cheapest_by_trying_all(cost, alone, row + 1, used | 1 << column));
            }
        }
        best
    }

    proptest! {
        #[test]
        fn the_assignment_costs_as_little_as_the_best_permutation(
            cost in (1usize..5, 0usize..5).prop_flat_map(|(rows, columns)| {
                let entry = prop_oneof![3 => 0.0..20.0f64, 1 => Just(FORBIDDEN)];
                proptest::collection::vec(proptest::collection::vec(entry, columns), rows)
            })
        ) {
            let (rows, columns) = (cost.len(), cost[0].len());
            let mut solver = Assignment::default();
            let result = solver.solve(rows, columns, 16.0, |r, c| cost[r][c]).to_vec();
            let mut used = std::collections::HashSet::new();
            prop_assert!(result.iter().flatten().all(|column| used.insert(*column)));
            let best = cheapest_by_trying_all(&cost, 16.0, 0, 0);
            // Rounding in sums of at most five numbers of order 10.
            prop_assert!((total(&cost, 16.0, &result) - best).abs() < 1e-9);
        }
    }

    #[test]
    fn an_empty_assignment_is_empty() {
        let mut solver = Assignment::default();
        assert!(solver.solve(0, 3, 1.0, |_, _| 0.0).is_empty());
        assert_eq!(solver.solve(2, 0, 1.0, |_, _| 0.0), [None, None]);
    }
}
