"""Files of motion capture, and how their poses become EllipBody's.

Three sources, all under one folder: ``cmu_expmap.npz`` + ``.json`` (CMU clips as exponential maps), ``cmu_asfamc/``
(CMU clips as ASF and gzipped AMC) and ``deepmimic/`` (humanoid quaternion text). CMU's data was obtained from
mocap.cs.cmu.edu, whose database was created with funding from NSF EIA-0196217; DeepMimic's clips are MIT.

Retargeting copies orientations, never positions, so bone lengths don't matter. Bone k of EllipBody gets the world
rotation ``R_k = R_mocap A_k``, where ``R_mocap`` is that of the joint at which the bone starts and ``A_k`` stands for
the two skeletons' different rest poses:

- arms and legs: ``A_k`` takes EllipBody's rest direction to the mocap's, on top of the ``A`` of the bone above. CMU's
  legs are splayed by 20 degrees, the ankle with them, so a minimal rotation of the foot alone would roll it.
- feet: as the limbs, but a mocap foot ends at the ball of the foot and EllipBody's at the toes, so a flat foot is
  matched to a flat foot (``FLAT_FOOT_PITCH``).
- pelvis, spine, neck, head, shoulders: mocap puts its spine joints elsewhere than EllipBody does, so directions say
  little. ``A_k`` makes the median pitch of walking people upright (``WALKING_PITCH``).
"""

from __future__ import annotations

import gzip
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path

import numpy as np
import torch

from ...body.landmarks import without_side
from ...body.rotations import rotation_between, skew
from ...body.template import LOCKED_PARTS, NUM_PARTS, PARENTS, PART_NAMES, template
from ...files.json_files import read_json
from .mocap import Clip, concatenate, is_held_out, rotation_matrices, rotation_vectors, smooth_windows

FRAME_RATE = 30.0  # of the clips of ``cmu_expmap.npz``, every fourth frame of CMU's
_CMU_UNIT = 0.0254 / 0.45  # [m]

# Angle below the horizontal of a flat foot's line from ankle to ball [degrees]: median of CMU's slow, low feet.
FLAT_FOOT_PITCH = 18.0

# Median pitch of CMU's trunk joints over all walking clips [degrees], positive leans forward: of the y axis, in the
# vertical plane of the pelvis' heading, retargeted with none of this.
WALKING_PITCH = {"pelvis": 1.4, "abdomen": 6.2, "chest": 3.7, "neck": -2.1, "head": 14.6}

# Mocap joints whose rotation a part follows. Where an EllipBody bone spans two mocap bones it lies halfway between
# their rotations; at rest it points as the first.
_EXPMAP, _ASF = 0, 1  # columns
_FOLLOWED = {
    "abdomen": ("LowerBack", "lowerback"),
    "chest": ("Spine Spine1", "upperback thorax"),
    "neck": ("Neck Neck1", "lowerneck upperneck"),
    "head": ("Head", "head"),
    "shoulder": ("{Side}Shoulder", "{s}clavicle"),
    "upper_leg": ("{Side}UpLeg", "{s}femur"),
    "lower_leg": ("{Side}Leg", "{s}tibia"),
    "foot": ("{Side}Foot", "{s}foot"),
    "upper_arm": ("{Side}Arm", "{s}humerus"),
    "forearm": ("{Side}ForeArm", "{s}radius"),
    "hand": ("{Side}FingerBase", "{s}hand"),
}
# DeepMimic's humanoid: x forward, y up, z to the right, arms hanging. Joints in file order, after time and position.
_DEEPMIMIC_AXES = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
_DEEPMIMIC_JOINTS = (
    "root chest head right_upper_leg right_lower_leg right_foot right_upper_arm right_forearm "
    "left_upper_leg left_lower_leg left_foot left_upper_arm left_forearm"
).split()

_Bones = dict[str, tuple[np.ndarray, np.ndarray]]  # part: world rotation (F, 3, 3) and rest direction (3,) of its bone


