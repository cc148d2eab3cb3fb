"""Poses of the people that networks learn from: motion capture, draws of the pose prior, mixed limbs, and procedure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ..body.template import LOCKED_PARTS, NUM_PARTS
from ..errors import InputError
from ..files.array_files import read_npz
from .mocap import is_held_out, without_errors
from .mocap_files import load_clips
from .poses import Poses, PriorSampler, clear_poses, draw_enough, join_poses, mirrored_half
from .procedural_poses import LIMBS, draw_procedural
from .rng import TorchRng, exact_float32

_STEP = np.radians(6.0)  # a joint turns so far, or it is the same pose
_JITTER = 0.05  # [rad], of every joint
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
    for clip in map(without_errors, load_clips(folder)):
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

    A quarter each is captured (``bank``), drawn from the prior, mixed of four captured ones and procedural. A ``pool``
    of so many is filled now and then, in which each pose is used once, so that most draws wait for nothing.
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
        kinds = (self._captured, self._prior.draw, self._mixed, draw_procedural)
        counts = np.diff(np.rint(np.linspace(0, self._size, len(kinds) + 1)).astype(int)).tolist()
        with torch.no_grad(), exact_float32(self._device):
            made = [self._make(kind, count, rng) for kind, count in zip(kinds, counts, strict=True) if count]
        order = torch.randperm(self._size, generator=rng.generator, device=self._device)
        rotations, ups = join_poses(made)
        self._pool = rotations[order], ups[order]

    def _make(self, kind: Callable[[int, TorchRng], Poses], count: int, rng: TorchRng) -> Poses:
        """Poses of one kind: what is not clear is drawn again."""

        def draw(tries: int) -> Poses:
            rotations, ups = mirrored_half(kind(min(tries, _AT_ONCE), rng), rng)
            jitter = _JITTER * rng.normal(*rotations.shape)
            jitter[:, list(LOCKED_PARTS)] = 0.0
            rotations = torch.minimum(torch.maximum(rotations + jitter, self._prior.lower), self._prior.upper)
            clear = clear_poses(rotations)
            return rotations[clear], ups[clear]

        return draw_enough(count, draw)

    def _captured(self, count: int, rng: TorchRng) -> Poses:
        frames = rng.integers(len(self._bank[0]), count)
        return self._bank[0][frames], self._bank[1][frames]

    def _mixed(self, count: int, rng: TorchRng) -> Poses:
        """Trunk, left arm, right arm and legs of four frames; the legs' frame says which way is up."""
        rotations = torch.zeros(count, NUM_PARTS, 3, device=self._device)
        for parts in LIMBS:
            others, ups = mirrored_half(self._captured(count, rng), rng)
            rotations[:, parts] = others[:, parts]
        return rotations, ups
