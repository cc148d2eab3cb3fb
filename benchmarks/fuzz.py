"""Fuzz the public entry points: random shapes, types, values, devices and damaged files.

    python benchmarks/fuzz.py [--cases 10000] [--seed 0] [--only CASE] [--device cpu]

Every case must give a result of finite numbers or an error on purpose: ValueError or OSError from a line of this
package, or a TypeError. Anything else fails: an error out of torch, NumPy or Warp, a bare KeyError, NaN, a crash, or
more than ``PATIENCE`` seconds. Only ``ELEMENTARY`` functions may pass on what was NaN or infinite. A case is told by
seed and number; ``--only`` runs it again, with the trace.
"""

from __future__ import annotations

import argparse
import faulthandler
import io
import json
import math
import multiprocessing
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
import warp as wp
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import warp_partdr
from warp_partdr import label_set
from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.labels import LabelSet, regroup
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_6d, rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.body.template import PART_NAMES
from warp_partdr.cameras import Camera, Crop, Perspective, WeakPerspective
from warp_partdr.clothing import smpl
from warp_partdr.clothing.anny import anny
from warp_partdr.clothing.load import load_model
from warp_partdr.clothing.registration import RegistrationOptions, register
from warp_partdr.fit.fitting import fit_body
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.stages import Stage
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation
from warp_partdr.inputs.part_labels import PartLabels, read_label_set, read_parts, read_photo
from warp_partdr.metrics import accuracy, align_similarity, confusion, f1_scores, mpjpe, pa_mpjpe, pve
from warp_partdr.network.checkpoint import load_label_network, save_label_network
from warp_partdr.network.label_network import NUM_CHANNELS, LabelNetwork, LabelNetworkConfig
from warp_partdr.network.landmarks import LANDMARKS
from warp_partdr.network.regressor import RegressorConfig
from warp_partdr.refinement.energy import Energy
from warp_partdr.refinement.refine import minimise, refine
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh
from warp_partdr.results.body_file import BodyFile, load_body

PATIENCE = 60  # [s]
SMALL_NETWORK = LabelNetworkConfig(
    size=64, channels=(4, 8, 8, 8, 8), places=2, keypoint_features=8, regressor=RegressorConfig(width=16)
)
PACKAGE = {
    Path(sys.modules[name].__file__ or "").resolve().parent
    for name in ("warp_partdr", *(f"warp_partdr.{part}" for part in ("body.template", "kernels.launch")))
}
REFUSALS = (ValueError, TypeError, OSError)
SIZES = [(8, 8), (1, 1), (5, 12), (24, 16)]

_DTYPES = [
    torch.float64,
    torch.float16,
    torch.bfloat16,
    torch.int32,
    torch.int64,
    torch.uint8,
    torch.bool,
    torch.complex64,
]
_VALUES = [math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-45, 1e-20, 1e9, 1e20, 3e38, 1e300]
_ODDITIES = [None, "a", [1.0], np.zeros(3)]


class UnfitError(AssertionError):
    """A result that is none."""


