#!/usr/bin/env python3
"""Compares dermis' U-Net with an independent one in both directions: weights made here are run there, and weights
written there are run here, including those of the shipped models. Uses PyTorch if it is installed (Debian's
python3-torch will do), else NumPy.

    cargo build -p dermis-learn --example run_network
    python3 scripts/check_network.py target/debug/examples/run_network

With --fixture FOLDER it trains a small network in PyTorch and writes it there as a state_dict, with an image and
PyTorch's output for it, for the test of crates/dermis-learn that needs neither Python nor PyTorch.
"""
import json
import pathlib
import struct
import subprocess
import sys
import tempfile

import numpy as np

MODELS = "crates/dermis-live/models"

try:
    import torch
except ImportError:
    torch = None


def write_safetensors(path, tensors):
    header, data, at = {}, [], 0
    for name, value in sorted(tensors.items()):
        raw = np.ascontiguousarray(value, "<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": list(value.shape), "data_offsets": [at, at + len(raw)]}
        data.append(raw)
        at += len(raw)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(data))


def read_safetensors(path):
    content = path.read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    header.pop("__metadata__", None)
    body = content[8 + length :]
    return {
        name: np.frombuffer(body[slice(*entry["data_offsets"])], "<f4").reshape(entry["shape"])
        for name, entry in header.items()
    }


def random_weights(rng, inputs, classes, width, levels):
    tensors = {}

    def stage(name, source, target):
        for number, channels in ((1, source), (2, target)):
            bound = (6 / (9 * channels)) ** 0.5
            tensors[f"{name}.conv{number}.weight"] = rng.uniform(-bound, bound, (target, channels, 3, 3))
            tensors[f"{name}.norm{number}.weight"] = rng.uniform(0.5, 1.5, target)
            tensors[f"{name}.norm{number}.bias"] = rng.uniform(-0.5, 0.5, target)
            tensors[f"{name}.norm{number}.running_mean"] = rng.uniform(-0.5, 0.5, target)
            tensors[f"{name}.norm{number}.running_var"] = rng.uniform(0.5, 1.5, target)

    for level in range(levels):
        stage(f"down.{level}", inputs if level == 0 else width << (level - 1), width << level)
    for level in reversed(range(levels - 1)):
        stage(f"up.{level}", (width << (level + 1)) + (width << level), width << level)
    tensors["head.weight"] = rng.uniform(-0.5, 0.5, (classes, width, 1, 1))
    tensors["head.bias"] = rng.uniform(-0.5, 0.5, classes)
    return {name: value.astype(np.float32) for name, value in tensors.items()}


