"""Checks of arguments."""

from __future__ import annotations

import numpy as np

from .errors import InputError


def check_positive(name: str, value: float, quantity: str) -> None:
    """Raises an InputError unless an argument is a finite value above 0; the quantity is "a number" or its unit."""
    if not (np.isfinite(value) and value > 0.0):
        raise InputError(f"{name} = {value!r}: expected {quantity} above 0")