def load_clips(folder: Path | str) -> list[Clip]:
    """All clips of a mocap folder, in a fixed order.

    Raises:
        FileNotFoundError: If the folder holds none of the three sources.
    """
    folder = Path(folder)
    clips = [*_read_expmap(folder), *_read_asf(folder / "cmu_asfamc"), *_read_deepmimic(folder / "deepmimic")]
    if not clips:
        raise FileNotFoundError(f"{folder}: no cmu_expmap.npz, cmu_asfamc/ or deepmimic/ in it")
    return clips


def held_out_windows(folder: Path | str, seconds: float) -> list[Clip]:
    """Windows of motion that no network and no prior has seen, at ``FRAME_RATE``, kinds of motion in turn.

    Raises:
        FileNotFoundError: If the folder holds no ``cmu_expmap.npz``.
    """
    if not (Path(folder) / "cmu_expmap.npz").is_file():
        raise FileNotFoundError(f"{folder}: no cmu_expmap.npz in it")
    kinds: dict[str, list[Clip]] = {}
    for clip in _read_expmap(Path(folder)):
        if is_held_out(clip):
            windows = smooth_windows(clip, round(seconds * FRAME_RATE))
            kinds.setdefault(clip.name.rpartition("_")[0], []).extend(windows)
    rounds = zip_longest(*(kinds[kind] for kind in sorted(kinds)))
    return [clip for each in rounds for clip in each if clip is not None]