class Chance:
    """What one case draws from, on one device.

    Args:
        rng: The case's own.
        folder: For its files.
        device: Of its tensors.
    """

    def __init__(self, rng: np.random.Generator, folder: Path, device: str) -> None:
        self.rng, self.folder, self.device = rng, folder, device
        self.extreme = False  # whether some tensor holds no number, 0, or what is near the end of float32
        # Most cases spoil something; where all is spoilt, only the first check is tested.
        self.rate = float(rng.choice([0.0, 0.1, 0.3]))

    def one(self, choices: Any) -> Any:
        """One of a sequence."""
        return choices[int(self.rng.integers(len(choices)))]

    def spoils(self) -> bool:
        """Whether this argument is spoilt."""
        return bool(self.rng.random() < self.rate)

    def tensor(self, *shape: int, scale: float = 1.0, shift: float = 0.0) -> torch.Tensor:
        """Normal numbers."""
        return torch.from_numpy(self.rng.normal(shift, scale, shape)).float().to(self.device)

    def turns(self, *shape: int) -> torch.Tensor:
        """Rotation matrices."""
        return rotation_from_axis_angle(self.tensor(*shape, 3))

    def maybe(self, tensor: torch.Tensor) -> Any:
        """The tensor, or something made of it that may be wrong in any way."""
        if self.rng.random() < 0.2:
            tensor = tensor.clone().requires_grad_(tensor.is_floating_point())
        if not self.spoils():
            return tensor
        kind = self.rng.integers(12)
        if kind <= 3 and tensor.numel():
            values = tensor.detach().clone().flatten()
            count = min(int(self.rng.integers(1, 4)), values.numel())
            spots = torch.from_numpy(self.rng.integers(0, values.numel(), count)).to(values.device)
            value = self.one(_VALUES)
            self.extreme |= not 1e-18 < abs(value) < 1e18  # what is divided by next to nothing leaves float32, too
            if not values.is_floating_point():
                value = int(np.clip(np.nan_to_num(value), 0, 255))
            elif abs(value) > 1e38 and math.isfinite(value):
                values = values.double()
            values[spots] = value
            return values.view(tensor.shape)
        if kind == 4:
            scaled = tensor.detach() * float(10.0 ** self.rng.uniform(-12, 12))
            self.extreme |= not bool((scaled.abs() < 1e18).all())
            return scaled
        if kind == 5:
            cast = tensor.detach().to(self.one(_DTYPES))
            self.extreme |= not bool(torch.isfinite(cast).all())
            return cast
        if kind in (6, 7):
            return self._reshaped(tensor.detach())
        if kind == 8:
            return tensor.detach().to("meta")
        if kind == 9:
            return tensor.detach().transpose(0, -1).contiguous().transpose(0, -1) if tensor.dim() else tensor
        if kind == 10:
            return tensor.detach().to_sparse() if self.device == "cpu" else tensor
        return self.one(_ODDITIES)

    def _reshaped(self, tensor: torch.Tensor) -> torch.Tensor:
        if not tensor.dim() or not tensor.numel():
            return tensor.new_zeros(())
        axis = int(self.rng.integers(tensor.dim()))
        ways: list[Callable[[], torch.Tensor]] = [
            lambda: tensor.select(axis, 0),
            lambda: tensor.unsqueeze(axis),
            lambda: tensor.narrow(axis, 0, 0),
            lambda: tensor.narrow(axis, 0, max(tensor.shape[axis] - 1, 0)),
            lambda: torch.cat([tensor, tensor], axis),
            lambda: tensor.flatten(),
            lambda: tensor.transpose(0, -1),
            lambda: tensor.new_zeros(()),
        ]
        return self.one(ways)()

    def array(self, values: np.ndarray) -> Any:
        """The same for arrays."""
        tensor = self.maybe(torch.from_numpy(np.array(values)))
        if not isinstance(tensor, torch.Tensor) or tensor.is_meta or tensor.layout != torch.strided:
            return self.one(_ODDITIES)
        return tensor.detach().numpy() if tensor.dtype != torch.bfloat16 else tensor.detach().float().numpy()

    def number(self, value: Any, *others: Any) -> Any:
        """The number, or another one."""
        return (
            self.one([*others, math.nan, math.inf, -math.inf, 0, -1, 1e30, None, "a", 2.5]) if self.spoils() else value
        )

    def size(self) -> Any:
        """A picture's size."""
        bad = [(0, 8), (8,), None, 8, (-1, 4), (2.0, 8), (2**20, 2**20), (2**14, 2**14), "ab", (8, 8, 8)]
        return self.one(bad) if self.spoils() else self.one(SIZES)

    def file(self, name: str, data: bytes) -> Path:
        """A file with these bytes, or damaged ones."""
        path = self.folder / name
        if self.spoils() and self.rng.random() < 0.1:
            return self.one([self.folder, self.folder / "missing" / name, path.with_suffix("")])
        path.write_bytes(self.damaged(data) if self.rng.random() < 0.6 else data)
        return path

    def damaged(self, data: bytes) -> bytes:
        """Bytes flipped, cut, repeated or made up."""
        values = bytearray(data)
        for _ in range(int(self.rng.integers(1, 4))):
            at = int(self.rng.integers(max(len(values), 1)))
            kind = int(self.rng.integers(6))
            if kind == 0:
                del values[at:]
            elif kind == 1:
                del values[at : at + int(self.rng.integers(1, 64))]
            elif kind == 2:
                values[at:at] = self.rng.integers(0, 256, int(self.rng.integers(1, 64))).astype(np.uint8).tobytes()
            elif kind == 3:
                values[at:at] = values[at : at + int(self.rng.integers(1, 256))]
            elif values:
                # In the beginning are headers.
                at = min(at, int(self.rng.integers(1, 256))) % len(values) if kind == 4 else at % len(values)
                values[at] = int(self.rng.integers(256))
        return bytes(values)

    def json(self, data: Any) -> Any:
        """Data with something in it replaced, wherever it is."""
        if self.rng.random() < 0.05 * self.rate:
            return self.one(
                [None, True, -1, 0, 1e400, 10**400, "x", [], {}, [[]], math.nan, "left_foot", 7.5, [1, 2, 3]]
            )
        if isinstance(data, dict):
            return {
                self.one(["", "format", "x"]) if self.rng.random() < 0.03 else k: self.json(v) for k, v in data.items()
            }
        if isinstance(data, list):
            kept = [self.json(value) for value in data]
            return kept[: int(self.rng.integers(len(kept) + 1))] if self.rng.random() < 0.03 else kept
        return data


