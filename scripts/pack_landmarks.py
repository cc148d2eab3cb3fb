"""Pack the landmark networks, out of MediaPipe's packages into safetensors files that plain torch runs.

    python scripts/pack_landmarks.py [FOLDER]

FOLDER holds the wheel of ``pip download --no-deps mediapipe==0.10.21`` (35 MB) and the package of ``npm pack
@mediapipe/pose@0.5.1675469404`` (41 MB); without it, both are fetched. Needs the package ``tflite``, which reads the
networks' files. Graphs come out in torch's layout, channels first, with the zeros around pictures as numbers, and
without outputs that nobody reads. No number of ``full_landmarks`` is changed: weights are float16 there, too. Of
``heavy_landmarks``, large convolutions of 1 x 1, which hold nearly all of its weights, have 8 bits a weight and a scale
for each output channel; layers by channel, heads and small layers, in which 8 bits cost most, stay in float16.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tflite
import torch
from packed_graphs import ASSETS, Operator, Package, same_zeros, write_graphs

from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.lab.harness import run_script
from warp_partdr.networks.detection.crops import Pyramid, cut_crops
from warp_partdr.networks.detection.graph import Node, OperatorGraph
from warp_partdr.networks.detection.people import find_people

EXAMPLE = ASSETS / "example" / "photo.png"


@dataclass(frozen=True)
class Source:
    """A package with a network, and the file that it becomes.

    Attributes:
        package: The package.
        target: Name of the file in ``assets``.
        name: Name of the network.
        file: File of the network in the package.
        outputs: Names of the network's outputs in their order. None drops an output.
        short: True if large convolutions of 1 x 1 get 8 bits a weight.
    """

    package: Package
    target: str
    name: str
    file: str
    outputs: tuple[str | None, ...]
    short: bool = False


SOURCES = (
    Source(
        Package(
            "mediapipe==0.10.21",
            "mediapipe-0.10.21-*.whl",
            (sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "mediapipe==0.10.21"),
        ),
        "full_landmarks.safetensors",
        "landmarks",
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
        ("landmarks", "presence", "mask", "heat", None),  # and landmarks in metres
    ),
    Source(
        Package(
            "@mediapipe/pose@0.5.1675469404",
            "mediapipe-pose-0.5.1675469404.tgz",
            ("npm", "pack", "@mediapipe/pose@0.5.1675469404"),
        ),
        "heavy_landmarks.safetensors",
        "heavy",
        "package/pose_landmark_heavy.tflite",
        ("landmarks", None, None, "heat", None),
        short=True,
    ),
)
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
LARGE = 2**15  # weights of a convolution of 1 x 1 from which on 8 bits are enough for each, where they are few
OPERATORS = {value: name for name, value in vars(tflite.BuiltinOperator).items() if isinstance(value, int)}
CONVOLUTIONS = ("CONV_2D", "DEPTHWISE_CONV_2D")


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
        if tensor.Sparsity() is not None:
            raise SystemExit(f"{tensor.Name().decode()}: sparse; expected dense weights")
        return values.reshape(tensor.ShapeAsNumpy() if tensor.ShapeLength() else ())

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


def read_graph(content: bytes, names: tuple[str | None, ...]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Graph and weights of a .tflite file; numbers name values, and a node's output names its weights too."""
    source = TfliteGraph(content)
    nodes: list[Operator] = []
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


def read_operator(source: TfliteGraph, name: str, inputs: list[int], output: int, table: Any) -> Operator:
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
            "zeros": zeros_around(source, inputs[0], kernel, found),
            "activation": ACTIVATIONS[found.FusedActivationFunction()],
        }
    if name == "PAD":
        batch, rows, columns, channels = constant[inputs[1]]
        if batch == rows == columns == [0, 0] and channels[0] == 0:
            return {"kind": "more_channels", "inputs": inputs[:1], "size": channels[1]}
        if batch != [0, 0] or channels != [0, 0]:
            raise SystemExit(f"PAD {output}: {constant[inputs[1]]}; expected zeros around pictures, or more channels")
        return {"kind": "pad", "inputs": inputs[:1], "zeros": [*columns, *rows]}
    if name == "ADD":
        activation = ACTIVATIONS[options(tflite.AddOptions).FusedActivationFunction()]
        return {"kind": "add", "inputs": inputs, "activation": activation}
    if name == "MAX_POOL_2D":
        found = options(tflite.Pool2DOptions)
        size = found.FilterHeight()
        if any(zeros_around(source, inputs[0], [size, size], found)) or {size, found.FilterWidth()} != {
            found.StrideH()
        }:
            raise SystemExit(f"MAX_POOL_2D {output}: expected squares side by side")
        return {"kind": "max_pool", "inputs": inputs, "size": size}
    if name == "RESIZE_BILINEAR":
        found = options(tflite.ResizeBilinearOptions)
        if found.AlignCorners() or not found.HalfPixelCenters():
            raise SystemExit(f"RESIZE_BILINEAR {output}: expected pixel centres at halves")
        return {"kind": "resize", "inputs": inputs[:1], "size": constant[inputs[1]]}
    if name == "LOGISTIC":
        return {"kind": "sigmoid", "inputs": inputs}
    if name == "RESHAPE":
        return {"kind": "rows", "inputs": inputs[:1], "shape": source.shape(output)[1:]}
    raise SystemExit(f"{name} {output}: not known here")


