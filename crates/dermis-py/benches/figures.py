#!/usr/bin/env python3
"""Measures the installed package on this machine. The figures in the book's Python chapters come from here.

    pip install numpy scipy pyeit dist/dermis-*.whl
    python crates/dermis-py/benches/figures.py [frame] [memory] [many] [import] [wheel=dist/dermis-0.1.0-...whl]

Without arguments it measures everything except the wheel. `many` takes `dermis=PATH`, a command built by `cargo build
--release`, for the rate of Rust without Python; frames=N sets the number of frames for `memory`.
"""

import json
import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import statistics
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np

import dermis

PEERS = Path(__file__).resolve().parents[3] / "benches" / "peers"
ROWS = 256


def pressed_pipeline():
    """A pipeline of healing-square after its baseline, frames at rest, and frames under a press."""
    skin = dermis.Skin("healing-square")
    twin, pipe = dermis.Twin(skin, seed=1), dermis.Pipeline(skin)
    rest = np.stack([twin.step().values for _ in range(200)])
    for frame in rest:
        pipe.process(frame)
    twin.press(x_mm=10, y_mm=-5, radius_mm=8, force_n=20.0)
    return pipe, rest[-64:], np.stack([twin.step().values for _ in range(64)])


def frame():
    """Time of `process` beyond Rust's own, measured in alternating blocks, so that a busy machine slows both."""
    pipe, rest, press = pressed_pipeline()
    print("pipe.process, healing-square, 208 channels (us a frame; median of 40 blocks of 256 frames each)")
    print("| frames | Rust | Python | difference | with result.image | with result.touches |")
    for name, frames in (("at rest", rest), ("pressed", press)):
        rows = list(frames) * (256 // len(frames))
        blocks = []
        for _ in range(40):
            rust = dermis._dermis._seconds_of_frames(pipe, frames, len(rows))
            times = [rust]
            for look in (None, "image", "touches"):
                begun = time.perf_counter()
                if look is None:
                    for row in rows:
                        pipe.process(row)
                else:
                    for row in rows:
                        getattr(pipe.process(row), look)
                times.append(time.perf_counter() - begun)
            blocks.append([1e6 * seconds / len(rows) for seconds in times])
        blocks = np.array(blocks)
        more = [statistics.median(blocks[:, column] - blocks[:, 0]) for column in (1, 2, 3)]
        rust, python = np.median(blocks[:, 0]), np.median(blocks[:, 1])
        print(f"| {name} | {rust:.1f} | {python:.1f} | +{more[0]:.1f} | +{more[1]:.1f} | +{more[2]:.1f} |")


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def memory(frames=1_000_000):
    """Resident memory while frames are processed; after the first tenth it should stay constant."""
    pipe, rest, press = pressed_pipeline()
    # One frame in sixteen is pressed, since those take ten times as long.
    rows = [*list(rest) * 15, *press]
    seen = []
    begun = time.perf_counter()
    for number in range(frames):
        result = pipe.process(rows[number % len(rows)])
        if number % 16 == 0:
            result.image, result.touches
        if (number + 1) % max(1, frames // 10) == 0:
            seen.append(resident_bytes() / 2**20)
    took = time.perf_counter() - begun
    print(f"{frames} frames in {took:.0f} s; resident MiB after each tenth: " + " ".join(f"{mib:.1f}" for mib in seen))
    print(f"growth from the first tenth to the last: {seen[-1] - seen[0]:+.2f} MiB")


def case_of(model):
    """A model in the form that the other packages read."""
    return {
        "nodes": np.asarray(model.nodes)[:, :2],
        "elements": np.asarray(model.elements).astype(np.int64),
        "electrodes": [electrode.parts.astype(np.int64) for electrode in model.electrodes],
        "contact_impedance_ohm_m": model.electrodes[0].contact_impedance,
        "stimulations": model.stimulations,
        "measurements": model.measurements,
        "stimulation_of": model.stimulation_of.astype(np.int64),
        "voltages_v": model.voltages(np.ones(len(model.elements))),
    }


def middle(edges):
    nodes = [edges[0][0]] + [edge[1] for edge in edges]
    return int(nodes[len(nodes) // 2])


def rates(threads, sigmas, model, blocks, command):
    """Solves with Python and with the command in turn, a second each."""
    found = {"python": [], "rust": []}
    for _ in range(blocks):
        begun = time.perf_counter()
        model.voltages_many(sigmas, threads=threads)
        found["python"].append(len(sigmas) / (time.perf_counter() - begun))
        if command:
            environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
            said = subprocess.run([command, "bench", "--json", "--seconds", "0.05"], capture_output=True, env=environment, check=True)
            (line,) = [line for line in json.loads(said.stdout) if "forward solves" in line["what"]]
            found["rust"].append(1e6 * ROWS / line["median_us"])
    return found


def many(command=None, blocks=10, counts=(1, 2)):
    """`voltages_many` of 5,000 elements, compared with the rates of Rust alone, SciPy and pyEIT."""
    model = dermis.Skin("ionic-disc").model(elements=5000)
    elements = len(model.elements)
    rows, columns = np.indices((ROWS, elements))
    sigmas = model.sigma * (1.0 + 0.5 * np.sin(rows + columns))
    model.voltages_many(sigmas[:8])
    print(f"voltages_many, {elements} elements, 16 electrodes, 208 channels (solves a second)")
    for threads in counts:
        found = rates(threads, sigmas, model, blocks, command)
        python = statistics.median(found["python"])
        line = f"{threads} threads: Python {python:.0f}/s"
        if command:
            rust = statistics.median(found["rust"])
            line += f", Rust {rust:.0f}/s: {100 * python / rust:.0f} %"
        print(line)
    sys.path.insert(0, str(PEERS))
    try:
        import scipy_peer

        case = case_of(model)
        peer = scipy_peer.Model(case)
        scipy_peer.check(peer, sigmas[0] / model.sigma[0])
        took = scipy_peer.timed(lambda: peer.voltages(peer.fields(sigmas[0])), least=3)
        print(f"1 thread: {scipy_peer.PEER} {1 / took:.0f}/s")
    except ImportError as error:
        print(f"SciPy left out: {error}")
        return
    try:
        from pyeit.eit import protocol
        from pyeit.eit.fem import EITForward
        from pyeit.mesh import PyEITMesh
    except ImportError as error:
        print(f"pyEIT left out: {error}")
        return
    places = np.array([middle(edges) for edges in case["electrodes"]])
    nodes = np.column_stack([case["nodes"], np.zeros(len(case["nodes"]))])
    reference = next(node for node in range(len(nodes)) if node not in set(places))
    mesh = PyEITMesh(node=nodes, element=case["elements"], perm=sigmas[0], el_pos=places, ref_node=reference)
    forward = EITForward(mesh, protocol.create(16, dist_exc=1, step_meas=1, parser_meas="std"))
    took = scipy_peer.timed(forward.solve_eit, least=3)
    print(f"1 thread: pyEIT {1 / took:.1f}/s")


def importing():
    """Time of `import dermis` after NumPy's own import, and of both, in fresh processes, milliseconds."""
    code = "import time; a = time.perf_counter(); import numpy; b = time.perf_counter(); import dermis; c = time.perf_counter(); print(b - a, c - b)"
    seen = []
    for _ in range(21):
        said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        seen.append([1e3 * float(seconds) for seconds in said.split()])
    numpy_ms, dermis_ms = np.median(seen[1:], axis=0)
    print(f"import dermis: {dermis_ms:.0f} ms after NumPy's own {numpy_ms:.0f} ms (median of 20 fresh processes)")


def wheel(path):
    """Size of a wheel and of its content."""
    size = Path(path).stat().st_size
    print(f"{Path(path).name}: {size / 1e6:.1f} MB")
    with zipfile.ZipFile(path) as packed:
        for part in sorted(packed.infolist(), key=lambda part: -part.file_size)[:3]:
            print(f"  {part.filename}: {part.file_size / 1e6:.1f} MB, {part.compress_size / 1e6:.1f} MB packed")


def main():
    words = dict(word.split("=", 1) if "=" in word else (word, "") for word in sys.argv[1:])
    chosen = [word for word in words if word in ("frame", "memory", "many", "import", "wheel")]
    print(f"dermis {dermis.__version__}, Python {sys.version.split()[0]}, NumPy {np.__version__}, {os.cpu_count()} processors\n")
    for word in chosen or ("frame", "memory", "many", "import"):
        if word == "frame":
            frame()
        elif word == "memory":
            memory(int(words.get("frames", 1_000_000)))
        elif word == "many":
            many(words.get("dermis"), int(words.get("blocks", 10)))
        elif word == "import":
            importing()
        else:
            wheel(words["wheel"])
        print(flush=True)


if __name__ == "__main__":
    main()
