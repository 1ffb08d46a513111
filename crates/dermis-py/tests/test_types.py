"""Types: the stubs are those of the Rust code and match the compiled half, the examples type-check, and they run."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import dermis
from dermis import _types

HERE = Path(__file__).resolve().parent
EXAMPLES = sorted((HERE.parent / "examples").glob("*.py"))
PROJECT = HERE.parent / "pyproject.toml"
STUBS = HERE.parents[2] / "scripts" / "stubs.py"


def test_stubs_are_those_of_the_rust_code():
    pytest.importorskip("maturin", reason="maturin is not installed")
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    run = subprocess.run([sys.executable, STUBS, "--check"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def test_dictionaries_have_the_keys_of_their_types(skin, model, pressed):
    pipe = dermis.Pipeline(skin)
    for frame in pressed[0]:
        result = pipe.process(frame)
    voltages = model.voltages()
    found = {
        _types.Health: result.health,
        _types.DamageWatch: result.damage,
        _types.FoundOrder: dermis._dermis.search_order(skin, voltages),
        _types.FoundConductance: dermis._dermis.estimate_conductance(skin, voltages),
    }
    for stated, given in found.items():
        assert set(given) == set(stated.__annotations__), stated


def test_stubs(tmp_path):
    pytest.importorskip("mypy", reason="mypy is not installed")
    command = [sys.executable, "-m", "mypy.stubtest", "dermis", "--mypy-config-file", PROJECT]
    command += ["--allowlist", HERE / "stubtest-allowlist.txt", "--ignore-unused-allowlist"]
    run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0, run.stdout + run.stderr


def test_examples_under_pyright():
    pyright = shutil.which("pyright", path=str(Path(sys.executable).parent))
    # The pyright package downloads the program at its first run.
    if pyright is None or subprocess.run([pyright, "--version"], capture_output=True).returncode != 0:
        pytest.skip("pyright is not installed")
    run = subprocess.run([pyright, "--pythonpath", sys.executable, "-p", PROJECT], capture_output=True, text=True)
    assert run.returncode == 0 and "0 errors, 0 warnings" in run.stdout, run.stdout + run.stderr


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example(example, tmp_path):
    run = subprocess.run([sys.executable, example], capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0 and run.stdout, run.stderr


def test_there_are_examples():
    assert len(EXAMPLES) >= 5
