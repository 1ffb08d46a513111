#!/usr/bin/env python3
"""Runs the book's notebooks in place and keeps their outputs small: pictures at 60 dots per inch, no metadata.

    pip install nbclient ipykernel matplotlib dist/dermis-*.whl
    python scripts/run_notebooks.py [docs/notebooks/1-first-evening.ipynb ...]
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "notebooks"
# Largest size of a notebook.
MOST_BYTES = 150_000
SETUP = "%config InlineBackend.figure_formats = ['png']\n%config InlineBackend.rc = {'figure.dpi': 60, 'figure.figsize': (5, 4)}"


def main():
    for path in [Path(word) for word in sys.argv[1:]] or sorted(FOLDER.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        # A setup cell that shrinks the pictures, which readers needn't see.
        notebook.cells.insert(0, nbformat.v4.new_code_cell(SETUP))
        with TemporaryDirectory() as folder:
            client = NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": folder}})
            client.execute()
        del notebook.cells[0]
        count = 0
        for cell in notebook.cells:
            cell.metadata = {}
            cell.pop("id", None)
            if cell.cell_type != "code":
                continue
            count += 1
            cell.execution_count = count
            for output in cell.outputs:
                output.pop("metadata", None)
                if output.output_type in ("display_data", "execute_result"):
                    output.metadata = {}
                if output.output_type == "execute_result":
                    output.execution_count = count
        notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"], "language_info": {"name": "python"}}
        notebook.nbformat, notebook.nbformat_minor = 4, 4
        text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
        if len(text) > MOST_BYTES:
            sys.exit(f"{path.name}: expected at most {MOST_BYTES} bytes, got {len(text)}")
        path.write_text(text)
        print(f"{path.name}: {len(text)} bytes")


if __name__ == "__main__":
    main()
