"""The packaged networks: their file, and the same numbers as Google's runtime says from the original files."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file
from scenes.files import EXAMPLE

import warp_partdr
from warp_partdr import read_photo
from warp_partdr.detection.asset import load_people_networks, packaged_people_networks
from warp_partdr.detection.crops import Pyramid, cut_crops
from warp_partdr.detection.detector import tiles
from warp_partdr.errors import InputError

WHEEL_VARIABLE = "PARTDR_MEDIAPIPE_WHEEL"
FILES = {
    "detector": ("mediapipe/modules/pose_detection/pose_detection.tflite", ("boxes", "scores")),
    "landmarks": (
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
        ("landmarks", "presence", "mask", "heat"),
    ),
}
ASSETS = Path(warp_partdr.__file__).parent / "assets"


def test_the_file_is_small_and_its_licence_lies_beside_it():
    assert (ASSETS / "people_detector.safetensors").stat().st_size < 10e6
    assert "Apache License" in (ASSETS / "people_detector.LICENSE.txt").read_text()
    assert "Apache-2.0" in (ASSETS / "people_detector.md").read_text()


def test_outputs_have_their_shapes(device):
    networks = packaged_people_networks(device)
    assert networks.device.type == device
    said = networks.detector(torch.zeros(3, 3, 224, 224, device=device))
    assert {name: tuple(values.shape) for name, values in said.items()} == {
        "boxes": (3, 2254, 12),
        "scores": (3, 2254, 1),
    }
    said = networks.landmarks(torch.zeros(2, 3, 256, 256, device=device))
    assert {name: tuple(values.shape) for name, values in said.items()} == {
        "landmarks": (2, 195),
        "presence": (2, 1),
        "mask": (2, 1, 256, 256),
        "heat": (2, 39, 64, 64),
    }


def test_a_batch_says_what_each_picture_says(device):
    network = packaged_people_networks(device).landmarks
    pictures = torch.rand(3, 3, 256, 256, device=device)
    together = network(pictures)["landmarks"]
    for row in range(3):
        torch.testing.assert_close(network(pictures[row : row + 1])["landmarks"][0], together[row], atol=0.5, rtol=1e-2)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.safetensors: No such file"):
        load_people_networks(tmp_path / "none.safetensors")
    path = tmp_path / "other.safetensors"
    path.write_bytes(b"not a network")
    with pytest.raises(InputError, match=r"expected a file of scripts/pack_detector"):
        load_people_networks(path)
    save_file({"x": np.zeros(3)}, path, {"format": "something"})
    with pytest.raises(InputError, match=r"format 'something'"):
        load_people_networks(path)
    save_file({"x": np.zeros(3)}, path, {"format": "warp-partdr people detector 1", "graphs": "[]"})
    with pytest.raises(InputError, match=r"other\.safetensors"):
        load_people_networks(path)


@pytest.mark.parametrize("name", FILES)
def test_google_s_runtime_says_the_same(name, tmp_path):
    """Of the example's picture: places to 0.01 px, probabilities to a part in a thousand."""
    interpreter = pytest.importorskip("ai_edge_litert.interpreter", reason="needs ai-edge-litert, Google's runtime")
    wheel = os.environ.get(WHEEL_VARIABLE)
    if not wheel:
        pytest.skip(f"needs {WHEEL_VARIABLE}, the path of MediaPipe's wheel (pip download mediapipe==0.10.21)")
    path, outputs = FILES[name]
    with zipfile.ZipFile(wheel) as archive:
        (tmp_path / "network.tflite").write_bytes(archive.read(path))
    network = getattr(packaged_people_networks("cpu"), name)
    picture = read_photo(EXAMPLE / "photo.png")
    cut = cut_crops([Pyramid(picture, "cpu")], tiles(picture.shape[:2], 1, 1), network.size)
    cut = cut * 2 - 1 if name == "detector" else cut
    google = interpreter.Interpreter(str(tmp_path / "network.tflite"), num_threads=1)
    google.allocate_tensors()
    google.set_tensor(google.get_input_details()[0]["index"], cut.permute(0, 2, 3, 1).contiguous().numpy())
    google.invoke()
    said = network(cut)
    for output, about in zip(outputs, google.get_output_details(), strict=False):  # the last one isn't packaged
        ours, theirs = said[output], torch.from_numpy(google.get_tensor(about["index"]).copy())
        theirs = theirs.permute(0, 3, 1, 2) if theirs.dim() == 4 else theirs
        if output in ("boxes", "landmarks"):
            torch.testing.assert_close(ours, theirs, atol=0.01, rtol=0)
        else:
            torch.testing.assert_close(ours.sigmoid(), theirs.sigmoid(), atol=1e-3, rtol=0)
