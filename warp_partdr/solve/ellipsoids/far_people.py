"""A longer lens where part labels show that a person is much farther away than an assumed lens puts them.

A picture that was cropped, or taken through a long lens, shows people large although they are far away. A usual lens
puts them near the camera, and perspective would then distort their bodies. The label network sees the true distance in
part labels: of the first 60 people of PartBench, it says so of 45 at the level "far" and of 3 at the level "realistic",
who in truth were made without perspective. It doesn't see the distance in keypoints alone, or in a mask.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from ...body.labels import LabelSet
from ...inputs.observations import Observations
from ...networks.regression.predicted import Predicted

MUCH_FARTHER = 2.0  # times the distance of an assumed lens; the lenses of usual photos differ by less
_FARTHEST = 10.0  # [m]; bodies look the same from all distances beyond, so what the network says there means nothing


def with_longer_lens(observations: Observations, predicted: Predicted) -> Observations | None:
    """Returns the observations with a longer lens for each person who is much farther away than assumed.

    The longer lens shows the person as large as before, at the distance that the network says.

    Args:
        observations: N people.
        predicted: What the label network says of them, N bodies.

    Returns:
        None if all lenses stay: those that are known, and of people who have no labels of parts.
    """
    if (
        observations.lens is None
        or not observations.lens_assumed
        or not shows_parts(observations.label_set)
        or predicted.uncertainty is None
    ):
        return None
    lenses = observations.lens
    # A lens shows one metre, at a distance of one metre, as long as its focal length.
    focal = predicted.log_scale.exp() / predicted.uncertainty.nearness.clamp_min(1 / _FARTHEST)
    far = focal > MUCH_FARTHER * lenses[:, 0]
    if not bool(far.any()):
        return None
    longer = torch.cat([torch.where(far, focal, lenses[:, 0])[:, None], lenses[:, 1:]], dim=1)
    return replace(observations, lens=longer)


def shows_parts(labels: LabelSet | None) -> bool:
    """Returns True if labels of a set tell parts of the body apart; a mask of the whole person does not."""
    return labels is not None and labels.num_groups > 1