# --- Entry points ---------------------------------------------------------------------------------------------------


def scene(chance: Chance) -> tuple[Ellipsoids, Camera, int, int]:
    """Ellipsoids and a camera, some of whose numbers may be wrong."""
    batch, parts = chance.one([0, 1, 1, 2, 3]), chance.one([1, 2, 5, 20])
    perspective = bool(chance.rng.random() < 0.5)
    ellipsoids = Ellipsoids(
        chance.maybe(chance.tensor(batch, parts, 3, scale=0.5, shift=2.0 * perspective)),
        chance.maybe(chance.turns(batch, parts)),
        chance.maybe(chance.tensor(batch, parts, 3, scale=0.3).abs() + 0.01),
    )
    return ellipsoids, camera(chance, batch, perspective), batch, parts


def camera(chance: Chance, batch: int, perspective: bool) -> Camera:
    """One a body."""
    middle = chance.maybe(chance.tensor(batch, 2, scale=4.0, shift=6.0))
    if perspective:
        return Perspective(chance.maybe(chance.tensor(batch, 2, scale=5.0, shift=10.0)), middle)
    return WeakPerspective(chance.maybe(chance.tensor(batch, scale=5.0, shift=10.0)), middle)


def target_of(chance: Chance, batch: int, labels: int) -> Any:
    """A label image."""
    size = (max(batch, 1) if chance.rng.random() < 0.3 else batch, *chance.one(SIZES))
    values = chance.rng.integers(0, labels + 1, size)
    values[chance.rng.random(size) < 0.1] = 255
    return chance.maybe(torch.from_numpy(values.astype(np.uint8)).to(chance.device))


def pull_options(chance: Chance) -> dict[str, Any]:
    """Of both renderers."""
    return {
        "near": chance.number(None, 0.1, -5.0),
        "occlusion": chance.one(["depth", "paper", "none", None]) if chance.spoils() else "depth",
        "max_distance": chance.number(math.inf, 3.0),
        "depth_weight": chance.number(1.0, 0.0),
    }


def ellipsoid_options(chance: Chance) -> dict[str, Any]:
    return {
        **pull_options(chance),
        "gradient": chance.one(["edges", "coverage", "partdr", *(["exact"] if chance.spoils() else [])]),
        "steps_per_pixel": chance.number(1.0, 4.0, 100.0),
        "halvings": chance.number(4, 0, 25),
    }


def part_labels(chance: Chance, parts: int) -> Any:
    kind = chance.rng.integers(4)
    if kind < 2:
        return None
    if kind == 2:
        return chance.rng.integers(1, 6, parts).tolist()
    return chance.one([[0] * parts, [1, 2], ["a"] * parts, [255] * parts, 5, [256] * parts, [1.5] * parts])


def try_draw_ellipsoids(chance: Chance) -> Any:
    ellipsoids, seen, _, parts = scene(chance)
    image = draw_ellipsoids(
        ellipsoids,
        seen,
        chance.size(),
        part_labels=part_labels(chance, parts),
        num_maps=chance.number(int(chance.rng.integers(0, 7)), 254, 300, -2),
        **ellipsoid_options(chance),
    )
    return image, backward(image.maps, vars(ellipsoids), image.maps)


def try_ellipsoid_label_loss(chance: Chance) -> Any:
    ellipsoids, seen, batch, parts = scene(chance)
    target = target_of(chance, batch, parts)
    loss, image = ellipsoid_label_loss(
        ellipsoids,
        seen,
        target,
        part_labels=part_labels(chance, parts),
        label_weights=weights_of(chance, parts),
        **ellipsoid_options(chance),
    )
    return loss, image, backward(loss, vars(ellipsoids), loss)


def weights_of(chance: Chance, labels: int) -> Any:
    return chance.maybe(chance.tensor(labels + 1).abs()) if chance.rng.random() < 0.3 else None


def backward(value: torch.Tensor | None, leaves: dict[str, torch.Tensor], weights: torch.Tensor | None) -> Any:
    """Gradients of what asks for one."""
    if value is None or weights is None or not value.requires_grad:
        return None
    wanted = [leaf for leaf in leaves.values() if leaf.requires_grad]
    if not wanted:
        return None
    return torch.autograd.grad((value * (1.0 + weights.detach())).sum(), wanted, allow_unused=True)


