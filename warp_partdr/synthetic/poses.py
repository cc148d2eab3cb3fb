"""How the people stand that networks learn from: motion capture, draws of the pose prior, mixed limbs, and procedure.

EllipBody's rotation vectors [rad]; +x of a joint bends the trunk forward, the knee backward and turns the leg back, and
the left arm, which points to +x at rest, comes down about -z and forward about -y. All that is random is on a device.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from ..body.pose_prior import FREE_PARTS, PosePrior, mirror_features
from ..body.posing import Posed, pose
from ..body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ..body.template import LOCKED_PARTS, NUM_PARTS, PART_NAMES, template
from ..errors import InputError
from ..files.array_files import read_npz
from .bench_poses import LIKELY, OVER_LIMITS, SPREAD, is_clear, pose_mixture
from .dice import Dice, exact
from .mocap import load_clips, without_errors
from .split import held_out_clips

_STEP = np.radians(6.0)  # a joint turns so far, or it is the same pose
_JITTER = 0.05  # [rad], of every joint
_AT_ONCE = 4096  # poses, of which a few arrays of 13 kB each are in memory

Poses = tuple[torch.Tensor, torch.Tensor]  # rotation vectors (N, 20, 3) and up directions in the pelvis' frame (N, 3)


@dataclass(frozen=True)
class PoseBank:
    """Poses that somebody took.

    Attributes:
        rotations: Local rotation vectors [rad], shape (N, 20, 3), float32.
        ups: Which way is up, in the pelvis' frame, shape (N, 3), float32.
    """

    rotations: torch.Tensor
    ups: torch.Tensor

    @classmethod
    def read(cls, source: Path | str, *, held_out: bool = False) -> PoseBank:
        """Poses of motion capture.

        Args:
            source: A folder of clips (see ``mocap.py``), or a file of ``pack_poses``.
            held_out: Those that are kept from training, instead of those to train on.

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
        return cls(*_Prior(torch.device("cpu")).draw(count, Dice(seed, "cpu")))


def pack_poses(folder: Path | str, path: Path | str) -> None:
    """Write the poses of a folder of clips, held-out ones too, to a small file (.npz) that ``PoseBank.read`` takes."""
    data = _frames(folder)
    halves = {name: data[name].astype(np.float16) for name in ("rotations", "ups")}
    np.savez_compressed(path, allow_pickle=False, held_out=data["held_out"], **halves)


def _frames(folder: Path | str) -> dict[str, np.ndarray]:
    """Poses of all clips that differ from the one before, and which are held out."""
    parts: dict[str, list[np.ndarray]] = {"rotations": [], "ups": [], "held_out": []}
    held_out = held_out_clips()
    for clip in map(without_errors, load_clips(folder)):
        vectors = clip.rotation_vectors()
        kept: list[int] = []
        for frame, vector in enumerate(vectors):
            if not kept or np.abs(vector - vectors[kept[-1]]).max() > _STEP:
                kept.append(frame)
        parts["rotations"].append(vectors[kept])
        parts["ups"].append(clip.up_directions()[kept])
        parts["held_out"].append(np.full(len(kept), clip.name in held_out))
    return {name: np.concatenate(arrays) for name, arrays in parts.items()}


def _unpack(path: Path | str) -> dict[str, np.ndarray]:
    shapes = {"rotations": (NUM_PARTS, 3), "ups": (3,), "held_out": ()}
    data = read_npz(path, tuple(shapes), expected="a file of pack_poses, or a folder of clips")
    for name, shape in shapes.items():
        values = data[name]
        if (
            values.dtype.kind not in "fb"
            or values.shape != (len(data["held_out"]), *shape)
            or not np.isfinite(values).all()
        ):
            raise InputError(f"{path}: {name} of shape {values.shape}; expected finite numbers (N, *{shape})")
    return data


@dataclass(frozen=True)
class Shares:
    """How much of the people have which kind of pose; only their ratios count."""

    captured: float = 0.25
    prior: float = 0.25
    mixed: float = 0.25
    procedural: float = 0.25


