"""Bodies from observations in one pass of the label network."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace

import torch

from ...body.labels import LabelSet
from ...body.parameters import BodyParameters
from ...errors import check_each, check_type
from ...inputs.observation import Observation, resize_nearest
from ...inputs.stacked import StackedObservations
from ...interop.torch_threads import one_torch_thread
from .conventions import keypoints_at_landmarks
from .fused import ask_fused, ask_with
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
from .landmarks import format_keypoints, stack_keypoints
from .mirror import mean_bodies, mirror_bodies, mirror_inputs
from .predicted import Predicted
from .upright import leans, turn_inputs, turn_predicted

# Networks learn how sure they are from people who are made. Of seven real people, 60 % of depths were within the
# stated 68 %, and so many times wider intervals hold 68 % (`partdr evaluate real`, docs/evaluation.md).
REAL_PEOPLE = 1.2
# Joints of real people are 1 to 3 mm nearer to the truth if bodies are so many times larger, in each set of views that
# docs/evaluation.md names. PartBench's people, whose bodies are of the kind that networks learn from, become too large.
REAL_SIZE = 1.015


def network_inputs(
    observations: Sequence[Observation] | StackedObservations, size: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Input of a label network for N people: shares (N, 22, size, size), keypoints (N, 24, 3) and conditions (N, 6)."""
    if isinstance(observations, StackedObservations):
        keypoints = format_keypoints(
            observations.landmarks, observations.visible, observations.points, observations.confidence
        )
        lenses = keypoints.new_ones(len(observations), 3) if observations.lens is None else observations.lens
        certainty = keypoints.new_full((len(observations),), _certainty(observations))
        return _stacked_pictures(observations, size), keypoints, network_conditions(lenses, certainty)
    keypoints = stack_keypoints(
        [each.landmarks for each in observations],
        [each.points for each in observations],
        [each.confidence for each in observations],
    )
    unknown = keypoints.new_ones(3)
    lenses = torch.stack([unknown if each.lens is None else each.lens for each in observations])
    certainty = torch.tensor([_certainty(each) for each in observations]).to(lenses.device)
    statures = torch.tensor([each.stature or 0.0 for each in observations]).to(lenses.device)
    return _network_pictures(observations, size), keypoints, network_conditions(lenses, certainty, statures)


def _certainty(observation: Observation | StackedObservations) -> float:
    if observation.lens is None:
        return 0.0
    return USUAL_LENS if observation.lens_assumed else KNOWN_LENS