def mesh_scene(chance: Chance) -> tuple[Any, PartMesh, int, int]:
    batch, count = chance.one([0, 1, 1, 2]), chance.one([1, 3, 8])
    vertices = chance.tensor(batch, 3 * count, 3, scale=5.0, shift=5.0)
    vertices[..., 2] = vertices[..., 2].abs() / 5
    faces, labels = np.arange(3 * count).reshape(-1, 3), chance.rng.integers(1, 5, count)
    mesh = PartMesh.from_faces(faces, labels, device=chance.device)
    return chance.maybe(vertices), mesh, batch, int(labels.max())


def mesh_options(chance: Chance) -> dict[str, Any]:
    edges = chance.one(["silhouette", "all", *(["some"] if chance.spoils() else [])])
    return {**pull_options(chance), "edges": edges, "perspective": bool(chance.rng.random() < 0.5)}


def try_rasterize_parts(chance: Chance) -> Any:
    vertices, mesh, *_ = mesh_scene(chance)
    maps = chance.number(int(chance.rng.integers(0, 6)), 254, 300, -2)
    image = draw_mesh(vertices, mesh, chance.size(), num_maps=maps, **mesh_options(chance))
    return image, backward(image.maps, {"vertices": vertices}, image.maps)


def try_label_loss(chance: Chance) -> Any:
    vertices, mesh, batch, labels = mesh_scene(chance)
    target, weights = target_of(chance, batch, labels), weights_of(chance, labels)
    loss, image = mesh_label_loss(vertices, mesh, target, label_weights=weights, **mesh_options(chance))
    return loss, image, backward(loss, {"vertices": vertices}, loss)


def try_part_mesh(chance: Chance) -> Any:
    count = chance.one([0, 1, 4])
    faces = chance.array(chance.rng.integers(0, 9, (count, 3)))
    mesh = PartMesh.from_faces(faces, chance.array(chance.rng.integers(1, 5, count)), device=chance.device)
    labels = {k: chance.number(int(chance.rng.integers(1, 9)), 255, 300) for k in range(1, 5)}
    return mesh.edges, mesh.every_edge, mesh.num_labels, mesh.num_vertices, mesh.relabel(labels).face_labels


def try_pose(chance: Chance) -> Any:
    batch = chance.one([0, 1, 2])
    values = {
        "global_orient": chance.turns(batch),
        "translation": chance.tensor(batch, 3),
        "rotations": chance.turns(batch, 20),
        "lengths": chance.tensor(batch, 12, scale=0.1, shift=0.4),
        "thicknesses": chance.tensor(batch, 15, scale=0.05, shift=0.2),
    }
    dtype = chance.one([torch.float32, torch.float64])
    posed = pose(**{name: chance.maybe(value.to(dtype)) for name, value in values.items()})
    vertices = posed.vertices(chance.number(int(chance.rng.integers(4)), 4, 1000))
    return posed, vertices


def try_ellipbody(chance: Chance) -> Any:
    batch = chance.one([0, 1, 2])
    body = EllipBody.from_numpy(
        global_orient=chance.array(np.tile(np.eye(3), (batch, 1, 1))),
        translation=chance.array(chance.rng.normal(size=(batch, 3))),
        rotations=chance.array(np.tile(np.eye(3), (batch, 20, 1, 1))),
        lengths=chance.array(chance.rng.uniform(0.1, 1, (batch, 12))),
        thicknesses=chance.array(chance.rng.uniform(0.1, 1, (batch, 15))),
        device=chance.device,
    )
    measured = body.measure(chance.number(0, -1, 5)) if batch else {}
    return body.pose(subdivisions=chance.number(1, 0, 3, 4)).torch(), measured


def try_cameras(chance: Chance) -> Any:
    batch = chance.one([0, 1, 3])
    perspective = bool(chance.rng.random() < 0.5)
    seen = camera(chance, batch, perspective)
    points = chance.maybe(chance.tensor(batch, 5, 3, shift=2.0))
    crop = Crop(*(chance.number(value) for value in (-3.0, 4.0, 1.5)), (8, 8))
    inside = seen.in_crop(crop)
    results: list[Any] = [seen.project(points), inside.intrinsics, inside.in_full(crop).intrinsics]
    if isinstance(seen, WeakPerspective):
        results += [
            seen.to_hmr(chance.number(8, 256)),
            WeakPerspective.from_hmr(chance.maybe(chance.tensor(batch, 3)), 8),
        ]
        results += list(seen.to_perspective(chance.maybe(chance.tensor(batch).abs() + 1), chance.tensor(batch, 2)))
    else:
        results.append(seen.to_weak(chance.maybe(chance.tensor(batch, 3, shift=3.0))))
    return results


