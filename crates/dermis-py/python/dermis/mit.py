"""Magnetic induction tomography: coils, conducting bodies, and the changes of mutual inductance caused by bodies.

>>> from dermis import mit
>>> coils = mit.Coils([[-0.02, 0.0], [0.02, 0.0]], inner_m=0.002, outer_m=0.03, turns=20)
>>> ball = mit.Body.sphere(radius_m=0.005, conductivity_s_per_m=5.8e7, frequency_hz=10e3)
>>> bool(coils.changes_h(ball, (0.0, 0.0, 0.03))[0].real < 0)
True
"""

from ._dermis import Body, Coils

__all__ = ["Body", "Coils"]
