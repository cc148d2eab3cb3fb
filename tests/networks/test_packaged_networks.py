"""The packaged networks: their file, and the same numbers as Google's runtime says from the original files."""

from __future__ import annotations

import os
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.example import example_photo
from safetensors.numpy import save_file

import warp_partdr
from warp_partdr.errors import InputError
from warp_partdr.networks.detection.asset import load_heavy_landmarks, load_people_networks, packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid, cut_crops
from warp_partdr.networks.detection.detector import tiles
from warp_partdr.networks.detection.look import read_landmarks
from warp_partdr.networks.detection.people import find_people

WHEEL_VARIABLE, PACKAGE_VARIABLE = "PARTDR_MEDIAPIPE_WHEEL", "PARTDR_MEDIAPIPE_POSE"
HEAVY_FILE = "package/pose_landmark_heavy.tflite"
FULL_FILE = "mediapipe/modules/pose_landmark/pose_landmark_full.tflite"
FULL_OUTPUTS = ("landmarks", "presence", "mask", "heat")
ASSETS = Path(warp_partdr.__file__).parent / "assets"


def test_the_file_is_small_and_its_licence_lies_beside_it():
    assert (ASSETS / "people_detector.safetensors").stat().st_size < 10e6
    assert (ASSETS / "full_landmarks.safetensors").stat().st_size < 6.5e6
    assert (ASSETS / "heavy_landmarks.safetensors").stat().st_size < 15.5e6
    licence = (ASSETS / "people_detector.LICENSE.txt").read_text()
    for name in ("people_detector", "full_landmarks", "heavy_landmarks"):
        assert f"{name}.safetensors" in licence
    assert "This model\nfollows Apache 2.0." in licence
    assert "Apache License" in licence
    assert "Apache-2.0" in (ASSETS / "people_detector.md").read_text()


def test_outputs_have_their_shapes(device):
    networks = packaged_people_networks(device)
    assert networks.device.type == device
    said = networks.detector(torch.zeros(3, 3, 256, 256, device=device))
    channels = {"centre": 1, "size": 2, "centre_offset": 2, "heat": 17, "keypoints": 34, "keypoint_offset": 34}
    assert {name: tuple(values.shape) for name, values in said.items()} == {
        name: (3, number, 64, 64) for name, number in channels.items()
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


def test_google_s_runtime_says_the_same(tmp_path):
    """On the example's picture, places agree to 0.01 px, and probabilities to a part in a thousand."""
    interpreter = pytest.importorskip("ai_edge_litert.interpreter", reason="needs ai-edge-litert, Google's runtime")
    wheel = os.environ.get(WHEEL_VARIABLE)
    if not wheel:
        pytest.skip(f"needs {WHEEL_VARIABLE}, the path of MediaPipe's wheel (pip download mediapipe==0.10.21)")
    with zipfile.ZipFile(wheel) as archive:
        (tmp_path / "network.tflite").write_bytes(archive.read(FULL_FILE))
    network = packaged_people_networks("cpu").landmarks
    picture = example_photo()
    cut = cut_crops([Pyramid(picture, "cpu")], tiles(picture.shape[:2], 0), network.size)
    said, results = network(cut), run_google(interpreter, tmp_path / "network.tflite", cut)
    for output, theirs in zip(FULL_OUTPUTS, results, strict=False):  # the last one isn't packaged
        ours = said[output]
        if output == "landmarks":
            torch.testing.assert_close(ours, theirs, atol=0.01, rtol=0)
        else:
            torch.testing.assert_close(ours.sigmoid(), theirs.sigmoid(), atol=1e-3, rtol=0)


def run_google(interpreter: Any, path: Path, pictures: torch.Tensor) -> list[torch.Tensor]:
    """Results of Google's runtime for one picture, channels first."""
    google = interpreter.Interpreter(str(path), num_threads=1)
    google.allocate_tensors()
    google.set_tensor(google.get_input_details()[0]["index"], pictures.permute(0, 2, 3, 1).contiguous().numpy())
    google.invoke()
    found = [torch.from_numpy(google.get_tensor(about["index"]).copy()) for about in google.get_output_details()]
    return [each.permute(0, 3, 1, 2) if each.dim() == 4 else each for each in found]


def test_the_heavy_network_in_8_bits_says_about_what_google_s_runtime_says(tmp_path):
    """On the example's person, landmarks agree to 0.5 px of 256 on average, and visibility to 0.02."""
    interpreter = pytest.importorskip("ai_edge_litert.interpreter", reason="needs ai-edge-litert, Google's runtime")
    package = os.environ.get(PACKAGE_VARIABLE)
    if not package:
        pytest.skip(f"needs {PACKAGE_VARIABLE}, the file of npm pack @mediapipe/pose@0.5.1675469404")
    with tarfile.open(package) as archive:
        content = archive.extractfile(HEAVY_FILE)
        assert content is not None
        (tmp_path / "network.tflite").write_bytes(content.read())
    picture = example_photo()
    (person,) = find_people(picture)
    cut = cut_crops([Pyramid(picture, "cpu")], person.crop, 256, beyond="border")
    landmarks, _, _, heat, _ = run_google(interpreter, tmp_path / "network.tflite", cut)
    expected = read_landmarks({"landmarks": landmarks, "heat": heat}, 256)[0, :35]
    found = read_landmarks(load_heavy_landmarks()(cut), 256)[0, :35]
    assert 256 * float((found - expected)[:, :2].norm(dim=1).mean()) < 0.5
    assert float((found - expected)[:33, 3:].abs().mean()) < 0.02
