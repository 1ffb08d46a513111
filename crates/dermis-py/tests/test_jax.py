"""The forward model in JAX."""

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="JAX is not installed")


def test_gradients():
    from test_eit import square

    from dermis import eit
    from dermis.jax import voltages

    jax.config.update("jax_enable_x64", True)
    nodes, elements, _ = square(4)
    model = eit.ForwardModel(
        eit.Mesh(nodes, elements), eit.points([0, 3, 15, 12]), eit.Protocol.generate(4, keep_driven=True)
    )
    rng = np.random.default_rng(2)
    sigma = rng.uniform(0.5, 2.0, len(elements))
    weights = rng.normal(size=model.protocol.channel_count)
    loss = lambda x: weights @ voltages(model, x)
    np.testing.assert_array_equal(voltages(model, sigma), model.voltages(sigma))
    for function in (jax.grad(loss), jax.jit(jax.grad(loss))):
        np.testing.assert_allclose(function(sigma), model.vjp(sigma, weights), rtol=1e-12)
    many = rng.uniform(0.5, 2.0, (3, len(elements)))
    np.testing.assert_array_equal(jax.vmap(lambda x: voltages(model, x))(many), model.voltages_many(many))
