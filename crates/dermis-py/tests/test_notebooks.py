"""The six notebooks of the book run from top to bottom."""

import json
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[3] / "docs" / "notebooks"


@pytest.mark.parametrize("name", ["1-first-evening", "2-own-skin", "3-own-data", "4-calibrate", "5-own-mesh", "6-gradients"])
def test_notebook(name):
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    matplotlib.use("Agg")
    cells = json.loads((FOLDER / f"{name}.ipynb").read_text())["cells"]
    names = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{name}.ipynb", "exec"), names)
    assert sum(cell["cell_type"] == "code" for cell in cells) >= 2
