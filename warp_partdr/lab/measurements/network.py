"""Errors of a label network on held-out people, by kind of person.

The people are those that the training of a label network validates on. "Within" are depths and rotations whose errors
are smaller than the standard deviation that the network states: 68 % if it is right.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import torch

from ...metrics import mpjpe, pa_mpjpe
from ...networks.regression.checkpoint import load_label_network
from ...networks.regression.label_network import KNOWN_LENS, USUAL_LENS
from ..options import Mocap, NetworkFile
from ..synthetic.training_people import PeopleBatch
from ..tables import FigureTable
from ..training.config import make_config
from ..training.label_task import LSP_JOINTS, LabelTask, errors_of, spreads_of

_TILTS = (30, 60, 180)  # [degrees] of the pelvis from upright in the picture
_COLUMNS = {
    "kind": "",
    "people": "d",
    "PA-MPJPE [mm]": ".1f",
    "MPJPE [mm]": ".1f",
    "depths within [%]": ".0f",
    "rotations within [%]": ".0f",
}


@torch.no_grad()
def measure_network(mocap: Mocap, /, *, network: NetworkFile = None) -> Iterator[FigureTable]:
    """Predict the held-out people.

    Args:
        mocap: Poses of the people.
        network: Network that predicts them.
    """
    predictor = load_label_network(network)
    config = make_config({"task": "label-network", "steps": 1, "batch_size": 1, "data": {"poses": str(mocap)}})
    task = LabelTask(config, rank=0, processes=1, device=torch.device("cpu"))
    rows: list[torch.Tensor] = []
    kinds: list[dict[str, torch.Tensor]] = []
    for people in task.held_out:
        predicted = task.predict(predictor, people)
        joints = predicted.posed().joints
        points = joints[:, LSP_JOINTS], people.joints[:, LSP_JOINTS]
        within = (torch.cat(errors_of(predicted, joints, people), 1) < spreads_of(predicted)).float()
        depths = joints.shape[1] - 1
        errors = 1000 * pa_mpjpe(*points), 1000 * mpjpe(*points)
        shares = 100 * within[:, :depths].mean(1), 100 * within[:, depths:].mean(1)
        rows.append(torch.stack([*errors, *shares]))
        kinds.append(_kinds(people))
    figures = torch.cat(rows, dim=1)
    table = FigureTable("Held-out people", _COLUMNS)
    for kind in kinds[0]:
        chosen = torch.cat([found[kind] for found in kinds])
        table.add(kind, int(chosen.sum()), *figures[:, chosen].mean(1).tolist())
    yield table


def _kinds(people: PeopleBatch) -> dict[str, torch.Tensor]:
    """Masks of people (B,) by kind."""
    tilt = torch.rad2deg((-people.orientation[:, 1, 1]).clamp(-1, 1).acos())
    near = people.distances < 50
    tilted = {
        f"tilted by {low} to {high} degrees": (tilt >= low) & (tilt < high) for low, high in pairwise((0, *_TILTS))
    }
    return tilted | {
        "lens known": people.lens_certainty == KNOWN_LENS,
        "usual lens assumed": people.lens_certainty == USUAL_LENS,
        "no lens": people.lens_certainty == 0,
        "stature known": people.statures > 0,
        "far camera": ~near,
        "without labels": (people.groups == 255).flatten(1).all(1),
        "without keypoints": (people.keypoints[..., 2] == 0).all(1),
        "all": torch.ones_like(near),
    }
