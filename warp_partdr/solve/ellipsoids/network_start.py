"""Start of a fit at the label network's bodies: longer lenses, doubted keypoints, and the order in depth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ...body.lens import turn_to_rays
from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior
from ...body.stature import bone_statures
from ...inputs.observations import Observations
from ...networks.regression.label_network import LabelNetwork
from ...networks.regression.predict import ask_network
from ...networks.regression.predicted import Predicted
from ...networks.regression.uncertainty import Uncertainty
from .depth_flips import DepthOrder, repair_depth_orders
from .far_people import shows_parts, with_longer_lens
from .options import FitOptions
from .wrong_keypoints import doubt_keypoints


@dataclass(frozen=True)
class NetworkStart:
    """N bodies from which a fit begins.

    Attributes:
        bodies: Bodies and their cameras in the crops, B = N.
        given: Observations as they were given, perhaps with longer lenses.
        observations: Observations with less confidence in doubted keypoints, and with expected sizes and depths.
        uncertainty: Uncertainty of the network about its bodies.
        depth_orders: Limbs of each person that were tried mirrored in depth; None if that was not tried.
        seconds: Wall time of each step for all people [s].
    """

    bodies: BodyParameters
    given: Observations
    observations: Observations
    uncertainty: Uncertainty
    depth_orders: Sequence[DepthOrder | None]
    seconds: dict[str, float]


def start_from_network(
    observations: Observations,
    network: LabelNetwork,
    prior: PosePrior,
    options: FitOptions,
    *,
    bodies: BodyParameters | None = None,
    longer_lenses: bool = True,
    doubting: bool = True,
    flips: bool = True,
) -> NetworkStart:
    """Predict N people by the label network, and prepare a fit that begins at these bodies.

    Args:
        observations: Observations of N people.
        network: Label network in evaluation mode, on the observations' device.
        prior: Prior of poses.
        options: Options of the fit.
        bodies: Bodies to begin from instead, B = N. Of the network's prediction, only the uncertainty is used then.
        longer_lenses: True to lengthen an assumed lens if the network predicts that a person is much farther away.
        doubting: True to give less confidence to keypoints that lie far from the network's body.
        flips: True to try limbs mirrored in depth, if labels show parts.
    """
    seconds: dict[str, float] = {}
    started = time.perf_counter()
    given, predicted = _predict(observations, network, options, longer_lenses=longer_lenses)
    uncertainty = predicted.uncertainty
    assert uncertainty is not None
    seconds["network"] = time.perf_counter() - started
    starts = turned_to_lenses(predicted.parameters(), given) if bodies is None else sized(bodies, given.statures)
    observations = doubt_keypoints(given, predicted) if doubting else given
    observations = replace(observations, lengths=starts.lengths, thicknesses=starts.thicknesses)
    orders: Sequence[DepthOrder | None] = [None] * len(observations)
    if flips and options.depth_flips and shows_parts(observations.label_set):  # in one mask, no part hides another
        started = time.perf_counter()
        # The network's uncertainty is about its own bodies.
        starts, orders = repair_depth_orders(
            starts, observations, prior, uncertainty=uncertainty if bodies is None else None
        )
        seconds["depth order"] = time.perf_counter() - started
    depths = starts.posed().centres[..., 2]
    observations = replace(observations, depths=depths, depth_uncertainties=uncertainty.centre_depths())
    return NetworkStart(starts, given, observations, uncertainty, orders, seconds)


def _predict(
    observations: Observations, network: LabelNetwork, options: FitOptions, *, longer_lenses: bool
) -> tuple[Observations, Predicted]:
    """Predict N people, and predict those again who are far away, with a longer lens."""
    predicted = ask_network(observations, network, mirror=options.mirror, half=options.half)
    longer = with_longer_lens(observations, predicted) if longer_lenses else None
    if longer is not None:
        assert observations.lens is not None  # it was lengthened
        assert longer.lens is not None
        changed = (longer.lens != observations.lens).any(1).nonzero()[:, 0]
        if observations.points.is_cuda:  # predict all again, because a captured graph exists for this number of people
            changed = torch.arange(len(observations), device=changed.device)
        again = ask_network(longer.select(changed), network, mirror=options.mirror, half=options.half)
        observations, predicted = longer, predicted.with_rows(changed, again)
    return observations, predicted if observations.statures is None else predicted.resized(
        _growth(predicted.lengths, observations.statures)
    )


def turned_to_lenses(bodies: BodyParameters, observations: Observations) -> BodyParameters:
    """Return the bodies turned to the rays of their lenses.

    The network predicts bodies as if the camera looked straight at each person. Without lenses the bodies stay.
    """
    return bodies if observations.lens is None else turn_to_rays(bodies, observations.lens)


def sized(bodies: BodyParameters, statures: torch.Tensor | None) -> BodyParameters:
    """Return the bodies resized to known statures; the cameras see the same picture of them.

    Args:
        bodies: N bodies.
        statures: Statures [m], 0 for people whose stature is not known, shape (N,); None: none is known.
    """
    return bodies if statures is None else bodies.resized(_growth(bodies.lengths, statures))


def _growth(lengths: torch.Tensor, statures: torch.Tensor) -> torch.Tensor:
    return torch.where(statures > 0, statures / bone_statures(lengths), 1.0)
