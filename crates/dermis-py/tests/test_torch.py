"""The forward model in autograd, and networks from training set to live."""

import subprocess
import sys

import numpy as np
import pytest

import dermis

torch = pytest.importorskip("torch", reason="PyTorch is not installed")


@pytest.fixture(scope="module")
def small():
    from test_eit import square

    from dermis import eit

    nodes, elements, rim = square(4)
    return eit.ForwardModel(eit.Mesh(nodes, elements), eit.points([0, 3, 15, 12]), eit.Protocol.generate(4, keep_driven=True))


def test_gradients(small):
    from dermis.torch import voltages

    sigma = torch.rand(2, 3, len(small.mesh.elements), dtype=torch.float64).add_(0.5).requires_grad_()
    assert voltages(small, sigma).shape == (2, 3, small.protocol.channel_count)
    assert torch.autograd.gradcheck(lambda x: voltages(small, x), (sigma,), eps=1e-6, atol=1e-8)


def test_values_are_the_model_s(small):
    from dermis.torch import voltages

    sigma = np.random.default_rng(1).uniform(0.5, 2.0, len(small.mesh.elements))
    np.testing.assert_array_equal(voltages(small, torch.from_numpy(sigma)).numpy(), small.voltages(sigma))
    single = voltages(small, torch.from_numpy(sigma).float())
    assert single.dtype == torch.float32
    with pytest.raises(dermis.InputError):
        voltages(small, torch.ones(3))


def test_a_network_from_training_set_to_live(tmp_path):
    pytest.importorskip("safetensors", reason="safetensors is not installed")
    from dermis.torch import TrainSet, train

    code = dermis._dermis.run_command(
        ["dermis", "train-set", "--skin", "healing-square", "--samples", "12", "--shard", "4", "--out", str(tmp_path / "set")]
    )
    assert code == 0
    shown = TrainSet(tmp_path / "set")
    assert len(shown) == 12 and shown[0][0].shape[1:] == shown[0][1].shape
    card = tmp_path / "model.json"
    network = train(tmp_path / "set", card, width=4, levels=3, epochs=2, batch=4, held_out=0.34)
    ours = dermis.Network.load(card)
    assert ours.skin == "healing-square"
    images = shown.inputs[:1] * torch.from_numpy(ours.input_scale)[None, :, None, None]
    with torch.no_grad():
        logits = network(images)[0].numpy()
    probabilities = ours.probabilities(images[0].numpy())
    # The temperature scales logits and keeps their order, so the likeliest classes agree except for ties.
    assert (probabilities.argmax(axis=0) == logits.argmax(axis=0)).mean() > 0.999
    run = [sys.executable, "-m", "dermis", "run", "healing-square", "--speed", "0", "--headless", "--frames", "40", "--model", card]
    assert subprocess.run(run, capture_output=True).returncode == 0