def try_rotations(chance: Chance) -> Any:
    shape = chance.one([(), (2,), (0,), (2, 3)])
    vectors = chance.maybe(chance.tensor(*shape, 3, scale=float(10.0 ** chance.rng.uniform(-8, 3))))
    turns = rotation_from_axis_angle(vectors)
    columns = chance.maybe(chance.tensor(*shape, 6, scale=float(10.0 ** chance.rng.uniform(-30, 30))))
    return turns, rotation_to_axis_angle(turns), rotation_from_6d(columns)


@lru_cache
def person(device: str) -> tuple[Keypoints2D, np.ndarray]:
    """Perfect keypoints and labels of the mean body, 96 x 80 px, drawn on a device."""
    from warp_partdr.body.posing import LandmarkGather

    body = BodyParameters.mean(1, device=device)
    seen = replace(body.camera(80), translation=torch.tensor([[40.0, 45.0]], device=device))
    names = warp_partdr.skeleton("coco17").landmarks
    points = seen.project(LandmarkGather(names, device)(body.posed()))[0, :, :2].cpu().numpy()
    labels = draw_ellipsoids(body.posed(), seen, (96, 80)).labels[0].cpu().numpy()
    return Keypoints2D("coco17", points.astype(np.float32), np.ones(17, dtype=np.float32)), labels


def keypoints_of(chance: Chance) -> Keypoints2D:
    known, _ = person(chance.device)
    points = known.points + chance.rng.normal(0, 2, known.points.shape).astype(np.float32)
    return Keypoints2D(
        chance.one(["lsp14", "nobody"]) if chance.spoils() else "coco17",
        chance.array(points),
        chance.array(known.confidence * chance.rng.random(17).astype(np.float32)),
    )


def try_fit_body(chance: Chance) -> Any:
    stages = (Stage("lift", 6, 2, 0.1), Stage("keypoints", 4, 2, 0.05), Stage("labels", 2, 2, 0.03, 32))
    labels = (
        chance.rng.permutation(person(chance.device)[1].reshape(-1)).reshape(96, 80)
        if chance.spoils()
        else person(chance.device)[1]
    )
    parts = PartLabels(label_set("ellipbody20"), chance.array(labels)) if chance.rng.random() < 0.7 else None
    if chance.spoils():
        stages = tuple(
            replace(
                stage,
                iterations=chance.number(2, 0),
                learning_rate=chance.number(0.1),
                size=chance.number(stage.size, 1),
            )
            for stage in stages
        )
    options = FitOptions(stages=stages, renderer=chance.one(["exact", "mesh"]), start=chance.one(["network", "search"]))
    others = [keypoints_of(chance)] if chance.rng.random() < 0.2 else []
    result = fit_body(keypoints_of(chance), parts, others=others, options=options, device=chance.device)
    return result.parameters, result.energy, result.posed, result.camera


@lru_cache
def prior(device: str) -> PosePrior:
    return PosePrior().to(device)


def try_refine(chance: Chance) -> Any:
    batch = chance.one([0, 1, 2])
    mean = BodyParameters.mean(batch, device=chance.device)
    start = BodyParameters(
        **{
            name: chance.maybe(value + chance.tensor(*value.shape, scale=0.02))
            for name, value in mean.tensors().items()
        }
    )
    names = warp_partdr.skeleton("coco17").landmarks
    labels = torch.from_numpy(chance.rng.integers(0, 21, (16, 16)).astype(np.uint8)).to(chance.device)
    observation = Observation(
        names, chance.tensor(17, 2, scale=0.3), torch.ones(17, device=chance.device), labels, label_set("ellipbody20")
    )
    energy = Energy(
        observation, size=16, prior=prior(chance.device), gradient=chance.one(["edges", "coverage", "partdr"])
    )
    run = chance.one([refine, minimise])
    return run(start, energy, iterations=chance.number(2, 0), learning_rate=chance.number(0.01, 0.0))


@lru_cache
def anny_model(device: str) -> Any:
    return anny(torch.device(device), torch.float32)


def try_register(chance: Chance) -> Any:
    posed = BodyParameters.mean(1, device=chance.device).posed()
    if chance.spoils():
        posed = replace(posed, **{each.name: chance.maybe(getattr(posed, each.name)) for each in fields(posed)})
    options = RegistrationOptions(iterations=chance.number(2, 0), learning_rate=chance.number(0.01))
    found = register(posed, anny_model(chance.device), options=options)
    return found.shape, found.rotations, found.translation, found.detailed, found.losses


