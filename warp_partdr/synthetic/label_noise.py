"""What networks do to the truth, as PartBench's noise but batched on a device, and of all strengths.

Strength 1 is about a good network on a clear photo; each sample has one of its own, from 0 to a bit beyond PartBench's
"hard" (2). Lengths of labels' noise are shares of the crop's side, whatever its pixels. Nothing waits for the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import torch

from ..body.labels import BACKGROUND, IGNORE, LABEL_SETS, LabelSet
from ..body.landmarks import mirror_name
from ..body.skeletons import skeleton
from ..body.template import NUM_PARTS, PARENTS, PART_NAMES
from ..network.landmarks import LANDMARKS, network_keypoints
from .noise import HIDDEN_NOISE, KEYPOINT_NOISE
from .rng import TorchRng

# How often people have labels of each set.
TRAINING_LABEL_SETS: dict[str, float] = {
    "cdcl14": 0.24,
    "ellipbody20": 0.16,
    "body14": 0.1,
    "lsp6": 0.07,
    "pascal6": 0.07,
    "surreal14": 0.06,
    "densepose24": 0.06,
    "up3d31": 0.05,
    "lip20": 0.05,
    "atr18": 0.04,
    "cihp20": 0.03,
    "sapiens28": 0.04,
    "full1": 0.03,
}

MAX_STRENGTH = 2.5
CLEAN = 0.08  # share of samples without noise
NO_LABELS, NO_KEYPOINTS = 0.08, 0.06  # shares of samples that lack the one or the other altogether

# At strength 1, unless said otherwise.
_DROPOUT = 0.06  # of a keypoint; twice that for hidden ones
_SWAP = 0.05  # of a limb's sides; all sides at once in a fifth of that
_STRAY = 0.008  # of a keypoint, to be anywhere
_LOSS = 0.25  # of a part that shows less than _SMALL of the person
_SMALL = 0.015
_CONFUSED = 0.1  # of the hands' sides; the same for the feet
_MISSING = 0.1  # of a limb's labels
_GROWTH = 0.007  # most that labels grow or shrink, of the crop's side
_HOLES = 0.2  # of each of four, whose radius is, in crop coordinates:
_HOLE = (0.02, 0.09)
_OCCLUDERS = 0.12  # of each of two, whose half sides are, in crop coordinates:
_OCCLUDER = (0.06, 0.4)
_STRANGER = 0.12
_WAVES = ((0.004, 50), (0.005, 12))  # deviation of boundaries, of the crop's side, and how many waves fit into it

_SOFT = 0.6  # standard deviation of what one wave spreads over, of its width

# Which landmarks a detector gives, and how often.
_DETECTORS: dict[str, float] = {
    "coco17": 0.4,
    "every": 0.1,
    "no face": 0.1,
    "body25": 0.1,
    "blazepose33": 0.08,
    "lsp14": 0.1,
    "mpii16": 0.06,
    "h36m17": 0.06,
}
_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")

_SWAPPED_KEYPOINTS = (("elbow", "wrist"), ("knee", "ankle"), ("wrist",), ("ankle",))
_LIMBS = (
    ("upper_arm", "forearm", "hand"),
    ("forearm", "hand"),
    ("upper_leg", "lower_leg", "foot"),
    ("lower_leg", "foot"),
)
_UNKNOWN = NUM_PARTS + 1  # stands for 255 in tables of part labels


@dataclass(frozen=True)
class Fronts:
    """What stands between camera and person in a crop.

    Attributes:
        mask: Pixels whose labels it changes, shape (B, S, S), bool.
        hiding: Pixels where it hides the person, too: all but the holes, shape (B, S, S), bool.
        groups: What labels say there, 0 and 255 included, shape (B, S, S), uint8.
    """

    mask: torch.Tensor
    hiding: torch.Tensor
    groups: torch.Tensor


class Noise:
    """The noise model on a device.

    Args:
        rng: Source of chance.
    """

    def __init__(self, rng: TorchRng) -> None:
        self.rng = rng
        device = rng.device
        sets = [LABEL_SETS[name] for name in TRAINING_LABEL_SETS]
        self._set_weights = torch.tensor(list(TRAINING_LABEL_SETS.values()), device=device)
        self._groups = torch.stack([_group_table(labels) for labels in sets]).to(device)
        self._clothed = torch.tensor(["ignore" in labels.ids.values() for labels in sets], device=device)
        self._detectors = torch.stack([_seen_by(name) for name in _DETECTORS]).to(device)
        self._detector_weights = torch.tensor(list(_DETECTORS.values()), device=device)
        self._mirror = torch.tensor([LANDMARKS.index(mirror_name(name)) for name in LANDMARKS], device=device)
        self._swaps = torch.stack([_swapped_keypoints(joints) for joints in _SWAPPED_KEYPOINTS]).to(device)
        identity = torch.arange(_UNKNOWN + 1)
        self._identity = identity.to(device)
        self._heirs = torch.tensor([0, *(max(parent, 2) + 1 for parent in PARENTS), _UNKNOWN], device=device)
        self._limb_swaps = torch.stack([_table(_both(limb), _both(limb, swap=True)) for limb in _LIMBS]).to(device)
        self._limbs = torch.stack(
            [_mask([f"{side}_{part}" for part in limb]) for limb in _LIMBS for side in ("left", "right")]
        ).to(device)
        self._ends = {
            kind: torch.stack(
                [_table(_both((kind,)), names) for names in (_both((kind,), swap=True), *_one_sided(kind))]
            ).to(device)
            for kind in ("hand", "foot")
        }
        clothes = (
            ("left_hip", "right_hip", "abdomen", "chest", "left_shoulder", "right_shoulder"),
            _both(("upper_arm",)),
            _both(("forearm",)),
            _both(("upper_leg",)),
            _both(("lower_leg",)),
            _both(("foot",)),
            _both(("hand",)),
        )
        self._clothes = torch.stack([_mask(names) for names in clothes]).to(device)
        self._clothes_odds = torch.tensor([0.95, 0.7, 0.5, 0.8, 0.65, 0.1, 0.05], device=device)
        self._confidence_odds = torch.tensor([0.4, 0.15, 0.1, 0.35], device=device)

    def strengths(self, count: int) -> torch.Tensor:
        """One for each sample, shape (B,)."""
        return MAX_STRENGTH * self.rng.uniform(count) * ~self.rng.chance(CLEAN, count)

    def label_sets(self, count: int) -> torch.Tensor:
        """Index into ``TRAINING_LABEL_SETS`` for each sample, shape (B,), int64."""
        return self.rng.choice(self._set_weights, count)

    def detected(self, count: int) -> torch.Tensor:
        """Which landmarks each sample's detector knows, shape (B, 24), bool."""
        return self._detectors[self.rng.choice(self._detector_weights, count)]

    def keypoints(
        self,
        points: torch.Tensor,
        hidden: torch.Tensor,
        known: torch.Tensor,
        stature: torch.Tensor,
        strength: torch.Tensor,
    ) -> torch.Tensor:
        """Keypoints as detectors give them, shape (B, 24, 3): crop coordinates and confidence, all 0 where missing.

        Args:
            points: True places in the crop, shape (B, 24, 2).
            hidden: Which are behind something, shape (B, 24), bool.
            known: Which the detector can give at all, shape (B, 24), bool.
            stature: In crop coordinates, shape (B,).
            strength: Shape (B,).
        """
        rng, (count, landmarks) = self.rng, hidden.shape
        strength = strength[:, None]
        spread = strength * KEYPOINT_NOISE * stature[:, None] * torch.where(hidden, HIDDEN_NOISE, 1.0)
        offsets = spread[..., None] * rng.normal(count, landmarks, 2)
        stray = rng.chance(strength * _STRAY, count, landmarks)
        anywhere = rng.uniform(count, landmarks, 2, low=-1.0, high=1.0)
        seen = torch.where(stray[..., None], anywhere, points + offsets)

        order = torch.arange(landmarks, device=rng.device).expand(count, -1)
        for swap in self._swaps:
            swapped = rng.chance(strength * _SWAP / len(self._swaps), count, 1)
            order = torch.where(swapped, order[:, swap], order)
        order = torch.where(rng.chance(strength * _SWAP / 5, count, 1), order[:, self._mirror], order)
        seen, hidden = seen.gather(1, order[..., None].expand(-1, -1, 2)), hidden.gather(1, order)
        known = known & known.gather(1, order)

        known = known & ~rng.chance(strength * _DROPOUT * torch.where(hidden, 2.0, 1.0), count, landmarks)
        confidence = self._confidence(hidden, stray, offsets.norm(dim=-1) / stature[:, None])
        return torch.cat([seen, confidence[..., None]], dim=-1) * known[..., None]

    def _confidence(self, hidden: torch.Tensor, stray: torch.Tensor, error: torch.Tensor) -> torch.Tensor:
        """Of some detectors it says what is hidden or wrong, of others nothing, shape (B, 24)."""
        rng, shape = self.rng, tuple(hidden.shape)
        random = rng.uniform(*shape)
        doubt = 0.6 * hidden + 15.0 * error + 0.5 * stray
        kinds = torch.stack(
            [
                torch.where(hidden, 0.5, 1.0),
                torch.ones_like(random),
                0.15 + 0.85 * random,
                (1.0 - doubt * random.sqrt() - 0.2 * rng.uniform(*shape)).clamp(0.05, 1.0),
            ],
            dim=1,
        )
        kind = rng.choice(self._confidence_odds, shape[0])
        return kinds[torch.arange(shape[0], device=rng.device), kind]

    def groups(self, parts: torch.Tensor, label_sets: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        """Group ids as segmentation networks give them, but for what ``fronts`` adds, shape (B, S, S), uint8.

        Args:
            parts: True part labels 0 to 20, beyond the picture's border, too, shape (B, S, S), uint8.
            label_sets: Index into ``TRAINING_LABEL_SETS``, shape (B,).
            strength: Shape (B,).
        """
        table = self._labels_taken_for(parts, strength, self._clothed[label_sets])
        table = self._groups[label_sets].gather(1, table)
        wandered = self._wander(parts, strength)
        groups = _majority(_look_up(table, wandered), strength > 0)
        rough = self.rng.chance(0.25 * strength, len(strength))
        return self._grow(_majority(groups, rough, 2), strength)

    def _labels_taken_for(self, parts: torch.Tensor, strength: torch.Tensor, clothed: torch.Tensor) -> torch.Tensor:
        """What each part's label becomes: 0 to 20 or 21 for unknown, shape (B, 22), int64."""
        rng, count = self.rng, len(parts)
        scale = strength[:, None]
        areas = torch.stack([(parts == label).sum((1, 2)) for label in range(1, NUM_PARTS + 1)], dim=1)
        small = torch.nn.functional.pad(areas < _SMALL * areas.sum(1, keepdim=True), (1, 1))
        lost = small & rng.chance(scale * _LOSS, count, _UNKNOWN + 1)
        heirs = torch.where(rng.chance(0.5, count, 1), self._heirs, BACKGROUND)
        table = torch.where(lost, heirs, self._identity)
        for tables in self._ends.values():
            mistaken = tables[rng.integers(len(tables), count)].gather(1, table)
            table = torch.where(rng.chance(scale * _CONFUSED, count, 1), mistaken, table)
        swapped = self._limb_swaps[rng.integers(len(self._limb_swaps), count)].gather(1, table)
        table = torch.where(rng.chance(scale * _SWAP, count, 1), swapped, table)
        limb = self._limbs[rng.integers(len(self._limbs), count)] & rng.chance(scale * _MISSING, count, 1)
        # Where keypoints see a limb that labels miss, `ignore_missing_limbs` makes the background unknown.
        instead = torch.where(rng.chance(0.6, count, 1), _UNKNOWN, BACKGROUND)
        table = torch.where(limb.gather(1, table), instead, table)

        worn = rng.chance(self._clothes_odds, count, len(self._clothes_odds))
        worn = torch.stack(  # sleeves and trouser legs don't begin at the elbow or the knee
            [
                worn[:, 0],
                worn[:, 1],
                worn[:, 1] & worn[:, 2],
                worn[:, 3],
                worn[:, 3] & worn[:, 4],
                worn[:, 5],
                worn[:, 6],
            ],
            dim=1,
        )
        covered = (worn[:, :, None] & self._clothes).any(1) & clothed[:, None]
        return torch.where(covered.gather(1, table), _UNKNOWN, table)

    def _wander(self, parts: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        """Labels taken from a little beside, so that boundaries wander, shape (B, S, S), uint8."""
        rng, (count, size, _) = self.rng, parts.shape
        field = torch.zeros(count, 2, size, size, device=rng.device)
        for deviation, waves in _WAVES:
            spread = _spread(size, waves, rng.device)
            scale = strength * rng.uniform(count, low=0.5, high=1.5) * deviation * size
            field += spread @ (scale[:, None, None, None] * rng.normal(count, 2, waves, waves)) @ spread.T
        places = torch.arange(size, device=rng.device)
        rows = (places[:, None] + field[:, 0]).round_().clamp_(0, size - 1)
        columns = (places + field[:, 1]).round_().clamp_(0, size - 1)
        index = rows.mul_(size).add_(columns).long().flatten(1)
        return parts.flatten(1).gather(1, index).view_as(parts)

    def _grow(self, groups: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        """Persons that are a few pixels wider or narrower."""
        size = groups.shape[-1]
        reach = strength * _GROWTH * size
        pixels = (reach * self.rng.uniform(len(groups), low=-1.0, high=1.0)).round()[:, None, None]
        for step in range(max(1, round(MAX_STRENGTH * _GROWTH * size))):
            beside = torch.stack(_neighbours(groups, [(-1, 0), (1, 0), (0, -1), (0, 1)]))
            wider = torch.where(groups == BACKGROUND, torch.where(beside == IGNORE, 0, beside).amax(0), groups)
            edge = (beside == BACKGROUND).any(0) & (groups != IGNORE)
            narrower = groups.masked_fill(edge, BACKGROUND)
            groups = torch.where(pixels > step, wider, torch.where(pixels < -step, narrower, groups))
        return groups

    def fronts(
        self, parts: torch.Tensor, label_sets: torch.Tensor, places: torch.Tensor, strength: torch.Tensor
    ) -> Fronts:
        """Strangers, things before the person, and holes.

        Args:
            parts: True part labels, 255 beyond the border, shape (B, S, S), uint8; a sample's stranger is the one
                before it.
            label_sets: Index into ``TRAINING_LABEL_SETS``, shape (B,).
            places: Six points of each person in the crop, shape (B, 6, 2).
            strength: Shape (B,).
        """
        rng, (count, size, _) = self.rng, parts.shape
        there, column = self._stranger(parts)
        stranger = parts.roll(1, 0).gather(2, column[:, None].expand(-1, size, -1))
        mask = there[:, None] & (stranger > 0) & (stranger <= NUM_PARTS)
        mask &= rng.chance(strength * _STRANGER, count)[:, None, None]
        behind = rng.chance(0.3, count)[:, None, None]
        mask &= ~(behind & (parts != BACKGROUND))
        ignored = rng.chance(0.75, count)[:, None, None]
        groups = torch.where(ignored, IGNORE, _look_up(self._groups[label_sets], stranger)).to(torch.uint8)

        hiding = mask.clone()
        centres = (torch.arange(size, device=rng.device) + 0.5) * (2 / size) - 1
        for index in range(places.shape[1]):
            hole = index < 4
            place = places[:, index] + (0.0 if hole else 0.2) * rng.normal(count, 2)
            radii = rng.uniform(count, 2, low=(_HOLE if hole else _OCCLUDER)[0], high=(_HOLE if hole else _OCCLUDER)[1])
            radii = radii[:, :1].expand(-1, 2) if hole else radii
            across, down = ((centres - place[:, i, None]).div(radii[:, i, None]).square() for i in range(2))
            inside = across[:, None, :] + down[:, :, None] < 1
            if not hole:
                box = (across[:, None, :] < 1) & (down[:, :, None] < 1)
                inside = torch.where(rng.chance(0.5, count)[:, None, None], box, inside)
            inside &= rng.chance(strength * (_HOLES if hole else _OCCLUDERS), count)[:, None, None]
            shown = torch.where(rng.chance(0.3 if hole else 0.6, count), IGNORE, BACKGROUND).to(torch.uint8)
            groups = torch.where(inside, shown[:, None, None], groups)
            mask |= inside
            if not hole:
                hiding |= inside
        return Fronts(mask, hiding, groups)

    def _stranger(self, parts: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Which column of the other's crop comes to each column, and whether there is one, shape (B, S) each."""
        rng, (count, size, _) = self.rng, parts.shape
        columns = torch.arange(size, device=rng.device)
        shown = ((parts > 0) & (parts <= NUM_PARTS)).any(1)
        low = torch.where(shown, columns, size).amin(1)
        high = torch.where(shown, columns, -1).amax(1)
        overlap = rng.uniform(count, low=0.05, high=0.35) * (high - low)
        left, right = low + overlap - high.roll(1), high - overlap - low.roll(1)
        shift = torch.where(rng.chance(0.5, count), left, right).round().long()
        source = columns - shift[:, None]
        return (source >= 0) & (source < size), source.clamp(0, size - 1)

    def absent(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Which samples have no labels and which no keypoints, never both, shape (B,) each, bool."""
        draw = self.rng.uniform(count)
        return draw < NO_LABELS, draw > 1 - NO_KEYPOINTS


@lru_cache(maxsize=16)
def _spread(size: int, waves: int, device: torch.device) -> torch.Tensor:
    """What makes white noise smooth and leaves its variance, along an axis, shape (size, waves)."""
    cells = (torch.arange(size, device=device)[:, None] + 0.5) * (waves / size) - 0.5
    weights = (-0.5 * ((cells - torch.arange(waves, device=device)) / _SOFT).square()).exp()
    return torch.nn.functional.normalize(weights, dim=1)


def _majority(groups: torch.Tensor, chosen: torch.Tensor, apart: int = 1) -> torch.Tensor:
    """The commonest label of nine, ``apart`` pixels from each other, in the chosen images; a tie goes to the first."""
    steps = (0, -apart, apart)
    nine = torch.stack(_neighbours(groups, [(down, right) for down in steps for right in steps]))
    counts = torch.ones_like(nine)
    for i in range(9):
        for j in range(i):
            same = (nine[i] == nine[j]).view(torch.uint8)
            counts[i] += same
            counts[j] += same
    best, most = nine[0], counts[0]
    for label, votes in zip(nine[1:], counts[1:], strict=True):
        more = votes > most
        best, most = torch.where(more, label, best), torch.where(more, votes, most)
    return torch.where(chosen[:, None, None], best, groups)


def _neighbours(images: torch.Tensor, steps: Sequence[tuple[int, int]]) -> list[torch.Tensor]:
    """The pixels so many rows below and columns to the right of each; borders repeat themselves."""
    reach, (height, width) = max(max(map(abs, step)) for step in steps), images.shape[1:]
    for axis, size in ((1, height), (2, width)):
        images = images.index_select(axis, torch.arange(-reach, size + reach, device=images.device).clamp(0, size - 1))
    return [
        images[:, reach + down : reach + down + height, reach + right : reach + right + width] for down, right in steps
    ]


def _look_up(table: torch.Tensor, parts: torch.Tensor) -> torch.Tensor:
    """Each image through its own table (B, 22) of part labels; 255 is the last entry."""
    return table.gather(1, parts.clamp(max=_UNKNOWN).flatten(1).long()).view(parts.shape)


def _group_table(labels: LabelSet) -> torch.Tensor:
    """What a data set's labels say of each part: 255 where no source id stands for its group, shape (22,), uint8."""
    groups = torch.from_numpy(labels.part_groups).clone()
    said = {BACKGROUND, *(labels.group_names.index(name) + 1 for name in labels.ids.values() if name in labels.groups)}
    for part, group in enumerate(groups.tolist()):
        if group not in said:
            groups[part] = IGNORE
    return torch.cat([groups, groups.new_tensor([IGNORE])])


def _seen_by(detector: str) -> torch.Tensor:
    if detector in ("every", "no face"):
        names = [name for name in LANDMARKS if detector == "every" or name not in _FACE]
    else:
        names = list(skeleton(detector).landmarks)
    return network_keypoints(names, torch.zeros(len(names), 2), torch.ones(len(names)))[:, 2] > 0


def _swapped_keypoints(joints: tuple[str, ...]) -> torch.Tensor:
    names = [mirror_name(name) if name.partition("_")[2] in joints else name for name in LANDMARKS]
    return torch.tensor([LANDMARKS.index(name) for name in names])


def _both(parts: tuple[str, ...], *, swap: bool = False) -> tuple[str, ...]:
    return tuple(f"{side}_{part}" for part in parts for side in (("right", "left") if swap else ("left", "right")))


def _one_sided(kind: str) -> tuple[tuple[str, str], ...]:
    return tuple((f"{side}_{kind}",) * 2 for side in ("left", "right"))


def _mask(names: tuple[str, ...] | list[str]) -> torch.Tensor:
    """Which labels are of these parts, shape (22,), bool."""
    return torch.tensor([False, *(name in names for name in PART_NAMES), False])


def _table(names: tuple[str, ...], taken_for: tuple[str, ...]) -> torch.Tensor:
    """Labels of parts, some of which are taken for others, shape (22,), int64."""
    table = torch.arange(_UNKNOWN + 1)
    for name, other in zip(names, taken_for, strict=True):
        table[PART_NAMES.index(name) + 1] = PART_NAMES.index(other) + 1
    return table
