"""SMPL, SMPL-H and SMPL-X: their joints in the terms of our parts and landmarks, and a model from a file's arrays.

The three share the body's 22 joints and the arrays' names. Their body frame is ours (x to the person's left, y up, z
forward) and they rest in a T-pose, palms down. The models are not free; ``load.py`` reads a user's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from ..body.template import PART_NAMES
from ..errors import check_whole
from .model import DetailedModel
from .skin import RiggedSkin, skinned_model

Layout = dict[str, tuple[tuple[int | str, ...], str]]
# Name: its dimensions, of which V, F, J, S and 9 (J - 1) are the model's, and the kind of its numbers.
ARRAYS: Layout = {
    "v_template": (("V", 3), "f"),
    "shapedirs": (("V", 3, "S"), "f"),
    "posedirs": (("V", 3, "9 (J - 1)"), "f"),
    "J_regressor": (("J", "V"), "f"),
    "weights": (("V", "J"), "f"),
    "kintree_table": ((2, "J"), "iu"),
    "f": (("F", 3), "iu"),
}
DEFAULT_SHAPES = 10  # how many shape values are used, as is usual
_WEIGHT_TOLERANCE = 0.01  # by which the weights of a vertex may miss a sum of 1

_BODY = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot "
    "neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist"
).split()
_FINGERS = [
    f"{side}_{finger}{knuckle}"
    for side in ("left", "right")
    for finger in ("index", "middle", "pinky", "ring", "thumb")
    for knuckle in (1, 2, 3)
]
SMPL_JOINTS = (*_BODY, "left_hand", "right_hand")
_MODELS: dict[str, tuple[str, ...]] = {
    "smpl": SMPL_JOINTS,
    "smplh": (*_BODY, *_FINGERS),
    "smplx": (*_BODY, "jaw", "left_eye", "right_eye", *_FINGERS),
}

# Part of the skin that follows a joint, by the joint's name without its side; the first matching beginning wins. The
# pelvis' skin belongs to the hip of its side.
_PARTS: tuple[tuple[str, str], ...] = (
    ("spine1", "abdomen"),
    ("spine", "chest"),
    ("neck", "neck"),
    ("head", "head"),
    ("jaw", "head"),
    ("*eye", "head"),
    ("*collar", "*shoulder"),
    ("*shoulder", "*upper_arm"),
    ("*elbow", "*forearm"),
    ("*hip", "*upper_leg"),
    ("*knee", "*lower_leg"),
    ("*ankle", "*foot"),
    ("*foot", "*foot"),
    ("*", "*hand"),
)

_MIDDLE_LANDMARKS: dict[str, tuple[str, ...]] = {
    "pelvis": ("pelvis",),
    "mid_hip": ("left_hip", "right_hip"),
    "spine": ("spine2",),
    "neck": ("left_shoulder", "right_shoulder"),  # As skeletons.py has it.
    "head": ("head",),
}
# Landmark: the joint that it is, on both sides, where the model has it.
_SIDED_LANDMARKS: dict[str, str] = {
    **{name: name for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")},
    "thumb": "thumb3",
    "index": "index1",
    "pinky": "pinky1",
}
# Vertices that smplx's users know as keypoints, by the size of the mesh.
_VERTEX_LANDMARKS = (
    "nose left_eye right_eye left_ear right_ear left_big_toe right_big_toe left_small_toe right_small_toe left_heel "
    "right_heel"
).split()
_VERTICES: dict[int, tuple[int, ...]] = {
    6890: (332, 2800, 6260, 583, 4071, 3216, 6617, 3226, 6624, 3387, 6787),
    10475: (9120, 9448, 9929, 6, 616, 5770, 8463, 5780, 8474, 8846, 8635),
}


def check_smpl(arrays: Mapping[str, np.ndarray], where: str) -> str:
    """Identify the model of a file's ``ARRAYS``: "smpl", "smplh" or "smplx".

    Raises:
        ValueError: If an array is missing, or has a wrong shape, dtype or value; it begins with ``where``.
    """
    check_layout(arrays, where, ARRAYS)
    joints = len(arrays["J_regressor"])
    known = {len(names): model for model, names in _MODELS.items()}
    if joints not in known:
        described = ", ".join(f"{size} ({model})" for size, model in known.items())
        raise ValueError(f"{where}: kintree_table: {joints} joints; expected {described}")
    return known[joints]


def check_layout(
    arrays: Mapping[str, np.ndarray], where: str, layout: Layout, called: Mapping[str, str] | None = None
) -> None:
    """Check arrays of a file against a layout, that of ``ARRAYS`` or more.

    Args:
        arrays: Arrays by the layout's names.
        where: Beginning of messages, such as the file's name.
        layout: Dimensions and kinds of numbers of each array.
        called: Names in the file, by the layout's names, for messages. By default, they are the same.

    Raises:
        ValueError: If an array is missing, or has a wrong shape, dtype or value.
    """
    own = {name: (called or {}).get(name, name) for name in layout}
    for name, (_, kind) in layout.items():
        if name not in arrays:
            raise ValueError(f"{where}: no array {own[name]!r}; expected {', '.join(own.values())}")
        if arrays[name].dtype.kind not in kind:
            numbers = "floating numbers" if kind == "f" else "integers"
            raise ValueError(f"{where}: {own[name]}: {arrays[name].dtype}; expected {numbers}")
    shapes = {name: np.atleast_1d(arrays[name]).shape for name in layout}
    joints = shapes["kintree_table"][-1]
    sizes = {"V": shapes["v_template"][0], "F": shapes["f"][0], "S": shapes["shapedirs"][-1]}
    sizes |= {"J": joints, "9 (J - 1)": 9 * (joints - 1)}
    for name, (dimensions, kind) in layout.items():
        array = arrays[name]
        expected = tuple(sizes[size] if isinstance(size, str) else size for size in dimensions)
        if array.shape != expected or 0 in expected:
            described = _shape(dimensions, sizes)
            raise ValueError(f"{where}: {own[name]}: shape {array.shape}; expected ({described}), none 0")
        if kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{where}: {own[name]}: holds NaN or infinity; expected finite numbers")
    faces, (parents, children) = arrays["f"], arrays["kintree_table"]
    if faces.min() < 0 or faces.max() >= sizes["V"]:
        raise ValueError(f"{where}: {own['f']}: vertex {faces.min()} to {faces.max()}; expected 0 to {sizes['V'] - 1}")
    if (children != np.arange(joints)).any() or (parents[1:] >= children[1:]).any() or (parents[1:] < 0).any():
        tree = own["kintree_table"]
        raise ValueError(f"{where}: {tree}: expected joints 0 to {joints - 1} in order, each after its parent")
    sums = arrays["weights"].astype(np.float64).sum(1)
    if np.abs(sums - 1).max() > _WEIGHT_TOLERANCE:
        raise ValueError(f"{where}: {own['weights']}: rows sum to {sums.min():.3g} to {sums.max():.3g}; expected 1")


def smpl_model(
    arrays: Mapping[str, np.ndarray],
    where: str,
    *,
    num_shapes: int | None = None,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> DetailedModel:
    """Make a model of a file's ``ARRAYS``; messages begin with ``where``. Arguments are those of ``load_model``.

    Raises:
        ValueError: If ``check_smpl`` raises it, or if the file has fewer shape values than asked for.
    """
    name = check_smpl(arrays, where)
    names = _MODELS[name]
    num_shapes = choose_shapes(num_shapes, arrays["shapedirs"].shape[2])
    vertices, weights, regressor = (arrays[key].astype(np.float64) for key in ("v_template", "weights", "J_regressor"))
    directions = np.moveaxis(arrays["shapedirs"][..., :num_shapes].astype(np.float64), 2, 0)
    joints = regressor @ vertices
    parents = (-1, *arrays["kintree_table"][0, 1:].tolist())
    moved, parts = regressor @ directions, parts_of_joints(names)
    skin = RiggedSkin(names, parents, arrays["f"], vertices, directions, joints, moved, weights, parts)
    landmarks = joint_landmarks(names, vertices, joints, skin.vertex_parts)
    bends = arrays["posedirs"].reshape(3 * len(vertices), -1).T
    return skinned_model(name, skin, landmarks, pose_directions=bends, device=device, dtype=dtype)


def choose_shapes(asked: int | None, available: int) -> int:
    """Number of a file's shape values that are used.

    Raises:
        ValueError: If there are fewer than asked for.
    """
    return check_whole("num_shapes", min(DEFAULT_SHAPES, available) if asked is None else asked, 0, available)


def _shape(dimensions: tuple[int | str, ...], sizes: dict[str, int]) -> str:
    return ", ".join(f"{size} = {sizes[size]}" if size in sizes else str(size) for size in dimensions)


def parts_of_joints(names: Sequence[str]) -> np.ndarray:
    """Part of the skin that follows each joint, by SMPL's names, -1 for the pelvis', shape (J,)."""
    return np.array([_part_of(name) for name in names])


def _part_of(joint: str) -> int:
    if joint == "pelvis":
        return -1
    side, _, name = joint.partition("_")
    for beginning, part in _PARTS:
        if (f"*{name}" if name else joint).startswith(beginning):
            return PART_NAMES.index(part.replace("*", f"{side}_"))
    raise AssertionError(joint)


def joint_landmarks(
    names: Sequence[str], vertices: np.ndarray, joints: np.ndarray, vertex_parts: np.ndarray
) -> dict[str, np.ndarray]:
    """Weights of vertices and then joints, shape (V + J,), of each landmark; joints by SMPL's names."""
    count = len(vertices)
    points = {name: [count + names.index(each) for each in sources] for name, sources in _MIDDLE_LANDMARKS.items()}
    for side in ("left", "right"):
        for name, source in _SIDED_LANDMARKS.items():
            if f"{side}_{source}" in names:
                points[f"{side}_{name}"] = [count + names.index(f"{side}_{source}")]
    # The ends of head, feet and hands, wherever a mesh has them.
    heights, depths = vertices[:, 1], vertices[:, 2]
    ends = {"head_top": ("head", heights)}
    for side in ("left", "right"):
        wrist = joints[names.index(f"{side}_wrist")]
        ends[f"{side}_toe"] = ends[f"{side}_foot_index"] = (f"{side}_foot", depths)
        ends[f"{side}_fingertip"] = (f"{side}_hand", np.linalg.norm(vertices - wrist, axis=1))
    for name, (part, extents) in ends.items():
        inside = np.flatnonzero(vertex_parts == PART_NAMES.index(part))
        if len(inside):
            points[name] = [int(inside[extents[inside].argmax()])]
    if count in _VERTICES:
        points |= {name: [vertex] for name, vertex in zip(_VERTEX_LANDMARKS, _VERTICES[count], strict=True)}
    rows = {}
    for name, shared in points.items():
        rows[name] = np.zeros(count + len(joints))
        rows[name][shared] = 1 / len(shared)
    return rows