def try_model(chance: Chance) -> Any:
    model = anny_model(chance.device)
    batch = chance.one([0, 1, 2])
    turns = chance.maybe(chance.turns(batch, model.num_joints))
    if isinstance(turns, torch.Tensor) and turns.is_floating_point() and not turns.is_sparse and not turns.is_meta:
        chance.extreme |= not bool((turns.abs() < 100).all())  # multiplied along chains of a dozen joints
    shape, place = chance.maybe(chance.tensor(batch, model.num_shapes)), chance.maybe(chance.tensor(batch, 3))
    detailed = model.pose(shape, turns, place)
    return detailed, model.landmarks(detailed, [chance.one(["nose", "left_knee", "tail"])])


def saved(write: Callable[[io.BytesIO], Any]) -> bytes:
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


@lru_cache
def body_file() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "global_orient": np.eye(3, dtype=np.float32),
        "translation": np.zeros(3, dtype=np.float32),
        "rotations": np.tile(np.eye(3, dtype=np.float32), (20, 1, 1)),
        "lengths": rng.uniform(0.2, 0.5, 12).astype(np.float32),
        "thicknesses": rng.uniform(0.1, 0.2, 15).astype(np.float32),
        "camera_scale": np.float32(100.0),
        "camera_translation": np.float32([20.0, 30.0]),
        "image_size": np.array([96, 80]),
    }


def try_body_file(chance: Chance) -> Any:
    arrays = {name: chance.array(value) for name, value in body_file().items()}
    if chance.rng.random() < 0.5:
        path = chance.folder / "body.npz"
        BodyFile(**arrays).save(path)
        data = path.read_bytes()
    else:
        data = saved(lambda file: np.savez(file, format=np.array("warp-partdr body 1"), **body_file()))
    loaded = load_body(chance.file("body.npz", data))
    return vars(loaded), loaded.camera(), loaded.body("cpu").numpy()


def try_keypoint_file(chance: Chance) -> Any:
    rows = [[*map(float, point), 0.9] for point in person(chance.device)[0].points]
    flat = [number for row in rows for number in row]
    data = chance.one(
        [
            {"format": "coco17", "keypoints": rows},
            {"people": [{"pose_keypoints_2d": flat + flat[:24]}]},
            {"annotations": [{"keypoints": flat, "image_id": 1}]},
            [{"keypoints": [row[:2] for row in rows], "keypoint_scores": [0.5] * 17}],
            rows,
            [rows, rows],
        ]
    )
    text = json.dumps(chance.json(data)).encode()
    path = chance.file("keypoints.json", text) if chance.rng.random() < 0.4 else chance.folder / "keypoints.json"
    if not path.exists():
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_bytes(text)
    people = read_keypoints(path, chance.one(["coco17", "lsp", "x"]) if chance.spoils() else None)
    return [(one.points, one.confidence) for one in people]


def try_part_file(chance: Chance) -> Any:
    from PIL import Image

    labels = chance.array(person(chance.device)[1])
    if chance.rng.random() < 0.5:
        image = Image.fromarray(person(chance.device)[1])
        kind = chance.one(["png", "jpeg", "gif"]) if chance.spoils() else "png"
        path = chance.file("parts.png", saved(lambda file: image.save(file, kind)))
    else:
        if chance.rng.random() < 0.3:
            maps = np.moveaxis(np.eye(21, dtype=np.float32)[person(chance.device)[1][::8, ::8]], -1, 0)
            labels = chance.array(maps)
        pickled = chance.spoils()
        data = saved(lambda file: np.save(file, np.array([{}]) if pickled else labels, allow_pickle=True))
        path = chance.file("parts.npy", data)
    parts = read_parts(path, label_set(chance.one(["ellipbody20", "ellipbody20", "lsp6"])))
    return parts.groups, parts.maps


def try_photo(chance: Chance) -> Any:
    from PIL import Image

    image = Image.fromarray(chance.rng.integers(0, 256, (6, 5, 3)).astype(np.uint8))
    kind = chance.one(["png", "jpeg", "webp", "tiff", "bmp"])
    return read_photo(chance.file(f"photo.{kind}", saved(lambda file: image.save(file, kind))))


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


def try_model_file(chance: Chance) -> Any:
    arrays = {name: chance.array(value) for name, value in smpl_arrays().items() if not chance.spoils()}
    assert set(smpl.ARRAYS) >= set(arrays)
    kind = chance.one(["npz", "npz", "safetensors"])
    if kind == "npz":
        data = saved(lambda file: np.savez(file, **arrays))
    else:
        from safetensors.numpy import save

        kept = {name: np.ascontiguousarray(array) for name, array in arrays.items() if isinstance(array, np.ndarray)}
        data = save({name: array for name, array in kept.items() if array.dtype.kind in "fiu"})
    path = chance.file(f"model.{chance.one(['pkl', 'txt', '']) if chance.spoils() else kind}", data)
    model = load_model(path, num_shapes=chance.number(None, 3, 10, 11))
    detailed = model.rest(torch.zeros(1, model.num_shapes))
    return detailed.vertices, detailed.joints


