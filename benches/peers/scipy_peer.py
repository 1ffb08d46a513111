"""EIT in NumPy and SciPy as a careful programmer writes it: the sparsity pattern and the map from conductivities to its
values are made once, one sparse factorisation serves all electrodes, and the adjoint Jacobian is vectorised.

    python scipy_peer.py CASE.json...     (cases from `cargo run --release -p dermis-tomo --example peer_case`)
"""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import multiprocessing
import sys
import time

import numpy as np
import scipy
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from peer import inclusion, label, load, report, timed

PEER = f"scipy {scipy.__version__}"


class Model:
    """Complete electrode model on triangles; the last electrode is the reference."""

    def __init__(self, case):
        nodes, elements = case["nodes"], case["elements"]
        self.case, self.count = case, len(case["electrodes"])
        n, m, corners = len(nodes), len(elements), nodes[elements]
        edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        doubled = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        self.area = np.abs(doubled) / 2
        # Gradients of the shape functions: the edge opposite each corner, turned by 90 degrees.
        self.grad = np.stack([-edges[:, :, 1], edges[:, :, 0]], axis=1) / doubled[:, None, None]
        stiffness = np.einsum("edi,edj,e->eij", self.grad, self.grad, self.area)
        self.size = n + self.count - 1
        rows, columns = np.repeat(elements, 3, axis=1).ravel(), np.tile(elements, (1, 3)).ravel()
        contact = self.contacts(nodes, n)
        everything = sp.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(self.size, self.size)).tocsc() + abs(contact)
        everything.sort_indices()
        self.indices, self.indptr = everything.indices, everything.indptr
        # Position of each stiffness entry among the sorted values of the pattern.
        keys = np.repeat(np.arange(self.size), np.diff(self.indptr)) * self.size + self.indices
        slots = np.searchsorted(keys, columns * self.size + rows)
        self.assemble = sp.csr_matrix((stiffness.ravel(), (slots, np.repeat(np.arange(m), 9))), shape=(len(keys), m))
        contact = contact.tocoo()
        self.fixed = np.zeros(len(keys))
        np.add.at(self.fixed, np.searchsorted(keys, contact.col.astype(np.int64) * self.size + contact.row), contact.data)
        self.currents = np.zeros((self.size, self.count - 1))
        self.currents[n + np.arange(self.count - 1), np.arange(self.count - 1)] = 1.0
        self.drives = self.grouped(case)

    def contacts(self, nodes, n):
        conductance = 1 / self.case["contact_impedance_ohm_m"]
        rows, columns, values = [], [], []
        for l, faces in enumerate(self.case["electrodes"]):
            for i, j in faces:
                length = np.linalg.norm(nodes[i] - nodes[j]) * conductance
                local = [(i, i, length / 3), (j, j, length / 3), (i, j, length / 6), (j, i, length / 6)]
                if l < self.count - 1:
                    u = n + l
                    local += [(i, u, -length / 2), (u, i, -length / 2), (j, u, -length / 2), (u, j, -length / 2), (u, u, length)]
                for row, column, value in local:
                    rows.append(row), columns.append(column), values.append(value)
        return sp.coo_matrix((values, (rows, columns)), shape=(self.size, self.size)).tocsc()

    def grouped(self, case):
        """Channels of each drive, as rows of the list of distinct measuring patterns."""
        patterns, which = np.unique(case["measurements"], axis=0, return_inverse=True)
        self.patterns, which = patterns, np.asarray(which).ravel()
        return [(np.flatnonzero(case["stimulation_of"] == d), which[case["stimulation_of"] == d]) for d in range(len(case["stimulations"]))]

    def fields(self, sigma):
        matrix = sp.csc_matrix((self.fixed + self.assemble @ sigma, self.indices, self.indptr), shape=(self.size, self.size))
        factor = spl.splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return factor.solve(self.currents)

    def voltages(self, fields):
        potentials = np.zeros((self.count, self.count - 1))
        potentials[:-1] = fields[-(self.count - 1):]
        driven = potentials @ self.case["stimulations"][:, :-1].T
        return np.einsum("ml,lm->m", self.case["measurements"], driven[:, self.case["stimulation_of"]])

    def jacobian(self, fields):
        n = len(self.case["nodes"])
        local = np.ascontiguousarray(fields[:n].T)[:, self.case["elements"]]
        # Gradients of the field of each unit current, times the root of the area.
        gradient = np.einsum("edi,lei,e->lde", self.grad, local, np.sqrt(self.area), optimize=True)
        flat = gradient.reshape(self.count - 1, -1)
        drive = (self.case["stimulations"][:, :-1] @ flat).reshape(-1, 2, len(self.area))
        read = (self.patterns[:, :-1] @ flat).reshape(-1, 2, len(self.area))
        jacobian = np.empty((len(self.case["measurements"]), len(self.area)))
        for d, (channels, which) in enumerate(self.drives):
            jacobian[channels] = -(read[which, 0] * drive[d, 0] + read[which, 1] * drive[d, 1])
        return jacobian


