"""ONNX Runtime on the networks of `crates/dermis-learn/benches/network.rs`: the same architecture with random weights,
norms folded into convolutions, one frame at a time, on one thread and on all. Before timing, its probabilities must
agree with NumPy's in double precision to 1e-5."""

import sys
from pathlib import Path

import numpy as np
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

from peer import report, timed

sys.path.append(str(Path(__file__).resolve().parents[2] / "scripts"))
from check_network import WithNumpy, random_weights  # noqa: E402

# Width and side, as in the bench.
CASES = ((8, 64), (8, 96), (16, 64))
INPUTS, CLASSES, LEVELS = 1, 3, 4
EPSILON = 1e-5


class Graph:
    """An ONNX graph of the network, built up node by node."""

    def __init__(self, tensors):
        self.tensors, self.nodes, self.constants, self.count = tensors, [], [], 0

    def constant(self, value):
        self.count += 1
        self.constants.append(numpy_helper.from_array(value, f"c{self.count}"))
        return f"c{self.count}"

    def node(self, kind, *inputs, **attributes):
        self.count += 1
        self.nodes.append(helper.make_node(kind, list(inputs), [f"n{self.count}"], **attributes))
        return f"n{self.count}"

    def block(self, name, number, x):
        gain, bias, mean, variance = (
            self.tensors[f"{name}.norm{number}.{leaf}"] for leaf in ("weight", "bias", "running_mean", "running_var")
        )
        gain = gain / np.sqrt(variance + EPSILON)
        weight = self.tensors[f"{name}.conv{number}.weight"] * gain[:, None, None, None]
        x = self.node("Conv", x, self.constant(weight), self.constant(bias - mean * gain), pads=[1] * 4, kernel_shape=[3, 3])
        return self.node("Softsign", x)

    def stage(self, name, x):
        return self.block(name, 2, self.block(name, 1, x))

    def network(self):
        x, kept = "image", []
        for level in range(LEVELS):
            x = self.node("MaxPool", x, kernel_shape=[2, 2], strides=[2, 2]) if level else x
            x = self.stage(f"down.{level}", x)
            kept.append(x)
        for level in reversed(range(LEVELS - 1)):
            scales = self.constant(np.array([1, 1, 2, 2], np.float32))
            x = self.node("Resize", x, "", scales, mode="nearest", coordinate_transformation_mode="asymmetric", nearest_mode="floor")
            x = self.stage(f"up.{level}", self.node("Concat", x, kept[level], axis=1))
        x = self.node("Conv", x, self.constant(self.tensors["head.weight"]), self.constant(self.tensors["head.bias"]), kernel_shape=[1, 1])
        return self.node("Softmax", x, axis=1)


def session(tensors, side, threads):
    graph = Graph(tensors)
    output = graph.network()
    value = lambda name, channels: helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, channels, side, side])
    whole = helper.make_graph(graph.nodes, "unet", [value("image", INPUTS)], [value(output, CLASSES)], graph.constants)
    model = helper.make_model(whole, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    options = onnxruntime.SessionOptions()
    # 0: as many as there are cores.
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])


def main():
    rng = np.random.default_rng(1)
    for width, side in CASES:
        tensors = random_weights(rng, INPUTS, CLASSES, width, LEVELS)
        image = rng.normal(size=(INPUTS, side, side)).astype(np.float32)
        logits = WithNumpy(tensors).run(image, LEVELS)
        expected = np.exp(logits - logits.max(0))
        expected /= expected.sum(0)
        for threads, peer in ((1, "ONNX Runtime"), (0, "ONNX Runtime, all cores")):
            run = session(tensors, side, threads)
            found = run.run(None, {"image": image[None]})[0][0]
            worst = np.abs(found - expected).max()
            assert worst < 1e-5, worst
            case = f"network, width {width}, {side} x {side}"
            report(peer, case, timed(lambda: run.run(None, {"image": image[None]})), difference=float(worst))


main()
