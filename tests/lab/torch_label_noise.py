"""Pixels of training people as torch counts them, operation by operation: what the kernels are to say, to the bit."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from warp_partdr.body.labels import BACKGROUND, IGNORE
from warp_partdr.body.template import BONE_STARTS, MEAN_STATURE, NUM_PARTS
from warp_partdr.lab.synthetic import cut_masks, label_noise, occluders
from warp_partdr.lab.synthetic.label_noise import MAX_STRENGTH, LabelNoise
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.networks.regression.heads import cell_centres

UNKNOWN = NUM_PARTS + 1  # stands for 255 in tables of part labels


class TorchLabelNoise(LabelNoise):
    """Noise of the same draws."""

    def groups(self, parts: torch.Tensor, label_sets: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        table = self._labels_taken_for(parts, strength, self._clothed[label_sets])
        table = self.tables(label_sets).gather(1, table)
        groups = majority(self._wander(parts, table, strength), strength > 0)
        rough = self.rng.chance(0.25 * strength, len(strength))
        return self._grow(majority(groups, rough, 2), strength)

    def _wander(self, parts: torch.Tensor, table: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        rng, (count, size, _) = self.rng, parts.shape
        field = torch.zeros(count, 2, size, size, device=rng.device)
        for deviation, waves in label_noise._WAVES:
            spread = label_noise._spread(size, waves, rng.device)
            scale = strength * rng.uniform(count, low=0.5, high=1.5) * deviation * size
            field += spread @ (scale[:, None, None, None] * rng.normal(count, 2, waves, waves)) @ spread.T
        places = torch.arange(size, device=rng.device)
        rows = (places[:, None] + field[:, 0]).round_().clamp_(0, size - 1)
        columns = (places + field[:, 1]).round_().clamp_(0, size - 1)
        index = rows.mul_(size).add_(columns).long().flatten(1)
        return look_up(table, parts.flatten(1).gather(1, index).view_as(parts))

    def _grow(self, groups: torch.Tensor, strength: torch.Tensor) -> torch.Tensor:
        size = groups.shape[-1]
        reach = strength * label_noise._GROWTH * size
        pixels = (reach * self.rng.uniform(len(groups), low=-1.0, high=1.0)).round()[:, None, None]
        for step in range(max(1, round(MAX_STRENGTH * label_noise._GROWTH * size))):
            beside = torch.stack(_neighbours(groups, [(-1, 0), (1, 0), (0, -1), (0, 1)]))
            wider = torch.where(groups == BACKGROUND, torch.where(beside == IGNORE, 0, beside).amax(0), groups)
            edge = (beside == BACKGROUND).any(0) & (groups != IGNORE)
            narrower = groups.masked_fill(edge, BACKGROUND)
            groups = torch.where(pixels > step, wider, torch.where(pixels < -step, narrower, groups))
        return groups


def look_up(table: torch.Tensor, parts: torch.Tensor) -> torch.Tensor:
    """Each image through its own table (B, 22) of part labels; 255 is the last entry."""
    return table.gather(1, parts.clamp(max=UNKNOWN).flatten(1).long()).view(parts.shape)


def areas(parts: torch.Tensor) -> torch.Tensor:
    """Pixels of each part, shape (B, 20)."""
    return torch.stack([(parts == label).sum((1, 2)) for label in range(1, NUM_PARTS + 1)], dim=1)


def majority(groups: torch.Tensor, chosen: torch.Tensor, apart: int = 1) -> torch.Tensor:
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


def draw_occluders(
    rng: TorchRng, parts: torch.Tensor, tables: torch.Tensor, places: torch.Tensor, strength: torch.Tensor
) -> occluders.Occluders:
    """Occluders of the same draws."""
    count, size, _ = parts.shape
    there, column = _stranger(rng, parts)
    stranger = parts.roll(1, 0).gather(2, column[:, None].expand(-1, size, -1))
    mask = there[:, None] & (stranger > 0) & (stranger <= NUM_PARTS)
    mask &= rng.chance(strength * occluders._STRANGER, count)[:, None, None]
    behind = rng.chance(0.3, count)[:, None, None]
    mask &= ~(behind & (parts != BACKGROUND))
    ignored = rng.chance(0.75, count)[:, None, None]
    groups = torch.where(ignored, IGNORE, look_up(tables, stranger)).to(torch.uint8)

    hiding = mask.clone()
    centres = cell_centres(size, rng.device)
    for place, thing in zip(places.unbind(1), occluders._THINGS, strict=True):
        place = place + thing.aside * rng.normal(count, 2)
        radii = rng.uniform(count, 2, low=thing.radii[0], high=thing.radii[1])
        radii = radii if thing.hides else radii[:, :1].expand(-1, 2)
        across, down = ((centres - place[:, i, None]).div(radii[:, i, None]).square() for i in range(2))
        inside = across[:, None, :] + down[:, :, None] < 1
        if thing.hides:
            box = (across[:, None, :] < 1) & (down[:, :, None] < 1)
            inside = torch.where(rng.chance(0.5, count)[:, None, None], box, inside)
        inside &= rng.chance(strength * thing.chance, count)[:, None, None]
        shown = torch.where(rng.chance(thing.unknown, count), IGNORE, BACKGROUND).to(torch.uint8)
        groups = torch.where(inside, shown[:, None, None], groups)
        mask |= inside
        if thing.hides:
            hiding |= inside
    return occluders.Occluders(mask, hiding, groups)


def _stranger(rng: TorchRng, parts: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Column of the other's crop that comes to each column, and True where there is one, shape (B, S) each."""
    count, size, _ = parts.shape
    columns = torch.arange(size, device=rng.device)
    shown = ((parts > 0) & (parts <= NUM_PARTS)).any(1)
    low = torch.where(shown, columns, size).amin(1)
    high = torch.where(shown, columns, -1).amax(1)
    overlap = rng.uniform(count, low=0.05, high=0.35) * (high - low)
    left, right = low + overlap - high.roll(1), high - overlap - low.roll(1)
    shift = torch.where(rng.chance(0.5, count), left, right).round().long()
    source = columns - shift[:, None]
    return (source >= 0) & (source < size), source.clamp(0, size - 1)


