"""Learn ``warp_partdr/assets/body_confidence.json`` from photos of people in hard situations.

    python -m warp_partdr.lab confidence --people 40000 40399 --device cuda --save rows0.npz
    ...
    python scripts/learn_confidence.py rows0.npz ...

Logistic regressions say how likely a body is right (``lab/measurements/confidence.py``), one for each set of measures
that a fit may have, and how likely each kind of limb is right. Every fifth photo is held out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warp_partdr.lab.harness import run_script
from warp_partdr.lab.measurements.confidence import HELD_OUT, LIMB_RIGHT, RIGHT, WRONG, area_under_curve
from warp_partdr.solve.confidence.limbs import LIMBS
from warp_partdr.solve.confidence.model import FORMAT, Logistic, probabilities

ASSET = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets" / "body_confidence.json"
ALWAYS = ("keypoints", "seen")
SETS = (("depths", "score", "mirror"), ("depths", "score"), ("depths",), ("score", "mirror"), ("score",), ())
_RIDGE, _STEPS = 1e-3, 60
_WARNED = 0.1  # share of right bodies that warnings may hit, for the figures that are printed
# Confidence below which a body is warned of. Of 97 bodies in real photos, 7 of 8 that look wrong are below it, and 6
# of 72 that look right (docs/measured/confidence.md).
_LEAST = 0.4


def learn(*rows: Path) -> None:
    """Learn from rows of the measurement "confidence", and write the asset.

    Args:
        rows: Files .npz.
    """
    files = [dict(np.load(path)) for path in rows]
    table = {name: np.concatenate([each[name] for each in files]) for name in files[0]}
    columns = {name.removeprefix("body "): values for name, values in table.items() if name.startswith("body ")}
    largest = table["errors"].max(axis=1)
    right, wrong = largest < RIGHT, largest >= WRONG
    held_out = table["photo"] % HELD_OUT == 0
    bodies = []
    for names in ((*ALWAYS, *some) for some in SETS):
        known = np.all([np.isfinite(columns[name]) for name in names], axis=0)
        bodies.append(_regression(names, columns, right, known & ~held_out))
        logits, clear = Logistic(**bodies[-1]).logits(columns), known & held_out & (right | wrong)
        least = np.quantile(logits[known & ~held_out & right], _WARNED)
        warned = 100 * float((logits[known & held_out & wrong] < least).mean())
        area = area_under_curve(logits[clear], right[clear])
        print(
            f"{', '.join(names)}: held out, AUC {area:.3f}, {int(clear.sum())} bodies; "
            f"{warned:.0f} % of the wrong ones are warned of below {probabilities(least):.2f}"
        )
    content = {
        "format": FORMAT,
        "bodies": bodies,
        "limbs": _limbs(table, _body_logits(bodies, columns), held_out),
        "least": _LEAST,
    }
    ASSET.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(f"{ASSET.name}: {len(right)} bodies of {len(np.unique(table['photo']))} photos")


def _limbs(table: Mapping[str, np.ndarray], body: np.ndarray, held_out: np.ndarray) -> dict[str, list[dict[str, Any]]]:
    """Regressions of each kind of limb, with the network's uncertainty and without."""
    found: dict[str, list[dict[str, Any]]] = {}
    for kind in dict.fromkeys(limb.kind for limb in LIMBS):
        rows = [row for row, limb in enumerate(LIMBS) if limb.kind == kind]
        columns = {
            name.removeprefix("limb "): values[:, rows].ravel()
            for name, values in table.items()
            if name.startswith("limb ")
        }
        columns["body"] = np.repeat(body, len(rows))
        right, out = table["limb_errors"][:, rows].ravel() < LIMB_RIGHT, np.repeat(held_out, len(rows))
        found[kind] = []
        for names in (("depths", "keypoints", "body"), ("keypoints", "body")):
            known = np.all([np.isfinite(columns[name]) for name in names], axis=0)
            found[kind].append(_regression(names, columns, right, known & ~out))
            logits = Logistic(**found[kind][-1]).logits(columns)[known & out]
            print(f"{kind}, {', '.join(names)}: held out, AUC {area_under_curve(logits, right[known & out]):.3f}")
    return found


def _regression(
    names: Sequence[str], columns: Mapping[str, np.ndarray], right: np.ndarray, rows: np.ndarray
) -> dict[str, Any]:
    """Logistic regression with a little ridge, by Newton's method."""
    values = np.stack([columns[name][rows] for name in names], axis=1)
    mean, spread = values.mean(axis=0), values.std(axis=0) + 1e-9
    design = np.column_stack([(values - mean) / spread, np.ones(len(values))])
    ridge = np.append(np.full(len(names), _RIDGE), 1e-9)
    weights = np.zeros(len(ridge))
    for _ in range(_STEPS):
        chance = probabilities(design @ weights)
        gradient = design.T @ (chance - right[rows]) / len(design) + ridge * weights
        curvature = (design * (chance * (1 - chance))[:, None]).T @ design / len(design) + np.diag(ridge)
        weights -= np.linalg.solve(curvature, gradient)
    scaled = weights[:-1] / spread
    bias = float(weights[-1] - scaled @ mean)
    return {"measures": list(names), "weights": [round(float(each), 4) for each in scaled], "bias": round(bias, 4)}


def _body_logits(bodies: Sequence[Mapping[str, Any]], columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Logarithms of each body's odds, by the first regression whose measures the body has."""
    found = np.full(len(columns["keypoints"]), np.nan)
    for regression in bodies:
        own = Logistic(**regression).logits(columns)
        found = np.where(np.isnan(found), own, found)
    return found


if __name__ == "__main__":
    run_script(learn)
