"""Learn what ``lab.synthetic.population`` knows of people's measures, and write its ``population.json``.

    python scripts/learn_population.py ANSUR

ANSUR is ``ansur2.npz``: ANSUR II (US Army, 2012, public release), keys such as male/stature, 4,082 men and 1,986 women,
tape measures in mm. For each sex it learns means of the logarithms of ``MEASURES`` and a lower triangular factor of
their covariance; from Anny's adults the measures as linear functions of shape values, and how far off that is.

Bones of a body lie between joints, not between the landmarks that tapes are laid at: a shoulder's joint is 35 mm below
the acromion and 20 mm nearer the middle, an elbow's 10 mm above the radiale, a wrist's 5 mm below the radius' end
(checked with de Leva 1996: upper arm 0.162, forearm 0.154 of the stature; these give 0.165, 0.155).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from warp_partdr.body.template import JOINT_NAMES
from warp_partdr.lab.harness import run_script
from warp_partdr.lab.synthetic.population import MEASURES
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.measuring import _TRUNK, _edges, _girths, measure_body

ASSET = Path(__file__).resolve().parents[1] / "warp_partdr/assets/population.json"
_DOWN, _INWARD, _ELBOW, _WRIST = 0.0199, 0.0114, 0.0057, 0.0028  # of the stature: joints from tapes' landmarks
_NAVEL = 0.31  # ANSUR's waist is the navel's: so far from the hips' joints up to the shoulders'
_PEOPLE, _BATCH = 1600, 100


def tape_measures(data: dict[str, np.ndarray], sex: str) -> np.ndarray:
    """``MEASURES`` of soldiers [m], shape (N, 11)."""

    def tape(name: str) -> np.ndarray:
        return data[f"{sex}/{name}"].astype(float) / 1000

    stature, knee = tape("stature"), tape("lateralfemoralepicondyleheight")
    measures = {
        "stature": stature,
        "waist girth": tape("waistcircumference"),
        "chest girth": tape("chestcircumference"),
        "hip girth": tape("buttockcircumference"),
        "thigh girth": tape("thighcircumference"),
        "shoulder height": tape("acromialheight") - _DOWN * stature,
        "shoulder width": tape("biacromialbreadth") - 2 * _INWARD * stature,
        "upper leg length": tape("trochanterionheight") - knee,
        "lower leg length": knee - tape("lateralmalleolusheight"),
        "upper arm length": tape("acromionradialelength") - (_DOWN + _ELBOW) * stature,
        "forearm length": tape("radialestylionlength") + (_ELBOW - _WRIST) * stature,
    }
    return np.stack([measures[name] for name in MEASURES], axis=1)


def body_measures(shape: torch.Tensor) -> torch.Tensor:
    """``MEASURES`` of Anny's bodies (B, 20) at rest [m], shape (B, 11)."""
    model = anny()
    rest = model.rest(shape)
    joints = dict(zip(JOINT_NAMES, model.landmarks(rest, JOINT_NAMES).unbind(1), strict=True))

    def length(start: str, end: str) -> torch.Tensor:
        sides = [joints[f"{side}_{start}"] - joints[f"{side}_{end}"] for side in ("left", "right")]
        return torch.stack(sides).norm(dim=-1).mean(0)

    hips, shoulders = joints["left_hip"][:, 1], joints["left_shoulder"][:, 1]
    stature, chest, _, hip, thigh = measure_body(model, rest).unbind(1)
    measures = {
        "stature": stature,
        "waist girth": _girths(rest.vertices, _edges(model, _TRUNK), hips + _NAVEL * (shoulders - hips)),
        "chest girth": chest,
        "hip girth": hip,
        "thigh girth": thigh,
        "shoulder height": shoulders - rest.vertices[..., 1].amin(1),
        "shoulder width": (joints["left_shoulder"] - joints["right_shoulder"]).norm(dim=-1),
        "upper leg length": length("hip", "knee"),
        "lower leg length": length("knee", "ankle"),
        "upper arm length": length("shoulder", "elbow"),
        "forearm length": length("elbow", "wrist"),
    }
    return torch.stack([measures[name] for name in MEASURES], dim=1)


def linear_measures() -> np.ndarray:
    """Measures as linear functions of shape values and 1, shape (11, 21), by least squares; prints how exact it is."""
    rng = np.random.default_rng(0)
    low, high = np.array([[0, 1], [0.3, 1], [0, 1], [0, 1], [0.15, 0.6], [0, 1]]).T
    shapes = anny_shape(rng.uniform(low, high, (_PEOPLE, 6)))
    shapes = shapes + 0.5 * torch.from_numpy(rng.standard_normal(shapes.shape)).float()
    measures = torch.cat([body_measures(some) for some in shapes.split(_BATCH)]).double().numpy()
    extended = np.concatenate([shapes.double().numpy(), np.ones((_PEOPLE, 1))], axis=1)
    half = _PEOPLE // 2
    off = extended[half:] @ np.linalg.lstsq(extended[:half], measures[:half])[0] - measures[half:]
    for name, share in zip(MEASURES, np.sqrt((off**2).mean(0)) / measures.mean(0), strict=True):
        print(f"{name}: linear to {100 * share:.2f} % (RMS)")
    return np.linalg.lstsq(extended, measures)[0].T


def main(ansur: Path, /) -> None:
    """Learn, print and write.

    Args:
        ansur: File ansur2.npz.
    """
    with np.load(ansur, allow_pickle=False) as archive:
        data = {name: archive[name] for name in archive.files}
    learned: dict[str, object] = {
        "source": "ANSUR II (US Army, 2012, public release), by scripts/learn_population.py; parameters only",
        "measures": list(MEASURES),
    }
    for key, sex in (("men", "male"), ("women", "female")):
        measures = tape_measures(data, sex)
        logs = np.log(measures)
        for name, values in zip(MEASURES, measures.T, strict=True):
            print(f"{key}, {name}: {values.mean():.3f} m, SD {values.std():.3f} m")
        factors = np.linalg.cholesky(np.cov(logs.T))
        learned[key] = {"log_means": logs.mean(0).round(4).tolist(), "log_factors": factors.round(4).tolist()}
    learned["measure_model"] = linear_measures().round(5).tolist()
    text = json.dumps(learned, indent=1)
    ASSET.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    run_script(main)
