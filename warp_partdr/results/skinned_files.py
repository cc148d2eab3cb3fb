"""Registered detailed bodies and their motions as files for other tools: GLB with skeleton and skin, OBJ, PLY, and BVH.

In all files y is up, bodies stand on y = 0, and they face as in the picture, like EllipBody in ``ellipbody_files``.
Lengths are in metres, in BVH in centimetres. The joints of the GLB (glTF 2.0) hold the pose, so that a viewer shows the
posed body and Blender can change the pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ..inputs.frame_times import USUAL_RATE, is_even
from ..models.model import DetailedModel
from ..models.normals import vertex_normals
from ..models.registration import Registered
from ..models.suit import in_suit, suit_of
from .binding import Binding, from_rest, numbers_of, to_quaternions
from .ellipbody_files import GLTF_FROM_CAMERA
from .gltf import ELEMENT_ARRAY, Document
from .mesh_files import obj, ply
from .palette import PART_COLOURS
from .shading import SKIN_COLOUR, suit_tones

SKIN_WEIGHTS = 4  # weights of a vertex, as many as glTF's JOINTS_0 has
_GAMMA = 2.2  # of colours on screens; those of glTF are linear
BODY_MATERIAL: dict[str, Any] = {  # by glTF's names: matt, and as neutral as in pictures
    "baseColorFactor": [*((SKIN_COLOUR / 255.0) ** _GAMMA).round(3).tolist(), 1.0],
    "metallicFactor": 0.0,
    "roughnessFactor": 0.75,
}
_MOST_OFTEN = 16  # most poses at a constant rate for each given pose
_STILL = 1e-5  # change of a rotation's entries; joints that turn less do not move


def save_detailed(registered: Registered, folder: Path, *, bare: bool = False) -> None:
    """Write detailed.glb, detailed.obj, detailed.ply and detailed.bvh of the first body, given in the camera frame.

    With ``bare``, the meshes are the skin. By default they wear a plain suit, whose surface has no detail.
    """
    (folder / "detailed.glb").write_bytes(glb(registered, bare=bare))
    shown = registered if bare else in_suit(registered)
    vertices, faces = standing_mesh(shown)
    (folder / "detailed.obj").write_text(obj(vertices, faces))
    colours = PART_COLOURS[registered.model.face_parts.cpu().numpy()]
    (folder / "detailed.ply").write_bytes(ply(vertices, faces, colours))
    (folder / "detailed.bvh").write_text(bvh(registered))


def standing_mesh(registered: Registered) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of the first body's posed mesh, y up, standing on y = 0 [m], shape (V, 3), and faces, shape (F, 3)."""
    vertices, lowest = _upright(registered)
    return vertices - [0.0, lowest, 0.0], registered.model.faces.cpu().numpy()


@dataclass(frozen=True)
class Poses:
    """Poses of a body, one after another.

    Attributes:
        rotations: Local rotation of each joint, shape (T, J, 3, 3).
        translation: Position of the root joint in the camera frame [m], shape (T, 3).
        times: Times of the poses [s], rising, shape (T,), float64.
        rate: Poses a second in files that have a constant rate.
        lowest: Lowest y of any vertex in any pose, y up [m].
    """

    rotations: torch.Tensor
    translation: torch.Tensor
    times: np.ndarray
    rate: float
    lowest: float

    @classmethod
    def first(cls, registered: Registered) -> Poses:
        """Make the pose of the first body."""
        lowest = float(_upright(registered)[1])
        return cls(registered.rotations[:1], registered.translation[:1], np.zeros(1), USUAL_RATE, lowest)

    def since(self, time: float) -> Poses:
        """Return a copy whose times are counted from this time [s]."""
        return replace(self, times=self.times - time)

    def evenly(self) -> Poses:
        """Return the motion at a constant rate. Between poses, joints turn the shortest way, the root goes straight.

        There are ``rate`` poses a second, or fewer if that would be far more than the given poses.
        """
        if is_even(self.times, self.rate):
            return self
        first, last, steps = self.times[0], self.times[-1], np.diff(self.times)
        rate = min(self.rate, _MOST_OFTEN * len(steps) / (last - first))
        times = first + np.arange(round((last - first) * rate) + 1) / rate
        before = (np.searchsorted(self.times, times, side="right") - 1).clip(0, len(steps) - 1)
        shares = torch.from_numpy(((times - self.times[before]) / steps[before]).clip(0, 1)).to(self.translation)
        turns, positions = self.rotations[before], self.translation[before]
        further = rotation_to_axis_angle(turns.mT @ self.rotations[before + 1])
        rotations = turns @ rotation_from_axis_angle(shares[:, None, None] * further)
        translation = torch.lerp(positions, self.translation[before + 1], shares[:, None])
        return Poses(rotations, translation, times, rate, self.lowest)

    def numbers(self) -> tuple[np.ndarray, np.ndarray]:
        """Return ``rotations`` and ``translation`` as NumPy arrays in double precision."""
        rotations: np.ndarray = self.rotations.detach().cpu().double().numpy()
        translation: np.ndarray = self.translation.detach().cpu().double().numpy()
        return rotations, translation