def upright_inputs(
    observations: Sequence[Observation] | StackedObservations, size: int, *, half: bool = False
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inputs of N people, turned upright, and by how much they lean, (N,); with ``half``, shares may be bfloat16."""
    if (
        not isinstance(observations, StackedObservations)
        or observations.labels is None
        or observations.label_set is None
    ):
        shares, keypoints, conditions = network_inputs(observations, size)
        angles = leans(keypoints)
        return *turn_inputs(shares, keypoints, conditions, -angles), angles
    _, keypoints, conditions = network_inputs(replace(observations, labels=None, label_set=None), size)
    angles = leans(keypoints)
    labels = resize_nearest(observations.labels, size)[:, None].float()  # to be turned: a number a pixel, not 22
    labels, keypoints, conditions = turn_inputs(labels, keypoints, conditions, -angles)
    table = label_table(observations.label_set).to(labels.device)
    if half:
        table = torch.nn.functional.pad(table, (0, EVEN_CHANNELS - table.shape[1])).bfloat16()
    return _shares_of_ids(labels[:, 0], table), keypoints, conditions, angles


def _shares_of_ids(labels: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
    which = torch.zeros(len(labels), dtype=torch.int64, device=labels.device)
    return label_shares(labels, table[None], which)


def _stacked_pictures(observations: StackedObservations, size: int) -> torch.Tensor:
    """Shares of people with labels of one set, or of all without."""
    if observations.labels is None or observations.label_set is None:
        return _no_labels(observations.points.device).expand(len(observations), -1, size, size)
    return _label_shares(observations.labels, observations.label_set, size)


def _no_labels(device: torch.device) -> torch.Tensor:
    """Shares of a person without labels, shape (1, 22, 1, 1)."""
    shares = torch.zeros(1, NUM_CHANNELS, 1, 1, device=device)
    shares[:, -1] = 1.0
    return shares


def _label_shares(labels: torch.Tensor, label_set: LabelSet, size: int) -> torch.Tensor:
    return _shares_of_ids(resize_nearest(labels, size), label_table(label_set).to(labels.device))


def _network_pictures(observations: Sequence[Observation], size: int) -> torch.Tensor:
    """Shares of all, those with labels of one set and size at a time: one by one, launches would take long."""
    shares: torch.Tensor | None = None
    groups: dict[Hashable, list[int]] = {}
    for row, each in enumerate(observations):
        labels = None if each.label_set is None else each.labels
        soft = each.maps is not None and each.known is not None
        groups.setdefault(None if labels is None else (id(each.label_set), labels.shape, soft), []).append(row)
    for key, rows in groups.items():
        some = [observations[row] for row in rows]
        if key is None:
            found = _no_labels(observations[0].points.device)
        else:
            found = _shares_of(some, size)
        if len(rows) == len(observations):
            return found.expand(len(observations), -1, size, size)
        if shares is None:
            shares = found.new_empty(len(observations), size, size, NUM_CHANNELS).permute(0, 3, 1, 2)
        shares[torch.tensor(rows).to(shares.device)] = found
    assert shares is not None
    return shares


def _shares_of(observations: Sequence[Observation], size: int) -> torch.Tensor:
    """Shares of people with labels of one set and size, all with probabilities or none."""
    first = observations[0]
    assert first.label_set is not None

    def together(pictures: Iterable[torch.Tensor | None]) -> torch.Tensor:
        return torch.stack([resize_nearest(each, size) for each in pictures if each is not None])

    if first.maps is not None and first.known is not None:
        table = label_table(first.label_set).to(first.points.device)
        return map_shares(
            together(each.maps for each in observations), together(each.known for each in observations), table
        )
    labels = torch.stack([each.labels for each in observations if each.labels is not None])
    return _label_shares(labels, first.label_set, size)


@one_torch_thread()
@torch.no_grad()
def predict_bodies(observations: Sequence[Observation], network: LabelNetwork) -> BodyParameters:
    """Predict bodies from observations, without refinement.

    Args:
        observations: Observations of N people, on the network's device. ``observe`` makes them.
        network: Network in evaluation mode.

    Returns:
        N bodies in their crops.

    Raises:
        TypeError: If these are no observations, or no network.
        ValueError: If there is no observation.
    """
    check_each("observations", observations, Observation, "of observe")
    check_type("network", network, LabelNetwork, "of load_label_network")
    if not observations:
        raise ValueError("observations: none; expected at least one")
    return ask_network(observations, network).parameters()


@torch.no_grad()
def ask_network(
    observations: Sequence[Observation] | StackedObservations,
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


def _look(
    observations: Sequence[Observation] | StackedObservations, network: LabelNetwork, *, mirror: bool, half: bool
) -> Predicted:
    """Returns ``ask_network`` of keypoints that are taken for landmarks as they are."""
    *inputs, angles = upright_inputs(observations, network.config.size, half=half)
    shares, keypoints, conditions = inputs
    if mirror:
        both = zip(inputs, mirror_inputs(shares, keypoints, conditions), strict=True)
        shares, keypoints, conditions = map(torch.cat, both)
    shares = shares.contiguous(memory_format=torch.channels_last)
    if half and shares.is_cuda:
        predicted = ask_fused(network, shares, keypoints, conditions)
    else:
        predicted = ask_with(network, network, (shares, keypoints, conditions), half=half)
    if mirror:
        own, images = slice(len(observations)), slice(len(observations), None)
        predicted = mean_bodies(predicted.select(own), mirror_bodies(predicted.select(images)))
    predicted = turn_predicted(predicted, angles)
    said = predicted.uncertainty
    predicted = replace(predicted, uncertainty=None if said is None else said.widened(REAL_PEOPLE))
    return predicted.resized(_size_shares(observations, predicted.log_scale))


def _size_shares(observations: Sequence[Observation] | StackedObservations, like: torch.Tensor) -> torch.Tensor:
    """Factors of people's sizes against what the network says, shape (N,); 1 where it was told their stature."""
    shares = torch.full_like(like, REAL_SIZE)
    if not isinstance(observations, StackedObservations) and any(each.stature is not None for each in observations):
        shares = like.new_tensor([REAL_SIZE if each.stature is None else 1.0 for each in observations])
    return shares
