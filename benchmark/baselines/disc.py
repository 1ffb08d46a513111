"""Sensitivities of a homogeneous disc with point electrodes on its rim, in closed form.

A current I into electrode k of a disc of unit radius creates the potential -(I / (pi sigma)) ln |r - e_k| (each source
coincides with its image). The derivative of a voltage with respect to the conductivity at r is therefore minus the product
of the gradients of the driving and the measuring field at r (Geselowitz 1971).
"""

import numpy as np


def grid(side):
    """Centres of the pixels of a square of side 2 that lie within 0.97 of the disc, and their indices; row 0 is the top."""
    middle = (np.arange(side) + 0.5) / side * 2 - 1
    x, y = np.meshgrid(middle, -middle)
    inside = np.flatnonzero(np.hypot(x, y).ravel() < 0.97)
    return np.column_stack([x.ravel(), y.ravel()])[inside], inside


def gradients(points, electrodes):
    """Gradients of -ln |r - e| / pi: points x electrodes x 2."""
    away = points[:, None] - electrodes[None]
    return -away / (np.pi * ((away**2).sum(2, keepdims=True) + 1e-3))


def sensitivities(points, electrodes, drives, reads):
    """Channels x points. Drives and reads are channels x electrodes: currents, and +1 and -1 for each voltage."""
    fields = gradients(points, electrodes)
    driving, reading = (np.einsum("ce,ped->cpd", part, fields, optimize=True) for part in (drives, reads))
    return -(driving * reading).sum(2)


def voltages(electrodes, drives, reads):
    """Voltages of the homogeneous disc. A driving electrode is a spot of finite size."""
    away = np.hypot(*(electrodes[:, None] - electrodes[None]).transpose(2, 0, 1))
    potential = -np.log(np.maximum(away, 0.05)) / np.pi
    return ((drives @ potential) * reads).sum(1)
