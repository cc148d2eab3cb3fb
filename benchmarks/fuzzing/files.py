"""Files, whole and damaged."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from safetensors.numpy import save

from fuzzing.case import Case
from fuzzing.fits import person
from warp_partdr import label_set
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.part_labels import read_parts, read_photo
from warp_partdr.models import smpl
from warp_partdr.models.load import load_model
from warp_partdr.networks.regression.checkpoint import load_label_network, save_label_network
from warp_partdr.networks.regression.label_network import NUM_CHANNELS, LabelNetwork, LabelNetworkConfig
from warp_partdr.networks.regression.landmarks import LANDMARKS
from warp_partdr.networks.regression.regressor import RegressorConfig
from warp_partdr.results.body_file import FORMAT, load_body

SMALL_NETWORK = LabelNetworkConfig(
    size=64, channels=(4, 8, 8, 8, 8), places=2, keypoint_features=8, regressor=RegressorConfig(width=16)
)


def saved(write: Callable[[io.BytesIO], Any]) -> bytes:
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


BODY_FILE: dict[str, np.ndarray] = {
    "global_orient": np.eye(3, dtype=np.float32),
    "translation": np.zeros(3, dtype=np.float32),
    "rotations": np.tile(np.eye(3, dtype=np.float32), (20, 1, 1)),
    "lengths": np.linspace(0.2, 0.5, 12, dtype=np.float32),
    "thicknesses": np.linspace(0.1, 0.2, 15, dtype=np.float32),
    "camera_scale": np.array(100.0, dtype=np.float32),
    "camera_translation": np.array([20.0, 30.0], dtype=np.float32),
    "image_size": np.array([96, 80]),
    "camera_perspective": np.array(0),
}


def try_body_file(case: Case) -> Any:
    arrays = {name: case.array(value) for name, value in BODY_FILE.items()} if case.happens(5) else BODY_FILE
    data = saved(lambda file: np.savez(file, format=np.array(FORMAT), **arrays))
    loaded = load_body(case.file("body.npz", data))
    return vars(loaded), loaded.camera(), loaded.body("cpu").numpy()


def try_keypoint_file(case: Case) -> Any:
    rows = [[*map(float, point), 0.9] for point in person(case.device)[0].points]
    flat = [number for row in rows for number in row]
    data = case.one(
        [
            {"format": "coco17", "keypoints": rows},
            {"people": [{"pose_keypoints_2d": flat + flat[:24]}]},
            {"annotations": [{"keypoints": flat, "image_id": 1}]},
            [{"keypoints": [row[:2] for row in rows], "keypoint_scores": [0.5] * 17}],
            rows,
            [rows, rows],
        ]
    )
    text, path = json.dumps(case.json(data)).encode(), case.folder / "keypoints.json"
    path.write_bytes(text)
    if case.happens(4):
        path = case.file(path.name, text)
    people = read_keypoints(path, case.either(None, "coco17", "lsp", "x"))
    return [(one.points, one.confidence) for one in people]


def try_part_file(case: Case) -> Any:
    labels = case.array(person(case.device)[1])
    if case.happens(5):
        image = Image.fromarray(person(case.device)[1])
        kind = case.either("png", "png", "jpeg", "gif")
        path = case.file("parts.png", saved(lambda file: image.save(file, kind)))
    else:
        if case.happens(3):
            maps = np.moveaxis(np.eye(21, dtype=np.float32)[person(case.device)[1][::8, ::8]], -1, 0)
            labels = case.array(maps)
        pickled = case.spoils()
        data = saved(lambda file: np.save(file, np.array([{}]) if pickled else labels, allow_pickle=True))
        path = case.file("parts.npy", data)
    parts = read_parts(path, label_set(case.one(["ellipbody20", "ellipbody20", "lsp6"])))
    return parts.groups, parts.maps


def try_photo(case: Case) -> Any:
    image = Image.fromarray(case.rng.integers(0, 256, (6, 5, 3)).astype(np.uint8))
    kind = case.one(["png", "jpeg", "webp", "tiff", "bmp"])
    return read_photo(case.file(f"photo.{kind}", saved(lambda file: image.save(file, kind))))


@lru_cache
def smpl_arrays() -> dict[str, np.ndarray]:
    """A made-up model of a few vertices, of SMPL's layout."""
    rng = np.random.default_rng(0)
    joints, vertices, faces = 24, 60, 30
    parents = np.array([-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21])
    weights = rng.random((vertices, joints))
    return {
        "v_template": rng.normal(size=(vertices, 3)),
        "shapedirs": rng.normal(size=(vertices, 3, 10)),
        "posedirs": rng.normal(size=(vertices, 3, 9 * (joints - 1))),
        "J_regressor": rng.dirichlet(np.ones(vertices), joints),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.stack([parents, np.arange(joints)]),
        "f": rng.integers(0, vertices, (faces, 3)),
    }


def try_model_file(case: Case) -> Any:
    arrays = {name: case.array(value) for name, value in smpl_arrays().items() if not case.spoils()}
    assert set(smpl.ARRAYS) >= set(arrays)
    kind = case.one(["npz", "npz", "safetensors"])
    if kind == "npz":
        data = saved(lambda file: np.savez(file, **arrays))
    else:
        kept = {name: np.ascontiguousarray(array) for name, array in arrays.items() if isinstance(array, np.ndarray)}
        data = save({name: array for name, array in kept.items() if array.dtype.kind in "fiu"})
    path = case.file(f"model.{case.either(kind, 'pkl', 'txt', '')}", data)
    model = load_model(path, num_shapes=case.number(None, 3, 10, 11))
    detailed = model.rest(torch.zeros(1, model.num_shapes))
    return detailed.vertices, detailed.joints


@lru_cache
def network_file() -> bytes:
    """A label network, small and untrained."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.safetensors"
        save_label_network(path, LabelNetwork(SMALL_NETWORK).state_dict(), SMALL_NETWORK, {"steps": 0})
        return path.read_bytes()


def try_network_file(case: Case) -> Any:
    data = network_file()
    if case.spoils():
        length = int.from_bytes(data[:8], "little") + 8
        head = case.happens(5)  # else any byte, which is most likely a weight
        data = case.damaged(data[:length]) + data[length:] if head else case.damaged(data)
    network = load_label_network(case.file("network.safetensors", data))
    shares, keypoints = torch.rand(2, NUM_CHANNELS, 64, 64), torch.rand(2, len(LANDMARKS), 3)
    predicted = network(shares, keypoints, torch.zeros(2, 4))
    return predicted.orientation, predicted.rotations