class PoseSampler:
    """Poses within the joint limits in which no limb is inside another part, either side's as often.

    A pool is filled now and then, in which each pose is used once, so that most draws wait for nothing.

    Args:
        bank: Motion capture.
        device: Where poses are made.
        seed: Of the random numbers.
        shares: Of the kinds.
        pool: How many poses are made at once.
    """

    def __init__(
        self,
        bank: PoseBank,
        *,
        device: torch.device | str = "cpu",
        seed: int = 0,
        shares: Shares | None = None,
        pool: int = 8192,
    ) -> None:
        self._bank = bank.rotations.to(device), bank.ups.to(device)
        self._prior = _Prior(torch.device(device))
        self._device, self._seed, self._size = torch.device(device), seed, pool
        kinds = (self._captured, self._prior.draw, self._mixed, draw_procedural)
        self._kinds = dict(zip(kinds, astuple(shares or Shares()), strict=True))
        self._refills = self._used = 0
        self._pool: Poses = self._bank
        self._refill()

    def draw(self, count: int) -> Poses:
        """The next ``count`` poses: rotation vectors, shape (count, 20, 3), and up directions, shape (count, 3)."""
        taken: list[Poses] = []
        while count > 0:
            if self._used == self._size:
                self._refill()
            end = min(self._used + count, self._size)
            taken.append((self._pool[0][self._used : end], self._pool[1][self._used : end]))
            count -= end - self._used
            self._used = end
        rotations, ups = zip(*taken, strict=True) if taken else ([self._pool[0][:0]], [self._pool[1][:0]])
        return torch.cat(rotations), torch.cat(ups)

    def state_dict(self) -> dict[str, int]:
        """Where the sampler is."""
        return {"refills": self._refills, "used": self._used}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Go on from there: the pool is made again as it was."""
        self._refills = state["refills"] - 1
        self._refill()
        self._used = state["used"]

    def _refill(self) -> None:
        self._refills += 1
        self._used = 0
        dice = Dice(self._seed + self._refills, self._device)
        ends = np.rint(np.cumsum(list(self._kinds.values())) / sum(self._kinds.values()) * self._size).astype(int)
        counts = np.diff(ends, prepend=0).tolist()
        with torch.no_grad(), exact(self._device):
            made = [self._make(kind, count, dice) for kind, count in zip(self._kinds, counts, strict=True) if count]
        order = torch.randperm(self._size, generator=dice.generator, device=self._device)
        rotations, ups = (torch.cat(values)[order] for values in zip(*made, strict=True))
        self._pool = rotations, ups

    def _make(self, kind: Callable[[int, Dice], Poses], count: int, dice: Dice) -> Poses:
        """Poses of one kind: what is not clear is drawn again."""
        made: list[Poses] = []
        while count > 0:
            rotations, ups = mirrored_half(kind(min(2 * count + 16, _AT_ONCE), dice), dice)
            jitter = _JITTER * dice.normal(*rotations.shape)
            jitter[:, list(LOCKED_PARTS)] = 0.0
            rotations = torch.minimum(torch.maximum(rotations + jitter, self._prior.lower), self._prior.upper)
            clear = clear_poses(rotations).nonzero()[:count, 0]
            made.append((rotations[clear], ups[clear]))
            count -= len(clear)
        return torch.cat([rotations for rotations, _ in made]), torch.cat([ups for _, ups in made])

    def _captured(self, count: int, dice: Dice) -> Poses:
        frames = dice.integers(len(self._bank[0]), count)
        return self._bank[0][frames], self._bank[1][frames]

    def _mixed(self, count: int, dice: Dice) -> Poses:
        """Trunk, left arm, right arm and legs of four frames; the legs' frame says which way is up."""
        rotations = torch.zeros(count, NUM_PARTS, 3, device=self._device)
        for parts in _LIMBS:
            others, ups = mirrored_half(self._captured(count, dice), dice)
            rotations[:, parts] = others[:, parts]
        return rotations, ups