class WithNumpy:
    def __init__(self, tensors):
        self.tensors = {name: value.astype(np.float64) for name, value in tensors.items()}

    def block(self, name, number, x):
        weight = self.tensors[f"{name}.conv{number}.weight"]
        rows, columns = x.shape[1:]
        padded = np.pad(x, ((0, 0), (1, 1), (1, 1)))
        windows = np.stack([padded[:, r : r + rows, c : c + columns] for r in range(3) for c in range(3)], 1)
        y = np.einsum("oit,itrc->orc", weight.reshape(*weight.shape[:2], 9), windows)
        gain, bias, mean, variance = (
            self.tensors[f"{name}.norm{number}.{leaf}"][:, None, None]
            for leaf in ("weight", "bias", "running_mean", "running_var")
        )
        y = gain * (y - mean) / np.sqrt(variance + 1e-5) + bias
        return y / (1 + np.abs(y))

    def pool(self, x):
        return x.reshape(x.shape[0], x.shape[1] // 2, 2, x.shape[2] // 2, 2).max((2, 4))

    def join(self, coarse, own):
        return np.concatenate([coarse.repeat(2, 1).repeat(2, 2), own])

    def head(self, x):
        weight = self.tensors["head.weight"][:, :, 0, 0]
        return np.einsum("oi,irc->orc", weight, x) + self.tensors["head.bias"][:, None, None]

    def run(self, x, levels):
        x, kept = x.astype(np.float64), []
        for level in range(levels):
            x = self.pool(x) if level else x
            x = self.block(f"down.{level}", 2, self.block(f"down.{level}", 1, x))
            kept.append(x)
        for level in reversed(range(levels - 1)):
            x = self.join(x, kept[level])
            x = self.block(f"up.{level}", 2, self.block(f"up.{level}", 1, x))
        return self.head(x)


if torch:

    class Stage(torch.nn.Module):
        def __init__(self, source, target):
            super().__init__()
            self.conv1 = torch.nn.Conv2d(source, target, 3, padding=1, bias=False)
            self.norm1 = torch.nn.BatchNorm2d(target)
            self.conv2 = torch.nn.Conv2d(target, target, 3, padding=1, bias=False)
            self.norm2 = torch.nn.BatchNorm2d(target)

        def forward(self, x):
            x = torch.nn.functional.softsign(self.norm1(self.conv1(x)))
            return torch.nn.functional.softsign(self.norm2(self.conv2(x)))

    class UNet(torch.nn.Module):
        def __init__(self, inputs, classes, width, levels):
            super().__init__()
            channels = [width << level for level in range(levels)]
            sources = [inputs, *channels[:-1]]
            self.down = torch.nn.ModuleList(map(Stage, sources, channels))
            self.up = torch.nn.ModuleList(Stage(a + b, a) for a, b in zip(channels, channels[1:]))
            self.head = torch.nn.Conv2d(width, classes, 1)

        def forward(self, x):
            kept = []
            for level, stage in enumerate(self.down):
                x = stage(torch.nn.functional.max_pool2d(x, 2) if level else x)
                kept.append(x)
            for level in reversed(range(len(self.up))):
                x = torch.nn.functional.interpolate(x, scale_factor=2, mode="nearest")
                x = self.up[level](torch.cat([x, kept[level]], 1))
            return self.head(x)


def with_torch(tensors, image, levels):
    classes, width = tensors["head.weight"].shape[:2]
    net = UNet(tensors["down.0.conv1.weight"].shape[1], classes, width, levels)
    state = {name: torch.tensor(value) for name, value in tensors.items() if not name.startswith(("novelty.", "first."))}
    missing, unexpected = net.load_state_dict(state, strict=False)
    assert not unexpected and all(name.endswith("num_batches_tracked") for name in missing), (missing, unexpected)
    with torch.no_grad():
        return net.double().eval()(torch.tensor(image[None]).double())[0].numpy()


def write_fixture(folder):
    """A network in the form that PyTorch users have: trained there, with its state_dict written by the safetensors
    library."""
    from safetensors.torch import save_file

    torch.manual_seed(1)
    net = UNet(inputs=2, classes=3, width=4, levels=3)
    optimiser = torch.optim.Adam(net.parameters(), lr=1e-2)
    for _ in range(30):
        image = torch.randn(8, 2, 16, 24)
        # Labels to learn: where the first image is high, and where the second is low.
        truth = torch.where(image[:, 0] > 1, 2, torch.where(image[:, 1] < -1, 1, 0))
        optimiser.zero_grad()
        loss = torch.nn.functional.cross_entropy(net(image), truth)
        loss.backward()
        optimiser.step()
    print(f"loss {loss.item():.3f}")
    save_file(net.state_dict(), folder / "state_dict.safetensors")
    image = torch.randn(2, 16, 24)
    with torch.no_grad():
        logits = net.double().eval()(image[None].double())[0].float()
    save_file({"image": image, "logits": logits.contiguous()}, folder / "case.safetensors")


def forward(tensors, image, levels):
    return with_torch(tensors, image, levels) if torch else WithNumpy(tensors).run(image, levels)


def shipped(root):
    """Weights, architecture and image size of the shipped models."""
    for card in sorted((root / MODELS).glob("*.json")):
        card = json.loads(card.read_text())
        shape = [card["shape"][key] for key in ("inputs", "classes", "width", "levels")]
        yield read_safetensors(root / MODELS / card["weights"]), (*shape, card["rows"], card["columns"]), card["weights"]


def main():
    if sys.argv[1] == "--fixture":
        return write_fixture(pathlib.Path(sys.argv[2]))
    program, rng, worst = sys.argv[1], np.random.default_rng(1), 0.0
    made = (((1, 3, 8, 4, 64, 64), "random"), ((3, 3, 12, 3, 48, 32), "random"))
    cases = [(random_weights(rng, *shape[:4]), shape, name) for shape, name in made]
    cases += shipped(pathlib.Path(__file__).resolve().parent.parent)
    with tempfile.TemporaryDirectory() as place:
        folder = pathlib.Path(place)
        for tensors, (inputs, classes, width, levels, rows, columns), name in cases:
            image = rng.standard_normal((inputs, rows, columns)).astype(np.float32)
            write_safetensors(folder / "w.safetensors", tensors)
            image.astype("<f4").tofile(folder / "in")
            numbers = map(str, (inputs, classes, width, levels, rows, columns))
            files = [folder / "w.safetensors", *numbers, folder / "in", folder / "out", folder / "copy"]
            subprocess.run([program, *map(str, files)], check=True)
            found = np.fromfile(folder / "out", "<f4").reshape(classes, rows, columns)
            back = read_safetensors(folder / "copy")
            assert all((back[key] == value).all() for key, value in tensors.items()), "weights changed on the way"
            scale = np.abs(found).max()
            gap = max(np.abs(found - forward(source, image, levels)).max() for source in (tensors, back)) / scale
            print(f"{name}, width {width}, {levels} levels, {rows} x {columns}: largest difference {gap:.2e} of the largest logit")
            worst = max(worst, gap)
    print("compared with", f"PyTorch {torch.__version__}" if torch else f"NumPy {np.__version__}")
    # On these networks PyTorch's 32-bit results differ from its 64-bit ones by up to 1.0e-6.
    sys.exit(int(worst > 2e-6))


if __name__ == "__main__":
    main()
