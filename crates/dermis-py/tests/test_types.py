"""Types: the stubs match the compiled half, the examples type-check, and they run."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
EXAMPLES = sorted((HERE.parent / "examples").glob("*.py"))
PROJECT = HERE.parent / "pyproject.toml"


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