def operator(jacobian, hyperparameter=1e-2):
    """NOSER in data space: P J' (J P J' + lambda^2)^-1."""
    spread = jacobian.T / np.sqrt((jacobian**2).sum(axis=0))[:, None]
    gram = jacobian @ spread
    gram.flat[:: len(gram) + 1] += hyperparameter**2
    return scipy.linalg.cho_solve(scipy.linalg.cho_factor(gram), spread.T).T


def check(model, sigma):
    """The same voltages as dermis, and a Jacobian that finite differences confirm."""
    case = model.case
    found = model.voltages(model.fields(np.ones(len(sigma))))
    error = np.linalg.norm(found - case["voltages_v"]) / np.linalg.norm(found)
    assert error < 1e-9, f"voltages differ from those of dermis by {error:.1e}"
    fields = model.fields(sigma)
    step = np.random.default_rng(1).standard_normal(len(sigma)) * 1e-6
    rise = model.voltages(model.fields(sigma + step)) - model.voltages(model.fields(sigma - step))
    predicted = 2 * model.jacobian(fields) @ step
    error = np.linalg.norm(rise - predicted) / np.linalg.norm(rise)
    assert error < 1e-4, f"the Jacobian differs from finite differences by {error:.1e}"


def rate(path_and_seconds):
    path, seconds = path_and_seconds
    model = Model(load(path))
    sigma = inclusion(model.case)
    solves, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        model.voltages(model.fields(sigma))
        solves += 1
    return solves / (time.perf_counter() - begun)


def main(paths):
    for path in paths:
        model = Model(load(path))
        sigma, name = inclusion(model.case), label(model.case)
        check(model, sigma)
        fields = model.fields(sigma)
        report(PEER, f"forward, {name} elements", timed(lambda: model.voltages(model.fields(sigma))))

        def both():
            fields = model.fields(sigma)
            return model.voltages(fields), model.jacobian(fields)

        report(PEER, f"forward and Jacobian, {name} elements", timed(both))
        if name == 5000:
            workers = multiprocessing.cpu_count()
            with multiprocessing.get_context("spawn").Pool(workers) as pool:
                rates = pool.map(rate, [(path, 3.0)] * workers)
            report(PEER, "samples/100 forward solves, 5000 elements, all cores", 100 / sum(rates), workers=workers)
    random = np.random.default_rng(1)
    jacobian = random.standard_normal((208, 4096))
    report(PEER, "operator, 208 channels to 4096 pixels, NOSER", timed(lambda: operator(jacobian)))
    for channels in (208, 4096):
        matrix = random.standard_normal((4096, channels)).astype(np.float32)
        frame = random.standard_normal(channels).astype(np.float32)
        report(PEER, f"frame, {channels} channels to 64 x 64", timed(lambda: matrix @ frame))


if __name__ == "__main__":
    main(sys.argv[1:])
