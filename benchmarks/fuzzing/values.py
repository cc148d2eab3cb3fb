"""Metrics and label sets."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import torch

from fuzzing.case import Case
from warp_partdr import label_set
from warp_partdr.body.labels import regroup
from warp_partdr.body.template import PART_NAMES
from warp_partdr.metrics import accuracy, confusion, f1_scores, mpjpe, pa_mpjpe, pve


def try_metrics(case: Case) -> Any:
    batch = case.one([(), (2,), (0,)])
    points, target = (case.maybe(case.tensor(*batch, 6, 3)) for _ in range(2))
    kind = case.one(["centred", "aligned", "valid", "vertices", "labels"])
    if kind == "centred":
        return mpjpe(points, target, centre_on=case.either((0, 1), (), (0,), (0, 9)))
    if kind == "aligned":
        return pa_mpjpe(points, target)
    if kind == "valid":
        valid = torch.ones(*batch, 6, dtype=torch.bool, device=case.device)
        return mpjpe(points, target, valid=case.maybe(valid))
    if kind == "vertices":
        pelvis = case.maybe(case.tensor(*batch, 3))
        return pve(points, target, pelvis=pelvis, target_pelvis=case.tensor(*batch, 3))
    labels = (case.maybe(torch.from_numpy(case.rng.integers(0, 4, (*batch, 4, 5)))) for _ in range(2))
    counts = confusion(*labels, case.number(4, 2, 256))
    return counts, accuracy(counts), np.nan_to_num(f1_scores(counts))


def try_label_sets(case: Case) -> Any:
    data = {
        "name": "mine",
        "groups": {"head": ["head", "neck"], "arm": ["left_forearm", "left_hand"], "leg": [case.one(PART_NAMES)]},
        "ids": {"0": "background", "1": "head", "2": "arm", "7": "ignore", "9": "leg"},
    }
    spoilt = case.json(data)
    if case.happens(5):
        found = label_set(case.file("labels.json", json.dumps(spoilt).encode()))
    else:
        found = label_set(spoilt if isinstance(spoilt, dict) else case.one(["lsp6", "cdcl14", "none"]))
    groups = found.to_groups(case.array(case.rng.choice([0, 1, 2, 7, 9, 255], (4, 5))))
    return groups, found.to_ids(groups), found.from_parts(groups % 21), regroup(label_set("ellipbody20"), found)
