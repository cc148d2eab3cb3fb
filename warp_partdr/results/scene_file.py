"""A scene in one file for other tools: everybody who moves in it, and its cameras, as binary glTF 2.0."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..inputs.scene import View
from ..models.registration import Registered
from .binding import to_quaternions
from .ellipbody_files import GLTF_FROM_CAMERA
from .gltf import Document
from .skinned_files import Poses, add_body

_NEAREST = 0.05  # [m] from a camera that something is shown


@dataclass(frozen=True)
class Actor:
    """Body that moves in the world.

    Attributes:
        name: The body's.
        body: In its first pose.
        poses: The motion.
        until: When the body is there no longer [s].
    """

    name: str
    body: Registered
    poses: Poses
    until: float


@dataclass(frozen=True)
class NamedView:
    """A camera: its name, its place, and (H, W) of its pictures [px]."""

    name: str
    view: View
    size: tuple[int, int]


def scene_glb(actors: Sequence[Actor], views: Sequence[NamedView]) -> bytes:
    """Bodies and cameras as binary glTF 2.0, one animation in all, y up; the lowest vertex of all lies on y = 0.

    The world's y is taken for down. Who is not there yet, or no longer, has no size. glTF's cameras look through the
    middle of their pictures: principal points are left out.

    Args:
        actors: Who moves, one at least; each may begin at another time.
        views: The cameras.
    """
    lowest, end = min(each.poses.lowest for each in actors), max(float(each.poses.times[-1]) for each in actors)
    document = Document()
    for actor in actors:
        poses = replace(actor.poses, lowest=lowest)
        body = add_body(document, actor.body, poses, name=actor.name)
        first, last = float(poses.times[0]), float(poses.times[-1])
        shown = [(0.0, 0.0)] * (first > 0) + [(first, 1.0)] + [(actor.until, 0.0)] * (last < end)
        if len(shown) > 1:
            times, sizes = np.array(shown).T
            document.animate(body, "scale", document.add_times(times), np.repeat(sizes[:, None], 3, 1), steps=True)
    for each in views:
        _add_camera(document, each, -lowest)
    return document.glb()


def _add_camera(document: Document, seen: NamedView, lift: float) -> None:
    height, width = seen.size
    focal = float(seen.view.camera.focal[0, 1])
    lens = {"yfov": 2 * math.atan(height / 2 / focal), "aspectRatio": width / height, "znear": _NEAREST}
    turn = GLTF_FROM_CAMERA @ seen.view.rotation.double().numpy().T @ GLTF_FROM_CAMERA
    place = GLTF_FROM_CAMERA @ seen.view.eye.double().numpy() + [0.0, lift, 0.0]
    document.roots.append(len(document.nodes))
    document.nodes.append(
        {
            "name": seen.name,
            "camera": len(document.cameras),
            "rotation": to_quaternions(turn[None])[0].tolist(),
            "translation": place.tolist(),
        }
    )
    document.cameras.append({"name": seen.name, "type": "perspective", "perspective": lens})
