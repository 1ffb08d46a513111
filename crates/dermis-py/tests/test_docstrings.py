"""Docstrings as numpydoc reads them: every parameter once, with its type; return values described; arrays with
shapes."""

import inspect
import re

import pytest

import dermis
from dermis import contacts, eit, lerobot, mit, mujoco, plot, rerun

numpydoc = pytest.importorskip("numpydoc.validate", reason="numpydoc is not installed")

# Sections that are wrong, and parameters that are missing, unknown, out of order, or lack a type or a description.
FAULTS = {"GL01", "GL06", "GL07", "GL08", "PR01", "PR02", "PR03", "PR04", "PR07", "PR08", "RT03", "YD01"}
# A single argument with an obvious name may be described in the first line.
SHORT = 1


def public():
    """All public names, with the dotted path to each."""
    for module in (dermis, contacts, eit, lerobot, mit, mujoco, plot, rerun):
        for name in getattr(module, "__all__", [name for name in vars(module) if not name.startswith("_")]):
            value = getattr(module, name)
            if not callable(value) or inspect.ismodule(value) or getattr(value, "__module__", "").startswith(("numpy", "typing")):
                continue
            path = f"{module.__name__}.{name}"
            yield path, value
            if inspect.isclass(value) and not issubclass(value, BaseException):
                # The fields of a dataclass are parameters of its class.
                fields = getattr(value, "__dataclass_fields__", {})
                for member, of in vars(value).items():
                    if not member.startswith("_") and member not in fields:
                        yield f"{path}.{member}", of


ALL = dict(public())


@pytest.mark.parametrize("path", ALL)
def test_docstring(path):
    found = numpydoc.validate(path)
    faults = [(code, words) for code, words in found["errors"] if code in FAULTS]
    value = ALL[path]
    sections = "Parameters\n" in (found["docstring"] or "") or "Attributes\n" in (found["docstring"] or "")
    if not sections and not inspect.isclass(value):
        try:
            wanted = [name for name in inspect.signature(value).parameters if name not in ("self", "args", "kwargs")]
        except (TypeError, ValueError):
            wanted = []
        if len(wanted) <= SHORT:
            faults = [fault for fault in faults if fault[0] != "PR01"]
    assert not faults, faults


def test_arrays_have_shapes():
    """Docstrings state the shape of every array they mention."""
    lacking = []
    for path, value in ALL.items():
        doc = inspect.getdoc(value) or ""
        for kind in re.finditer(r"^(?P<indent> *)(?P<what>[\w, ]+ : )?(array_like|numpy\.ndarray)\b.*\n(?P<said>(?:(?P=indent) +.*\n?)+)", doc, re.M):
            if not re.search(r"[Ss]hape \(", kind["said"]):
                lacking.append(f"{path}: {kind[0]!r}")
    assert not lacking, "\n".join(lacking)


def test_properties_of_arrays_have_shapes():
    lacking = []
    for name, annotation in stubbed_arrays():
        owner, member = name.split(".")
        doc = inspect.getdoc(getattr(getattr(dermis._dermis, owner), member)) or ""
        if not re.search(r"[Ss]hape \(", doc):
            lacking.append(f"{name} -> {annotation}: {doc!r}")
    assert not lacking, "\n".join(lacking)


def stubbed_arrays():
    """Properties that are arrays according to the stubs."""
    import ast
    from pathlib import Path

    stubs = ast.parse(Path(dermis._dermis.__file__).with_name("_dermis.pyi").read_text())
    for node in stubs.body:
        for member in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(member, ast.FunctionDef) and member.decorator_list and member.returns is not None:
                annotation = ast.unparse(member.returns)
                if "NDArray" in annotation:
                    yield f"{node.name}.{member.name}", annotation
