"""EIT on a mesh of your own: electrodes, patterns, Jacobian, a one-step image, and a gradient without a Jacobian."""

import numpy as np

from dermis import eit

SIDE = 8
axis = np.linspace(-0.05, 0.05, SIDE)
nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
corners = [row * SIDE + column for row in range(SIDE - 1) for column in range(SIDE - 1)]
elements = [triangle for k in corners for triangle in ((k, k + 1, k + SIDE + 1), (k, k + SIDE + 1, k + SIDE))]
mesh = eit.Mesh(nodes, elements)
electrodes = eit.ring_electrodes(mesh, 8, width_m=0.02, contact_impedance=1e-3, start_rad=0.2)
model = eit.ForwardModel(mesh, electrodes, eit.Protocol.adjacent(8))
rest = np.ones(len(elements))
pressed = rest.copy()
pressed[60:64] = 2.0
jacobian = model.jacobian(rest)
change = model.voltages(pressed) - model.voltages(rest)
operator = eit.Operator(jacobian, eit.Prior.noser(0.5), ("relative", 1e-3), mesh=mesh)
image = mesh.grid(32).to_pixels(operator(change))
gradient = model.vjp(rest, change)
print("image", image.shape, "gradient as by the Jacobian:", bool(np.allclose(gradient, jacobian.T @ change)))
