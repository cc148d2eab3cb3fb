"""Bodies from observations in one pass of the label network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ...body.parameters import BodyParameters
from ...errors import check_each, check_type
from ...inputs.observation import Observation, resize_nearest
from ...inputs.observations import Observations, batch_observations
from ...interop.torch_threads import one_torch_thread
from .conventions import keypoints_at_landmarks
from .fused import ask_fused, ask_with, is_fused
from .label_network import (
    EVEN_CHANNELS,
    KNOWN_LENS,
    NUM_CHANNELS,
    USUAL_LENS,
    LabelNetwork,
    label_shares,
    label_table,
    map_shares,
    network_conditions,
)
from .landmarks import format_keypoints
from .mirror import mirror_inputs
from .predicted import Predicted
from .upright import leans, turn_inputs, turn_predicted

# Networks learn how sure they are from people who are made. Of seven real people, 60 % of depths were within the
# stated 68 %, and so many times wider intervals hold 68 % (`partdr evaluate real`, docs/measured/real_people.md).
REAL_PEOPLE = 1.2
# Joints of real people are 1 to 3 mm nearer to the truth if bodies are so many times larger, in each set of views that
# docs/measured/real_people.md names. PartBench's people, whose bodies are of the kind that networks learn from, become
# too large.
REAL_SIZE = 1.015


def network_inputs(observations: Observations, size: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Input of a label network for N people: shares (N, 22, size, size), keypoints (N, 24, 3) and conditions (N, 6)."""
    return _shares(observations, size), *_numbers(observations)


def _numbers(observations: Observations) -> tuple[torch.Tensor, torch.Tensor]:
    """Keypoints and conditions of ``network_inputs``."""
    names, visible = observations.landmarks, observations.visible
    keypoints = format_keypoints(names, visible, observations.points, observations.confidence)
    lenses = keypoints.new_ones(len(observations), 3) if observations.lens is None else observations.lens
    certainty = keypoints.new_full((len(observations),), _certainty(observations))
    return keypoints, network_conditions(lenses, certainty, observations.statures)


def _certainty(observations: Observations) -> float:
    if observations.lens is None:
        return 0.0
    return USUAL_LENS if observations.lens_assumed else KNOWN_LENS


def _shares(observations: Observations, size: int) -> torch.Tensor:
    """Shares of the parts in each pixel, shape (N, 22, size, size)."""
    if observations.label_set is None or observations.labels is None:
        unknown = torch.zeros(1, NUM_CHANNELS, 1, 1, device=observations.points.device)
        unknown[:, -1] = 1.0
        return unknown.expand(len(observations), -1, size, size)
    table = label_table(observations.label_set).to(observations.points.device)
    if observations.maps is not None and observations.known is not None:
        return map_shares(resize_nearest(observations.maps, size), resize_nearest(observations.known, size), table)
    return _shares_of_ids(resize_nearest(observations.labels, size), table)


def _shares_of_ids(labels: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
    which = torch.zeros(len(labels), dtype=torch.int64, device=labels.device)
    return label_shares(labels, table[None], which)


def upright_inputs(
    observations: Observations, size: int, *, half: bool = False
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inputs of N people, turned upright, and by how much they lean, (N,); with ``half``, shares may be bfloat16."""
    keypoints, conditions = _numbers(observations)
    angles = leans(keypoints)
    if observations.labels is None or observations.label_set is None or observations.maps is not None:
        return *turn_inputs(_shares(observations, size), keypoints, conditions, -angles), angles
    labels = resize_nearest(observations.labels, size)[:, None].float()  # to be turned: a number a pixel, not 22
    labels, keypoints, conditions = turn_inputs(labels, keypoints, conditions, -angles)
    table = label_table(observations.label_set).to(labels.device)
    if half:
        table = torch.nn.functional.pad(table, (0, EVEN_CHANNELS - table.shape[1])).bfloat16()
    return _shares_of_ids(labels[:, 0], table), keypoints, conditions, angles


@one_torch_thread()
@torch.no_grad()
def predict_bodies(observations: Sequence[Observation], network: LabelNetwork) -> BodyParameters:
    """Predict bodies from observations, without refinement.

    Args:
        observations: N people, on the network's device; ``observe`` makes them.
        network: Label network in evaluation mode.

    Returns:
        N bodies in their crops.

    Raises:
        TypeError: If these are no observations, or no network.
        ValueError: If there is no observation.

    Examples:
        >>> from warp_partdr import load_label_network, observe, predict_bodies, read_keypoints, read_parts
        >>> observation, crop = observe(read_keypoints("keypoints.json")[0], read_parts("parts.png", "cdcl14"))
        >>> bodies = predict_bodies([observation, observation], load_label_network())  # one pass for all people
        >>> bodies.posed().joints.shape
        torch.Size([2, 21, 3])
    """
    check_each("observations", observations, Observation, "of observe")
    check_type("network", network, LabelNetwork, "of load_label_network")
    if not observations:
        raise ValueError("observations: none; expected at least one")
    return ask_about_each(observations, network).parameters()


def ask_about_each(observations: Sequence[Observation], network: LabelNetwork, *, mirror: bool = True) -> Predicted:
    """Return ``ask_network`` of N people in their order, who need not be alike: it is asked about each kind at once."""
    rows: list[int] = []
    predicted: list[Predicted] = []
    for own, some in batch_observations(observations):
        rows += own
        predicted.append(ask_network(some, network, mirror=mirror))
    if len(predicted) == 1:
        return predicted[0]
    joined = Predicted.joined(predicted)
    return joined.select(torch.tensor(rows).argsort().to(joined.shift.device))


@torch.no_grad()
def ask_network(
    observations: Observations,
    network: LabelNetwork,
    *,
    mirror: bool = True,
    half: bool = False,
) -> Predicted:
    """Bodies as in ``predict_bodies``, and how sure they are: halfway between a picture's and its mirror image's.

    People whose keypoints lie elsewhere than a network knows (``CONVENTIONS``) are looked at twice. Those who lean are
    turned upright before (``leans``). Without ``mirror``, of the picture alone, in half the time.
    With ``half``, features are made in bfloat16.
    """
    predicted = _look(observations, network, mirror=mirror, half=half)
    moved = keypoints_at_landmarks(observations, predicted)
    return predicted if moved is None else _look(moved, network, mirror=mirror, half=half)


def _look(observations: Observations, network: LabelNetwork, *, mirror: bool, half: bool) -> Predicted:
    """Returns ``ask_network`` of keypoints that are taken for landmarks as they are."""
    *inputs, angles = upright_inputs(observations, network.config.size, half=half)
    shares, keypoints, conditions = inputs
    if mirror:
        both = zip(inputs, mirror_inputs(shares, keypoints, conditions), strict=True)
        shares, keypoints, conditions = map(torch.cat, both)
    shares = shares.contiguous(memory_format=torch.channels_last)
    given = shares, keypoints, conditions
    if is_fused(given, half=half):
        predicted = ask_fused(network, given, half=half, images=mirror)
    else:
        predicted = ask_with(network, network, given, half=half, images=mirror)
    predicted = turn_predicted(predicted, angles)
    said = predicted.uncertainty
    predicted = replace(predicted, uncertainty=None if said is None else said.widened(REAL_PEOPLE))
    return predicted.resized(_size_shares(observations, predicted.log_scale))


def _size_shares(observations: Observations, like: torch.Tensor) -> torch.Tensor:
    """Factors of people's sizes against what the network says, shape (N,); 1 where it was told their stature."""
    shares = torch.full_like(like, REAL_SIZE)
    return shares if observations.statures is None else torch.where(observations.statures > 0, 1.0, shares)
