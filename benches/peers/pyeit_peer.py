"""The same cases in pyEIT, by its public interface. pyEIT has point electrodes only: they sit in the middle of ours.

    python pyeit_peer.py CASE.json...
"""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import sys
from importlib.metadata import version

import numpy as np
import pyeit.eit.jac as jac
from pyeit.eit import protocol as patterns
from pyeit.eit.fem import EITForward
from pyeit.mesh import PyEITMesh

from peer import inclusion, label, load, report, timed

PEER = f"pyEIT {version('pyeit')}"


def middle(faces):
    nodes = [faces[0][0]] + [face[1] for face in faces]
    return nodes[len(nodes) // 2]


def main(paths):
    for path in paths:
        case = load(path)
        name = label(case)
        electrodes = np.array([middle(faces) for faces in case["electrodes"]])
        used = set(electrodes)
        reference = next(node for node in range(len(case["nodes"])) if node not in used)
        nodes = np.column_stack([case["nodes"], np.zeros(len(case["nodes"]))])
        mesh = PyEITMesh(node=nodes, element=case["elements"], perm=inclusion(case), el_pos=electrodes, ref_node=reference)
        protocol = patterns.create(len(electrodes), dist_exc=1, step_meas=1, parser_meas="std")
        forward = EITForward(mesh, protocol)
        report(PEER, f"forward, {name} elements", timed(forward.solve_eit, least=3))
        report(PEER, f"forward and Jacobian, {name} elements", timed(forward.compute_jac, least=2))
        if name == 5000:
            solver = jac.JAC(mesh, protocol)
            solver.setup(p=0.5, lamb=0.01, method="kotre", perm=1.0, jac_normalized=False)
            v0 = forward.solve_eit()
            v1 = v0 * (1 + 1e-3 * np.sin(np.arange(len(v0))))
            # To elements: pyEIT has no pixels.
            report(PEER, "frame, 208 channels to 64 x 64", timed(lambda: solver.solve(v1, v0)), unknowns=len(case["elements"]))


if __name__ == "__main__":
    main(sys.argv[1:])
