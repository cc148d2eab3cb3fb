"""Metrics, label sets and the pose prior."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import torch

from fuzzing.chance import Chance
from fuzzing.fits import prior
from warp_partdr import label_set
from warp_partdr.body.labels import LabelSet, regroup
from warp_partdr.body.template import PART_NAMES
from warp_partdr.inputs.part_labels import read_label_set
from warp_partdr.metrics import accuracy, align_similarity, confusion, f1_scores, mpjpe, pa_mpjpe, pve


def try_metrics(chance: Chance) -> Any:
    batch = chance.one([(), (2,), (0,)])
    points, target = (chance.maybe(chance.tensor(*batch, 6, 3)) for _ in range(2))
    kind = chance.rng.integers(5)
    if kind == 0:
        return mpjpe(points, target, centre_on=chance.either((0, 1), (), (0,), (0, 9)))
    if kind == 1:
        return pa_mpjpe(points, target), align_similarity(points, target)
    if kind == 2:
        valid = chance.maybe(torch.ones(*batch, 6, dtype=torch.bool, device=chance.device))
        return mpjpe(points, target, valid=valid)
    if kind == 3:
        return pve(
            points, target, pelvis=chance.maybe(chance.tensor(*batch, 3)), target_pelvis=chance.tensor(*batch, 3)
        )
    shape = (*batch, 4, 5)
    counts = confusion(
        chance.maybe(torch.from_numpy(chance.rng.integers(0, 4, shape))),
        chance.maybe(torch.from_numpy(chance.rng.integers(0, 4, shape))),
        chance.number(4, 2, 256),
    )
    return counts, accuracy(counts), np.nan_to_num(f1_scores(counts))


def try_label_sets(chance: Chance) -> Any:
    data = {
        "name": "mine",
        "groups": {"head": ["head", "neck"], "arm": ["left_forearm", "left_hand"], "leg": [chance.one(PART_NAMES)]},
        "ids": {"0": "background", "1": "head", "2": "arm", "7": "ignore", "9": "leg"},
    }
    spoilt = chance.json(data)
    if chance.rng.random() < 0.5:
        found: LabelSet = read_label_set(chance.file("labels.json", json.dumps(spoilt).encode()))
    else:
        found = (
            read_label_set(spoilt) if isinstance(spoilt, dict) else label_set(chance.one(["lsp6", "cdcl14", "none"]))
        )
    image = chance.array(chance.rng.choice([0, 1, 2, 7, 9, 255], (4, 5)))
    groups = found.to_groups(image)
    return groups, found.to_ids(groups), found.from_parts(groups % 21), regroup(label_set("ellipbody20"), found)


def try_prior(chance: Chance) -> Any:
    batch = chance.one([0, 1, 3])
    vectors, up = chance.maybe(chance.tensor(batch, 20, 3)), chance.maybe(chance.tensor(batch, 3))
    return prior(chance.device)(vectors, up), prior(chance.device).joint_limits(vectors)