def glb(registered: Registered, poses: Poses | None = None, *, bare: bool = False) -> bytes:
    """Write the first body as binary glTF 2.0: mesh, skeleton, skin weights and pose, or an animation of its poses.

    It wears a plain suit, unless ``bare``.
    """
    document = Document()
    add_body(document, registered, poses or Poses.first(registered), name="body", bare=bare)
    return document.glb()


def add_body(document: Document, registered: Registered, poses: Poses, *, name: str, bare: bool = False) -> int:
    """Add the first body to a glTF file, with its pose and motion, and return the index of the node that carries it.

    It wears a plain suit, unless ``bare``.
    """
    model, faces = registered.model, registered.model.faces.cpu().numpy()
    binding = Binding.of(registered if bare else in_suit(registered), SKIN_WEIGHTS)
    rest, bind, nodes = binding.joints, binding.points, document.nodes

    first = len(nodes)
    turns, translation = to_quaternions(numbers_of(registered.rotations)[None])[0], numbers_of(registered.translation)
    for joint, (joint_name, parent) in enumerate(zip(model.joint_names, model.parents, strict=True)):
        offset = translation if parent < 0 else rest[joint] - rest[parent]
        nodes.append({"name": joint_name, "translation": offset.tolist(), "rotation": turns[joint].tolist()})
        if children := _children(model, joint):
            nodes[-1]["children"] = [first + child for child in children]
    body, lift = len(nodes), -poses.lowest
    # Half a turn about x: from the camera frame to glTF's.
    nodes.append({"name": name, "rotation": [1.0, 0.0, 0.0, 0.0], "translation": [0.0, lift, 0.0], "children": [first]})
    nodes.append({"name": model.name, "mesh": len(document.meshes), "skin": len(document.skins)})
    document.roots += [body, body + 1]

    attributes = {
        "POSITION": document.add(bind.astype(np.float32), bounds=True),
        "NORMAL": document.add(_unit_normals(vertex_normals(bind, faces)).astype(np.float32)),
        "JOINTS_0": document.add(binding.bones.astype(np.uint16)),
        "WEIGHTS_0": document.add(binding.shares.astype(np.float32)),
    }
    if not bare:
        tones = suit_tones(suit_of(model).cloth) ** _GAMMA
        attributes["COLOR_0"] = document.add(np.repeat(tones[:, None], 3, axis=1).astype(np.float32))
    indices = document.add(faces.astype(np.uint32).reshape(-1), target=ELEMENT_ARRAY)
    # glTF's matrices are stored column by column.
    matrices = document.add(from_rest(rest).transpose(0, 2, 1).astype(np.float32))
    primitive = {"attributes": attributes, "indices": indices, "material": len(document.materials)}
    document.materials.append({"name": "body", "pbrMetallicRoughness": BODY_MATERIAL})
    document.meshes.append({"name": model.name, "primitives": [primitive]})
    document.skins.append({"joints": list(range(first, body)), "inverseBindMatrices": matrices, "skeleton": body})
    if len(poses.rotations) > 1:
        _animate(document, first, poses)
    return body


