"""EVAL-CN0565-ARDZ (AD5940 and a crosspoint switch) as a source: python cn0565.py serial:/dev/ttyACM0,230400

pyadi-iio sets the board and reads it; dermis needs its sequence of electrodes and its complex readings. The readings are
in the board's own unit: touches and places do not depend on it, siemens would.
"""

import sys

import numpy as np

import dermis


def skin_of(board, diameter_mm=200.0, width_mm=10.0):
    """A round tank with the board's electrodes, whose channels are those that the board reads."""
    rows = [[f_minus + 1, f_plus + 1, s_plus + 1, s_minus + 1] for f_plus, s_plus, s_minus, f_minus in board.switch_sequence]
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
channels = {[[int(e) for e in row] for row in rows]}
[touch]
both_signs = true
"""
    )


def frames(board):
    """One complex frame after another."""
    while True:
        parts = np.asarray(board.all_voltages, float)
        yield parts[:, 0] + 1j * parts[:, 1]


def main(uri):
    import adi

    board = adi.cn0565(uri)
    board.electrode_count, board.force_distance, board.sense_distance = 8, 1, 1
    for result in dermis.open(frames(board), skin_of(board)):
        for touch in result.touches:
            print(f"{result.time_s:.1f} s: ({touch['x_mm']:.1f}, {touch['y_mm']:.1f}) mm")


if __name__ == "__main__":
    main(sys.argv[1])