def held_out_frames(folder: Path | str, count: int) -> Clip:
    """Frames the prior has never seen, spread evenly over time of every held-out clip, walking counted as one clip."""
    clips = [clip for clip in load_clips(folder) if is_held_out(clip)]
    walking = [clip for clip in clips if "walking" in clip.name]
    groups = [concatenate(walking, "walking")] if walking else []
    groups += [clip for clip in clips if "walking" not in clip.name]
    shares = [count // len(groups) + (i < count % len(groups)) for i in range(len(groups))]
    # Middles of equal stretches, so that no clip gives only its first frame.
    picked = [
        group[((np.arange(share) + 0.5) * len(group) / max(share, 1)).astype(int)]
        for group, share in zip(groups, shares, strict=True)
    ]
    return concatenate(picked, "held out")


def _minimal_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that takes one direction (3,) to another."""
    return rotation_between(*(torch.from_numpy(each / np.linalg.norm(each)) for each in (source, target))).numpy()


def _halfway(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first @ rotation_matrices(0.5 * rotation_vectors(np.swapaxes(first, -1, -2) @ second))


def _pitch(degrees: float) -> np.ndarray:
    return rotation_matrices(np.array([np.radians(degrees), 0.0, 0.0]))


def _ankle_to_ball(foot: np.ndarray) -> np.ndarray:
    """Direction from ankle to ball of the flat foot that points to ``foot``, from ankle to toes."""
    horizontal = foot[[0, 2]] / np.hypot(foot[0], foot[2]) * np.cos(np.radians(FLAT_FOOT_PITCH))
    return np.array([horizontal[0], -np.sin(np.radians(FLAT_FOOT_PITCH)), horizontal[1]])


def _retarget(name: str, root: np.ndarray, bones: _Bones, trunk_pitch: dict[str, float] = WALKING_PITCH) -> Clip:
    """Copy the orientations of mocap bones; parts that have none follow their parent.

    ``root`` is the world rotation of the mocap's pelvis, shape (F, 3, 3), and ``trunk_pitch`` says how far its trunk
    parts lean forward when a person stands upright [degrees].
    """
    rest = template().rest_directions
    root_world = root @ _pitch(-trunk_pitch["pelvis"])
    corrections = np.tile(np.eye(3), (NUM_PARTS, 1, 1))
    world = np.empty((len(root), NUM_PARTS, 3, 3))
    local = np.broadcast_to(np.eye(3), world.shape).copy()
    directions = np.full((len(root), NUM_PARTS, 3), np.nan)
    for part, (name_of_part, parent) in enumerate(zip(PART_NAMES, PARENTS, strict=True)):
        above = root_world if parent < 0 else world[:, parent]
        kind = without_side(name_of_part)
        if name_of_part not in bones or part in LOCKED_PARTS:
            world[:, part] = above
            continue
        rotation, direction = bones[name_of_part]
        if kind in trunk_pitch:
            corrections[part] = _pitch(-trunk_pitch[kind])
        elif kind == "shoulder":
            corrections[part] = corrections[parent]
        else:
            start = np.eye(3) if kind.startswith("upper") else corrections[parent]
            own = _ankle_to_ball(rest[part]) if kind == "foot" else rest[part]
            corrections[part] = _minimal_rotation(start @ own, direction) @ start
        world[:, part] = rotation @ corrections[part]
        directions[:, part] = rotation @ (direction / np.linalg.norm(direction))
        local[:, part] = np.swapaxes(above, -1, -2) @ world[:, part]
    return Clip(name, root_world, local, directions)


def _follow(column: int, world: Mapping[str, np.ndarray], rest: Mapping[str, np.ndarray]) -> _Bones:
    """Bones of EllipBody's parts, of world rotations and rest directions by mocap joint."""
    bones = {}
    for kind, names in _FOLLOWED.items():
        for side in ("",) if kind in PART_NAMES else ("Left", "Right"):
            own = names[column].format(Side=side, s=side[:1].lower()).split()
            rotations = [world[name] for name in own]
            rotation = rotations[0] if len(own) == 1 else _halfway(*rotations)
            bones[f"{side.lower()}_{kind}".lstrip("_")] = rotation, rest[own[0]]
    return bones


def _read_expmap(folder: Path) -> Iterator[Clip]:
    """Clips of ``cmu_expmap.npz``: root translation and 38 exponential maps a frame, row-vector kinematics."""
    if not (folder / "cmu_expmap.npz").is_file():
        return
    skeleton = read_json(folder / "cmu_expmap.json", "the skeleton of cmu_expmap.npz")
    names, offsets = skeleton["joints"], np.array(skeleton["offsets_mm"])
    parents = [names[parent] if parent >= 0 else "" for parent in skeleton["parents"]]
    rest = dict(zip(reversed(parents), offsets[::-1], strict=True))  # a bone ends at its joint's first child
    with np.load(folder / "cmu_expmap.npz", allow_pickle=False) as data:
        for key in data.files:
            # Each clip starts with one frame in the rest pose, which nobody performed.
            values = data[key][1:].astype(np.float64)
            # Row vectors: the column-vector rotation is the transpose, so the exponents change sign and order.
            exponentials = rotation_matrices(-values[:, 3:].reshape(-1, len(names), 3))
            world: dict[str, np.ndarray] = {}
            for joint, (name, parent) in enumerate(zip(names, parents, strict=True)):
                world[name] = world[parent] @ exponentials[:, joint] if parent else exponentials[:, joint]
            clip = _retarget(f"expmap.{key}", world[names[0]], _follow(_EXPMAP, world, rest))
            yield replace(clip, positions=_CMU_UNIT * values[:, :3])


@dataclass(frozen=True)
class _AsfBone:
    direction: np.ndarray  # (3,)
    axis: np.ndarray  # (3, 3), the frame in which the bone's angles are meant
    channels: tuple[int, ...]  # which of rx, ry, rz the AMC gives
    parent: str


def _euler_xyz(degrees: np.ndarray) -> np.ndarray:
    """Angles (..., 3) about x, then y, then z of the fixed frame [degrees] to matrices (..., 3, 3)."""
    x, y, z = (rotation_matrices(np.radians(degrees[..., i : i + 1]) * np.eye(3)[i]) for i in range(3))
    return z @ y @ x


@lru_cache(maxsize=8)
def _read_asf_skeleton(path: Path) -> dict[str, _AsfBone]:
    """Bones of an ASF file, parents before children."""
    text = path.read_text()
    rows = [line.split() for line in text.split(":hierarchy")[1].splitlines()]
    parents = {child: parent for parent, *children in filter(None, rows) for child in children}
    bones = {}
    for block in text.split(":bonedata")[1].split(":hierarchy")[0].split("begin")[1:]:
        fields = {key: values for key, *values in filter(None, map(str.split, block.splitlines()))}
        bones[fields["name"][0]] = _AsfBone(
            direction=np.array(fields["direction"][:3], dtype=np.float64),
            axis=_euler_xyz(np.array(fields["axis"][:3], dtype=np.float64)),
            channels=tuple("rx ry rz".split().index(channel) for channel in fields.get("dof", [])),
            parent=parents[fields["name"][0]],
        )
    return bones


def _read_asf(folder: Path) -> Iterator[Clip]:
    """Clips of ``SUBJECT.asf`` and ``SUBJECT_TRIAL.amc.gz``."""
    for path in sorted(folder.glob("*.amc.gz")):
        name = path.name.removesuffix(".amc.gz")
        skeleton = _read_asf_skeleton(folder / f"{name.split('_')[0]}.asf")
        channels: dict[str, list[list[float]]] = {}
        for line in gzip.decompress(path.read_bytes()).decode("ascii").splitlines():
            words = line.split()
            if len(words) > 1 and not words[0].startswith(("#", ":")):
                channels.setdefault(words[0], []).append([float(word) for word in words[1:]])
        world = {"root": _euler_xyz(np.array(channels["root"])[:, 3:])}
        for bone_name, bone in skeleton.items():
            angles = np.zeros((len(world["root"]), 3))
            if bone.channels:
                angles[:, bone.channels] = np.array(channels[bone_name])
            world[bone_name] = world[bone.parent] @ (bone.axis @ _euler_xyz(angles) @ bone.axis.T)
        rest = {bone_name: bone.direction for bone_name, bone in skeleton.items()}
        yield _retarget(f"asf.{name}", world["root"], _follow(_ASF, world, rest))


def _read_deepmimic(folder: Path) -> Iterator[Clip]:
    """Clips of the humanoid's text files: quaternions (w, x, y, z), hinges about z."""
    # CMU's elbow axis is tilted by 30 degrees against its T-pose, so the arms of the two agree after this turn.
    arm_down = rotation_matrices(np.array([0.0, 0.0, -np.pi / 2])) @ rotation_matrices(np.array([np.pi / 6, 0.0, 0.0]))
    flip = np.outer([-1.0, 1.0, 1.0], [-1.0, 1.0, 1.0])
    upward, ahead = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    for path in sorted(folder.glob("humanoid3d_*.txt")):
        frames = np.array(read_json(path, "a clip of DeepMimic")["Frames"], dtype=np.float64)
        local: dict[str, np.ndarray] = {}
        start = 4
        for joint in _DEEPMIMIC_JOINTS:
            if joint.endswith(("lower_leg", "forearm")):
                local[joint] = rotation_matrices(frames[:, start : start + 1] * (_DEEPMIMIC_AXES @ ahead))
                start += 1
            else:
                turn = _quaternion_matrices(frames[:, start : start + 4])
                local[joint] = _DEEPMIMIC_AXES @ turn @ _DEEPMIMIC_AXES.T
                start += 4
        root = local["root"]
        chest = root @ local["chest"]
        head = chest @ local["head"]
        bones: _Bones = {"abdomen": (_halfway(root, chest), upward), "chest": (chest, upward)}
        bones |= {"neck": (_halfway(chest, head), upward), "head": (head, upward)}
        for side, out, rest in (("left", 1.0, arm_down), ("right", -1.0, arm_down * flip)):
            arm = chest @ local[f"{side}_upper_arm"]
            leg = root @ local[f"{side}_upper_leg"]
            shin = leg @ local[f"{side}_lower_leg"]
            sideways = np.array([out, 0.0, 0.0])
            bones[f"{side}_upper_arm"] = (arm @ rest, sideways)
            bones[f"{side}_forearm"] = (arm @ local[f"{side}_forearm"] @ rest, sideways)
            bones[f"{side}_upper_leg"] = (leg, -upward)
            bones[f"{side}_lower_leg"] = (shin, -upward)
            bones[f"{side}_foot"] = (shin @ local[f"{side}_foot"], _ankle_to_ball(ahead))
        name = f"deepmimic.{path.stem.removeprefix('humanoid3d_')}"
        yield _retarget(name, root, bones, dict.fromkeys(WALKING_PITCH, 0.0))


def _quaternion_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) as (w, x, y, z), of any length, to matrices (..., 3, 3)."""
    unit = torch.nn.functional.normalize(torch.from_numpy(quaternions), dim=-1)
    w, cross = unit[..., :1, None], skew(unit[..., 1:])
    return (torch.eye(3) + 2 * w * cross + 2 * cross @ cross).numpy()
