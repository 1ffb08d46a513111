"""EVAL-CN0565-ARDZ (AD5940 and a crosspoint switch) as a source: python cn0565.py serial:/dev/ttyACM0,230400

pyadi-iio configures the board and reads it; dermis needs its sequence of electrodes and its complex readings. The
readings are in the board's own unit: touches and positions don't depend on it, but siemens would.
"""

import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dermis


def skin_of(board: Any, diameter_mm: float = 200.0, width_mm: float = 10.0) -> dermis.Skin:
    """A round tank with the board's electrodes, and channels in the order in which the board reads them."""
    sequence = [[int(electrode) + 1 for electrode in row] for row in board.switch_sequence]
    channels = [[f_minus, f_plus, s_plus, s_minus] for f_plus, s_plus, s_minus, f_minus in sequence]
    return dermis.Skin(
        f"""name = "cn0565"
modality = "eit"
[frontend]
shape = {{ disc = {{ diameter_mm = {diameter_mm} }} }}
layer = {{ kind = "liquid", depth_mm = 20.0, conductivity_s_per_m = 0.2, tension_n_per_m = 0.0 }}
electrodes = {{ rim = {{ count = {board.electrode_count}, width_mm = {width_mm}, start_deg = 0.0 }} }}
contact_impedance_ohm_m2 = 4e-4
[backend]
instrument = "EVAL-CN0565-ARDZ"
current_ma = 0.1
reads = "complex"
channels = {channels}
[touch]
both_signs = true
"""
    )


def frames(board: Any) -> Iterator[NDArray[np.complex128]]:
    """Yields one complex frame after another."""
    while True:
        parts = np.asarray(board.all_voltages, float)
        yield parts[:, 0] + 1j * parts[:, 1]


def main(uri: str) -> None:
    board = import_module("adi").cn0565(uri)
    board.electrode_count, board.force_distance, board.sense_distance = 8, 1, 1
    for result in dermis.open(frames(board), skin_of(board)):
        for touch in result.touches:
            print(f"{result.time_s:.1f} s: ({touch['x_mm']:.1f}, {touch['y_mm']:.1f}) mm")


if __name__ == "__main__":
    if len(sys.argv) == 2:
        main(sys.argv[1])
    else:
        print(__doc__)