@lru_cache
def network_file() -> bytes:
    """A label network, small and untrained."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.safetensors"
        save_label_network(path, LabelNetwork(SMALL_NETWORK).state_dict(), SMALL_NETWORK, {"steps": 0})
        return path.read_bytes()


def try_network_file(chance: Chance) -> Any:
    data = network_file()
    if chance.spoils():
        length = int.from_bytes(data[:8], "little") + 8
        head = chance.rng.random() < 0.5  # else any byte, which is most likely a weight
        data = chance.damaged(data[:length]) + data[length:] if head else chance.damaged(data)
    network = load_label_network(chance.file("network.safetensors", data))
    shares, keypoints = torch.rand(2, NUM_CHANNELS, 64, 64), torch.rand(2, len(LANDMARKS), 3)
    predicted = network(shares, keypoints)
    return predicted.orientation, predicted.rotations


def try_metrics(chance: Chance) -> Any:
    batch = chance.one([(), (2,), (0,)])
    points, target = (chance.maybe(chance.tensor(*batch, 6, 3)) for _ in range(2))
    kind = chance.rng.integers(5)
    if kind == 0:
        return mpjpe(points, target, centre_on=chance.one([(), (0,), (0, 9)]) if chance.spoils() else (0, 1))
    if kind == 1:
        return pa_mpjpe(points, target), align_similarity(points, target)
    if kind == 2:
        valid = chance.maybe(torch.ones(*batch, 6, dtype=torch.bool, device=chance.device))
        return mpjpe(points, target, valid=valid)
    if kind == 3:
        return pve(
            points, target, pelvis=chance.maybe(chance.tensor(*batch, 3)), target_pelvis=chance.tensor(*batch, 3)
        )
    shape = (*batch, 4, 5)
    counts = confusion(
        chance.maybe(torch.from_numpy(chance.rng.integers(0, 4, shape))),
        chance.maybe(torch.from_numpy(chance.rng.integers(0, 4, shape))),
        chance.number(4, 2, 256),
    )
    return counts, accuracy(counts), np.nan_to_num(f1_scores(counts))


def try_label_sets(chance: Chance) -> Any:
    data = {
        "name": "mine",
        "groups": {"head": ["head", "neck"], "arm": ["left_forearm", "left_hand"], "leg": [chance.one(PART_NAMES)]},
        "ids": {"0": "background", "1": "head", "2": "arm", "7": "ignore", "9": "leg"},
    }
    spoilt = chance.json(data)
    if chance.rng.random() < 0.5:
        found: LabelSet = read_label_set(chance.file("labels.json", json.dumps(spoilt).encode()))
    else:
        found = (
            read_label_set(spoilt) if isinstance(spoilt, dict) else label_set(chance.one(["lsp6", "cdcl14", "none"]))
        )
    image = chance.array(chance.rng.choice([0, 1, 2, 7, 9, 255], (4, 5)))
    groups = found.to_groups(image)
    return groups, found.to_ids(groups), found.from_parts(groups % 21), regroup(label_set("ellipbody20"), found)


def try_prior(chance: Chance) -> Any:
    batch = chance.one([0, 1, 3])
    vectors, up = chance.maybe(chance.tensor(batch, 20, 3)), chance.maybe(chance.tensor(batch, 3))
    return prior(chance.device)(vectors, up), prior(chance.device).joint_limits(vectors)


TARGETS: dict[str, Callable[[Chance], Any]] = {
    name.removeprefix("try_"): function for name, function in list(globals().items()) if name.startswith("try_")
}
ELEMENTARY = {"rotations", "cameras", "prior", "model", "detailed"}
# How often: the cheap and the much used more.
RATES = {"fit_body": 2, "register": 1, "refine": 3, "ellipsoid_label_loss": 8, "label_loss": 8, "draw_ellipsoids": 6}
TURNS = [name for name in TARGETS for _ in range(RATES.get(name, 4))]


# --- What a case came to --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """Of one case: "right", "refused" or what failed, and the trace of that."""

    target: str
    kind: str
    trace: str = field(default="", compare=False)

    @property
    def passed(self) -> bool:
        """Whether it is right, or refused on purpose."""
        return self.kind in ("right", "refused")


def check_finite(value: Any, name: str = "result") -> None:
    """Raise UnfitError where a result holds NaN or infinity, but for the depth of the background."""
    if isinstance(value, torch.Tensor):
        if value.is_meta:  # it has none
            return
        value = value.detach().cpu().float().numpy() if value.dtype == torch.bfloat16 else value.detach().cpu().numpy()
    if isinstance(value, float | np.ndarray | np.generic):
        numbers = np.asarray(value)
        if numbers.dtype.kind in "fc":
            bad = np.isnan(numbers) if name.endswith(("depth", "maps")) else ~np.isfinite(numbers)
            if bad.any():
                raise UnfitError(f"{name}: {numbers[bad][0]}")
    elif is_dataclass(value) and not isinstance(value, type):
        for each in fields(value):
            check_finite(getattr(value, each.name), f"{name}.{each.name}")
    elif isinstance(value, dict):
        for key, each in value.items():
            check_finite(each, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        for index, each in enumerate(value):
            check_finite(each, f"{name}[{index}]")


def on_purpose(error: BaseException) -> bool:
    """Whether a line of this package raised it, or Python because of an argument's type."""
    if isinstance(error, TypeError):
        return True
    if not isinstance(error, REFUSALS) or not str(error):
        return False
    last = traceback.extract_tb(error.__traceback__)[-1]
    return not PACKAGE.isdisjoint(Path(last.filename).resolve().parents)


