"""Creates the files in this folder: small tables of frames, written by SciPy, openpyxl, pandas and pyarrow.

Made with Python 3.11, numpy 2.4.6, scipy 1.17.1, pandas 3.1.1, openpyxl 3.1.5 and pyarrow 26.0.1:

    python make.py

Unless a comment below says otherwise, every file has the same six frames of twelve readings in volts, FRAMES[frame, channel],
20 ms apart. The test module `foreign` computes the same numbers.
"""

import datetime as dt
import struct

import numpy as np
import openpyxl
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io

COUNT, CHANNELS = 6, 12
FRAMES = np.array([[(1000 * (c + 1) + 10 * f) * 1e-6 for c in range(CHANNELS)] for f in range(COUNT)])
TIMES_S = np.arange(COUNT) * 0.02
START = dt.datetime(2024, 3, 1, 14, 7, 12)


def matlab():
    # A single uncompressed array.
    scipy.io.savemat("plain.mat", {"frames": FRAMES})
    # Compressed, single precision, with times, text and a calibration.
    scipy.io.savemat(
        "with_times.mat",
        {"v": FRAMES.astype(np.float32), "time_s": TIMES_S, "operator": "nobody", "gain": np.eye(3)},
        do_compression=True,
    )
    # Channels x frames in a compressed structure, as EIDORS stores measurements.
    data = {"name": "run 1", "meas": FRAMES.T, "time": TIMES_S, "elec": {"z_contact": 0.01 * np.ones((4, 1))}}
    scipy.io.savemat("structure.mat", {"vi": data}, do_compression=True)
    # Whole microvolts, complex readings, drives x measurements, and a single frame as a column.
    scipy.io.savemat(
        "kinds.mat",
        {
            "int32": np.round(FRAMES * 1e6).astype(np.int32),
            "int16": np.round(FRAMES * 1e6).astype(np.int16),
            "complex": FRAMES * (1 + 0.5j),
            "cube": FRAMES.reshape(COUNT, 3, 4),
            "column": FRAMES[:1].T,
        },
    )
    # Nothing readable: only text and cells.
    scipy.io.savemat("words.mat", {"label": "abc", "cells": np.array([[1, "a"]], dtype=object)})
    # Big-endian file, built by hand because SciPy writes the machine's own byte order. SciPy reads it back below.
    body = b"".join(
        (
            struct.pack(">IIII", 6, 8, 6, 0),
            struct.pack(">IIii", 5, 8, COUNT, CHANNELS),
            struct.pack(">II8s", 1, 6, b"frames\0\0"),
            struct.pack(">II", 9, 8 * FRAMES.size) + FRAMES.astype(">f8").tobytes(order="F"),
        )
    )
    text = b"MATLAB 5.0 MAT-file, Platform: SOL2".ljust(116) + bytes(8)
    with open("big_endian.mat", "wb") as file:
        file.write(text + struct.pack(">H2s", 0x0100, b"MI") + struct.pack(">II", 14, len(body)) + body)
    assert (scipy.io.loadmat("big_endian.mat")["frames"] == FRAMES).all()


def excel():
    # A table as pandas writes it, with an index and numeric headers.
    pd.DataFrame(FRAMES).to_excel("pandas.xlsx", sheet_name="Sheet1")
    # Dates, names with units in millivolts, a title, an offset, an empty cell, and other sheets.
    book = openpyxl.Workbook()
    notes = book.active
    notes.title = "Notes"
    notes["A1"] = "Press at (20, 10) mm"
    sheet = book.create_sheet("Frames")
    sheet["B2"] = "Run 7"
    sheet.append([])
    sheet.append([None, "timestamp"] + [f"ch{c} (mV)" for c in range(CHANNELS)])
    for frame in range(COUNT):
        stamp = START + dt.timedelta(milliseconds=20 * frame)
        values = [float(v) for v in FRAMES[frame] * 1e3]
        if frame == 2:
            values[4] = None
        sheet.append([None, stamp] + values)
    settings = book.create_sheet("Settings")
    settings.append(["amplitude (mA)", "frequency (Hz)"])
    settings.append([1.0, 10000])
    book.save("book.xlsx")
    # Formulas without calculated values, and a cell with an error.
    book = openpyxl.Workbook()
    sheet = book.active
    for frame in range(COUNT):
        sheet.append([f"={1 + frame}/2"] + [float(v) for v in FRAMES[frame][1:]])
    book.save("formulas.xlsx")
    book = openpyxl.Workbook()
    sheet = book.active
    for frame in range(COUNT):
        sheet.append([float(v) for v in FRAMES[frame]])
    sheet["C4"] = "#DIV/0!"
    sheet["C4"].data_type = "e"
    book.save("error.xlsx")


def parquet():
    names = [f"ch{c}" for c in range(CHANNELS)]
    table = pd.DataFrame(FRAMES, columns=names)
    # pandas: snappy, a time column in nanoseconds, words, a missing reading, several row groups.
    stamps = [START + dt.timedelta(milliseconds=20 * f) for f in range(COUNT)]
    full = table.copy()
    full.insert(0, "timestamp", pd.to_datetime(stamps).astype("datetime64[ns]"))
    full["note"] = ["", "", "press", "press", "", ""]
    full.loc[2, "ch4"] = None
    full.to_parquet("pandas.parquet", row_group_size=4)
    # An index of times.
    table.set_index(pd.Index(TIMES_S, name="time_s")).to_parquet("index.parquet")
    # pyarrow: zstd, one list per frame, in single precision, with counts.
    lists = pa.array(FRAMES.astype(np.float32).tolist(), pa.list_(pa.float32()))
    pq.write_table(pa.table({"frame": list(range(COUNT)), "voltages": lists}), "lists.parquet", compression="zstd")
    # The same, with one frame a reading short.
    short = FRAMES.tolist()
    short[3] = short[3][:-1]
    pq.write_table(pa.table({"voltages": pa.array(short)}), "short.parquet", compression="gzip")
    # Integers, dates in milliseconds, lz4.
    whole = {name: np.round(FRAMES[:, c] * 1e6).astype(np.int32) for c, name in enumerate(names)}
    when = pa.array(stamps, pa.timestamp("ms", tz="UTC"))
    pq.write_table(pa.table({"when": when, **whole}), "whole.parquet", compression="lz4")


if __name__ == "__main__":
    matlab()
    excel()
    parquet()
