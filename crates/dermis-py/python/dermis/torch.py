"""Forward models inside PyTorch, and the network that labels images, trained in PyTorch and run by dermis.

PyTorch is imported only here. The forward model takes CPU tensors only; gradients come back on their device.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from .errors import InputError

__all__ = ["TrainSet", "UNet", "save", "train", "voltages"]


class _Voltages(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, model: Any, sigma: torch.Tensor) -> torch.Tensor:
        rows = sigma.detach().to("cpu", torch.float64).contiguous()
        ctx.model = model
        ctx.save_for_backward(sigma)
        values = model.voltages_many(rows.reshape(-1, rows.shape[-1]).numpy())
        shape = (*sigma.shape[:-1], values.shape[1])
        return torch.from_numpy(values).reshape(shape).to(sigma.device, sigma.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[None, torch.Tensor]:
        (sigma,) = ctx.saved_tensors
        rows = sigma.detach().to("cpu", torch.float64).reshape(-1, sigma.shape[-1]).numpy()
        weights = cotangent.detach().to("cpu", torch.float64).reshape(len(rows), -1).numpy()
        gradient = np.stack([ctx.model.vjp(row, weight) for row, weight in zip(rows, weights)])
        return None, torch.from_numpy(gradient).reshape(sigma.shape).to(sigma.device, sigma.dtype)


def voltages(model: Any, sigma: torch.Tensor) -> torch.Tensor:
    """Voltages of a model as a differentiable function of conductivities.

    Parameters
    ----------
    model : dermis.Model or dermis.eit.ForwardModel
        The forward model.
    sigma : torch.Tensor
        Shape (..., m): one conductivity per element, in any number of batches. Gradients come from the model's
        adjoint (:meth:`dermis.Model.vjp`), computed in double precision; there are no second derivatives.

    Returns
    -------
    torch.Tensor
        Shape (..., k), volts, with the type and device of `sigma`.
    """
    if sigma.ndim < 1:
        raise InputError(f"sigma: expected shape (..., m), got shape {tuple(sigma.shape)}")
    return _Voltages.apply(model, sigma)


class _Block(nn.Module):
    """Two 3 x 3 convolutions, each with batch norm and softsign, under the names that dermis reads."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
        self.norm1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.norm2 = nn.BatchNorm2d(outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = nn.functional.softsign(self.norm1(self.conv1(x)))
        return nn.functional.softsign(self.norm2(self.conv2(x)))


class UNet(nn.Module):
    """The network that dermis runs: a U-Net with softsign, nearest-neighbour upsampling and no cropping.

    Level 0 works on the whole image with `width` channels; each further level has half the rows and columns and twice
    the channels (Ronneberger, Fischer and Brox, MICCAI 2015). Names and layouts in the ``state_dict`` are those that
    dermis reads.

    Parameters
    ----------
    inputs, classes : int
        Number of images per frame, and number of classes.
    width, levels : int
        Channels of the finest level, and number of levels; rows and columns must be multiples of ``2 ** (levels -
        1)``.
    """

    def __init__(self, inputs: int = 1, classes: int = 3, width: int = 8, levels: int = 4) -> None:
        super().__init__()
        self.shape = {"inputs": inputs, "classes": classes, "width": width, "levels": levels}
        channels = [width << level for level in range(levels)]
        self.down = nn.ModuleList(
            _Block(inputs if level == 0 else channels[level - 1], channels[level]) for level in range(levels)
        )
        self.up = nn.ModuleList(_Block(channels[level + 1] + channels[level], channels[level]) for level in range(levels - 1))
        self.head = nn.Conv2d(width, classes, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Logits, shape (n, classes, rows, columns), for images of shape (n, inputs, rows, columns)."""
        kept = []
        for level, block in enumerate(self.down):
            x = block(nn.functional.max_pool2d(x, 2) if level else x)
            kept.append(x)
        for level in reversed(range(len(self.up))):
            coarse = nn.functional.interpolate(x, scale_factor=2, mode="nearest")
            x = self.up[level](torch.cat([coarse, kept[level]], dim=1))
        return self.head(x)


class TrainSet(torch.utils.data.Dataset):
    """A folder written by ``dermis train-set``: images, shape (inputs, rows, columns), and the class of every pixel.

    Parameters
    ----------
    folder : str or pathlib.Path
        The training set.
    shards : sequence of int, optional
        Shards to use; default: all.
    """

    def __init__(self, folder: str | Path, shards: Any = None) -> None:
        from safetensors.torch import load_file

        folder = Path(folder)
        try:
            self.manifest = json.loads((folder / "manifest.json").read_text())
        except (OSError, ValueError) as error:
            raise InputError(f"{folder}: expected a folder that dermis train-set wrote, got none: {error}") from None
        count = -(-self.manifest["samples"] // self.manifest["shard_samples"])
        chosen = range(count) if shards is None else shards
        parts = [load_file(folder / f"shard-{shard:05}.safetensors") for shard in chosen]
        self.inputs = torch.cat([part["inputs"] for part in parts])
        self.labels = torch.cat([part["labels"] for part in parts])
        self.shards = count

    def __len__(self) -> int:
        return len(self.inputs)

    def __getitem__(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        return self.inputs[index], self.labels[index].long()


def train(
    folder: str | Path,
    out: str | Path,
    *,
    width: int = 8,
    levels: int = 4,
    epochs: int = 20,
    batch: int = 16,
    learning_rate: float = 2e-3,
    class_weights: Any = None,
    held_out: float = 0.1,
    seed: int = 1,
    device: str | None = None,
) -> UNet:
    """Trains a network on a training set, with CUDA if available, and saves it for dermis to load.

    Parameters
    ----------
    folder, out : str or pathlib.Path
        The training set, and the model card to write (``MODEL.json``; the weights are written next to it).
    width, levels, epochs, batch, learning_rate : int, int, int, int, float
        Size of the network, passes, samples per step, and Adam's initial step, which falls along a half cosine.
    class_weights : sequence of float, optional
        Weight of each class in the loss.
    held_out : float
        Share of the shards used to select the pass to keep.
    seed : int
        Seed of weights and sample order.
    device : str, optional
        Device to train on; default: CUDA if available, otherwise the CPU.

    Returns
    -------
    UNet
        The network of the best pass, on the CPU.
    """
    torch.manual_seed(seed)
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    whole = TrainSet(folder)
    first = max(1, min(whole.shards - 1, round((1.0 - held_out) * whole.shards)))
    learn = TrainSet(folder, range(first))
    judge = TrainSet(folder, range(first, whole.shards)) if first < whole.shards else learn
    # Scale each image to a root mean square of 1, as `dermis train` does.
    scale = 1.0 / learn.inputs.double().square().mean(dim=(0, 2, 3)).sqrt().clamp_min(1e-30)
    scale = scale.float()
    classes = len(whole.manifest["classes"])
    network = UNet(len(scale), classes, width, levels).to(device)
    weights = None if class_weights is None else torch.tensor(class_weights, dtype=torch.float32, device=device)
    loss_of = nn.CrossEntropyLoss(weight=weights)
    optimiser = torch.optim.Adam(network.parameters(), lr=learning_rate)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs, eta_min=learning_rate / 50.0)
    batches = torch.utils.data.DataLoader(learn, batch, shuffle=True)
    factors = scale.to(device)[None, :, None, None]
    best, best_loss = None, float("inf")
    for _ in _progress(range(epochs)):
        network.train()
        for images, labels in batches:
            optimiser.zero_grad()
            loss_of(network(images.to(device) * factors), labels.to(device)).backward()
            optimiser.step()
        falling.step()
        network.eval()
        with torch.no_grad():
            losses = [
                loss_of(network(images.to(device) * factors), labels.to(device)).item()
                for images, labels in torch.utils.data.DataLoader(judge, batch)
            ]
        loss = sum(losses) / len(losses)
        if loss < best_loss:
            best, best_loss = {name: value.cpu().clone() for name, value in network.state_dict().items()}, loss
    if best is not None:
        network.load_state_dict(best)
    network = network.cpu().eval()
    save(network, folder, out, input_scale=scale.tolist(), held_out=held_out)
    return network


def save(network: UNet, folder: str | Path, out: str | Path, *, input_scale: Any, held_out: float = 0.1) -> None:
    """Writes a network as a model of dermis: card, weights, and the temperature that calibrates its probabilities.

    Parameters
    ----------
    network : UNet
        The trained network.
    folder, out : str or pathlib.Path
        The training set to evaluate it on, and the card to write.
    input_scale : sequence of float
        Factors that its input images were multiplied by.
    held_out : float
        Share of the shards to evaluate it on.
    """
    from safetensors.torch import save_file

    from ._dermis import run_command
    from .errors import Error

    out = Path(out)
    state = {
        name: value.float().contiguous()
        for name, value in network.state_dict().items()
        if not name.endswith("num_batches_tracked")
    }
    weights = out.with_name(out.stem + ".state_dict.safetensors")
    save_file(state, weights)
    scale = ",".join(f"{float(factor):.9g}" for factor in input_scale)
    arguments = ["dermis", "train", "--set", str(folder), "--out", str(out), "--weights", str(weights), "--epochs", "0"]
    arguments += ["--width", str(network.shape["width"]), "--levels", str(network.shape["levels"])]
    arguments += [f"--input-scale={scale}", "--held-out", str(held_out)]
    code = run_command(arguments)
    weights.unlink(missing_ok=True)
    if code != 0:
        raise Error(f"{out}: the network could not be evaluated (exit code {code}); the reason is on stderr")


def _progress(steps: Any) -> Any:
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return steps
    return tqdm(steps, unit="epoch", leave=False)


def main() -> None:
    """``python -m dermis.torch SET MODEL.json``: trains like :func:`train`."""
    import argparse

    parser = argparse.ArgumentParser(prog="python -m dermis.torch", description=main.__doc__)
    parser.add_argument("folder", metavar="SET")
    parser.add_argument("out", metavar="MODEL.json")
    for name, kind, usual in (("width", int, 8), ("levels", int, 4), ("epochs", int, 20), ("batch", int, 16), ("seed", int, 1)):
        parser.add_argument(f"--{name}", type=kind, default=usual)
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--held-out", type=float, default=0.1)
    parser.add_argument("--class-weights", type=float, nargs="+")
    parser.add_argument("--device")
    train(**vars(parser.parse_args()))


if __name__ == "__main__":
    main()