class _Prior:
    """The packaged prior's mixture, to draw from on a device."""

    def __init__(self, device: torch.device) -> None:
        prior, mixture = pose_mixture()
        self._prior = PosePrior().to(device)
        self.lower, self.upper = (limits.float().to(device) for limits in (prior.lower_limits, prior.upper_limits))
        numbers = {**mixture, "factors": np.linalg.inv(mixture["whitening"])}
        self._weights, self._means, self._factors = (
            torch.from_numpy(numbers[name]).float().to(device) for name in ("weights", "means", "factors")
        )

    def draw(self, count: int, dice: Dice) -> Poses:
        """As PartBench draws: nearer to the means, without what is beyond the joint limits or unlikely."""
        rotations: list[torch.Tensor] = []
        ups: list[torch.Tensor] = []
        while count > 0:
            tries = 2 * count + 16
            component = dice.choice(self._weights, tries)
            normal = dice.normal(tries, self._means.shape[1])
            every = torch.einsum("kij,nj->nki", self._factors, normal)
            features = self._means[component] + SPREAD * every[torch.arange(tries, device=every.device), component]
            vectors = features.new_zeros(tries, NUM_PARTS, 3)
            vectors[:, list(FREE_PARTS)] = features[:, :-3].unflatten(1, (-1, 3))
            up = torch.nn.functional.normalize(features[:, -3:], dim=1)
            good = (self._prior.joint_limits(vectors) <= OVER_LIMITS) & (self._prior(vectors, up) <= LIKELY)
            kept = good.nonzero()[:count, 0]
            rotations.append(vectors[kept])
            ups.append(up[kept])
            count -= len(kept)
        return torch.cat(rotations), torch.cat(ups)


def mirrored_half(poses: Poses, dice: Dice) -> Poses:
    """The same poses, half of them with left and right exchanged."""
    rotations, ups = poses
    order, sign = (torch.from_numpy(values).to(rotations.device) for values in mirror_features())
    free = list(FREE_PARTS)
    features = torch.cat([rotations[:, free].flatten(1), ups], dim=1)
    flip = dice.chance(0.5, len(ups), 1)
    features = torch.where(flip, features[:, order] * sign.to(features), features)
    mirrored = torch.zeros_like(rotations)
    mirrored[:, free] = features[:, :-3].unflatten(1, (-1, 3))
    return mirrored, features[:, -3:]


def clear_poses(rotations: torch.Tensor) -> torch.Tensor:
    """Whether no limb of a mean body in these poses passes through another part, shape (N,), bool.

    Args:
        rotations: Rotation vectors [rad], shape (N, 20, 3), float32.
    """
    return is_clear(mean_body(rotation_from_axis_angle(rotations)))


def mean_body(rotations: torch.Tensor, orientation: torch.Tensor | None = None) -> Posed:
    """Mean adults in poses, the pelvis at the origin.

    Args:
        rotations: Local rotations, shape (B, 20, 3, 3), float32.
        orientation: Global orientation, shape (B, 3, 3); upright in the body frame if None.
    """
    batch = len(rotations)
    if orientation is None:
        orientation = torch.eye(3, device=rotations.device).expand(batch, 3, 3)
    lengths, thicknesses = (values.expand(batch, -1) for values in _mean_shape(rotations.device))
    return pose(orientation, rotations.new_zeros(batch, 3), rotations, lengths, thicknesses, validate=False)


