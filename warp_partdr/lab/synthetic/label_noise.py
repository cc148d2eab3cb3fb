"""Part labels as segmentation networks give them, in batches on a device, and the strength of all noise.

Strength 1 is about a good network on a clear photo; each sample has one of its own, from 0 to a bit beyond PartBench's
"hard" (2). Lengths of labels' noise are shares of the crop's side, whatever its pixels. Nothing waits for the device.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import torch

from ...body.labels import BACKGROUND, IGNORE, LABEL_SETS, LabelSet
from ...body.landmarks import mirror_name
from ...body.template import NUM_PARTS, PARENTS, PART_NAMES
from ...interop.arrays import warp_array
from ...interop.device_cache import device_cache
from ...interop.streams import launch_bodies_on
from ...kernels import label_noise
from .noise import LIMBS
from .rng import TorchRng

# Shares of people with labels of each set.
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
NO_LABELS, NO_KEYPOINTS = 0.2, 0.05  # shares of samples that lack the one or the other altogether

# At strength 1, unless said otherwise.
_SWAP = 0.05  # of a limb's sides
_LOSS = 0.25  # of a part that shows less than _SMALL of the person
_SMALL = 0.015
_CONFUSED = 0.1  # of the hands' sides; the same for the feet
_MISSING = 0.1  # of a limb's labels
_GROWTH = 0.007  # most that labels grow or shrink, of the crop's side
_WAVES = ((0.004, 50), (0.005, 12))  # deviation of boundaries, of the crop's side, and how many waves fit into it

_CLOTHES = {  # ends of the names of parts: chance that these are under clothes
    ("hip", "abdomen", "chest", "shoulder"): 0.95,
    ("upper_arm",): 0.7,
    ("forearm",): 0.5,
    ("upper_leg",): 0.8,
    ("lower_leg",): 0.65,
    ("foot",): 0.1,
    ("hand",): 0.05,
}

_SOFT = 0.6  # standard deviation of what one wave spreads over, of its width

_UNKNOWN = NUM_PARTS + 1  # stands for 255 in tables of part labels


def draw_strengths(count: int, rng: TorchRng) -> torch.Tensor:
    """Strength of the noise of each sample, shape (B,)."""
    return MAX_STRENGTH * rng.uniform(count) * ~rng.chance(CLEAN, count)


def draw_absent(count: int, rng: TorchRng) -> tuple[torch.Tensor, torch.Tensor]:
    """Samples that have no labels, and those that have no keypoints, never both, shape (B,) each, bool."""
    draw = rng.uniform(count)
    return draw < NO_LABELS, draw > 1 - NO_KEYPOINTS


class LabelNoise:
    """The noise model of labels, of one source of chance."""

    def __init__(self, rng: TorchRng) -> None:
        self.rng = rng
        device = rng.device
        sets = [LABEL_SETS[name] for name in TRAINING_LABEL_SETS]
        self._set_weights = torch.tensor(list(TRAINING_LABEL_SETS.values()), device=device)
        self._groups = torch.stack([_group_table(labels) for labels in sets]).to(device)
        self._clothed = torch.tensor(["ignore" in labels.ids.values() for labels in sets], device=device)
        self._identity = torch.arange(_UNKNOWN + 1, device=device)
        self._heirs = torch.tensor([0, *(max(parent, 2) + 1 for parent in PARENTS), _UNKNOWN], device=device)
        limbs = [[[f"{side}_{part}" for part in limb] for side in ("left", "right")] for limb in LIMBS]
        swaps = [_table({name: mirror_name(name) for side in sides for name in side}) for sides in limbs]
        self._limb_swaps = torch.stack(swaps).to(device)
        self._limbs = torch.stack([_mask(side) for sides in limbs for side in sides]).to(device)
        self._ends = []  # exchanged, both taken for the left one, or both for the right one
        for left, right in (("left_hand", "right_hand"), ("left_foot", "right_foot")):
            confused = ({left: right, right: left}, {right: left}, {left: right})
            self._ends.append(torch.stack([_table(taken_for) for taken_for in confused]).to(device))
        worn = [[name for name in PART_NAMES if name.endswith(ends)] for ends in _CLOTHES]
        self._clothes = torch.stack([_mask(names) for names in worn]).to(device)
        self._clothes_odds = torch.tensor(list(_CLOTHES.values()), device=device)

    def label_sets(self, count: int) -> torch.Tensor:
        """Index into ``TRAINING_LABEL_SETS`` for each sample, shape (B,), int64."""
        return self.rng.choice(self._set_weights, count)

    def tables(self, label_sets: torch.Tensor) -> torch.Tensor:
        """Group ids of labels 0 to 20, and of 21 for unknown, in label sets by index (B,), shape (B, 22), uint8."""
        return self._groups[label_sets]

    def groups(self, parts: torch.Tensor, label_sets: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        """Group ids as segmentation networks give them, but for what ``draw_occluders`` adds, shape (B, S, S), uint8.

        Of true part labels 0 to 20, beyond the picture's border, too, and of each sample's label set (its index) and
        strength.
        """
        table = self._labels_taken_for(parts, strength, self._clothed[label_sets])
        table = self.tables(label_sets).gather(1, table)
        groups = _majority(self._wander(parts, table, strength), strength > 0)
        rough = self.rng.chance(0.25 * strength, len(strength))
        return self._grow(_majority(groups, rough, 2), strength)

    def _labels_taken_for(self, parts: torch.Tensor, strength: torch.Tensor, clothed: torch.Tensor) -> torch.Tensor:
        """Labels by what they are mistaken for: 0 to 20, or 21 for unknown, shape (B, 22), int64."""
        rng, count = self.rng, len(parts)
        scale = strength[:, None]
        areas = _areas(parts)
        small = torch.nn.functional.pad(areas < _SMALL * areas.sum(1, keepdim=True), (1, 1))
        lost = small & rng.chance(scale * _LOSS, count, _UNKNOWN + 1)
        heirs = torch.where(rng.chance(0.5, count, 1), self._heirs, BACKGROUND)
        table = torch.where(lost, heirs, self._identity)
        for tables in self._ends:
            mistaken = tables[rng.integers(len(tables), count)].gather(1, table)
            table = torch.where(rng.chance(scale * _CONFUSED, count, 1), mistaken, table)
        swapped = self._limb_swaps[rng.integers(len(self._limb_swaps), count)].gather(1, table)
        table = torch.where(rng.chance(scale * _SWAP, count, 1), swapped, table)
        limb = self._limbs[rng.integers(len(self._limbs), count)] & rng.chance(scale * _MISSING, count, 1)
        # Where keypoints see a limb that labels miss, `ignore_missing_limbs` makes the background unknown.
        instead = torch.where(rng.chance(0.6, count, 1), _UNKNOWN, BACKGROUND)
        table = torch.where(limb.gather(1, table), instead, table)

        worn = rng.chance(self._clothes_odds, count, len(self._clothes_odds))
        worn[:, 2:5:2] &= worn[:, 1:4:2]  # sleeves and trouser legs don't begin at the elbow or the knee
        covered = (worn[:, :, None] & self._clothes).any(1) & clothed[:, None]
        return torch.where(covered.gather(1, table), _UNKNOWN, table)

    def _wander(self, parts: torch.Tensor, table: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        """Labels taken from a little beside, so that boundaries wander, through tables (B, 22), shape (B, S, S)."""
        rng, (count, size, _) = self.rng, parts.shape
        fields = []
        for deviation, waves in _WAVES:
            spread = _spread(size, waves, rng.device)
            scale = strength * rng.uniform(count, low=0.5, high=1.5) * deviation * size
            fields.append(spread @ (scale[:, None, None, None] * rng.normal(count, 2, waves, waves)) @ spread.T)
        found = torch.empty_like(parts)

        def launch(part: slice) -> None:
            labels, coarse, fine, names, taken = (warp_array(each[part]) for each in (parts, *fields, table, found))
            label_noise.launch_from_beside(labels, (coarse, fine), names, taken)

        launch_bodies_on(parts.device, launch, count, [label_noise])
        return found

    def _grow(self, groups: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        """Persons that are a few pixels wider or narrower."""
        size = groups.shape[-1]
        reach = strength * _GROWTH * size
        pixels = (reach * self.rng.uniform(len(groups), low=-1.0, high=1.0)).round()
        for step in range(max(1, round(MAX_STRENGTH * _GROWTH * size))):
            groups = _grown(groups, pixels, step)
        return groups


@device_cache(16)
def _spread(size: int, waves: int, device: torch.device) -> torch.Tensor:
    """Weights that make white noise smooth along an axis and leave its variance, shape (size, waves)."""
    cells = (torch.arange(size, device=device)[:, None] + 0.5) * (waves / size) - 0.5
    weights = (-0.5 * ((cells - torch.arange(waves, device=device)) / _SOFT).square()).exp()
    return torch.nn.functional.normalize(weights, dim=1)


def _areas(parts: torch.Tensor) -> torch.Tensor:
    """Number of pixels of each part in images (B, S, S), shape (B, 20), int32."""
    counts = torch.zeros(len(parts), NUM_PARTS, dtype=torch.int32, device=parts.device)

    def launch(part: slice) -> None:
        label_noise.launch_areas(warp_array(parts[part]), warp_array(counts[part]))

    launch_bodies_on(parts.device, launch, len(parts), [label_noise])
    return counts


def _majority(groups: torch.Tensor, chosen: torch.Tensor, apart: int = 1) -> torch.Tensor:
    """The commonest label of nine, ``apart`` pixels from each other, in the chosen images; a tie goes to the first."""
    return _passed(label_noise.launch_commonest, groups, chosen, apart)


def _grown(groups: torch.Tensor, pixels: torch.Tensor, step: int) -> torch.Tensor:
    """Persons that are to grow by ``pixels`` (B,), or to shrink if negative, after ``step`` of these another one."""
    return _passed(label_noise.launch_growth, groups, pixels, step)


def _passed(launch: Callable[..., None], groups: torch.Tensor, of_each: torch.Tensor, number: int) -> torch.Tensor:
    """New labels by a launch for labels (B, S, S), a number of each image (B,), and one of all."""
    found = torch.empty_like(groups)

    def work(part: slice) -> None:
        labels, own, taken = (warp_array(each[part]) for each in (groups, of_each, found))
        launch(labels, own, number, taken)

    launch_bodies_on(groups.device, work, len(groups), [label_noise])
    return found


def _group_table(labels: LabelSet) -> torch.Tensor:
    """Group ids that a data set gives each part, 255 where no id stands for its group, shape (22,), uint8."""
    said = {BACKGROUND, *(labels.group_names.index(name) + 1 for name in labels.ids.values() if name in labels.groups)}
    groups = [group if group in said else IGNORE for group in labels.part_groups.tolist()]
    return torch.tensor([*groups, IGNORE], dtype=torch.uint8)


def _mask(names: Collection[str]) -> torch.Tensor:
    """True for the labels of these parts, shape (22,), bool."""
    return torch.tensor([False, *(name in names for name in PART_NAMES), False])


def _table(taken_for: Mapping[str, str]) -> torch.Tensor:
    """Labels of parts, some of which are taken for others, shape (22,), int64."""
    parts = [PART_NAMES.index(taken_for.get(name, name)) + 1 for name in PART_NAMES]
    return torch.tensor([BACKGROUND, *parts, _UNKNOWN])
