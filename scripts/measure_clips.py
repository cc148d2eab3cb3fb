"""Measure and print what frames tell one another: held-out motion capture at realistic noise that lasts some frames.

    python scripts/measure_clips.py MOCAP

Each clip's busiest two seconds, 25 frames a second, are fitted frame by frame, and the joints smoothed afterwards by a
Gaussian, against a film's fit. Joints are compared about their middle: MPJPE, PA-MPJPE, error of the acceleration.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import torch
import warp as wp

from warp_partdr import metrics
from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.scenes.fitting import fit_scene
from warp_partdr.scenes.options import SceneOptions
from warp_partdr.scenes.start import time_shares
from warp_partdr.synthetic.mocap import Clip, is_held_out, joint_positions
from warp_partdr.synthetic.mocap_files import load_clips
from warp_partdr.synthetic.scene_people import SceneSample, make_clip

_RATE, _FRAMES = 25.0, 48
_MOST_ACCELERATION = 20.0  # [mm/frame^2] on average; more comes from frames that are turned around
_FIRST_PERSON = 160
_WIDTHS = (1.0, 2.0, 3.0, 4.0, 6.0)  # [frames], of the smoothing afterwards


def main(folder: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    rows: dict[str, list[np.ndarray]] = {}
    for place, clip in enumerate(clips(folder)):
        sample = make_clip(_FIRST_PERSON + place, clip, _RATE)
        alone = joints_of(sample, replace(SceneOptions.film(), smoothing=0.0))
        rows.setdefault("frame by frame", []).append(score(alone, sample.joints[0]))
        for width in _WIDTHS:
            shares = time_shares(torch.ones(1, len(alone), dtype=torch.bool), width)[0].numpy()
            smooth = np.einsum("ts,sjk->tjk", shares, alone)
            rows.setdefault(f"smoothed by {width:g} frames", []).append(score(smooth, sample.joints[0]))
        rows.setdefault("as a film", []).append(score(joints_of(sample, SceneOptions.film()), sample.joints[0]))
        print(f"{clip.name}: {', '.join(f'{values[-1][0]:.1f}' for values in rows.values())}", flush=True)
    for name, values in rows.items():
        error, aligned, acceleration = np.mean(values, axis=0)
        print(f"{name}: MPJPE {error:.1f} mm, PA-MPJPE {aligned:.1f}, acceleration {acceleration:.1f} mm/frame^2")
    best = min((name for name in rows if name.startswith("smoothed")), key=lambda name: np.mean(rows[name], axis=0)[0])
    gain = np.array(rows["as a film"])[:, 0] - np.array(rows[best])[:, 0]
    low, high = metrics.bootstrap_sum(gain, lambda sums: sums / len(gain))
    print(f"as a film against {best}: MPJPE {gain.mean():+.1f} mm ({low:+.1f} to {high:+.1f}), {len(gain)} clips")


def clips(folder: str) -> list[Clip]:
    """The busiest part of each held-out clip of 25 frames a second."""
    found = []
    for clip in load_clips(folder):
        if not (clip.name.startswith("expmap.") and is_held_out(clip)) or len(clip) < _FRAMES:
            continue
        moves = acceleration(joint_positions(clip.global_orient, clip.rotations))
        starts = range(0, len(moves) - _FRAMES + 3, _FRAMES // 2)
        busy = [float(moves[start : start + _FRAMES - 2].mean()) for start in starts]
        clean = [value if value < _MOST_ACCELERATION else -1.0 for value in busy]
        if max(clean) > 0:
            start = starts[int(np.argmax(clean))]
            found.append(clip[start : start + _FRAMES])
    return found


def joints_of(sample: SceneSample, options: SceneOptions) -> np.ndarray:
    """LSP's joints of the one person in the world [m], shape (T, 14, 3)."""
    return fit_scene(sample.scene, options=options).landmarks(MPJPE_JOINTS)[0].numpy()


def score(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """MPJPE about the joints' middle, PA-MPJPE [mm], error of the acceleration [mm/frame^2]."""
    middle = [each - each.mean(1, keepdims=True) for each in (found, truth)]
    aligned = np.mean([float(metrics.pa_mpjpe(*pair)) for pair in zip(found, truth, strict=True)])
    moves = np.linalg.norm(np.diff(found - truth, n=2, axis=0), axis=-1).mean()
    return 1000 * np.array([np.linalg.norm(middle[0] - middle[1], axis=-1).mean(), aligned, moves])


def acceleration(joints: np.ndarray) -> np.ndarray:
    """Mean length of the second differences of joints (T, J, 3) [m] in each frame but two [mm]."""
    return 1000 * np.linalg.norm(np.diff(joints, n=2, axis=0), axis=-1).mean(-1)


if __name__ == "__main__":
    main(*sys.argv[1:2])