def _animate(document: Document, first: int, poses: Poses) -> None:
    """Animate the joints that move. The root's node has the index ``first``."""
    rotations, translation = poses.numbers()
    times = document.add_times(poses.times)
    document.animate(first, "translation", times, translation)
    turns = to_quaternions(rotations)
    for joint in range(rotations.shape[1]):
        if np.ptp(rotations[:, joint], axis=0).max() > _STILL:
            document.animate(first + joint, "rotation", times, turns[:, joint])


def bvh(registered: Registered, poses: Poses | None = None) -> str:
    """Write the first body's skeleton with its pose, or poses at a constant rate, as BVH [cm, degrees]."""
    model, poses = registered.model, (poses or Poses.first(registered)).evenly()
    rest, (rotations, translation) = 100 * numbers_of(registered.rest().joints), poses.numbers()
    rotations[:, 0] = GLTF_FROM_CAMERA @ rotations[:, 0]
    columns = [100 * (translation @ GLTF_FROM_CAMERA.T - [0.0, poses.lowest, 0.0])]
    lines = ["HIERARCHY"]

    def describe(joint: int, indent: str) -> None:
        parent = model.parents[joint]
        offset = np.zeros(3) if parent < 0 else rest[joint] - rest[parent]
        position = "Xposition Yposition Zposition " if parent < 0 else ""
        head = f"{'ROOT' if parent < 0 else 'JOINT'} {model.joint_names[joint]}"
        channels = f"  CHANNELS {6 if position else 3} {position}Zrotation Yrotation Xrotation"
        lines.extend(indent + line for line in (head, "{", f"  OFFSET {_numbers(offset)}", channels))
        columns.append(_euler_zyx(rotations[:, joint]))
        children = _children(model, joint)
        for child in children:
            describe(child, indent + "  ")
        end = () if children else ("  End Site", "  {", f"    OFFSET {_numbers(np.zeros(3))}", "  }")
        lines.extend(indent + line for line in (*end, "}"))

    describe(0, "")
    frames = [_numbers(row) for row in np.concatenate(columns, axis=1)]
    timing = f"Frames: {len(frames)}", f"Frame Time: {1 / poses.rate:.7f}"
    return "\n".join([*lines, "MOTION", *timing, *frames, ""])


def _children(model: DetailedModel, joint: int) -> list[int]:
    return [child for child, above in enumerate(model.parents) if above == joint]


def _upright(registered: Registered) -> tuple[np.ndarray, float]:
    """Posed vertices with y up [m], shape (V, 3), and the lowest y."""
    vertices = numbers_of(registered.detailed.vertices) @ GLTF_FROM_CAMERA.T
    return vertices, vertices[:, 1].min()


def _euler_zyx(rotations: np.ndarray) -> np.ndarray:
    """Angles [degrees] about z, y, x for ``Rz Ry Rx``, shape (T, 3). If y is at a right angle, the angle about x is 0.

    No angle jumps by a whole turn from frame to frame.
    """
    cosine = np.hypot(rotations[:, 0, 0], rotations[:, 1, 0])
    locked = cosine < 1e-6
    y = np.arctan2(-rotations[:, 2, 0], cosine)
    z = np.where(
        locked,
        np.arctan2(-rotations[:, 0, 1], rotations[:, 1, 1]),
        np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]),
    )
    x = np.where(locked, 0.0, np.arctan2(rotations[:, 2, 1], rotations[:, 2, 2]))
    return np.degrees(np.unwrap(np.stack([z, y, x], axis=1), axis=0))


def _unit_normals(normals: np.ndarray) -> np.ndarray:
    """Normals in which those of length 0 are replaced by the z axis, because glTF takes only unit vectors."""
    return np.where(normals.any(axis=1, keepdims=True), normals, [0.0, 0.0, 1.0])


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)
