"""Poses of the people that networks learn from: motion capture, draws of the pose prior, mixed limbs, and procedure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ...body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ...body.template import LOCKED_PARTS, NUM_PARTS
from ...errors import InputError
from ...files.array_files import read_npz
from .mocap import is_held_out, straightened, without_errors
from .mocap_files import load_clips
from .poses import Poses, PriorSampler, clear_poses, draw_enough, join_poses, mirrored_half
from .procedural_poses import BROAD, LIMBS, SEATED, SPORT, STANDING, draw_procedural
from .rng import TorchRng, exact_float32
from .touching_poses import touching

_STEP = np.radians(6.0)  # a joint turns so far, or it is the same pose
_JITTER = 0.05  # [rad], of every joint
_LOOSENED, _LOOSE_JITTER = 0.3, (0.1, 0.3)  # share of poses one limb of which is jittered more, and by how much [rad]
_EXAGGERATION = (0.6, 1.4)  # of a limb's turns from the mean pose
_BETWEEN = (-0.25, 1.0)  # how far from one captured pose to one like it
_ALIKE = 16  # frames, of which the most alike one is taken
# Shares. People in photos mostly stand, walk and sit: about half of all do as those captured did, or stand at ease.
POSE_KINDS = {
    "captured": 0.17,
    "varied": 0.17,
    "mixed": 0.14,
    "prior": 0.15,
    "standing": 0.08,
    "seated": 0.08,
    "broad": 0.07,
    "sport": 0.03,
    "touching": 0.11,
}
_MIXED = {"captured": 0.4, "varied": 0.25, "prior": 0.15, "standing": 0.1, "seated": 0.1}
_REPERTOIRES = {"standing": STANDING, "seated": SEATED, "broad": BROAD, "sport": SPORT}
_TOUCHING = {"captured": 0.12, "standing": 0.5, "seated": 0.23, "broad": 0.15}
_AT_ONCE = 4096  # poses, of which a few arrays of 13 kB each are in memory


@dataclass(frozen=True)
class PoseBank:
    """Poses that somebody took."""

    rotations: torch.Tensor  # local rotation vectors [rad], shape (N, 20, 3), float32
    ups: torch.Tensor  # directions of the vertical, upward, in the pelvis' frame, shape (N, 3), float32

    @classmethod
    def read(cls, source: Path | str, *, held_out: bool = False) -> PoseBank:
        """Poses of a folder of clips (see ``mocap_files.py``) or a file of ``pack_poses``, to train on or ``held_out``.

        Raises:
            InputError: If there is no such file, or it holds none of these poses.
            FileNotFoundError: If the folder holds no clips.
        """
        data = _frames(source) if Path(source).is_dir() else _unpack(source)
        chosen = data["held_out"] == held_out
        if not chosen.any():
            raise InputError(f"{source}: no poses {'held out' if held_out else 'to train on'}; expected some")
        rotations, ups = (torch.from_numpy(data[name][chosen].astype(np.float32)) for name in ("rotations", "ups"))
        return cls(rotations, torch.nn.functional.normalize(ups, dim=-1))

    @classmethod
    def of_prior(cls, count: int = 4096, *, seed: int = 0) -> PoseBank:
        """Draws of the packaged prior, for those who have no motion capture."""
        return cls(*PriorSampler(torch.device("cpu")).draw(count, TorchRng(seed, "cpu")))


def pack_poses(folder: Path | str, path: Path | str) -> None:
    """Write the poses of a folder of clips, held-out ones too, to a small file (.npz) that ``PoseBank.read`` takes."""
    data = _frames(folder)
    halves = {name: data[name].astype(np.float16) for name in ("rotations", "ups")}
    np.savez_compressed(path, allow_pickle=False, held_out=data["held_out"], **halves)


def _frames(folder: Path | str) -> dict[str, np.ndarray]:
    """Poses of all clips that differ from the one before, and which are held out."""
    parts: dict[str, list[np.ndarray]] = {"rotations": [], "ups": [], "held_out": []}
    for clip in map(without_errors, map(straightened, load_clips(folder))):
        vectors = clip.rotation_vectors()
        kept: list[int] = []
        for frame, vector in enumerate(vectors):
            if not kept or np.abs(vector - vectors[kept[-1]]).max() > _STEP:
                kept.append(frame)
        parts["rotations"].append(vectors[kept])
        parts["ups"].append(clip.up_directions()[kept])
        parts["held_out"].append(np.full(len(kept), is_held_out(clip)))
    return {name: np.concatenate(arrays) for name, arrays in parts.items()}


def _unpack(path: Path | str) -> dict[str, np.ndarray]:
    shapes = {"rotations": (NUM_PARTS, 3), "ups": (3,), "held_out": ()}
    data = read_npz(path, tuple(shapes), expected="a file of pack_poses, or a folder of clips")
    for name, shape in shapes.items():
        values, expected = data[name], (len(data["held_out"]), *shape)
        if values.dtype.kind not in "fb" or values.shape != expected or not np.isfinite(values).all():
            raise InputError(f"{path}: {name} of shape {values.shape}; expected finite numbers (N, *{shape})")
    return data


class PoseSampler:
    """Poses within the joint limits in which no limb is inside another part, either side's as often.

    Each of ``POSE_KINDS`` has its share. A ``pool`` of so many is filled now and then, in which each pose is used once,
    so that most draws wait for nothing.
    """

    def __init__(self, bank: PoseBank, *, device: torch.device | str = "cpu", seed: int = 0, pool: int = 8192) -> None:
        self._bank = bank.rotations.to(device), bank.ups.to(device)
        self._prior = PriorSampler(torch.device(device))
        self._device, self._seed, self._size = torch.device(device), seed, pool
        self._refills = self._used = 0
        self._refill()

    def draw(self, count: int) -> Poses:
        """The next ``count`` poses: rotation vectors, shape (count, 20, 3), and up directions, shape (count, 3)."""
        taken: list[Poses] = []
        while not taken or count > 0:
            if self._used == self._size:
                self._refill()
            end = min(self._used + count, self._size)
            taken.append((self._pool[0][self._used : end], self._pool[1][self._used : end]))
            count -= end - self._used
            self._used = end
        return join_poses(taken)

    def state_dict(self) -> dict[str, int]:
        """The sampler's place in its stream of poses."""
        return {"refills": self._refills, "used": self._used}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Go on from there: the pool is made again as it was."""
        self._refills = state["refills"] - 1
        self._refill()
        self._used = state["used"]

    def _refill(self) -> None:
        self._refills += 1
        self._used = 0
        rng = TorchRng(self._seed + self._refills, self._device)
        counts = _shared_out(POSE_KINDS, self._size)
        with torch.no_grad(), exact_float32(self._device):
            made = [self._make(kind, count, rng) for kind, count in counts.items() if count]
        order = torch.randperm(self._size, generator=rng.generator, device=self._device)
        rotations, ups = join_poses(made)
        self._pool = rotations[order], ups[order]

    def _make(self, kind: str, count: int, rng: TorchRng) -> Poses:
        """Poses of one kind: what is not clear is drawn again."""

        def draw(tries: int) -> Poses:
            tries = min(tries, _AT_ONCE)
            rotations, ups = self._draw(kind, tries, rng)
            rotations = self._prior.limits.clamp(rotations + _jitter(tries, rng))
            fits = torch.ones_like(ups[:, 0], dtype=torch.bool)
            if kind == "touching":  # after all else, for hands are to stay where they are put
                (rotations, ups), gestures = touching((rotations, ups), self._prior.limits, rng)
                fits = gestures >= 0
            rotations, ups = mirrored_half((rotations, ups), rng)
            fits &= clear_poses(rotations)
            return rotations[fits], ups[fits]

        return draw_enough(count, draw)

    def _draw(self, kind: str, count: int, rng: TorchRng) -> Poses:
        """Poses of one of ``POSE_KINDS``, as they come: limits and self-penetration are not looked at."""
        if kind in _REPERTOIRES:
            return draw_procedural(count, rng, _REPERTOIRES[kind])
        if kind == "touching":
            return self._some_of(_TOUCHING, count, rng)
        if kind == "prior":
            return self._prior.draw(count, rng)
        return {"captured": self._captured, "varied": self._varied, "mixed": self._mixed}[kind](count, rng)

    def _captured(self, count: int, rng: TorchRng) -> Poses:
        frames = rng.integers(len(self._bank[0]), count)
        return self._bank[0][frames], self._bank[1][frames]

    def _varied(self, count: int, rng: TorchRng) -> Poses:
        """Poses between two frames that are alike, or beyond one, limbs of which differ more from the mean, or less."""
        first, ups = self._captured(count, rng)
        frames = rng.integers(len(self._bank[0]), count, _ALIKE)
        like = (self._bank[0][frames] - first[:, None]).flatten(2).square().sum(2).argmin(1)
        frames = frames[torch.arange(count, device=self._device), like]
        share = rng.uniform(count, 1, low=_BETWEEN[0], high=_BETWEEN[1])
        start, end = rotation_from_axis_angle(first), rotation_from_axis_angle(self._bank[0][frames])
        turns = rotation_from_axis_angle(share[..., None] * rotation_to_axis_angle(start.mT @ end))
        rotations = rotation_to_axis_angle(start @ turns)
        mean = self._prior.mean
        for parts in LIMBS:
            factor = rng.uniform(count, 1, 1, low=_EXAGGERATION[0], high=_EXAGGERATION[1])
            rotations[:, parts] = mean[parts] + factor * (rotations[:, parts] - mean[parts])
        return rotations, torch.nn.functional.normalize(ups.lerp(self._bank[1][frames], share), dim=1)

    def _mixed(self, count: int, rng: TorchRng) -> Poses:
        """Trunk, left arm, right arm and legs of four poses; the legs' pose says which way is up."""
        others, their_ups = mirrored_half(self._some_of(_MIXED, count, rng), rng)
        rotations = torch.zeros_like(others)
        for parts in LIMBS:
            frames = rng.integers(count, count)
            rotations[:, parts] = others[frames][:, parts]
        return rotations, their_ups[frames]

    def _some_of(self, shares: dict[str, float], count: int, rng: TorchRng) -> Poses:
        """Poses of several kinds, one kind after the other."""
        counts = _shared_out(shares, count)
        return join_poses([self._draw(kind, some, rng) for kind, some in counts.items() if some])


def _shared_out(shares: dict[str, float], count: int) -> dict[str, int]:
    """Numbers of each kind that make ``count`` together."""
    ends = np.rint(np.cumsum([0.0, *shares.values()]) * count).astype(int)
    return dict(zip(shares, np.diff(ends).tolist(), strict=True))


def _jitter(count: int, rng: TorchRng) -> torch.Tensor:
    """Noise of all joints, and more of one limb of some poses [rad], shape (count, 20, 3)."""
    widths = torch.full((count, NUM_PARTS, 1), _JITTER, device=rng.device)
    limb, loosened = rng.integers(len(LIMBS), count), rng.chance(_LOOSENED, count)
    more = rng.uniform(count, 1, low=_LOOSE_JITTER[0], high=_LOOSE_JITTER[1])
    for index, parts in enumerate(LIMBS):
        chosen = (loosened & (limb == index))[:, None, None]
        widths[:, parts] = torch.where(chosen, more[..., None], widths[:, parts])
    widths[:, list(LOCKED_PARTS)] = 0.0
    return widths * rng.normal(count, NUM_PARTS, 3)
