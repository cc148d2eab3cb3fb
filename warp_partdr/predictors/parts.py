"""Part labels of people by a network of others, without the pixels of the people beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F

from ..body.labels import BACKGROUND, IGNORE, LabelSet
from ..detection.crops import Pyramid, cut_crops
from ..detection.masks import crop_window, instance_map, spread_maps
from ..detection.person import FoundPerson
from ..errors import InputError
from ..inputs.part_labels import PartLabels, parts_from_maps, without_haze
from .networks import PartNetwork, upright_crop

# Probability of a person's mask from which on what the network takes for a part may be that person's: a mask ends
# within the outline.
_WEAK = 0.02
_MOST_VALUES = 2**27  # of all people's probabilities together, half a gigabyte; of more, labels alone are kept
_SUM_TOLERANCE = 1e-2


class PeopleParts:
    """Part labels of people in one picture.

    Args:
        network: Says them.
        picture: On the network's device.
        people: Everyone there.
        owners: Whom each pixel shows, of ``instance_map``, shape (H, W).
        count: People whose labels are wanted.
    """

    def __init__(
        self,
        network: PartNetwork,
        picture: Pyramid,
        people: Sequence[FoundPerson],
        owners: np.ndarray,
        count: int,
    ) -> None:
        self.network, self._picture, self._people, self._owners = network, picture, people, owners
        self._nearest = instance_map(people, picture.size, threshold=_WEAK)
        self._keeps_maps = count * (network.labels.num_groups + 1) * owners.size <= _MOST_VALUES

    def of(self, place: int) -> PartLabels | None:
        """Labels of the one at a place in ``people``; None if the network sees no part.

        Pixels of others' masks are ignored, and so is a part where another's mask is stronger, however weak. Beyond
        the crop there is background.

        Raises:
            InputError: If the network gives something else than ``PartNetwork`` says.
        """
        network, size = self.network, self._owners.shape
        crop = upright_crop(self._people[place], network.size, stretch=network.stretch)
        said, soft = _predicted(network, cut_crops([self._picture], crop, network.size))
        window = crop_window(crop, size)
        drawn, within = spread_maps(said, crop, window, mode="bilinear" if soft else "nearest")
        maps = np.zeros((len(drawn), *size), dtype=np.float32)
        maps[BACKGROUND] = 1.0
        maps[:, window[0], window[1]][:, within] = drawn[:, within]
        parts = parts_from_maps(maps, network.labels)
        mine, groups = place + 1, parts.groups
        theirs = (self._owners != BACKGROUND) & (self._owners != mine)
        theirs |= (groups != BACKGROUND) & (self._nearest != BACKGROUND) & (self._nearest != mine)
        groups[theirs] = IGNORE
        if not ((groups != BACKGROUND) & (groups != IGNORE)).any():
            return None
        maps[:, theirs] = 0.0
        return PartLabels(network.labels, groups, maps if soft and self._keeps_maps else None)


@torch.no_grad()
def _predicted(network: PartNetwork, pictures: torch.Tensor) -> tuple[torch.Tensor, bool]:
    """Maps of background and groups in one person's crop, (G + 1, h, w), on CPU; False if of ids, not probabilities."""
    labels = network.labels
    said = network.predict(pictures)
    if isinstance(said, torch.Tensor) and said.ndim == 3 and len(said) == 1 and not said.is_floating_point():
        return _one_hot(said[0].cpu().numpy(), labels), False
    count = len(labels.channel_ids)
    if not isinstance(said, torch.Tensor) or said.ndim != 4 or said.shape[:2] != (1, count):
        found = tuple(said.shape) if isinstance(said, torch.Tensor) else type(said).__name__
        raise InputError(
            f"parts_from: {found}; expected probabilities (N, {count}, h, w), a map per id of {labels.name}, "
            "or ids (N, h, w)"
        )
    maps = said[0].float().cpu()
    low, sums = float(maps.min()), maps.sum(0)
    if not (low >= 0 and float((sums - 1).abs().max()) <= _SUM_TOLERANCE):  # not so, either, where there is a NaN
        raise InputError(
            f"parts_from: values from {low:g}, sums of {float(sums.min()):g} to {float(sums.max()):g}; expected "
            "probabilities, which add up to 1 at each pixel"
        )
    return torch.from_numpy(without_haze(labels.to_group_maps(maps.numpy()))), True


def _one_hot(ids: np.ndarray, labels: LabelSet) -> torch.Tensor:
    """Ones and zeros (G + 1, h, w) from ids (h, w); ignored ones are in no map."""
    try:
        groups = torch.from_numpy(labels.to_groups(ids)).long()
    except ValueError as error:
        raise InputError(f"parts_from: {error}") from error
    return F.one_hot(groups, IGNORE + 1)[..., : labels.num_groups + 1].permute(2, 0, 1).float()
