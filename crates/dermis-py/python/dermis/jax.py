"""Forward models inside JAX, as a function with a custom derivative. JAX is imported only here."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np

__all__ = ["voltages"]


def _read(model: Any, sigma: jax.Array) -> np.ndarray:
    rows = np.ascontiguousarray(sigma, np.float64)
    values = model.voltages_many(rows.reshape(-1, rows.shape[-1]))
    return values.reshape(*rows.shape[:-1], values.shape[1]).astype(sigma.dtype)


def _pull(model: Any, sigma: jax.Array, cotangent: jax.Array) -> np.ndarray:
    rows = np.ascontiguousarray(sigma, np.float64).reshape(-1, sigma.shape[-1])
    weights = np.asarray(cotangent, np.float64).reshape(len(rows), -1)
    gradient = np.stack([model.vjp(row, weight) for row, weight in zip(rows, weights)])
    return gradient.reshape(sigma.shape).astype(sigma.dtype)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def voltages(model: Any, sigma: jax.Array) -> jax.Array:
    """Voltages of a model as a differentiable function of conductivities, usable inside ``jit``, ``grad`` and
    ``vmap``.

    Parameters
    ----------
    model : dermis.Model or dermis.eit.ForwardModel
        The forward model.
    sigma : jax.Array
        Shape (..., m): one conductivity per element. Gradients come from the model's adjoint in double precision.

    Returns
    -------
    jax.Array
        Shape (..., k), volts, with the type of `sigma`.
    """
    shape = (*sigma.shape[:-1], len(model.channels) if hasattr(model, "channels") else model.protocol.channel_count)
    out = jax.ShapeDtypeStruct(shape, sigma.dtype)
    return jax.pure_callback(partial(_read, model), out, sigma, vmap_method="broadcast_all")


def _forward(model: Any, sigma: jax.Array) -> tuple[jax.Array, jax.Array]:
    return voltages(model, sigma), sigma


def _backward(model: Any, sigma: jax.Array, cotangent: jax.Array) -> tuple[jax.Array]:
    out = jax.ShapeDtypeStruct(sigma.shape, sigma.dtype)
    return (jax.pure_callback(partial(_pull, model), out, sigma, cotangent, vmap_method="broadcast_all"),)


voltages.defvjp(_forward, _backward)