@lru_cache(maxsize=8)
def _mean_shape(device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    constants = template()
    lengths, thicknesses = (torch.from_numpy(v) for v in (constants.mean_lengths, constants.mean_thicknesses))
    return lengths.float().to(device), thicknesses.float().to(device)


def turn_to(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """The smallest rotation that takes one unit vector to another, (..., 3) each, shape (..., 3, 3).

    Of opposite ones, where there is no smallest, it is a half turn at most, and finite.
    """
    cross = torch.linalg.cross(source, target)
    sine = cross.norm(dim=-1, keepdim=True)
    angle = torch.atan2(sine, (source * target).sum(-1, keepdim=True))
    return rotation_from_axis_angle(cross / sine.clamp(min=1e-9) * angle)


# --- procedure -------------------------------------------------------------------------------------------------------


def _parts(*names: str) -> list[int]:
    return [PART_NAMES.index(name) for name in names]


_TRUNK = _parts("abdomen", "chest", "neck", "head")
_LEFT_ARM, _RIGHT_ARM = (
    _parts(*(f"{side}_{part}" for part in ("shoulder", "upper_arm", "forearm", "hand"))) for side in ("left", "right")
)
_LEFT_LEG, _RIGHT_LEG = (
    _parts(*(f"{side}_{part}" for part in ("upper_leg", "lower_leg", "foot"))) for side in ("left", "right")
)
_LIMBS = (_TRUNK, _LEFT_ARM, _RIGHT_ARM, [*_LEFT_LEG, *_RIGHT_LEG])

_Span = tuple[float, float]


@dataclass(frozen=True)
class _Leg:
    """Ranges [degrees]: of the thigh from hanging, forward and outward, of the knee, and of the foot, toes down."""

    forward: _Span
    outward: _Span
    knee: _Span
    foot: _Span


@dataclass(frozen=True)
class _Stance:
    """How legs stand; ``lean`` is the pelvis' [degrees] forward, ``alike`` the chance that both legs do the same."""

    weight: float
    lean: _Span
    first: _Leg
    second: _Leg
    alike: float = 0.0


_STRAIGHT = _Leg((-8, 12), (-3, 14), (0, 18), (-8, 10))
_STEPPING = _Leg((5, 60), (-5, 15), (0, 70), (-20, 20))
_BEHIND = _Leg((-32, 5), (-5, 15), (0, 80), (-15, 30))
_SEATED = _Leg((60, 105), (-5, 35), (30, 125), (-20, 25))
_DEEP = _Leg((55, 115), (0, 45), (75, 142), (-35, 0))
_KNEELING = _Leg((-15, 45), (-3, 25), (70, 140), (0, 45))
_LUNGING = _Leg((55, 105), (-3, 30), (50, 125), (-20, 10))
_RAISED = _Leg((30, 115), (-10, 45), (0, 110), (-10, 45))
_SPREAD_OUT = _Leg((-15, 35), (12, 48), (0, 60), (-20, 20))
_BENT = _Leg((-15, 20), (-3, 18), (0, 40), (-15, 10))
_LOOSE = _Leg((-15, 110), (-5, 40), (0, 135), (-20, 45))
_STANCES = (
    _Stance(0.20, (-8, 10), _STRAIGHT, _STRAIGHT),
    _Stance(0.20, (-5, 25), _STEPPING, _BEHIND),
    _Stance(0.16, (-25, 20), _SEATED, _SEATED, alike=0.5),
    _Stance(0.10, (0, 50), _DEEP, _DEEP, alike=0.6),
    _Stance(0.08, (-10, 30), _KNEELING, _LUNGING),
    _Stance(0.04, (-10, 40), _KNEELING, _KNEELING, alike=0.7),
    _Stance(0.08, (-20, 20), _RAISED, _STRAIGHT),
    _Stance(0.06, (-10, 20), _SPREAD_OUT, _SPREAD_OUT, alike=0.3),
    _Stance(0.10, (25, 95), _BENT, _BENT, alike=0.4),
)
_LYING = 0.06  # of all: any side up, any legs


def draw_procedural(count: int, dice: Dice) -> Poses:
    """Broad and plausible poses put together from ranges of joints; limits and self-penetration are not looked at."""
    rotations = torch.zeros(count, NUM_PARTS, 3, device=dice.device)
    lean, rotations[:, _LEFT_LEG], rotations[:, _RIGHT_LEG] = _legs(count, dice)
    ups = rotation_from_axis_angle(torch.stack([lean, _between(count, dice, -4, 4), 0.1 * dice.normal(count)], 1))[:, 1]
    lying, any_legs = dice.chance(_LYING, count), [_one_leg(_LOOSE, count, dice) for _ in range(2)]
    for leg, parts, flip in zip(any_legs, (_LEFT_LEG, _RIGHT_LEG), (1.0, -1.0), strict=True):
        side = leg * leg.new_tensor([1.0, flip, flip])
        rotations[:, parts] = torch.where(lying[:, None, None], side, rotations[:, parts])
    level = dice.normal(count, 3) * torch.tensor([1.0, 0.25, 1.0], device=dice.device)
    ups = torch.where(lying[:, None], torch.nn.functional.normalize(level, dim=1), ups)
    rotations[:, _TRUNK] = _trunk(count, dice)
    rotations[:, _LEFT_ARM] = _arm(count, dice)
    rotations[:, _RIGHT_ARM] = _arm(count, dice) * torch.tensor([1.0, -1.0, -1.0], device=dice.device)
    return rotations, ups


def _between(count: int, dice: Dice, low: float, high: float) -> torch.Tensor:
    """Degrees in, radians out, shape (count,)."""
    return torch.deg2rad(dice.uniform(count, low=low, high=high))


def _one_leg(leg: _Leg, count: int, dice: Dice) -> torch.Tensor:
    """Rotation vectors of a left leg, shape (count, 3, 3)."""
    forward, outward, knee, foot = (_between(count, dice, *span) for span in astuple(leg))
    turn, toes = _between(count, dice, -12, 28), _between(count, dice, -10, 20)
    zero = torch.zeros_like(turn)
    return torch.stack([-forward, turn, outward, knee, zero, zero, foot, toes, zero], dim=1).unflatten(1, (3, 3))


def _legs(count: int, dice: Dice) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The pelvis' lean forward [rad], shape (count,), and vectors of left and right leg, shape (count, 3, 3) each."""
    which = dice.choice([stance.weight for stance in _STANCES], count)
    drawn = []
    for stance in _STANCES:
        lean = _between(count, dice, *stance.lean)
        first, second = (_one_leg(leg, count, dice) for leg in (stance.first, stance.second))
        second = torch.where(dice.chance(stance.alike, count, 1, 1), first + 0.1 * dice.normal(count, 3, 3), second)
        drawn.append(torch.cat([lean[:, None], first.flatten(1), second.flatten(1)], dim=1))
    chosen = torch.stack(drawn, dim=1)[torch.arange(count, device=dice.device), which]
    lean, left, right = chosen[:, 0], chosen[:, 1:10].unflatten(1, (3, 3)), chosen[:, 10:].unflatten(1, (3, 3))
    bent = torch.zeros_like(left)
    bent[:, 0, 0] = -lean  # thighs are where they are said to be from the vertical, not from the pelvis
    return lean, left + bent, right * right.new_tensor([1.0, -1.0, -1.0]) + bent


def _trunk(count: int, dice: Dice) -> torch.Tensor:
    """Rotation vectors of abdomen, chest, neck and head, shape (count, 4, 3)."""
    forward = torch.deg2rad(-12 + 62 * dice.uniform(count).square())
    back = torch.stack([forward, _between(count, dice, -30, 30), _between(count, dice, -28, 28)], dim=1)
    skull = torch.stack([_between(count, dice, *span) for span in ((-40, 45), (-65, 65), (-25, 25))], dim=1)
    share = dice.uniform(count, 1, low=0.3, high=0.7)
    return torch.stack([share * back, (1 - share) * back, 0.5 * skull, 0.5 * skull], dim=1)


# An upper arm's direction: above the horizontal, and from sideways to forward; its turn about itself, inward; and the
# elbow's bend [degrees].
_ARMS = (
    (0.3, (-88, -55), (-60, 100), (-30, 60), (0, 60)),  # hanging
    (0.4, (-88, 75), (-30, 115), (-60, 75), (0, 125)),  # anywhere
    (0.3, (-85, -20), (10, 95), (0, 80), (50, 125)),  # hands before the trunk
)


def _arm(count: int, dice: Dice) -> torch.Tensor:
    """Rotation vectors of a left shoulder, upper arm, forearm and hand, shape (count, 4, 3)."""
    which = dice.choice([arm[0] for arm in _ARMS], count)
    drawn = torch.stack([torch.stack([_between(count, dice, *s) for s in spans]) for _, *spans in _ARMS], dim=-1)
    up, forward, inward, bend = drawn.gather(-1, which.expand(4, count)[..., None])[..., 0]
    direction = torch.stack([up.cos() * forward.cos(), up.sin(), up.cos() * forward.sin()], dim=1)
    rest = direction.new_tensor(template().rest_directions[_parts("left_upper_arm")[0]]).expand_as(direction)
    upper = rotation_to_axis_angle(turn_to(rest, direction) @ rotation_from_axis_angle(rest * inward[:, None]))
    tilt = _between(count, dice, -10, 55)
    zero = torch.zeros_like(tilt)
    forearm = torch.stack([zero, -bend * tilt.cos(), bend * tilt.sin()], dim=1)
    shoulder = torch.stack([zero, _between(count, dice, -12, 8), 0.25 * up.clamp(min=0)], dim=1)
    hand = dice.normal(count, 3) * torch.deg2rad(direction.new_tensor([30.0, 18.0, 18.0]))
    return torch.stack([shoulder, upper, forearm, hand], dim=1)