def run_case(seed: int, case: int, device: str) -> Outcome:
    """One case, from its number."""
    rng = np.random.default_rng([seed, case])
    target = TURNS[int(rng.integers(len(TURNS)))]

    def give_up(signum: int, frame: FrameType | None) -> None:
        raise UnfitError(f"still running after {PATIENCE} s")

    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        signal.signal(signal.SIGALRM, give_up)
        signal.alarm(PATIENCE)
        try:
            chance = Chance(rng, Path(folder), device)
            result = TARGETS[target](chance)
            if not (target in ELEMENTARY and chance.extreme):
                check_finite(result)
        except Exception as error:
            if on_purpose(error):
                return Outcome(target, "refused")
            return Outcome(target, f"{type(error).__name__}: {str(error)[:100]}", traceback.format_exc())
        finally:
            signal.alarm(0)
    return Outcome(target, "right")


def _work(seed: int, first: int, cases: int, device: str, results: Any) -> None:
    faulthandler.enable()
    prepare()
    for case in range(first, cases):
        results.put((case, None))
        results.put((case, run_case(seed, case, device)))


def prepare() -> None:
    """Quiet and single-threaded, for tensors are small."""
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)
    np.seterr(all="ignore")


def run_apart(seed: int, cases: int, device: str, tell: Callable[[int, Outcome], None]) -> None:
    """All cases in a process of their own, so that a crash is one more outcome."""
    context = multiprocessing.get_context("spawn")
    first = 0
    while first < cases:
        results = context.SimpleQueue()
        worker = context.Process(target=_work, args=(seed, first, cases, device, results))
        worker.start()
        while worker.is_alive() or not results.empty():
            if results.empty():
                time.sleep(0.001)
                continue
            case, outcome = results.get()
            first = case
            if outcome is not None:
                tell(case, outcome)
                first += 1
        worker.join()
        if first < cases:
            tell(first, Outcome("?", f"crashed, exit code {worker.exitcode}"))
            first += 1


def main() -> int:
    """Run, show a bar and a table; the exit status is 1 where something failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="CASE", help="this case alone, in this process, with its trace")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    console = Console()
    if options.only is not None:
        prepare()
        outcome = run_case(options.seed, options.only, options.device)
        console.print(f"{outcome.target}: {outcome.kind}\n{outcome.trace}", markup=False, highlight=False)
        return int(not outcome.passed)
    started = time.perf_counter()
    counts: dict[str, Counter[str]] = {name: Counter() for name in (*TARGETS, "?")}
    failures: list[tuple[int, Outcome]] = []
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("fuzz", total=options.cases)

        def tell(case: int, outcome: Outcome) -> None:
            counts[outcome.target][outcome.kind if outcome.passed else "failed"] += 1
            if not outcome.passed:
                failures.append((case, outcome))
            bar.update(task, advance=1, description=f"{len(failures)} failed")

        run_apart(options.seed, options.cases, options.device, tell)
    table = Table("entry point", "right", "refused", "failed", title=f"{options.cases} cases, seed {options.seed}")
    for name, count in counts.items():
        if count:
            table.add_row(name, *(str(count[kind]) for kind in ("right", "refused", "failed")))
    console.print(table)
    for case, outcome in failures:
        console.print(f"case {case}: {outcome.target}: {outcome.kind}", markup=False, highlight=False, soft_wrap=True)
    console.print(f"{len(failures)} of {options.cases} failed, {time.perf_counter() - started:.0f} s")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
