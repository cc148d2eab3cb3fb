"""Pack the networks that find people, out of MediaPipe's packages into safetensors files that plain torch runs.

    python scripts/pack_detector.py [FOLDER]

FOLDER holds the wheel of ``pip download --no-deps mediapipe==0.10.21`` (35 MB) and the package of ``npm pack
@mediapipe/pose@0.5.1675469404`` (41 MB); without it, both are fetched. Needs the package ``tflite``, which reads the
networks' files. Graphs come out in torch's layout, channels first, with the zeros around pictures as numbers, and
without outputs that nobody reads. No number of ``people_detector`` is changed: weights are float16 there, too, and
zeros of the pruned detector are left out here, too. Of ``heavy_landmarks``, large convolutions of 1 x 1, which hold
nearly all of its weights, have 8 bits a weight and a scale for each output channel; layers by channel, heads and small
layers, in which 8 bits cost most, stay in float16.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tflite
import torch
from safetensors.numpy import save

from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.lab.harness import run_script
from warp_partdr.networks.detection.crops import Pyramid, cut_crops
from warp_partdr.networks.detection.graph import Node, OperatorGraph
from warp_partdr.networks.detection.people import find_people

ASSETS = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets"
EXAMPLE = ASSETS / "example" / "photo.png"
FORMAT = "warp-partdr people detector 1"


@dataclass(frozen=True)
class Source:
    """A package with networks, and the file that they become.

    Attributes:
        package: Name and version.
        pattern: Pattern of its file's name.
        fetch: Command that writes the file into the folder where it runs.
        target: Name of the file in ``assets``.
        networks: Files of the networks in the package by name, with the names of their outputs in their order there.
            None drops an output.
        short: True if large convolutions of 1 x 1 get 8 bits a weight.
    """

    package: str
    pattern: str
    fetch: tuple[str, ...]
    target: str
    networks: dict[str, tuple[str, tuple[str | None, ...]]]
    short: bool = False

    def files(self, folder: Path) -> dict[str, bytes]:
        """Contents of the networks' files, by the networks' names; the package is fetched if the folder lacks it."""
        if not list(folder.glob(self.pattern)):
            subprocess.run(self.fetch, check=True, cwd=folder)
        (path,) = folder.glob(self.pattern)
        if path.suffix == ".whl":
            with zipfile.ZipFile(path) as wheel:
                return {name: wheel.read(file) for name, (file, _) in self.networks.items()}
        with tarfile.open(path) as package:
            found = {name: package.extractfile(file) for name, (file, _) in self.networks.items()}
            return {name: file.read() for name, file in found.items() if file is not None}


SOURCES = (
    Source(
        "mediapipe==0.10.21",
        "mediapipe-0.10.21-*.whl",
        (sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "mediapipe==0.10.21"),
        "people_detector.safetensors",
        {
            "detector": ("mediapipe/modules/pose_detection/pose_detection.tflite", ("boxes", "scores")),
            "landmarks": (
                "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
                ("landmarks", "presence", "mask", "heat", None),  # and landmarks in metres
            ),
        },
    ),
    Source(
        "@mediapipe/pose@0.5.1675469404",
        "mediapipe-pose-0.5.1675469404.tgz",
        ("npm", "pack", "@mediapipe/pose@0.5.1675469404"),
        "heavy_landmarks.safetensors",
        {"heavy": ("package/pose_landmark_heavy.tflite", ("landmarks", None, None, "heat", None))},
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
SPARSE = 0.7  # Weights with a smaller share of non-zeros are stored as these and a mask of bits.
OPERATORS = {value: name for name, value in vars(tflite.BuiltinOperator).items() if isinstance(value, int)}
CONVOLUTIONS = ("CONV_2D", "DEPTHWISE_CONV_2D")

Operator = dict[str, Any]


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
            "zeros": same_zeros(source, inputs[0], kernel, found),
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
            tensors |= stored(key, values)
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


def sort_header(content: bytes) -> bytes:
    """A safetensors file with its header in order, which otherwise changes from run to run."""
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8:start]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + content[start:]


def pack(source: Source, folder: Path) -> None:
    """Write the file of a package's networks, which the folder holds or gets."""
    graphs, tensors = {}, {}
    for name, content in source.files(folder).items():
        graphs[name], weights = read_graph(content, source.networks[name][1])
        if source.short:
            own = stored_short(graphs[name], weights)
        else:
            own = {key: each for whole, values in weights.items() for key, each in stored(whole, values).items()}
        tensors |= {f"{name}/{key}": values for key, values in own.items()}
        print(name, dict(Counter(node["kind"] for node in graphs[name]["nodes"])))
    about = f"Weights of {source.package} (Apache-2.0, Google), repacked by scripts/pack_detector.py"
    target = ASSETS / source.target
    content = save(tensors, {"format": FORMAT, "graphs": json.dumps(graphs), "about": about})
    target.write_bytes(sort_header(content))
    print(f"{target.name}: {target.stat().st_size / 1e6:.2f} MB, {len(tensors)} tensors")


def main(folder: Path | None = None, /) -> None:
    """Pack all networks.

    Args:
        folder: Folder that holds their files, or for those that are fetched; by default a temporary one.
    """
    with tempfile.TemporaryDirectory() as fetched:
        for source in SOURCES:
            pack(source, folder or Path(fetched))


if __name__ == "__main__":
    run_script(main)