def zeros_around(source: TfliteGraph, index: int, kernel: list[int], options: Any) -> list[int]:
    """Zeros left, right, above and below a value before windows of a size; none with padding "valid"."""
    if options.Padding() != tflite.Padding.SAME:
        return [0, 0, 0, 0]
    _, height, width, _ = source.shape(index)
    return same_zeros((height, width), (kernel[0], kernel[1]), (options.StrideH(), options.StrideW()))


def used(nodes: list[Operator], wanted: set[int]) -> list[Operator]:
    """Nodes that the wanted outputs need."""
    kept = []
    for node in reversed(nodes):
        if node["output"] in wanted:
            wanted = wanted | set(node["inputs"])
            kept.append(node)
    return kept[::-1]


def without_pads(nodes: list[Operator]) -> list[Operator]:
    """Nodes among which convolutions do the pads of zeros that stood before them."""
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


def eight_bits(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights as whole numbers from -127 to 127, and what each output channel's 1 stands for."""
    weights = np.ascontiguousarray(weights, dtype=np.float32)
    scale = np.maximum(np.abs(weights).max(axis=(1, 2, 3)) / 127, np.finfo(np.float32).tiny)
    return np.rint(weights / scale[:, None, None, None]).astype(np.int8), scale


def stored_short(graph: dict[str, Any], weights: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Tensors of the file for a network's arrays, large convolutions of 1 x 1 in 8 bits.

    What the rounded weights add to a layer's mean result, for the mean of its input in the packaged example, is taken
    off its bias: this leaves a third of the landmarks' error by rounding.
    """
    inputs = mean_inputs(graph, weights)
    tensors: dict[str, np.ndarray] = {}
    for key, values in weights.items():
        number, _, role = key.partition(".")
        kernel = weights[f"{number}.weight"]
        if kernel.shape[2:] != (1, 1) or kernel.size < LARGE:
            tensors[key] = values
            continue
        whole, scale = eight_bits(kernel)
        if role == "weight":
            tensors |= {f"{key}.int8": whole, f"{key}.scale": scale}
        else:
            missing = kernel[..., 0, 0].astype(np.float32) - whole[..., 0, 0] * scale[:, None]
            tensors[key] = (values + missing @ inputs[number]).astype(np.float16)
    return tensors


def mean_inputs(graph: dict[str, Any], weights: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Mean of each channel of each convolution's input, by the convolution's number, of the packaged example."""
    nodes = [Node.from_json(node) for node in graph["nodes"]]
    tensors = {name: torch.from_numpy(values.copy()) for name, values in weights.items()}
    inputs = {str(node.output): node.inputs[0] for node in nodes if node.kind == "convolution"}
    photo = read_photo(EXAMPLE)
    (person,) = find_people(photo)
    picture = cut_crops([Pyramid(photo, "cpu")], person.crop, graph["size"], beyond="border")
    said = OperatorGraph(graph["size"], graph["input"], inputs, nodes, tensors)(picture)
    return {number: values.mean(dim=(0, 2, 3)).numpy() for number, values in said.items()}


def pack(source: Source, folder: Path) -> None:
    """Write the file of a package's network, which the folder holds or gets."""
    content = source.package.read(folder, {source.name: source.file})[source.name]
    graph, weights = read_graph(content, source.outputs)
    tensors = stored_short(graph, weights) if source.short else weights
    write_graphs(
        source.target,
        {source.name: graph},
        {f"{source.name}/{key}": values for key, values in tensors.items()},
        f"Weights of {source.package.name} (Apache-2.0, Google), repacked by scripts/pack_landmarks.py",
    )


def main(folder: Path | None = None, /) -> None:
    """Pack both networks.

    Args:
        folder: Folder that holds their files, or for those that are fetched; by default a temporary one.
    """
    with tempfile.TemporaryDirectory() as fetched:
        for source in SOURCES:
            pack(source, folder or Path(fetched))


if __name__ == "__main__":
    run_script(main)
