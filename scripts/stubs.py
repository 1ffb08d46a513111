#!/usr/bin/env python3
"""Writes the types of the Python package's compiled half, `crates/dermis-py/python/dermis/_dermis.pyi`, from the Rust
code.

    scripts/stubs.py            writes the file
    scripts/stubs.py --check    fails if the file is not what would be written

This Python needs maturin, which builds the library as `scripts/test` does and reads its types. Docstrings are left out,
since the library has them, and long lines are wrapped.
"""

import ast
import difflib
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CRATE = ROOT / "crates" / "dermis-py"
STUBS = CRATE / "python" / "dermis" / "_dermis.pyi"
WIDTH = 120
HEADER = "# Written by scripts/stubs.py from the types in crates/dermis-py/src.\n\n"
# The crate's own pyproject.toml strips the library, which then has lost its types.
PROJECT = f"""
project = {{ name = "dermis", version = "0" }}
tool.maturin = {{ module-name = "dermis._dermis", manifest-path = "{(CRATE / "Cargo.toml").as_posix()}" }}
build-system = {{ requires = ["maturin>=1.9,<2"], build-backend = "maturin" }}
"""


def built():
    """The stubs as maturin writes them."""
    if importlib.util.find_spec("maturin") is None:
        sys.exit(f"{sys.executable} has no maturin: pip install 'maturin>=1.9,<2'")
    target = os.path.abspath(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    os.makedirs(target, exist_ok=True)
    # Within the repository, so that its settings of cargo and its toolchain are used.
    with tempfile.TemporaryDirectory(dir=target) as folder:
        Path(folder, "pyproject.toml").write_text(PROJECT)
        command = [sys.executable, "-m", "maturin", "generate-stubs", "--quiet", "--profile", "dev", "--locked"]
        command += ["--features", "foxglove,ros2", "--interpreter", sys.executable, "--out", "stubs"]
        subprocess.run(command, cwd=folder, check=True, env={**os.environ, "CARGO_TARGET_DIR": target})
        (found,) = Path(folder, "stubs").rglob("*.pyi")
        return found.read_text()


def without_docstrings(text):
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node) is not None:
            said = node.body[0]
            lines[said.lineno - 1 : said.end_lineno] = [None] * (said.end_lineno - said.lineno + 1)
            if isinstance(node, ast.FunctionDef):
                lines[said.lineno - 2] += " ..."
    return [line for line in lines if line is not None]


def wrapped(line):
    """A line, or several if it is too long: what is in its brackets on a line of its own, or on one for each item."""
    shape = re.fullmatch(r"( *)(from \S+ import |def \w+\(|__all__ = \[)(.*?)(\]|\) -> .*|)", line)
    if len(line) <= WIDTH or shape is None:
        return [line]
    indent, before, inside, after = shape.groups()
    if not after:
        before, after = f"{before}(", ")"
    inner = f"{indent}    "
    if len(inner + inside) <= WIDTH and not before.startswith("__all__"):
        return [indent + before, inner + inside, indent + after]
    items = [""]
    for part in inside.split(", "):
        # A comma within brackets separates nothing.
        if items[-1].count("[") > items[-1].count("]"):
            items[-1] += f", {part}"
        else:
            items.append(part)
    return [indent + before, *(f"{inner}{item}," for item in items[1:]), indent + after]


def main():
    lines = without_docstrings(built())
    written = HEADER + "\n".join(part for line in lines for part in wrapped(line)).strip() + "\n"
    ast.parse(written)
    if "--check" not in sys.argv[1:]:
        STUBS.write_text(written)
    elif STUBS.read_text() != written:
        there = STUBS.read_text().splitlines()
        print(*difflib.unified_diff(there, written.splitlines(), "checked in", "written", lineterm=""), sep="\n")
        sys.exit(f"{STUBS.relative_to(ROOT)} is not what the Rust code says: scripts/stubs.py writes it")


if __name__ == "__main__":
    main()