def cut_mask(mask: torch.Tensor, joints: torch.Tensor, statures: torch.Tensor, unsure: torch.Tensor) -> torch.Tensor:
    """Parts by the nearest bone."""
    radii = cut_masks._radii(joints.device) * (statures / MEAN_STATURE)[:, None]
    centres = cell_centres(mask.shape[-1], joints.device)
    best = torch.full(mask.shape, torch.inf, device=joints.device)
    labels = torch.zeros(mask.shape, dtype=torch.uint8, device=joints.device)
    inside = torch.zeros(mask.shape, dtype=torch.int32, device=joints.device)  # a bit for each part
    for part, start in enumerate(BONE_STARTS):
        bone = joints[:, part + 1] - joints[:, start]
        right, down = (centres - joints[:, start, axis, None] for axis in range(2))  # (B, S) each, from where it starts
        right, down, along, across = right[:, None, :], down[:, :, None], *bone[:, :, None, None].unbind(1)
        share = (right * along + down * across) / bone.square().sum(1).clamp_min(cut_masks._SHORT**2)[:, None, None]
        share = share.clamp(0.0, 1.0)
        distance = torch.hypot(right - share * along, down - share * across) - radii[:, part, None, None]
        labels = torch.where(distance < best, part + 1, labels)
        best = torch.minimum(best, distance)
        inside |= (distance < 0).int() << part
    overlap = (inside & ~cut_masks._close(joints.device)[labels.long()]) != 0
    labels = torch.where(overlap & unsure[:, None, None], IGNORE, labels)
    return torch.where(mask, labels, BACKGROUND).to(torch.uint8)
