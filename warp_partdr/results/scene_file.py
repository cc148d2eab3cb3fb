"""Scene in one file for other tools: all moving people and the cameras, as binary glTF 2.0."""

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

_NEAREST = 0.05  # [m], least distance from a camera at which it shows something


@dataclass(frozen=True)
class Actor:
    """Body that moves in the world.

    Attributes:
        name: Name of the body.
        body: Body in its first pose.
        poses: Motion of the body.
        until: Time from which on the body is hidden [s].
    """

    name: str
    body: Registered
    poses: Poses
    until: float


@dataclass(frozen=True)
class NamedView:
    """View with its name and the size (H, W) of its pictures [px]."""

    name: str
    view: View
    size: tuple[int, int]


def scene_glb(actors: Sequence[Actor], views: Sequence[NamedView], *, bare: bool = False) -> bytes:
    """Write bodies and cameras as binary glTF 2.0 with one animation, y up; the lowest vertex lies on y = 0.

    The world's y axis must point down. Outside of its own time, a body is scaled to 0. Cameras of glTF look through the
    middle of their pictures, so principal points are left out.

    Args:
        actors: Moving bodies, at least one; each may begin at another time.
        views: Cameras of the scene.
        bare: True writes the skin. By default bodies wear a plain suit.
    """
    lowest, end = min(each.poses.lowest for each in actors), max(float(each.poses.times[-1]) for each in actors)
    document = Document()
    for actor in actors:
        poses = replace(actor.poses, lowest=lowest)
        body = add_body(document, actor.body, poses, name=actor.name, bare=bare)
        first, last = float(poses.times[0]), float(poses.times[-1])
        keys = [(0.0, 0.0)] * (first > 0) + [(first, 1.0)] + [(actor.until, 0.0)] * (last < end)
        if len(keys) > 1:
            times, sizes = np.array(keys).T
            document.animate(body, "scale", document.add_times(times), np.repeat(sizes[:, None], 3, 1), steps=True)
    for each in views:
        _add_camera(document, each, -lowest)
    return document.glb()


def _add_camera(document: Document, named: NamedView, lift: float) -> None:
    height, width = named.size
    focal = float(named.view.camera.focal[0, 1])
    lens = {"yfov": 2 * math.atan(height / 2 / focal), "aspectRatio": width / height, "znear": _NEAREST}
    turn = GLTF_FROM_CAMERA @ named.view.rotation.double().numpy().T @ GLTF_FROM_CAMERA
    position = GLTF_FROM_CAMERA @ named.view.eye.double().numpy() + [0.0, lift, 0.0]
    document.roots.append(len(document.nodes))
    document.nodes.append(
        {
            "name": named.name,
            "camera": len(document.cameras),
            "rotation": to_quaternions(turn[None])[0].tolist(),
            "translation": position.tolist(),
        }
    )
    document.cameras.append({"name": named.name, "type": "perspective", "perspective": lens})
