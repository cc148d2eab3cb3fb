"""Part labels of people, by a network of others or by the packaged part head, without the pixels of others beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F

from ...body.labels import BACKGROUND, IGNORE, LabelSet, label_set
from ...errors import InputError
from ...inputs.part_labels import PartLabels, parts_from_maps, without_haze
from ..detection.crops import Pyramid
from ..detection.masks import crop_window, instance_map, spread_maps
from ..detection.person import FoundPerson
from .networks import PartNetwork, cut_upright, upright_crop

# Probability of a person's mask from which on what the network takes for a part may be that person's: a mask ends
# within the outline.
_WEAK = 0.02
_MOST_VALUES = 2**27  # of all people's probabilities together, half a gigabyte; of more, labels alone are kept
_SUM_TOLERANCE = 1e-2

# Of the packaged part head. BlazePose's mask has the better outline: with the head's own background, outlines of the
# bodies of PartBench's level "photo" (24 people) had an F1 of 0.960, with the mask 0.982.
_HEAD_LABELS = "ellipbody20"
_ANOTHER_THING = 0.8  # probability of background from which on a pixel of the mask is ignored, such as one of a racket
_SAME_PERSON = 0.2  # the same below which a pixel beside the mask is ignored


@dataclass(frozen=True)
class SaidParts:
    """Answer of a network about one person's crop.

    Attributes:
        maps: Maps of the background and the groups, shape (G + 1, h, w), on CPU.
        soft: True for probabilities, False for ids.
    """

    maps: torch.Tensor
    soft: bool


class PlacedParts:
    """Part labels of people in one picture, from what a network said about each one's crop.

    Args:
        network: Network that made the labels.
        people: All people in the picture, in pixels of ``owners``.
        owners: Number of the person that each pixel shows, as in ``instance_map``, shape (H, W).
        keeps_maps: True keeps probabilities beside the labels.
    """

    def __init__(
        self, network: PartNetwork, people: Sequence[FoundPerson], owners: np.ndarray, *, keeps_maps: bool
    ) -> None:
        self._network, self._people, self._owners, self._keeps_maps = network, people, owners, keeps_maps
        size = owners.shape[0], owners.shape[1]
        self._nearest = instance_map(people, size, threshold=_WEAK)

    def of(self, index: int, said: SaidParts) -> PartLabels | None:
        """Labels of the one at a place in ``people``; None if the network sees no part.

        Pixels of others' masks are ignored, and so is a part where another's mask is stronger, however weak. Beyond
        the crop there is background.
        """
        network, size = self._network, self._owners.shape
        crop = upright_crop(self._people[index], network.size, stretch=network.stretch)
        window = crop_window(crop, size)
        drawn, within = spread_maps(said.maps, crop, window, mode="bilinear" if said.soft else "nearest")
        maps = np.zeros((len(drawn), *size), dtype=np.float32)
        maps[BACKGROUND] = 1.0
        maps[:, window[0], window[1]][:, within] = drawn[:, within]
        parts = parts_from_maps(maps, network.labels)
        mine, groups = index + 1, parts.groups
        theirs = (self._owners != BACKGROUND) & (self._owners != mine)
        theirs |= (groups != BACKGROUND) & (self._nearest != BACKGROUND) & (self._nearest != mine)
        groups[theirs] = IGNORE
        if not ((groups != BACKGROUND) & (groups != IGNORE)).any():
            return None
        maps[:, theirs] = 0.0
        return PartLabels(network.labels, groups, maps if said.soft and self._keeps_maps else None)


class PeopleParts:
    """Part labels of people in one picture.

    Args:
        network: Network that makes the labels.
        picture: Picture on the network's device.
        people: All people in the picture.
        owners: Number of the person that each pixel shows, as in ``instance_map``, shape (H, W).
        count: Number of people whose labels are wanted.
    """

    def __init__(
        self,
        network: PartNetwork,
        picture: Pyramid,
        people: Sequence[FoundPerson],
        owners: np.ndarray,
        count: int,
    ) -> None:
        self.network, self._picture, self._people = network, picture, people
        keeps_maps = count * (network.labels.num_groups + 1) * owners.size <= _MOST_VALUES
        self._placed = PlacedParts(network, people, owners, keeps_maps=keeps_maps)

    def of(self, index: int) -> PartLabels | None:
        """Labels of the person with an index in ``people``, as ``PlacedParts`` makes them.

        Raises:
            InputError: If the network gives something else than ``PartNetwork`` says.
        """
        network = self.network
        seen = cut_upright(self._picture, self._people[index], network.size, stretch=network.stretch)
        return self._placed.of(index, ask_parts(network, seen)[0])


@torch.no_grad()
def ask_parts(network: PartNetwork, pictures: torch.Tensor) -> list[SaidParts]:
    """Answers about N people, each in a picture of ``cut_upright``.

    Raises:
        InputError: If the network gives something else than ``PartNetwork`` says.
    """
    labels, wanted = network.labels, len(pictures)
    said = network.predict(pictures)
    if isinstance(said, torch.Tensor) and said.ndim == 3 and len(said) == wanted and not said.is_floating_point():
        return [SaidParts(_one_hot(ids, labels), False) for ids in said.cpu().numpy()]
    count = len(labels.channel_ids)
    if not isinstance(said, torch.Tensor) or said.ndim != 4 or said.shape[:2] != (wanted, count):
        found = tuple(said.shape) if isinstance(said, torch.Tensor) else type(said).__name__
        raise InputError(
            f"parts_from: {found}; expected probabilities (N, {count}, h, w), a map per id of {labels.name}, "
            "or ids (N, h, w)"
        )
    maps = said.float().cpu()
    low, sums = float(maps.min()), maps.sum(1)
    if not (low >= 0 and float((sums - 1).abs().max()) <= _SUM_TOLERANCE):  # not so, either, where there is a NaN
        raise InputError(
            f"parts_from: values from {low:g}, sums of {float(sums.min()):g} to {float(sums.max()):g}; expected "
            "probabilities, which add up to 1 at each pixel"
        )
    return [SaidParts(torch.from_numpy(without_haze(labels.to_group_maps(each.numpy()))), True) for each in maps]


def _one_hot(ids: np.ndarray, labels: LabelSet) -> torch.Tensor:
    """Ones and zeros (G + 1, h, w) from ids (h, w); ignored ones are in no map."""
    try:
        groups = torch.from_numpy(labels.to_groups(ids)).long()
    except ValueError as error:
        raise InputError(f"parts_from: {error}") from error
    return F.one_hot(groups, IGNORE + 1)[..., : labels.num_groups + 1].permute(2, 0, 1).float()


def seen_parts(person: FoundPerson, mask: PartLabels) -> PartLabels | None:
    """Part labels of a person from the packaged part head, within the person's mask.

    A pixel of the mask has the likeliest part, and is ignored where no part is likely. What lies beside the mask is
    background. Where mask and head contradict each other, pixels are ignored.

    Args:
        person: Person whom the larger landmark network has looked at.
        mask: Labels of the person's mask, of a set with one group.

    Returns:
        Labels; None if the head has not looked, or sees no part.
    """
    if person.parts is None:
        return None
    maps = torch.stack([person.parts.labels, person.parts.background]).float().cpu()
    window = crop_window(person.crop, mask.groups.shape)
    (labels, background), within = spread_maps(maps, person.crop, window, mode="nearest")
    groups = mask.groups.copy()
    drawn = groups[window]
    own = within & (drawn != BACKGROUND) & (drawn != IGNORE)
    beside = within & (drawn == BACKGROUND) & (background < 255 * _SAME_PERSON)
    drawn[own] = np.where(background[own] > 255 * _ANOTHER_THING, IGNORE, labels[own]).astype(np.uint8)
    drawn[beside] = IGNORE
    if not ((drawn != BACKGROUND) & (drawn != IGNORE)).any():
        return None
    return PartLabels(label_set(_HEAD_LABELS), groups)
