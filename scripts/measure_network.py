"""Measure and print errors of a label network on held-out people, by kind of person.

    python scripts/measure_network.py MOCAP [NETWORK]

MOCAP is a folder of motion capture or a pose bank made of one, as `partdr train label-network` takes it; NETWORK a file
of it, by default the packaged one. The people are those that training validates on.
"""

from __future__ import annotations

import sys
from itertools import pairwise

import torch
import warp as wp

from warp_partdr.lab.training.config import make_config
from warp_partdr.lab.training.label_task import LSP_JOINTS, LabelTask, errors_of, spreads_of
from warp_partdr.metrics import mpjpe, pa_mpjpe
from warp_partdr.networks.regression.checkpoint import load_label_network
from warp_partdr.networks.regression.label_network import KNOWN_LENS, USUAL_LENS

_TILTS = (30, 60, 180)  # [degrees] of the pelvis from upright in the picture


@torch.no_grad()
def main(poses: str, file: str | None = None) -> None:
    wp.config.log_level = wp.LOG_WARNING
    network = load_label_network(file)
    config = make_config({"task": "label-network", "steps": 1, "batch_size": 1, "data": {"poses": poses}})
    task = LabelTask(config, rank=0, processes=1, device=torch.device("cpu"))
    rows: list[torch.Tensor] = []
    kinds: list[dict[str, torch.Tensor]] = []
    for people in task.held_out:
        predicted = task.predict(network, people)
        joints = predicted.posed().joints
        points = joints[:, LSP_JOINTS], people.joints[:, LSP_JOINTS]
        within = (torch.cat(errors_of(predicted, joints, people), 1) < spreads_of(predicted)).float()
        depths = joints.shape[1] - 1
        rows.append(
            torch.stack(
                [
                    1000 * pa_mpjpe(*points),
                    1000 * mpjpe(*points),
                    within[:, :depths].mean(1),
                    within[:, depths:].mean(1),
                ]
            )
        )
        tilt = torch.rad2deg((-people.orientation[:, 1, 1]).clamp(-1, 1).acos())
        near = people.distances < 50
        found = {
            f"tilted by {low} to {high} degrees": (tilt >= low) & (tilt < high) for low, high in pairwise((0, *_TILTS))
        }
        found |= {
            "lens known": people.lens_certainty == KNOWN_LENS,
            "usual lens assumed": people.lens_certainty == USUAL_LENS,
            "no lens": people.lens_certainty == 0,
            "stature known": people.statures > 0,
            "far camera": ~near,
            "without labels": (people.groups == 255).flatten(1).all(1),
            "without keypoints": (people.keypoints[..., 2] == 0).all(1),
            "all": torch.ones_like(near),
        }
        kinds.append(found)
    table = torch.cat(rows, dim=1)
    print("kind: people, PA-MPJPE [mm], MPJPE [mm], depths and rotations within their 68 %")
    for kind in kinds[0]:
        chosen = torch.cat([found[kind] for found in kinds])
        pa, plain, depth, turn = table[:, chosen].mean(1).tolist()
        print(f"{kind}: {int(chosen.sum())}, {pa:.1f}, {plain:.1f}, {100 * depth:.0f} %, {100 * turn:.0f} %")


if __name__ == "__main__":
    main(*sys.argv[1:])
