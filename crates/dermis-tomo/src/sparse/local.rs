//! Solutions at a few unknowns for sources at the same ones. Only the supernodes between them and the root of the
//! elimination tree take part: no source reaches the others, and none of the wanted values depends on them.

use faer::MatMut;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::supernodal::{SupernodalLltRef, SymbolicSupernodalCholesky};

use super::substitution::{Supernodal, WIDTH};

/// Working memory of [`SpdStructure::solve_at`](super::SpdStructure::solve_at).
#[derive(Clone, Debug, Default)]
pub struct LocalMemory {
    /// Values by place in the elimination order; stale outside the supernodes that take part.
    x: Vec<[f64; WIDTH]>,
    /// True for each supernode that takes part.
    takes_part: Vec<bool>,
    /// The supernodes that take part, in elimination order.
    supernodes: Vec<usize>,
    below: Vec<[f64; WIDTH]>,
}

impl LocalMemory {
    /// Finds the supernodes for unknowns at these places in the elimination order.
    fn begin(&mut self, symbolic: &SymbolicSupernodalCholesky<u32>, places: impl Iterator<Item = usize>) {
        let begins = symbolic.supernode_begin();
        self.takes_part.clear();
        self.takes_part.resize(begins.len(), false);
        let supernode_of = |place: usize| begins.partition_point(|&begin| begin as usize <= place) - 1;
        for place in places {
            let mut supernode = supernode_of(place);
            while !std::mem::replace(&mut self.takes_part[supernode], true) {
                // The parent holds the first of the rows below.
                let Some(&parent) = symbolic.supernode(supernode).pattern().iter().min() else { break };
                supernode = supernode_of(parent as usize);
            }
        }
        self.supernodes.clear();
        self.supernodes.extend((0..begins.len()).filter(|&supernode| self.takes_part[supernode]));
        self.x.resize(symbolic.nrows(), [0.0; WIDTH]);
    }

    /// Solves for all columns of `rhs`, reading and writing the rows of these unknowns.
    pub(super) fn solve(
        &mut self,
        factor: SupernodalLltRef<'_, u32, f64>,
        order: PermRef<'_, u32>,
        unknowns: &[u32],
        mut rhs: MatMut<'_, f64>,
    ) {
        let (_, new_of_old) = order.arrays();
        let places = unknowns.iter().map(|&unknown| new_of_old[unknown as usize] as usize);
        self.begin(factor.symbolic(), places.clone());
        let supernodal = Supernodal { factor, first: 0 };
        for first in (0..rhs.ncols()).step_by(WIDTH) {
            let columns = first..rhs.ncols().min(first + WIDTH);
            for &supernode in &self.supernodes {
                let node = factor.supernode(supernode);
                self.x[node.start()..][..node.val().ncols()].fill([0.0; WIDTH]);
            }
            for (&unknown, place) in unknowns.iter().zip(places.clone()) {
                let row = rhs.as_ref().row(unknown as usize);
                columns.clone().for_each(|column| self.x[place][column - first] = row[column]);
            }
            let Self { x, supernodes, below, .. } = self;
            pulp::Arch::new().dispatch(LocalSubstitution { supernodal: &supernodal, x, supernodes, below });
            for (&unknown, place) in unknowns.iter().zip(places.clone()) {
                let mut row = rhs.as_mut().row_mut(unknown as usize);
                columns.clone().for_each(|column| row[column] = self.x[place][column - first]);
            }
        }
    }
}

/// The loops of a solve, compiled for the vector instructions of the machine.
struct LocalSubstitution<'a> {
    supernodal: &'a Supernodal<'a>,
    x: &'a mut [[f64; WIDTH]],
    supernodes: &'a [usize],
    below: &'a mut Vec<[f64; WIDTH]>,
}

impl pulp::NullaryFnOnce for LocalSubstitution<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for &supernode in self.supernodes {
            self.supernodal.forward(supernode, self.x);
        }
        for &supernode in self.supernodes.iter().rev() {
            self.supernodal.backward(supernode, self.x, self.below);
        }
    }
}
