#!/usr/bin/env python3
"""Trains a network on a training set with PyTorch on the CPU, in 16-bit arithmetic if that is faster.

    python3 scripts/train_network.py SET... STATE.safetensors --width 16 --passes 20

Several sets of the same images may be given; every tenth shard is held out. Weights are averaged over the last steps
(Polyak & Juditsky, SIAM J. Control Optim. 30, 1992). The output is a state_dict, and next to it `STATE.scale` with
the factors that images were multiplied by; `dermis train --weights STATE.safetensors --epochs 0 --input-scale
FACTORS` turns it into a model. Needs torch and safetensors.
"""

import argparse
import json
import math
import time
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import nn

from check_network import UNet


class Shards:
    """Images and labels in the shards of several sets; every tenth shard is held out. Sets may grow in the
    meantime."""

    def __init__(self, folders):
        self.folders, self.known, self.parts = folders, set(), ([], [])
        self.classes = len(json.loads((folders[0] / "manifest.json").read_text())["classes"])

    def read(self):
        """The current data: images and labels for training, and those held out."""
        for shard in sorted(shard for folder in self.folders for shard in folder.glob("shard-*.safetensors")):
            if shard not in self.known:
                self.known.add(shard)
                read = load_file(shard)
                is_held_out = int(shard.stem.split("-")[1]) % 10 == 9
                self.parts[is_held_out].append((read["inputs"].bfloat16(), read["labels"]))
        return [[torch.cat([part[k] for part in side]) for k in (0, 1)] for side in self.parts]


def turned(images, labels, random):
    """The batch rotated and mirrored, each half differently."""
    out = []
    for part in zip(images.chunk(2), labels.chunk(2)):
        turns, mirror = torch.randint(0, 4, (1,), generator=random).item(), torch.rand(1, generator=random).item() < 0.5
        part = [torch.rot90(tensor, turns, (-2, -1)) for tensor in part]
        out.append([tensor.flip(-1) for tensor in part] if mirror else part)
    return [torch.cat([part[k] for part in out]) for k in (0, 1)]


def judged(network, images, labels, scale, batch=64):
    """Mean cross-entropy."""
    network.eval()
    loss = 0.0
    with torch.no_grad():
        for start in range(0, len(images), batch):
            logits = network(images[start : start + batch].float() * scale)
            loss += nn.functional.cross_entropy(logits, labels[start : start + batch].long(), reduction="sum").item()
    return loss / labels.numel()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--width", type=int, default=16)
    parser.add_argument("--levels", type=int, default=4)
    parser.add_argument("--passes", type=int, default=20)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=math.inf, help="the step falls to nothing by then")
    parser.add_argument("--start", type=Path, help="a model card to begin with; further images count for nothing at first")
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    random = torch.Generator().manual_seed(options.seed)
    shards = Shards(options.sets)
    (images, _), _ = shards.read()
    square = torch.stack([part.float().square().mean((0, 2, 3)) for part in images.split(1000)]).mean(0)
    scale = square.sqrt().clamp_min(1e-30).reciprocal()[None, :, None, None]
    network = UNet(images.shape[1], shards.classes, options.width, options.levels)
    if options.start:
        card = json.loads(options.start.read_text())
        known = torch.tensor(card["input_scale"])
        scale[0, : len(known), 0, 0] = known
        state = load_file(options.start.with_name(card["weights"]))
        kernel = torch.zeros_like(network.down[0].conv1.weight)
        kernel[:, : len(known)] = state["down.0.conv1.weight"]
        state["down.0.conv1.weight"] = kernel
        named = network.state_dict()
        network.load_state_dict({name: value for name, value in state.items() if name in named}, strict=False)
    network = network.to(memory_format=torch.channels_last)
    average = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.998), use_buffers=True
    )
    optimiser = torch.optim.AdamW(network.parameters(), lr=options.learning_rate, weight_decay=1e-3)
    steps, begun, step = options.passes * (len(images) // options.batch), time.time(), 0
    while step < steps:
        (images, labels), (held_images, held_labels) = shards.read()
        network.train()
        order, total, count = torch.randperm(len(images), generator=random), 0.0, 0
        for chosen in order.split(options.batch):
            done = max(step / steps, (time.time() - begun) / (60.0 * options.minutes))
            if len(chosen) < options.batch or done >= 1.0:
                break
            rate = options.learning_rate * min(1.0, step / 200 + 0.05) * 0.5 * (1.0 + math.cos(math.pi * done))
            optimiser.param_groups[0]["lr"] = rate + 1e-6
            batch, truth = turned(images[chosen], labels[chosen], random)
            batch = (batch.float() * scale).to(memory_format=torch.channels_last)
            with torch.autocast("cpu", dtype=torch.bfloat16):
                logits = network(batch)
            loss = nn.functional.cross_entropy(logits.float(), truth.long())
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            average.update_parameters(network)
            total, count, step = total + loss.item(), count + 1, step + 1
        state = {name: value.float().contiguous() for name, value in average.module.state_dict().items()
                 if not name.endswith("num_batches_tracked")}
        save_file(state, options.out)
        Path(f"{options.out.with_suffix('')}.scale").write_text(",".join(f"{v:.8g}" for v in scale.flatten().tolist()))
        held = judged(average.module, held_images, held_labels, scale)
        print(f"{time.time() - begun:.0f} s, {len(images)} samples, step {step}: loss {total / max(count, 1):.5f}, "
              f"held out {held:.5f}", flush=True)
        if done >= 1.0:
            break


if __name__ == "__main__":
    main()
